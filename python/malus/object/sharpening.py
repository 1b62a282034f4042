"""Restores detail that stereo smoothed away, as far as the phases of several stations support it.

A phase of polarization constrains the surface normal to a plane through the viewing ray, whatever the station's prior; the depths of
each station are moved slightly and smoothly, so that as many normals as possible lie in the planes of all stations. The library
(cpp/malus/object/sharpening.h) does it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from malus import _core
from malus.object.arrays import on_disk
from malus.object.views import Singles, View
from malus.threads import ALL_CORES
from malus.workspace import Workspace


@dataclass(frozen=True)
class Phases:
    """Polarization of a station: degree times cosine and sine of twice the phase, 2×H×W; zero where it is not known."""

    maps: Singles

    @staticmethod
    def of(workspace: Workspace, path: Path) -> Phases:
        """The phases of a finished workspace. path: a new file for the maps."""
        degree, phase = (workspace.raster(f"polarization/{name}.tif") for name in ("degree", "phase"))
        return Phases(on_disk(np.stack(_core.phase_maps(degree, phase)), path))


def telling(views: Sequence[View], phases: Sequence[Phases], *, threads: int = ALL_CORES) -> list[tuple[View, Phases]]:
    """The stations whose phases are consistent with their own surfaces."""
    stations = zip(views, phases, strict=True)
    return [(view, known) for view, known in stations if _core.is_telling(view.core, known.maps, threads)]


def sharpened(
    views: Sequence[View], stations: Sequence[tuple[View, Phases]], *, threads: int = ALL_CORES
) -> Iterator[View]:
    """The views with depths and normals adjusted to the phases of the stations, one after the other; `usable` does not change."""
    phased = [(view.core, known.maps) for view, known in stations]
    for view in views:
        depth, normals = _core.sharpened(view.core, phased, threads)
        yield replace(view, depth=depth, normals=normals)

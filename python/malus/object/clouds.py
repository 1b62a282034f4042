"""The stations' clouds as oriented points of an object, for places that no station measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from malus import _core, scans
from malus.batch import Outcome
from malus.object.agreement import OrientedPoints
from malus.object.definition import Object
from malus.object.implicit import pixel_side
from malus.object.views import Floats
from malus.workspace import Workspace


def clouds_of(thing: Object, done: Sequence[Outcome], output: Path, gsd: float, threads: int) -> list[OrientedPoints]:
    """The stations' clouds that have normals, without duplicates, as large as known distances make them. Their points count as pixels
    that are large enough to join each other to a surface.
    """
    parts = []
    clouds: dict[str, tuple[str, float]] = {}
    for outcome in done:
        said = thing.campaign.station(outcome["file"]).describe()
        if "prior_cloud" in said:
            clouds.setdefault(said["prior_cloud"], (outcome["station"], said["prior_scale"]))
    for cloud, (station, scale) in clouds.items():
        read = _read_cloud(Path(cloud), thing.unit)
        noise = Workspace(output / "stations" / station).manifest["steps"]["prior"]["notes"]["noise"]
        if read is not None:
            count, points, normals = len(read[0]), scale * read[0], read[1]
            # Limited as the scales of views are: the margins about blocks are no wider.
            (*_, side) = _core.scales_of([gsd, gsd, max(gsd, pixel_side(points, threads))])
            parts.append(
                OrientedPoints(
                    points, normals, np.full(count, float(noise)), np.zeros(count, np.int64),
                    np.full(count, side, np.float32) if side > 1 else None,
                )
            )  # fmt: skip
    return parts


def _read_cloud(path: Path, unit: str) -> tuple[Floats, Floats] | None:
    """Points of a station's cloud, a file or a workspace of COLMAP's dense stereo, that have normals, and these unit normals; None if there
    are none.
    """
    points, normals = scans.read_scan(path, unit)[:2] if scans.is_scan(path) else _core.read_oriented_points(str(path))
    if normals is None:
        return None
    # A normal that is not known is zero. Such a point confirms no other, and would make outliers of the good ones beside it.
    known = normals.any(1)
    return (points[known], normals[known].astype(np.float64)) if known.any() else None

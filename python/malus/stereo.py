"""Depth in the station's view from ordinary photos, by a surface sweep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_mask, as_rows
from malus.camera import Camera, as_view
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["SweepPass", "SweepResult", "sweep"]


@dataclass(frozen=True)
class SweepPass:
    """One sweep of depth offsets about the surface of the previous pass."""

    reduction: int
    """Side of a pixel of this level, in pixels of the station's image."""
    offsets: int
    """Number of depth offsets tried at each pixel."""
    step_gsd: float
    """Step between neighboring offsets, in GSD."""
    score: float
    """Median correlation at the offsets found."""
    change_gsd: float
    """Median absolute change of the surface, in GSD."""
    seconds: float


@dataclass(frozen=True)
class SweepResult:
    """Depth of every pixel of the station's view; H×W float32 rasters, NaN = none."""

    depth: NDArray[np.float32]
    """z in the station's camera frame, in the unit of the world."""
    sigma: NDArray[np.float32]
    """One standard deviation of depth, in the same unit."""
    confidence: NDArray[np.float32]
    """Mean correlation of the best photos times the share of pixels around where both halves of the photos agree."""
    views_total: int
    views_used: int
    points_total: int
    points_used: int
    """Of a sample of the triangulated points on the object, those that match in the photos."""
    completeness: float
    """Share of the mask that has a depth."""
    highlights: float
    """Share of the mask that is left out because the station's image shows highlights there: mirror images agree on a wrong depth."""
    median_score: float
    median_sigma_gsd: float
    halves_compared: bool
    """Whether two disjoint halves of the photos were compared, which needs at least three photos."""
    passes: list[SweepPass]


def _as_photo(image: ArrayLike | Path, camera: Camera, name: str) -> NDArray[np.float32] | str:
    return str(image) if isinstance(image, Path) else as_view(image, name, camera)


def sweep(
    intensity: ArrayLike,
    camera: Camera,
    views: Sequence[tuple[ArrayLike | Path, Camera]],
    points: ArrayLike,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
    progress: Callable[[str, float, str], None] | None = None,
    log: Callable[[str, str], None] | None = None,
    surface: tuple[ArrayLike, ArrayLike] | None = None,
) -> SweepResult:
    """Depth, its standard deviation and a confidence in the station's view.

    intensity: H×W, the station's unpolarized intensity, linear, in [0, 1], undistorted. camera: the station's camera (without
    distortion) and pose. views: photos with their cameras (any lens model) and poses. A photo is an array (H'×W', in [0, 1] as
    the file codes it) or a Path; a photo from a Path is held in memory once, an array twice. points: N×3, triangulated points
    in the world's frame, from which the search starts. mask: H×W, non-zero = object. options: section `sweep`;
    `sweep.station_gamma=1` if the station is coded like the photos. progress gets (step, fraction, message), log (level,
    message); messages call the first photo views[0]. surface: depth and its standard deviation (both H×W) of a surface known
    beforehand, such as a fused one; the sweep then starts from this surface instead of the points, with larger windows that
    follow it.

    Raises InputError for values that cannot be used, DataError if no photo sees the object or too few points are on it.
    Method: coarse-to-fine offsets from a surface, windowed normalized cross-correlation with the best photos,
    semi-global matching (Hirschmüller 2008); sigma from disjoint halves of the photos.
    """
    found = _core.sweep_surface(
        as_view(intensity, "intensity", camera),
        camera.values(),
        [(_as_photo(image, view, f"views[{k}]"), view.values()) for k, (image, view) in enumerate(views)],
        as_rows(points, "points"),
        None if surface is None else (as_image(surface[0], "surface"), as_image(surface[1], "surface's sigma")),
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
        progress,
        log,
    )
    passes = [SweepPass(**values) for values in found.pop("passes")]
    return SweepResult(passes=passes, **found)

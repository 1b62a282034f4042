"""The coarse surface in the polarized view."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_mask
from malus._core import DepthPrior
from malus.camera import Camera
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["DepthPrior", "project_points"]


def project_points(
    points: ArrayLike,
    camera: Camera,
    *,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """Depth and its standard deviation in a camera's view from a cloud.

    points: N×3, world frame. camera: with its pose, without distortion.
    mask: H×W, non-zero = object. Hidden points and outliers are removed; gaps are filled; the smoothing is chosen from the
    points' scatter. Returns `depth` and `sigma` (H×W float32, NaN outside the mask).
    """
    cloud = np.ascontiguousarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points has shape {cloud.shape}, expected (N, 3)")
    return _core.project_points(
        cloud,
        camera,
        None if mask is None else as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )

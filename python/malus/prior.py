"""The coarse surface in the polarized view."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_mask
from malus._core import DepthPrior, Pinhole
from malus.options import Options

__all__ = ["DepthPrior", "Pinhole", "project_points"]


def project_points(
    points: ArrayLike,
    camera: Pinhole,
    *,
    rotation: ArrayLike | None = None,
    translation: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = 1,
) -> DepthPrior:
    """Depth and its standard deviation in a camera's view from a cloud.

    points: N×3, world frame. rotation (3×3), translation (3): x_in_cam = R x + t; left out = the camera frame is the world.
    mask: H×W, non-zero = object. Hidden points and outliers are removed; gaps are filled; the smoothing is chosen from the
    points' scatter. Returns `depth` and `sigma` (H×W float32, NaN outside the mask).
    """
    cloud = np.ascontiguousarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"points has shape {cloud.shape}, expected (N, 3)")
    return _core.project_points(
        cloud,
        camera,
        np.asarray(np.eye(3) if rotation is None else rotation, dtype=np.float64),
        np.asarray(np.zeros(3) if translation is None else translation, dtype=np.float64),
        None if mask is None else as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )

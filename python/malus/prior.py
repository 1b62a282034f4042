"""The coarse surface in the polarized view."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_image, as_mask, as_rows, as_triangles
from malus._core import DepthPrior
from malus.camera import Camera
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["DepthPrior", "project_depth", "project_mesh", "project_points"]


def project_points(
    points: ArrayLike,
    camera: Camera,
    *,
    normals: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """Depth and its standard deviation in a camera's view from a cloud.

    points: N×3, world frame. normals: N×3, pointing away from the object, or None. camera: with its pose, without distortion.
    mask: H×W, non-zero = object. Hidden points and outliers are removed; gaps are filled; the smoothing is chosen from the
    points' scatter. Returns `depth` and `sigma` (H×W float32, NaN outside the mask).
    """
    cloud = as_rows(points, "points")
    return _core.project_points(
        cloud,
        None if normals is None else as_rows(normals, "normals", len(cloud), np.float32),
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )


def project_mesh(
    vertices: ArrayLike,
    triangles: ArrayLike,
    camera: Camera,
    *,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """As `project_points`, for a mesh: vertices N×3 (world frame), triangles M×3 (indices). Holes are filled from their surroundings."""
    corners = as_rows(vertices, "vertices")
    return _core.project_mesh(
        corners,
        as_triangles(triangles, len(corners)),
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )


def project_depth(
    depth: ArrayLike,
    camera: Camera,
    *,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """As `project_points`, for a depth map (H×W, z in the camera, NaN = none), whose holes on the object are filled."""
    raster = as_image(depth, "depth")
    if raster.shape != (camera.height, camera.width):
        raise ValueError(f"depth has shape {raster.shape}, expected {(camera.height, camera.width)} as the camera")
    return _core.project_depth(
        raster,
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )

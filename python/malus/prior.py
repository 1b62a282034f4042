"""The coarse surface in the polarized view.

`DepthPrior(depth, sigma, camera)` takes rasters of your own (H×W; z in the camera and its standard deviation, NaN = none), which it
copies; its rasters are read-only. Such a sigma counts as a systematic error, like that of a shape: the fused surface is not anchored to
these depths, and its sigma is nowhere smaller. `project_depth` with the option prior.sigma makes a prior whose errors are noise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_mask, as_rows, as_triangles
from malus._core import DepthPrior
from malus._plain import plain
from malus.camera import Camera, as_view
from malus.options import Options
from malus.station import ShapeValues
from malus.threads import ALL_CORES

__all__ = ["DepthPrior", "project_depth", "project_mesh", "project_points", "project_shape", "project_swept"]


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

    points: N×3, world frame. normals: N×3, pointing out of the object, or None. camera: with its pose, without distortion.
    mask: H×W, non-zero = object. Hidden points and outliers are removed; gaps are filled; the smoothing is chosen from the
    points' scatter. Returns `depth` and `sigma` (H×W float32, NaN outside the mask). `assumes_sigma`: the points hardly scatter,
    as those of a smoothed surface; sigma is then `prior.raster_sigma_gsd` unless `prior.sigma` states it.
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
        as_triangles(triangles, "triangles", len(corners)),
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
    return _core.project_depth(
        as_view(depth, "depth", camera),
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )


def project_shape(
    shape: ShapeValues,
    sigma: float,
    camera: Camera,
    *,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """As `project_points`, for a plane, sphere or cylinder of the world frame, given as in [prior] of a station file:
    {"sphere": {"center": [x, y, z], "radius": r}}.

    sigma: how far the object is from the shape, one standard deviation in the unit of the shape; prior.sigma of `options` is not
    used. It is no noise: the surface is not anchored to the shape, and its sigma is nowhere smaller. Pixels of the object whose
    rays miss the shape are filled from their surroundings. malus.InputError names keys and values as for a file; malus.DataError
    if hardly any ray meets the shape.
    """
    if not isinstance(shape, Mapping):
        raise ValueError(
            f"shape is a {type(shape).__name__}, expected a mapping with the key plane, sphere or cylinder"
        )
    return _core.project_shape(
        json.dumps(plain(shape, "shape: ")),
        float(sigma),
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )


def project_swept(
    depth: ArrayLike,
    sigma: ArrayLike,
    camera: Camera,
    *,
    surface: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> DepthPrior:
    """As `project_points`, for depths that were measured over windows, with the standard deviation of each (both H×W, NaN = none), as
    `malus.stereo.sweep` returns them. Neighboring pixels share most of their errors, so that every fourth pixel counts as a point.

    surface: H×W z, over the whole object, of the surface that the sweep started from: only the difference from it is smoothed, and it
    continues where there is no depth. The prior's sigma is nowhere below the given one, and grows with the distance from the
    depths. ValueError for rasters of another shape than the camera's; malus.DataError if hardly any pixel has a depth.
    """
    return _core.project_swept(
        as_view(depth, "depth", camera),
        as_view(sigma, "sigma", camera),
        None if surface is None else as_view(surface, "surface", camera),
        camera,
        as_mask(mask, (camera.height, camera.width)),
        (options or Options()).to_json(),
        threads,
    )

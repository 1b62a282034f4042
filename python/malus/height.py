"""Height from polarization and shading alone (Eq 9 to 11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_image, as_mask, as_numbers
from malus._core import HeightMap, PolarizationState, ReflectionMap
from malus.camera import Camera, require_view
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["HeightMap", "light", "light_from_polarization", "solve"]


def light(
    intensity: ArrayLike,
    normals: ArrayLike,
    *,
    mask: ArrayLike | None = None,
    camera: Camera | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> dict[str, Any]:
    """Light from intensity (H×W) and known normals (H×W×3, camera frame): robust least squares, intensity = light[:3] · n + light[3].

    Returns `light` (4), `status`, `rms`, `robust_sigma` (unit of the intensity) and `pixels`. camera None = orthographic.
    """
    image = as_image(intensity, "intensity")
    require_view(camera, image.shape, "intensity")
    return _core.estimate_light(
        image,
        as_image(normals, "normals", 3),
        as_mask(mask, image.shape),
        camera,
        (options or Options()).to_json(),
        threads,
    )


def light_from_polarization(
    state: PolarizationState,
    reflection: ReflectionMap,
    *,
    direction: ArrayLike | None = None,
    camera: Camera | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> dict[str, Any]:
    """Light of an object of one albedo from its polarization alone; returns the keys of `light`, and `of_contour`.

    A hollow lit from one side looks like a bump lit from the other side. Option light.without_prior selects the assumption that
    decides between the two. "contour": at the outline of the state's mask the surface turns away from the view. If it does
    not, `of_contour` is False and convexity decides. The light fitted to all pixels, on the side that the outline decides,
    is used if it is within 10° of the light fitted to the outline; otherwise the outline's light is used. "convex": the object is
    convex as a whole (after Smith et al. 2016). With `direction` (3, camera frame, towards the source) only the strength is found.
    """
    require_view(camera, state.unpolarized.shape, "the state")
    vector = None
    if direction is not None:
        vector = np.asarray(as_numbers(direction, "direction"), dtype=np.float64)
        if vector.shape != (3,) or not np.linalg.norm(vector) > 0:
            raise ValueError(f"direction is {vector.tolist()}, expected three numbers that are not all zero")
    return _core.light_from_polarization(state, reflection, vector, camera, (options or Options()).to_json(), threads)


def solve(
    state: PolarizationState,
    reflection: ReflectionMap,
    *,
    camera: Camera | None = None,
    light: ArrayLike | None = None,
    prior_normals: ArrayLike | None = None,
    prior_depth: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> HeightMap:
    """Solve the height system; `height` is H×W, in pixels (GSD), positive towards the camera, mean 0, NaN outside.

    camera None = orthographic. light: 4 numbers, i_un = light[:3] · n + light[3], n in the camera frame (x right, y down, z forward,
    towards the camera). Without `light` it is estimated with prior_normals (H×W×3), and without both as by `light_from_polarization`, which
    takes a hollow object for a raised one. prior_depth (only with `camera`): H×W, z of the coarse surface in the camera, NaN = none. The
    solution starts from it, continued over its gaps, where that is likelier than the linear solution; with the option height.boundary =
    "prior" it keeps to it along the outline. `status` says how the solver ended.
    """
    require_view(camera, state.unpolarized.shape, "the state")
    vector = None
    if light is not None:
        vector = np.asarray(as_numbers(light, "light"), dtype=np.float64)
        if vector.shape != (4,):
            raise ValueError(f"light has shape {vector.shape}, expected (4,): light vector and ambient")
    normals = None if prior_normals is None else as_image(prior_normals, "prior_normals", 3)
    depth = None if prior_depth is None else as_image(prior_depth, "prior_depth")
    if depth is not None and depth.shape != state.unpolarized.shape:
        raise ValueError(f"prior_depth has shape {depth.shape}, expected {state.unpolarized.shape} as the state")
    return _core.solve_height(
        state, reflection, camera, vector, normals, depth, (options or Options()).to_json(), threads
    )

"""Height from polarization and shading alone (Eq 9 to 11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_image
from malus._core import HeightMap, PolarizationState, ReflectionMap
from malus.camera import Camera
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["HeightMap", "solve"]


def solve(
    state: PolarizationState,
    reflection: ReflectionMap,
    *,
    camera: Camera | None = None,
    light: ArrayLike | None = None,
    prior_normals: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> HeightMap:
    """Solve the height system; `height` is H×W, in pixels (GSD), positive towards the camera, mean 0, NaN outside.

    camera None = orthographic. light: 4 numbers, i_un = light[:3] · n + light[3], n in the camera frame (x right, y down,
    z forward, towards the camera); left out = estimated with prior_normals (H×W×3). `status` says how it ended.
    """
    if light is None and prior_normals is None:
        raise ValueError("light and prior_normals are both missing, expected one of them")
    vector = None
    if light is not None:
        vector = np.asarray(light, dtype=np.float64)
        if vector.shape != (4,):
            raise ValueError(f"light has shape {vector.shape}, expected (4,): light vector and ambient")
    normals = None if prior_normals is None else as_image(prior_normals, "prior_normals", 3)
    return _core.solve_height(state, reflection, camera, vector, normals, (options or Options()).to_json(), threads)

"""Fusion of prior and polarization into one surface.

`FusedSurface(depth, normals, sigma, camera)` takes rasters of your own (H×W, H×W×3, H×W; NaN = none), which it copies. Its rasters are
read-only: for another surface change copies of them, and make a new one.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_metal, as_reflection
from malus._core import DepthPrior, FusedSurface, HeightMap, PolarizationState, ReflectionMap
from malus.options import Options
from malus.threads import ALL_CORES

__all__ = ["FusedSurface", "fuse_grid", "optimize_grid", "refine"]


def fuse_grid(
    height: HeightMap, prior: DepthPrior, *, options: Options | None = None, threads: int = ALL_CORES
) -> FusedSurface:
    """The paper's grid transfer (Eq 14 to 16): low frequencies of the prior, detail of the polarization height."""
    return _core.fuse_grid(height, prior, (options or Options()).to_json(), threads)


def optimize_grid(
    surface: FusedSurface,
    state: PolarizationState,
    reflection: ReflectionMap,
    prior: DepthPrior,
    height: HeightMap,
    *,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> FusedSurface:
    """Minimize the residuals of all equations of the paper together, starting from the surface of `fuse_grid` (decision 45): one
    interpretation of the "simultaneous optimization" after Eq 16. The light is that of `height`; weights and number of steps come
    from `options.optimize`, whose `enabled` is ignored here.

    Returns a new surface, in the camera frame and unit of the given one; its `status` says how the minimization ended. Raises
    malus.InputError for rasters of another size, and if the height has no light.
    """
    return _core.optimize_grid(surface, state, reflection, prior, height, (options or Options()).to_json(), threads)


def refine(
    state: PolarizationState,
    prior: DepthPrior,
    *,
    refractive_index: float | None = 1.5,
    reflection: str | ArrayLike = "auto",
    metal: str | complex | Sequence[float] = "auto",
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> FusedSurface:
    """Refine the prior by nonlinear least squares on log depth (docs/method.md); refractive_index None = from the data.

    reflection: "auto", "diffuse", "specular", or labels H×W (1 = diffuse, 2 = specular, 0 = decide). With anything but "auto", no map of
    the surroundings is fitted, and the object is taken for bare metal only if `metal` states it. metal: "auto", "none", the name of the
    bare metal that the whole object is of (docs/station-file.md), or its refractive index, n + k i or (n, k).

    The surface's `confidence` ({"level": "high" | "partial" | "low", "reasons": [...]}) says how far it may be trusted, by
    refinement and comparison with the prior; the functions of malus.evidence say whether prior and images fit each other.
    `status` says how the solver ended, and `warnings` lists its warnings.
    """
    name, labels = as_reflection(reflection, state.degree.shape)
    return _core.refine(
        state, prior, refractive_index, name, labels, as_metal(metal), (options or Options()).to_json(), threads
    )

"""From depth maps to normals and meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image
from malus._core import FusedSurface, Pinhole
from malus.options import Options


@dataclass(frozen=True)
class Mesh:
    """vertices N×3 (world frame), normals N×3, colors N×3 uint8 (N = 0 without), triangles M×3 (counter-clockwise)."""

    vertices: NDArray[np.float64]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8]
    triangles: NDArray[np.uint32]


def normals_from_depth(depth: ArrayLike, camera: Pinhole, *, threads: int = 1) -> NDArray[np.float32]:
    """Unit normals (H×W×3, camera frame, towards the camera) of a z-depth map (H×W, NaN = none)."""
    return _core.normals_from_depth(as_image(depth, "depth"), camera, threads)


def mesh_from_depth(
    surface: FusedSurface, *, color: ArrayLike | None = None, options: Options | None = None, threads: int = 1
) -> Mesh:
    """Triangulate a fused surface, cut at depth discontinuities; color: H×W linear intensity for the vertices."""
    intensity = None if color is None else as_image(color, "color")
    return Mesh(**_core.mesh_from_depth(surface, intensity, (options or Options()).to_json(), threads))

"""From depth maps to normals and meshes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_rows, as_triangles
from malus._core import FusedSurface
from malus._files import require_utf8
from malus.camera import Camera, as_view
from malus.options import Options
from malus.threads import ALL_CORES


@dataclass(frozen=True)
class Mesh:
    """vertices N×3 (world frame), normals N×3, colors N×3 uint8 (0×3 if there are none), triangles M×3 (counter-clockwise)."""

    vertices: NDArray[np.float64]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8]
    triangles: NDArray[np.uint32]


@dataclass(frozen=True)
class Dem:
    """Elevation above the plane fitted to a surface.

    elevation: H×W float32, station unit, towards the camera, NaN = none. pixel: size of a pixel. The center of the top-left
    pixel lies at `origin` in the world; `right` and `up` (towards smaller rows) lie in the plane, `normal` points to the camera.
    """

    elevation: NDArray[np.float32]
    pixel: float
    origin: NDArray[np.float64]
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    normal: NDArray[np.float64]

    def points(self, rows: slice = slice(None)) -> NDArray[np.float64]:
        """World points of all pixels, or of those in some consecutive rows, H×W×3, NaN where there is no elevation."""
        elevation = self.elevation[rows].astype(np.float64)
        first, _, _ = rows.indices(len(self.elevation))
        down, across = np.meshgrid(*(np.arange(float(n)) for n in elevation.shape), indexing="ij")
        offset = np.multiply.outer(across, self.right) - np.multiply.outer(first + down, self.up)
        height = np.multiply.outer(elevation, self.normal)
        points: NDArray[np.float64] = self.origin + self.pixel * offset + height
        return points


def dem_from_mesh(
    mesh: Mesh, surface: FusedSurface, *, options: Options | None = None, threads: int = ALL_CORES
) -> Dem:
    """Elevation model of a surface's mesh above the plane fitted to it; pixel size: options.surface.dem_pixel."""
    vertices = as_rows(mesh.vertices, "vertices")
    triangles = as_triangles(mesh.triangles, "triangles", len(vertices))
    return Dem(**_core.dem_from_mesh(vertices, triangles, surface, (options or Options()).to_json(), threads))


def write_dem(path: str | Path, dem: Dem, *, unit: str, name: str) -> None:
    """Write an elevation model as GeoTIFF in a local coordinate system (x right, y up, in `unit`, e.g. "mm"); NaN = no data."""
    require_utf8(path)
    elevation = as_image(dem.elevation, "elevation")
    _core.write_dem(str(path), elevation, dem.pixel, dem.origin, dem.right, dem.up, dem.normal, unit, name)


def normals_from_depth(depth: ArrayLike, camera: Camera, *, threads: int = ALL_CORES) -> NDArray[np.float32]:
    """Unit normals (H×W×3, camera frame, towards the camera) of a z-depth map (H×W, NaN = none); ValueError if it is not of the camera's
    size.
    """
    return _core.normals_from_depth(as_view(depth, "depth", camera), camera, threads)


def mesh_from_depth(
    surface: FusedSurface, *, color: ArrayLike | None = None, options: Options | None = None, threads: int = ALL_CORES
) -> Mesh:
    """Triangulate a fused surface, cut at depth discontinuities; color: H×W or H×W×3, linear, gives the vertex colors."""
    intensity = None if color is None else as_image(color, "color", 3 if np.ndim(color) == 3 else 1)
    return Mesh(**_core.mesh_from_depth(surface, intensity, (options or Options()).to_json(), threads))

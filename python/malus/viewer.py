"""Data of the report's interactive views, packed small enough for one page: normal maps, colors, a mesh.

Numbers are stored as base64 of Deflate. Whole numbers of 16 or 32 bits are stored as differences to the previous value, all lowest bytes
first, then all next ones: smooth data shrink to about one byte per value. assets/unpack.js unpacks them.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.albedo import diffuse_albedo
from malus.errors import DataError
from malus.pages import base64_text
from malus.pictures import encode
from malus.raster import reduced, step_for
from malus.surface import Mesh, mesh_from_depth, normals_from_depth
from malus.units import METERS
from malus.workspace import Raster, Workspace

#: Longest side of the relighting viewer's normal map: larger stations are averaged down, so that the page stays small.
NORMALS_SIDE_PX = 2048
#: Approximate largest number of triangles of the mesh in the page.
MESH_TRIANGLES = 80000
#: Whole number that stands for 1 in a component of a normal; one of 4096 steps is 0.03 degrees.
_NORMAL_SCALE = 2047
_QUALITY = 88
_MIDDLE_GRAY = 0.42


def pack(values: NDArray[Any], bits: int = 16) -> str:
    """Whole numbers that fit into so many bits (signed or unsigned), as differences modulo 2^bits, in base64 of Deflate."""
    numbers = values.ravel().astype(np.int64)
    steps = numbers - np.concatenate([[0], numbers[:-1]])
    planes = np.concatenate([((steps >> shift) & 0xFF).astype(np.uint8) for shift in range(0, bits, 8)])
    return base64_text(zlib.compress(planes.tobytes(), 6))


@dataclass(frozen=True)
class _Window:
    """The part of the rasters that contains the object, and the size of the blocks over which it is averaged."""

    rows: slice
    columns: slice
    step: int

    def of(self, raster: Raster) -> Raster:
        return reduced(raster[self.rows, self.columns], self.step)


def object_window(depth: Raster, side_px: int) -> _Window:
    """The part of the rasters that contains the object, averaged so that no side has more than `side_px` pixels."""
    known = np.isfinite(depth)
    (top, *_, bottom), (left, *_, right) = (np.nonzero(known.any(axis))[0].tolist() for axis in (1, 0))
    step = step_for((bottom + 1 - top, right + 1 - left), side_px)
    return _Window(slice(top, bottom + 1), slice(left, right + 1), step)


def viewer_normals(normals: Raster, window: _Window) -> NDArray[np.float64]:
    """Unit normals of the window in the viewer's frame (x right, y up, z to the viewer), NaN where there are none."""
    mean = np.stack([window.of(normals[..., c]) for c in range(3)], -1).astype(float) * (1, -1, -1)
    return np.asarray(mean / np.linalg.norm(mean, axis=-1, keepdims=True), dtype=np.float64)


def _packed_normals(normals: NDArray[np.float64]) -> str:
    whole = np.rint(np.nan_to_num(normals[..., :2]) * _NORMAL_SCALE).astype(np.int16)
    return pack(np.moveaxis(whole, -1, 0))


def unshaded_color(
    workspace: Workspace, window: _Window, normals: NDArray[np.float64], mirrored: Raster | None = None
) -> NDArray[np.uint8]:
    """The object's color in the window without its shading, sRGB; normals as `viewer_normals` gives them.

    mirrored: H×W, share of the light that was mirrored at the surface, which is removed; without it the function is faster.
    """
    image = workspace.color()
    channels = [image[..., c] for c in range(3)] if image.ndim == 3 else [image] * 3
    picture = np.nan_to_num(np.stack([window.of(channel) for channel in channels], -1).astype(float))
    flat = np.where(np.isfinite(normals).all(-1), 1.0, np.nan).astype(np.float32)
    share = None if mirrored is None else window.of(mirrored)
    color = diffuse_albedo(picture, normals * (1, -1, -1), mirrored=share)
    return _core.display_image(np.nan_to_num(color), flat, 99.0)


def relighting(workspace: Workspace) -> dict[str, Any]:
    """Data of the relighting viewer: size, packed normals of both surfaces, color with the object's mask as alpha, median slopes."""
    depth = workspace.raster("fused/depth.tif")
    window = object_window(depth, NORMALS_SIDE_PX)
    fused = viewer_normals(workspace.raster("fused/normals.tif"), window)
    prior_depth = workspace.raster("prior/depth.tif")
    prior = viewer_normals(normals_from_depth(prior_depth, workspace.camera), window)
    known = np.isfinite(fused).all(-1)
    height, width = known.shape
    display = unshaded_color(workspace, window, fused)
    mask = np.where(known, 255, 0).astype(np.uint8)
    linear = (display[known].mean(-1) / 255) ** 2.2
    slopes = fused[known][:, :2] / np.maximum(fused[known][:, 2:], 0.05)
    return {
        "width": width,
        "height": height,
        "step": window.step,
        "scale": _NORMAL_SCALE,
        # Factor that makes the median of the object mid-gray under the first light.
        "brightness": float(np.clip(_MIDDLE_GRAY / max(float(np.median(linear)), 1e-3), 0.3, 3)),
        "median_slope": [float(x) for x in np.median(slopes, axis=0)],
        "fused": _packed_normals(fused),
        "prior": _packed_normals(prior),
        "color": base64_text(encode(np.dstack([display, mask]), "WEBP", quality=_QUALITY)),
        "gsd": float(workspace.quality["gsd"]) * window.step,
        "meters": METERS[workspace.quality["unit"]],
    }


def _page_mesh(workspace: Workspace) -> Mesh:
    """The surface with a vertex at every n-th pixel, about MESH_TRIANGLES triangles; with more of them if the object's parts are thinner
    than n pixels.
    """
    surface, options = workspace.surface(), workspace.options()
    factor = np.ceil(np.sqrt(2 * np.isfinite(surface.depth).sum() / MESH_TRIANGLES))
    options.surface.subsample = int(np.clip(factor, 1, 64))
    while True:
        try:
            return mesh_from_depth(surface, options=options)
        except DataError:  # No cell of this size lies on the surface.
            if options.surface.subsample == 1:
                raise
            options.surface.subsample //= 2


def mesh_view(workspace: Workspace) -> dict[str, Any]:
    """Data of the mesh viewer: packed vertices as the station sees them (x right, y up), texture coordinates, triangles."""
    mesh = _page_mesh(workspace)
    rotation, translation = workspace.pose
    in_camera = mesh.vertices @ rotation.T + translation
    camera = workspace.camera
    u = camera.fx * in_camera[:, 0] / in_camera[:, 2] + camera.cx
    v = camera.fy * in_camera[:, 1] / in_camera[:, 2] + camera.cy
    window = object_window(workspace.raster("fused/depth.tif"), NORMALS_SIDE_PX)
    # The texture is the color image of the relighting viewer, which covers the object's window of the pixel grid.
    width = -(-(window.columns.stop - window.columns.start) // window.step) * window.step
    height = -(-(window.rows.stop - window.rows.start) // window.step) * window.step
    uv = np.stack([(u - window.columns.start + 0.5) / width, (v - window.rows.start + 0.5) / height])
    view = in_camera * (1, -1, -1)
    low, high = view.min(0), view.max(0)
    size = float((high - low).max())
    whole = np.rint((view - low) / size * 65535).astype(np.uint16)
    return {
        "vertices": len(view),
        "triangles": len(mesh.triangles),
        "positions": pack(whole.T),
        "uv": pack(np.rint(np.clip(uv, 0, 1) * 65535).astype(np.uint16)),
        "indices": pack(mesh.triangles, 32),
        "size": size,
        "unit": str(workspace.quality["unit"]),
        "meters": METERS[workspace.quality["unit"]],
        # Position of the station's camera in the frame of the mesh, whose origin is the middle of the mesh.
        "eye": [float(x) for x in -(low + high) / 2],
        "extent": [float(x) for x in high - low],
    }

"""The object under any light direction, for RTI viewers: a polynomial texture map (PTM 1.2, Malzbender, Gelb and Wolters 2001).

RTIViewer and Relight read it. It is computed from the measured normals and the color without shading, not from photographs under many
lights: it shows a matte object under a light from any direction, without cast shadows.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus import _core
from malus._files import new_folder, replacing, write_text
from malus.units import METERS
from malus.viewer import object_window, unshaded_color, viewer_normals
from malus.workspace import Workspace
from malus.xmp import save_png, tag_png

#: Longest side of the map in pixels: viewers of PTM files do not open more.
_SIDE_PX = 8192
_QUALITY = 95


def basis(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The six terms of a PTM for directions to the light (N×3: x right, y up, z to the viewer), N×6."""
    u, v = directions[:, 0], directions[:, 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], -1)


def _hemisphere(count: int) -> NDArray[np.float64]:
    """Directions to lights, spread evenly over the hemisphere from 10 degrees above the object's plane (a Fibonacci spiral)."""
    k = np.arange(count) + 0.5
    z = 1 - k / count * (1 - np.sin(np.radians(10)))
    angle = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def polynomial(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients (N×6) of the brightness max(0, n · l) of matte surfaces with these unit normals (N×3).

    The polynomial is fitted to all lights, including those behind the surface, where the brightness is 0.
    """
    lights = _hemisphere(120)
    inverse = np.linalg.pinv(basis(lights))
    return np.asarray(np.maximum(normals @ lights.T, 0) @ inverse.T, dtype=np.float64)


def normal_levels(normals: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Components of unit vectors as 16 bits: 0 … 65535 for −1 … 1."""
    return np.asarray(np.rint((normals + 1) / 2 * 65535), dtype=np.uint16)


def write_ptm(path: Path, coefficients: NDArray[np.float64], colors: NDArray[np.uint8]) -> None:
    """Write an LRGB polynomial texture map: coefficients H×W×6 (brightness 1 = the color itself), colors H×W×3."""
    height, width = colors.shape[:2]
    low, high = coefficients.min((0, 1)), coefficients.max((0, 1))
    scale = np.maximum(high - low, 1e-6) / 255
    bias = np.clip(np.rint(-low / scale), -32768, 32767).astype(int)
    # The format stores brightness 1 as 256.
    header = (
        f"PTM_1.2\nPTM_FORMAT_LRGB\n{width}\n{height}\n"
        f"{' '.join(f'{256 * value:.9g}' for value in scale)}\n{' '.join(str(value) for value in bias)}\n"
    )
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(header.encode())
        # The format stores rows from the bottom up.
        for row in coefficients[::-1]:
            file.write(np.clip(np.rint(row / scale + bias), 0, 255).astype(np.uint8).tobytes())
        file.write(colors[::-1].tobytes())


@dataclass(frozen=True)
class Relightable:
    """An object in the station's view: normals (H×W×3, x right, y up, z to the viewer, NaN = none), colors without shading (H×W×3) and
    PTM coefficients (H×W×6). step: side of one of these pixels in pixels of the station. without_highlights: whether highlights were
    removed from the colors.
    """

    normals: NDArray[np.float64]
    colors: NDArray[np.uint8]
    coefficients: NDArray[np.float64]
    step: int
    without_highlights: bool


def relightable(workspace: Workspace) -> Relightable:
    """The fused surface of a workspace with its PTM coefficients."""
    window = object_window(workspace.raster("fused/depth.tif"), _SIDE_PX)
    normals = viewer_normals(workspace.raster("fused/normals.tif"), window)
    mirrored = workspace.mirrored_share()
    colors = unshaded_color(workspace, window, normals, mirrored).copy()
    known: NDArray[np.bool_] = np.asarray(np.isfinite(normals).all(-1))
    colors[~known] = 0
    coefficients = np.zeros((*known.shape, 6))
    for row, inside in enumerate(known):  # a row at a time: 120 lights for every pixel would not fit into memory
        if inside.any():
            coefficients[row, inside] = polynomial(normals[row, inside])
    return Relightable(normals, colors, coefficients, window.step, mirrored is not None)


def write_rti(workspace: Workspace, path: Path) -> None:
    """Write the fused surface of a workspace as a polynomial texture map in the station's view."""
    found = relightable(workspace)
    write_ptm(path, found.coefficients, found.colors)


def write_relight(workspace: Workspace, folder: Path, said: dict[str, str], xmp: str) -> Path:
    """Write the polynomial texture map for OpenLIME and RelightLab: info.json with planes of coefficients as JPEG, and the layers
    normals.png and albedo.png. Without a reflection model highlights stay in the colors; the layer is then called unshaded.png.

    The planes: color, then the coefficients of 1, u, v and of u², uv, v²; a value is (level − bias) · scale with levels 0 … 1.
    `said` (the statements about the surface) is stored in info.json under "about", which viewers ignore, and `xmp` in the layers.
    InputError if the folder exists already.
    """
    found = relightable(workspace)
    # The coefficients here are of u², v², uv, u, v, 1, in this order.
    order = [5, 3, 4, 0, 2, 1]
    low, high = (limit[order] for limit in (found.coefficients.min((0, 1)), found.coefficients.max((0, 1))))
    scale = np.maximum(high - low, 1e-6)
    # A row at a time, because copies of all coefficients would need many times the memory of the planes.
    levels = np.stack([np.rint(255 * (row[:, order] - low) / scale).astype(np.uint8) for row in found.coefficients])
    height, width = found.colors.shape[:2]
    millimeters = workspace.quality["gsd"] * found.step * METERS[str(workspace.quality["unit"])] * 1000
    info = {
        "width": width,
        "height": height,
        "format": "jpg",
        "type": "ptm",
        "colorspace": "lrgb",
        "nplanes": 9,
        "quality": _QUALITY,
        "pixelSizeInMM": millimeters,
        "about": said,
        "materials": [{"scale": [1, 1, 1, *scale.tolist()], "bias": [0, 0, 0, *(-low / scale).tolist()]}],
    }
    # Outside of the object the normal faces the viewer, as in a normal map: one of length 0 has no direction.
    shown = np.where(np.isfinite(found.normals).all(-1, keepdims=True), found.normals, (0.0, 0.0, 1.0))
    with new_folder(folder) as new:
        for k, plane in enumerate((found.colors, levels[..., :3], levels[..., 3:])):
            # No chroma subsampling: the channels of the planes are coefficients.
            Image.fromarray(np.ascontiguousarray(plane)).save(new / f"plane_{k}.jpg", quality=_QUALITY, subsampling=0)
        # 16 bits, because 8 bits would round directions to half a degree. No color profile, because normals are not colors.
        _core.write_png16(str(new / "normals.png"), normal_levels(shown))
        tag_png(new / "normals.png", xmp)
        save_png(new / ("albedo.png" if found.without_highlights else "unshaded.png"), found.colors, xmp)
        write_text(new / "info.json", json.dumps(info, indent=1) + "\n")
    return folder

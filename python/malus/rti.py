"""The object under any light for RTI viewers: a polynomial texture map (PTM 1.2, Malzbender, Gelb and Wolters 2001).

RTIViewer and Relight read it. It is made of the measured normals and the color without shading, not of photographs under many lights:
a matt object under a light from each direction, without cast shadows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus._files import replacing
from malus.mirrored_light import mirrored_share
from malus.viewer import object_window, unshaded_color, viewer_normals
from malus.workspace import Workspace

#: More than viewers of PTM files open.
_SIDE_PX = 8192


def basis(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The six terms of a PTM for directions to the light (N×3: x right, y up, z to the viewer), N×6."""
    u, v = directions[:, 0], directions[:, 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], -1)


def _hemisphere(count: int) -> NDArray[np.float64]:
    """Directions to lights spread evenly above 10 degrees over the object's plane (a Fibonacci spiral)."""
    k = np.arange(count) + 0.5
    z = 1 - k / count * (1 - np.sin(np.radians(10)))
    angle = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def polynomial(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients (N×6) of the brightness max(0, n · l) of matt surfaces with these unit normals (N×3).

    Lights that a steep surface turns away from bend the polynomial; it is fitted to all of them.
    """
    lights = _hemisphere(120)
    inverse = np.linalg.pinv(basis(lights))
    return np.asarray(np.maximum(normals @ lights.T, 0) @ inverse.T, dtype=np.float64)


def write_ptm(path: Path, coefficients: NDArray[np.float64], colors: NDArray[np.uint8]) -> None:
    """Write an LRGB polynomial texture map: coefficients H×W×6 (brightness 1 = the color itself), colors H×W×3."""
    height, width = colors.shape[:2]
    low, high = coefficients.min((0, 1)), coefficients.max((0, 1))
    scale = np.maximum(high - low, 1e-6) / 255
    bias = np.clip(np.rint(-low / scale), -32768, 32767).astype(int)
    # Brightness 1 is 256 by the format.
    stored = np.clip(np.rint(coefficients / scale + bias), 0, 255).astype(np.uint8)
    header = (
        f"PTM_1.2\nPTM_FORMAT_LRGB\n{width}\n{height}\n"
        f"{' '.join(f'{256 * value:.9g}' for value in scale)}\n{' '.join(str(value) for value in bias)}\n"
    )
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(header.encode())
        # Rows from the bottom up.
        file.write(stored[::-1].tobytes())
        file.write(colors[::-1].tobytes())


def write_rti(workspace: Workspace, path: Path) -> None:
    """Write the fused surface of a workspace as a polynomial texture map in the station's view."""
    window = object_window(workspace.raster("fused/depth.tif"), _SIDE_PX)
    normals = viewer_normals(workspace.raster("fused/normals.tif"), window)
    colors = unshaded_color(workspace, window, normals, mirrored_share(workspace)).copy()
    known: NDArray[np.bool_] = np.asarray(np.isfinite(normals).all(-1))
    colors[~known] = 0
    coefficients = np.zeros((*known.shape, 6))
    for row, inside in enumerate(known):  # a row at a time: 120 lights for every pixel would not fit into memory
        if inside.any():
            coefficients[row, inside] = polynomial(normals[row, inside])
    write_ptm(path, coefficients, colors)

"""Functions that several benchmarks share: files of rendered stations, and the low pass that defines detail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import recfunctions
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Cloud = NDArray[Any]  # structured: a field for each property of the file

# Definitions of rendered/score.py.
BORDER_PX, DETAIL_SIGMA_PX = 6, 8.0


def read_cloud(path: Path) -> Cloud:
    """Vertices of a binary little-endian PLY file of scalar properties, as the renderer writes it."""
    types = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    content = path.read_bytes()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    header = [line.split() for line in content[:end].decode("ascii").splitlines()]
    names = [(words[2], types[words[1]]) for words in header if words[0] == "property"]
    count = next(int(words[2]) for words in header if words[:2] == ["element", "vertex"])
    return np.frombuffer(content, names, count, end).copy()


def write_cloud(path: Path, cloud: Cloud) -> None:
    types = {"f4": "float", "f8": "double", "u1": "uchar"}
    properties = [f"property {types[cloud.dtype[name].str[1:]]} {name}" for name in cloud.dtype.names or ()]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}", *properties, "end_header", ""]
    path.write_bytes("\n".join(lines).encode("ascii") + cloud.tobytes())


def vectors(cloud: Cloud, names: tuple[str, str, str]) -> Array:
    """Three fields of a cloud as N×3."""
    return recfunctions.structured_to_unstructured(cloud[list(names)]).astype(float)


def with_vectors(cloud: Cloud, names: tuple[str, str, str], values: Array) -> Cloud:
    """The cloud with N×3 values in three of its fields."""
    out = cloud.copy()
    for column, name in enumerate(names):
        out[name] = values[:, column]
    return np.asarray(out)


def toml_text(tables: dict[str, dict[str, Any]]) -> str:
    """TOML of tables whose values are numbers, texts and lists of these, written as in JSON."""
    lines = []
    for table, values in tables.items():
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items()), ""]
    return "\n".join(lines)


def lowpass(values: Array, mask: Mask) -> Array:
    """Gaussian-weighted mean of the mask's pixels about each pixel; the values minus this mean are detail."""
    weight = ndimage.gaussian_filter(mask.astype(float), DETAIL_SIGMA_PX)
    smooth = ndimage.gaussian_filter(np.where(mask, values, 0.0), DETAIL_SIGMA_PX)
    return np.asarray(smooth / np.maximum(weight, 1e-6))

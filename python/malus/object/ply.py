"""Binary PLY with any vertex properties, for clouds to mesh and for meshes with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus._files import replacing
from malus.errors import ExternalError

_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_ply(
    path: Path, vertices: Mapping[str, NDArray[np.generic]], triangles: NDArray[np.integer] | None, comment: str
) -> None:
    """Write a cloud, or a mesh with triangles M×3. vertices: N values by property (float32, float64, uint8 or int32)."""
    kinds = [(name, values.dtype.newbyteorder("<")) for name, values in vertices.items()]
    table = np.empty(len(next(iter(vertices.values()))), np.dtype(kinds))
    for name, values in vertices.items():
        table[name] = values
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(table)}"]
    lines += [f"property {_TYPES[kind.str[1:]]} {name}" for name, kind in kinds]
    if triangles is not None:
        lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        table.tofile(file)
        if triangles is not None:
            faces = np.empty(len(triangles), _FACE)
            faces["count"], faces["corners"] = 3, triangles
            faces.tofile(file)


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (N×3) and triangles (M×3) of a binary PLY as COLMAP writes it; ExternalError if it is not one."""
    content = path.read_bytes()
    head, _, body = content.partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line[:1] == ["element"] and len(line) == 3}
    of_vertex = [line[1:] for line in lines[: _index(lines, "face")] if line[:1] == ["property"]]
    names = {"float": "<f4", "double": "<f8", "uchar": "u1", "uint8": "u1", "float32": "<f4"}
    try:
        kind = np.dtype([(name, names[type_]) for type_, name in of_vertex])
        vertices = np.frombuffer(body, kind, counts["vertex"])
        faces = np.frombuffer(body, _FACE, counts["face"], counts["vertex"] * kind.itemsize)
        points = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], 1)
    except (KeyError, ValueError) as error:
        raise ExternalError(f"{path}: is not the mesh that COLMAP writes ({error})") from None
    return points, faces["corners"].astype(np.int64)


def _index(lines: list[list[str]], element: str) -> int:
    return next((k for k, line in enumerate(lines) if line[:2] == ["element", element]), len(lines))

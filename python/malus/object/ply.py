"""Binary PLY with any vertex properties, for clouds to mesh and for meshes with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import replacing
from malus.errors import ExternalError
from malus.object.arrays import chunks

_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


Properties = dict[str, tuple[NDArray[Any], str]]


def columns(names: Iterable[str], values: NDArray[Any], kind: str) -> Properties:
    """A property of this type for each column of the values (N×K), as `write_ply` takes them."""
    return {name: (values[:, k], kind) for k, name in enumerate(names)}


def write_ply(
    path: Path, vertices: Mapping[str, tuple[NDArray[Any], str]], triangles: NDArray[np.integer] | None, *comments: str
) -> None:
    """Write a cloud, or a mesh with triangles M×3. vertices: for each property N values and their type: f4, f8, u1 or i4.

    Rows are written in chunks, so that arrays on disk need no memory.
    """
    kind = np.dtype([(name, "<" + type_) for name, (_, type_) in vertices.items()])
    count = len(next(iter(vertices.values()))[0])
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {count}",
    ]
    lines += [f"property {_TYPES[type_]} {name}" for name, (_, type_) in vertices.items()]
    if triangles is not None:
        lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        for rows in chunks(count):
            table = np.empty(rows.stop - rows.start, kind)
            for name, (values, _) in vertices.items():
                table[name] = values[rows]
            table.tofile(file)
        for rows in chunks(0 if triangles is None else len(triangles)):
            faces = np.empty(rows.stop - rows.start, _FACE)
            faces["count"], faces["corners"] = 3, triangles[rows] if triangles is not None else 0
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

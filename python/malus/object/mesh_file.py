"""mesh.ply of an object: the full mesh with sigma and colors, and which stations see each part of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus.object.arrays import GrowingArray, chunks
from malus.object.color import Paint
from malus.object.meshing import ObjectMesh
from malus.object.ply import columns, write_ply
from malus.object.views import Floats, View, may_see, sees


@dataclass(frozen=True)
class Coverage:
    """Shares of the surface that each station sees, and that no other station sees. stations: how many see each vertex, at most 255."""

    seen: Floats
    alone: Floats
    stations: NDArray[np.uint8]


def coverage_of(mesh: ObjectMesh, views: Sequence[View], scratch: Path) -> Coverage:
    """What the stations see of the mesh."""
    stations = GrowingArray(scratch / "stations", np.uint8)
    seen, alone = np.zeros(len(views)), np.zeros(len(views))
    total = 0.0
    for rows in chunks(len(mesh.vertices)):
        points, normals = mesh.vertices[rows], mesh.normals[rows]
        by = np.zeros((len(views), len(points)), bool)
        for k in may_see(views, points):
            by[k] = sees(views[k], points, normals)
        stations.add(np.minimum(by.sum(0), 255))  # a byte in the file
        share = mesh.shares(rows)
        seen += by @ share
        alone += (by & (by.sum(0) == 1)) @ share
        total += float(share.sum())
    return Coverage(seen / total, alone / total, stations.array())


def needs_double(vertices: Floats, gsd: float) -> bool:
    """Whether rounding to single precision could move a vertex by more than a thousandth of a GSD."""
    farthest = max(-vertices.min(), vertices.max())
    return bool(farthest * np.finfo(np.float32).eps / 2 > 1e-3 * gsd)


def write_mesh(
    path: Path,
    mesh: ObjectMesh,
    gsd: float,
    paint: Paint,
    stations: NDArray[np.uint8],
    said: Mapping[str, str],
    scratch: Path,
) -> None:
    """Write the mesh as PLY, with `said` as comments. stations: how many see each vertex."""
    colors = GrowingArray(scratch / "colors", np.uint8, 3)
    for rows in chunks(len(mesh.vertices)):
        colors.add(paint.srgb(mesh.vertices[rows], mesh.normals[rows]))
    values = columns("xyz", mesh.vertices, "f8" if needs_double(mesh.vertices, gsd) else "f4")
    values |= columns(("nx", "ny", "nz"), mesh.normals, "f4")
    values |= columns(("red", "green", "blue"), colors.array(), "u1")
    values |= {"sigma": (mesh.sigma, "f4"), "measured": (mesh.measured, "u1"), "stations": (stations, "u1")}
    write_ply(path, values, mesh.triangles, *(f"{key}: {words}" for key, words in said.items()))

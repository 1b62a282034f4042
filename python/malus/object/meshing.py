"""A closed mesh of oriented points, by COLMAP's screened Poisson reconstruction; parts that no points support are marked."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus.errors import DataError
from malus.object.agreement import OrientedPoints
from malus.object.arrays import chunks
from malus.object.ply import columns, read_mesh, write_ply
from malus.object.views import Bools, Floats, scipy, unit
from malus.photogrammetry.program import Colmap

#: Depth of the octree; memory grows fourfold with each level.
_LEAST_DEPTH, _MOST_DEPTH = 6, 13
#: Weight of the points' positions relative to their normals (Kazhdan and Hoppe 2013).
_POINT_WEIGHT = 4.0
#: A vertex counts as measured if a point lies within this many times the local spacing of the points.
_REACH = 2.0
_SPACING_NEIGHBOR = 2
#: Connected parts with a smaller share of the triangles are dropped.
LEAST_PART = 0.005
#: Most triangles of a mesh that is simplified as a whole.
MOST_TO_SIMPLIFY = 4_000_000


@dataclass(frozen=True)
class ObjectMesh:
    """vertices, normals: N×3, world, station unit. triangles: M×3, counter-clockwise from outside. sigma: N, one standard
    deviation across the surface. measured: N, whether points support the vertex; elsewhere the surface is a guess that closes the mesh.
    level: N, how often the lattice's cells were halved where the vertex is; None if nowhere. areas: N, area of the surface that each
    vertex stands for, up to a factor; None if the level alone determines it, as it does unless parts of the mesh are guessed.
    """

    vertices: Floats
    normals: Floats
    triangles: NDArray[np.int64]
    sigma: Floats
    measured: Bools
    level: NDArray[np.uint8] | None = None
    areas: Floats | None = None

    def shares(self, rows: slice) -> Floats:
        """Weights of these vertices in shares of the surface: smaller where the mesh is finer, so that there are more of them."""
        return self._cells(rows) if self.areas is None else self.areas[rows]

    def _cells(self, rows: slice) -> Floats:
        """Size of the lattice's cells about these vertices, on the surface, in cells that are not halved."""
        return np.ones(len(self.sigma[rows])) if self.level is None else 0.25 ** self.level[rows].astype(np.float64)

    def measured_fraction(self) -> float:
        """Share of the surface that is measured."""
        measured = total = 0.0
        for rows in chunks(len(self.vertices)):
            share = self.shares(rows)
            measured += float(share @ self.measured[rows])
            total += float(share.sum())
        return measured / total

    def even(self) -> Bools:
        """Which vertices (N) to take for medians, so that all of the measured surface counts alike: all of them, but a random choice
        where the lattice is finer.
        """
        random = np.random.default_rng(0)
        parts = [random.random(len(size)) < size for size in map(self._cells, chunks(len(self.vertices)))]
        return np.concatenate([np.empty(0, bool), *parts])


def poisson_mesh(points: OrientedPoints, gsd: float, folder: Path, colmap: Colmap, halved: int = 0) -> ObjectMesh:
    """Closed mesh of oriented points; `folder` keeps COLMAP's log.

    Cells have the side of the GSD halved `halved` times, except for objects larger than 8000 cells; where points are sparser, they are
    larger. Raises DataError if there is no surface.
    """
    if len(points.points) < 100:
        raise DataError(f"{len(points.points)} points of the stations agree, expected at least 100")
    middle = points.points.mean(0)  # Relative to the middle, single precision suffices.
    local = (points.points - middle).astype(np.float32)
    cells = _cells_across(local, gsd) * 2**halved
    depth = int(np.clip(math.ceil(math.log2(cells)), _LEAST_DEPTH, _MOST_DEPTH))
    properties = columns("xyz", local, "f4") | columns(("nx", "ny", "nz"), points.normals, "f4")
    gray = (np.zeros(len(local), np.uint8), "u1")  # COLMAP 3.8 wants colors.
    folder.mkdir(parents=True, exist_ok=True)
    # COLMAP keeps large files of its own in its folder. What a killed run leaves there is removed with the folder (run.py).
    with tempfile.TemporaryDirectory(prefix=".mesh-", dir=folder) as temporary:
        scratch = Path(temporary).resolve()
        cloud, raw = scratch / "points.ply", scratch / "poisson.ply"
        write_ply(cloud, {**properties, "red": gray, "green": gray, "blue": gray}, None, "points of the object")
        colmap.run(
            "poisson_mesher",
            {
                "input_path": cloud, "output_path": raw, "PoissonMeshing.depth": depth, "PoissonMeshing.trim": 0,
                "PoissonMeshing.point_weight": _POINT_WEIGHT, "PoissonMeshing.num_threads": colmap.threads,
            },
            folder / "poisson.log",
            working_folder=scratch,
        )  # fmt: skip
        vertices, triangles = read_mesh(raw)
    # COLMAP leaves a few vertices that are NaN; the holes without them are closed below.
    numbers = np.asarray(np.isfinite(vertices).all(axis=1))
    triangles = triangles[numbers[triangles].all(1)]
    vertices, triangles = closed_up(*without_crumbs(vertices + middle, triangles))
    if not len(triangles):
        raise DataError("Poisson reconstruction found no surface in the points that stations agree on")
    return _with_uncertainty(vertices, triangles, points, gsd)


def closed_surface(mesh: ObjectMesh, gsd: float, folder: Path, colmap: Colmap) -> ObjectMesh:
    """A closed mesh from an open one: the same surface where `mesh` has one, and a guess, marked as such, over its holes.

    `folder` keeps COLMAP's log. Raises what `poisson_mesh` raises.
    """
    points = OrientedPoints(mesh.vertices, mesh.normals, mesh.sigma, np.ones(len(mesh.vertices), np.int64))
    halved = 0 if mesh.level is None else int(mesh.level.max())
    closed = poisson_mesh(points, gsd, folder, colmap, halved)
    # The octree of a large object ends at larger cells.
    finest = min(halved, max(0, round(_MOST_DEPTH - math.log2(_cells_across(mesh.vertices, gsd)))))
    if mesh.level is None or finest == 0:
        return closed
    # Cells of Poisson's octree go down to half of the points' spacing.
    nearest = scipy("spatial").cKDTree(mesh.vertices).query(closed.vertices, workers=1)[1]
    return replace(closed, level=np.minimum(mesh.level[nearest] + 1, finest).astype(np.uint8))


def _cells_across(points: NDArray[np.floating], gsd: float) -> float:
    """Side of the octree about the points, in cells of one GSD."""
    return 1.1 * float(np.ptp(points, axis=0).max()) / gsd


def _with_uncertainty(vertices: Floats, triangles: NDArray[np.int64], points: OrientedPoints, gsd: float) -> ObjectMesh:
    """The mesh with sigma and normals of the nearest points; where no point is near, sigma grows with the distance."""
    tree = scipy("spatial").cKDTree(points.points)
    spacing = tree.query(points.points, _SPACING_NEIGHBOR + 1, workers=1)[0][:, -1]
    away, near = tree.query(vertices, 4, workers=1)
    share = 1 / (away**2 + (0.1 * gsd) ** 2)
    share /= share.sum(1, keepdims=True)
    sigma = (share * points.sigma[near]).sum(1)
    measured = away[:, 0] < np.maximum(_REACH * spacing[near[:, 0]], 2 * gsd)
    faces = face_normals(vertices, triangles)
    normals = unit(sums_at_vertices(triangles, faces, len(vertices)))
    areas = sums_at_vertices(triangles, np.linalg.norm(faces, axis=1), len(vertices))
    fine = (share[..., None] * points.normals[near]).sum(1)
    length = np.linalg.norm(fine, axis=1)
    agree = measured & (length > 0.5) & ((fine * normals).sum(1) > 0.5 * length)
    normals = np.where(agree[:, None], fine / np.maximum(length, 0.5)[:, None], normals)
    sigma = np.where(measured, sigma, np.hypot(sigma, away[:, 0]))
    return ObjectMesh(vertices, normals, triangles, sigma, measured, areas=areas)


def face_normals(vertices: Floats, triangles: NDArray[np.integer]) -> Floats:
    """Normals of the triangles (M×3), with twice the areas as lengths."""
    corners = vertices[triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def sums_at_vertices(triangles: NDArray[np.integer], values: Floats, count: int) -> Floats:
    """For each of `count` vertices the sum of the values (M or M×K) of the triangles about it."""
    if values.ndim == 1:
        return np.asarray(np.bincount(triangles.ravel(), np.repeat(values, 3), count), np.float64)
    return np.stack([sums_at_vertices(triangles, column, count) for column in values.T], 1)


def vertex_normals(vertices: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Unit normals: area-weighted means over the triangles about each vertex."""
    return unit(sums_at_vertices(triangles, face_normals(vertices, triangles), len(vertices)))


def without_crumbs(vertices: Floats, triangles: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """The mesh without small separate parts and without unused vertices."""
    piece = part_numbers(triangles, len(vertices))[triangles[:, 0]]
    size = np.bincount(piece)
    kept = triangles[size[piece] >= LEAST_PART * len(triangles)]
    used, renumbered = np.unique(kept, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)


def part_numbers(triangles: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """The number of the connected part of the mesh that each of `count` vertices belongs to."""
    # Two edges of a triangle connect its three vertices.
    return connected(np.concatenate([triangles[:, :2], triangles[:, 1:]]), count)


def edges_of(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The three edges of every triangle (3M×2), in the direction in which the triangle runs along them."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def connected(edges: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """The number of the connected part that each of `count` vertices belongs to."""
    links = scipy("sparse").coo_matrix((np.ones(len(edges), np.int8), tuple(edges.T)), shape=(count, count))
    return np.asarray(scipy("sparse.csgraph").connected_components(links, directed=False)[1], np.int64)


def closed_up(vertices: Floats, triangles: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """The mesh with every open border closed by a fan about its middle: without points, Poisson's surface leaves its bounding box."""
    count = len(vertices)
    edges = edges_of(triangles)
    there, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    border = edges[~np.isin(there, back)]
    if not len(border):
        return vertices, triangles
    loop = _loops(border)
    sums = np.stack([np.bincount(loop, vertices[border[:, 0], axis]) for axis in range(3)], 1)
    middles = sums / np.bincount(loop)[:, None]
    fans = np.stack([border[:, 1], border[:, 0], count + loop], 1)
    return np.concatenate([vertices, middles]), np.concatenate([triangles, fans])


def _loops(border: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of the loop that each edge (N×2, first and last vertex) of open borders belongs to. No loop passes a vertex twice: holes
    that touch at a vertex have a loop each.
    """
    starts, ends = border.T.tolist()
    onward: dict[int, list[int]] = {}
    for edge, start in enumerate(starts):
        onward.setdefault(start, []).append(edge)
    loop = np.empty(len(border), np.int64)
    count = 0
    for start in list(onward):
        path: list[int] = []
        at = {start: 0}  # of the vertices of the path: the edge with which it leaves them
        vertex = start
        while onward.get(vertex):
            path.append(onward[vertex].pop())
            vertex = ends[path[-1]]
            if vertex not in at:
                at[vertex] = len(path)
                continue
            around = path[at[vertex] :]
            for edge in around[1:]:
                del at[starts[edge]]
            del path[at[vertex] :]
            loop[around] = count
            count += 1
        if path:  # Where three triangles meet at an edge, a border need not be closed.
            loop[path] = count
            count += 1
    return loop

"""A surface through oriented points, block by block: where the weighted mean of the signed distances to their tangent planes is zero.

Each point has a tangent plane. The mean of a place's signed distances from the tangent planes of the points near it, with weights that
fall with the distance to the points, is its signed distance from the surface (implicit moving least squares: Kolluri 2008,
"Provably good moving least squares"). This mean is computed at the nodes of one lattice for the whole object; marching cubes runs on
blocks of the lattice. Nodes on the side between two blocks are computed from the same points in the same order, so that blocks meet
exactly. Where points have smaller pixels, the lattice is finer (`levels`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus.errors import DataError
from malus.object.agreement import OrientedPoints
from malus.object.arrays import chunks
from malus.object.joining import Piece
from malus.object.levels import FINEST, Cube, Levels, Place
from malus.object.meshing import ObjectMesh
from malus.object.views import Floats, scipy, unit
from malus.threads import ALL_CORES

Ints = NDArray[np.int64]

#: Cells along a block's side.
BLOCK_CELLS = 128
#: Radius of a point's weight function: this many cells, or this many times the spacing of its neighbors if that is more. Where a point's
#: pixels are larger or smaller than a cell, its own pixels count instead of cells, here and below.
_REACH_CELLS = 4.0
_REACH_SPACINGS = 1.8
_SPACING_NEIGHBOR = 6
#: The usual spacing of a cloud is measured at so many points, about.
_SAMPLE = 100_000
#: Largest radius of a weight function (cells): holes wider than this stay open.
MOST_REACH_CELLS = 6.0
#: Nodes with a smaller sum of weights are too far from the points to have a distance.
_LEAST_WEIGHT = 0.3
#: Margin about a block (cells): it holds the points whose weights reach into the block, and the neighbors that their radii depend on.
_BESIDE_CELLS = 10
#: Normal and standard deviation of a vertex are means over this many nearest points.
_NEIGHBORS = 4
#: Bits that identify a vertex on a side of a block: it lies on an edge of the finest lattice, which a node (x, y, z) and an axis name.
_NODE_BITS, _AXIS_BITS = 20, 2
#: A vertex nearer to a node than half of this share of an edge counts as lying on the node; _AT_NODE then takes the place of the axis.
_AT_NODE, _SHARE_AT_NODE = 3, 1 / 256


@dataclass(frozen=True)
class Lattice:
    """Nodes at origin + cell · (i, j, k), world; blocks of BLOCK_CELLS cells. beside: margin about a part of the lattice (cells) that
    holds the points that matter in it.
    """

    origin: Floats
    cell: float
    beside: float

    def indices(self, points: Floats) -> Floats:
        """Where points (N×3) lie, in cells."""
        return np.asarray((points - self.origin) / self.cell)


class PointBlocks:
    """Oriented points, sorted by block, or by part of a block if their scales differ."""

    def __init__(self, points: OrientedPoints, lattice: Lattice) -> None:
        self.lattice, self.levels = lattice, Levels(BLOCK_CELLS)
        self._side = BLOCK_CELLS if points.scale is None else self.levels.part
        number = np.empty(len(points.points), np.int64)
        for rows in chunks(len(number)):
            some = points.select(rows)
            at = lattice.indices(some.points)
            number[rows] = _node_number(np.floor(at / self._side).astype(np.int64))
            if some.scale is not None:
                self.levels.add(at, some.levels(), _BESIDE_CELLS * some.scale)
        order = np.argsort(number, kind="stable")
        self.points = points.select(order)
        numbers, starts = np.unique(number[order], return_index=True)
        parts = np.stack([numbers >> shift & (1 << _NODE_BITS) - 1 for shift in (2 * _NODE_BITS, _NODE_BITS, 0)], 1)
        ends = [*starts[1:].tolist(), len(order)]
        self._where = {
            tuple(part): range(*ends_) for part, *ends_ in zip(parts.tolist(), starts.tolist(), ends, strict=True)
        }
        self.blocks = np.unique(parts * self._side // BLOCK_CELLS, axis=0)
        #: Side of each part's largest pixels, in GSD; 1 if all are that small.
        self._coarsest = {
            at: float(self.points.scale[rows.start : rows.stop].max()) if self.points.scale is not None else 1.0
            for at, rows in self._where.items()
        }

    def to_march(self) -> list[Cube]:
        """The cubes of all blocks that the surface may enter: those with points, and their neighbors. x never decreases."""
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
        found = np.unique((self.blocks[:, None] + steps).reshape(-1, 3), axis=0)
        return self.levels.cubes((i, j, k) for i, j, k in found.tolist())

    def around(self, cube: Cube) -> OrientedPoints:
        """The points in a cube and in the margin about it, which is as wide as its largest pixels need."""
        coarsest = max((self._coarsest[at] for at in self._parts(cube, self.lattice.beside)), default=1.0)
        beside = min(self.lattice.beside, _BESIDE_CELLS * max(1.0, coarsest))
        low, high = cube.low - beside, cube.low + cube.size + beside
        rows = [np.arange(r.start, r.stop) for r in (self._where[at] for at in self._parts(cube, beside))]
        some = np.concatenate([np.empty(0, np.int64), *rows])
        at = self.lattice.indices(self.points.points[some])
        return self.points.select(some[((at >= low) & (at <= high)).all(1)])

    def _parts(self, cube: Cube, beside: float) -> list[Place]:
        """The parts with points in a cube or in a margin about it."""
        low, high = cube.low - beside, cube.low + cube.size + beside
        first, last = (np.floor(end / self._side).astype(np.int64).tolist() for end in (low, high))
        x, y, z = (range(a, b + 1) for a, b in zip(first, last, strict=True))
        return [at for at in itertools.product(x, y, z) if at in self._where]


def reach_of(points: OrientedPoints, cell: float, threads: int) -> Floats:
    """Radius of each point's weight function (N): in proportion to the distance to its sixth neighbor, within limits in cells or pixels."""
    side = cell * points.scales()
    if len(side) <= _SPACING_NEIGHBOR:
        return np.asarray(_REACH_CELLS * side)
    tree = scipy("spatial").cKDTree(points.points)
    spacing = tree.query(points.points, _SPACING_NEIGHBOR + 1, workers=threads)[0][:, -1]
    return np.asarray(np.clip(_REACH_SPACINGS * spacing, _REACH_CELLS * side, MOST_REACH_CELLS * side))


def pixel_side(points: Floats, threads: int) -> float:
    """Side of the pixels that the points (N×3) of a cloud count as. It is so large that the longest reach of a point (MOST_REACH_CELLS of
    these pixels) suffices for the median distance of the points from their sixth neighbor.
    """
    if len(points) <= _SPACING_NEIGHBOR:
        return 0.0
    some = points[:: max(1, len(points) // _SAMPLE)]
    tree = scipy("spatial").cKDTree(points)
    spacing = tree.query(some, _SPACING_NEIGHBOR + 1, workers=threads)[0][:, -1]
    return float(np.median(spacing)) * _REACH_SPACINGS / MOST_REACH_CELLS


def distance_field(
    points: OrientedPoints, reach: Floats, lattice: Lattice, cube: Cube, threads: int
) -> NDArray[np.float32]:
    """Signed distance in the cube's cells, positive outside, at its nodes; NaN away from the points."""
    finer = 1 << cube.level
    return _core.tangent_plane_mean(
        lattice.indices(points.points) * finer, points.normals.astype(np.float64), reach / lattice.cell * finer,
        list(cube.first), cube.side + 1, _LEAST_WEIGHT, threads,
    )  # fmt: skip


def pieces(points: OrientedPoints, cell: float, threads: int = ALL_CORES) -> Iterator[Piece]:
    """The surface through the points on a lattice of this cell size, one piece for each block, x ascending; `joined_mesh` joins them.

    Vertices on the side between two blocks are in both pieces. DataError if there are no points, or if they spread over more cells than
    can be numbered: 1 048 576, or half, a quarter or an eighth of it if cells are halved once, twice or three times.
    """
    measure = extra("skimage.measure", "scikit-image", "the surface of an object", "object")
    if not len(points.points):
        raise DataError(
            "no station has a surface that is sure enough for the mesh; object.max_sigma_gsd says how sure it must be, and the reports "
            "of the stations say why it is not"
        )
    coarsest = 1.0 if points.scale is None else max(1.0, float(points.scale.max()))
    beside = min(_BESIDE_CELLS * coarsest, BLOCK_CELLS)
    across = float((points.points.max(0) - points.points.min(0)).max()) / cell
    most = 1 << (_NODE_BITS - _finest_level(points))
    if across + 2 * (beside + BLOCK_CELLS) > most:
        raise DataError(
            f"the points of the object spread over {across:.0f} cells of {cell:g}, expected at most {most}: "
            "are all stations and clouds in one frame and unit?"
        )
    blocks = PointBlocks(points, Lattice(points.points.min(0) - beside * cell, cell, beside))
    for cube in blocks.to_march():
        near = blocks.around(cube)
        if len(near.points) <= _NEIGHBORS:
            continue
        field = distance_field(near, reach_of(near, cell, threads), blocks.lattice, cube, threads)
        field = blocks.levels.blended(cube, field)
        known = field[np.isfinite(field)]
        if not len(known) or known.min() >= 0 or known.max() <= 0:
            continue
        # Cubes with a NaN corner give NaN vertices.
        at, triangles, _, _ = measure.marching_cubes(field, 0.0, gradient_direction="descent")
        triangles = triangles[np.isfinite(at).all(1)[triangles].all(1)]
        if len(triangles):
            if blocks.levels.finest:
                at = exact_vertices(field, at)
            at, triangles = blocks.levels.divided(cube, field, at, triangles)
            yield _piece(at, triangles, cube, near, blocks, threads)


def _finest_level(points: OrientedPoints) -> int:
    """How often the cells at the smallest pixels are halved."""
    if points.scale is None:
        return 0
    return int(np.clip(_core.levels_of(np.array([float(points.scale.min())]))[0], 0, FINEST))


def exact_vertices(field: NDArray[np.float32], at: NDArray[np.float32]) -> Floats:
    """Vertices of marching cubes (N×3) in double precision. Counted in coarse and in fine cells, the same vertex is rounded differently in
    single precision, and could get two numbers.
    """
    exact = at.astype(np.float64)
    node = np.floor(exact)
    fraction = exact - node
    some = np.flatnonzero((fraction > 0).sum(1) == 1)  # the others lie on a node or inside a cell
    axis, before = fraction[some].argmax(1), node[some].astype(np.int64)
    after = before + np.eye(3, dtype=np.int64)[axis]
    first, last = (field[tuple(nodes.T)].astype(np.float64) for nodes in (before, after))
    crossed = (first > 0) != (last > 0)
    some, axis = some[crossed], axis[crossed]
    exact[some, axis] = node[some, axis] + first[crossed] / (first - last)[crossed]
    return exact


def _piece(
    at: NDArray[np.floating], triangles: Ints, cube: Cube, points: OrientedPoints, blocks: PointBlocks, threads: int
) -> Piece:
    """The surface in a cube. at: N×3, in the cube's cells. points: those that it was made from."""
    lattice = blocks.lattice
    used, renumbered = np.unique(triangles, return_inverse=True)
    whole = at[used].astype(np.float64) + np.array(cube.first)
    cell, finer = lattice.cell / (1 << cube.level), 1 << (blocks.levels.finest - cube.level)
    mesh, scale = _with_means(lattice.origin + cell * whole, renumbered.reshape(-1, 3), points, cell, threads)
    on_side = ((at[used] == 0) | (at[used] == cube.side)).any(1)
    first = int(_node_number(np.array([[cube.first[0] * finer, 0, 0]]))[0]) << _AXIS_BITS
    return Piece(mesh, np.where(on_side, _edge_number(whole * finer), -1), first, cube.level, scale)


def _edge_number(at: Floats) -> Ints:
    """A number for each vertex of the finest lattice, by the edge or node that it lies on; grows with x."""
    parts = np.rint(at / _SHARE_AT_NODE).astype(np.int64)
    node, fraction = np.divmod(parts, round(1 / _SHARE_AT_NODE))
    axis = np.where(fraction.any(1), fraction.argmax(1), _AT_NODE)
    return np.asarray((_node_number(node) << _AXIS_BITS) + axis)


def _node_number(node: Ints) -> Ints:
    """One number for each node or block (N×3), which grows with x."""
    return np.asarray((((node[:, 0] << _NODE_BITS) + node[:, 1]) << _NODE_BITS) + node[:, 2])


def _with_means(
    vertices: Floats, triangles: Ints, points: OrientedPoints, cell: float, threads: int
) -> tuple[ObjectMesh, Floats | None]:
    """The mesh with normals and standard deviations: means over the nearest points, weighted by distance; and their scale, averaged alike."""
    away, near = scipy("spatial").cKDTree(points.points).query(vertices, _NEIGHBORS, workers=threads)
    share = 1 / (away**2 + cell**2)
    normals = unit((share[..., None] * points.normals[near]).sum(1))
    sigma = (share * points.sigma[near]).sum(1) / share.sum(1)
    scale = None if points.scale is None else (share * points.scale[near]).sum(1) / share.sum(1)
    return ObjectMesh(vertices, normals, triangles, sigma, np.ones(len(vertices), bool)), scale

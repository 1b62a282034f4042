"""A surface through oriented points, block by block: where the weighted mean of the signed distances to their tangent planes is zero.

Each point has a tangent plane. The mean of a place's signed distances from the tangent planes of the points near it, with weights that
fall with the distance to the points, is its signed distance from the surface (implicit moving least squares: Kolluri 2008,
"Provably good moving least squares"). This mean is computed at the nodes of one lattice for the whole object; marching cubes runs on
blocks of the lattice. Nodes on the side between two blocks are computed from the same points in the same order, so that blocks meet
exactly.
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
from malus.object.meshing import ObjectMesh
from malus.object.views import Floats, scipy, unit
from malus.threads import ALL_CORES

Ints = NDArray[np.int64]

#: Cells along a block's side.
BLOCK_CELLS = 128
#: Radius of a point's weight function: this many cells, or this many times the spacing of its neighbors if that is more.
_REACH_CELLS = 4.0
_REACH_SPACINGS = 1.8
_SPACING_NEIGHBOR = 6
#: Largest radius of a weight function (cells): holes wider than this stay open.
MOST_REACH_CELLS = 6.0
#: Nodes with a smaller sum of weights are too far from the points to have a distance.
_LEAST_WEIGHT = 0.3
#: Margin about a block (cells): it holds the points whose weights reach into the block, and the neighbors that their radii depend on.
_BESIDE_CELLS = 10
#: Normal and standard deviation of a vertex are means over this many nearest points.
_NEIGHBORS = 4
#: Bits that identify a vertex on a side of a block: it lies on an edge of the lattice, which a node (x, y, z) and an axis name, at a
#: fraction of the edge.
_NODE_BITS, _AXIS_BITS, _FRACTION_BITS = 17, 2, 8
#: The nodes of the lattice that these bits can name, along each axis.
MOST_CELLS = 1 << _NODE_BITS


@dataclass(frozen=True)
class Lattice:
    """Nodes at origin + cell · (i, j, k), world; blocks of BLOCK_CELLS cells."""

    origin: Floats
    cell: float

    def indices(self, points: Floats) -> Floats:
        """Where points (N×3) lie, in cells."""
        return np.asarray((points - self.origin) / self.cell)


class PointBlocks:
    """Oriented points, sorted by block."""

    def __init__(self, points: OrientedPoints, lattice: Lattice) -> None:
        self.lattice = lattice
        number = np.empty(len(points.points), np.int64)
        for rows in chunks(len(number)):
            number[rows] = _node_number(np.floor(lattice.indices(points.points[rows]) / BLOCK_CELLS).astype(np.int64))
        order = np.argsort(number, kind="stable")
        self.points = points.select(order)
        numbers, starts = np.unique(number[order], return_index=True)
        self.blocks = np.stack([numbers >> shift & MOST_CELLS - 1 for shift in (2 * _NODE_BITS, _NODE_BITS, 0)], 1)
        ends = [*starts[1:].tolist(), len(order)]
        self._where = {
            tuple(block): range(*ends_)
            for block, *ends_ in zip(self.blocks.tolist(), starts.tolist(), ends, strict=True)
        }

    def to_march(self) -> list[tuple[int, int, int]]:
        """All blocks that the surface may enter: those with points, and their neighbors."""
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
        found = np.unique((self.blocks[:, None] + steps).reshape(-1, 3), axis=0)
        return [(i, j, k) for i, j, k in found.tolist()]

    def around(self, block: tuple[int, int, int]) -> OrientedPoints:
        """The points in a block and in the margin about it."""
        beside = itertools.product(*([x - 1, x, x + 1] for x in block))
        parts = [np.arange(r.start, r.stop) for r in (self._where.get(at) for at in beside) if r is not None]
        some = np.concatenate([np.empty(0, np.int64), *parts])
        at = self.lattice.indices(self.points.points[some]) - np.array(block) * BLOCK_CELLS
        near = ((at >= -_BESIDE_CELLS) & (at <= BLOCK_CELLS + _BESIDE_CELLS)).all(1)
        return self.points.select(some[near])


def reach_of(points: Floats, cell: float, threads: int) -> Floats:
    """Radius of each point's weight function (N): in proportion to the distance to its sixth neighbor, within limits in cells."""
    if len(points) <= _SPACING_NEIGHBOR:
        return np.full(len(points), _REACH_CELLS * cell)
    spacing = scipy("spatial").cKDTree(points).query(points, _SPACING_NEIGHBOR + 1, workers=threads)[0][:, -1]
    return np.asarray(np.clip(_REACH_SPACINGS * spacing, _REACH_CELLS * cell, MOST_REACH_CELLS * cell))


def distance_field(
    points: OrientedPoints, reach: Floats, lattice: Lattice, block: tuple[int, int, int], threads: int
) -> NDArray[np.float32]:
    """Signed distance in cells, positive outside, at the nodes of a block (side BLOCK_CELLS + 1); NaN away from the points."""
    return _core.tangent_plane_mean(
        lattice.indices(points.points), points.normals.astype(np.float64), reach / lattice.cell,
        [BLOCK_CELLS * k for k in block], BLOCK_CELLS + 1, _LEAST_WEIGHT, threads,
    )  # fmt: skip


def pieces(points: OrientedPoints, cell: float, threads: int = ALL_CORES) -> Iterator[Piece]:
    """The surface through the points on a lattice of this cell size, one piece for each block, x ascending; `joined_mesh` joins them.

    Vertices on the side between two blocks are in both pieces. DataError if there are no points, or if they spread over more than
    MOST_CELLS cells.
    """
    measure = extra("skimage.measure", "scikit-image", "the surface of an object", "object")
    if not len(points.points):
        raise DataError(
            "no station has a surface that is sure enough for the mesh; object.max_sigma_gsd says how sure it must be, and the reports "
            "of the stations say why it is not"
        )
    across = float((points.points.max(0) - points.points.min(0)).max()) / cell
    if across + 2 * (_BESIDE_CELLS + BLOCK_CELLS) > MOST_CELLS:
        raise DataError(
            f"the points of the object spread over {across:.0f} cells of {cell:g}, expected at most {MOST_CELLS}: "
            "are all stations and clouds in one frame and unit?"
        )
    blocks = PointBlocks(points, Lattice(points.points.min(0) - _BESIDE_CELLS * cell, cell))
    for block in blocks.to_march():
        near = blocks.around(block)
        if len(near.points) <= _NEIGHBORS:
            continue
        field = distance_field(near, reach_of(near.points, cell, threads), blocks.lattice, block, threads)
        known = field[np.isfinite(field)]
        if not len(known) or known.min() >= 0 or known.max() <= 0:
            continue
        # Cubes with a NaN corner give NaN vertices.
        at, triangles, _, _ = measure.marching_cubes(field, 0.0, gradient_direction="descent")
        triangles = triangles[np.isfinite(at).all(1)[triangles].all(1)]
        if len(triangles):
            used, renumbered = np.unique(triangles, return_inverse=True)
            whole = at[used].astype(np.float64) + np.array(block) * BLOCK_CELLS
            vertices = blocks.lattice.origin + cell * whole
            yield Piece(
                _with_means(vertices, renumbered.reshape(-1, 3), near, cell, threads),
                _seam(at[used], whole),
                int(_node_number(np.array([[block[0] * BLOCK_CELLS, 0, 0]]))[0]) << _AXIS_BITS + _FRACTION_BITS,
            )


def _seam(at: NDArray[np.float32], whole: Floats) -> Ints:
    """A number for each vertex on a side of its block, the same in the neighboring block and growing with x; -1 for all other vertices."""
    parts = np.rint(whole * (1 << _FRACTION_BITS)).astype(np.int64)
    node, fraction = np.divmod(parts, 1 << _FRACTION_BITS)
    edge = (_node_number(node) << _AXIS_BITS) + fraction.argmax(1)
    return np.where(((at == 0) | (at == BLOCK_CELLS)).any(1), (edge << _FRACTION_BITS) + fraction.max(1), -1)


def _node_number(node: Ints) -> Ints:
    """One number for each node or block (N×3), which grows with x."""
    return np.asarray((((node[:, 0] << _NODE_BITS) + node[:, 1]) << _NODE_BITS) + node[:, 2])


def _with_means(vertices: Floats, triangles: Ints, points: OrientedPoints, cell: float, threads: int) -> ObjectMesh:
    """The mesh with normals and standard deviations: means over the nearest points, weighted by distance."""
    away, near = scipy("spatial").cKDTree(points.points).query(vertices, _NEIGHBORS, workers=threads)
    share = 1 / (away**2 + cell**2)
    normals = unit((share[..., None] * points.normals[near]).sum(1))
    sigma = (share * points.sigma[near]).sum(1) / share.sum(1)
    return ObjectMesh(vertices, normals, triangles, sigma, np.ones(len(vertices), bool))

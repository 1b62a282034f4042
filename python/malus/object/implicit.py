"""A surface through oriented points: where a weighted mean of their tangent planes' distances is zero, block by block.

Each point says of its surroundings how far they lie before or behind its tangent plane. The mean of what the points near a place say,
by a weight that falls with their distance, is a signed distance from the surface (implicit moving least squares: Kolluri 2008,
"Provably good moving least squares"). It is computed at the nodes of one lattice for the whole object; cubes are marched in
blocks of it. What lies on the side of two blocks is computed from the same points in the same order, so that blocks meet exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.object.agreement import OrientedPoints
from malus.object.joining import Piece
from malus.object.meshing import ObjectMesh
from malus.object.views import Floats

Ints = NDArray[np.int64]

#: Cells along a block's side.
BLOCK_CELLS = 128
#: A point's weight is zero this many cells away, or this many of the spacing of its neighbors where they lie further apart.
_REACH_CELLS = 4.0
_REACH_SPACINGS = 1.8
_SPACING_NEIGHBOR = 6
#: No point reaches further (cells): holes wider than that stay open.
MOST_REACH_CELLS = 6.0
#: Nodes about which the points together weigh less lie away from the surface.
_LEAST_WEIGHT = 0.3
#: What is taken along beside a block (cells): points that reach into it, and the neighbors that their reach depends on.
_BESIDE_CELLS = 10
#: Points whose normals and standard deviations a vertex takes the mean of.
_NEIGHBORS = 4
#: To so many parts of a cell vertices on the sides of blocks are told apart.
_PARTS = 256
_DIGITS = 21  # bits for a coordinate


@dataclass(frozen=True)
class Lattice:
    """Nodes at origin + cell · (i, j, k), world; blocks of BLOCK_CELLS cells."""

    origin: Floats
    cell: float

    def indices(self, points: Floats) -> Floats:
        """Where points (N×3) lie, in cells."""
        return np.asarray((points - self.origin) / self.cell)


class PointBlocks:
    """Oriented points, sorted by the blocks that they lie in."""

    def __init__(self, points: OrientedPoints, lattice: Lattice) -> None:
        self.lattice = lattice
        blocks = np.floor(lattice.indices(points.points) / BLOCK_CELLS).astype(np.int64)
        order = np.lexsort(blocks.T[::-1])
        self.points = points.select(order)
        self.blocks, starts = np.unique(blocks[order], axis=0, return_index=True)
        ends = [*starts[1:].tolist(), len(order)]
        self._where = {
            tuple(block): range(*ends_)
            for block, *ends_ in zip(self.blocks.tolist(), starts.tolist(), ends, strict=True)
        }

    def to_march(self) -> list[tuple[int, int, int]]:
        """All blocks that the surface may enter: those of points, and those beside them."""
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
        found = np.unique((self.blocks[:, None] + steps).reshape(-1, 3), axis=0)
        return [(i, j, k) for i, j, k in found.tolist()]

    def around(self, block: tuple[int, int, int]) -> OrientedPoints:
        """The points in a block and beside it."""
        beside = itertools.product(*([x - 1, x, x + 1] for x in block))
        parts = [np.arange(r.start, r.stop) for r in (self._where.get(at) for at in beside) if r is not None]
        some = np.concatenate([np.empty(0, np.int64), *parts])
        at = self.lattice.indices(self.points.points[some]) - np.array(block) * BLOCK_CELLS
        near = ((at >= -_BESIDE_CELLS) & (at <= BLOCK_CELLS + _BESIDE_CELLS)).all(1)
        return self.points.select(some[near])


def reach_of(points: Floats, cell: float) -> Floats:
    """How far each point's word counts (N): by the distance to its sixth neighbor, but at least and at most so many cells."""
    spatial = extra("scipy.spatial", "scipy", "the surface of an object", "object")
    if len(points) <= _SPACING_NEIGHBOR:
        return np.full(len(points), _REACH_CELLS * cell)
    spacing = spatial.cKDTree(points).query(points, _SPACING_NEIGHBOR + 1, workers=1)[0][:, -1]
    return np.asarray(np.clip(_REACH_SPACINGS * spacing, _REACH_CELLS * cell, MOST_REACH_CELLS * cell))


def distance_field(
    points: OrientedPoints, reach: Floats, lattice: Lattice, block: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Signed distance in cells, positive outside, at the nodes of a block (side BLOCK_CELLS + 1); NaN away from the points."""
    # Whatever block they are taken for, points have the same numbers and the same order: sums then are equal to the last bit.
    at = lattice.indices(points.points)
    nearest = np.rint(at)
    far = reach / lattice.cell
    widest = math.ceil(far.max(initial=0))
    local = nearest.astype(np.int64) - np.array(block) * BLOCK_CELLS
    some = np.flatnonzero(((local >= -widest) & (local <= BLOCK_CELLS + widest)).all(1))
    some = some[np.lexsort(at[some].T)]
    off, normals, far = (at - nearest)[some].T, points.normals[some], far[some]
    # The volume has a rim as wide as points reach, so that no node must be asked whether it is inside.
    side = BLOCK_CELLS + 1 + 4 * widest
    weights, sums = np.zeros(side**3), np.zeros(side**3)
    strides = np.array([side**2, side, 1])
    place = ((local[some] + 2 * widest) * strides).sum(1)
    square, along = (off**2).sum(0), (off * normals.T).sum(0)
    for step in itertools.product(range(-widest, widest + 1), repeat=3):
        # A node is at most .87 cells nearer than its step from the nearest one.
        some = np.flatnonzero(far > math.hypot(*step) - 0.87)
        x, y, z = off[:, some]
        apart = square[some] - 2 * (x * step[0] + y * step[1] + z * step[2]) + sum(s * s for s in step)
        share = np.sqrt(np.maximum(apart, 0)) / far[some]
        weight = np.where(share < 1, (1 - share) ** 4 * (4 * share + 1), 0)  # Wendland: smooth, and zero at the reach
        x, y, z = normals.T[:, some]
        node = place[some] + int(np.dot(step, strides))
        np.add.at(weights, node, weight)
        np.add.at(sums, node, weight * (x * step[0] + y * step[1] + z * step[2] - along[some]))
    with np.errstate(invalid="ignore", divide="ignore"):
        field = np.where(weights > _LEAST_WEIGHT, sums / weights, np.nan).reshape(side, side, side)
    inner = slice(2 * widest, 2 * widest + BLOCK_CELLS + 1)
    return np.asarray(field[inner, inner, inner], np.float32)


def pieces(points: OrientedPoints, cell: float) -> Iterator[Piece]:
    """The surface through the points on a lattice of this cell, block after block, first along x; `joined_mesh` makes one of them.

    Vertices on the sides of blocks are in the pieces on both sides.
    """
    measure = extra("skimage.measure", "scikit-image", "the surface of an object", "object")
    blocks = PointBlocks(points, Lattice(points.points.min(0) - _BESIDE_CELLS * cell, cell))
    for block in blocks.to_march():
        near = blocks.around(block)
        if len(near.points) <= _NEIGHBORS:
            continue
        field = distance_field(near, reach_of(near.points, cell), blocks.lattice, block)
        known = field[np.isfinite(field)]
        if not len(known) or known.min() >= 0 or known.max() <= 0:
            continue
        # Where a corner of a cube is unknown, vertices are no numbers.
        at, triangles, _, _ = measure.marching_cubes(field, 0.0, gradient_direction="descent")
        triangles = triangles[np.isfinite(at).all(1)[triangles].all(1)]
        if len(triangles):
            used, renumbered = np.unique(triangles, return_inverse=True)
            whole = at[used].astype(np.float64) + np.array(block) * BLOCK_CELLS
            vertices = blocks.lattice.origin + cell * whole
            yield Piece(
                _with_means(vertices, renumbered.reshape(-1, 3), near, cell),
                _seam(at[used], whole),
                (block[0] * BLOCK_CELLS * _PARTS) << 2 * _DIGITS,
            )


def _seam(at: NDArray[np.float32], whole: Floats) -> Ints:
    """A number for each vertex on the side of its block, the same in the block beside it and growing with x; -1 within."""
    parts = np.rint(whole * _PARTS).astype(np.int64)
    number = (parts[:, 0] << 2 * _DIGITS) + (parts[:, 1] << _DIGITS) + parts[:, 2]
    return np.where(((at == 0) | (at == BLOCK_CELLS)).any(1), number, -1)


def _with_means(vertices: Floats, triangles: Ints, points: OrientedPoints, cell: float) -> ObjectMesh:
    """Normals and standard deviations: means of the nearest points, by their distance."""
    spatial = extra("scipy.spatial", "scipy", "the surface of an object", "object")
    away, near = spatial.cKDTree(points.points).query(vertices, _NEIGHBORS, workers=1)
    share = 1 / (away**2 + cell**2)
    normals = (share[..., None] * points.normals[near]).sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    sigma = (share * points.sigma[near]).sum(1) / share.sum(1)
    return ObjectMesh(vertices, normals, triangles, sigma, np.ones(len(vertices), bool))

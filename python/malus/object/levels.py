"""A lattice that is finer where points have smaller pixels, and the seams between its parts.

The object's lattice has cells of one GSD. Blocks of it near points of smaller pixels have cells that are halved once or several times.
On the side between two blocks the finer one takes its values from the nodes of the coarser one, linear in between, and the triangles of
the coarser one are divided where the finer one has vertices. So the surfaces of both have the same vertices on it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.object.views import Floats

Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
Place = tuple[int, int, int]

#: Cells of one GSD are halved at most this often.
FINEST: int = _core.finest_level
#: A block is divided into so many parts along each side where points have smaller pixels; each part has cells of its own size.
_PARTS = 8


@dataclass(frozen=True)
class Cube:
    """Part of the lattice that is marched at once: `side` cells, halved `level` times, from node `first`, counted in these cells."""

    first: Place
    side: int
    level: int

    @property
    def low(self) -> Floats:
        """The cube's first corner, in whole cells."""
        return np.array(self.first, np.float64) / (1 << self.level)

    @property
    def size(self) -> float:
        """Side in whole cells."""
        return self.side / (1 << self.level)


class Levels:
    """How often the cells of each part of the lattice are halved. block_cells: whole cells along a block's side. part: along a part's."""

    def __init__(self, block_cells: int) -> None:
        self._block, self.part = block_cells, block_cells // _PARTS
        #: Level of the smallest cells.
        self.finest = 0
        self._of: dict[Place, int] = {}
        self._divided: set[Place] = set()

    def add(self, at: Floats, levels: Ints, beside: NDArray[np.floating]) -> None:
        """Halve the cells near points (N×3, in cells) as often as their levels (N) say. beside: how far about each point (N, in cells)."""
        for level in np.unique(np.minimum(levels[levels > 0], FINEST)).tolist():
            some = np.minimum(levels, FINEST) == level
            low, high = (
                np.floor((at[some] + sign * beside[some, None]) / self.part).astype(np.int64) for sign in (-1, 1)
            )
            for step in itertools.product(range(int((high - low).max(initial=0)) + 1), repeat=3):
                for i, j, k in np.unique(np.minimum(low + step, high), axis=0).tolist():
                    self._of[i, j, k] = max(self._of.get((i, j, k), 0), level)
                    self._divided.add((i // _PARTS, j // _PARTS, k // _PARTS))
            self.finest = max(self.finest, level)

    def cubes(self, blocks: Iterable[Place]) -> list[Cube]:
        """The cubes that make up these blocks; x never decreases."""
        found = [cube for block in blocks for cube in self._cubes_of(block)]
        return sorted(found, key=lambda cube: cube.low[0]) if self._of else found

    def _cubes_of(self, block: Place) -> Iterator[Cube]:
        if block not in self._divided:
            yield Cube(_times(block, self._block), self._block, 0)
            return
        for step in itertools.product(range(_PARTS), repeat=3):
            part = _plus(_times(block, _PARTS), step)
            level = self._of.get(part, 0)
            side = self.part * 2**level
            yield Cube(_times(part, side), side, level)

    def _at(self, cube: Cube, nodes: Ints) -> Ints:
        """Levels (N) of the parts of the lattice that hold these places (N×3), counted in the cube's cells."""
        parts, which = np.unique(nodes // (self.part * 2**cube.level), axis=0, return_inverse=True)
        levels = [self._of.get((i, j, k), 0) for i, j, k in parts.tolist()]
        return np.array(levels, np.int64)[which.reshape(-1)]

    def _beside(self, cube: Cube, *ends: tuple[int, bool]) -> int:
        """Level of the lattice on the other side of one end of the cube, or of two: axis, and whether it is the far end."""
        node = np.array([cube.first])
        for axis, far in ends:
            node[0, axis] += cube.side if far else -1
        return int(self._at(cube, node)[0])

    def blended(self, cube: Cube, field: Singles) -> Singles:
        """The field at a cube's nodes (in its cells); on its sides, between nodes of coarser neighbors, linear in between."""
        if cube.level == 0:
            return field
        self._blend_edges(cube, field)
        for axis, far in itertools.product(range(3), (False, True)):
            level = self._beside(cube, (axis, far))
            if level < cube.level:
                side = np.moveaxis(field, axis, 0)
                end = -1 if far else 0
                every = 2 ** (cube.level - level)
                side[end] = refined(side[end][::every, ::every], every)
        # The sides have rounded the values on their edges differently, but all parts about an edge must have the same values.
        self._blend_edges(cube, field)
        return field

    def _blend_edges(self, cube: Cube, field: Singles) -> None:
        """The same on the cube's edges, where the coarsest of the parts about an edge counts."""
        for a, b in ((0, 1), (0, 2), (1, 2)):
            for far_a, far_b in itertools.product((False, True), repeat=2):
                ends = ((a, far_a), (b, far_b))
                level = min(*(self._beside(cube, end) for end in ends), self._beside(cube, *ends))
                if level < cube.level:
                    at: list[Any] = [slice(None)] * 3
                    at[a], at[b] = -1 if far_a else 0, -1 if far_b else 0
                    every = 2 ** (cube.level - level)
                    line = field[tuple(at)]
                    line[:] = _between(line[::every], every)

    def divided(
        self, cube: Cube, field: Singles, at: NDArray[np.floating], triangles: Ints
    ) -> tuple[NDArray[np.floating], Ints]:
        """Vertices (N×3, in the cube's cells) and triangles, with triangles divided where finer neighbors have vertices on their edges."""
        if not self._of:
            return at, triangles
        for axis, far in itertools.product(range(3), (False, True)):
            at, triangles = self._divided_at(cube, field, at, triangles, axis, far)
        return at, triangles

    def _divided_at(
        self, cube: Cube, field: Singles, at: NDArray[np.floating], triangles: Ints, axis: int, far: bool
    ) -> tuple[NDArray[np.floating], Ints]:
        """Divide the triangles that have an edge on one side of the cube."""
        flat = (at[:, axis] == (cube.side if far else 0))[triangles]
        number, corner = np.nonzero(flat & np.roll(flat, -1, 1) & ~flat.all(1)[:, None])
        across = [k for k in range(3) if k != axis]
        edges = np.stack([triangles[number, (corner + k) % 3] for k in range(3)], 1)
        cells = np.minimum(np.floor(at[edges[:, :2]][..., across].mean(1)), cube.side - 1).astype(np.int64)
        beside = np.tile(np.array(cube.first), (len(cells), 1))
        beside[:, axis] += cube.side if far else -1
        beside[:, across] += cells
        halved = self._at(cube, beside) - cube.level
        values = np.moveaxis(field, axis, 0)[-1 if far else 0]
        whole = np.ones(len(triangles), bool)
        vertices, added, count = [at], [triangles[:0]], len(at)
        for some in np.flatnonzero(halved > 0).tolist():
            (i, j), (a, b, c) = cells[some].tolist(), edges[some].tolist()
            ends = at[[a, b]][:, across].astype(np.float64) - cells[some]
            between = _crossings(values[i : i + 2, j : j + 2], 2 ** int(halved[some]), ends)
            if len(between):
                new = np.full((len(between), 3), at[a, axis], at.dtype)
                new[:, across] = cells[some] + between
                vertices.append(new)
                line = [a, *range(count, count + len(new)), b]
                added.append(np.array([[p, q, c] for p, q in itertools.pairwise(line)]))
                count += len(new)
                whole[number[some]] = False
        return np.concatenate(vertices), np.concatenate([triangles[whole], *added])


def _times(place: Place, factor: int) -> Place:
    return (place[0] * factor, place[1] * factor, place[2] * factor)


def _plus(place: Place, step: tuple[int, ...]) -> Place:
    return (place[0] + step[0], place[1] + step[1], place[2] + step[2])


def _between(values: Singles, every: int) -> Singles:
    """Values at nodes (N, or N×M), and linear between them at (N - 1) · every + 1 nodes."""
    whole = np.empty(((len(values) - 1) * every + 1, *values.shape[1:]), values.dtype)
    whole[::every] = values
    for k in range(1, every):
        share = np.float32(k / every)
        whole[k::every] = (1 - share) * values[:-1] + share * values[1:]
    return whole


def refined(values: Singles, every: int) -> Singles:
    """The same for the nodes of a square, bilinear. An unknown node (NaN) does not affect the lines between known nodes."""
    return np.ascontiguousarray(_between(_between(values, every).T, every).T)


def _crossings(corners: Singles, every: int, ends: Floats) -> Floats:
    """Where a finer lattice has vertices between the ends (2×2) of a triangle's edge inside a cell of a side; N×2, in cells, in order.

    corners: the field at the cell's corners (2×2). The finer lattice's field is bilinear there, so that the surface is a hyperbola.
    """
    values = refined(corners, every).astype(np.float64)
    parts = [np.empty((0, 2))]
    for turned in (False, True):
        lines = (values.T if turned else values)[1:-1]
        row, column = np.nonzero((lines[:, 1:] > 0) != (lines[:, :-1] > 0))
        before, after = lines[row, column], lines[row, column + 1]
        found = np.stack([row + 1.0, column + before / (before - after)], 1) / every
        parts.append(found[:, ::-1] if turned else found)
    places = np.concatenate(parts)
    (a, b), (c, d) = corners.astype(np.float64) > 0
    if a == d and b == c and a != b:
        # Both branches of the hyperbola are in the cell. The edge's one is on the edge's side of the asymptotes.
        bend = values[0, 0] - values[0, -1] - values[-1, 0] + values[-1, -1]
        saddle = np.array([values[0, 0] - values[0, -1], values[0, 0] - values[-1, 0]]) / bend
        places = places[((places > saddle) == (ends.mean(0) > saddle)).all(1)]
    return np.asarray(places[np.argsort((places - ends[0]) @ (ends[1] - ends[0]), kind="stable")])

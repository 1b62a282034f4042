"""Joins pieces of a surface into one mesh: merges vertices on seams and drops small separate parts. Large arrays stay on disk."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus.errors import DataError
from malus.object.arrays import GrowingArray, chunks
from malus.object.meshing import LEAST_PART, ObjectMesh, connected, part_numbers
from malus.object.views import Bools, Floats

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Piece:
    """Part of a mesh. seam: N, the same number for a vertex here and in a neighboring piece; -1 for vertices that no other piece has.
    level: how often the lattice's cells were halved for it. scale: N, side of the pixels that measured each vertex, in GSD of the object;
    None if it is 1 for all.

    Seam numbers are never less than the `first_seam` of their piece. `first_seam` never decreases from one piece to the next.
    """

    mesh: ObjectMesh
    seam: Ints
    first_seam: int
    level: int = 0
    scale: Floats | None = None

    def sure(self, most_sigma: float) -> Bools:
        """Which vertices (N) have a sigma of at most `most_sigma`, a limit that grows with pixels larger than the object's GSD."""
        return np.asarray(self.mesh.sigma <= most_sigma * (1.0 if self.scale is None else np.maximum(self.scale, 1.0)))


class _GrowingMesh:
    def __init__(self, folder: Path) -> None:
        self.vertices, self.normals = (GrowingArray(folder / name, np.float64, 3) for name in ("vertices", "normals"))
        self.sigma = GrowingArray(folder / "sigma", np.float64)
        self.level = GrowingArray(folder / "level", np.uint8)
        self.triangles = GrowingArray(folder / "triangles", np.int64, 3)

    def add(self, mesh: ObjectMesh, chosen: Bools, triangles: Ints, level: NDArray[np.integer]) -> None:
        """Add the chosen vertices of a mesh with their levels, and triangles between any vertices."""
        self.vertices.add(mesh.vertices[chosen])
        self.normals.add(mesh.normals[chosen])
        self.sigma.add(mesh.sigma[chosen])
        self.level.add(level)
        self.triangles.add(triangles)

    def mesh(self) -> ObjectMesh:
        level = self.level.array()
        return ObjectMesh(
            self.vertices.array(), self.normals.array(), self.triangles.array(), self.sigma.array(),
            np.ones(self.vertices.rows, bool), level if level.any() else None,
        )  # fmt: skip


class _Seams:
    """Vertices that later pieces may share: seam numbers in order, each with its vertex number and its connected part of the mesh."""

    def __init__(self) -> None:
        self.seam, self.number, self.part = (np.empty(0, np.int64) for _ in range(3))

    def find(self, seam: Ints) -> tuple[NDArray[np.bool_], Ints]:
        """Which of these seam numbers are known, and their positions in `self.seam`."""
        if not len(self.seam):
            return np.zeros(len(seam), bool), np.zeros(len(seam), np.int64)
        at = np.minimum(np.searchsorted(self.seam, seam), len(self.seam) - 1)
        return (seam >= 0) & (self.seam[at] == seam), at

    def add(self, seam: Ints, number: Ints, part: Ints, first: int) -> None:
        """Add vertices, and drop those that no later piece can share."""
        kept = self.seam >= first
        rows = [
            np.concatenate([old[kept], new])
            for old, new in zip((self.seam, self.number, self.part), (seam, number, part), strict=True)
        ]
        order = np.argsort(rows[0], kind="stable")
        self.seam, self.number, self.part = (row[order] for row in rows)


def joined_mesh(pieces: Iterable[Piece], folder: Path, most_sigma: float) -> ObjectMesh:
    """One mesh of all pieces, its arrays in files in `folder`.

    Triangles with a vertex whose sigma exceeds `most_sigma` (more where pixels are larger than the object's GSD) are dropped, and so are
    small separate parts. Raises DataError if no triangle is left.
    """
    raw, parts_of = _GrowingMesh(folder / "raw"), GrowingArray(folder / "raw" / "parts", np.int64)
    seams, links, sizes = _Seams(), [np.empty((0, 2), np.int64)], [np.empty(0)]
    parts = 0
    for piece in pieces:
        mesh = piece.mesh
        found, at = seams.find(piece.seam)
        # Two vertices of a piece that lie on one node are one vertex, as for the pieces beside it.
        shared = np.flatnonzero(~found & (piece.seam >= 0))
        _, first, where = np.unique(piece.seam[shared], return_index=True, return_inverse=True)
        twin = shared[first[where]]
        new = ~found
        new[shared] = twin == shared
        numbers = np.empty(len(found), np.int64)
        numbers[new] = raw.vertices.rows + np.arange(int(new.sum()))
        numbers[shared] = numbers[twin]
        numbers[found] = seams.number[at[found]]
        kept = mesh.triangles[piece.sure(most_sigma)[mesh.triangles].all(1)]
        part = parts + part_numbers(kept, len(found))
        links += [np.stack([part[found], seams.part[at[found]]], 1), np.stack([part[shared], part[twin]], 1)]
        once = shared[first]
        seams.add(piece.seam[once], numbers[once], part[once], piece.first_seam)
        triangles = numbers[kept]
        # A triangle whose seam vertices were merged has no area.
        real = (triangles != np.roll(triangles, 1, 1)).all(1)
        raw.add(mesh, new, triangles[real], np.full(int(new.sum()), piece.level))
        of = part[kept[real, 0]]
        parts_of.add(of)
        # In triangles of whole cells, so that fine parts of the mesh do not make the others small.
        count = np.bincount(of - parts, minlength=part.max(initial=parts - 1) + 1 - parts)
        sizes.append(count.astype(np.float64) * 0.25**piece.level)
        parts += len(sizes[-1])
    whole = connected(np.concatenate(links), parts)
    size = np.bincount(whole, np.concatenate(sizes), max(parts, 1))
    good = (size >= LEAST_PART * size.sum())[whole] & (size[whole] > 0)
    return _selected(raw.mesh(), good, parts_of.array(), folder)


def _selected(mesh: ObjectMesh, good: NDArray[np.bool_], parts_of: Ints, folder: Path) -> ObjectMesh:
    """The triangles of good parts, and their vertices."""
    used = np.zeros(len(mesh.vertices), bool)
    for rows in chunks(len(mesh.triangles)):
        used[mesh.triangles[rows][good[parts_of[rows]]]] = True
    if not used.any():
        raise DataError("stations agree on no surface, expected points that lie beside each other")
    numbers = np.cumsum(used, dtype=np.int32) - 1
    kept = _GrowingMesh(folder / "kept")
    for rows in chunks(len(mesh.vertices)):
        part = ObjectMesh(mesh.vertices[rows], mesh.normals[rows], mesh.triangles[:0], mesh.sigma[rows], used[rows])
        level = np.zeros(len(part.vertices), np.uint8) if mesh.level is None else mesh.level[rows]
        kept.add(part, used[rows], mesh.triangles[:0], level[used[rows]])
    for rows in chunks(len(mesh.triangles)):
        kept.triangles.add(numbers[mesh.triangles[rows][good[parts_of[rows]]]])
    return kept.mesh()

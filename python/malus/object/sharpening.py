"""Restores detail that stereo smoothed away, as far as the phases of several stations support it.

A phase of polarization constrains the surface normal to a plane through the viewing ray: for diffuse reflection the plane with the
phase's direction, for specular reflection the plane across it (multi-view azimuth stereo: Cao et al. 2023). Every station that sees a
place constrains its normal in this way, whatever the station's prior. The depths of each station are moved slightly and smoothly, so
that as many normals as possible lie in their planes. This is done in tiles, since a move has no effect far beyond a tile.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.object.arrays import on_disk
from malus.object.views import LEAST_COSINE, Bools, Floats, Singles, View, scipy, unit
from malus.workspace import Workspace

Ints = NDArray[np.int64]
Window = tuple[slice, slice]

#: Standard deviations (GSD) of a pixel's move across the surface: the surface's own one, clipped to _PLACE_GSD; of the move's second
#: differences, _BEND_GSD.
_PLACE_GSD, _BEND_GSD = (0.2, 1.0), 0.3
#: Standard deviation of the sine between a normal and a phase's plane: a constant for interreflections, and a part divided by the degree.
_TURN, _TURN_OF_DEGREE = 0.08, 0.0012
#: Beyond this many standard deviations the weight of a phase falls (Cauchy).
_ROBUST = 2.0
#: Phases of a smaller degree are not used. Nor are phases of an unclear kind: the normal must be nearer to one plane by this factor.
_LEAST_DEGREE, _CLEARER = 0.003, 2.0
#: A station with a smaller share of clear phases is not used: 59 % of phases that are unrelated to the surface are clear.
_LEAST_CLEAR = 0.7
#: About the largest sample of phases that decide it.
_MOST_ASKED = 1_000_000
#: Side of a tile, and the margin about it (pixels).
_TILE, _BESIDE = 512, 32
#: Gauss–Newton steps; tolerance and most iterations of the linear solver.
_STEPS, _TOLERANCE, _MOST_ITERATIONS = 3, 1e-3, 300
#: Pixels farther apart in depth (GSD) do not belong to one surface.
_STEP_GSD = 6.0
#: Corners of a cell of four pixels: row, column, and their factors in the steps to the right and down across the cell's middle.
_CORNERS = ((0, 0, -0.5, -0.5), (0, 1, 0.5, -0.5), (1, 0, -0.5, 0.5), (1, 1, 0.5, 0.5))


@dataclass(frozen=True)
class Phases:
    """Polarization of a station: degree times cosine and sine of twice the phase, 2×H×W; zero where it is not known."""

    maps: Singles

    @staticmethod
    def of(workspace: Workspace, path: Path) -> Phases:
        """The phases of a finished workspace. path: a new file for the maps."""
        degree, phase = (workspace.raster(f"polarization/{name}.tif") for name in ("degree", "phase"))
        maps = np.nan_to_num(np.stack([degree * np.cos(2 * phase), degree * np.sin(2 * phase)]))
        return Phases(on_disk(maps.astype(np.float32), path))

    def planes(self, view: View, points: Floats) -> tuple[Floats, Floats]:
        """Degree (N) of the light that comes from world points (N×3), and the unit normals (2×N×3) of the planes that hold their surface
        normals: first for diffuse, then for specular reflection.
        """
        ndimage = scipy("ndimage")
        u, v, _ = view.project(points)
        cosine, sine = (ndimage.map_coordinates(values, [v, u], order=1, mode="nearest") for values in self.maps)
        angle = np.arctan2(sine, cosine) / 2  # counter-clockwise as displayed, v down
        along = np.stack([np.cos(angle), -np.sin(angle), np.zeros_like(angle)], -1) @ view.rotation
        ray = points - view.eye
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        body = np.cross(ray, along)
        mirror = along - ray * (along * ray).sum(1, keepdims=True)
        planes = np.stack([body, mirror])
        return np.hypot(cosine, sine), planes / np.linalg.norm(planes, axis=-1, keepdims=True)


class _Cells:
    """Part of a view's surface as cells of four neighboring pixels. The unknowns are the growths: each pixel's change of depth over depth."""

    def __init__(self, view: View, window: Window) -> None:
        usable, depth = view.usable[window], view.depth[window].astype(np.float64)
        whole = usable[:-1, :-1] & usable[1:, :-1] & usable[:-1, 1:] & usable[1:, 1:]
        four = np.stack([depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]])
        whole[whole] = np.ptp(four[:, whole], axis=0) < _STEP_GSD * view.gsd
        self.row, self.column = np.nonzero(whole)
        self.pixels = np.zeros(usable.shape, bool)
        for i, j, _, _ in _CORNERS:
            self.pixels[self.row + i, self.column + j] = True
        self.number = np.full(usable.shape, -1)
        self.number[self.pixels] = np.arange(int(self.pixels.sum()))
        self.view, self.eye = view, view.eye
        self._from_eye = _grid_points(view, window) - view.eye
        self.of_corner = [self.number[self.row + i, self.column + j] for i, j, _, _ in _CORNERS]
        #: Standard deviation of each pixel's place across the surface, in GSD.
        self.sigma = np.clip(view.sigma[window][self.pixels] / view.gsd, *_PLACE_GSD)
        #: How far a pixel moves across the surface for a growth of one, in GSD.
        self.across = np.linalg.norm(self._from_eye[self.pixels], axis=1) * view.cosine[window][self.pixels] / view.gsd

    @property
    def unknowns(self) -> int:
        return len(self.across)

    def corners(self, growth: Floats) -> list[Floats]:
        """The cells' four corners (N×3 each) relative to the eye, after this growth."""
        return [
            self._from_eye[self.row + i, self.column + j] * (1 + growth[number])[:, None]
            for (i, j, _, _), number in zip(_CORNERS, self.of_corner, strict=True)
        ]

    def bends(self) -> Any:
        """Sparse matrix: second differences of pixels in rows and columns."""
        parts = []
        for number in (self.number, self.number.T):
            line = np.stack([number[:-2], number[1:-1], number[2:]], -1).reshape(-1, 3)
            parts.append(line[(line >= 0).all(1)])
        lines = np.concatenate(parts)
        rows = np.repeat(np.arange(len(lines)), 3)
        values = np.tile([1.0, -2.0, 1.0], len(lines))
        return scipy("sparse").csr_matrix((values, (rows, lines.ravel())), (len(lines), self.unknowns))


def telling(views: Sequence[View], phases: Sequence[Phases]) -> list[tuple[View, Phases]]:
    """The stations whose phases are consistent with their own surfaces."""
    return [(view, known) for view, known in zip(views, phases, strict=True) if _tells(view, known)]


def sharpened(views: Sequence[View], stations: Sequence[tuple[View, Phases]]) -> Iterator[View]:
    """The views with depths and normals adjusted to the phases of the stations, one after the other; `usable` does not change."""
    return (_sharpened(view, stations) for view in views) if stations else iter(views)


def _tells(view: View, phases: Phases) -> bool:
    """Whether enough phases are consistent with the station's own surface."""
    rows, columns = np.nonzero(view.usable)
    some = slice(None, None, max(1, len(rows) // _MOST_ASKED))
    rows, columns = rows[some], columns[some]
    degree, planes = phases.planes(view, view.points_at(rows, columns))
    strong = degree > _LEAST_DEGREE
    clear = _clear(np.abs((planes * view.normals[rows, columns]).sum(-1)))
    return bool(clear[strong].mean() > _LEAST_CLEAR) if strong.any() else False


def _clear(off: Floats) -> Bools:
    """Which normals are clearly nearer to one of two planes; `off`: sine between the normals and each plane, 2×N."""
    return np.asarray(_CLEARER * off.min(0) < off.max(0))


def _sharpened(view: View, stations: Sequence[tuple[View, Phases]]) -> View:
    height, width = view.depth.shape
    growth = np.zeros((height, width))
    for top, left in itertools.product(range(0, height, _TILE), range(0, width, _TILE)):
        window, inner = _around(top, left, _BESIDE)
        cells = _Cells(view, window)
        if cells.unknowns:
            part = np.zeros(cells.pixels.shape)
            part[cells.pixels] = _growth(cells, stations)
            growth[top : top + _TILE, left : left + _TILE] = part[inner]
    return _moved(view, growth)


def _growth(cells: _Cells, stations: Sequence[tuple[View, Phases]]) -> Floats:
    """Growth of the depths of the cells' pixels."""
    sparse, solvers = scipy("sparse"), scipy("sparse.linalg")
    growth = np.zeros(cells.unknowns)
    asked = _asked(cells, stations)
    place = sparse.diags(cells.across / cells.sigma)
    bend = cells.bends() @ sparse.diags(cells.across / _BEND_GSD)
    held = place.T @ place + bend.T @ bend
    for _ in range(_STEPS):
        matrix, right = held, -held @ growth
        for which, degree, planes in asked:
            rows, weight, off = _equations(cells, cells.corners(growth), which, degree, planes)
            matrix = matrix + rows.T @ sparse.diags(weight) @ rows
            right = right - rows.T @ (weight * off)
        step, _ = solvers.cg(
            matrix, right, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS, M=sparse.diags(1 / matrix.diagonal())
        )
        growth = growth + step
    return growth


def _asked(cells: _Cells, stations: Sequence[tuple[View, Phases]]) -> list[tuple[Ints, Floats, Floats]]:
    """For each station: the cells that it sees, the degree of polarization there, and the two planes.

    A station with larger pixels is not asked: its phase is a mean over detail that the cells have, and would smooth it.
    """
    corners = cells.corners(np.zeros(cells.unknowns))
    points = cells.eye + sum(corners) / 4
    normals = unit(_areas(corners))
    asked = []
    for station, phases in stations:
        if not station.may_see(points):
            continue
        at = station.meet(points)
        near = np.abs(at.off(points)) < 2 * station.gsd
        coarser = cells.view.finer(cells.view.facing(points, normals), station, at.weight)
        which = np.flatnonzero((at.weight > 0) & near & ~coarser & (station.facing(points, normals) > LEAST_COSINE))
        asked.append((which, *phases.planes(station, points[which])))
    return asked


def _equations(
    cells: _Cells, corners: list[Floats], which: Ints, degree: Floats, planes: Floats
) -> tuple[Any, Floats, Floats]:
    """Linear equations of one station for the unknowns: rows, weights and residuals (sines), for the cells whose phase is clear."""
    right, down = _steps(corners)
    areas = _areas(corners)
    size = np.linalg.norm(areas, axis=1)[which]
    off = np.abs((planes * (areas[which] / size[:, None])).sum(-1))
    kind = off.argmin(0)
    clear = np.flatnonzero((degree > _LEAST_DEGREE) & _clear(off))
    plane, which, size = planes[kind[clear], clear], which[clear], size[clear]
    sine = (areas[which] * plane).sum(1) / size
    sigma = np.hypot(_TURN, _TURN_OF_DEGREE / degree[clear])
    weight = 1 / sigma**2 / (1 + (sine / (_ROBUST * sigma)) ** 2)
    # The cell's normal is down × right; a corner's growth moves the corner along its ray.
    of_right, of_down = np.cross(plane, down[which]), np.cross(right[which], plane)
    values, columns = [], []
    for (_, _, to_right, to_down), corner, number in zip(_CORNERS, corners, cells.of_corner, strict=True):
        values.append((corner[which] * (to_right * of_right + to_down * of_down)).sum(1) / size)
        columns.append(number[which])
    numbers = np.tile(np.arange(len(which)), len(_CORNERS))
    shape = (len(which), cells.unknowns)
    rows = scipy("sparse").csr_matrix((np.concatenate(values), (numbers, np.concatenate(columns))), shape)
    return rows, weight, sine


def _steps(corners: list[Floats]) -> tuple[Floats, Floats]:
    """Steps across the middle of each cell, to the right and down."""
    along = [(_CORNERS[k][2], _CORNERS[k][3], corner) for k, corner in enumerate(corners)]
    right = np.sum([to_right * corner for to_right, _, corner in along], axis=0)
    down = np.sum([to_down * corner for _, to_down, corner in along], axis=0)
    return right, down


def _areas(corners: list[Floats]) -> Floats:
    """Normals of the cells towards the eye, with the cells' areas as lengths."""
    right, down = _steps(corners)
    return np.cross(down, right)


def _moved(view: View, growth: Floats) -> View:
    """The view with its depths changed by a growth (H×W), and normals that are means over the cells about each pixel."""
    height, width = view.depth.shape
    normals = np.empty_like(view.normals)
    for top, left in itertools.product(range(0, height, _TILE), range(0, width, _TILE)):
        window, inner = _around(top, left, 1)
        cells = _Cells(view, window)
        areas = _areas(cells.corners(growth[window][cells.pixels]))
        sums = np.zeros((*cells.pixels.shape, 3))
        for i, j, _, _ in _CORNERS:
            sums[cells.row + i, cells.column + j] += areas
        moved = np.where(cells.pixels[..., None], unit(sums), view.normals[window])
        normals[top : top + _TILE, left : left + _TILE] = moved[inner]
    return replace(view, depth=(view.depth * (1 + growth)).astype(np.float32), normals=normals)


def _around(top: int, left: int, beside: int) -> tuple[Window, Window]:
    """The window of a tile with a margin of `beside` pixels, and the tile within this window."""
    above, before = min(top, beside), min(left, beside)
    window = (slice(top - above, top + _TILE + beside), slice(left - before, left + _TILE + beside))
    return window, (slice(above, above + _TILE), slice(before, before + _TILE))


def _grid_points(view: View, window: Window) -> Floats:
    """World points of the pixels in a window."""
    rows, columns = (range(*part.indices(size)) for part, size in zip(window, view.depth.shape, strict=True))
    return view.points_at(*np.meshgrid(rows, columns, indexing="ij"))

"""Detail that stereo smoothed away comes back as far as the phases of several stations ask for it.

A phase of polarization says that the normal lies in one plane: that of the viewing ray and the phase's direction where the body's own light
is polarized, and the one across it where a mirror image is (multi-view azimuth stereo: Cao et al. 2023). Every station that sees a
place says so of its normal, whatever its prior. Each station's depths are moved, by little and smoothly, until as many of these planes
as can be hold the normals. That is done in tiles, which a move does not reach far across.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.object.views import LEAST_COSINE, Bools, Floats, View
from malus.workspace import Workspace

Ints = NDArray[np.int64]
Window = tuple[slice, slice]

#: The surface is held to its own standard deviation, between these (GSD), and what moves to that of its second differences (GSD).
_PLACE_GSD, _BEND_GSD = (0.2, 1.0), 0.3
#: Standard deviation of the sine between a normal and a phase's plane: what light between parts turns it, and that over the degree.
_TURN, _TURN_OF_DEGREE = 0.08, 0.0012
#: Beyond this many of them a phase counts less and less (Cauchy).
_ROBUST = 2.0
#: Phases of a smaller degree say nothing, and those that could be of either kind: the normal must be nearer to one plane by this factor.
_LEAST_DEGREE, _CLEARER = 0.003, 2.0
#: A station of which fewer phases are clear says nothing: of phases that have nothing to do with the surface 59 % are.
_LEAST_CLEAR = 0.7
#: Side of a tile, and what is taken along beside it (pixels).
_TILE, _BESIDE = 512, 32
#: Gauss–Newton steps, and what the system is solved to.
_STEPS, _TOLERANCE, _MOST_ITERATIONS = 3, 1e-3, 300
#: Pixels farther apart in depth (GSD) do not belong to one surface.
_STEP_GSD = 6.0
#: Corners of a cell of four pixels: row, column, and their parts in the steps to the right and down across its middle.
_CORNERS = ((0, 0, -0.5, -0.5), (0, 1, 0.5, -0.5), (1, 0, -0.5, 0.5), (1, 1, 0.5, 0.5))


@dataclass(frozen=True)
class Phases:
    """Polarization of a station: degree times cosine and sine of twice the phase, 2×H×W; zero where it is not known."""

    maps: Floats

    @staticmethod
    def of(workspace: Workspace) -> Phases:
        """That of a finished workspace."""
        degree, phase = (
            workspace.raster(f"polarization/{name}.tif").astype(np.float64) for name in ("degree", "phase")
        )
        return Phases(np.nan_to_num(np.stack([degree * np.cos(2 * phase), degree * np.sin(2 * phase)])))

    def planes(self, view: View, points: Floats) -> tuple[Floats, Floats]:
        """Degree (N) of the light that comes from world points (N×3), and the unit normals of the planes (2×N×3) that their
        surface's normals lie in: if the body's own light is polarized, if a mirror image is.
        """
        ndimage = extra("scipy.ndimage", "scipy", "the surface of an object", "object")
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
    """Part of a view's surface as cells of four neighboring pixels. Unknowns are what its pixels' depths grow by, as shares of them."""

    def __init__(self, view: View, window: Window) -> None:
        usable, depth = view.usable[window], view.depth[window]
        whole = usable[:-1, :-1] & usable[1:, :-1] & usable[:-1, 1:] & usable[1:, 1:]
        four = np.stack([depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]])
        whole[whole] = np.ptp(four[:, whole], axis=0) < _STEP_GSD * view.gsd
        self.row, self.column = np.nonzero(whole)
        self.pixels = np.zeros(usable.shape, bool)
        for i, j, _, _ in _CORNERS:
            self.pixels[self.row + i, self.column + j] = True
        self.number = np.full(usable.shape, -1)
        self.number[self.pixels] = np.arange(int(self.pixels.sum()))
        self.eye = view.eye
        self._from_eye = view.points[window] - view.eye
        self.of_corner = [self.number[self.row + i, self.column + j] for i, j, _, _ in _CORNERS]
        #: Standard deviation of each pixel's place across the surface, in GSD.
        self.sigma = np.clip(view.sigma[window][self.pixels] / view.gsd, *_PLACE_GSD)
        #: How far a pixel moves across the surface as its depth grows by its whole, in GSD.
        self.across = np.linalg.norm(self._from_eye[self.pixels], axis=1) * view.cosine[window][self.pixels] / view.gsd

    @property
    def unknowns(self) -> int:
        return len(self.across)

    def corners(self, growth: Floats) -> list[Floats]:
        """Where the cells' four corners (N×3 each) lie from the eye."""
        return [
            self._from_eye[self.row + i, self.column + j] * (1 + growth[number])[:, None]
            for (i, j, _, _), number in zip(_CORNERS, self.of_corner, strict=True)
        ]

    def bends(self) -> Any:
        """Sparse matrix: second differences of pixels in rows and columns."""
        sparse = extra("scipy.sparse", "scipy", "the surface of an object", "object")
        parts = []
        for number in (self.number, self.number.T):
            line = np.stack([number[:-2], number[1:-1], number[2:]], -1).reshape(-1, 3)
            parts.append(line[(line >= 0).all(1)])
        lines = np.concatenate(parts)
        rows = np.repeat(np.arange(len(lines)), 3)
        values = np.tile([1.0, -2.0, 1.0], len(lines))
        return sparse.csr_matrix((values, (rows, lines.ravel())), (len(lines), self.unknowns))


def telling(views: Sequence[View], phases: Sequence[Phases]) -> list[tuple[View, Phases]]:
    """The stations whose phases have to do with their surfaces."""
    return [(view, known) for view, known in zip(views, phases, strict=True) if _tells(view, known)]


def sharpened(views: Sequence[View], stations: Sequence[tuple[View, Phases]]) -> list[View]:
    """The views with their depths and normals moved to what the phases of stations ask for; `usable` stays as it is."""
    return [_sharpened(view, stations) for view in views] if stations else list(views)


def _tells(view: View, phases: Phases) -> bool:
    """Whether the phases have to do with the station's own surface."""
    degree, planes = phases.planes(view, view.points[view.usable])
    strong = degree > _LEAST_DEGREE
    clear = _clear(np.abs((planes * view.normals[view.usable]).sum(-1)))
    return bool(clear[strong].mean() > _LEAST_CLEAR) if strong.any() else False


def _clear(off: Floats) -> Bools:
    """Which normals are clearly nearer to one of two planes; `off`: sine between them and each plane, 2×N."""
    return np.asarray(_CLEARER * off.min(0) < off.max(0))


def _sharpened(view: View, stations: Sequence[tuple[View, Phases]]) -> View:
    height, width = view.depth.shape
    growth = np.zeros((height, width))
    for top, left in itertools.product(range(0, height, _TILE), range(0, width, _TILE)):
        above, before = min(top, _BESIDE), min(left, _BESIDE)
        window = (slice(top - above, top + _TILE + _BESIDE), slice(left - before, left + _TILE + _BESIDE))
        cells = _Cells(view, window)
        if cells.unknowns:
            part = np.zeros(cells.pixels.shape)
            part[cells.pixels] = _growth(cells, view, stations)
            inner = part[above : above + _TILE, before : before + _TILE]
            growth[top : top + _TILE, left : left + _TILE] = inner
    return _moved(view, growth)


def _growth(cells: _Cells, view: View, stations: Sequence[tuple[View, Phases]]) -> Floats:
    """What the depths of the cells' pixels grow by."""
    sparse = extra("scipy.sparse", "scipy", "the surface of an object", "object")
    solvers = extra("scipy.sparse.linalg", "scipy", "the surface of an object", "object")
    growth = np.zeros(cells.unknowns)
    asked = _asked(cells, view, stations)
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


def _asked(cells: _Cells, view: View, stations: Sequence[tuple[View, Phases]]) -> list[tuple[Ints, Floats, Floats]]:
    """Of each station the cells that it sees, the degree of polarization there, and the two planes."""
    corners = cells.corners(np.zeros(cells.unknowns))
    points = cells.eye + sum(corners) / 4
    normals = _unit(_areas(corners))
    asked = []
    for station, phases in stations:
        at = station.meet(points)
        near = np.abs((at.normals * (at.points - points)).sum(1)) < 2 * station.gsd
        which = np.flatnonzero((at.weight > 0) & near & (station.facing(points, normals) > LEAST_COSINE))
        asked.append((which, *phases.planes(station, points[which])))
    return asked


def _equations(
    cells: _Cells, corners: list[Floats], which: Ints, degree: Floats, planes: Floats
) -> tuple[Any, Floats, Floats]:
    """What one station asks of the unknowns: rows, weights, and how far off the normals are, for the cells whose phase is clear."""
    sparse = extra("scipy.sparse", "scipy", "the surface of an object", "object")
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
    # The cell's normal is down × right; a corner's growth moves it along its ray.
    of_right, of_down = np.cross(plane, down[which]), np.cross(right[which], plane)
    values, columns = [], []
    for (_, _, to_right, to_down), corner, number in zip(_CORNERS, corners, cells.of_corner, strict=True):
        values.append((corner[which] * (to_right * of_right + to_down * of_down)).sum(1) / size)
        columns.append(number[which])
    numbers = np.tile(np.arange(len(which)), len(_CORNERS))
    shape = (len(which), cells.unknowns)
    return sparse.csr_matrix((np.concatenate(values), (numbers, np.concatenate(columns))), shape), weight, sine


def _steps(corners: list[Floats]) -> tuple[Floats, Floats]:
    """Across the middle of each cell, to the right and down."""
    along = [(_CORNERS[k][2], _CORNERS[k][3], corner) for k, corner in enumerate(corners)]
    right = np.sum([to_right * corner for to_right, _, corner in along], axis=0)
    down = np.sum([to_down * corner for _, to_down, corner in along], axis=0)
    return right, down


def _areas(corners: list[Floats]) -> Floats:
    """Normals of the cells towards the eye, as long as the cells are large."""
    right, down = _steps(corners)
    return np.cross(down, right)


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30))


def _moved(view: View, growth: Floats) -> View:
    """The view with depths that grew (H×W), and normals that are means of the cells about each pixel."""
    whole = (slice(None), slice(None))
    cells = _Cells(view, whole)
    areas = _areas(cells.corners(growth[cells.pixels]))
    sums = np.zeros(view.normals.shape)
    for i, j, _, _ in _CORNERS:
        sums[cells.row + i, cells.column + j] += areas
    return replace(
        view,
        depth=view.depth * (1 + growth),
        points=view.eye + (view.points - view.eye) * (1 + growth)[..., None],
        normals=np.where(cells.pixels[..., None], _unit(sums), view.normals),
    )

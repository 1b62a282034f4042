"""Registration of a reference scan in any pose to a surface, without a rough placement by hand.

Both are compared as elevation maps. The reference is viewed from many directions and turned in steps. Each placement where its
elevations correlate best with those of the surface (masked normalized correlation by FFT, Padfield 2012) is a candidate. The best
candidates are refined by point-to-plane steps on the maps. If one fits clearly better than every other, it is the result. Otherwise
the reference is another object, or its shape does not determine its turn, and a DataError is raised. `malus assess` then
aligns the surfaces precisely.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_rows
from malus._files import resolved, write_text
from malus._robust import robust_spread
from malus.errors import DataError
from malus.object.ply import columns, write_ply
from malus.workspace import Workspace

#: Cells across the surface, and points of the reference, in the search.
_CELLS, _SEARCH_POINTS = 40, 20_000
#: Number of directions from which a solid reference is viewed, in addition to the two normals of its flattest side; and the steps
#: between turns for these directions and for the two normals.
_DIRECTIONS, _TURN_STEP_DEG, _FLAT_TURN_STEP_DEG = 60, 10.0, 5.0
#: A reference thinner than this share of its length is flat: it is viewed from its two sides only.
_FLAT = 0.1
#: Number of candidates that are refined, their steps, and cells across the surface in the refinement.
_CANDIDATES, _STEPS, _FINE_CELLS = 12, 25, 128
#: Two placements are the same if they differ by less than this: degrees, and share of the surface's length.
_SAME_TURN_DEG, _SAME_SHIFT = 8.0, 0.05
#: Conditions for a placement: the least correlation r of the elevations, and the largest ratio of its 1 − r to the 1 − r of the
#: next best placement. The third number is added to its 1 − r: the loss that the grids cause even at the right placement.
_LEAST_CORRELATION, _MOST_OF_NEXT, _OF_GRIDS = 0.7, 0.6, 5e-4
#: Elevations are clipped to these percentiles, because otherwise a few pixels on the wall of a rim would outweigh all relief.
_PERCENTILES = (2, 98)
#: Share of the surface's cells that the reference must cover.
_LEAST_COVER = 0.5

#: Approximate number of points of the surface and of the reference that are used.
_SURFACE_POINTS, _REFERENCE_POINTS = 20_000, 100_000

#: The fraction of which every multiple lies in the largest gap between those before it.
_GOLDEN = (5**0.5 - 1) / 2

Points = NDArray[np.float64]
Grid = NDArray[np.float64]


@dataclass(frozen=True)
class Placement:
    """x_in_surface = rotation · x_in_reference + translation, and how well the elevations then agree."""

    rotation: Points
    translation: Points
    correlation: float
    #: Correlation of the best different placement.
    next_best: float


@dataclass(frozen=True)
class _Candidate:
    correlation: float
    rotation: Points  # of the reference into the surface's plane frame
    translation: Points


def place_reference(surface: ArrayLike, towards_camera: ArrayLike, reference: ArrayLike) -> Placement:
    """The motion that takes a reference onto a surface; both metric, in one unit.

    surface: N×3 points, evenly spread, of one side of an object; towards_camera: 3, direction from that side to the camera;
    reference: M×3 points of the same side or of the whole object, at least as dense. Raises DataError if no placement fits clearly
    better than all others.
    """
    points, scan = _checked(surface, "surface"), _checked(reference, "reference")
    frame, middle = _plane_frame(points, np.asarray(towards_camera, dtype=float))
    local = (points - middle) @ frame.T
    length = float(np.ptp(local[:, :2], axis=0).max())
    center = scan.mean(0)
    moved = scan - center
    candidates = _search(local, moved, length / _CELLS)
    cell = max(length / _FINE_CELLS, 2 * _spacing(moved, candidates, length / _CELLS))
    refined = sorted((_refined(local, moved, c, cell) for c in candidates), key=lambda c: -c.correlation)
    best = refined[0] if refined else None
    others = [c.correlation for c in refined[1:] if best is not None and not _same(best, c, length)]
    next_best = max(others, default=0.0)
    least_left = _MOST_OF_NEXT * (1 - next_best)
    if best is None or best.correlation < _LEAST_CORRELATION or 1 - best.correlation + _OF_GRIDS > least_left:
        found = 0.0 if best is None else max(best.correlation, 0.0)
        raise DataError(
            f"no place of the reference stands out: its elevations correlate by {found:.2f} at best (expected more than "
            f"{_LEAST_CORRELATION}) and by {next_best:.2f} at another place. It is another object or in another unit, or its shape "
            "looks alike in several directions"
        )
    # From the frame of the plane back to the world frame.
    rotation = frame.T @ best.rotation
    translation = frame.T @ best.translation + middle - rotation @ center
    return Placement(rotation, translation, best.correlation, next_best)


def register_reference(work: str | Path, reference: str | Path) -> Path:
    """Register a reference (PLY or XYZ, station unit) in any pose to the surface of a workspace; of a mesh, its vertices find the place.

    Writes WORK/reference/registered.ply, the cloud or mesh in the world frame of the station, and registration.json, with the motion
    and the correlation of the elevations. Returns the path of registered.ply. Raises InputError for a file that cannot be read,
    DataError if no placement fits clearly better than all others.
    """
    workspace = Workspace(work)
    scan, triangles = _core.read_cloud_or_mesh(str(reference))
    rotation, translation = workspace.pose
    points = workspace.points().reshape(-1, 3)
    points = points[np.isfinite(points).all(1)]
    points = _some(points, _SURFACE_POINTS)
    towards_camera = -rotation.T @ translation - points.mean(0)
    try:
        placement = place_reference(points, towards_camera, _some(scan, _REFERENCE_POINTS))
    except DataError as error:
        raise DataError(f"{reference}: {error}; place it by hand and leave --register out") from None
    figures = {
        "reference": str(reference),
        "rotation": placement.rotation.tolist(),
        "translation": placement.translation.tolist(),
        "correlation": placement.correlation,
        "next_best": placement.next_best,
    }
    moved = scan @ placement.rotation.T + placement.translation
    folder = workspace.folder / "reference"
    folder.mkdir(exist_ok=True)
    write_ply(folder / "registered.ply", columns("xyz", moved, "f8"), triangles, "reference moved onto the surface")
    write_text(folder / "registration.json", json.dumps(figures, indent=2) + "\n")
    return folder / "registered.ply"


def forget_registration(work: str | Path, reference: str | Path | None) -> None:
    """Remove what an earlier run registered, or read from a file of another format, unless it is the `reference` of this one, too: it
    would look like part of this result.
    """
    folder = Path(work) / "reference"
    compared = None if reference is None else resolved(reference)
    if compared == resolved(folder / "registered.ply"):
        return
    for name in ("registered.ply", "registration.json", "scan.ply"):
        if compared != resolved(folder / name):
            (folder / name).unlink(missing_ok=True)
    with suppress(OSError):  # other files are in it, or it never was
        folder.rmdir()


def _checked(values: ArrayLike, name: str) -> Points:
    points: Points = as_rows(values, name)
    points = points[np.isfinite(points).all(1)]
    if len(points) < 100:
        raise DataError(f"{name} has {len(points)} points, expected 100 or more to find its place")
    return points


def some_of(count: int, most: int) -> NDArray[np.intp]:
    """Numbers of about `most` of `count` points (less than twice as many), one of every run of equally many.

    Its place in the run varies. Points are often in the order of a grid: of a surface 6000 pixels wide, every 1200th point lies in one
    of five columns.
    """
    run = max(1, count // most)
    start = np.arange(0, count - run + 1, run)
    return np.asarray(start + (run * (np.arange(len(start)) * _GOLDEN % 1)).astype(int))


def _some(points: Points, most: int) -> Points:
    return np.asarray(points[some_of(len(points), most)])


def _plane_frame(points: Points, towards_camera: Points) -> tuple[Points, Points]:
    """Axes as rows (two in the fitted plane, and its normal on the camera's side), and the mean of the points."""
    middle = points.mean(0)
    axes = np.linalg.svd(_some(points - middle, _SEARCH_POINTS), full_matrices=False)[2]
    normal = axes[2] * np.sign(axes[2] @ towards_camera or 1.0)
    return np.stack([axes[0], np.cross(normal, axes[0]), normal]), middle


def _directions(scan: Points) -> list[tuple[Points, float]]:
    """Frames (axes as rows, the last one towards the viewer) in which a reference, centered on its mean, is viewed, each with the
    step between its turns in degrees.
    """
    _, extents, axes = np.linalg.svd(_some(scan, _SEARCH_POINTS), full_matrices=False)
    normals = [axes[2], -axes[2]]
    if extents[2] > _FLAT * extents[0]:
        k = np.arange(_DIRECTIONS) + 0.5
        z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
        normals += list(np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1))
    frames = []
    for number, normal in enumerate(normals):
        right = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        right /= np.linalg.norm(right)
        step = _FLAT_TURN_STEP_DEG if number < 2 else _TURN_STEP_DEG
        frames.append((np.stack([right, np.cross(normal, right), normal]), step))
    return frames


def _about_z(angle: float) -> Points:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _elevations(points: Points, cell: float) -> tuple[Grid, Points]:
    """Largest z in each cell of a grid over x (columns) and y (rows), NaN = none; and x, y of the first cell's center."""
    origin = points[:, :2].min(0)
    column, row = np.rint((points[:, :2] - origin) / cell).astype(int).T
    grid = np.full((row.max() + 1, column.max() + 1), -np.inf)
    np.maximum.at(grid, (row, column), points[:, 2])
    return np.where(np.isfinite(grid), grid, np.nan), origin


def _relief(grid: Grid) -> Grid:
    """Elevations above the fitted plane, with outliers clipped."""
    row, column = np.nonzero(np.isfinite(grid))
    design = np.stack([row, column, np.ones(len(row))], -1)
    values = grid[row, column] - design @ np.linalg.lstsq(design, grid[row, column], rcond=None)[0]
    result = np.full_like(grid, np.nan)
    result[row, column] = np.clip(values, *np.percentile(values, _PERCENTILES))
    return result


class _Correlator:
    """Masked normalized correlation of one grid with other grids at every shift."""

    def __init__(self, grid: Grid, largest: tuple[int, int]) -> None:
        self._shape = (grid.shape[0] + largest[0], grid.shape[1] + largest[1])
        known = np.isfinite(grid)
        values = np.where(known, grid, 0)
        self._count = known.sum()
        self._of = [np.fft.rfft2(part, self._shape).conj() for part in (known, values, values**2)]

    def best(self, other: Grid) -> tuple[float, int, int]:
        """Largest correlation, and the shift (rows, columns) of this grid in the other grid at which it occurs."""
        known = np.isfinite(other)
        values = np.where(known, other, 0)
        of = [np.fft.rfft2(part, self._shape) for part in (known, values, values**2)]

        def product(own: int, others: int) -> Grid:
            return np.fft.irfft2(self._of[own] * of[others], self._shape)

        count = np.maximum(product(0, 0), 1e-9)
        own_mean, other_mean = product(1, 0) / count, product(0, 1) / count
        own_variance = product(2, 0) / count - own_mean**2
        other_variance = product(0, 2) / count - other_mean**2
        covariance = product(1, 1) / count - own_mean * other_mean
        floor = 1e-9 * (own_variance.max() * other_variance.max()) ** 0.5
        with np.errstate(invalid="ignore"):
            correlation = covariance / np.sqrt(np.maximum(own_variance * other_variance, floor**2))
        correlation[(count < _LEAST_COVER * self._count) | (np.minimum(own_variance, other_variance) <= 0)] = -1
        row, column = np.unravel_index(np.argmax(correlation), self._shape)
        value = float(correlation[row, column])
        # The FFT is periodic: shifts beyond the other grid are negative shifts.
        rows, columns = other.shape
        return (
            value,
            int(row - self._shape[0] if row >= rows else row),
            int(column - self._shape[1] if column >= columns else column),
        )


def _search(local: Points, scan: Points, cell: float) -> list[_Candidate]:
    """The best placements among all directions and turns, without duplicates."""
    scan = _some(scan, _SEARCH_POINTS)
    grid, origin = _elevations(local, cell)
    diagonal = int(np.ceil(2 * np.linalg.norm(scan, axis=1).max() / cell)) + 2
    if diagonal > 40 * _CELLS:
        raise DataError(
            f"the reference is {diagonal / _CELLS:.0f} times as large as the surface, expected the same object in the same unit"
        )
    correlator = _Correlator(_relief(grid), (diagonal, diagonal))
    found: list[_Candidate] = []
    for frame, step in _directions(scan):
        for turn in np.radians(np.arange(0, 360, step)):
            rotation = _about_z(turn) @ frame
            turned = scan @ rotation.T
            other, other_origin = _elevations(turned, cell)
            value, row, column = correlator.best(_relief(other))
            shift = origin - (other_origin + cell * np.array([column, row]))
            found.append(_Candidate(value, rotation, np.array([*shift, 0.0])))
    length = cell * _CELLS
    kept: list[_Candidate] = []
    for candidate in sorted(found, key=lambda c: -c.correlation):
        if not any(_same(candidate, other, length) for other in kept):
            kept.append(candidate)
        if len(kept) == _CANDIDATES:
            break
    return kept


def _spacing(scan: Points, candidates: list[_Candidate], cell: float) -> float:
    """Mean distance of the reference's points in the view of the best candidate; finer cells would have holes."""
    if not candidates:
        return 0.0
    grid, _ = _elevations(scan @ candidates[0].rotation.T, cell)
    return float(cell * np.sqrt(np.isfinite(grid).sum() / len(scan)))


def _refined(local: Points, scan: Points, start: _Candidate, cell: float) -> _Candidate:
    """The candidate after point-to-plane steps between the surface and the reference's elevations, with its final correlation."""
    rotation, translation = start.rotation, start.translation
    points = _some(local, _SURFACE_POINTS)
    correlation = -1.0
    for step in range(_STEPS + 1):
        turned = scan @ rotation.T + translation
        grid, origin = _elevations(turned, cell)
        gradient = np.gradient(grid, cell)
        column, row = np.rint((points[:, :2] - origin) / cell).astype(int).T
        inside = (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
        row, column, at = row[inside], column[inside], points[inside]
        slope = np.stack([gradient[1][row, column], gradient[0][row, column]], -1)
        # Interpolate the reference's elevation at the point itself, not at its cell's center.
        beside = at[:, :2] - (origin + cell * np.stack([column, row], -1))
        elevation = grid[row, column] + (slope * beside).sum(1)
        known = np.isfinite(elevation)
        if known.sum() < max(50, _LEAST_COVER * len(points)):
            return _Candidate(-1.0, rotation, translation)
        at, slope, elevation = at[known], slope[known], elevation[known]
        if step == _STEPS:
            correlation = _correlation(at, elevation)
            break
        if step == 0:
            translation = translation + np.array([0, 0, float(np.median(at[:, 2] - elevation))])
            continue
        turn, shift = _step(at, slope, at[:, 2] - elevation)
        rotation, translation = turn @ rotation, turn @ translation + shift
    return _Candidate(correlation, rotation, translation)


def _step(at: Points, slope: Points, off: NDArray[np.float64]) -> tuple[Points, Points]:
    """Small motion of the reference that takes its elevations towards the points; off: height of the points above the reference."""
    normal = np.column_stack([-slope, np.ones(len(slope))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = off * normal[:, 2]
    limit = 4.685 * robust_spread(distance) + 1e-12
    weight = np.maximum(0, 1 - (distance / limit) ** 2) ** 2
    # Turns in units of the surface's size: with coordinates of tens of thousands, as in micrometers, shifts would be cut off as not
    # determined.
    size = float(np.sqrt((at**2).sum(1).mean())) or 1.0
    rows = np.column_stack([np.cross(at / size, normal), normal])
    matrix = rows.T @ (weight[:, None] * rows)
    # A little damping: motions that the shape does not determine, such as the turn of a disk, stay zero.
    matrix[np.diag_indices(6)] *= 1 + 1e-6
    motion = np.linalg.lstsq(matrix, rows.T @ (weight * distance), rcond=1e-9)[0]
    motion[:3] /= size
    angle = float(np.linalg.norm(motion[:3]))
    turn = np.eye(3)
    if angle > 0:
        x, y, z = motion[:3] / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn, motion[3:]


def _correlation(at: Points, elevation: NDArray[np.float64]) -> float:
    """Correlation of two elevations at the same points, after the plane fitted to the first is subtracted from both and outliers
    are clipped.
    """
    design = np.column_stack([at[:, :2], np.ones(len(at))])
    plane = design @ np.linalg.lstsq(design, at[:, 2], rcond=None)[0]
    a, b = at[:, 2] - plane, elevation - plane
    low, high = np.percentile(a, _PERCENTILES)
    a, b = np.clip(a, low, high), np.clip(b, low, high)
    a, b = a - a.mean(), b - b.mean()
    return float((a @ b) / max(np.sqrt((a @ a) * (b @ b)), 1e-300))


def _same(a: _Candidate, b: _Candidate, length: float) -> bool:
    cosine = (np.trace(a.rotation @ b.rotation.T) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return bool(turn < _SAME_TURN_DEG and np.linalg.norm(a.translation - b.translation) < _SAME_SHIFT * length)

"""Overlapping stations at the same places: weighted means of their surfaces, and how well the surfaces agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from malus.object.arrays import chunks
from malus.object.levels import FINEST
from malus.object.views import ALIKE, LEAST_COSINE, Bools, Floats, View, scipy, unit

#: Least cosine between the normals of one surface: below it, two surfaces are the sides of something thin, or one of them is wrong.
_LEAST_FACING = 0.5
#: Surfaces farther apart than this many standard deviations are not measurements of the same surface.
_MOST_RATIO = 4.0
#: A place that only one station sees may be a rim. It must face the station (least cosine), or stereo must support it: at least
#: _WITNESSES of the _OF_NEAREST nearest cloud points lie within _WITNESS_GSD (GSD), and within _WITNESS_ACROSS_GSD along the normal.
_LEAST_COSINE_ALONE = 0.5
_WITNESSES, _OF_NEAREST, _WITNESS_GSD, _WITNESS_ACROSS_GSD = 2, 6, 4.0, 2.0
#: A point is an outlier unless at least this share of its nearest _NEIGHBORS points continues its surface.
_NEIGHBORS, _LEAST_TOGETHER = 8, 0.6
#: A station's point is dropped if another station has a weight there that is larger by more than this factor.
_SURER = 1.5
#: About the largest sample of points in statistics: distances between stations, and whether a contour holds the whole object.
_MOST_COMPARED = 1_000_000
#: If less than this share of the stations' points in an image lie outside its contour, the contour holds the whole object there.
_MOST_BESIDE = 0.01
#: A point is dropped if a point of a finer level lies beside it, within so many of its own pixels along and across the surface: a finer
#: station saw the place.
_BESIDE_FINER, _ACROSS_FINER = 1.0, 2.0
#: A lattice's cells are halved until they are no larger than this many pixels.
_LARGEST_CELL = 4 / 3
#: Pixels more than this many times larger than the object's GSD count as so large. Pixels too small for the finest cells count as larger
#: ones, too: their points' weights would not reach from node to node of the lattice, and the surface would have holes.
_LARGEST_SCALE, _SMALLEST_SCALE = 12.0, 0.5**FINEST / _LARGEST_CELL


@dataclass(frozen=True)
class OrientedPoints:
    """points, normals: N×3, world. sigma: N, one standard deviation along the normal. stations: N, number of stations that see the
    place; 0 for points of stereo alone. scale: N, side of the pixels that measured the place, in GSD of the object (the median of its
    stations'); None if it is 1 for all.
    """

    points: Floats
    normals: NDArray[np.floating]
    sigma: NDArray[np.floating]
    stations: NDArray[np.integer]
    scale: NDArray[np.floating] | None = None

    def select(self, chosen: Bools | NDArray[np.integer] | slice) -> OrientedPoints:
        """Some of the points, by mask, number or slice."""
        return OrientedPoints(
            self.points[chosen], self.normals[chosen], self.sigma[chosen], self.stations[chosen],
            None if self.scale is None else self.scale[chosen],
        )  # fmt: skip

    def scales(self) -> NDArray[np.floating]:
        """`scale` as numbers (N)."""
        return np.ones(len(self.points)) if self.scale is None else self.scale

    def levels(self) -> NDArray[np.int64]:
        """How often a cell of one GSD is halved to be as fine as the pixels that measured the place (N); negative for larger pixels."""
        return np.asarray(np.ceil(-np.log2(self.scales() * _LARGEST_CELL)), np.int64)


def joined(parts: Sequence[OrientedPoints]) -> OrientedPoints:
    """All points of several sets, in their order; 42 bytes each (46 with `scale`), as there may be tens of millions."""
    empty = OrientedPoints(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0, np.int64))
    together = [empty, *parts]
    return OrientedPoints(
        np.concatenate([part.points for part in together]),
        np.concatenate([part.normals for part in together], dtype=np.float32),
        np.concatenate([part.sigma for part in together], dtype=np.float32),
        np.concatenate([part.stations for part in together], dtype=np.uint16, casting="unsafe"),
        None
        if all(part.scale is None for part in together)
        else np.concatenate([part.scales() for part in together], dtype=np.float32),
    )


@dataclass(frozen=True)
class Agreement:
    """Distances of the other stations' surfaces from the surface of one station, along this station's normals.

    view: the station. ratio: H×W, root mean square of distance over its stated standard deviation, NaN where no other station measured.
    distances, expected: N each, single distances and their standard deviations; for a large station only those of every n-th pixel.
    """

    view: str
    ratio: Floats
    distances: Floats
    expected: Floats


def combine(views: Sequence[View], cloud: OrientedPoints | None = None) -> tuple[OrientedPoints, list[Agreement]]:
    """The stations' surfaces as one set of points, each the mean of all stations that see it.

    A station's weight is the inverse of its usual variance times the cosine of its viewing angle at the place. The variances stated for
    single places are not used: they exaggerate the advantage of the frontal view (decision 90). The standard deviation of a mean is the
    mean of those stated, not smaller: stations share a prior, so their errors do not average out. A point is dropped if another
    station sees the surface behind it, or sees the place better. A station is not averaged into the detail of one with smaller pixels,
    nor does its weight count against it. `cloud`: stereo's points; they support places that one station alone
    sees at a flat angle and that could be rims.
    """
    parts, doubted, agreements = [], [], []
    for view, scale in zip(views, scales_of(views), strict=True):
        believed, doubtful, agreement = _with_others(view, [other for other in views if other is not view])
        parts.append(_of_scale(believed, scale))
        doubted.append(_of_scale(doubtful, scale))
        agreements.append(agreement)
    if cloud is not None and views:
        flat = joined(doubted)
        parts.append(flat.select(_found_by(cloud, flat, float(np.median([view.gsd for view in views])))))
    return joined(parts), agreements


def scales_of(views: Sequence[View]) -> list[float]:
    """Side of each view's pixels in GSD of the object, the median of the views', within what the lattice can show; 1 if it differs from
    that by less than a quarter.
    """
    gsd = float(np.median([view.gsd for view in views])) if views else 1.0
    sizes = [float(np.clip(view.gsd / gsd, _SMALLEST_SCALE, _LARGEST_SCALE)) for view in views]
    return [1.0 if 1 / ALIKE <= size <= ALIKE else size for size in sizes]


def _of_scale(points: OrientedPoints, scale: float) -> OrientedPoints:
    return points if scale == 1 else replace(points, scale=np.full(len(points.points), scale, np.float32))


def _with_others(view: View, others: Sequence[View]) -> tuple[OrientedPoints, OrientedPoints, Agreement]:
    """Means at the trusted places of a view, means at places that it alone sees and at too flat an angle, and the agreement of the others."""
    pixels = np.flatnonzero(view.usable)
    every = max(1, len(pixels) // _MOST_COMPARED)
    ratio = np.full(view.depth.size, np.nan)
    believed, doubtful, apart, expected = [], [], [np.empty(0)], [np.empty(0)]
    for rows in chunks(len(pixels)):
        means = _Means.of(view, pixels[rows], others, every)
        ratio[pixels[rows]] = means.ratio
        believed.append(means.points.select(means.kept & means.believed))
        doubtful.append(means.points.select(means.kept & ~means.believed))
        apart += means.apart
        expected += means.expected
    agreement = Agreement(view.name, ratio.reshape(view.depth.shape), np.concatenate(apart), np.concatenate(expected))
    return joined(believed), joined(doubtful), agreement


@dataclass(frozen=True)
class _Means:
    """Means of one view and the others at some of its pixels.

    kept: no other view contradicts the point or sees it better. believed: another view sees it too, or this one at a steep enough angle.
    ratio: as in `Agreement`. apart, expected: distances of the other surfaces and their standard deviations, one array for each view.
    """

    points: OrientedPoints
    kept: Bools
    believed: Bools
    ratio: Floats
    apart: list[Floats]
    expected: list[Floats]

    @staticmethod
    def of(view: View, pixels: NDArray[np.int64], others: Sequence[View], every: int) -> _Means:
        """The means at these pixels (flat indices). Single distances are kept at flat indices that are multiples of `every`."""
        points = view.points_at(*np.unravel_index(pixels, view.depth.shape))
        normals = view.normals.reshape(-1, 3)[pixels].astype(np.float64)
        sigma, cosine = (values.ravel()[pixels].astype(np.float64) for values in (view.sigma, view.cosine))
        usual = view.usual_sigma
        own = cosine / usual**2
        total, best = own.copy(), own.copy()
        moved = np.zeros(len(points))
        cosines, stated = cosine.copy(), cosine / sigma**2
        normal = normals * own[:, None]
        seen = np.ones(len(points), np.int64)
        squares, count = np.zeros(len(points)), np.zeros(len(points), np.int64)
        contradicted = np.zeros(len(points), bool)
        compared = pixels % every == 0
        distances, expected = [], []
        for other in others:
            if not other.may_see(points):
                continue
            at = other.meet(points)
            facing = (at.normals * normals).sum(-1)
            apart = at.off(points) / np.maximum(facing, _LEAST_FACING)
            spread = np.hypot(sigma, at.sigma)
            same = (at.weight > 0) & (facing > _LEAST_FACING) & (other.facing(points, normals) > LEAST_COSINE)
            finer = view.finer(cosine, other, at.weight)
            # What the other cannot resolve may lie as far from its surface as from that of a view with its pixels.
            farthest = 2 * (other.gsd if view.resolves_more(other) else view.gsd)
            near = same & (np.abs(apart) < max(_MOST_RATIO * float(np.hypot(usual, other.usual_sigma)), farthest))
            # Another station may only exclude a point that it sees at a better angle.
            contradicted |= other.in_front(points, _MOST_RATIO) & ~near & (at.weight > cosine)
            used = near & ~finer
            weight = np.where(used, at.weight / other.usual_sigma**2, 0.0)
            total += weight
            moved += np.where(used, weight * apart, 0)
            cosines += np.where(used, at.weight, 0)
            stated += np.where(used, at.weight / at.sigma**2, 0)
            normal += np.where(used[:, None], weight[:, None] * at.normals, 0)
            best = np.maximum(best, weight)
            seen += near
            counted = same & (np.abs(apart) < 3 * _MOST_RATIO * spread)
            squares += np.where(counted, (apart / spread) ** 2, 0)
            count += counted
            distances.append(apart[counted & compared])
            expected.append(spread[counted & compared])
        with np.errstate(invalid="ignore"):
            ratio = np.sqrt(squares / np.where(count > 0, count, np.nan))
        mean = OrientedPoints(
            points + normals * (moved / total)[:, None],
            unit(normal),
            np.sqrt(cosines / stated),
            seen,
        )
        believed = (seen > 1) | (cosine > _LEAST_COSINE_ALONE)
        return _Means(mean, ~contradicted & (_SURER * own >= best), believed, ratio, distances, expected)


def _found_by(cloud: OrientedPoints, points: OrientedPoints, gsd: float) -> NDArray[np.bool_]:
    """Which points lie on the surface of the cloud points near them."""
    if len(cloud.points) < _OF_NEAREST or not len(points.points):
        return np.zeros(len(points.points), bool)
    tree = scipy("spatial").cKDTree(cloud.points)
    found = np.zeros(len(points.points), bool)
    for rows in chunks(len(found)):
        some = points.select(rows)
        away, nearest = tree.query(some.points, _OF_NEAREST, workers=1)
        across, parallel = _continued(some, cloud, nearest)
        witness = parallel & (away < _WITNESS_GSD * gsd) & (np.abs(across) < _WITNESS_ACROSS_GSD * gsd)
        found[rows] = witness.sum(1) >= _WITNESSES
    return found


def _continued(points: OrientedPoints, others: OrientedPoints, which: NDArray[np.int64]) -> tuple[Floats, Bools]:
    """Distance of each point's neighbors (N×K, indices into `others`) from its tangent plane, and whether their normals agree with its own."""
    across = ((others.points[which] - points.points[:, None]) * points.normals[:, None]).sum(-1)
    return across, (others.normals[which] * points.normals[:, None]).sum(-1) > _LEAST_FACING


def unseen_stereo(cloud: OrientedPoints, views: Sequence[View], seen_points: OrientedPoints) -> OrientedPoints:
    """The points of a cloud at places that no station has measured.

    Points are dropped if a station sees the surface behind them, and if they lie on the ground: outside the object's contour for most
    stations, or for one station whose contour holds the whole object. Points near `seen_points`, the stations' points, are dropped,
    too: correct points there repeat the stations' surface, all others are errors.
    """
    whole = [_has_all(view, seen_points) for view in views]
    free = np.zeros(len(cloud.points), bool)
    for rows in chunks(len(free)):
        free[rows] = _unseen(cloud.select(rows), views, whole)
    if len(seen_points.points):
        away = scipy("spatial").cKDTree(seen_points.points).query(cloud.points[free], workers=1)[0]
        free[free] = away > _MOST_RATIO * cloud.sigma[free]
    return cloud.select(free)


def _unseen(cloud: OrientedPoints, views: Sequence[View], whole: Sequence[bool]) -> Bools:
    """Which points of a cloud are on the object, and measured or excluded by no view. whole: whether each view's contour holds the object."""
    points, normals, sigma = cloud.points, cloud.normals, cloud.sigma
    free = np.ones(len(points), bool)
    votes = np.zeros(len(points), np.int64)
    for view, has_all in zip(views, whole, strict=True):
        if not view.may_see(points):
            continue
        at = view.meet(points)
        spread = np.hypot(at.sigma, sigma)
        off = np.abs(at.off(points))
        seen = (at.weight > 0) & ((at.normals * normals).sum(-1) > _LEAST_FACING)
        near = np.linalg.norm(at.points - points, axis=1) < _MOST_RATIO * spread / LEAST_COSINE
        free &= ~(seen & near & (off < 2 * _MOST_RATIO * spread)) & ~view.in_front(points, _MOST_RATIO)
        inside, within = view.placed(points)
        votes += np.where(within, 1, -1) * inside
        if has_all:
            free &= within | ~inside
    return np.asarray(free & (votes > 0))


def _has_all(view: View, points: OrientedPoints) -> bool:
    """Whether the contour holds all of the object that the image shows. It does not if the station was to reconstruct a part only."""
    every = max(1, len(points.points) // _MOST_COMPARED)
    inside, within = view.placed(points.points[::every])
    return bool((inside & ~within).sum() < _MOST_BESIDE * inside.sum())


def without_coarser(points: OrientedPoints, gsd: float) -> OrientedPoints:
    """The points beside which no finer ones of the same surface lie: these would be blurred by them."""
    if points.scale is None:
        return points
    levels = points.levels()
    kept = np.ones(len(levels), bool)
    for level in np.unique(levels)[:-1]:
        finer = points.select(levels > level)
        tree = scipy("spatial").cKDTree(finer.points)
        coarser = np.flatnonzero(levels == level)
        for rows in chunks(len(coarser)):
            some = points.select(coarser[rows])
            near = tree.query(some.points, min(_NEIGHBORS, len(finer.points)), workers=1)[1].reshape(
                len(some.points), -1
            )
            apart = finer.points[near] - some.points[:, None]
            across = (apart * some.normals[:, None]).sum(-1)
            along = np.linalg.norm(apart - across[..., None] * some.normals[:, None], axis=-1)
            pixel = gsd * some.scales()[:, None]
            same = (finer.normals[near] * some.normals[:, None]).sum(-1) > 0
            beside = same & (along < _BESIDE_FINER * pixel) & (np.abs(across) < _ACROSS_FINER * pixel)
            kept[coarser[rows]] = ~beside.any(1)
    return points.select(kept)


def without_outliers(points: OrientedPoints, gsd: float) -> OrientedPoints:
    """The points that lie on a surface with most of their neighbors: nearly parallel, and in one plane to two of their pixels."""
    if len(points.points) <= _NEIGHBORS:
        return points
    tree = scipy("spatial").cKDTree(points.points)
    good = np.zeros(len(points.points), bool)
    for rows in chunks(len(good)):
        some = points.select(rows)
        near = tree.query(some.points, _NEIGHBORS + 1, workers=1)[1][:, 1:]
        across, parallel = _continued(some, points, near)
        good[rows] = (parallel & (np.abs(across) < 2 * gsd * some.scales()[:, None])).mean(1) >= _LEAST_TOGETHER
    return points.select(good)


def agreement_figures(agreements: Sequence[Agreement], gsd: float) -> dict[str, float | None]:
    """RMS of distance over standard deviation, share within two standard deviations, and RMS and median distance in GSD.

    Over all places that two stations see; None if there are none.
    """
    apart = np.concatenate([agreement.distances for agreement in agreements])
    expected = np.concatenate([agreement.expected for agreement in agreements])
    if not len(apart):
        return dict.fromkeys(("rms_ratio", "within_two_sigma", "rms_gsd", "median_gsd"))
    ratio = apart / expected
    return {
        "rms_ratio": float(np.sqrt((ratio**2).mean())),
        "within_two_sigma": float((np.abs(ratio) < 2).mean()),
        "rms_gsd": float(np.sqrt((apart**2).mean()) / gsd),
        "median_gsd": float(np.median(np.abs(apart)) / gsd),
    }

"""Overlapping stations at the same places: weighted means of their surfaces, and how well the surfaces agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.object.views import LEAST_COSINE, Floats, View

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
#: If less than this share of the stations' points in an image lie outside its contour, the contour holds the whole object there.
_MOST_BESIDE = 0.01


@dataclass(frozen=True)
class OrientedPoints:
    """points, normals: N×3, world. sigma: N, one standard deviation along the normal. stations: N, number of stations that see the
    place; 0 for points of stereo alone.
    """

    points: Floats
    normals: Floats
    sigma: Floats
    stations: NDArray[np.int64]

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> OrientedPoints:
        """Some of the points, by mask or number."""
        return OrientedPoints(self.points[chosen], self.normals[chosen], self.sigma[chosen], self.stations[chosen])


def joined(parts: Sequence[OrientedPoints]) -> OrientedPoints:
    """All points of several sets, in their order."""
    empty = OrientedPoints(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0, np.int64))
    together = [empty, *parts]
    return OrientedPoints(
        np.concatenate([part.points for part in together]),
        np.concatenate([part.normals for part in together]),
        np.concatenate([part.sigma for part in together]),
        np.concatenate([part.stations for part in together]),
    )


@dataclass(frozen=True)
class Agreement:
    """Distances of the other stations' surfaces from the surface of one station, along this station's normals.

    view: the station. ratio: H×W, root mean square of distance over its stated standard deviation, NaN where no other station measured.
    distances, expected: N each, every single distance and its standard deviation.
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
    station sees the surface behind it, or sees the place better. `cloud`: stereo's points; they support places that one station alone
    sees at a flat angle and that could be rims.
    """
    parts, doubted, agreements = [], [], []
    for view in views:
        believed, doubtful, agreement = _mean_with_others(view, [other for other in views if other is not view])
        parts.append(believed)
        doubted.append(doubtful)
        agreements.append(agreement)
    if cloud is not None and views:
        flat = joined(doubted)
        parts.append(flat.select(_found_by(cloud, flat, float(np.median([view.gsd for view in views])))))
    return joined(parts), agreements


def _usual_sigma(view: View) -> float:
    """Median standard deviation of a station's usable pixels; the GSD if there are none."""
    return float(np.median(view.sigma[view.usable])) if view.usable.any() else view.gsd


def _mean_with_others(view: View, others: Sequence[View]) -> tuple[OrientedPoints, OrientedPoints, Agreement]:
    """Means at the trusted places of a view, means at places that it alone sees and at too flat an angle, and the agreement of the others."""
    points, normals, sigma = (values[view.usable] for values in (view.points, view.normals, view.sigma))
    cosine, usual = view.cosine[view.usable], _usual_sigma(view)
    own = cosine / usual**2
    total, best = own.copy(), own.copy()
    moved = np.zeros(len(points))
    cosines, stated = cosine.copy(), cosine / sigma**2
    normal = normals * own[:, None]
    seen = np.ones(len(points), np.int64)
    squares, count = np.zeros(len(points)), np.zeros(len(points), np.int64)
    contradicted = np.zeros(len(points), bool)
    distances, expected = [], []
    for other in others:
        at = other.meet(points)
        facing = (at.normals * normals).sum(-1)
        apart = (at.normals * (at.points - points)).sum(-1) / np.maximum(facing, _LEAST_FACING)
        spread = np.hypot(sigma, at.sigma)
        same = (at.weight > 0) & (facing > _LEAST_FACING) & (other.facing(points, normals) > LEAST_COSINE)
        others_usual = _usual_sigma(other)
        near = same & (np.abs(apart) < max(_MOST_RATIO * float(np.hypot(usual, others_usual)), 2 * view.gsd))
        # Another station may only exclude a point that it sees at a better angle.
        contradicted |= other.in_front(points, _MOST_RATIO) & ~near & (at.weight > cosine)
        weight = np.where(near, at.weight / others_usual**2, 0.0)
        total += weight
        moved += np.where(near, weight * apart, 0)
        cosines += np.where(near, at.weight, 0)
        stated += np.where(near, at.weight / at.sigma**2, 0)
        normal += np.where(near[:, None], weight[:, None] * at.normals, 0)
        best = np.maximum(best, weight)
        seen += near
        counted = same & (np.abs(apart) < 3 * _MOST_RATIO * spread)
        squares += np.where(counted, (apart / spread) ** 2, 0)
        count += counted
        distances.append(apart[counted])
        expected.append(spread[counted])
    ratio = np.full(view.depth.shape, np.nan)
    with np.errstate(invalid="ignore"):
        ratio[view.usable] = np.sqrt(squares / np.where(count > 0, count, np.nan))
    mean = OrientedPoints(
        points + normals * (moved / total)[:, None],
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        np.sqrt(cosines / stated),
        seen,
    )
    believed = (seen > 1) | (cosine > _LEAST_COSINE_ALONE)
    kept = ~contradicted & (_SURER * own >= best)
    agreement = Agreement(view.name, ratio, np.concatenate(distances or [[]]), np.concatenate(expected or [[]]))
    return mean.select(kept & believed), mean.select(kept & ~believed), agreement


def _found_by(cloud: OrientedPoints, points: OrientedPoints, gsd: float) -> NDArray[np.bool_]:
    """Which points lie on the surface of the cloud points near them."""
    if len(cloud.points) < _OF_NEAREST or not len(points.points):
        return np.zeros(len(points.points), bool)
    spatial = extra("scipy.spatial", "scipy", "the surface of an object", "object")
    away, nearest = spatial.cKDTree(cloud.points).query(points.points, _OF_NEAREST, workers=1)
    across = ((cloud.points[nearest] - points.points[:, None]) * points.normals[:, None]).sum(-1)
    parallel = (cloud.normals[nearest] * points.normals[:, None]).sum(-1) > _LEAST_FACING
    witness = parallel & (away < _WITNESS_GSD * gsd) & (np.abs(across) < _WITNESS_ACROSS_GSD * gsd)
    return np.asarray(witness.sum(1) >= _WITNESSES)


def unseen_stereo(cloud: OrientedPoints, views: Sequence[View], seen_points: OrientedPoints) -> OrientedPoints:
    """The points of a cloud at places that no station has measured.

    Points are dropped if a station sees the surface behind them, and if they lie on the ground: outside the object's contour for most
    stations, or for one station whose contour holds the whole object. Points near `seen_points`, the stations' points, are dropped,
    too: correct points there repeat the stations' surface, all others are errors.
    """
    spatial = extra("scipy.spatial", "scipy", "the surface of an object", "object")
    points, normals, sigma = cloud.points, cloud.normals, cloud.sigma
    free = np.ones(len(points), bool)
    votes = np.zeros(len(points), np.int64)
    for view in views:
        at = view.meet(points)
        spread = np.hypot(at.sigma, sigma)
        off = np.abs((at.normals * (at.points - points)).sum(-1))
        seen = (at.weight > 0) & ((at.normals * normals).sum(-1) > _LEAST_FACING)
        near = np.linalg.norm(at.points - points, axis=1) < _MOST_RATIO * spread / LEAST_COSINE
        free &= ~(seen & near & (off < 2 * _MOST_RATIO * spread)) & ~view.in_front(points, _MOST_RATIO)
        inside, within = view.placed(points)
        votes += np.where(within, 1, -1) * inside
        if _has_all(view, seen_points):
            free &= within | ~inside
    free &= votes > 0
    if len(seen_points.points):
        away = spatial.cKDTree(seen_points.points).query(points[free], workers=1)[0]
        free[free] = away > _MOST_RATIO * sigma[free]
    return cloud.select(free)


def _has_all(view: View, points: OrientedPoints) -> bool:
    """Whether the contour holds all of the object that the image shows. It does not if the station was to reconstruct a part only."""
    inside, within = view.placed(points.points)
    return bool((inside & ~within).sum() < _MOST_BESIDE * inside.sum())


def without_outliers(points: OrientedPoints, gsd: float) -> OrientedPoints:
    """The points that lie on a surface with most of their neighbors: nearly parallel, and in one plane to two GSD."""
    if len(points.points) <= _NEIGHBORS:
        return points
    spatial = extra("scipy.spatial", "scipy", "the surface of an object", "object")
    near = spatial.cKDTree(points.points).query(points.points, _NEIGHBORS + 1, workers=1)[1][:, 1:]
    parallel = (points.normals[near] * points.normals[:, None]).sum(-1) > _LEAST_FACING
    across = ((points.points[near] - points.points[:, None]) * points.normals[:, None]).sum(-1)
    together = parallel & (np.abs(across) < 2 * gsd)
    return points.select(together.mean(1) >= _LEAST_TOGETHER)


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

"""Overlapping stations at the same places: weighted means of their surfaces, and how well the surfaces agree.

The library (cpp/malus/object) computes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.object.views import Bools, Floats, Singles, View
from malus.threads import ALL_CORES

#: The fields of OrientedPoints, as the library takes them.
_Arrays = tuple[Floats, NDArray[np.floating], NDArray[np.floating], NDArray[np.integer], NDArray[np.floating] | None]


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
        return _core.levels_of(self.scales())

    def arrays(self) -> _Arrays:
        """All fields, as the library takes them."""
        return self.points, self.normals, self.sigma, self.stations, self.scale


@dataclass(frozen=True)
class Agreement:
    """Distances of the other stations' surfaces from the surface of one station, along this station's normals.

    view: the station. ratio: H×W, root mean square of distance over its stated standard deviation, or the largest one that contradicts the
    place; NaN where no other station measured. distances, expected: N each, single distances and their standard deviations; if there are
    millions, only those of every n-th pixel. contradictions: number of other stations' surfaces, over all these pixels, that contradict the
    place: they lie more than twelve standard deviations away, and one of the two stations looks through the surface of the other.
    """

    view: str
    ratio: Singles
    distances: Floats
    expected: Floats
    contradictions: int


def combine(
    views: Sequence[View], cloud: OrientedPoints | None = None, *, threads: int = ALL_CORES
) -> tuple[OrientedPoints, list[Agreement]]:
    """The stations' surfaces as one set of points, each the mean of all stations that see it.

    A station's weight is the inverse of its usual variance times the cosine of its viewing angle at the place. The variances stated for
    single places are not used: they exaggerate the advantage of the frontal view (decision 90). The standard deviation of a mean is the
    mean of those stated, not smaller: stations share a prior, so their errors do not average out. A point is dropped if another
    station sees through it to a surface behind, or sees the place better. A station with larger pixels does not replace the points of
    one with smaller pixels; it moves and tilts them on average, without changing their detail. `cloud`: points of stereo. A place that
    only one station sees, at a flat angle, may be a rim: it is kept only if the cloud has a surface there, too.
    """
    points, agreements = _core.combine(
        [view.core for view in views], None if cloud is None else cloud.arrays(), threads
    )
    return OrientedPoints(*points), [Agreement(*one) for one in agreements]


def object_points(
    views: Sequence[View], clouds: Sequence[OrientedPoints], *, threads: int = ALL_CORES
) -> OrientedPoints:
    """Points of the object's surface: means over the stations (`combine`), and points of stereo's clouds where no station measured
    (`unseen_stereo`). Means beside those of a station with smaller pixels are left out, and so are outliers of both.
    """
    return OrientedPoints(
        *_core.object_points([view.core for view in views], [cloud.arrays() for cloud in clouds], threads)
    )


def unseen_stereo(
    cloud: OrientedPoints, views: Sequence[View], seen_points: OrientedPoints, *, threads: int = ALL_CORES
) -> OrientedPoints:
    """The points of a cloud at places that no station has measured.

    Points are dropped if a station sees the surface behind them, and if they lie on the ground: outside the object's contour for most
    stations, or for one station whose contour holds the whole object. Points near `seen_points`, the stations' points, are dropped,
    too: correct points there repeat the stations' surface, all others are errors.
    """
    kept = _core.unseen_stereo(cloud.arrays(), [view.core for view in views], seen_points.arrays(), threads)
    return OrientedPoints(*kept)


def agreements_of(views: Sequence[View], *, threads: int = ALL_CORES) -> Iterator[Agreement]:
    """Agreement with each view as `combine` gives it, one after the other: those of many large stations do not fit into memory together."""
    for which in range(len(views)):
        yield Agreement(*_core.agreement([view.core for view in views], which, threads))


def agreement_figures(agreements: Sequence[Agreement], gsd: float) -> dict[str, float | None]:
    """RMS of distance over standard deviation, share within two standard deviations, RMS and median distance in GSD, and the share of
    contradictions (`contradicted_fraction`), which count in none of the others.

    Over all places that two stations see; None if there are none.
    """
    return _core.agreement_figures([(one.distances, one.expected, one.contradictions) for one in agreements], gsd)

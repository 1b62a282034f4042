"""Color of places on an object, blended from the stations that see them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus.chart import srgb_bytes
from malus.object.arrays import chunks
from malus.object.views import Floats, Singles, View, may_see, scipy

_WHITE_PERCENTILE = 99.5
#: Most places, about, from which the gains and white are estimated.
_SAMPLE = 200000
#: A place that no station sees (between rims) gets the color of the nearest seen place within this many GSD.
_LENT_GSD = 10.0
#: If only each n-th place is searched, the nearest one may be farther away by this many times the square root of n - 1 GSD.
_APART_GSD = 2.0


@dataclass(frozen=True)
class _Lent:
    """Colors (N×C) of seen places, and a search tree of these places, for unseen places up to `reach` away."""

    tree: Any
    colors: Floats
    reach: float

    def to(self, points: Floats) -> Floats:
        """Color of the seen place nearest to each point, NaN if it is farther than `reach`."""
        away, nearest = self.tree.query(points, distance_upper_bound=self.reach, workers=1)
        near = np.isfinite(away)
        return np.asarray(np.where(near[:, None], self.colors[np.where(near, nearest, 0)], np.nan))


@dataclass(frozen=True)
class Paint:
    """How stations' images (H×W×C, linear) are blended. gains: a factor for each image. white: the value that is shown white. Unseen
    places get the color from `lent` if a seen place is near, else `missing` (C).
    """

    views: Sequence[View]
    images: Sequence[Singles]
    gains: Floats
    white: float
    missing: Floats
    lent: _Lent | None

    @staticmethod
    def of(views: Sequence[View], points: Floats, normals: Floats, images: Sequence[Singles] | None = None) -> Paint:
        """Gains, white and colors estimated on a surface with these points and normals (N×3). images: by default the stations' photographs."""
        pictures = [view.color for view in views] if images is None else images
        every = max(1, len(points) // _SAMPLE)
        some = slice(None, None, every)
        channels = max(image.shape[2] for image in pictures)
        weights, colors = _sights(points[some], normals[some], views, pictures, channels)
        gains = np.exp(_log_gains(weights, colors))
        mean = _mean(_of_finest(weights, views), colors * gains[:, None, None])
        seen = np.isfinite(mean).all(1)
        known = mean[seen]
        if not len(known):
            return Paint(views, pictures, gains, 1.0, np.full(colors.shape[2], 0.5), None)
        white = max(float(np.percentile(known, _WHITE_PERCENTILE)), 1e-12)
        reach = (_LENT_GSD + _APART_GSD * math.sqrt(every - 1)) * float(np.median([view.gsd for view in views]))
        lent = _Lent(scipy("spatial").cKDTree(points[some][seen]), known, reach)
        return Paint(views, pictures, gains, white, np.median(known, axis=0), lent)

    def linear(self, points: Floats, normals: Floats) -> Floats:
        """Linear color (N×3, 1 = white) of places; a station's weight is the squared cosine of its viewing angle.

        Where a station shows a place in more detail, those with larger pixels do not count.
        """
        parts = [np.empty((0, len(self.missing)))]
        for rows in chunks(len(points)):
            parts.append(self._blended(points[rows], normals[rows]))
        color = np.concatenate(parts)
        unseen = np.flatnonzero(~np.isfinite(color).all(axis=1))
        if self.lent is not None and len(unseen):
            color[unseen] = self.lent.to(points[unseen])
        known = np.asarray(np.isfinite(color).all(axis=1))
        color = np.where(known[:, None], color, self.missing) / self.white
        return np.asarray(np.repeat(color, 3, axis=1) if color.shape[1] == 1 else color)

    def _blended(self, points: Floats, normals: Floats) -> Floats:
        """Color (N×C) as the stations that see a place show it, NaN where none does."""
        near = may_see(self.views, points)
        if not near:
            return np.full((len(points), len(self.missing)), np.nan)
        views, images = [self.views[k] for k in near], [self.images[k] for k in near]
        weights, colors = _sights(points, normals, views, images, len(self.missing))
        return _mean(_of_finest(weights, views), colors * self.gains[near, None, None])

    def srgb(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """8-bit sRGB (N×3) of places."""
        return srgb_bytes(self.linear(points, normals))


def _sights(
    points: Floats, normals: Floats, views: Sequence[View], images: Sequence[Singles], channels: int
) -> tuple[Floats, Floats]:
    """Weight (V×N) and linear color (V×N×C) of places in each view; a gray image has the same value in all channels."""
    weights = np.zeros((len(views), len(points)))
    colors = np.zeros((len(views), len(points), channels))
    for k, view in enumerate(views):
        rows, columns, cosine = view.sights(points, normals)
        color = images[k][rows, columns]
        seen = (cosine > 0) & np.isfinite(color).all(1)
        weights[k] = np.where(seen, cosine**2, 0)
        # Masked pixels have NaN colors, and NaN times zero weight would make the mean of all stations NaN.
        colors[k] = np.where(seen[:, None], color, 0)
    return weights, colors


def _of_finest(weights: Floats, views: Sequence[View]) -> Floats:
    """The weights (V×N, squared cosines), zero for views that show a place more coarsely than another view with a weight."""
    kept = weights.copy()
    cosines = np.sqrt(weights)
    for k, view in enumerate(views):
        for j, other in enumerate(views):
            if other.resolves_more(view):
                kept[k, (weights[j] > 0) & other.finer(cosines[j], view, cosines[k])] = 0
    return kept


def _mean(weights: Floats, colors: Floats) -> Floats:
    """Weighted mean over the views, NaN for places that no station sees."""
    total = weights.sum(0)
    return np.asarray((weights[..., None] * colors).sum(0) / np.where(total > 0, total, np.nan)[:, None])


def _log_gains(weights: Floats, colors: Floats) -> Floats:
    """Logarithm of the gain of each view, by least squares on the median differences between views over the places that both see."""
    count = len(weights)
    bright = np.log(np.maximum(colors.mean(2), 1e-6))
    rows, values = [np.full(count, 1e-3)], [0.0]  # Fixes the mean of the logarithms.
    for i in range(count):
        for j in range(i):
            both = (weights[i] > 0.1) & (weights[j] > 0.1)
            if both.sum() < 50:
                continue
            row = np.zeros(count)
            row[i], row[j] = 1, -1
            rows.append(row)
            values.append(-float(np.median(bright[i, both] - bright[j, both])))
    return np.asarray(np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0])

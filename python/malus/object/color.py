"""Color of places on an object, blended from the stations that see them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.object.views import LEAST_COSINE, Floats, View

#: Beyond this many GSD before or behind a station's surface a place is not seen by it.
_NEAR_GSD = 4.0
_WHITE_PERCENTILE = 99.5


def blended(points: Floats, normals: Floats, views: Sequence[View]) -> Floats:
    """Linear color (N×C) of places on the surface, NaN where no station looks.

    Stations count by the square of the cosine under which they see a place; their brightness is made alike first, by one gain each.
    """
    channels = max(view.color.shape[2] for view in views)
    weights = np.zeros((len(views), len(points)))
    colors = np.zeros((len(views), len(points), channels))
    for k, view in enumerate(views):
        at = view.meet(points)
        facing = view.facing(points, normals)
        near = np.abs((at.normals * (at.points - points)).sum(1)) < _NEAR_GSD * view.gsd
        seen = (at.weight > 0) & near & (facing > LEAST_COSINE)
        weights[k] = np.where(seen, facing**2, 0)
        colors[k] = view.color[at.v, at.u]
    colors *= np.exp(_log_gains(weights, colors))[:, None, None]
    total = weights.sum(0)
    with np.errstate(invalid="ignore"):
        return np.asarray((weights[..., None] * colors).sum(0) / np.where(total > 0, total, np.nan)[:, None])


def _log_gains(weights: Floats, colors: Floats) -> Floats:
    """Logarithm of the gain of each view, by least squares on the medians of what two views both see."""
    count = len(weights)
    bright = np.log(np.maximum(colors.mean(2), 1e-6))
    rows, values = [np.full(count, 1e-3)], [0.0]  # Their mean stays.
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


def display(color: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB (N×3) of linear color (N×C); what has none takes the median."""
    known = np.asarray(np.isfinite(color).all(axis=1))
    missing = np.median(color[known], axis=0) if known.any() else np.full(color.shape[1], 0.5)
    filled = np.where(known[:, None], color, missing)
    image = np.repeat(filled, 3, axis=1) if filled.shape[1] == 1 else filled
    encoded: NDArray[np.uint8] = _core.display_image(
        np.ascontiguousarray(image[None], np.float32), np.ones((1, len(image)), np.float32), _WHITE_PERCENTILE
    )
    return np.asarray(encoded[0], np.uint8)

"""Rasters between their pixels (interpolated) and with fewer of them (averaged)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def sample(raster: NDArray[Any], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear values of a raster (H×W×C) at pixels (…×2: u, v); beyond the border the nearest border value is used."""
    height, width = raster.shape[:2]
    u = np.clip(pixels[..., 0], 0, width - 1)
    v = np.clip(pixels[..., 1], 0, height - 1)
    u0 = np.minimum(u.astype(int), max(width - 2, 0))
    v0 = np.minimum(v.astype(int), max(height - 2, 0))
    u1, v1 = np.minimum(u0 + 1, width - 1), np.minimum(v0 + 1, height - 1)
    s, t = (u - u0)[..., None], (v - v0)[..., None]
    top = (1 - s) * raster[v0, u0] + s * raster[v0, u1]
    bottom = (1 - s) * raster[v1, u0] + s * raster[v1, u1]
    return np.asarray((1 - t) * top + t * bottom, dtype=np.float64)


def sample_known(raster: NDArray[Any], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Like `sample` for a raster (H×W) with missing values (NaN), which are left out; NaN where all neighbors are missing.

    With `sample` they would spread: a value at a pixel's center is 0 times its right neighbor, too, and 0 · NaN is NaN.
    """
    known = np.isfinite(raster)
    values = np.stack([np.where(known, raster, 0), known], -1).astype(np.float64)
    total, weight = np.moveaxis(sample(values, pixels), -1, 0)
    # A smaller weight is only rounding: the place is the center of a pixel without a value.
    return np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), np.nan)


def reduced(raster: NDArray[Any], step: int) -> NDArray[np.float32]:
    """Means over blocks of step × step pixels, NaN left out; the last block of a row or column may be smaller."""
    if step == 1:
        return raster.astype(np.float32)
    rows, columns = np.arange(0, raster.shape[0], step), np.arange(0, raster.shape[1], step)
    known = np.isfinite(raster)

    def sums(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, axis=0, dtype=np.float64), columns, axis=1))

    count = sums(known)
    total = sums(np.where(known, raster, 0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def step_for(shape: Sequence[int], limit: int) -> int:
    """Smallest block size with which no side is longer than the limit."""
    return max(1, -(-max(shape[0], shape[1]) // limit))

"""Figures of values that may contain a few outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def robust_spread(deviations: ArrayLike) -> float:
    """Robust σ of values, in their unit, from their deviations from the middle; NaNs are left out.

    1.4826 times the median of the absolute deviations (MAD), which estimates the standard deviation of normally distributed
    values; a few large errors do not change it. NaN if all deviations are NaN.
    """
    return 1.4826 * float(np.nanmedian(np.abs(deviations)))


def distance_figures(values: NDArray[np.floating]) -> dict[str, float]:
    """Mean, RMSE, robust σ about the median, and percentiles of signed distances without NaN."""
    median = float(np.median(values))
    low, high = np.percentile(values, (5, 95)).tolist()
    return {
        "mean": float(values.mean()),
        "rmse": float(np.sqrt((values.astype(np.float64) ** 2).mean())),
        "mad": robust_spread(values - median),
        "p05": low,
        "median": median,
        "p95": high,
    }

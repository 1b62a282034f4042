"""The spread of values that may contain a few outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def robust_spread(deviations: ArrayLike) -> float:
    """Robust σ of values, in their unit, from their deviations from the middle; NaNs are left out.

    1.4826 times the median of the absolute deviations (MAD), which estimates the standard deviation of normally distributed
    values; a few large errors do not change it. NaN if all deviations are NaN.
    """
    return 1.4826 * float(np.nanmedian(np.abs(deviations)))

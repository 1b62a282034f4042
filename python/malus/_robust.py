"""The spread of values of which a few may be wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def robust_spread(deviations: ArrayLike) -> float:
    """Standard deviation of normal values, in their unit, from their deviations from the middle; NaNs are left out.

    1.4826 times the median of the absolute deviations (MAD): a few large errors do not change it. NaN if there is none.
    """
    return 1.4826 * float(np.nanmedian(np.abs(deviations)))

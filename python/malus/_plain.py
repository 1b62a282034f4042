"""Values of callers as plain data, for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from malus.errors import InputError


def plain(value: Any, where: str) -> Any:
    """Convert arrays, NumPy numbers and paths to values that JSON has; InputError for numbers that are not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        is_top = where.endswith(": ")
        return {key: plain(item, f"{where}[{key}]" if is_top else f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(item, f"{where}[{k}]") for k, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where} = {value}, expected a finite number")
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)

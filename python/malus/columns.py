"""Columns of numbers: all have the same number of decimals, so that the decimal points are aligned."""

from __future__ import annotations

import math
from collections.abc import Iterable

#: Digits that a column's smallest number shall show, and how many more decimals than the largest number needs it may add for that.
_SMALLEST, _FURTHER = 2, 2
#: The minus sign in print: as wide as a plus, and never separated from its number by a line break.
MINUS = "−"


def decimals(values: Iterable[float | None], digits: int = 3) -> int:
    """Number of decimals for a column whose largest number has `digits` digits; 0 for counts."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    sizes = [abs(value) for value in known if value]
    if not sizes or all(isinstance(value, int) for value in known):
        return 0
    largest, smallest = (
        wanted - 1 - math.floor(math.log10(size)) for wanted, size in ((digits, max(sizes)), (_SMALLEST, min(sizes)))
    )
    return max(0, largest, min(smallest, largest + _FURTHER))


def aligned(value: float | None, places: int) -> str:
    """A number with `places` decimals."""
    return "–" if value is None else printed(f"{value:.{places}f}")


def plain(value: float, digits: int = 3) -> str:
    """A number with so many digits, and without an exponent, however large or small it is."""
    return aligned(value, decimals([value], digits))


def printed(number: str) -> str:
    """A number for print: with the typographic minus sign, and without a minus before zero."""
    if not number.startswith("-"):
        return number
    return MINUS + number[1:] if number.strip("-0.") else number[1:]

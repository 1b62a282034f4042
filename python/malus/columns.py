"""Numbers below each other: as many decimals in all, so that the points stand in one line."""

from __future__ import annotations

import math
from collections.abc import Iterable

#: Digits of a column's smallest number, as far as that asks for few more decimals than the largest one needs.
_SMALLEST, _FURTHER = 2, 2
#: As the minus sign is printed: as wide as a plus, and not broken from its number.
MINUS = "−"


def decimals(values: Iterable[float | None], digits: int = 3) -> int:
    """Decimals that suit all numbers of a column, whose largest one has so many digits; 0 for counts."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    sizes = [abs(value) for value in known if value]
    if not sizes or all(isinstance(value, int) for value in known):
        return 0
    largest, smallest = (
        wanted - 1 - math.floor(math.log10(size)) for wanted, size in ((digits, max(sizes)), (_SMALLEST, min(sizes)))
    )
    return max(0, largest, min(smallest, largest + _FURTHER))


def aligned(value: float | None, places: int) -> str:
    """A number with so many decimals."""
    return "–" if value is None else printed(f"{value:.{places}f}")


def printed(number: str) -> str:
    """A number as it is printed, with the proper minus sign, and none before zero."""
    if not number.startswith("-"):
        return number
    return MINUS + number[1:] if number.strip("-0.") else number[1:]

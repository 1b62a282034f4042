"""Columns of numbers, for people: all have the same number of decimals, so that the decimal points are aligned; and for programs: CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

#: Digits that a column's smallest number shall show, and how many more decimals than the largest number needs it may add for that.
_SMALLEST, _FURTHER = 2, 2
#: The minus sign in print: as wide as a plus, and never separated from its number by a line break.
MINUS = "−"


def csv_text(header: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table as CSV, numbers with all digits; missing numbers (None, NaN) are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow("" if value is None or value != value else value for value in row)
    return text.getvalue()


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


def number(value: float | str | None, digits: int = 3) -> str:
    """A figure as text: a number with at most so many digits, yes or no, the text itself, or a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if abs(value) < 1e-12:  # 0, with an error of rounding
        return "0"
    # %g would switch to an exponent for a smaller number, such as a pixel of 60 µm in meters, and for a larger one.
    if abs(value) < 1e-4:
        return plain(value, digits)
    return printed(f"{value:.{digits}g}" if abs(value) < 10**digits - 0.5 else f"{value:.0f}")


def printed(text: str) -> str:
    """A number for print: with the typographic minus sign, and without a minus before zero."""
    if not text.startswith("-"):
        return text
    return MINUS + text[1:] if text.strip("-0.") else text[1:]

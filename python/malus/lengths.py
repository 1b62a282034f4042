"""Lengths as text in a readable unit, whatever the station's unit, and lengths of scale bars."""

from __future__ import annotations

import math
from collections.abc import Sequence

from malus.columns import aligned, decimals, number
from malus.units import METERS


def _suitable(meters: float) -> tuple[float, str]:
    """The unit for a length of this size: how many of it make a meter, and its name."""
    return next(((f, n) for f, n in ((1e6, "µm"), (1e3, "mm")) if abs(meters) * f < 1000), (1.0, "m"))


def shown(length: float, unit: str, digits: int = 2) -> str:
    """A length given in the station's unit, as text in µm, mm or m, whichever suits its size: 60 µm, 1.2 mm."""
    meters = length * METERS[unit]
    factor, name = _suitable(meters)
    return f"{number(meters * factor, digits)} {name}"


def sides(lengths: Sequence[float], unit: str) -> str:
    """Side lengths given in the station's unit, as text in the one unit that suits the longest: 31 × 12.5 mm."""
    meters = [length * METERS[unit] for length in lengths]
    factor, name = _suitable(max(meters))
    values = [length * factor for length in meters]
    places = decimals([max(values)])
    return f"{' × '.join(aligned(value, places) for value in values)} {name}"


def scale_bar(extent: float, unit: str) -> tuple[float, str]:
    """Length of a scale bar for a picture that is `extent` wide (1, 2 or 5 times a power of ten, about a fifth of the width), and its label."""
    meters = extent * METERS[unit]
    length = round_below(meters / 4)
    return length / METERS[unit], shown(length / METERS[unit], unit, 4)


def round_below(length: float) -> float:
    """The largest of 1, 2 and 5 times powers of ten that is no longer than a length."""
    power = 10.0 ** math.floor(math.log10(length))
    # A length of just a power of ten may be less than it by rounding.
    return next((factor * power for factor in (5, 2) if factor * power <= length), power)

"""Units of length that a station may use."""

from malus import _core

#: Meters in a unit.
METERS = _core.length_units

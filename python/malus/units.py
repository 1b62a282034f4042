"""Units of length that a station may use."""

#: Meters in a unit.
METERS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}

"""Edge conversions: what people write (mm, degrees, kPa) to SI, and the unit that a field's name carries.

Scene files, flags and plots use the units of their names' suffixes; arrays are SI. Only the reading side of a stage converts.
"""

from __future__ import annotations

import math

MM = 1e-3
"""Metres in a millimetre."""
MM_PER_M = 1e3
"""Millimetres in a metre: lengths of the solver and the light are millimetres. (x / MM differs from x * MM_PER_M in the last bit.)"""
KPA = 1e3
"""Pascals in a kilopascal."""
KPA_PER_PA = 1e-3
"""Kilopascals in a pascal: stresses of the solver are kilopascals."""
DEG = math.pi / 180.0
"""Radians in a degree."""

MESH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 25.4e-3}
"""Metres in the unit that a mesh file is said to be in."""

# Longest suffix first: speed_mm_s is not in seconds.
_SUFFIXES = {
    "_n_per_m": "N/m",
    "_mm_s": "mm/s",
    "_mm": "mm",
    "_um": "µm",
    "_deg": "°",
    "_kpa": "kPa",
    "_n": "N",
    "_00": "Shore 00",
    "_a": "Shore A",
    "_nm": "nm",
    "_s": "s",
}


def unit_of(field: str) -> str:
    """The unit that a field's name carries, "" when it is a pure number: `unit_of("radius_mm") == "mm"`."""
    return next((unit for suffix, unit in _SUFFIXES.items() if field.endswith(suffix)), "")

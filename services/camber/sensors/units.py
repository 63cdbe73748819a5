"""Units that a signal of a CAN bus may be in, and how DBC files spell them."""

from __future__ import annotations

import math
from typing import Literal

Unit = Literal["m/s", "km/h", "mph", "rad/s", "deg/s", "rad", "deg", "m", "cm", "mm", "1"]
Quantity = Literal["speed", "turn rate", "angle", "length", "code"]

UNITS: dict[Unit, tuple[Quantity, float]] = {
    "m/s": ("speed", 1.0), "km/h": ("speed", 1.0 / 3.6), "mph": ("speed", 0.44704),
    "rad/s": ("turn rate", 1.0), "deg/s": ("turn rate", math.pi / 180.0),
    "rad": ("angle", 1.0), "deg": ("angle", math.pi / 180.0),
    "m": ("length", 1.0), "cm": ("length", 0.01), "mm": ("length", 0.001), "1": ("code", 1.0),
}  # fmt: skip
"""What each measures, and one of it in SI units, angles in radians."""
_SPELT: dict[str, Unit] = {
    "m/s": "m/s", "mps": "m/s", "km/h": "km/h", "kph": "km/h", "kmh": "km/h", "kmph": "km/h", "mph": "mph",
    "rad/s": "rad/s", "deg/s": "deg/s", "°/s": "deg/s", "deg/sec": "deg/s", "degpersec": "deg/s",
    "rad": "rad", "deg": "deg", "°": "deg", "degree": "deg", "degrees": "deg", "m": "m", "cm": "cm", "mm": "mm",
}  # fmt: skip


def spelt(text: str) -> Unit | None:
    """The unit that a DBC file means; None for a spelling that is not known."""
    return _SPELT.get(text.strip().lower().replace(" ", ""))

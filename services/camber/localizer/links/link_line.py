"""The straight line of a piece of link, CN101360971 eq. (2): `-x sin(alpha) + y cos(alpha) + c = 0`.

Coordinates are local east and north with the origin near the vehicle: the derivative of `c` by `alpha` grows with the
distance from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class LinkLine(NamedTuple):
    """Direction, counter-clockwise from east [rad], and signed normal offset [m]."""

    alpha_rad: float
    c_m: float

    def offset_m(self, east_m: float, north_m: float) -> float:
        """Return the signed distance of a point from the line, positive to the left of its direction."""
        return -east_m * math.sin(self.alpha_rad) + north_m * math.cos(self.alpha_rad) + self.c_m

    @property
    def normal(self) -> tuple[float, float]:
        """The derivatives of `offset_m` by east and north."""
        return -math.sin(self.alpha_rad), math.cos(self.alpha_rad)

    def shifted(self, east_m: float, north_m: float) -> LinkLine:
        """Return the line in a plane whose origin has moved by (east, north)."""
        return LinkLine(self.alpha_rad, self.offset_m(east_m, north_m))

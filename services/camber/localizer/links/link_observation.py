"""Observation of a map link by a pose: `h(X, S)` of CN101360971 and its Jacobians.

Two independent systems: A, dead reckoning, gives the pose `X = (x, y, yaw)`; B, the link and the other rotation
sensor, gives `S = (alpha, c, r, phi)`:

- `alpha`  direction of the link, counter-clockwise from the x axis (rad);
- `c`      signed normal offset of the link's line `-x sin(alpha) + y cos(alpha) + c = 0` (m);
- `r`      signed offset of the vehicle from the link, positive to the left of `alpha` (m). The document's unsigned
  `r` has another form of `h` below the line; the signed one does not need it;
- `phi`    heading relative to the link, clockwise positive (rad).

Coordinates are local east and north with the origin near the vehicle, because the first element of `J_S` grows with the
distance from it. The optimum, CN101360971 eq. (9) to (13), is a Kalman update with these Jacobians.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats


class LinkLine(NamedTuple):
    """Straight line of a piece of link: direction [rad] and signed normal offset [m], CN101360971 eq. (2)."""

    alpha_rad: float
    c_m: float

    def offset_m(self, east_m: float, north_m: float) -> float:
        """Return the signed distance of a point from the line, positive to the left of its direction."""
        return -east_m * math.sin(self.alpha_rad) + north_m * math.cos(self.alpha_rad) + self.c_m

    def shifted(self, east_m: float, north_m: float) -> LinkLine:
        """Return the line in a plane whose origin has moved by (east, north)."""
        return LinkLine(self.alpha_rad, self.offset_m(east_m, north_m))


def observation(x: Floats, s: Floats) -> Floats:
    """Return `h(X, S)` (2,), CN101360971 eq. (3): zero if pose (3,) and link (4,) were free of error [m, rad]."""
    east, north, yaw = float(x[0]), float(x[1]), float(x[2])
    alpha, c, r, phi = float(s[0]), float(s[1]), float(s[2]), float(s[3])
    return np.array([LinkLine(alpha, c).offset_m(east, north) - r, wrap_pi(yaw - alpha + phi)])


def jacobian_x(s: Floats) -> Floats:
    """Return `J_X = dh/dX` (2, 3), after CN101360971 eq. (4)."""
    sin, cos = math.sin(s[0]), math.cos(s[0])
    return np.array([[-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def jacobian_s(x: Floats, s: Floats) -> Floats:
    """Return `J_S = dh/dS` (2, 4), after CN101360971 eq. (4); columns alpha, c, r, phi."""
    along = float(x[0]) * math.cos(s[0]) + float(x[1]) * math.sin(s[0])
    return np.array([[-along, 1.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 1.0]])

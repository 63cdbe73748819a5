"""Coupling of dead reckoning with a map link.

Source: CN101360971 (Toyota), spec/link-filter.md; the equation numbers are the document's.

Two independent sensor systems are weighed against each other: A, dead reckoning, gives the pose
`X = (x, y, yaw)`; B, the link and the other rotation sensor, gives `S = (alpha, c, r, phi)`:

- `alpha`  direction of the link, counter-clockwise from the x axis (rad);
- `c`      signed normal offset of the link's line `-x sin(alpha) + y cos(alpha) + c = 0` (m);
- `r`      signed offset of the vehicle from the link, positive to the left of `alpha` (m). The document's
  unsigned `r` has another form of `h` below the line; the signed one does not need it;
- `phi`    heading relative to the link, clockwise positive (rad).

Plane: local east/north metres with the origin near the vehicle, for the first element of `J_S` grows with
the distance from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


class LinkLine(NamedTuple):
    """The straight line of a piece of link: direction (rad) and signed normal offset (m), equation (2)."""

    alpha_rad: float
    c_m: float

    def offset_m(self, east_m: float, north_m: float) -> float:
        """Signed distance of a point from the line, positive to the left of its direction."""
        return -east_m * math.sin(self.alpha_rad) + north_m * math.cos(self.alpha_rad) + self.c_m

    def shifted(self, east_m: float, north_m: float) -> LinkLine:
        """The same line in a plane whose origin has moved by (east, north)."""
        return LinkLine(self.alpha_rad, self.offset_m(east_m, north_m))


class Coupled(NamedTuple):
    """Result of one coupling: pose (3,), its covariance (3, 3), innovation (2,) and its covariance (2, 2)."""

    x_hat: Array
    q_hat: Array
    innovation: Array
    innovation_covariance: Array


def line_through(
    start_east_m: float, start_north_m: float, end_east_m: float, end_north_m: float
) -> LinkLine:
    """Line through two points, directed from the first to the second. ValueError where they coincide."""
    east, north = end_east_m - start_east_m, end_north_m - start_north_m
    if not math.hypot(east, north) > 0.0:
        raise ValueError("end: must differ from start, and both be finite, to give a line a direction")
    alpha = math.atan2(north, east)
    return LinkLine(alpha, start_east_m * math.sin(alpha) - start_north_m * math.cos(alpha))


def wrapped(angle_rad: float) -> float:
    """The angle in [-pi, pi]."""
    return math.remainder(angle_rad, math.tau)


def observation(x: Array, s: Array) -> Array:
    """`h(X, S)` (3): what would be zero if pose (3,) and link measurement (4,) were free of error; m, rad."""
    east, north, yaw = float(x[0]), float(x[1]), float(x[2])
    alpha, c, r, phi = float(s[0]), float(s[1]), float(s[2]), float(s[3])
    return np.array([LinkLine(alpha, c).offset_m(east, north) - r, wrapped(yaw - alpha + phi)])


def jacobian_x(s: Array) -> Array:
    """`J_X = dh/dX` (2, 3), after equation (4)."""
    sin, cos = math.sin(s[0]), math.cos(s[0])
    return np.array([[-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def jacobian_s(x: Array, s: Array) -> Array:
    """`J_S = dh/dS` (2, 4), after equation (4); columns alpha, c, r, phi."""
    along = float(x[0]) * math.cos(s[0]) + float(x[1]) * math.sin(s[0])
    return np.array([[-along, 1.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 1.0]])


def couple(x: Array, q_x: Array, s: Array, q_s: Array) -> Coupled:
    """The optimum of pose and link measurement, equations (9) to (13) in Kalman form.

    `x` (3,) and `q_x` (3, 3) from system A, `s` (4,) and `q_s` (4, 4) from system B, whose errors must be
    independent of A's. Correlations inside `q_s` count: where `phi` is an absolute heading minus `alpha`,
    `cov(alpha, phi) = -var(alpha)`, and the link's direction cancels in the second row.
    ValueError names an argument of the wrong shape or not finite.
    """
    for name, value, shape in (("x", x, (3,)), ("q_x", q_x, (3, 3)), ("s", s, (4,)), ("q_s", q_s, (4, 4))):
        require(name, value, shape)
    h, j_x, j_s = observation(x, s), jacobian_x(s), jacobian_s(x, s)
    q_s_prime = j_s @ q_s @ j_s.T
    x_hat, q_hat, innovation_covariance = kalman_update(x, q_x, j_x, -h, q_s_prime)
    return Coupled(x_hat, q_hat, h, innovation_covariance)


def kalman_update(
    x: Array, p: Array, h: Array, innovation: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """State (n,), covariance (n, n) and innovation covariance (m, m) after an observation of m = 1 or 2 rows
    `h` (m, n) with `noise` (m, m), which must be regular."""
    ph = p @ h.T
    s = h @ ph + noise
    gain = ph / s[0, 0] if len(s) == 1 else ph @ inverse_2x2(s)
    updated = p - gain @ ph.T
    return x + gain @ innovation, 0.5 * (updated + updated.T), s


def inverse_2x2(s: Array) -> Array:
    """Inverse of a regular matrix (2, 2)."""
    a, b, c, d = float(s[0, 0]), float(s[0, 1]), float(s[1, 0]), float(s[1, 1])
    scale = 1.0 / (a * d - b * c)
    return np.array(((d * scale, -b * scale), (-c * scale, a * scale)))


def require(name: str, value: Array, shape: tuple[int, ...]) -> None:
    """ValueError naming the argument unless it has this shape and every element is finite."""
    if np.shape(value) != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {np.shape(value)}")
    if not np.isfinite(value).all():
        raise ValueError(f"{name}: every element must be finite")

"""Angles in radians: wrapping, differences, and the two ways of saying where a vehicle points.

*Yaw* is counter-clockwise from east, as the x axis of the vehicle in an east-north-up frame (ISO 8855, REP
103). *Heading* is clockwise from north, as compasses, receivers and people give it.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

TWO_PI_RAD = 2.0 * math.pi


def wrap_pi(angle_rad: float) -> float:
    """The same direction in (−π, π]. NaN stays NaN; an infinite angle raises ValueError."""
    wrapped = math.remainder(angle_rad, TWO_PI_RAD)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_two_pi(angle_rad: float) -> float:
    """The same direction in [0, 2π). NaN stays NaN; an infinite angle raises ValueError."""
    wrapped = math.fmod(angle_rad, TWO_PI_RAD)
    if wrapped < 0.0:
        wrapped += TWO_PI_RAD
    # A tiny negative angle rounds up to 2π itself.
    return 0.0 if wrapped >= TWO_PI_RAD else wrapped


def wrap_pi_array(angle_rad: ArrayLike) -> NDArray[np.float64]:
    """`wrap_pi` for an array of any shape; entries that are not finite become NaN."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        wrapped = np.asarray(np.pi - np.mod(np.pi - angle, TWO_PI_RAD))
    # np.mod may round to 2π for a tiny negative argument, which would give −π.
    return np.where(wrapped <= -np.pi, np.pi, wrapped)


def angle_difference(angle_rad: float, reference_rad: float) -> float:
    """`angle − reference` the short way round, in (−π, π]."""
    return wrap_pi(angle_rad - reference_rad)


def heading_from_yaw(yaw_rad: float) -> float:
    """Heading clockwise from north in [0, 2π) of a yaw counter-clockwise from east."""
    return wrap_two_pi(0.5 * math.pi - yaw_rad)

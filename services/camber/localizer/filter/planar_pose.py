"""Planar geometry of a pose (east, north, yaw) and of its covariance."""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.arrays import Floats


def rotated(yaw_rad: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return east and north of a vector given as x forward and y left of a heading."""
    sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
    return x_m * cos - y_m * sin, x_m * sin + y_m * cos


def covariance_at_offset(covariance: Floats, east_m: float, north_m: float) -> Floats:
    """Return the covariance (3, 3) of a pose for another point of the rigid vehicle, (east, north) away."""
    f = np.array([[1.0, 0.0, -north_m], [0.0, 1.0, east_m], [0.0, 0.0, 1.0]])
    return np.asarray(f @ covariance @ f.T)


def largest_variance(covariance: Floats) -> float:
    """Return the larger eigenvalue of the leading 2 × 2 block of a covariance."""
    a, b, c = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    return 0.5 * (a + b) + math.hypot(0.5 * (a - b), c)

"""The ways to know the antenna's height `h_a` above the road, each with its σ (H (1), embodiment 5)."""

from __future__ import annotations

import math

from camber.schemas.antenna import HeightByWay
from camber.schemas.motion import Suspension


def fixed_height(height_m: float, sigma_m: float) -> HeightByWay:
    """A stored value, measured once: antennas below the suspension, robots."""
    return HeightByWay(way="fixed", height_m=height_m, sigma_m=sigma_m)


def stroke_height(
    suspension: Suspension,
    *,
    suspension_to_antenna_m: float,
    tyre_radius_m: float,
    stored_sigma_m: float,
) -> HeightByWay:
    """`h_a = h_ba + h_s + h_t`, H (1): suspension top to antenna, stroke height, tyre radius, all metres.

    σ is that of the sensor and of the two stored values together.
    """
    height_m = suspension_to_antenna_m + suspension.stroke_height_m + tyre_radius_m
    sigma_m = math.hypot(suspension.stroke_sigma_m, stored_sigma_m)
    return HeightByWay(way="stroke", height_m=height_m, sigma_m=sigma_m)


def disagree(a: HeightByWay, b: HeightByWay, sigmas: float = 4.0) -> bool:
    """Do two ways contradict each other beyond `sigmas` of their difference?"""
    return not abs(a.height_m - b.height_m) <= sigmas * math.hypot(a.sigma_m, b.sigma_m)

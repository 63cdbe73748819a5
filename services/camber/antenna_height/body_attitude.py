"""Attitude of the vehicle's body on the road: what a lever arm means in height above the road.

Level axes: x forward along the heading, y to its left, z up. The road is a plane in them, `slope_forward` and
`slope_left` metres of height per metre. A body at rest lies parallel to it; braking, a curve or a load tilts it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

UNKNOWN_GRADE = 0.07
"""Chosen: the grade of a road of which nothing is known, the steepest that are common."""


class Arm(NamedTuple):
    """A lever arm, or a point of the vehicle frame [m]: x forward, y left, z up."""

    x_m: float
    y_m: float
    z_m: float

    def minus(self, other: Arm) -> Arm:
        """Return the lever arm from the other point to this one."""
        return Arm(self.x_m - other.x_m, self.y_m - other.y_m, self.z_m - other.z_m)


class Slopes(NamedTuple):
    """The road's plane in level axes."""

    forward: float
    left: float

    @property
    def steepness(self) -> float:
        """The steepest slope."""
        return math.hypot(self.forward, self.left)

    @classmethod
    def along(cls, slope_east: float, slope_north: float, yaw_rad: float) -> Slopes:
        """Return the slopes of a plane over east and north along a heading and to its left."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        return cls(slope_east * cos + slope_north * sin, slope_north * cos - slope_east * sin)


class Tilt(NamedTuple):
    """The body against the vertical [rad]: roll left side up positive, pitch nose down positive."""

    roll_rad: float
    pitch_rad: float

    @classmethod
    def parallel_to(cls, road: Slopes) -> Tilt:
        """Return the tilt of a body that lies evenly on the road."""
        along = math.atan(road.forward)
        return cls(math.atan(road.left * math.cos(along)), -along)


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltRules:
    """Standard deviations [rad; slopes are ratios].

    `body_*`: of the body against the road, before any measurement. `attitude`: of a measured attitude against the
    vertical, its constant error included. `slope`: of the road between two points of the vehicle against the map's.
    """

    body_pitch_sigma_rad: float
    body_roll_sigma_rad: float
    attitude_sigma_rad: float
    slope_sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyAttitude:
    """Road, body, and σ of the body's angles *against the road* [rad]; `grade_sigma` of a grade that was assumed."""

    road: Slopes
    body: Tilt
    pitch_sigma_rad: float
    roll_sigma_rad: float
    grade_sigma: float = 0.0

    @classmethod
    def of(cls, road: Slopes | None, body: Tilt | None, rules: TiltRules) -> BodyAttitude:
        """Combine road and measured attitude, None: not known.

        With both, the body's angles against the road are the measured ones, weighted by the variances against the
        assumption that they are zero. Where one is missing, body and road are taken as parallel.
        """
        pitch, pitch_sigma_rad = 0.0, rules.body_pitch_sigma_rad
        roll, roll_sigma_rad = 0.0, rules.body_roll_sigma_rad
        grade_sigma = UNKNOWN_GRADE if road is None and body is None else 0.0
        if road is not None and body is not None:
            rest = Tilt.parallel_to(road)
            measured_rad = math.hypot(rules.attitude_sigma_rad, rules.slope_sigma)
            pitch, pitch_sigma_rad = _combined(body.pitch_rad - rest.pitch_rad, measured_rad, pitch_sigma_rad)
            roll, roll_sigma_rad = _combined(body.roll_rad - rest.roll_rad, measured_rad, roll_sigma_rad)
        road = road or (Slopes(0.0, 0.0) if body is None else _road_below(body))
        rest = Tilt.parallel_to(road)
        return cls(
            road=road,
            body=Tilt(rest.roll_rad + roll, rest.pitch_rad + pitch),
            pitch_sigma_rad=math.hypot(pitch_sigma_rad, rules.slope_sigma),
            roll_sigma_rad=math.hypot(roll_sigma_rad, rules.slope_sigma),
            grade_sigma=grade_sigma,
        )

    @property
    def vertical_per_normal(self) -> float:
        """Vertical metres for one metre along the road's normal."""
        return math.sqrt(1.0 + self.road.forward**2 + self.road.left**2)

    def rise_m(self, arm: Arm) -> float:
        """Return how much higher above the road the end of a lever arm is than its beginning, vertically."""
        x, y, z = self._level(arm)
        return z - self.road.forward * x - self.road.left * y

    def rise_sigma_m(self, arm: Arm) -> float:
        """Return its σ, by the uncertainty of tilt and grade."""
        x, y, z = self._level(arm)
        by_pitch = (x + self.road.forward * z) * self.pitch_sigma_rad
        by_roll = (y + self.road.left * z) * self.roll_sigma_rad
        return math.hypot(by_pitch, by_roll, 0.5 * self.grade_sigma**2 * z)

    def _level(self, arm: Arm) -> tuple[float, float, float]:
        """Return Ry(pitch) Rx(roll) arm, as in `camber.geodesy.se3`."""
        sr, cr = math.sin(self.body.roll_rad), math.cos(self.body.roll_rad)
        sp, cp = math.sin(self.body.pitch_rad), math.cos(self.body.pitch_rad)
        y, z = cr * arm.y_m - sr * arm.z_m, sr * arm.y_m + cr * arm.z_m
        return cp * arm.x_m + sp * z, y, cp * z - sp * arm.x_m


def _road_below(body: Tilt) -> Slopes:
    """Return the road to which a body lies parallel."""
    return Slopes(-math.tan(body.pitch_rad), math.tan(body.roll_rad) / max(math.cos(body.pitch_rad), 1e-3))


def _combined(measured_rad: float, sigma_rad: float, prior_sigma_rad: float) -> tuple[float, float]:
    share = prior_sigma_rad**2 / (prior_sigma_rad**2 + sigma_rad**2) if prior_sigma_rad > 0.0 else 0.0
    return share * measured_rad, math.sqrt(share) * sigma_rad

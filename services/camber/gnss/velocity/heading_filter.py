"""Heading of a vehicle from satellite velocity and yaw rate.

Source: Kikuchi (TUMSAT), "Heading": ψ = atan2(V_E, V_N) when the wheel speed is above 0.5 m/s, the two speeds agree
within 1.5 m/s and HDOP is below 2.5; a Kalman filter of state (ψ, ω) with F = [1 Δt; 0 1] and R = diag(σ²_v/v, σ²_ω).

Deviation, for consistent dimensions: a velocity whose component across the direction of travel errs by σ_v errs in
direction by σ_v / v, so the variance of the heading is (σ_v / v)². σ_v is that of the velocity's covariance across, at
least `least_velocity_sigma_m_s`.

Heading is clockwise from north, yaw rate counter-clockwise positive (`docs/conventions.md`): ω is dψ/dt = −yaw rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from camber.geodesy.angles import angle_difference, wrap_pi, wrap_two_pi
from camber.geodesy.gps_time import NS_PER_SECOND

Gate = Literal[
    "accepted", "wheel_speed", "speeds_differ", "hdop", "imprecise", "outlier", "not_finite", "too_old"
]
"""Outcome for a velocity: the three gates of Kikuchi (TUMSAT); `imprecise`: too slow for its σ; `outlier`: contradicts
a known heading, or faster than `GREATEST_SPEED_M_S`; `too_old`: after a newer input."""
GREATEST_SPEED_M_S = 515.0  # civil receivers state no velocity above 1,000 knots (COCOM limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingOptions:
    """Gates (Kikuchi (TUMSAT): the first three) and standard deviations, chosen for a car and a MEMS gyroscope."""

    least_wheel_speed_m_s: float = 0.5
    greatest_speed_difference_m_s: float = 1.5
    greatest_hdop: float = 2.5
    least_velocity_sigma_m_s: float = 0.03
    yaw_rate_sigma_rad_s: float = 0.005
    yaw_acceleration_rad_s2: float = 0.5
    """Standard deviation of the yaw acceleration that acts for a second (white, per √Hz)."""
    greatest_heading_sigma_rad: float = 0.5
    """Gate of a velocity; beyond it a direction is not normally distributed."""
    drift_rad_per_root_s: float = 0.005
    """Random walk of the heading by the yaw rate's scale and bias."""
    longest_without_velocity_s: float = 10.0
    """Time after the last accepted velocity when the heading becomes unknown."""
    longest_step_s: float = 1.0
    """Longest gap of all inputs: beyond it the vehicle may have turned; the heading is unknown."""
    outlier_sigmas: float = 5.0
    outliers_until_restart: int = 5
    """Consecutive outliers after which the heading is taken to be wrong and restarted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneVelocity:
    """A satellite velocity in the plane with covariance (ee, en, nn)."""

    east_m_s: float
    north_m_s: float
    covariance_m2_s2: tuple[float, float, float]
    hdop: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingEstimate:
    """At a time: heading [0, 2π) clockwise from north of the vehicle's x, its rate, and their standard deviations."""

    time_ns: int
    heading_rad: float
    rate_rad_s: float
    heading_sigma_rad: float
    rate_sigma_rad_s: float


class HeadingFilter:
    """Kalman filter of heading and turn rate; inputs in the order of their times.

    Input older than the last is ignored; far older input means that the clock was set back and restarts the filter.
    """

    def __init__(self, options: HeadingOptions | None = None) -> None:
        self._options = options or HeadingOptions()
        self._time_ns: int | None = None
        self._velocity_ns: int | None = None
        # State ψ, ω and its covariance (ψψ, ψω, ωω); the heading counts only while `_velocity_ns` is set.
        self._heading = 0.0
        self._rate = 0.0
        self._covariance = (0.0, 0.0, 0.0)
        self._outliers = 0

    def add_yaw_rate(self, time_ns: int, yaw_rate_rad_s: float) -> bool:
        """Update by a yaw rate, counter-clockwise positive; false where it is ignored: late or not finite."""
        if not math.isfinite(yaw_rate_rad_s) or not self._advance(time_ns):
            return False
        if self._velocity_ns is not None:
            self._update_rate(-yaw_rate_rad_s)
        return True

    def add_velocity(self, time_ns: int, velocity: PlaneVelocity, wheel_speed_m_s: float) -> Gate:
        """Update by a satellite velocity; the wheel speed at its time is negative backwards."""
        o, covariance_m2_s2 = self._options, velocity.covariance_m2_s2
        east_m_s, north_m_s = velocity.east_m_s, velocity.north_m_s
        if not all(
            map(math.isfinite, (east_m_s, north_m_s, *covariance_m2_s2, velocity.hdop, wheel_speed_m_s))
        ):
            return "not_finite"
        if not self._advance(time_ns):
            return "too_old"
        speed = math.hypot(east_m_s, north_m_s)
        if speed > GREATEST_SPEED_M_S:
            return "outlier"
        if not abs(wheel_speed_m_s) > o.least_wheel_speed_m_s:
            return "wheel_speed"
        if not (abs(speed - abs(wheel_speed_m_s)) < o.greatest_speed_difference_m_s and speed > 0.0):
            return "speeds_differ"
        if not velocity.hdop < o.greatest_hdop:
            return "hdop"
        course = math.atan2(east_m_s, north_m_s)
        heading = wrap_pi(course + math.pi) if wheel_speed_m_s < 0.0 else course
        ee, en, nn = covariance_m2_s2
        s, c = east_m_s / speed, north_m_s / speed
        across = max(c * c * ee - 2.0 * s * c * en + s * s * nn, o.least_velocity_sigma_m_s**2)
        if not math.sqrt(across) < o.greatest_heading_sigma_rad * speed:
            return "imprecise"
        return self._update_heading(time_ns, heading, across / (speed * speed))

    def at(self, time_ns: int) -> HeadingEstimate | None:
        """The heading at a time not before the last input; None where it is not known."""
        if self._time_ns is None or time_ns < self._time_ns or not self._is_known(time_ns):
            return None
        dt = (time_ns - self._time_ns) / NS_PER_SECOND
        pp, _, rr = self._predicted(dt)
        return HeadingEstimate(
            time_ns=time_ns,
            heading_rad=wrap_two_pi(self._heading + self._rate * dt),
            rate_rad_s=self._rate,
            heading_sigma_rad=math.sqrt(pp),
            rate_sigma_rad_s=math.sqrt(rr),
        )

    def _is_known(self, time_ns: int) -> bool:
        if self._time_ns is None or self._velocity_ns is None:
            return False
        longest, step = self._options.longest_without_velocity_s, self._options.longest_step_s
        return (
            time_ns - self._velocity_ns <= longest * NS_PER_SECOND
            and time_ns - self._time_ns <= step * NS_PER_SECOND
        )

    def _advance(self, time_ns: int) -> bool:
        """Predict to a time; false, without a change, if that is before the last input."""
        if self._time_ns is None:
            self._time_ns = time_ns
            return True
        back_ns = self._time_ns - time_ns
        if 0 < back_ns <= self._options.longest_without_velocity_s * NS_PER_SECOND:
            return False
        if back_ns > 0 or not self._is_known(time_ns):
            self._velocity_ns = None
        else:
            dt = (time_ns - self._time_ns) / NS_PER_SECOND
            self._covariance = self._predicted(dt)
            self._heading = wrap_pi(self._heading + self._rate * dt)
        self._time_ns = time_ns
        return True

    def _predicted(self, dt: float) -> tuple[float, float, float]:
        """F P Fᵀ + Q: Q of white yaw acceleration q, [dt³/3 dt²/2; dt²/2 dt] q, and of the heading's drift."""
        pp, pr, rr = self._covariance
        q = self._options.yaw_acceleration_rad_s2**2
        drift = self._options.drift_rad_per_root_s**2
        return (
            pp + 2.0 * dt * pr + dt * dt * rr + q * dt**3 / 3.0 + drift * dt,
            pr + dt * rr + q * dt * dt / 2.0,
            rr + q * dt,
        )

    def _update_rate(self, rate_rad_s: float) -> None:
        pp, pr, rr = self._covariance
        total = rr + self._options.yaw_rate_sigma_rad_s**2
        innovation = rate_rad_s - self._rate
        self._heading = wrap_pi(self._heading + pr / total * innovation)
        self._rate += rr / total * innovation
        kept = 1.0 - rr / total
        self._covariance = (pp - pr * pr / total, pr * kept, rr * kept)

    def _update_heading(self, time_ns: int, heading_rad: float, variance: float) -> Gate:
        o = self._options
        if self._velocity_ns is None:
            self._start(time_ns, heading_rad, variance)
            return "accepted"
        pp, pr, rr = self._covariance
        total = pp + variance
        innovation = angle_difference(heading_rad, self._heading)
        if innovation * innovation > o.outlier_sigmas**2 * total:
            self._outliers += 1
            if self._outliers < o.outliers_until_restart:
                return "outlier"
            self._start(time_ns, heading_rad, variance)
            return "accepted"
        self._heading = wrap_pi(self._heading + pp / total * innovation)
        self._rate += pr / total * innovation
        kept = 1.0 - pp / total
        self._covariance = (pp * kept, pr * kept, rr - pr * pr / total)
        self._velocity_ns, self._outliers = time_ns, 0
        return "accepted"

    def _start(self, time_ns: int, heading_rad: float, variance: float) -> None:
        # The rate is unknown: a car turns by less than 1 rad/s.
        self._heading, self._rate, self._covariance = heading_rad, 0.0, (variance, 0.0, 1.0)
        self._velocity_ns, self._outliers = time_ns, 0

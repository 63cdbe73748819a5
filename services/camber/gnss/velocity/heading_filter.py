"""Heading of a vehicle from satellite velocity and yaw rate.

Source: R, "Heading": ψ = atan2(V_E, V_N) when the wheel speed is above 0.5 m/s, the two speeds agree within 1.5 m/s and
HDOP is below 2.5; a Kalman filter of state (ψ, ω) with F = [1 Δt; 0 1] and R = diag(σ²_v/v, σ²_ω).

Taken by its dimensions, a velocity whose component across the direction of travel is off by σ_v turns its direction by
σ_v / v: the variance of the heading is (σ_v / v)², and the slower, the less it counts. σ_v is that of the velocity's
own covariance across, and no less than `least_velocity_sigma_m_s`.

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
"""What became of a velocity: the three gates of R; `imprecise` is too slow for its own σ; `outlier` contradicts a
heading that is known; `too_old` comes after what is newer."""


@dataclass(frozen=True, slots=True)
class HeadingOptions:
    """Gates and standard deviations; the rate of the process is that of a vehicle's yaw acceleration."""

    least_wheel_speed_m_s: float = 0.5
    greatest_speed_difference_m_s: float = 1.5
    greatest_hdop: float = 2.5
    least_velocity_sigma_m_s: float = 0.03
    yaw_rate_sigma_rad_s: float = 0.005
    yaw_acceleration_rad_s2: float = 0.5
    """Standard deviation of the yaw acceleration that acts for a second (white, per √Hz)."""
    greatest_heading_sigma_rad: float = 0.5
    """Of a velocity; beyond it a direction is no normal variable any more."""
    drift_rad_per_root_s: float = 0.005
    """How heading is lost beside that: the yaw rate's scale and bias."""
    longest_without_velocity_s: float = 10.0
    """So long after the last accepted velocity the heading is not known any more."""
    longest_step_s: float = 1.0
    """A gap of everything beyond this: the vehicle may have turned; the heading is not known."""
    outlier_sigmas: float = 5.0
    outliers_until_restart: int = 5
    """So many velocities one after another that contradict the heading: then it is the heading that is wrong."""


@dataclass(frozen=True, slots=True)
class Heading:
    """At a time: heading [0, 2π) clockwise from north of the vehicle's x, its rate, and their standard deviations."""

    time_ns: int
    heading_rad: float
    rate_rad_s: float
    heading_sigma_rad: float
    rate_sigma_rad_s: float


class HeadingFilter:
    """Feeds on yaw rates and on velocities with the wheel speed of their time, in the order of their times.

    What is older than what came last is ignored; where it is far older, the clock has jumped, and everything is
    forgotten. A wheel speed is negative backwards: then the vehicle points against its velocity.
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
        """A yaw rate, counter-clockwise positive; false where it is ignored: older than the last or not finite."""
        if not math.isfinite(yaw_rate_rad_s) or not self._advance(time_ns):
            return False
        if self._velocity_ns is not None:
            self._update_rate(-yaw_rate_rad_s)
        return True

    def add_velocity(
        self,
        time_ns: int,
        east_m_s: float,
        north_m_s: float,
        covariance_m2_s2: tuple[float, float, float],
        hdop: float,
        wheel_speed_m_s: float,
    ) -> Gate:
        """A satellite velocity in the plane with (ee, en, nn), and the wheel speed, negative backwards, at its time."""
        o = self._options
        if not all(map(math.isfinite, (east_m_s, north_m_s, *covariance_m2_s2, hdop, wheel_speed_m_s))):
            return "not_finite"
        if not self._advance(time_ns):
            return "too_old"
        speed = math.hypot(east_m_s, north_m_s)
        if not abs(wheel_speed_m_s) > o.least_wheel_speed_m_s:
            return "wheel_speed"
        if not (abs(speed - abs(wheel_speed_m_s)) < o.greatest_speed_difference_m_s and speed > 0.0):
            return "speeds_differ"
        if not hdop < o.greatest_hdop:
            return "hdop"
        course = math.atan2(east_m_s, north_m_s)
        heading = wrap_pi(course + math.pi) if wheel_speed_m_s < 0.0 else course
        ee, en, nn = covariance_m2_s2
        s, c = east_m_s / speed, north_m_s / speed
        across = max(c * c * ee - 2.0 * s * c * en + s * s * nn, o.least_velocity_sigma_m_s**2)
        if not math.sqrt(across) < o.greatest_heading_sigma_rad * speed:
            return "imprecise"
        return self._update_heading(time_ns, heading, across / speed**2)

    def at(self, time_ns: int) -> Heading | None:
        """The heading at a time not before what came last; None where it is not known."""
        if self._time_ns is None or time_ns < self._time_ns or not self._is_known(time_ns):
            return None
        dt = (time_ns - self._time_ns) / NS_PER_SECOND
        pp, _, rr = self._predicted(dt)
        return Heading(
            time_ns, wrap_two_pi(self._heading + self._rate * dt), self._rate, math.sqrt(pp), math.sqrt(rr)
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
        """Predict to a time; false, and nothing changes, if that lies before the last."""
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
        off = rate_rad_s - self._rate
        self._heading = wrap_pi(self._heading + pr / total * off)
        self._rate += rr / total * off
        kept = 1.0 - rr / total
        self._covariance = (pp - pr * pr / total, pr * kept, rr * kept)

    def _update_heading(self, time_ns: int, heading_rad: float, variance: float) -> Gate:
        o = self._options
        if self._velocity_ns is None:
            self._start(time_ns, heading_rad, variance)
            return "accepted"
        pp, pr, rr = self._covariance
        total = pp + variance
        off = angle_difference(heading_rad, self._heading)
        if off * off > o.outlier_sigmas**2 * total:
            self._outliers += 1
            if self._outliers < o.outliers_until_restart:
                return "outlier"
            self._start(time_ns, heading_rad, variance)
            return "accepted"
        self._heading = wrap_pi(self._heading + pp / total * off)
        self._rate += pr / total * off
        kept = 1.0 - pp / total
        self._covariance = (pp * kept, pr * kept, rr - pr * pr / total)
        self._velocity_ns, self._outliers = time_ns, 0
        return "accepted"

    def _start(self, time_ns: int, heading_rad: float, variance: float) -> None:
        # Of a rate nothing is known yet: a car turns by less than 1 rad/s.
        self._heading, self._rate, self._covariance = heading_rad, 0.0, (variance, 0.0, 1.0)
        self._velocity_ns, self._outliers = time_ns, 0

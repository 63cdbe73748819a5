"""Heading of a vehicle from satellite velocity and yaw rate.

Source: Kikuchi (TUMSAT), "Heading": ψ = atan2(V_E, V_N) when the wheel speed is above 0.5 m/s, the two speeds agree
within 1.5 m/s and HDOP is below 2.5; a Kalman filter of state (ψ, ω) with F = [1 Δt; 0 1] and R = diag(σ²_v/v, σ²_ω).

Deviation, for consistent dimensions: a velocity whose component across the direction of travel errs by σ_v errs in
direction by σ_v / v, so the variance of the heading is (σ_v / v)². σ_v is that of the velocity's covariance across, at
least `LEAST_VELOCITY_SIGMA_M_S`.

Heading is clockwise from north, yaw rate counter-clockwise positive (`docs/conventions.md`): ω is dψ/dt = −yaw rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from camber.geodesy.angles import angle_difference, wrap_pi, wrap_two_pi
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.velocity.doppler_velocity import DopplerVelocity

Gate = Literal[
    "accepted", "wheel_speed", "speeds_differ", "hdop", "imprecise", "outlier", "not_finite", "too_old"
]
"""Outcome for a velocity: the three gates of Kikuchi (TUMSAT); `imprecise`: too slow for its σ; `outlier`: contradicts
a known heading, or faster than `GREATEST_SPEED_M_S`; `too_old`: after a newer input."""
GREATEST_SPEED_M_S = 515.0  # civil receivers state no velocity above 1,000 knots (COCOM limit)

# Gates of Kikuchi (TUMSAT).
_LEAST_WHEEL_SPEED_M_S, _GREATEST_SPEED_DIFFERENCE_M_S, _GREATEST_HDOP = 0.5, 1.5, 2.5
# Chosen for a car and a MEMS gyroscope.
LEAST_VELOCITY_SIGMA_M_S = 0.03
YAW_RATE_SIGMA_RAD_S = 0.005
YAW_ACCELERATION_RAD_S2 = 0.5
"""Standard deviation of the yaw acceleration that acts for a second (white, per √Hz)."""
DRIFT_RAD_PER_ROOT_S = 0.005
"""Random walk of the heading by the yaw rate's scale and bias."""
_GREATEST_HEADING_SIGMA_RAD = 0.5  # chosen: of a velocity; beyond it a direction is not normally distributed
_LONGEST_WITHOUT_VELOCITY_NS = 10 * NS_PER_SECOND  # chosen: then the heading becomes unknown
_LONGEST_STEP_NS = NS_PER_SECOND  # chosen: in a longer gap of all inputs the vehicle may have turned
_OUTLIER_SIGMAS = 5.0  # chosen: of the innovation
_OUTLIERS_UNTIL_RESTART = 5  # chosen: consecutive ones, after which the heading is taken to be wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingEstimate:
    """Heading [0, 2π) clockwise from north of the vehicle's x, and its standard deviation."""

    heading_rad: float
    heading_sigma_rad: float


class HeadingFilter:
    """Kalman filter of heading and turn rate; inputs in the order of their times.

    Input older than the last is ignored; far older input means that the clock was set back and restarts the filter.
    """

    def __init__(self) -> None:
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

    def add_velocity(self, velocity: DopplerVelocity, wheel_speed_m_s: float) -> Gate:
        """Update by a satellite velocity; the wheel speed at its time is negative backwards."""
        east_m_s, north_m_s, _ = velocity.velocity_enu_m_s.tolist()
        (ee, en, _), (_, nn, _), _ = velocity.covariance_enu_m2_s2.tolist()
        if not all(map(math.isfinite, (east_m_s, north_m_s, ee, en, nn, velocity.hdop, wheel_speed_m_s))):
            return "not_finite"
        if not self._advance(velocity.time_ns):
            return "too_old"
        speed = math.hypot(east_m_s, north_m_s)
        if speed > GREATEST_SPEED_M_S:
            return "outlier"
        if not abs(wheel_speed_m_s) > _LEAST_WHEEL_SPEED_M_S:
            return "wheel_speed"
        if not (abs(speed - abs(wheel_speed_m_s)) < _GREATEST_SPEED_DIFFERENCE_M_S and speed > 0.0):
            return "speeds_differ"
        if not velocity.hdop < _GREATEST_HDOP:
            return "hdop"
        course = math.atan2(east_m_s, north_m_s)
        heading = wrap_pi(course + math.pi) if wheel_speed_m_s < 0.0 else course
        s, c = east_m_s / speed, north_m_s / speed
        across = max(c * c * ee - 2.0 * s * c * en + s * s * nn, LEAST_VELOCITY_SIGMA_M_S**2)
        if not math.sqrt(across) < _GREATEST_HEADING_SIGMA_RAD * speed:
            return "imprecise"
        return self._update_heading(velocity.time_ns, heading, across / (speed * speed))

    def at(self, time_ns: int) -> HeadingEstimate | None:
        """The heading at a time not before the last input; None where it is not known."""
        if self._time_ns is None or time_ns < self._time_ns or not self._is_known(time_ns):
            return None
        dt = (time_ns - self._time_ns) / NS_PER_SECOND
        heading_rad = wrap_two_pi(self._heading + self._rate * dt)
        return HeadingEstimate(heading_rad=heading_rad, heading_sigma_rad=math.sqrt(self._predicted(dt)[0]))

    def _is_known(self, time_ns: int) -> bool:
        if self._time_ns is None or self._velocity_ns is None:
            return False
        since_ns, step_ns = time_ns - self._velocity_ns, time_ns - self._time_ns
        return since_ns <= _LONGEST_WITHOUT_VELOCITY_NS and step_ns <= _LONGEST_STEP_NS

    def _advance(self, time_ns: int) -> bool:
        """Predict to a time; false, without a change, if that is before the last input."""
        if self._time_ns is None:
            self._time_ns = time_ns
            return True
        back_ns = self._time_ns - time_ns
        if 0 < back_ns <= _LONGEST_WITHOUT_VELOCITY_NS:
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
        q, drift = YAW_ACCELERATION_RAD_S2**2, DRIFT_RAD_PER_ROOT_S**2
        return (
            pp + 2.0 * dt * pr + dt * dt * rr + q * dt**3 / 3.0 + drift * dt,
            pr + dt * rr + q * dt * dt / 2.0,
            rr + q * dt,
        )

    def _update_rate(self, rate_rad_s: float) -> None:
        pp, pr, rr = self._covariance
        total = rr + YAW_RATE_SIGMA_RAD_S**2
        innovation = rate_rad_s - self._rate
        self._heading = wrap_pi(self._heading + pr / total * innovation)
        self._rate += rr / total * innovation
        kept = 1.0 - rr / total
        self._covariance = (pp - pr * pr / total, pr * kept, rr * kept)

    def _update_heading(self, time_ns: int, heading_rad: float, variance: float) -> Gate:
        if self._velocity_ns is None:
            self._start(time_ns, heading_rad, variance)
            return "accepted"
        pp, pr, rr = self._covariance
        total = pp + variance
        innovation = angle_difference(heading_rad, self._heading)
        if innovation * innovation > _OUTLIER_SIGMAS**2 * total:
            self._outliers += 1
            if self._outliers < _OUTLIERS_UNTIL_RESTART:
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

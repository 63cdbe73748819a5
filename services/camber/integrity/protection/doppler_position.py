"""Position by satellite Doppler: velocities integrated since the last confirmed position (Kikuchi, reliability index).

The displacement is the sum by trapezoids. The errors of velocities that follow one another are alike: Gauss–Markov with
the correlation time τ, so that the variance of the displacement grows with t² at first and with t later, 2 σ² τ t.
With P of the displacement, X its covariance with the velocity, V of the velocity, ρ = exp(−Δt / τ) and V_m the mean of
the two V:

    P' = P + Δt/2 (1 + ρ) (X + Xᵀ) + Δt²/2 (1 + ρ) V_m        X' = ρ X + Δt/2 (ρ V_m + V')

What cannot be checked by the wheels or the pose is no position, and what contradicts them ends the sum: a spoofer must
not carry the position away.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.angles import wrap_pi
from camber.schemas.base import Covariance3
from camber.schemas.gnss import SatelliteVelocity

Floats = NDArray[np.float64]

_KEPT = 32  # velocities: a verdict comes after those of its epoch


@dataclass(frozen=True, slots=True, kw_only=True)
class DopplerRules:
    """How far velocities are believed.

    The true σ of a velocity is `sigma_scale` times the claimed and a floor an axis; its errors are alike over
    `correlation_s`. The sum ends `longest_s` after the confirmed position, with a pause longer than `longest_pause_s`,
    and where speeds differ by more than `speed_gate_m_s`, or paths by `path_gate_m` and `path_share` of them, beyond
    what their σ explain.
    """

    sigma_scale: float = 1.5
    sigma_floor_m_s: float = 0.02
    correlation_s: float = 1.0
    longest_s: float = 30.0
    longest_pause_s: float = 0.3
    speed_gate_m_s: float = 0.5
    path_gate_m: float = 0.5
    path_share: float = 0.02
    acceleration_m_s2: float = 3.0
    sigmas: float = 5.0
    steepest: float = 0.3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Displacement:
    """Since the confirmed position: metres (3,) east, north, up, their covariance (3, 3), and the yaw of the vehicle.

    `checked`: there was a wheel speed all the time.
    """

    since_ns: int
    metres: Floats
    covariance_m2: Floats
    yaw_rad: float | None
    checked: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Velocity:
    time_ns: int
    metres_s: Floats
    covariance_m2_s2: Floats
    yaw_rad: float | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sum:
    since_ns: int
    velocity: _Velocity
    metres: Floats
    covariance_m2: Floats
    with_velocity: Floats
    path_m: float = 0.0
    slip_m: float = 0.0
    checked: bool = True


class DopplerPosition:
    """Integrates satellite velocities, checked by wheel speeds: the displacement since the last confirmed position."""

    def __init__(self, rules: DopplerRules) -> None:
        self._rules = rules
        self._velocities: deque[_Velocity] = deque(maxlen=_KEPT)
        self._speeds: deque[tuple[int, float]] = deque(maxlen=_KEPT)
        self._sum: _Sum | None = None

    def add_velocity(self, velocity: SatelliteVelocity) -> None:
        """A new velocity; one that is older than the last, or has no covariance, is of no use."""
        latest = self._read(velocity)
        if latest is None or (self._velocities and latest.time_ns <= self._velocities[-1].time_ns):
            return
        self._velocities.append(latest)
        if self._sum is not None:
            self._sum = self._after(self._sum, latest)

    def add_wheel_speed(self, time_ns: int, speed_m_s: float) -> None:
        """A new wheel speed."""
        if not self._speeds or time_ns > self._speeds[-1][0]:
            self._speeds.append((time_ns, speed_m_s))

    def begin(self, time_ns: int) -> None:
        """A position of this time has been confirmed: begin anew, with the velocities since that are here already."""
        before = [v for v in self._velocities if v.time_ns <= time_ns][-1:]
        later = [v for v in self._velocities if v.time_ns > time_ns]
        first = before or later
        if not first or abs(first[0].time_ns - time_ns) > self._rules.longest_pause_s * 1e9:
            self._sum = None
            return
        wheels_m_s = self._speed_at(first[0].time_ns)
        if wheels_m_s is not None and not self._is_driven(first[0], wheels_m_s):
            self._sum = None
            return
        running: _Sum | None = _Sum(
            since_ns=time_ns,
            velocity=replace(first[0], time_ns=time_ns),
            metres=np.zeros(3),
            covariance_m2=np.zeros((3, 3)),
            with_velocity=np.zeros((3, 3)),
            checked=wheels_m_s is not None,
        )
        for velocity in later:
            running = self._after(running, velocity) if running is not None else None
        self._sum = running

    def end(self) -> None:
        """What it says has been found wrong: nothing until the next confirmed position."""
        self._sum = None

    def forget_future(self, limit_ns: int) -> None:
        """Drop what is dated later than this."""
        while self._velocities and self._velocities[-1].time_ns > limit_ns:
            self._velocities.pop()
        while self._speeds and self._speeds[-1][0] > limit_ns:
            self._speeds.pop()
        if self._sum is not None and max(self._sum.since_ns, self._sum.velocity.time_ns) > limit_ns:
            self._sum = None

    def at(self, time_ns: int) -> Displacement | None:
        """The displacement at a time, moved on by the last velocity; None where it has ended or that is too old."""
        result, rules = self._sum, self._rules
        if result is None:
            return None
        velocity = result.velocity
        ahead_s = (time_ns - velocity.time_ns) / 1e9
        old = not (time_ns - result.since_ns) / 1e9 <= rules.longest_s
        if old or time_ns < result.since_ns or not abs(ahead_s) <= rules.longest_pause_s:
            return None
        turned_m = 0.5 * rules.acceleration_m_s2 * ahead_s**2
        covariance = (
            result.covariance_m2
            + abs(ahead_s) * (result.with_velocity + result.with_velocity.T)
            + ahead_s**2 * velocity.covariance_m2_s2
            + turned_m**2 * np.eye(3)
        )
        return Displacement(
            since_ns=result.since_ns,
            metres=result.metres + ahead_s * velocity.metres_s,
            covariance_m2=covariance,
            yaw_rad=velocity.yaw_rad,
            checked=result.checked,
        )

    def _read(self, velocity: SatelliteVelocity) -> _Velocity | None:
        claimed = _matrix(velocity.covariance_enu_m2_s2)
        if not np.linalg.eigvalsh(claimed)[0] >= -1e-9 * np.trace(claimed):
            return None
        covariance = self._rules.sigma_scale**2 * claimed + self._rules.sigma_floor_m_s**2 * np.eye(3)
        heading = velocity.heading_rad
        yaw = None if heading is None else wrap_pi(0.5 * math.pi - heading)
        return _Velocity(
            time_ns=velocity.time_ns,
            metres_s=np.array(velocity.velocity_enu_m_s),
            covariance_m2_s2=covariance,
            yaw_rad=yaw,
        )

    def _after(self, last: _Sum, now: _Velocity) -> _Sum | None:
        """The sum with one more velocity; None where it ends."""
        rules, before = self._rules, last.velocity
        step_s = (now.time_ns - before.time_ns) / 1e9
        if not step_s <= rules.longest_pause_s:
            return None
        rho = math.exp(-step_s / rules.correlation_s)
        mean = 0.5 * (before.covariance_m2_s2 + now.covariance_m2_s2)
        # Where the velocities become worse, so do the errors that they share with those before.
        worse = max(1.0, math.sqrt(np.trace(now.covariance_m2_s2) / np.trace(before.covariance_m2_s2)))
        common = worse * last.with_velocity
        covariance = (
            last.covariance_m2
            + 0.5 * step_s * (1.0 + rho) * (common + common.T)
            + 0.5 * step_s**2 * (1.0 + rho) * mean
        )
        with_velocity = rho * common + 0.5 * step_s * (rho * mean + now.covariance_m2_s2)
        metres = last.metres + 0.5 * step_s * (before.metres_s + now.metres_s)
        sum_now = replace(
            last, velocity=now, metres=metres, covariance_m2=covariance, with_velocity=with_velocity
        )
        wheels_m_s = self._speed_at(now.time_ns)
        if wheels_m_s is None:
            return replace(sum_now, checked=False)
        path_m = last.path_m + abs(wheels_m_s) * step_s
        slip_m = last.slip_m + _over_m_s(now, wheels_m_s) * step_s
        path_limit = rules.path_gate_m + rules.path_share * path_m + rules.sigmas * _largest_sigma(covariance)
        if not (self._is_driven(now, wheels_m_s) and abs(slip_m) <= path_limit):
            return None
        return replace(sum_now, path_m=path_m, slip_m=slip_m)

    def _is_driven(self, velocity: _Velocity, wheels_m_s: float) -> bool:
        """Is it one that a vehicle whose wheels turn so fast can have, along its way and upwards?"""
        rules = self._rules
        limit = rules.speed_gate_m_s + rules.sigmas * _largest_sigma(velocity.covariance_m2_s2)
        up_sigma_m_s = math.sqrt(velocity.covariance_m2_s2[2, 2])
        climb_limit = rules.speed_gate_m_s + rules.steepest * abs(wheels_m_s) + rules.sigmas * up_sigma_m_s
        climbs = abs(velocity.metres_s[2]) <= climb_limit
        return bool(abs(_over_m_s(velocity, wheels_m_s)) <= limit and climbs)

    def _speed_at(self, time_ns: int) -> float | None:
        near = min(self._speeds, key=lambda speed: abs(speed[0] - time_ns), default=None)
        if near is None or abs(near[0] - time_ns) > self._rules.longest_pause_s * 1e9:
            return None
        return near[1]


def _matrix(upper_triangle: Covariance3) -> Floats:
    ee, en, eu, nn, nu, uu = upper_triangle
    return np.array([[ee, en, eu], [en, nn, nu], [eu, nu, uu]])


def _over_m_s(velocity: _Velocity, wheels_m_s: float) -> float:
    """By how much it is faster over the ground than the wheels are."""
    return float(np.hypot(velocity.metres_s[0], velocity.metres_s[1])) - abs(wheels_m_s)


def _largest_sigma(covariance: Floats) -> float:
    """Of the horizontal part, by its trace: never too small."""
    return math.sqrt(covariance[0, 0] + covariance[1, 1])

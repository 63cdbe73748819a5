"""Comparison of positions with the path by odometry, over windows of 10 to 300 s.

Three positions z_0, z_m, z_1 of the vehicle's reference point begin a window, end its first part, and end it. Odometry
gives the two displacements p(s) = (p_m, p_1 − p_m) in a frame of its own, by the sensors' errors s ~ N(s_0, P_s) and
with a noise N. The direction φ of that frame is unknown:

    r = R(−φ) (z_m − z_0, z_1 − z_m) − p(s)
    T = min over φ, s of r' (N + R(−φ) F R(φ))⁻¹ r + (s − s_0)' P_s⁻¹ (s − s_0),

with F the covariance of the positions' differences. T is χ² with three degrees of freedom: the lengths of both
displacements and the bend between them. Positions led away along the way change the lengths, as soon as they do; led
away across, the bend, only while they begin to. It is the generalised likelihood ratio test (Kay, Fundamentals of
Statistical Signal Processing II, ch. 6) of "no drift". A path that a bias has bent by degrees is not linear in it: s is
iterated (Gauss-Newton) as φ is.

The sensors' errors must be known without the positions compared: from the filter that no fix anchors, or a priori.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import (
    BIAS_A,
    BIAS_B,
    N_MOTION,
    SCALE,
    TURN_GAIN,
    WHEEL_LAG,
    propagate,
)
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionModel, MotionStep, yaw_rate

WINDOWS_S: Final = (10.0, 30.0, 100.0, 300.0)  # of the second part
FIRST_PART_S: Final = 30.0  # chosen: the heading of a longer first part is the gyro's, not the positions'
THRESHOLD: Final = 30.665  # χ², three degrees of freedom, 1e-6
SEGMENT_S: Final = 5.0  # chosen: half of the shortest part
_SENSORS: Final = slice(BIAS_A, WHEEL_LAG + 1)
_N_SENSORS: Final = WHEEL_LAG + 1 - BIAS_A
_CHANGE: Final = np.arange(5, 5 + _N_SENSORS)
_MIN_PART_M: Final = 20.0  # chosen: the direction of a shorter displacement is not determined to 1°
_ITERATIONS: Final = 5  # from a start within some degrees it converges in three


class PlacedPosition(NamedTuple):
    """A position of the reference point, east and north (2,) [m], and its covariance (2, 2), at the present time."""

    position_m: Floats
    covariance: Floats


class PathSegment(NamedTuple):
    """Motion over some seconds in a frame that begins at zero: displacement and turn (3,), their derivatives (3, 6) by
    the sensors' errors, and the covariance (3, 3) of the rest; what the sensors' errors change by in it (6,)."""

    lasts_s: float
    moved: Floats
    by_sensors: Floats
    noise: Floats
    sensor_change_var: Floats


class PathTest(NamedTuple):
    """Outcome of one window: the statistic, the drift of the positions in its second part [m/s], along and to the left
    of the way, and how far that has led them in the plane, east and north [m]."""

    window_s: float
    statistic: float
    along_m_s: float
    across_m_s: float
    departure_m: tuple[float, float]

    @property
    def contradicts(self) -> bool:
        """Whether positions and odometry contradict each other."""
        return self.statistic > THRESHOLD


class SegmentOdometry:
    """Propagates one segment."""

    def __init__(self, motion: MotionModel, sensors: FilterState) -> None:
        self._motion, self._lasts_s, self._path_m = motion, 0.0, 0.0
        self._x, self._p = np.zeros(N_MOTION), np.zeros((N_MOTION, N_MOTION))
        self._x[_SENSORS] = sensors.x[_SENSORS]
        self._sensors_p = sensors.p[_SENSORS, _SENSORS].copy()
        self._p[_SENSORS, _SENSORS] = self._sensors_p

    @property
    def lasts_s(self) -> float:
        """How long it has lasted."""
        return self._lasts_s

    def advance(self, step: MotionStep) -> None:
        """Propagate by a step of the motion."""
        x, motion = self._x, self._motion
        bias, scale, gain = float(x[BIAS_A]), float(x[SCALE]), float(x[TURN_GAIN])
        turn = yaw_rate(step, motion.a_rate_sensor, motion, bias=bias, scale=scale, gain=gain)
        propagate(x, self._p, step, turn=turn, model=motion)
        self._lasts_s += step.dt_s
        self._path_m += abs(step.speed_m_s) * step.dt_s

    def close(self) -> PathSegment:
        """Return the segment."""
        by_sensors: Floats = np.asarray(np.linalg.solve(self._sensors_p, self._p[_SENSORS, :3]).T, np.float64)
        return PathSegment(
            lasts_s=self._lasts_s,
            moved=self._x[:3].copy(),
            by_sensors=by_sensors,
            noise=self._p[:3, :3] - by_sensors @ self._sensors_p @ by_sensors.T,
            sensor_change_var=self._sensor_change_var(),
        )

    def _sensor_change_var(self) -> Floats:
        """Return the process noise (6,) of the sensors' errors over the segment."""
        model, change = self._motion, np.zeros(_N_SENSORS)
        for index, sensor in ((BIAS_A, model.a_rate_sensor), (BIAS_B, model.b_rate_sensor)):
            share = -math.expm1(-2.0 * self._lasts_s / model.bias_time_s(sensor))
            change[index - BIAS_A] = share * model.bias_sigma(sensor) ** 2
        share = -math.expm1(-2.0 * self._path_m / model.speed_scale_length_m)
        change[SCALE - BIAS_A] = share * model.speed_scale_sigma**2
        change[WHEEL_LAG - BIAS_A] = model.wheel_lag_wander_s_sqrt_s**2 * self._lasts_s
        return change


class PathWindow(NamedTuple):
    """The segments of both parts, the positions that begin and end them, and the covariance (6, 6) of the sensors'
    errors."""

    parts: tuple[Sequence[PathSegment], Sequence[PathSegment]]
    positions: tuple[PlacedPosition, PlacedPosition, PlacedPosition]
    sensors_p: Floats

    def displacements(self, error: Floats) -> tuple[Floats, Floats, Floats]:
        """Return both displacements (4,) for errors (6,) of the sensors beyond their estimates, their derivatives
        (4, 6) by these, and the covariance (4, 4) of the rest."""
        pose, slope = np.zeros(3), np.zeros((3, _N_SENSORS))
        noise = np.zeros(
            (5 + _N_SENSORS, 5 + _N_SENSORS)
        )  # of the pose, the middle, the sensors' change since
        middle, middle_slope = np.zeros(2), np.zeros((2, _N_SENSORS))
        for number, part in enumerate(self.parts):
            for segment in part:
                turn = np.eye(3)
                turn[:2, :2] = rotation(float(pose[2]))
                moved = turn @ (segment.moved + segment.by_sensors @ error)
                by_sensors = turn @ segment.by_sensors
                carry = np.eye(len(noise))
                carry[0, 2], carry[1, 2] = -moved[1], moved[0]
                carry[:3, 5:] = by_sensors
                noise = carry @ noise @ carry.T
                noise[:3, :3] += turn @ segment.noise @ turn.T
                noise[_CHANGE, _CHANGE] += segment.sensor_change_var
                pose, slope = pose + moved, carry[:3, :3] @ slope + by_sensors
            if number == 0:
                middle, middle_slope = pose[:2].copy(), slope[:2].copy()
                noise[3:5] = noise[:2]
                noise[:, 3:5] = noise[:, :2]
        both = np.zeros((4, len(noise)))
        both[:2, 3:5] = np.eye(2)
        both[2:, :2], both[2:, 3:5] = np.eye(2), -np.eye(2)
        path = np.concatenate((middle, pose[:2] - middle))
        return path, np.vstack((middle_slope, slope[:2] - middle_slope)), both @ noise @ both.T

    def compare(self) -> PathTest | None:
        """Compare odometry with the positions; None where a part is too short for a direction."""
        begin, middle, end = self.positions
        moved = np.concatenate((middle.position_m - begin.position_m, end.position_m - middle.position_m))
        a, b, c = begin.covariance, middle.covariance, end.covariance
        fixes = np.block([[a + b, -b], [-b, b + c]])
        error = np.zeros(_N_SENSORS)
        path, by_sensors, noise = self.displacements(error)
        if min(np.hypot(*path[:2]), np.hypot(*path[2:])) < _MIN_PART_M:
            return None
        phi = _direction(moved, path)
        for _ in range(_ITERATIONS):
            back = np.kron(np.eye(2), rotation(-phi))
            seen = back @ moved
            weight = np.linalg.inv(by_sensors @ self.sensors_p @ by_sensors.T + noise + back @ fixes @ back.T)
            slope = turned_left(seen)  # of the residual, by less φ
            residual = seen - path + by_sensors @ error
            more = float(slope @ weight @ residual) / float(slope @ weight @ slope)
            phi, residual = phi + more, residual - more * slope
            error = self.sensors_p @ by_sensors.T @ weight @ residual
            path, by_sensors, noise = self.displacements(error)
        lasts_s = sum(segment.lasts_s for segment in self.parts[1])
        departure = _departure(residual, slope, weight, path)
        east, north = rotation(math.atan2(path[3], path[2]) + phi) @ departure
        along, left = departure / lasts_s
        statistic = float(residual @ weight @ residual)
        return PathTest(
            window_s=lasts_s,
            statistic=statistic,
            along_m_s=float(along),
            across_m_s=float(left),
            departure_m=(float(east), float(north)),
        )


class PathComparison:
    """Keeps segments and the positions between them, and compares windows of them."""

    def __init__(self, motion: MotionModel, sensors: FilterState) -> None:
        self._motion, self._sensors = motion, sensors
        keep = math.ceil((WINDOWS_S[-1] + FIRST_PART_S) / SEGMENT_S)
        self._segments: deque[PathSegment] = deque(maxlen=keep)
        self._positions: deque[PlacedPosition] = deque(maxlen=keep + 1)
        self._present: SegmentOdometry | None = None

    def forget(self) -> None:
        """Forget the positions: they are another series."""
        self._segments.clear()
        self._positions.clear()
        self._present = None

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        origin = np.array((east_m, north_m))
        for _ in range(len(self._positions)):
            position = self._positions.popleft()
            self._positions.append(position._replace(position_m=position.position_m - origin))

    def advance(self, step: MotionStep) -> None:
        """Propagate the present segment by a step of the motion."""
        if self._present is not None:
            self._present.advance(step)

    def add(self, position: PlacedPosition) -> PathTest | None:
        """Add a position of the present; return the comparison that contradicts most of those that end with it."""
        if self._present is not None and self._present.lasts_s < SEGMENT_S:
            return None
        if self._present is not None:
            if self._present.lasts_s > 2.0 * SEGMENT_S:  # without positions: the parts would be too unequal
                self.forget()
            else:
                self._segments.append(self._present.close())
        self._positions.append(position)
        self._present = SegmentOdometry(self._motion, self._sensors)
        windows = (self._window(length_s) for length_s in WINDOWS_S)
        tests = [window.compare() for window in windows if window is not None]
        return max(
            (test for test in tests if test is not None), key=lambda test: test.statistic, default=None
        )

    def _window(self, length_s: float) -> PathWindow | None:
        segments = list(self._segments)
        second = _count(segments[::-1], length_s)
        first = (
            None
            if second is None
            else _count(segments[: len(segments) - second][::-1], min(length_s, FIRST_PART_S))
        )
        if first is None or second is None:
            return None
        last = len(segments)
        begins = last - second - first, last - second, last
        parts = segments[begins[0] : begins[1]], segments[begins[1] :]
        sensors_p = self._sensors.p[_SENSORS, _SENSORS].copy()
        positions = tuple(self._positions[k] for k in begins)
        return PathWindow(parts, (positions[0], positions[1], positions[2]), sensors_p)


def _count(newest_first: Sequence[PathSegment], length_s: float) -> int | None:
    """Return how many segments last so long; None where they do not."""
    lasts_s = 0.0
    for number, segment in enumerate(newest_first, 1):
        lasts_s += segment.lasts_s
        if lasts_s >= length_s:
            return number
    return None


def rotation(angle_rad: float) -> Floats:
    """Return the rotation (2, 2) by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array(((cos, -sin), (sin, cos)))


def turned_left(vectors: Floats) -> Floats:
    """Return pairs (4,) turned by a right angle to the left."""
    return np.array((-vectors[1], vectors[0], -vectors[3], vectors[2]))


def _direction(moved: Floats, path: Floats) -> float:
    """Return the rotation from the path's frame to the plane that fits both displacements best."""
    cross = path[0] * moved[1] - path[1] * moved[0] + path[2] * moved[3] - path[3] * moved[2]
    return math.atan2(float(cross), float(path @ moved))


def _departure(residual: Floats, slope: Floats, weight: Floats, path: Floats) -> Floats:
    """Return the departure (2,) over the second part, along and to the left, by least squares; φ is free."""
    ahead = path[2:] / np.hypot(*path[2:])
    design = np.zeros((4, 3))
    design[2:, 0] = ahead
    design[2:, 1] = (-ahead[1], ahead[0])
    design[:, 2] = slope
    departure = np.linalg.solve(design.T @ weight @ design, design.T @ weight @ residual)
    return np.asarray(departure[:2], dtype=np.float64)

"""Speed without wheels: what an accelerometer carries on, its error as a state, and standstills by a quiet unit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.localizer.filter.dead_reckoning_time_update import ACCELERATION_ERROR, SCALE, SPEED_ERROR
from camber.localizer.filter.odometry import InertialReading
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import AccelerationModel, PoseModel
from camber.schemas.motion import Motion
from support.pose_inputs import start_pose

START_NS = 1_300_000_000_000_000_000
DT_S = 0.02
MODEL = PoseModel(acceleration=AccelerationModel(error_sigma_m_s2=0.2))
MATCH = np.diag([0.03**2, 0.03**2, math.radians(0.1) ** 2])


class Drive:
    """A vehicle that drives to the east with an accelerometer of this error, and with wheels for a time."""

    def __init__(
        self, *, speed_m_s: float = 10.0, error_m_s2: float = 0.0, wheels_until_s: float = 2.0
    ) -> None:
        self.filter = PoseFilter(MODEL)
        self.speed_m_s, self.error_m_s2, self.wheels_until_s = speed_m_s, error_m_s2, wheels_until_s
        self.east_m, self.steps, self.quiet_s = 0.0, 0, 0.0
        self._predict(0.0, quiet=False)
        assert self.filter.start(start_pose(START_NS, (0.0, 0.0, 0.0), sigma_m=0.05, yaw_deg=0.1))

    @property
    def t_s(self) -> float:
        return self.steps * DT_S

    def run(
        self, seconds: float, *, acceleration_m_s2: float = 0.0, matches: bool = False, quiet: bool = False
    ) -> None:
        for _ in range(round(seconds / DT_S)):
            self.steps += 1
            self.east_m += self.speed_m_s * DT_S + 0.5 * acceleration_m_s2 * DT_S**2
            self.speed_m_s += acceleration_m_s2 * DT_S
            self._predict(acceleration_m_s2, quiet=quiet)
            if matches and self.steps % 5 == 0:
                pose = (self.east_m, 0.0, 0.0)
                self.filter.match(START_NS + round(self.t_s * 1e9), pose, MATCH, unique=True)

    def error(self) -> tuple[float, float]:
        """Error of the position and its σ, along."""
        estimate = self.filter.estimate()
        assert estimate is not None
        return estimate.east_m - self.east_m, math.sqrt(estimate.covariance[0, 0])

    def _predict(self, acceleration_m_s2: float, *, quiet: bool) -> None:
        self.quiet_s = self.quiet_s + DT_S if quiet else 0.0
        self.filter.predict(
            Motion(
                time_ns=START_NS + round(self.t_s * 1e9),
                wheel_speed_m_s=self.speed_m_s if self.t_s <= self.wheels_until_s else None,
                yaw_rate_rad_s=0.0,
            ),
            InertialReading(acceleration_m_s2 + self.error_m_s2, quiet_s=self.quiet_s),
        )


def test_the_accelerometer_carries_the_speed_of_wheels_on() -> None:
    drive = Drive()
    drive.run(3.0)
    drive.run(5.0, acceleration_m_s2=-1.0)
    error, sigma = drive.error()
    assert abs(error) < 1.0  # a speed that is held would be 12 m off
    assert abs(error) < 3.0 * sigma


@pytest.mark.parametrize("error_m_s2", [-0.3, 0.1, 0.3])
def test_what_the_acceleration_is_off_by_is_covered(error_m_s2: float) -> None:
    drive = Drive(error_m_s2=error_m_s2)
    drive.run(12.0)
    error, sigma = drive.error()
    assert abs(error) == pytest.approx(0.5 * abs(error_m_s2) * 10.0**2, rel=0.05)
    assert abs(error) < 3.0 * sigma


def test_matches_teach_speed_and_acceleration_error() -> None:
    drive = Drive(error_m_s2=0.3, wheels_until_s=-1.0)
    drive.run(20.0, matches=True)
    state = drive.filter.state
    assert state.x[ACCELERATION_ERROR] == pytest.approx(-0.3, abs=0.05)
    assert abs(drive.error()[0]) < 0.05
    drive.run(3.0)
    error, sigma = drive.error()
    assert abs(error) < 0.5
    assert abs(error) < 3.0 * sigma


@pytest.mark.parametrize("late_s", [0.0, 0.4])
def test_late_anchors_teach_the_speed_too(late_s: float) -> None:
    """The wheels have never given a speed; the vehicle drives at 10 m/s, and 4 m lie between an anchor and now."""
    drive = Drive(error_m_s2=0.2, wheels_until_s=-1.0)
    past: list[tuple[int, float]] = []
    for k in range(150):
        drive.run(0.2)
        past.append((START_NS + round(drive.t_s * 1e9), drive.east_m))
        time_ns, east_m = past[max(0, k - round(late_s / 0.2))]
        drive.filter.anchor(time_ns, east_m, 0.0, np.eye(2) * 0.05**2)
    error, sigma = drive.error()
    assert abs(error) < 0.15
    assert abs(error) < 3.0 * sigma
    assert drive.filter.state.x[ACCELERATION_ERROR] == pytest.approx(-0.2, abs=0.1)


def test_the_speed_is_stated_only_while_matches_hold_it() -> None:
    drive = Drive(wheels_until_s=-1.0)
    drive.run(1.0)
    assert estimated_speed(drive) is None
    drive.run(10.0, matches=True)
    assert estimated_speed(drive) == pytest.approx(10.0, abs=0.1)
    drive.run(1.0)
    assert estimated_speed(drive) is None


def test_a_quiet_unit_at_no_speed_stands_and_learns_its_bias() -> None:
    drive = Drive(error_m_s2=0.2)
    drive.run(3.0)
    drive.run(5.0, acceleration_m_s2=-2.0, matches=True)
    drive.speed_m_s = 0.0
    drive.run(30.0, quiet=True)
    error, sigma = drive.error()
    assert abs(error) < 0.3
    assert sigma < 0.3
    assert drive.filter.state.x[ACCELERATION_ERROR] == pytest.approx(-0.2, abs=0.05)


def test_a_smooth_road_is_no_standstill() -> None:
    drive = Drive()
    drive.run(3.0)
    drive.run(4.5, quiet=True)
    assert abs(drive.error()[0]) < 1.0


def test_a_unit_that_is_quiet_for_long_stands_whatever_the_speed_is_thought_to_be() -> None:
    drive = Drive(speed_m_s=0.0, wheels_until_s=-1.0)
    drive.run(1.0)
    drive.run(10.0, quiet=True)
    state = drive.filter.state
    assert state.p[SPEED_ERROR, SPEED_ERROR] < 0.05**2
    assert abs(drive.filter.track.at(drive.filter.time_ns or 0).path_m) < 1.0  # type: ignore[union-attr]


def test_a_steady_turn_is_no_standstill_and_no_bias() -> None:
    drive = Drive(speed_m_s=0.0, wheels_until_s=-1.0)
    for _ in range(500):
        drive.steps += 1
        drive.quiet_s += DT_S
        sample = Motion(time_ns=START_NS + round(drive.t_s * 1e9), yaw_rate_rad_s=math.radians(5.0))
        drive.filter.predict(sample, InertialReading(0.0, quiet_s=drive.quiet_s))
    estimate = drive.filter.estimate()
    assert estimate is not None
    assert estimate.yaw_rad == pytest.approx(math.radians(50.0), abs=math.radians(2.0))


def test_the_scale_that_was_learnt_and_the_age_of_the_wheel_speed_begin_the_integration() -> None:
    drive = Drive(wheels_until_s=0.5)
    drive.filter.state.x[SCALE] = 0.01
    drive.run(0.6)
    state = drive.filter.state
    assert state.x[SPEED_ERROR] == pytest.approx(0.1, abs=0.02)
    assert 0.3 < math.sqrt(state.p[SPEED_ERROR, SPEED_ERROR]) < 0.6


def test_a_dead_unit_without_wheels_keeps_what_is_known_of_the_speed() -> None:
    drive = Drive(wheels_until_s=-1.0)
    drive.run(10.0, matches=True)
    for _ in range(50):
        drive.steps += 1
        drive.east_m += drive.speed_m_s * DT_S
        drive.filter.predict(Motion(time_ns=START_NS + round(drive.t_s * 1e9), yaw_rate_rad_s=0.0))
    error, sigma = drive.error()
    assert abs(error) < 0.5
    assert abs(error) < 3.0 * sigma


def test_positions_give_no_heading_to_a_track_without_a_speed() -> None:
    """A vehicle that slows down from an unknown speed has a track that fits its positions in reverse."""
    pose_filter = PoseFilter(MODEL)
    east_m, speed_m_s, outcomes = 0.0, 10.0, set()
    for k in range(500):
        time_ns = START_NS + k * 20_000_000
        pose_filter.predict(Motion(time_ns=time_ns, yaw_rate_rad_s=0.0), InertialReading(-0.5))
        if k % 50 == 49:
            outcomes.add(pose_filter.anchor(time_ns, east_m, 0.0, np.eye(2) * 0.05**2).outcome)
        speed_m_s -= 0.5 * DT_S
        east_m += speed_m_s * DT_S
    assert outcomes == {"no_speed"}


def test_wheels_that_come_back_end_the_integration() -> None:
    drive = Drive(error_m_s2=0.3)
    drive.run(6.0)
    assert drive.filter.speed_is_integrated
    drive.wheels_until_s = math.inf
    drive.run(0.1)
    state = drive.filter.state
    assert not drive.filter.speed_is_integrated
    assert state.p[SPEED_ERROR, SPEED_ERROR] == state.p[ACCELERATION_ERROR, ACCELERATION_ERROR] == 0.0
    assert estimated_speed(drive) == pytest.approx(10.0, abs=0.1)


def estimated_speed(drive: Drive) -> float | None:
    estimate = drive.filter.estimate()
    assert estimate is not None
    return estimate.speed_m_s

"""Starting without an anchor: from fixes that agree with the motion, and from what does not."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.filter.heading_search import HeadingSearch, TrackedPosition
from camber.localizer.filter.odometry import MotionModel, WheelOdometry
from camber.localizer.filter.planar_pose import covariance_at_offset, rotated
from camber.localizer.filter.start_from_fixes import StartFromFixes, StartPose
from camber.localizer.filter.track import RelativeTrack
from support.pose_inputs import sample

FIX = np.eye(2) * 0.02**2
STEP_NS = 200_000_000


class Drive:
    """A vehicle with its own track and fixes of its antenna."""

    def __init__(self, yaw=0.0, east=0.0, north=0.0, antenna=(0.0, 0.0), seed=1):
        print("seed", seed)
        self.rng = np.random.default_rng(seed)
        self.antenna, self.yaw, self.place = antenna, yaw, np.array([east, north])
        self.track, self.odometer, self.time_ns = RelativeTrack(), WheelOdometry(MotionModel()), 0
        self.start = StartFromFixes(*antenna)
        self.step(0.0, 0.0)

    def step(self, speed, rate):
        middle = self.yaw + 0.1 * rate
        self.place = self.place + 0.2 * speed * np.array([math.cos(middle), math.sin(middle)])
        self.yaw += 0.2 * rate
        self.time_ns += STEP_NS
        step = self.odometer.advance(sample(self.time_ns, speed, rate), 0.0)
        self.track.append(self.time_ns, step, speed, rate)

    def fix(self, error=(0.0, 0.0)):
        at = self.place + rotated(self.yaw, *self.antenna) + error + self.rng.normal(0, 0.02, 2)
        return self.start.add(self.time_ns, (float(at[0]), float(at[1])), FIX, self.track)


def test_at_a_standstill_the_heading_stays_unknown():
    drive = Drive(antenna=(1.0, 0.0))
    poses = []
    for _ in range(20):
        drive.step(0.0, 0.0)
        poses.append(drive.fix())
    assert poses[3] is None
    assert poses[-1] is not None
    assert poses[-1].yaw_rad is None
    assert poses[-1].covariance[2, 2] == pytest.approx(math.pi**2)
    assert poses[-1].covariance[0, 0] > 0.5 * 1.0


def test_a_few_fixes_or_a_short_time_are_not_enough():
    drive = Drive()
    for _ in range(5):
        drive.step(5.0, 0.0)
        assert drive.fix() is None, "five fixes, but only 0.8 s"
    drive.step(5.0, 0.0)
    assert drive.fix() is not None


@pytest.mark.parametrize(
    ("speed", "error"),
    [
        (5.0, lambda k: (0.0, 1.5 * (-1.0) ** (k // 4))),  # jumps
        (5.0, lambda k: (-1.0 * k, 0.0)),  # stays where it is
        (0.0, lambda k: (0.3 * k, 0.0)),  # moves, with a vehicle at rest
    ],
)
def test_fixes_that_do_not_follow_the_motion_are_refused(speed, error):
    drive = Drive()
    for k in range(60):
        drive.step(speed, 0.0)
        assert drive.fix(error(k)) is None


def test_a_gap_in_the_fixes_begins_anew():
    drive = Drive()
    for _ in range(4):
        drive.step(5.0, 0.0)
        assert drive.fix() is None
    for _ in range(15):
        drive.step(5.0, 0.0)
    assert drive.fix() is None


def test_repeated_and_late_fixes_do_not_count():
    drive = Drive()
    for _ in range(3):
        drive.step(5.0, 0.0)
        for _ in range(10):
            assert drive.fix() is None


def test_fixes_outside_the_track_or_too_vague_do_not_count():
    drive = Drive()
    assert drive.start.add(10**15, (0.0, 0.0), FIX, drive.track) is None
    for _ in range(20):
        drive.step(5.0, 0.0)
        at = drive.place
        assert drive.start.add(drive.time_ns, (at[0], at[1]), np.eye(2) * 9.0, drive.track) is None


def test_the_origin_may_move_in_between():
    drive = Drive(east=500.0)
    for _ in range(3):
        drive.step(5.0, 0.0)
        drive.fix()
    drive.start.shift(400.0, 0.0)
    drive.place = drive.place - [400.0, 0.0]
    for _ in range(4):
        drive.step(5.0, 0.0)
        pose = drive.fix()
    assert pose.east_m == pytest.approx(drive.place[0], abs=0.2)


@settings(max_examples=30, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(1.0, 15.0), st.floats(-0.3, 0.3), st.integers(0, 10_000))
def test_moving_fixes_that_agree_determine_position_and_heading(yaw, speed, rate, seed):
    drive = Drive(yaw=yaw, east=100.0, north=-50.0, antenna=(1.2, 0.3), seed=seed)
    pose = None
    for _ in range(30):
        drive.step(speed, rate)
        pose = drive.fix() or pose
    assert pose.provenance == "fixes"
    error = np.array([pose.east_m, pose.north_m, math.remainder(pose.yaw_rad - drive.yaw, math.tau)])
    error -= (*drive.place, 0.0)
    assert error @ np.linalg.solve(pose.covariance, error) < 31.8, "as many as 5 sigma in one dimension"
    assert abs(error[2]) < 5.0 * math.sqrt(pose.covariance[2, 2])
    assert math.hypot(*error[:2]) < 0.2
    assert np.linalg.eigvalsh(pose.covariance)[0] > 0.0


def test_two_positions_and_the_track_between_them_determine_the_heading():
    drive = Drive(yaw=1.0)
    first = TrackedPosition(drive.place[0], drive.place[1], 0.05**2, drive.track.at(drive.time_ns))
    for _ in range(10):
        drive.step(5.0, 0.1)
    then = TrackedPosition(drive.place[0], drive.place[1], 0.05**2, drive.track.at(drive.time_ns))
    assert HeadingSearch(first, (0.0, 0.0)).add(then)[0] == pytest.approx(1.0, abs=1e-6)
    elsewhere = then._replace(east_m=then.east_m + 30.0)
    assert HeadingSearch(first, (0.0, 0.0)).add(elsewhere) is None


def test_a_covariance_is_carried_to_another_point_of_the_vehicle_by_its_derivatives():
    pose, root = np.array([3.0, -2.0, 0.7]), np.random.default_rng(3).standard_normal((3, 3))

    def point(x):
        return np.add(x, (*rotated(x[2], 2.0, -1.0), 0.0))

    f = np.column_stack([(point(pose + e) - point(pose - e)) / 2e-6 for e in 1e-6 * np.eye(3)])
    moved = covariance_at_offset(root @ root.T, *rotated(0.7, 2.0, -1.0))
    np.testing.assert_allclose(moved, f @ root @ root.T @ f.T, atol=1e-6)


@pytest.mark.parametrize("name", ["east_m", "north_m", "yaw_rad"])
def test_a_start_that_is_not_finite_is_refused_by_name(name):
    values = {"east_m": 0.0, "north_m": 0.0, "yaw_rad": 0.0, name: math.nan}
    with pytest.raises(ValueError, match=f"^{name}:"):
        StartPose(time_ns=0, covariance=np.eye(3), **values)


@pytest.mark.parametrize(
    ("covariance", "why"),
    [
        (np.zeros((3, 3)), "must be positive definite"),
        (np.eye(3) + np.eye(3, k=1) * 0.1, "must be symmetric"),
        (np.eye(2), "expected shape"),
        (np.eye(3) * math.nan, "every element must be finite"),
    ],
)
def test_a_start_needs_a_covariance(covariance, why):
    with pytest.raises(ValueError, match=f"^covariance: {why}"):
        StartPose(time_ns=0, east_m=0.0, north_m=0.0, yaw_rad=0.0, covariance=covariance)


def test_a_fix_that_is_not_finite_is_refused_by_name():
    drive = Drive()
    with pytest.raises(ValueError, match=r"^north_m:"):
        drive.start.add(0, (0.0, math.nan), FIX, drive.track)
    with pytest.raises(ValueError, match=r"^covariance:"):
        drive.start.add(0, (0.0, 0.0), FIX * math.nan, drive.track)

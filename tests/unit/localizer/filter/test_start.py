"""Starting without an anchor: from fixes that agree with the motion, and from what does not."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.filter.heading_search import HeadingModel, HeadingSearch, TrackedPosition
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


def test_moving_fixes_that_agree_determine_position_and_heading():
    drive = Drive(yaw=2.0, east=100.0, north=-50.0, antenna=(1.2, 0.3))
    pose = None
    for k in range(60):
        drive.step(5.0, 0.1 * math.sin(0.1 * k))
        pose = drive.fix() or pose
    assert pose.provenance == "fixes"
    error = np.array([pose.east_m, pose.north_m, pose.yaw_rad]) - [*drive.place, drive.yaw]
    assert error @ np.linalg.solve(pose.covariance, error) < 16.3
    assert math.hypot(*error[:2]) < 0.2


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


def test_fixes_that_jump_begin_anew():
    drive = Drive()
    for k in range(30):
        drive.step(5.0, 0.0)
        assert drive.fix((0.0, 1.5 * (-1.0) ** (k // 4))) is None


def test_fixes_that_do_not_cover_the_distance_driven_are_refused():
    drive = Drive()
    for _ in range(60):
        drive.step(5.0, 0.0)
        assert drive.start.add(drive.time_ns, (1.0, 2.0), FIX, drive.track) is None


def test_moving_fixes_of_a_vehicle_at_rest_are_refused():
    drive = Drive()
    for k in range(60):
        drive.step(0.0, 0.0)
        assert drive.fix((0.3 * k, 0.0)) is None


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
def test_the_heading_is_within_its_sigma(yaw, speed, rate, seed):
    drive = Drive(yaw=yaw, antenna=(1.0, -0.5), seed=seed)
    pose = None
    for _ in range(30):
        drive.step(speed, rate)
        pose = drive.fix() or pose
    assert pose.yaw_rad is not None
    error = math.remainder(pose.yaw_rad - drive.yaw, math.tau)
    assert abs(error) < 5.0 * math.sqrt(pose.covariance[2, 2])
    assert np.linalg.eigvalsh(pose.covariance)[0] > 0.0


def a_place(east, north, drive, sigma=0.05):
    return TrackedPosition(east, north, sigma**2, drive.track.at(drive.time_ns))


def test_without_a_heading_the_driven_distance_spreads_over_a_circle():
    drive = Drive()
    search = HeadingSearch(a_place(10.0, 20.0, drive), (0.0, 0.0), HeadingModel())
    for _ in range(50):
        drive.step(5.0, 0.0)
    east, north, variance = search.spread(drive.track.at(drive.time_ns))
    assert (east, north) == (10.0, 20.0)
    assert 13.82 * variance > 50.0**2, "the circle lies within the 99.9 % ellipse"


def test_two_positions_and_the_track_between_them_determine_the_heading():
    drive = Drive(yaw=1.0)
    search = HeadingSearch(a_place(*drive.place, drive), (0.0, 0.0), HeadingModel())
    heading = None
    for _ in range(10):
        drive.step(5.0, 0.1)
        heading = heading or search.add(a_place(*drive.place, drive))
    assert heading[0] == pytest.approx(1.0, abs=1e-6)


def test_a_position_the_track_does_not_lead_to_determines_nothing():
    drive = Drive()
    search = HeadingSearch(a_place(0.0, 0.0, drive), (0.0, 0.0), HeadingModel())
    for _ in range(10):
        drive.step(5.0, 0.0)
    assert search.add(a_place(30.0, 0.0, drive)) is None


def test_a_covariance_moved_by_a_lever_and_back_is_the_same():
    root = np.random.default_rng(3).standard_normal((3, 3))
    covariance = root @ root.T
    back = covariance_at_offset(covariance_at_offset(covariance, 2.0, -1.0), -2.0, 1.0)
    np.testing.assert_allclose(back, covariance, atol=1e-12)


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

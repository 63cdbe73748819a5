"""The latest inputs of the judge: the pose nearest in time, and nothing that is too old."""

import pytest

from camber.integrity.latest_inputs import LatestInputs
from camber.schemas.gnss import ReceiverIntegrity
from support.judging import ALL, antenna, at, pose


def latest(*epochs, **changes):
    result = LatestInputs()
    for epoch in epochs:
        result.add_pose(pose(epoch, **changes))
    return result


def test_before_any_message_nothing_is_known():
    assert latest().pose is None
    assert latest().pose_near(at(0)) is None
    assert latest().speed_at(at(0), 1.0) is None
    inputs = latest().inputs(at(0), ALL)
    assert (inputs.pose, inputs.antenna, inputs.alive) == (None, None, ALL)


@pytest.mark.parametrize(
    ("time", "epoch"), [(-5, 0), (0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (1, 1), (1.6, 2), (2.4, 2), (9, 3)]
)
def test_of_several_poses_it_is_the_nearest_and_of_two_as_near_the_earlier(time, epoch):
    assert latest(0, 1, 2, 3).inputs(at(time), ALL).pose == pose(epoch)


def test_a_pose_that_is_no_newer_is_ignored():
    result = latest(2, 1)
    result.add_pose(pose(2, east_m=5.0))
    assert list(result.poses) == [pose(2)]


def test_of_a_long_drive_only_the_newest_poses_are_kept():
    result = latest(*range(100))
    assert list(result.poses) == [pose(epoch) for epoch in range(36, 100)]


@pytest.mark.parametrize(("epoch", "near"), [(2.5, True), (-2.5, True), (2.51, False), (-2.51, False)])
def test_a_pose_gives_the_displacement_half_a_second_before_and_after(epoch, near):
    assert (latest(0).pose_near(at(epoch)) == pose(0)) == near
    assert near or latest(0).pose_near(at(epoch)) is None


def test_one_without_a_place_gives_none():
    assert latest(0, latitude_rad=None).pose_near(at(0)) is None


@pytest.mark.parametrize(("epoch", "speed_m_s"), [(2.5, 7.0), (-2.5, 7.0), (2.6, None), (-2.6, None)])
def test_the_speed_is_known_so_long(epoch, speed_m_s):
    result = LatestInputs()
    result.add_wheel_speed(at(0), 7.0)
    assert result.speed_at(at(epoch), 0.5) == speed_m_s


def test_no_speed_leaves_the_one_before():
    result = LatestInputs()
    result.add_wheel_speed(at(0), 7.0)
    result.add_wheel_speed(at(1), None)
    assert result.speed_at(at(1), 0.5) == 7.0


def test_what_is_dated_ahead_is_forgotten_and_what_is_of_now_is_not():
    result = latest(0, 1, 2)
    result.set_antenna_height(antenna(1))
    result.receiver.update(ReceiverIntegrity(time_ns=at(1), spoofing="affirmed"))
    result.forget_after(at(1))
    assert result.pose == pose(1)
    assert result.inputs(at(1), ALL).antenna == antenna(1)
    assert result.receiver.warning(at(1), 1.0) == "spoofing affirmed"
    result.forget_after(at(1) - 1)
    assert result.pose == pose(0)
    assert result.inputs(at(1), ALL).antenna is None
    assert result.receiver.warning(at(1), 1.0) is None
    result.forget_after(at(0) - 1)
    assert result.pose is None

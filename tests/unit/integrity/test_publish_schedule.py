"""When a verdict, a position or its absence is due to be published."""

import pytest

from camber.integrity.publish_schedule import PublishSchedule

S = 1_000_000_000
T = 10**18


def after(seconds):
    return T + round(seconds * S)


@pytest.mark.parametrize(("after_s", "due"), [(0.0, False), (0.05, False), (0.1, True), (-1.0, True)])
def test_a_verdict_is_due_when_there_was_none_for_a_tenth_of_a_second_or_the_clock_was_set_back(after_s, due):
    schedule = PublishSchedule()
    schedule.verdict(T)
    assert schedule.verdict_is_due(after(after_s)) is due


def test_at_first_everything_is_due():
    schedule = PublishSchedule()
    assert schedule.verdict_is_due(T)
    assert schedule.position_is_due(T, 0.3)
    assert schedule.pose_is_due(T)


def test_a_pose_is_news_once():
    schedule = PublishSchedule()
    schedule.position(T)
    assert not schedule.pose_is_due(T)
    assert schedule.pose_is_due(after(0.1))


@pytest.mark.parametrize(("after_s", "due"), [(0.0, False), (0.02, False), (0.03, True), (-0.01, False)])
def test_no_pose_overwrites_the_confirmed_position_of_its_epoch(after_s, due):
    schedule = PublishSchedule()
    schedule.rtk(T)
    assert schedule.pose_is_due(after(after_s)) is due


def test_a_confirmed_position_that_comes_late_does_not_make_an_old_pose_news():
    schedule = PublishSchedule()
    schedule.position(after(0.1))
    schedule.rtk(T)
    assert not schedule.pose_is_due(after(0.1))


@pytest.mark.parametrize(("after_s", "due"), [(0.3, False), (0.31, True), (-0.4, False)])
def test_an_unavailable_position_is_due_when_the_newest_is_too_old(after_s, due):
    schedule = PublishSchedule()
    schedule.position(T)
    assert schedule.position_is_due(after(after_s), 0.3) is due


def test_it_is_repeated_but_not_at_every_round():
    schedule = PublishSchedule()
    schedule.unavailable_position(T)
    assert not schedule.position_is_due(T, 0.3)
    assert not schedule.position_is_due(after(0.05), 0.3)
    assert schedule.position_is_due(after(0.1), 0.3)
    assert schedule.position_is_due(after(-5.0), 0.3)


def test_when_the_clock_is_set_back_poses_are_news_again():
    schedule = PublishSchedule()
    schedule.rtk(after(100.0))
    schedule.forget_after(after(100.0))
    assert not schedule.pose_is_due(T)
    schedule.forget_after(after(99.0))
    assert schedule.pose_is_due(T)

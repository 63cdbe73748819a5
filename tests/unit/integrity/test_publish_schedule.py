"""Silence is never an answer: when consumers have to be told something."""

import pytest

from camber.integrity.publish_schedule import PublishSchedule

S = 1_000_000_000
T = 10**18


def after(seconds):
    return T + round(seconds * S)


@pytest.mark.parametrize(("after_s", "due"), [(0.0, False), (0.05, False), (0.1, True), (-1.0, True)])
def test_a_verdict_is_due_when_there_was_none_for_a_tenth_of_a_second_or_the_clock_was_set_back(after_s, due):
    spoken = PublishSchedule()
    spoken.verdict(T)
    assert spoken.verdict_is_due(after(after_s)) is due


def test_at_first_everything_is_due():
    spoken = PublishSchedule()
    assert spoken.verdict_is_due(T)
    assert spoken.position_is_due(T, 0.3)
    assert spoken.pose_is_due(T)


def test_a_pose_is_news_once():
    spoken = PublishSchedule()
    spoken.position(T)
    assert not spoken.pose_is_due(T)
    assert spoken.pose_is_due(after(0.1))


@pytest.mark.parametrize(("after_s", "due"), [(0.0, False), (0.02, False), (0.03, True), (-0.01, False)])
def test_no_pose_overwrites_the_confirmed_position_of_its_epoch(after_s, due):
    spoken = PublishSchedule()
    spoken.rtk(T)
    assert spoken.pose_is_due(after(after_s)) is due


def test_a_confirmed_position_that_comes_late_does_not_make_an_old_pose_news():
    spoken = PublishSchedule()
    spoken.position(after(0.1))
    spoken.rtk(T)
    assert not spoken.pose_is_due(after(0.1))


@pytest.mark.parametrize(("after_s", "due"), [(0.3, False), (0.31, True), (-0.4, False)])
def test_the_word_that_there_is_no_position_is_due_when_the_newest_is_too_old(after_s, due):
    spoken = PublishSchedule()
    spoken.position(T)
    assert spoken.position_is_due(after(after_s), 0.3) is due


def test_it_is_repeated_but_not_at_every_round():
    spoken = PublishSchedule()
    spoken.unavailable_position(T)
    assert not spoken.position_is_due(T, 0.3)
    assert not spoken.position_is_due(after(0.05), 0.3)
    assert spoken.position_is_due(after(0.1), 0.3)
    assert spoken.position_is_due(after(-5.0), 0.3)


def test_when_the_clock_is_set_back_poses_are_news_again():
    spoken = PublishSchedule()
    spoken.rtk(after(100.0))
    spoken.forget_after(after(100.0))
    assert not spoken.pose_is_due(T)
    spoken.forget_after(after(99.0))
    assert spoken.pose_is_due(T)

"""What the judge carries on from fix to fix, and which poses it moves to where that is."""

import pytest

from camber.integrity.rules import Rules
from support.judging import ALL, SettlingJudge, antenna, at, fix, pose, provisional

RULES = Rules(horizontal_reference="assumed")


def judging(**changes):
    """A judge that has confirmed three fixes, with what they have in common."""
    judge = SettlingJudge(RULES)
    for k in range(3):
        epoch(judge, k, **changes)
    return judge


def epoch(judge, k, **changes):
    judge.latest.add_pose(pose(k, anchor_time_ns=at(k - 1)))
    judge.latest.set_antenna_height(antenna(k))
    return judge.judge(fix(k, **changes), at(k), ALL)


def carried_odds(judge):
    return judge._state.carried._base.odds


def test_a_fix_of_few_satellites_is_carried_as_one_that_is_oftener_wrong():
    few, many = (carried_odds(judging(satellites=count)) for count in (6, 20))
    assert few > 3.0 * many


def test_a_fix_without_a_covariance_or_a_pose_leaves_what_is_carried():
    for k, changes in ((3, {"covariance_enu_m2": None}), (900, {})):
        judge = judging()
        before = judge._state.carried._base
        assert before.confirmed_ns == at(2)
        assert not judge.judge(fix(k, **changes), at(k), ALL).confirmed
        assert judge._state.carried._base is before


LIMIT_M = RULES.pose_sigma_limit_m


@pytest.mark.parametrize(
    ("make", "sigma_m", "moved"),
    [
        (pose, 3.0, True),
        (pose, LIMIT_M, True),
        (pose, 1.01 * LIMIT_M, False),
        (provisional, 3.0, False),
    ],
)
def test_a_pose_is_moved_where_it_rests_on_more_than_unconfirmed_fixes_and_is_no_wider_than_its_limit(
    make, sigma_m, moved
):
    judge = judging()
    judge._state.carried.settle(fix(3, north_m=2.0), pose(3), None)
    given = make(3, sigma_m=sigma_m, east_m=1.0)
    judge.latest.add_pose(given)
    assert (judge.inputs(at(3), ALL).pose is not given) == moved

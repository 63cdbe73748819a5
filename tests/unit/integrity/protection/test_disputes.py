"""A fix with the road's height that the pose contradicts: one of both is wrong, and until that is known the pose is no
position to use beyond where the fix was."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.protection.pose_dispute import _is_out_of_reach, updated_agreement, updated_dispute
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent
from camber.integrity.protection.position_output import PositionOutput
from camber.integrity.rules import Rules
from support.judging import ALL, SPEED_M_S, SettlingJudge, antenna, at, fix, independent, pose

# Faults of single fixes: base station and signals are honest. `test_common_fault.py` has the others.
RULES, LEVELS = Rules(horizontal_reference="assumed"), LevelRules()
EPOCH_NS = at(1) - at(0)
exactly = settings(derandomize=True, deadline=None)


def sharp_pose(epoch=0, **changes):
    """Held by scan matching, of which the last one was half a second ago."""
    fields = {"mode": "scan_match", "provenance": "scan_match", "match_time_ns": at(epoch) - EPOCH_NS * 5}
    return pose(epoch, sigma_m=0.05, **fields | changes)


def examined(epoch=0, **off):
    """A fix so far off beside the sharp pose, as the judge finds it."""
    judge, the_pose = SettlingJudge(RULES), sharp_pose(epoch)
    judge.latest.add_pose(the_pose)
    judge.latest.set_antenna_height(antenna().model_copy(update={"time_ns": the_pose.time_ns}))
    return judge.examine(fix(epoch, **off), ALL)


def after(*judgements, levels=LEVELS):
    positions = PositionOutput(replace(RULES, levels=levels))
    for judgement in judgements:
        positions.update_dispute(judgement)
    return positions


def position(positions, epoch=1, **changes):
    return positions.at(
        at(epoch), EpochInputs(pose=sharp_pose(epoch, **changes), antenna=antenna(epoch), alive=ALL), 0.0
    )


UNDISPUTED = position(after())


def test_a_pose_that_a_fix_with_the_roads_height_contradicts_is_bounded_as_far_as_the_fix_and_no_farther():
    assert UNDISPUTED.usable
    for offset_m in (0.9, 5.0):
        result = position(after(examined(east_m=0.6 * offset_m, north_m=0.8 * offset_m)))
        assert offset_m < result.horizontal_protection_level_m < offset_m + 0.6
        assert result.usable is (offset_m < 1.0)
        assert result.reason == ("none" if offset_m < 1.0 else "pose_too_uncertain")
        assert result.vertical_protection_level_m == pytest.approx(
            UNDISPUTED.vertical_protection_level_m, rel=1e-2
        )
        assert result.semi_major_99_m == pytest.approx(UNDISPUTED.semi_major_99_m, rel=0.05)


def test_it_does_not_fade_and_ends_with_a_fix_that_agrees():
    disputing, agreeing = examined(east_m=5.0), examined(7.0)
    assert agreeing.comparison.position == 0
    assert not position(after(disputing), epoch=900).usable
    assert position(after(disputing, agreeing), epoch=8) == position(after(), epoch=8)
    confirmed = replace(disputing, verdict="confirmed")
    assert position(after(disputing, confirmed)) == UNDISPUTED
    unsure = replace(agreeing, verdict="unknown", reason="height_unverified")
    assert position(after(disputing, unsure), epoch=8) == position(after(), epoch=8)


@pytest.mark.parametrize("reason", ["phase_residuals_contradict", "receiver_warns", "common_offset"])
def test_a_fix_that_is_wrong_by_itself_or_by_its_base_does_not_dispute_the_pose(reason):
    disputing = examined(east_m=5.0)
    assert position(after(replace(disputing, reason=reason))) == UNDISPUTED
    later = replace(examined(1.0), verdict="unknown", reason=reason)
    assert not position(after(disputing, later)).usable


def test_a_fix_that_contradicts_in_height_too_is_wrong_by_itself():
    off = examined(east_m=5.0, up_m=1.0)
    assert off.reason == "height_and_position_disagree"
    assert position(after(off)) == UNDISPUTED
    later = examined(1.0, east_m=5.0, up_m=1.0)
    assert not position(after(examined(east_m=5.0), later), epoch=2).usable


def test_a_dispute_ends_where_another_fix_of_its_run_contradicts_in_height_and_that_run_begins_none_again():
    judge, positions = SettlingJudge(RULES), after()
    usable = []
    wrong = [
        (5.0, up_m) for up_m in (0.0, 0.0, 0.2, 0.45, 0.7, 0.45, 0.2, 0.0)
    ]  # over a road that falls and rises
    for epoch, (east_m, up_m) in enumerate([(0.0, 0.0)] * 3 + wrong):
        judge.latest.add_pose(sharp_pose(epoch))
        judge.latest.set_antenna_height(antenna(epoch))
        positions.update_dispute(judge.judge(fix(epoch, east_m=east_m, up_m=up_m), at(epoch), ALL))
        usable.append(position(positions, epoch).usable)
    assert usable == [True] * 3 + [False] * 3 + [True] * 5


def test_a_fix_between_agreement_and_contradiction_leaves_it_as_it_was():
    unverified = examined(1.0, east_m=0.4)
    assert unverified.reason == "position_unverified"
    assert position(after(unverified), epoch=2) == position(after(), epoch=2)
    assert not position(after(examined(east_m=5.0), unverified), epoch=2).usable


def test_a_fix_that_was_not_compared_leaves_it_as_it_was():
    disputing = examined(east_m=5.0)
    for other in (
        replace(examined(1.0), comparison=None),
        replace(examined(1.0), fix=fix(1.0, covariance_enu_m2=None), verdict="unknown"),
    ):
        other = replace(other, verdict="unknown")
        assert position(after(other)) == UNDISPUTED
        assert not position(after(disputing, other)).usable


def test_scan_matches_that_are_newer_than_the_dispute_bear_the_pose_out_at_a_second_place():
    apart = LEVELS.matches_apart_m / (SPEED_M_S * EPOCH_NS / 1e9)

    def driven(until, **changes):
        """The dispute began at the second epoch; a match at each."""
        disputed = after(examined(2.0, east_m=5.0), examined(4.0, east_m=5.0))
        for k in range(5, int(until)):
            position(disputed, k, **{"match_time_ns": at(k), **changes})
        return position(disputed, int(until), **{"match_time_ns": at(int(until)), **changes})

    assert not driven(5).usable, "one match may be false"
    assert not driven(5 + 0.9 * apart).usable, "what deceives it is the same at so near a place"
    assert driven(6 + apart).usable
    assert driven(6 + apart, match_time_ns=at(2) + 1).usable, "newer than its beginning"
    for old in ({"match_time_ns": at(2)}, {"match_time_ns": None}, {"mode": "dead_reckoning"}):
        assert not driven(6 + 2 * apart, **old).usable


def test_the_farther_off_the_newest_such_fix_the_larger_the_level():
    @exactly
    @given(st.floats(1.0, 20.0), st.floats(1.0, 3.0), st.floats(1e-6, 0.5), st.floats(1.0, 2.0))
    def holds(offset_m, factor, prior, more):
        def level_m(metres, share):
            levels = replace(LEVELS, disputed_pose_prior=min(share, 1.0))
            return position(after(examined(east_m=metres), levels=levels)).horizontal_protection_level_m

        least = level_m(offset_m, prior)
        assert level_m(offset_m * factor, prior) >= least * (1.0 - 1e-3)
        assert level_m(offset_m, prior * more) >= least * (1.0 - 1e-3)

    holds()


def test_what_is_dated_ahead_disputes_from_now_on():
    disputed = after(examined(50.0, east_m=5.0))
    disputed.forget_future(at(1))
    ahead_ns = round(RULES.future_limit_s * 1e9)
    assert not position(disputed).usable
    assert disputed._dispute.begun_ns == disputed._dispute.time_ns == at(1) + ahead_ns
    unchanged = after(examined(0.0, east_m=5.0))
    unchanged.forget_future(at(1))
    assert unchanged._dispute.begun_ns == at(0)
    just = after(examined(0.0, east_m=5.0), examined(5.0, east_m=5.0))
    just.forget_future(at(5) - ahead_ns)
    assert just._dispute.begun_ns == at(0)


def test_the_dispute_is_that_of_the_newest_fix_and_began_with_the_first():
    first = updated_dispute(examined(0.0, east_m=3.0), None, RULES.true_sigma)
    second = updated_dispute(examined(1.0, east_m=4.0), first, RULES.true_sigma)
    assert (second.begun_ns, second.time_ns) == (at(0), at(1))
    assert second.east_m == pytest.approx(4.0, abs=1e-3)


@pytest.mark.parametrize("unknown", ["latitude_rad", "longitude_rad"])
def test_a_match_without_a_place_corroborates_nothing(unknown):
    disputed = updated_dispute(examined(0.0, east_m=3.0), None, RULES.true_sigma)
    assert disputed.update(sharp_pose(1, match_time_ns=at(1)), LEVELS).matches == 1
    assert disputed.update(sharp_pose(1, match_time_ns=at(1), **{unknown: None}), LEVELS) == disputed


def test_a_newer_fix_that_says_so_too_does_not_make_one_place_two():
    disputed = updated_dispute(examined(0.0, east_m=3.0), None, RULES.true_sigma)
    once = disputed.update(sharp_pose(1, match_time_ns=at(1)), LEVELS)
    again = updated_dispute(examined(2.0, east_m=3.0), once, RULES.true_sigma)
    assert again.update(sharp_pose(3, match_time_ns=at(3)), LEVELS).matches == 1
    assert again.update(sharp_pose(100, match_time_ns=at(100)), LEVELS).matches == 2


def test_the_mixture_has_the_pose_and_the_place_of_the_fix():
    disputed = updated_dispute(examined(0.0, east_m=3.0, north_m=4.0), None, RULES.true_sigma)
    alone = MixtureComponent(weight=1.0, horizontal_m2=(0.01, 0.0, 0.01), up_m2=0.1)
    parts = (alone.weighed(0.9), alone.weighed(0.1))
    *others, there = disputed.with_alternative(parts, alone, 0.2)
    assert [part.weight for part in (*others, there)] == pytest.approx([0.72, 0.08, 0.2])
    assert there.mean_m == pytest.approx((-3.0, -4.0, 0.0), abs=1e-3), (
        "the error of the pose, were the fix right"
    )
    assert not there.is_latent


# --- out of reach --------------------------------------------------------------------------------------------------


def agreement(epoch=0.0, speed_m_s=SPEED_M_S):
    agreeing = replace(examined(epoch), verdict="confirmed")
    return replace(updated_agreement(agreeing, None), speed_m_s=speed_m_s)


def test_only_a_confirmed_fix_that_agrees_with_a_pose_of_known_speed_is_an_agreement():
    agreeing = replace(examined(0.0), verdict="confirmed")
    before = updated_agreement(agreeing, None)
    assert (before.time_ns, before.speed_m_s) == (at(0), SPEED_M_S)
    assert before.tolerance_m < 0.5
    for other in (
        replace(agreeing, verdict="unknown"),
        replace(agreeing, comparison=None),
        replace(agreeing, pose=None),
        replace(agreeing, pose=sharp_pose(latitude_rad=None)),
        replace(agreeing, pose=sharp_pose(speed_m_s=None)),
        replace(examined(0.0, east_m=5.0), verdict="confirmed"),
    ):
        assert updated_agreement(other, before) is before


def disputed(epoch, off_m, since, before=None):
    return updated_dispute(examined(epoch, east_m=off_m), before, RULES.true_sigma, since)


@exactly
@given(st.floats(0.5, 40.0), st.floats(0.0, 30.0), st.floats(1.0, 60.0))
def test_what_the_vehicle_can_have_reached_is_never_out_of_reach(epochs, speed_m_s, off_m):
    since, duration_s = agreement(speed_m_s=speed_m_s), epochs * EPOCH_NS / 1e9
    can_m = speed_m_s * duration_s + 5.0 * duration_s**2
    dispute = disputed(epochs, off_m, since)
    if off_m <= can_m:
        assert not dispute.out_of_reach
    # The pose has moved too, and fix and pose are known to decimetres.
    if off_m > can_m + SPEED_M_S * duration_s + 1.0:
        assert dispute.out_of_reach


def test_without_an_agreement_or_a_place_of_the_pose_nothing_is_out_of_reach():
    assert not disputed(1.0, 50.0, None).out_of_reach
    assert not disputed(-1.0, 50.0, agreement()).out_of_reach, "older than the agreement"
    nowhere = replace(examined(1.0, east_m=50.0), pose=sharp_pose(1.0, latitude_rad=None))
    assert not updated_dispute(nowhere, None, RULES.true_sigma, agreement()).out_of_reach
    without = replace(examined(1.0, east_m=50.0), pose=None)
    assert not updated_dispute(without, None, RULES.true_sigma, agreement()).out_of_reach


def test_a_run_that_began_out_of_reach_stays_so_and_another_place_does_not():
    since = agreement()
    began = disputed(1.0, 20.0, since)
    assert began.out_of_reach
    assert disputed(100.0, 20.3, since, began).out_of_reach
    assert not disputed(100.0, 21.0, since, began).out_of_reach


def test_a_pose_that_jumped_is_in_reach_of_where_it_jumped_from():
    jumped = agreement()
    far = replace(jumped, latitude_rad=jumped.latitude_rad + 20.0 / 6.37e6)
    assert disputed(1.0, 20.0, jumped).out_of_reach
    assert not disputed(1.0, 20.0, far).out_of_reach


def test_the_pose_can_be_off_by_its_tolerance_what_it_moved_and_the_distance_at_full_grip():
    """10 m/s for 3 s, and 1/2 · 10 m/s² · 9 s²."""
    since = agreement()
    standing = sharp_pose(0)
    assert since.largest_error_m(standing, at(0)) == since.tolerance_m
    assert since.largest_error_m(standing, at(15)) == pytest.approx(since.tolerance_m + 30.0 + 45.0)
    assert since.largest_error_m(sharp_pose(15), at(15)) == pytest.approx(
        since.tolerance_m + 60.0 + 45.0, abs=0.01
    )


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)])
def test_out_of_reach_is_what_the_sigma_of_the_fix_leaves_beyond_it_in_any_direction(direction):
    """5.7 σ of a fix."""
    since, sigma_m = agreement(), 0.5
    reach_m = since.largest_error_m(sharp_pose(1), at(1)) + 5.7 * sigma_m
    dispute = disputed(1.0, 20.0, since)
    for off_m, out in ((reach_m - 0.01, False), (reach_m + 0.01, True)):
        east_m, north_m = (off_m * one for one in direction)
        newest = replace(
            dispute,
            east_m=east_m,
            north_m=north_m,
            covariance_enu_m2=(0.25, 0.0, 0.0, 0.1, 0.0, 0.1),
        )
        assert _is_out_of_reach(newest, None, sharp_pose(1), since) == out


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)])
def test_a_fix_is_of_the_run_within_half_a_metre_of_the_last_in_any_direction(direction):
    began = replace(disputed(1.0, 20.0, agreement()), east_m=16.0, north_m=12.0)
    assert began.out_of_reach
    most_m = 0.5 if 0.0 in direction else 0.499
    for apart_m, same in ((most_m, True), (0.51, False)):
        east_m, north_m = (apart_m * one for one in direction)
        newest = replace(began, east_m=16.0 + east_m, north_m=12.0 + north_m, out_of_reach=False)
        assert _is_out_of_reach(newest, began, sharp_pose(100), None) == same


def test_an_independent_position_excludes_a_pose_that_is_wrong_by_what_is_out_of_reach():
    rules = Rules()
    for first, usable in ((0.0, True), (None, False)):
        positions = PositionOutput(rules)
        if first is not None:
            positions.update_dispute(replace(examined(first), verdict="confirmed"))
        positions.update_dispute(examined(1.0, east_m=20.0))
        the_pose = sharp_pose(2, independent=independent(2, sigma_m=0.1))
        result = positions.at(at(2), EpochInputs(pose=the_pose, antenna=antenna(2), alive=ALL), 0.0)
        assert result.usable is usable
        assumed = PositionOutput(replace(rules, horizontal_reference="assumed"))
        if first is not None:
            assumed.update_dispute(replace(examined(first), verdict="confirmed"))
        assumed.update_dispute(examined(1.0, east_m=20.0))
        assert not position(assumed, 2).usable, "nothing else excludes it"


def test_an_agreement_that_is_dated_ahead_is_none():
    positions = PositionOutput(Rules())
    positions.update_dispute(replace(examined(500.0), verdict="confirmed"))
    positions.forget_future(at(0))
    positions.update_dispute(examined(501.0, east_m=20.0))
    the_pose = sharp_pose(502, independent=independent(502, sigma_m=0.1))
    inputs = EpochInputs(pose=the_pose, antenna=antenna(502), alive=ALL)
    assert not positions.at(at(502), inputs, 0.0).usable


def test_an_agreement_lasts_over_fixes_that_are_none_and_until_it_is_dated_ahead():
    """The fix at the far place would be in reach of nothing if the agreement were forgotten."""
    positions = after(replace(examined(0), verdict="confirmed"))
    since = positions._agreement
    assert since.time_ns == at(0)
    positions.update_dispute(replace(examined(1), verdict="unknown", reason="height_unverified"))
    assert positions._agreement is since
    limit_ns = round(RULES.future_limit_s * 1e9)
    positions.forget_future(at(0) - limit_ns)
    assert positions._agreement is since
    positions.forget_future(at(0) - limit_ns - 1)
    assert positions._agreement is None

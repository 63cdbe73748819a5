"""The position of every epoch: which source, which bounds, usable or not; never more trusted than what it rests on."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.latent_fault import (
    LatentFaultHypothesis,
    LatentFaultPart,
    MatchCorroboration,
)
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent, bounds_of
from camber.integrity.protection.position_candidates import confirmed_fix
from camber.integrity.protection.position_candidates import of_pose as candidate_of_pose
from camber.integrity.protection.position_output import PositionOutput
from camber.integrity.protection.wrong_fix_probability import WrongFixRules
from camber.integrity.rules import Rules
from camber.schemas.gnss import SatelliteVelocity
from support.judging import (
    ALL,
    ANTENNA_M,
    ROAD_M,
    SPEED_M_S,
    SettlingJudge,
    antenna,
    at,
    fix,
    place,
    pose,
    provisional,
    road,
)

exactly = settings(derandomize=True, deadline=None)
# Faults of single fixes: base station and signals are honest. `test_common_fault.py` has the others.
RULES, LEVELS = Rules(horizontal_reference="assumed"), LevelRules()
MATCHED = {"mode": "scan_match", "provenance": "scan_match"}
SLACK = 1.0 + 5e-4
sigma = st.floats(0.01, 5.0)


def velocity(epoch, east=SPEED_M_S, north=0.0, **changes):
    fields = {
        "time_ns": at(epoch),
        "velocity_enu_m_s": (east, north, 0.0),
        "covariance_enu_m2_s2": (4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-3),
        "hdop": 1.0,
        "satellites": 8,
        "heading_rad": math.pi / 2.0,
    }
    return SatelliteVelocity(**(fields | changes))


def inputs(the_pose=None, the_antenna=None, alive=ALL):
    return EpochInputs(pose=the_pose, antenna=the_antenna, alive=alive)


def judged(the_pose, the_fix=None, trials=1):
    judge = SettlingJudge(RULES)
    judge.latest.add_pose(the_pose)
    judge.latest.set_antenna_height(antenna().model_copy(update={"time_ns": the_pose.time_ns}))
    judgement = judge.examine(the_fix or fix(), ALL)
    return replace(judgement, verdict="confirmed", trials=trials)


def confirmed(positions, the_pose=None, the_fix=None, trials=1):
    the_pose = the_pose or pose(**MATCHED)
    return positions.confirmed(judged(the_pose, the_fix, trials), 0.0, inputs(the_pose, antenna()))


def by_itself(the_fix, trials=1):
    """The candidate that a fix makes beside a matched pose."""
    before = LatentFaultHypothesis.initial(LEVELS.wrong_fix)
    return confirmed_fix(judged(pose(**MATCHED), the_fix, trials), before, LEVELS, RULES.true_sigma).candidate


def fresh(levels=LEVELS, rules=RULES):
    return PositionOutput(replace(rules, levels=levels))


def of_pose(the_pose, the_antenna=None, levels=LEVELS, epoch=0.0, rules=RULES):
    return fresh(levels, rules).at(at(epoch), inputs(the_pose, the_antenna or antenna()), 0.0)


def driving(epochs=1, levels=LEVELS, **changes):
    """After a confirmed fix, velocities and wheels for some epochs."""
    positions = fresh(levels)
    positions.add_velocity(velocity(0))
    positions.add_wheel_speed(at(0), SPEED_M_S)
    confirmed(positions)
    for k in range(1, epochs + 1):
        positions.add_wheel_speed(at(k), SPEED_M_S)
        positions.add_velocity(velocity(k, **changes))
    return positions


def level(position):
    value = position.horizontal_protection_level_m
    return math.inf if value is None else value


# --- confirmed fixes ---------------------------------------------------------------------------------------------


def test_a_confirmed_fix_that_agrees_with_a_matched_pose_is_usable_at_1e_7():
    result = confirmed(fresh(), the_fix=fix(satellites=16))
    assert (result.source, result.usable, result.reason, result.fix_id) == ("rtk", True, "none", fix().fix_id)
    assert result.horizontal_protection_level_m < 1.0
    assert result.vertical_protection_level_m < 1.0
    assert 0.0 < result.wrong_fix_probability < 1e-3
    assert result.integrity_risk == 1e-7
    assert (result.alert_limit_m, result.vertical_alert_limit_m) == (1.5, 2.0)
    assert result.semi_major_99_m < result.semi_major_999_m < result.horizontal_protection_level_m


@pytest.mark.parametrize("verdict", ["unknown", "erroneous"])
def test_any_other_is_refused(verdict):
    with pytest.raises(ValueError, match=f"is {verdict}, not confirmed"):
        fresh().confirmed(
            FixJudgement(fix=fix(), verdict=verdict, reason="none"), 0.0, inputs(pose(), antenna())
        )
    with pytest.raises(ValueError, match="not confirmed"):
        fresh().confirmed(
            FixJudgement(fix=fix(covariance_enu_m2=None), verdict="confirmed", reason="none"), 0.0, inputs()
        )


def test_a_pose_that_knows_nothing_better_than_the_fix_cannot_make_it_usable():
    for the_pose in (pose(sigma_m=2.0, **MATCHED), provisional(), pose(provenance="confirmed")):
        result = confirmed(fresh(), the_pose)
        assert result.source == "rtk"
        assert not result.usable
        assert result.reason == "position_unverified"
        assert result.wrong_fix_probability > 1e-3


@pytest.mark.parametrize(("satellites", "prior"), [(16, 0.1), (10, 0.3), (6, 0.95), (None, 0.95)])
def test_without_any_comparison_the_prior_of_the_satellites_alone_counts(satellites, prior):
    the_fix = fix(satellites=satellites)
    result = fresh().confirmed(FixJudgement(fix=the_fix, verdict="confirmed", reason="none"), 0.0, inputs())
    assert result.wrong_fix_probability == pytest.approx(prior)
    assert not result.usable
    assert result.yaw_rad is None


def test_a_fix_whose_height_was_not_compared_has_only_the_place_to_speak_for_it():
    judgement = judged(pose(**MATCHED))
    vague = judgement.comparison.covariance_m2.copy()
    vague[2, 2] = np.inf
    difference = judgement.comparison.difference_m.copy()
    difference[2] = np.nan
    unheard = replace(
        judgement, comparison=replace(judgement.comparison, difference_m=difference, covariance_m2=vague)
    )
    result = fresh().confirmed(unheard, 0.0, inputs())
    assert result.wrong_fix_probability > confirmed(fresh()).wrong_fix_probability
    assert result.vertical_protection_level_m > confirmed(fresh()).vertical_protection_level_m


@exactly
@given(st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.floats(1.0, 2.0))
def test_a_larger_contradiction_never_lowers_the_probability_or_a_level(east, up, factor):
    small = by_itself(fix(east_m=east, up_m=up))
    large = by_itself(fix(east_m=east * factor, up_m=up * factor))
    assert large.wrong >= small.wrong * (1.0 - 1e-9)
    one, other = bounds_of([small.mixture, large.mixture], LEVELS)
    assert other.horizontal_level_m * SLACK >= one.horizontal_level_m
    assert other.vertical_level_m * SLACK >= one.vertical_level_m


def test_a_fix_of_fewer_satellites_is_never_surer_all_else_the_same():
    result = [by_itself(fix(satellites=count)) for count in (None, *range(4, 20))]
    wrong = [candidate.wrong for candidate in result]
    assert wrong == sorted(wrong, reverse=True)
    bounds = bounds_of([candidate.mixture for candidate in result], LEVELS)
    for less, more in itertools.pairwise(bounds):
        assert less.horizontal_level_m * SLACK >= more.horizontal_level_m
        assert less.vertical_level_m * SLACK >= more.vertical_level_m
    assert bounds[0].horizontal_level_m > bounds[-1].horizontal_level_m


@exactly
@given(st.integers(2, 100), st.floats(0.0, 0.4))
def test_every_trial_is_charged(trials, east):
    once, often = (by_itself(fix(east_m=east), k) for k in (1, trials))
    assert often.wrong > once.wrong
    one, other = bounds_of([once.mixture, often.mixture], LEVELS)
    assert other.horizontal_level_m * SLACK >= one.horizontal_level_m


def test_a_pose_that_is_clearly_better_takes_the_place_of_a_vague_fix():
    vague = fix(covariance_enu_m2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    result = confirmed(fresh(), pose(sigma_m=0.03, **MATCHED), vague)
    assert result.source == "scan_match"
    assert result.fix_id is None


def source_with_precise_pose(up_m, east_m=0.0, **rules):
    """The source beside a vague fix that is as far off; it is not usable."""
    off = {"height_m": ROAD_M + ANTENNA_M + up_m, "east_m": east_m}
    vague = fix(**off, covariance_enu_m2=(0.04, 0.0, 0.0, 0.04, 0.0, 1e-4))
    return confirmed(fresh(rules=replace(RULES, **rules)), pose(sigma_m=0.03, **MATCHED), vague).source


def test_a_pose_on_a_road_that_has_changed_does_not_take_the_place_of_a_usable_fix_that_shows_it():
    as_surveyed_m = 5.33 * math.hypot(0.03, 0.02)
    for sign in (1.0, -1.0):
        assert source_with_precise_pose(sign * (as_surveyed_m - 0.001), alert_limit_m=1e3) == "scan_match"
        assert source_with_precise_pose(sign * (as_surveyed_m + 0.001), alert_limit_m=1e3) == "rtk"
        assert source_with_precise_pose(sign * (as_surveyed_m + 0.001)) == "scan_match", (
            "the fix is not usable"
        )


def test_a_pose_whose_vertical_level_a_fix_contradicts_never_takes_its_place():
    level_m = of_pose(pose(sigma_m=0.03, **MATCHED)).vertical_protection_level_m
    for sign in (1.0, -1.0):
        assert source_with_precise_pose(sign * (level_m - 0.001), east_m=2.0) == "scan_match"
        assert source_with_precise_pose(sign * (level_m + 0.001), east_m=2.0) == "rtk"


def test_where_the_height_of_a_pose_is_not_known_none_contradicts_it():
    the_pose = pose(sigma_m=0.03, road=road(datum=None), **MATCHED)
    vague = fix(covariance_enu_m2=(0.04, 0.0, 0.0, 0.04, 0.0, 1e-4))
    judgement = replace(judged(pose(**MATCHED), vague), pose=the_pose)
    assert fresh().confirmed(judgement, 0.0, inputs(the_pose, antenna())).source == "scan_match"


# --- what a wrong fix leaves behind ------------------------------------------------------------------------------


def test_a_pose_that_confirmed_fixes_anchor_is_no_better_than_they():
    positions = fresh()
    confirmed(positions, pose(sigma_m=2.0, **MATCHED))
    result = positions.at(at(1), inputs(pose(1), antenna(1)), 0.0)
    assert result.wrong_fix_probability > 1e-4
    assert level(result) > 1.5
    assert not result.usable
    matched = positions.at(at(1), inputs(pose(1, **MATCHED), antenna(1)), 0.0)
    assert matched.usable
    assert matched.wrong_fix_probability is None


def test_a_pose_anchored_by_what_is_not_known_here_is_not_usable():
    result = of_pose(pose())
    assert result.source == "sensors"
    assert not result.usable
    assert result.wrong_fix_probability == pytest.approx(0.1)


def test_a_latent_fault_fades_with_the_fixes_that_agree_and_not_with_time_alone():
    rules = WrongFixRules()
    start = LatentFaultHypothesis.initial(rules)
    now = confirmed_fix(judged(provisional()), start, LEVELS, RULES.true_sigma).latent_fault
    assert now.odds > 1e-3
    assert now.remaining_share(now.time_ns + round(1e10), rules) == pytest.approx(math.exp(-1.0))
    assert now.remaining_share(now.time_ns - 1, rules) == 1.0
    later = now
    for k in range(1, 400):
        later = confirmed_fix(
            judged(pose(k, **MATCHED), fix(k)), later, LEVELS, RULES.true_sigma
        ).latent_fault
    assert later.odds < 0.1 * now.odds


def matched(k, **changes):
    """The pose of an epoch, anchored by fixes, that scan matching holds: its match is as old as the epoch."""
    return pose(k, **{"mode": "scan_match", "match_time_ns": at(k), "anchor_time_ns": at(k), **changes})


def off_by_a_metre(time_ns, odds):
    """A latent fault of these odds and a metre."""
    return LatentFaultHypothesis(
        time_ns=time_ns, parts=(LatentFaultPart(odds=odds, horizontal_m2=1.0, up_m2=1.0),)
    )


def latest(poses, start=None, levels=LEVELS):
    """What is left of a latent fault of even odds after poses."""
    latent_fault, places = (
        start or off_by_a_metre(at(0), 1.0),
        MatchCorroboration(levels),
    )
    for the_pose in poses:
        latent_fault = places.update(the_pose, latent_fault)
    return latent_fault.odds


def test_matches_along_the_street_refute_a_pose_that_was_pulled_along_place_after_place():
    metres = LEVELS.matches_apart_m / (SPEED_M_S * (at(1) - at(0)) / 1e9)
    epochs = int(3.9 * metres)
    assert latest(matched(k) for k in range(epochs)) == pytest.approx(LEVELS.false_match_prior**3)
    assert latest(pose(k) for k in range(epochs)) == 1.0, "no match"
    assert latest(matched(k, latitude_rad=None) for k in range(epochs)) == 1.0
    assert latest(matched(0) for _ in range(epochs)) == 1.0, (
        "one place says it once: how the latent fault came about"
    )
    assert latest(matched(k, mode="dead_reckoning") for k in range(epochs)) == 1.0, (
        "matches and fixes dispute"
    )
    assert latest(matched(k, sigma_m=0.24) for k in range(epochs)) < 1e-8, (
        "four of its σ are within the metre"
    )
    assert latest(matched(k, sigma_m=0.26) for k in range(epochs)) == 1.0, "it resolves no metre"
    assert latest(matched(k, match_time_ns=at(0)) for k in range(epochs)) == 1.0, (
        "older than what is suspected"
    )
    assert latest(matched(k, match_time_ns=None) for k in range(epochs)) == 1.0
    assert latest(matched(k, covariance_east_north_yaw=None) for k in range(epochs)) == 1.0


def test_of_fixes_that_are_not_known_here_no_match_knows_the_time():
    before = LatentFaultHypothesis.initial(WrongFixRules())
    assert latest((matched(k) for k in range(400)), before) == before.odds


def test_what_a_match_refutes_is_what_was_suspected_before_it():
    places, old = MatchCorroboration(LEVELS), off_by_a_metre(at(0), 1.0)
    places.update(matched(0), old)
    marked = places.update(matched(400), old)
    assert marked.odds == old.odds
    left = old.remaining_share(at(400), LEVELS.wrong_fix)
    a_metre = MixtureComponent(weight=1.0, horizontal_m2=(1.0, 0.0, 1.0), up_m2=1.0)
    grown = marked.after(at(400), 0.5, [a_metre], LEVELS.wrong_fix)
    assert grown.odds == pytest.approx(left + 0.5 * (1.0 - left))
    result = places.update(matched(401), grown)
    assert result.odds == pytest.approx(grown.odds - (1.0 - LEVELS.false_match_prior) * left)


def test_a_drive_that_began_with_fixes_alone_is_usable_once_matches_have_borne_it_out():
    usable = {}
    for kind in (pose, matched):
        positions = fresh()
        confirmed(positions, provisional())
        for k in range(1, 450):
            the_pose = kind(k, sigma_m=0.05)
            result = positions.confirmed(judged(the_pose, fix(k)), 0.0, inputs(the_pose, antenna(k)))
        usable[kind] = result.usable, level(result)
    assert usable[matched][0]
    assert usable[matched][1] < 1.0
    assert usable[matched][1] < 0.5 * usable[pose][1]


def test_a_match_dated_ahead_corroborates_nothing_once_the_clock_is_right():
    positions = fresh()
    confirmed(positions, provisional(400), fix(400))
    positions.forget_future(at(0))
    for k in (0, 400):
        result = positions.at(at(k), inputs(matched(k), antenna(k)), 0.0)
    assert result.wrong_fix_probability > 1e-3


# --- Doppler -----------------------------------------------------------------------------------------------------


def test_between_fixes_the_position_is_that_of_the_velocities():
    result = driving(10).at(at(10), inputs(), 0.0)
    assert (result.source, result.usable, result.fix_id) == ("doppler", True, None)
    assert (result.latitude_rad, result.longitude_rad) == pytest.approx(place(10), abs=1e-9)
    assert result.height_m == pytest.approx(ROAD_M + ANTENNA_M, abs=1e-3)
    assert result.yaw_rad == pytest.approx(0.0)
    assert result.wrong_fix_probability is not None
    assert result.horizontal_protection_level_m > level(confirmed(fresh()))


def test_it_goes_before_the_sensors_and_before_a_match_that_is_not_clearly_better():
    positions = driving(10)
    doppler = positions.at(at(10), inputs(pose(10, sigma_m=0.2, **MATCHED), antenna(10)), 0.0)
    assert doppler.source == "doppler"
    matched = positions.at(at(10), inputs(pose(10, sigma_m=0.03, **MATCHED), antenna(10)), 0.0)
    assert matched.source == "scan_match"
    assert level(matched) < level(doppler)


@pytest.mark.parametrize("horizontal", [0.0, 3.0])
def test_one_that_contradicts_the_pose_ends_until_the_next_confirmed_fix(horizontal):
    positions = driving(10, north=horizontal)
    result = positions.at(at(10), inputs(pose(10, **MATCHED), antenna(10)), 0.0)
    assert result.source == ("scan_match" if horizontal else "doppler")
    assert positions.at(at(10), inputs(), 0.0).source == ("none" if horizontal else "doppler")


def test_without_wheels_it_counts_only_with_a_pose():
    positions = fresh()
    positions.add_velocity(velocity(0))
    positions.add_wheel_speed(at(0), None)
    confirmed(positions)
    positions.add_velocity(velocity(1))
    assert positions.at(at(1), inputs(), 0.0).source == "none"
    assert positions.at(at(1), inputs(pose(1, sigma_m=0.2, **MATCHED), antenna(1)), 0.0).source == "doppler"


def test_a_fix_that_is_older_than_the_last_confirmed_one_does_not_set_it_back():
    positions = driving(10)
    confirmed(positions, pose(5, **MATCHED), fix(5))
    confirmed(positions, pose(4, **MATCHED), fix(4))
    result = positions.at(at(10), inputs(), 0.0)
    assert (result.latitude_rad, result.longitude_rad) == pytest.approx(place(10), abs=1e-9)


def test_what_is_dated_ahead_is_forgotten():
    positions = driving(10)
    positions.forget_future(at(10))
    assert positions.at(at(10), inputs(), 0.0).source == "doppler"
    positions.forget_future(at(-10))
    assert positions.at(at(10), inputs(), 0.0).source == "none"
    assert fresh().forget_future(at(0)) is None


def test_what_is_dated_as_late_as_may_be_is_kept():
    now_ns = at(10) - round(RULES.future_limit_s * 1e9)
    positions = fresh()
    positions.add_velocity(velocity(10))
    positions.add_wheel_speed(at(10), SPEED_M_S)
    confirmed(positions, pose(10, **MATCHED), fix(10))
    positions.forget_future(now_ns)
    assert positions.at(at(10), inputs(), 0.0).source == "doppler"
    positions.forget_future(now_ns - 1)
    assert positions.at(at(10), inputs(), 0.0).source == "none"
    assert confirmed(positions, pose(10, **MATCHED), fix(10)).source == "rtk"


def test_what_was_suspected_ahead_of_the_clock_is_suspected_as_if_of_now():
    """And fades from then on."""
    now = at(10) - round(RULES.future_limit_s * 1e9)
    drives = {epoch: fresh() for epoch in (400, 10, -400)}
    for epoch, positions in drives.items():
        confirmed(positions, provisional(epoch), fix(epoch))
        positions.forget_future(now)
    ahead, right, long_ago = (
        confirmed(positions, pose(60, sigma_m=1.0), fix(60)).wrong_fix_probability
        for positions in drives.values()
    )
    assert ahead == pytest.approx(right, rel=1e-6)
    assert ahead > 1.001 * long_ago


# --- poses -------------------------------------------------------------------------------------------------------


def test_a_matched_pose_stands_on_the_road_with_its_antenna():
    result = of_pose(pose(sigma_m=0.08, **MATCHED))
    assert (result.source, result.usable, result.reason) == ("scan_match", True, "none")
    assert result.height_m == pytest.approx(ROAD_M + ANTENNA_M)
    assert result.horizontal_protection_level_m == pytest.approx(1.03 * 0.08 * 5.68, rel=0.02)
    as_surveyed = of_pose(pose(sigma_m=0.08, **MATCHED), levels=LevelRules(changed_road_prior=0.0))
    assert as_surveyed.vertical_protection_level_m == pytest.approx(math.hypot(0.03, 0.02) * 5.33, rel=0.02)
    assert result.wrong_fix_probability is None


def test_the_vertical_level_of_a_pose_holds_a_road_that_has_changed():
    result = of_pose(pose(sigma_m=0.08, **MATCHED))
    # One road in a hundred: 1e-5 of those that have changed may be beyond.
    assert result.vertical_protection_level_m == pytest.approx(math.hypot(0.2, 0.03, 0.02) * 4.42, rel=0.02)
    as_surveyed = of_pose(pose(sigma_m=0.08, **MATCHED), levels=LevelRules(changed_road_prior=0.0))
    assert as_surveyed.horizontal_protection_level_m == pytest.approx(
        result.horizontal_protection_level_m, rel=1e-6
    )
    assert result.height_m == as_surveyed.height_m
    assert result.covariance_enu_m2 == as_surveyed.covariance_enu_m2


@pytest.mark.parametrize("the_pose", [pose(**MATCHED), pose()], ids=["no fix behind it", "anchored by fixes"])
def test_a_pose_is_one_of_its_parts_whatever_has_changed(the_pose):
    for prior in (0.0, 0.01, 1.0):
        levels = LevelRules(changed_road_prior=prior)
        latent_fault = LatentFaultHypothesis.initial(levels.wrong_fix)
        result = candidate_of_pose(
            inputs(the_pose, antenna()), 0.0, latent_fault, replace(RULES, levels=levels)
        )
        assert sum(part.weight for part in result.mixture.parts) == pytest.approx(1.0)
        odd = [part.weight for part in result.mixture.parts if part.up_m2 > 0.2**2]
        assert sum(odd) == pytest.approx(prior)


@exactly
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.01, 1.0), st.floats(1.0, 5.0), st.booleans())
def test_roads_that_change_more_or_more_often_never_shrink_a_vertical_level(one, other, sigma_m, factor, rtk):
    low, high = sorted((one, other))

    def result(prior, sigma_m):
        levels = LevelRules(changed_road_prior=prior, changed_road_sigma_m=sigma_m)
        the_position = confirmed(fresh(levels)) if rtk else of_pose(pose(**MATCHED), levels=levels)
        return the_position.vertical_protection_level_m

    assert result(high, factor * sigma_m) * SLACK >= result(low, sigma_m)


def test_where_a_wrong_fix_would_stand_on_a_changed_road_the_level_of_a_fix_holds_both():
    def parts(prior):
        before = LatentFaultHypothesis.initial(LEVELS.wrong_fix)
        levels = LevelRules(changed_road_prior=prior)
        return confirmed_fix(
            judged(pose(**MATCHED)), before, levels, RULES.true_sigma
        ).candidate.mixture.parts

    right, wrong, and_changed = parts(0.01)
    assert and_changed.weight == pytest.approx(wrong.weight * 0.01 / 0.99)
    assert (and_changed.mean_m, and_changed.horizontal_m2) == (wrong.mean_m, wrong.horizontal_m2)
    assert and_changed.up_m2 == pytest.approx(wrong.up_m2 + 0.2**2)
    assert right == parts(0.0)[0]


def test_on_a_slope_the_height_shares_the_error_of_the_place():
    result = of_pose(pose(sigma_m=0.2, road=road(slope_east=0.1, slope_north=-0.2), **MATCHED))
    assert result.covariance_enu_m2[5] == pytest.approx(0.03**2 + 0.02**2 + 0.05 * 0.2**2)


@pytest.mark.parametrize(
    ("changes", "the_antenna", "reason"),
    [
        ({}, antenna(-11), "antenna_height_stale"),
        ({}, antenna(status="disagreement"), "antenna_height_disagrees"),
        ({"road": road(status="unknown", reason="no_surface")}, None, "road_unknown"),
        ({"road": road(datum=None)}, None, "datum_mismatch"),
        ({"road": road(slope_east=None)}, None, "road_unknown"),
        ({"road": road(slope_north=None)}, None, "road_unknown"),
        ({}, antenna(status="unknown", height_m=None), "antenna_height_missing"),
    ],
)
def test_where_the_height_is_not_known_the_position_is_there_but_not_usable(changes, the_antenna, reason):
    result = of_pose(pose(**MATCHED, **changes), the_antenna)
    assert result.source == "scan_match"
    assert (result.usable, result.reason) == (False, reason)
    assert result.height_m is result.vertical_protection_level_m is None
    assert result.horizontal_protection_level_m < 1.0
    assert result.covariance_enu_m2[5] == 1e6


@pytest.mark.parametrize(
    ("the_pose", "reason"),
    [
        (provisional(), "pose_provisional"),
        (provisional(mode="anchored"), "pose_provisional"),
        (provisional(provenance="confirmed"), "pose_provisional"),
        (pose(mode="none"), "pose_missing"),
        (pose(provenance="none"), "pose_missing"),
        (pose(latitude_rad=None), "pose_missing"),
        (pose(covariance_east_north_yaw=None), "pose_missing"),
        (pose(covariance_east_north_yaw=(1.0, 2.0, 0.0, 1.0, 0.0, 0.0)), "pose_too_uncertain"),
        (pose(-2), "pose_stale"),
        (pose(-1), "pose_stale"),
        (pose(motion_time_ns=at(-2), **MATCHED), "pose_stale"),
        (None, "pose_missing"),
    ],
)
def test_a_pose_of_no_use_or_another_time_is_none(the_pose, reason):
    result = of_pose(the_pose)
    assert (result.source, result.usable, result.reason) == ("none", False, reason)
    assert result.latitude_rad is result.horizontal_protection_level_m is None
    assert result.vertical_alert_limit_m == 2.0


def test_too_wide_a_pose_is_there_but_not_usable_and_says_why():
    result = of_pose(pose(sigma_m=0.5, **MATCHED))
    assert (result.source, result.usable, result.reason) == ("scan_match", False, "pose_too_uncertain")
    low = of_pose(pose(**MATCHED), levels=LevelRules(vertical_alert_limit_m=0.1))
    assert (low.usable, low.reason) == (False, "height_unverified")


@exactly
@given(sigma, st.sampled_from([0.05, 0.5, 0.8, 2.0]))
def test_usable_is_what_has_both_levels_below_their_limits_and_nothing_else(s, vertical_limit_m):
    result = of_pose(pose(sigma_m=s, **MATCHED), levels=LevelRules(vertical_alert_limit_m=vertical_limit_m))
    levels = result.horizontal_protection_level_m, result.vertical_protection_level_m
    limits = result.alert_limit_m, result.vertical_alert_limit_m
    assert result.usable is all(
        level_m is not None and level_m < limit_m for level_m, limit_m in zip(levels, limits, strict=True)
    )


def test_no_risk_to_spend_means_no_level():
    result = of_pose(pose(**MATCHED), levels=LevelRules(pose_fault_prior=1e-7))
    assert result.horizontal_protection_level_m is None
    assert not result.usable
    assert result.semi_major_999_m < 1.0


@exactly
@given(sigma, sigma, st.floats(-0.99, 0.99), sigma)
def test_more_uncertainty_never_shrinks_a_bound_and_never_makes_usable(se, sn, rho, more):
    def result(extra_m2):
        covariance = (se**2 + extra_m2, rho * se * sn, 0.0, sn**2 + extra_m2, 0.0, 1e-4)
        return of_pose(pose(covariance_east_north_yaw=covariance, **MATCHED))

    small, large = result(0.0), result(more**2)
    if large.source != "none":
        assert large.semi_major_99_m * SLACK >= small.semi_major_99_m
        assert large.semi_major_999_m * SLACK >= small.semi_major_999_m
        assert level(large) * SLACK >= level(small)
    assert small.usable or not large.usable


@exactly
@given(sigma, sigma)
def test_a_fix_that_agrees_wholly_is_never_surer_by_a_blunter_pose_or_claim(s, more):
    small, large = (confirmed(fresh(), pose(sigma_m=x, **MATCHED)) for x in (s, math.hypot(s, more)))
    assert level(large) * SLACK >= level(small)
    claims = [x**2 for x in (0.1 * s, 0.1 * math.hypot(s, more))]
    small, large = (confirmed(fresh(), None, fix(covariance_enu_m2=(v, 0.0, 0.0, v, 0.0, v))) for v in claims)
    if small.source == large.source:
        assert level(large) * SLACK >= level(small)


@exactly
@given(
    st.sampled_from(["none", "provisional", "anchored", "dead_reckoning", "scan_match"]),
    st.sampled_from(["none", "fixes", "given", "confirmed", "scan_match"]),
    st.one_of(st.just(0.0), st.floats(-3.0, 3.0)),  # most draws of any age alone are stale
    st.sampled_from([True, True, True, False]),
    st.sampled_from([True, True, True, False]),
)
def test_stale_missing_or_provisional_is_never_usable(mode, provenance, age, with_antenna, with_road):
    changes = {} if with_road else {"road": road(status="unknown", reason="no_surface")}
    the_pose = pose(age, mode=mode, provenance=provenance, **changes)
    result = fresh().at(at(0), inputs(the_pose, antenna() if with_antenna else None), 0.0)
    good = mode not in ("none", "provisional") and provenance not in ("none", "fixes")
    assert not result.usable or (good and abs(age) <= 0.1 and with_antenna and with_road)
    assert result.usable == (result.reason == "none")


# --- Reliability index ------------------------------------------------------------------------------------------------


def test_by_the_reliability_index_levels_are_r_s():
    levels = LevelRules(levels="reliability_index")
    positions = driving(10, levels)
    a = math.sqrt(9.2103)
    result = positions.at(at(10), inputs(), 0.0)
    assert result.source == "doppler"
    assert result.horizontal_protection_level_m == pytest.approx(a * (0.025 + 20 * 0.02), rel=1e-4)
    assert result.integrity_risk == pytest.approx(0.01)
    again = confirmed(positions, pose(10, **MATCHED), fix(10))
    assert again.horizontal_protection_level_m == pytest.approx(a * 0.025, rel=1e-4)
    positions = fresh(levels)
    confirmed(positions)
    sensors = positions.at(at(1), inputs(pose(1), antenna(1)), 0.0)
    assert sensors.source == "sensors"
    assert sensors.horizontal_protection_level_m == pytest.approx(a * (0.025 + 2 * 0.03), rel=1e-4)
    assert sensors.usable


def test_by_the_reliability_index_a_match_is_taken_where_its_ellipse_is_clearly_smaller():
    positions = driving(10, LevelRules(levels="reliability_index"))
    result = positions.at(at(10), inputs(pose(10, sigma_m=0.2, **MATCHED), antenna(10)), 0.0)
    assert result.source == "scan_match"
    assert result.horizontal_protection_level_m == result.semi_major_99_m < 0.7 * math.sqrt(9.2103) * 0.425

"""The positions that an epoch could have: where they are, and the ways in which each may be off with their weights."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.pose_provenance import rests_on_fixes
from camber.integrity.protection.doppler_position import Displacement
from camber.integrity.protection.latent_fault import LatentFaultHypothesis, LatentFaultPart
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent
from camber.integrity.protection.position_candidates import (
    PositionCandidate,
    confirmed_fix,
    of_doppler,
    of_pose,
)
from camber.integrity.protection.position_output import PositionOutput
from camber.integrity.rules import Rules
from camber.schemas.gnss import SatelliteVelocity
from support.judging import (
    ALL,
    ANTENNA_M,
    LATITUDE_RAD,
    LONGITUDE_RAD,
    ROAD_M,
    SettlingJudge,
    antenna,
    at,
    fix,
    pose,
    provisional,
    road,
)

# Faults of single fixes: base station and signals are honest. `test_common_fault.py` has the others.
RULES, LEVELS = Rules(horizontal_reference="assumed"), LevelRules()
MATCHED = {"mode": "scan_match", "provenance": "scan_match"}
BEFORE = LatentFaultHypothesis.initial(LEVELS.wrong_fix)
CHANGED = LEVELS.changed_road_prior
NO_OFFSET = (0.0, 0.0, 0.0)


def judged(the_pose=None, **off):
    judge = SettlingJudge(RULES)
    judge.latest.add_pose(the_pose or pose(**MATCHED))
    judge.latest.set_antenna_height(antenna())
    return replace(judge.examine(fix(**off), ALL), verdict="confirmed")


def by_fix(judgement, before=BEFORE):
    return confirmed_fix(judgement, before, LEVELS, RULES.true_sigma)


def by_pose(the_pose, latent_fault=BEFORE, correction_m=0.0):
    return of_pose(
        EpochInputs(pose=the_pose, antenna=antenna(), alive=ALL), correction_m, latent_fault, RULES
    )


def weights(candidate):
    return [part.weight for part in candidate.mixture.parts]


# --- of a confirmed fix -------------------------------------------------------------------------------------------


def test_a_fix_is_where_it_says_unless_it_is_wrong_and_then_the_vehicle_is_where_road_and_pose_say():
    judgement = judged(east_m=0.05, up_m=0.04)
    result = by_fix(judgement).candidate
    right, wrong, wrong_on_a_changed_road = result.mixture.parts  # nothing was confirmed before
    assert (result.source, result.time_ns, result.fix_id) == ("rtk", at(0), fix().fix_id)
    assert result.geodetic == (
        judgement.fix.latitude_rad,
        judgement.fix.longitude_rad,
        judgement.fix.height_m,
    )
    assert result.yaw_rad == 0.0
    assert by_fix(judged(pose(**MATCHED, yaw_rad=0.7))).candidate.yaw_rad == 0.7
    assert by_fix(replace(judgement, pose=None)).candidate.yaw_rad is None
    assert sum(weights(result)) == pytest.approx(1.0)
    assert result.wrong == pytest.approx(1.0 - right.weight)
    assert result.mixture.lost == pytest.approx(result.wrong * LEVELS.pose_fault_prior)
    ee, _, _, nn, _, uu = result.covariance_enu_m2
    assert (right.mean_m, right.horizontal_m2, right.up_m2) == (NO_OFFSET, (ee, 0.0, nn), uu)
    assert wrong.mean_m == pytest.approx((0.05, 0.0, 0.04), abs=1e-4)
    assert wrong.horizontal_m2 == pytest.approx((0.01, 0.0, 0.01))
    assert wrong_on_a_changed_road.mean_m == wrong.mean_m
    assert wrong_on_a_changed_road.up_m2 == pytest.approx(wrong.up_m2 + LEVELS.changed_road_sigma_m**2)
    assert wrong_on_a_changed_road.weight == pytest.approx(CHANGED / (1.0 - CHANGED) * wrong.weight)


def test_if_a_fix_is_wrong_the_height_is_that_of_road_and_antenna_but_no_surer_than_the_fix_had_it():
    sharp = by_fix(judged()).candidate
    assert sharp.mixture.parts[1].up_m2 == sharp.covariance_enu_m2[5]
    vague = by_fix(judged(pose(**MATCHED, road=road(sigma_m=0.2)))).candidate
    assert vague.mixture.parts[1].up_m2 == pytest.approx(0.2**2 + 0.02**2)


def test_errors_of_a_fix_that_go_together_stay_together_where_it_is_right():
    covariance = (4e-4, 1e-4, 5e-5, 5e-4, 2e-5, 6e-4)
    result = by_fix(judged(covariance_enu_m2=covariance)).candidate
    ee, en, _, nn, _, _ = result.covariance_enu_m2
    assert result.mixture.parts[0].horizontal_m2 == (ee, en, nn)
    assert en == pytest.approx(RULES.true_sigma.scale**2 * 1e-4)


@pytest.mark.parametrize("off", [{"east_m": 2.0}, {"north_m": 2.0}], ids=str)
def test_a_provisional_pose_is_no_evidence_against_a_fix_off_it_along_any_axis(off):
    horizontal = by_fix(judged(provisional(), satellites=16, **off)).candidate.wrong
    assert horizontal == pytest.approx(by_fix(judged(provisional(), satellites=16)).candidate.wrong, rel=0.01)
    assert by_fix(judged(satellites=16, **off)).candidate.wrong > 0.999, "a matched one does"


@pytest.mark.parametrize(("up_m", "variance_m2"), [(math.nan, 0.01), (0.1, math.inf)])
def test_a_height_that_was_not_compared_says_nothing_for_a_fix_or_of_where_it_is_else(up_m, variance_m2):
    def with_height(up_m, variance_m2):
        compared = judged().comparison
        difference_m, covariance_m2 = compared.difference_m.copy(), compared.covariance_m2.copy()
        difference_m[2], covariance_m2[2, 2] = up_m, variance_m2
        latest = replace(compared, difference_m=difference_m, covariance_m2=covariance_m2)
        return by_fix(replace(judged(), comparison=latest)).candidate

    result = with_height(up_m, variance_m2)
    assert result.wrong == pytest.approx(with_height(0.0, 1e6).wrong, rel=1e-9), "as one known to a kilometre"
    assert result.mixture.parts[1].mean_m == NO_OFFSET
    assert result.mixture.parts[1].up_m2 == pytest.approx(LEVELS.wrong_fix.second_moment_m2[1])


@pytest.mark.parametrize(("mean_m", "horizontal_m2"), [((3.0, 1.0, 2.0), 9.04), ((1.0, -3.0, 2.0), 9.09)])
def test_a_latent_fault_is_as_far_off_as_the_fix_may_be_along_the_worse_axis(mean_m, horizontal_m2):
    """Nothing was suspected before: what is suspected then is what the fix may be."""
    wrong = MixtureComponent(weight=1.0, mean_m=mean_m, horizontal_m2=(0.04, 0.0, 0.09), up_m2=0.25)
    nothing = LatentFaultHypothesis(time_ns=at(0), parts=())
    (result,) = nothing.after(at(1), 0.5, [wrong], LEVELS.wrong_fix).parts
    assert horizontal_m2 <= result.horizontal_m2 <= 2.0**0.25 * horizontal_m2
    assert result.up_m2 == pytest.approx(4.25)
    assert nothing.after(at(1), 0.0, [wrong], LEVELS.wrong_fix).parts == ()


def test_of_a_fix_that_was_compared_with_nothing_only_its_prior_is_known():
    result = by_fix(replace(judged(), comparison=None)).candidate
    _, near, _, far, _ = result.mixture.parts
    assert (near.mean_m, near.horizontal_m2) == (NO_OFFSET, (1.0, 0.0, 1.0))
    assert (far.mean_m, far.horizontal_m2) == (NO_OFFSET, (100.0, 0.0, 100.0))
    assert near.weight / far.weight == pytest.approx(0.7 / 0.3)
    assert near.up_m2 == far.up_m2 == pytest.approx(LEVELS.wrong_fix.second_moment_m2[1])


def test_an_earlier_fault_hypothesis_fades_and_counts_for_the_next_fix():
    first = by_fix(judged()).latent_fault
    second = by_fix(judged(), replace(first, time_ns=at(0) - 10_000_000_000)).candidate
    pulled = second.mixture.parts[-1]
    right, (only,) = second.mixture.parts[0], first.parts
    assert pulled.weight / right.weight == pytest.approx(first.odds * math.exp(-1.0))
    ee, _, _, nn, _, uu = second.covariance_enu_m2
    assert pulled.horizontal_m2 == pytest.approx((only.horizontal_m2 + ee, 0.0, only.horizontal_m2 + nn))
    assert pulled.up_m2 == pytest.approx(only.up_m2 + uu)
    assert pulled.mean_m == NO_OFFSET
    assert sum(weights(second)) == pytest.approx(1.0)


# --- by Doppler ---------------------------------------------------------------------------------------------------


def test_by_doppler_it_has_come_so_far_and_is_so_much_less_sure():
    parts = (
        MixtureComponent(weight=0.9, horizontal_m2=(0.01, 0.002, 0.02), up_m2=0.03),
        MixtureComponent(weight=0.1, mean_m=(1.0, 2.0, 3.0), horizontal_m2=(0.1, 0.0, 0.2), up_m2=0.3),
    )
    base = PositionCandidate(
        source="rtk",
        time_ns=at(0),
        geodetic=(LATITUDE_RAD, LONGITUDE_RAD, 100.0),
        covariance_enu_m2=(0.01, 0.002, 0.003, 0.02, 0.004, 0.03),
        yaw_rad=0.5,
        mixture=ErrorMixture(parts, 1e-9),
        wrong=0.1,
        up_by_road_m=(0.3, 0.05),
        fix_id=17,
    )
    p = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])
    moved = Displacement(
        since_ns=at(0), metres=np.array([30.0, -40.0, 1.5]), covariance_m2=p, yaw_rad=0.7, checked=True
    )
    result = of_doppler(base, moved, at(5), LEVELS)
    frame = LocalFrame(LATITUDE_RAD, LONGITUDE_RAD, 100.0)
    there = frame.geodetic_from_east_north(30.0, -40.0, 101.5)
    assert result.geodetic[:2] == pytest.approx(there[:2], abs=1e-10)  # a millimetre
    assert result.geodetic[2] == pytest.approx(101.5)
    assert (result.source, result.time_ns, result.yaw_rad) == ("doppler", at(5), 0.7)
    assert (result.wrong, result.fix_id) == (0.1, 17)
    assert result.covariance_enu_m2 == pytest.approx((1.01, 0.102, 0.203, 2.02, 0.304, 3.03))
    assert result.up_by_road_m == pytest.approx((0.3, 3.05))
    assert [part.weight for part in result.mixture.parts] == [0.9, 0.1]
    assert [part.mean_m for part in result.mixture.parts] == [NO_OFFSET, (1.0, 2.0, 3.0)]
    assert result.mixture.parts[0].horizontal_m2 == pytest.approx((1.01, 0.102, 2.02))
    assert result.mixture.parts[1].horizontal_m2 == pytest.approx((1.1, 0.1, 2.2))
    assert [part.up_m2 for part in result.mixture.parts] == pytest.approx([3.03, 3.3])
    assert result.mixture.lost == pytest.approx(1e-9 + LEVELS.pose_fault_prior)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("sigmas", "goes_on"), [(4.9, True), (5.5, False)])
def test_by_doppler_and_by_the_pose_it_must_be_within_what_both_know_along_each_axis(axis, sigmas, goes_on):
    """χ²(2) at 1e-6 is 27.6, 5.25 σ; the σ are those of the pose, 3 m along the axis, and a floor of 0.1 m."""
    sigma_m = [0.1, 0.1]
    sigma_m[axis] = 3.0
    off_m = [0.0, 0.0]
    off_m[axis] = sigmas * 3.0
    positions = PositionOutput(RULES)
    positions.add_velocity(
        SatelliteVelocity(
            time_ns=at(0),
            velocity_enu_m_s=(10.0, 0.0, 0.0),
            covariance_enu_m2_s2=(4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-3),
            hdop=1.0,
            satellites=8,
            heading_rad=math.pi / 2.0,
        )
    )
    positions.add_wheel_speed(at(0), 10.0)
    positions.confirmed(judged(), 0.0, EpochInputs(pose=pose(**MATCHED), antenna=antenna(), alive=ALL))
    horizontal = fix(east_m=off_m[0], north_m=off_m[1])
    there = pose(
        **MATCHED,
        latitude_rad=horizontal.latitude_rad,
        longitude_rad=horizontal.longitude_rad,
        covariance_east_north_yaw=(sigma_m[0] ** 2, 0.0, 0.0, sigma_m[1] ** 2, 0.0, 1e-4),
    )
    result = positions.at(at(0), EpochInputs(pose=there, antenna=antenna(), alive=ALL), 0.0)
    assert (result.source == "doppler") == goes_on


# --- of a pose ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "rests"),
    [
        ({"mode": "scan_match", "provenance": "scan_match"}, False),
        ({"mode": "dead_reckoning", "provenance": "given"}, False),
        ({"mode": "dead_reckoning", "provenance": "confirmed"}, True),
        ({"mode": "anchored", "provenance": "given"}, True),
        ({"mode": "scan_match", "provenance": "scan_match", "anchor_time_ns": at(-5)}, True),
    ],
    ids=str,
)
def test_a_pose_rests_on_fixes_where_any_of_it_says_so(changes, rests):
    assert rests_on_fixes(pose(**changes)) is rests
    assert (by_pose(pose(**changes)).wrong is not None) is rests


def test_a_pose_that_rests_on_no_fix_has_the_components_of_its_covariance_and_of_a_changed_road():
    covariance = (0.04, 0.01, 0.0, 0.09, 0.0, 1e-4)
    result = by_pose(pose(**MATCHED, covariance_east_north_yaw=covariance, yaw_rad=0.3), correction_m=0.02)
    as_surveyed, changed = result.mixture.parts
    assert (result.source, result.time_ns, result.yaw_rad, result.wrong) == ("scan_match", at(0), 0.3, None)
    assert result.geodetic[2] == pytest.approx(ROAD_M + ANTENNA_M + 0.02)
    up_m2 = 0.03**2 + 0.02**2
    assert result.covariance_enu_m2 == pytest.approx((0.04, 0.01, 0.0, 0.09, 0.0, up_m2))
    assert weights(result) == pytest.approx([1.0 - CHANGED, CHANGED])
    assert [part.mean_m for part in result.mixture.parts] == [NO_OFFSET, NO_OFFSET]
    assert as_surveyed.horizontal_m2 == changed.horizontal_m2 == (0.04, 0.01, 0.09)
    assert as_surveyed.up_m2 == pytest.approx(up_m2)
    assert changed.up_m2 == pytest.approx(up_m2 + LEVELS.changed_road_sigma_m**2)
    assert result.mixture.lost == LEVELS.pose_fault_prior
    assert result.up_by_road_m == pytest.approx((0.0, up_m2))


NEGLIGIBLE = LatentFaultHypothesis(
    time_ns=at(0),
    parts=(
        LatentFaultPart(odds=1e-3, horizontal_m2=4.0, up_m2=9.0),
        LatentFaultPart(odds=4e-12, horizontal_m2=0.5, up_m2=9.0),
    ),
)
"""Of a risk of 1e-7, a ten-thousandth of which is 1e-11."""


@pytest.mark.parametrize("source", ["rtk", "sensors"])
def test_what_is_negligible_has_no_part_and_counts_as_not_bounded(source):
    candidate = by_fix(judged(), NEGLIGIBLE).candidate if source == "rtk" else by_pose(pose(), NEGLIGIBLE)
    latent = [part for part in candidate.mixture.parts if part.is_latent]
    assert latent
    assert all(part.horizontal_m2[0] > 1.0 for part in latent)
    known = LEVELS.pose_fault_prior * (candidate.wrong if source == "rtk" else 1.0)
    assert candidate.mixture.lost == pytest.approx(known + 4e-12, rel=0.0, abs=1e-13)


def test_a_fix_under_a_pose_that_says_nothing_against_it_is_wrong_by_shares_of_one():
    result = by_fix(judged(provisional())).candidate
    assert len(result.mixture.parts) > 3
    assert sum(weights(result)) == pytest.approx(1.0)


def test_one_that_does_may_have_been_pulled_along_but_its_height_is_that_of_the_road():
    part = LatentFaultPart(odds=0.25, horizontal_m2=4.0, up_m2=9.0)
    latent_fault = LatentFaultHypothesis(time_ns=at(-1), parts=(part,))
    result = by_pose(pose(covariance_east_north_yaw=(0.04, 0.01, 0.0, 0.09, 0.0, 1e-4)), latent_fault)
    alone, _, pulled, _ = result.mixture.parts
    assert result.source == "sensors"
    assert result.wrong == pytest.approx(0.2)
    assert weights(result) == pytest.approx(
        [0.8 * (1 - CHANGED), 0.8 * CHANGED, 0.2 * (1 - CHANGED), 0.2 * CHANGED]
    )
    assert [part.mean_m for part in result.mixture.parts] == [NO_OFFSET] * 4
    assert pulled.horizontal_m2 == pytest.approx((4.04, 0.01, 4.09))
    assert pulled.up_m2 == alone.up_m2


def test_where_the_road_is_not_known_neither_is_the_height():
    for unknown in (
        road(slope_east=None),
        road(slope_north=None),
        road(status="unknown", reason="no_surface"),
    ):
        result = by_pose(pose(**MATCHED, road=unknown))
        assert result.geodetic[2] is None
        assert all(part.up_m2 == math.inf for part in result.mixture.parts)
        assert result.covariance_enu_m2[5] == 1e6


def test_on_a_slope_the_height_shares_the_error_of_the_place_also_where_east_and_north_go_together():
    sloping = road(slope_east=0.1, slope_north=-0.2)
    result = by_pose(
        pose(**MATCHED, road=sloping, covariance_east_north_yaw=(0.04, 0.02, 0.0, 0.09, 0.0, 1e-4))
    )
    along, geodetic = np.array([0.1, -0.2]), np.array([[0.04, 0.02], [0.02, 0.09]])
    assert result.covariance_enu_m2[5] == pytest.approx(0.03**2 + 0.02**2 + along @ geodetic @ along)

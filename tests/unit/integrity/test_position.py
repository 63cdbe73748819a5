"""What consumers get: a confirmed fix, else the pose; provisional or unknown is never usable."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.judgement import Judgement, verdict_of
from camber.integrity.position import no_position, pose_position, rtk_position
from camber.integrity.rules import Rules
from camber.integrity.situation import Situation
from camber.integrity.true_sigma import TrueSigma, with_true_sigma
from support.judging import ALL, ANTENNA_M, ROAD_M, antenna, at, fix, pose, provisional, road

RULES = Rules()
CONFIRMED = ("confirmed", "confirmed_after_verification")
sigma = st.floats(1e-3, 10.0)


def right(the_fix=None, **changes):
    return Judgement(the_fix or fix(), "confirmed", "height_agrees", pose=pose(), **changes)


def from_pose(the_pose, the_antenna=None, *, correction_m=0.0, alive=ALL):
    return pose_position(Situation(the_pose, the_antenna, alive), correction_m, RULES)


# --- confirmed fixes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", CONFIRMED)
def test_a_confirmed_fix_is_the_position(word):
    position = rtk_position(Judgement(fix(), word, "height_agrees", pose=pose(yaw_rad=1.0)), RULES)
    assert position.source == "rtk"
    assert position.usable
    assert position.reason == "none"
    assert (position.latitude_rad, position.longitude_rad) == (fix().latitude_rad, fix().longitude_rad)
    assert position.height_m == fix().height_m
    assert position.fix_id == fix().fix_id
    assert position.yaw_rad == 1.0


@pytest.mark.parametrize("word", ["unknown", "erroneous"])
def test_any_other_is_refused(word):
    with pytest.raises(ValueError, match=f"is {word}, not confirmed"):
        rtk_position(Judgement(fix(), word, "none"), RULES)


def test_a_fix_without_a_covariance_is_refused():
    with pytest.raises(ValueError, match="not confirmed"):
        rtk_position(Judgement(fix(covariance_enu_m2=None), "confirmed", "none"), RULES)


def test_its_ellipse_holds_99_9_percent_of_the_true_sigma():
    position = rtk_position(right(), RULES)
    axis_m = math.sqrt(13.8155 * (16.0 * 2.5e-5 + 0.05**2))
    assert position.semi_major_999_m == pytest.approx(axis_m, rel=1e-5)
    assert position.semi_minor_999_m == pytest.approx(axis_m, rel=1e-5)
    assert position.covariance_enu_m2 == with_true_sigma(fix().covariance_enu_m2, TrueSigma())


def test_beyond_the_alert_limit_a_confirmed_fix_is_there_but_not_usable():
    position = rtk_position(right(), Rules(alert_limit_m=0.1))
    assert not position.usable
    assert position.latitude_rad is not None


def test_without_a_pose_the_yaw_is_not_known():
    assert rtk_position(Judgement(fix(), "confirmed", "none"), RULES).yaw_rad is None


# --- poses -------------------------------------------------------------------------------------------------------


def test_a_pose_stands_on_the_road_with_its_antenna():
    position = from_pose(pose(), antenna(), correction_m=0.05)
    assert position.source == "sensors"
    assert position.usable
    assert position.height_m == pytest.approx(ROAD_M + ANTENNA_M + 0.05)
    assert position.fix_id is None
    assert position.covariance_enu_m2 is not None
    assert position.covariance_enu_m2[5] == pytest.approx(0.03**2 + 0.02**2)


def test_on_a_slope_the_height_shares_the_error_of_the_place():
    position = from_pose(pose(sigma_m=0.2, road=road(slope_east=0.1, slope_north=-0.2)), antenna())
    assert position.covariance_enu_m2 is not None
    assert position.covariance_enu_m2[5] == pytest.approx(0.03**2 + 0.02**2 + 0.05 * 0.2**2)


def test_a_pose_from_scan_matching_says_so():
    assert from_pose(pose(mode="scan_match", provenance="scan_match")).source == "scan_match"


@pytest.mark.parametrize(
    ("the_pose", "the_antenna"),
    [
        (pose(), None),
        (pose(), antenna(-11)),
        (pose(), antenna(status="disagreement")),
        (pose(road=road(status="unknown", reason="no_surface")), antenna()),
        (pose(road=road(datum=None)), antenna()),
        (pose(road=road(slope_east=None)), antenna()),
        (pose(road=road(slope_north=None)), antenna()),
    ],
)
def test_where_road_or_antenna_is_not_known_the_height_is_not(the_pose, the_antenna):
    position = from_pose(the_pose, the_antenna)
    assert position.height_m is None
    assert position.usable
    assert position.covariance_enu_m2 is not None
    assert position.covariance_enu_m2[5] == 1e6


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
    ],
)
def test_a_provisional_pose_or_one_of_no_use_gives_no_position(the_pose, reason):
    position = from_pose(the_pose, antenna())
    assert position.source == "none"
    assert position.reason == reason
    assert not position.usable
    assert position.latitude_rad is None


def test_a_pose_beyond_the_alert_limit_is_there_but_not_usable_and_says_why():
    position = from_pose(pose(sigma_m=0.5), antenna())
    assert position.source == "sensors"
    assert not position.usable
    assert position.reason == "pose_too_uncertain"
    assert position.semi_major_999_m == pytest.approx(0.5 * math.sqrt(13.8155), rel=1e-5)


def test_without_any_pose_there_is_nothing_to_tell():
    with pytest.raises(ValueError, match="no pose"):
        from_pose(None)


def test_the_word_that_there_is_none_has_no_place():
    position = no_position(at(0), "localizer_absent", RULES)
    assert not position.usable
    assert position.reason == "localizer_absent"
    assert position.latitude_rad is position.height_m is position.covariance_enu_m2 is None


@given(sigma, sigma, st.floats(-0.99, 0.99), sigma)
def test_more_uncertainty_never_shrinks_the_ellipse_and_never_makes_usable(se, sn, rho, more):
    def ellipse(extra_m2):
        covariance = (se**2 + extra_m2, rho * se * sn, 0.0, sn**2 + extra_m2, 0.0, 1e-4)
        return from_pose(pose(covariance_east_north_yaw=covariance), antenna())

    small, large = ellipse(0.0), ellipse(more**2)
    if large.source != "none":
        assert large.semi_major_999_m >= small.semi_major_999_m
        assert large.semi_minor_999_m >= small.semi_minor_999_m * (1.0 - 1e-6)
    assert small.usable or not large.usable


@given(claimed=sigma, more=sigma)
def test_a_larger_claim_never_shrinks_the_ellipse_of_a_fix(claimed, more):
    def ellipse(sigma_m):
        variance = sigma_m**2
        return rtk_position(right(fix(covariance_enu_m2=(variance, 0.0, 0.0, variance, 0.0, 1e-4))), RULES)

    assert ellipse(math.hypot(claimed, more)).semi_major_999_m >= ellipse(claimed).semi_major_999_m


@given(
    st.sampled_from(["none", "provisional", "anchored", "dead_reckoning", "scan_match"]),
    st.sampled_from(["none", "fixes", "given", "confirmed", "scan_match"]),
)
def test_only_what_rests_on_something_confirmed_given_or_matched_is_usable(mode, provenance):
    position = from_pose(pose(mode=mode, provenance=provenance), antenna())
    assert position.usable is (mode not in ("none", "provisional") and provenance not in ("none", "fixes"))


# --- verdicts ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", ["unknown", "erroneous"])
def test_a_verdict_that_confirms_nothing_has_no_position(word):
    verdict = verdict_of(Judgement(fix(), word, "none", pose=pose()), TrueSigma())
    assert (
        verdict.latitude_rad is verdict.longitude_rad is verdict.height_m is verdict.covariance_enu_m2 is None
    )
    assert verdict.surface_id == 7
    assert verdict.map_version == 3


def test_a_verdict_that_confirms_has_the_position_with_its_true_covariance():
    verdict = verdict_of(right(), TrueSigma())
    assert (verdict.latitude_rad, verdict.longitude_rad) == (fix().latitude_rad, fix().longitude_rad)
    assert verdict.height_m == fix().height_m
    assert verdict.covariance_enu_m2 == with_true_sigma(fix().covariance_enu_m2, TrueSigma())
    assert verdict.fix_id == fix().fix_id


def test_a_verdict_without_pose_or_covariance_says_so():
    verdict = verdict_of(Judgement(fix(covariance_enu_m2=None), "confirmed", "none"), TrueSigma())
    assert verdict.surface_id is verdict.map_version is verdict.latitude_rad is None
    assert verdict.height_difference_m is verdict.tolerance_m is None

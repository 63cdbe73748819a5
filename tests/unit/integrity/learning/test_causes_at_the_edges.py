"""The least that a cause needs, and what is just too little: stretch by stretch, a fix each, 20 m and 2 s apart."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.learning.cell_offset import CauseRules
from camber.integrity.learning.offset_causes import NO_OFFSET, OffsetCauses, RoadChange
from camber.road_map.map_error_model import MAP_ERRORS
from support.residual_drives import KEY, START_NS, residual

RULES = CauseRules()
RIGHT, UP, FAR = {}, {"up_m": 0.4}, {"up_m": None, "east_m": 12.0}
NEAR = FAR | {"east_m": 0.0}
VERIFIED = {"up_m": 0.4, "verdict": "confirmed_after_verification"}
KNOWN = RoadChange(surface_id=99, map_version=KEY.map_version, offset_m=0.3, onset_ns=START_NS)


def at_s(number, every_s=2.0):
    return START_NS + round(number * every_s * 1e9)


def drive(causes, rows, every_s=2.0, corrections_m=None):
    """A stretch for each row, of one fix with these changes; the correction is that in force at its end."""
    corrections_m = [0.0] * len(rows) if corrections_m is None else corrections_m
    for number, row in enumerate([*rows, RIGHT]):  # the last ends the stretch before it
        fix = replace(residual(20 * number, **row), time_ns=at_s(number, every_s))
        causes.update(fix, corrections_m[max(number - 1, 0)])
    return causes.common


def result(rows, **how):
    return drive(OffsetCauses(RULES), rows, **how)


# --- how many stretches -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("off", "every_s", "cause"), [(UP, 6.0, "ambiguous"), (FAR, 3.0, "base")])
def test_four_stretches_that_last_long_enough_are_a_cause_and_three_are_none(off, every_s, cause):
    assert result([off] * 4, every_s=every_s).cause == cause
    assert result([off] * 3, every_s=2.0 * every_s) == NO_OFFSET


@pytest.mark.parametrize(("right", "after_right"), [(3, False), (4, True)])
def test_it_began_after_all_was_right_where_as_many_stretches_were_right_as_a_cause_needs(right, after_right):
    assert result([RIGHT] * right + [UP] * 12).after_right is after_right


@pytest.mark.parametrize("off", [UP, FAR])
def test_the_onset_is_the_first_stretch_that_differs(off):
    assert result([RIGHT] * 6 + [off] * 12).onset_ns == at_s(6)


@pytest.mark.parametrize(("off", "outlier", "cause"), [(UP, RIGHT, "ambiguous"), (FAR, NEAR, "base")])
def test_three_quarters_of_the_stretches_must_agree(off, outlier, cause):
    assert result([outlier if n in (2, 5, 8) else off for n in range(12)]).cause == cause
    causes = OffsetCauses(RULES)
    drive(causes, [outlier if n in (3, 4, 7, 8) else off for n in range(12)])
    assert causes.news() == []


def test_three_quarters_of_the_stretches_must_have_a_pose_that_owes_nothing_to_fixes():
    unknown = FAR | {"east_m": None}
    assert result([unknown if n in (2, 5, 8) else FAR for n in range(12)]).cause == "base"
    assert result([unknown if n in (3, 4, 7, 8) else FAR for n in range(12)]) == NO_OFFSET


def test_a_stretch_that_does_not_agree_is_passed_over_once_the_two_after_it_agree():
    assert result([FAR, FAR, FAR, NEAR, FAR]) == NO_OFFSET
    assert result([FAR, FAR, FAR, NEAR, FAR, FAR]).cause == "base"


@pytest.mark.parametrize(
    ("low", "off", "cause"), [({"up_m": 0.25}, UP, "ambiguous"), (FAR | {"east_m": 9.0}, FAR, "base")]
)
def test_it_stands_where_most_of_its_first_half_is_what_its_second_half_is(low, off, cause):
    assert result([low] * 3 + [off] * 11).cause == cause
    assert result([low] * 5 + [off] * 9) == NO_OFFSET


# --- how large --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("fix_sigma_m", "map_sigma_m"), [(0.2, 0.0), (0.0, 0.2), (0.2, 0.2)])
def test_a_height_counts_beyond_five_sigmas_of_the_mean_whose_map_errors_are_alike(fix_sigma_m, map_sigma_m):
    """Of ten stretches, 20 m apart; their places are not quite that far from one another on the ellipsoid."""
    sigmas = {"fix_sigma_m": fix_sigma_m, "map_sigma_m": map_sigma_m}
    along_m = 20.0 * np.arange(10.0)[:, None]
    map_m2 = MAP_ERRORS.covariance_m2(along_m, np.full(10, map_sigma_m)).mean()
    least_m = 5.0 * math.sqrt(fix_sigma_m**2 / 10 + map_m2)
    assert result([{"up_m": 1.1 * least_m} | sigmas] * 10).cause == "ambiguous"
    assert result([{"up_m": 0.9 * least_m} | sigmas] * 10) == NO_OFFSET


@pytest.mark.parametrize(("up_m", "is_one"), [(0.18, False), (0.24, True)])
def test_a_road_differs_by_more_than_three_sigmas_of_fix_and_map_together(up_m, is_one):
    """Each 0.05 m: three of both together are 0.21 m, of one alone 0.15 m."""
    causes = OffsetCauses(RULES)
    drive(causes, [RIGHT] * 3 + [VERIFIED | {"up_m": up_m}] * 2 + [RIGHT] * 2)
    assert (1 in causes.roads) is is_one


@pytest.mark.parametrize("along", ["east_m", "north_m"])
@pytest.mark.parametrize("size_m", [12.0, -12.0])
def test_a_base_is_off_in_any_one_direction(along, size_m):
    assert result([NEAR | {along: size_m}] * 6).cause == "base"


@pytest.mark.parametrize(("along", "across"), [("east_m", "north_m"), ("north_m", "east_m")])
def test_what_agrees_in_one_direction_alone_is_no_vector(along, across):
    causes = OffsetCauses(RULES)
    wander_m = [0.0, 8.0, -8.0] * 3 + [0.0] * 3
    drive(causes, [FAR | {along: 12.0, across: across_m} for across_m in wander_m])
    assert causes.news() == []


@pytest.mark.parametrize("along", ["east_m", "north_m"])
def test_what_grows_in_any_one_direction_does_not_stand(along):
    causes = OffsetCauses(RULES)
    drive(causes, [NEAR | {along: 9.0 + 0.5 * n} for n in range(12)])
    assert causes.news() == []


# --- against what -----------------------------------------------------------------------------------------------


def test_it_differs_from_the_correction_in_force_before_its_onset():
    """The correction has followed what grew slowly, and does not follow the jump."""
    learnt_m = [0.02 * min(n, 15) for n in range(22)]
    rows = [{"up_m": up_m} for up_m in learnt_m] + [{"up_m": 0.7}] * 12
    cause = result(rows, corrections_m=learnt_m + [0.3] * 12)
    assert (cause.cause, cause.up_m, cause.onset_ns) == ("ambiguous", pytest.approx(0.4), at_s(22))


def test_what_has_differed_from_the_first_stretch_on_differs_from_the_correction_in_force_there():
    cause = result([UP] * 12, corrections_m=[0.0] + [0.4] * 11)
    assert (cause.cause, cause.up_m) == ("ambiguous", pytest.approx(0.4))


@pytest.mark.parametrize(("leans_on", "cause"), [(-1, "base"), (0, "none")])
def test_a_pose_that_leans_on_the_very_first_fix_in_question_names_no_base(leans_on, cause):
    assert result([FAR | {"anchored_ns": at_s(leans_on)}] * 8).cause == cause


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"antenna": "fixed"}], ids=str)
def test_what_changed_a_stretch_before_the_onset_decides_nothing(changes):
    after = {"key": replace(KEY, **changes), "east_m": None}
    assert result([RIGHT] * 6 + [after] + [after | UP] * 12).cause == "ambiguous"


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"antenna": "fixed"}], ids=str)
def test_what_changes_while_it_lasts_decides_nothing_where_its_beginning_was_not_seen(changes):
    off = UP | {"east_m": None}
    assert result([off] * 6 + [off | {"key": replace(KEY, **changes)}] * 6).cause == "ambiguous"


# --- roads ------------------------------------------------------------------------------------------------------


def test_a_road_differs_from_what_has_been_learnt():
    causes, learnt = OffsetCauses(RULES), {"up_m": 0.2}
    drive(causes, [learnt] * 3 + [VERIFIED | {"up_m": 0.5}] * 2 + [learnt] * 2, corrections_m=[0.2] * 7)
    assert causes.at(1).up_m == pytest.approx(0.3)


def test_a_road_before_which_no_height_was_known_is_not_named():
    """It may have begun to differ anywhere there."""
    causes = OffsetCauses(RULES)
    drive(causes, [RIGHT] * 2 + [{"up_m": None}] + [VERIFIED] * 2 + [RIGHT] * 2)
    assert causes.roads == {}


def test_where_other_roads_are_known_a_drive_that_begins_on_one_that_differs_does_not_name_it():
    """Surface 0 has no road before it, surface 3 has."""
    causes = OffsetCauses(RULES, [KNOWN])
    drive(causes, [VERIFIED] * 3 + [RIGHT] * 5 + [VERIFIED] * 2 + [RIGHT] * 2)
    assert set(causes.roads) == {99, 3}


def test_the_first_height_from_the_map_of_the_known_roads_forgets_nothing():
    cause = drive(OffsetCauses(RULES, [KNOWN]), [FAR] * 6 + [FAR | {"up_m": 0.0}])
    assert (cause.cause, cause.onset_ns) == ("base", at_s(0))


# --- its end ----------------------------------------------------------------------------------------------------


def test_that_a_cause_has_ended_is_no_news():
    causes = OffsetCauses(RULES)
    assert drive(causes, [FAR] * 6 + [RIGHT] * 6) == NO_OFFSET
    assert [news.cause for news in causes.news()] == ["base"]


def test_the_first_height_of_a_drive_does_not_undo_what_positions_alone_have_shown():
    assert result([FAR] * 6).cause == "base"
    assert result([FAR] * 6 + [FAR | {"up_m": 0.0}]).cause == "base"
    assert result([FAR] * 6 + [FAR | {"up_m": 0.0}] * 4).onset_ns == START_NS


def test_of_the_roads_known_at_the_start_only_those_of_the_map_at_hand_are_kept():
    before = replace(KNOWN, surface_id=98, map_version=KEY.map_version - 1)
    causes = OffsetCauses(RULES, [before, KNOWN])
    drive(causes, [RIGHT] * 3)
    assert set(causes.roads) == {KNOWN.surface_id}


def test_a_drive_that_begins_on_a_road_that_differs_does_not_name_it_on_another_map():
    """Surface 0 has no road before it, surface 3 has."""
    causes = OffsetCauses(RULES, [replace(KNOWN, map_version=KEY.map_version - 1)])
    drive(causes, [VERIFIED] * 3 + [RIGHT] * 5 + [VERIFIED] * 2 + [RIGHT] * 2)
    assert set(causes.roads) == {3}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_height_at_the_limit_may_be_that_of_an_antenna(sign):
    limit_m = sign * RULES.antenna_limit_m
    named = result([{"up_m": limit_m}] * 12, every_s=6.0)
    assert (named.cause, named.up_m) == ("ambiguous", limit_m)
    assert "antenna or road" in named.text
    alike = result([{"up_m": limit_m, "east_m": 0.0}] * 60)
    assert (alike.cause, alike.up_m) == ("antenna", limit_m)


def test_one_stretch_that_differs_on_a_surface_of_others_that_do_not_is_no_road():
    here = [row | {"surface_id": 7} for row in (RIGHT, VERIFIED, RIGHT)]
    causes = OffsetCauses(RULES)
    drive(causes, [*[RIGHT | {"surface_id": 1}] * 3, *here, *[RIGHT | {"surface_id": 9}] * 3])
    assert causes.roads == {}


def test_a_height_of_the_least_that_counts_is_a_cause_and_a_smaller_one_is_none():
    sure = {"fix_sigma_m": 1e-3, "map_sigma_m": 1e-3}
    for up_m, cause in ((RULES.least_height_m, "ambiguous"), (0.999 * RULES.least_height_m, "none")):
        assert result([sure | {"up_m": up_m}] * 12, every_s=6.0).cause == cause

"""Statistics of offsets by heights with any covariance, and the bounds at which they become a fault and end."""

from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.learning.cell_offset import CauseRules
from camber.integrity.learning.fix_track_offset import JudgedTrackOffset, TrackFaultRules, TrackFaults
from camber.integrity.learning.offset_causes import NO_OFFSET, OffsetCauses
from support.residual_drives import KEY, residual

RULES = TrackFaultRules()
S = 1_000_000_000


def offset(east_north_m=(1.7, 0.0), end_s=120, **changes):
    fields = {
        "begin_ns": (end_s - 120) * S,
        "end_ns": end_s * S,
        "east_north_m": east_north_m,
        "covariance_m2": (0.04, 0.01, 0.09),
        "growth_m_s": (0.0, 0.0),
        "growth_covariance": (4e-5, 0.0, 4e-5),
    }
    return JudgedTrackOffset(**fields | changes)


def distance2(vector, covariance, more=0.0):
    ee, en, nn = covariance
    c = np.array([[ee + more, en], [en, nn + more]])
    return float(np.array(vector) @ np.linalg.solve(c, np.array(vector)))


@pytest.mark.parametrize("vector", [(1.7, 0.4), (-0.6, 1.9), (0.3, -2.2)])
@pytest.mark.parametrize("covariance", [(0.04, 0.01, 0.09), (0.3, -0.2, 0.2), (1.0, 0.9, 2.0)])
def test_chi2_is_the_distance_by_the_covariance_with_the_common_error_on_both_axes(vector, covariance):
    one = offset(vector, covariance_m2=covariance)
    for common_sigma_m in (0.0, 0.05, 0.6):
        expected = distance2(vector, covariance, common_sigma_m**2)
        assert one.chi2(common_sigma_m) == pytest.approx(expected)


def test_a_covariance_without_extent_in_one_direction_shows_nothing():
    assert offset(covariance_m2=(1.0, 1.0, 1.0)).chi2(0.0) == 0.0


@pytest.mark.parametrize("growth_m_s", [(0.012, 0.02), (0.02, 0.01), (0.005, 0.025), (0.02, 0.025)])
def test_what_the_growth_is_nearer_to_by_its_covariance_is_named(growth_m_s):
    """Of 1.2 m east, 2.4 m north in 120 s: led away they grow by 0.02 m/s and 0.04 m/s."""
    kinds = set()
    for covariance in ((4e-6, 0.0, 4e-4), (4e-4, 0.0, 4e-6), (1e-4, 9e-5, 1e-4), (1e-4, -9e-5, 1e-4)):
        one = offset((1.2, 2.4), growth_m_s=growth_m_s, growth_covariance=covariance)
        led = growth_m_s[0] - 0.02, growth_m_s[1] - 0.04
        drift = distance2(led, covariance) < distance2(growth_m_s, covariance)
        assert one.kind == ("drift" if drift else "base")
        kinds.add(one.kind)
    assert kinds == {"base", "drift"}


def test_an_operator_reads_the_growth_of_both_directions():
    led = offset((3.0, -6.0), growth_m_s=(0.05, -0.1))
    assert led.describe() == "fixes are led away by +0.05 m/s east, -0.10 m/s north, by heights"


def test_nothing_is_named_before_two_estimates_of_a_base_without_a_name():
    faults = TrackFaults(RULES)
    assert faults.fault is None
    assert faults.update(offset(), "")
    assert faults.fault is None
    assert faults.update(offset(end_s=130), "")
    assert faults.fault == offset(end_s=130)


def test_an_estimate_of_the_least_statistic_itself_is_a_fault_and_one_of_the_last_itself_goes_on():
    common_sigma_m = RULES.common_sigma_m
    faults = TrackFaults(replace(RULES, least_chi2=offset().chi2(common_sigma_m)))
    for end_s in (120, 130):
        faults.update(offset(end_s=end_s), "base")
    assert faults.fault is not None
    small = offset((0.5, 0.0), end_s=140)
    faults.rules = replace(RULES, ended_chi2=small.chi2(common_sigma_m))
    faults.update(small, "base")
    assert faults.fault == offset(end_s=130), "as it was named"
    faults.update(offset((0.49, 0.0), end_s=150), "base")
    assert faults.fault is None


# --- steps of the fixes ----------------------------------------------------------------------------------------------


def named(vector=(1.7, 0.0)):
    faults = TrackFaults(RULES)
    for end_s in (120, 130):
        faults.update(offset(vector, end_s), "base")
    assert faults.fault is not None
    return faults


@pytest.mark.parametrize(
    ("left_m", "goes_on"), [((0.3, 0.4), False), ((1.0, 0.3), False), ((3.9, -2.0), True)]
)
def test_a_fault_goes_on_after_a_step_only_if_what_is_left_is_as_significant_as_what_is_named(
    left_m, goes_on
):
    faults, left = named(), offset(left_m, 140, is_estimate=False)
    assert faults.update(left, "base")
    assert faults.fault == (left if goes_on else None)
    chi2 = left.chi2(RULES.common_sigma_m)
    assert (chi2 >= RULES.least_chi2) == goes_on
    assert left_m != (1.0, 0.3) or chi2 > RULES.ended_chi2, "an estimate would not end it"


def test_a_step_names_nothing_and_interrupts_what_estimates_show():
    faults = TrackFaults(RULES)
    for k, is_estimate in enumerate((True, False, False, True)):
        faults.update(offset(end_s=120 + k, is_estimate=is_estimate), "base")
        assert faults.fault is None
    faults.update(offset(end_s=130), "base")
    assert faults.fault is not None


# --- as the cause of verdicts ------------------------------------------------------------------------------------


def test_a_cause_by_the_track_is_named_with_its_second_estimate_and_has_its_time_vector_and_text():
    causes, off = OffsetCauses(CauseRules()), (1.7, -0.4)
    for epoch in range(200):
        causes.update(residual(epoch, up_m=0.4, verdict="unknown"), 0.0)
    up_m = causes.common.up_m
    assert up_m == pytest.approx(0.4)
    for epoch, end_s in ((200, 120), (201, 120), (202, 130)):
        assert causes.common.cause != "base"
        causes.update(residual(epoch, up_m=0.4, verdict="unknown", track_offset=offset(off, end_s)), 0.0)
    common = causes.common
    assert (common.cause, common.onset_ns) == ("base", 10 * S)
    assert (common.up_m, common.east_north_m) == (up_m, off)
    assert common.text == (
        "+0.40 m up, +1.70 m east, -0.40 m north: the track of the fixes is off by one vector, by heights"
    )


def test_two_estimates_of_two_bases_are_no_cause():
    causes = OffsetCauses(CauseRules())
    for epoch, base in ((0, "one"), (1, "other")):
        key = replace(KEY, base=base)
        causes.update(residual(epoch, key=key, track_offset=offset(end_s=120 + 10 * epoch)), 0.0)
    assert causes.common == NO_OFFSET


def test_a_cause_by_the_independent_position_has_its_onset_too():
    causes = OffsetCauses(CauseRules())
    for epoch in range(0, 400, 20):
        known = (12.0, 0.0, 0.1, 0.0, 0.1, 0.02)
        one = residual(epoch, up_m=None, independent=known)
        causes.update(replace(one, evidence_ns=one.time_ns), 0.0)
    assert (causes.common.cause, causes.common.onset_ns) == ("base", residual(0).time_ns)

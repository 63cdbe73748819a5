"""Offsets of the fixes' own track by heights: a base that is off, fixes that are led away, and right ones."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.learning.fix_track_offset import JudgedTrackOffset, TrackFaultRules, TrackFaults
from camber.integrity.learning.offset_causes import CauseRules, OffsetCauses
from support.residual_drives import KEY, START_NS, residual

RULES = TrackFaultRules()
LASTS_S = 120.0
SIGMA_M, GROWTH_SIGMA_M_S = 0.2, 0.2 * math.sqrt(12.0) / LASTS_S
"""Of an offset on average over a window, and of a slope through the same heights."""


def offset(east_m=0.0, growth_m_s=0.0, *, end_s=LASTS_S, sigma_m=SIGMA_M):
    """An estimate whose window ends at a time."""
    return JudgedTrackOffset(
        begin_ns=START_NS + round((end_s - LASTS_S) * 1e9),
        end_ns=START_NS + round(end_s * 1e9),
        east_north_m=(east_m, 0.0),
        covariance_m2=(sigma_m**2, 0.0, sigma_m**2),
        growth_m_s=(growth_m_s, 0.0),
        growth_covariance=(GROWTH_SIGMA_M_S**2, 0.0, GROWTH_SIGMA_M_S**2),
    )


def named(*estimates, base="base"):
    judge = TrackFaults(RULES)
    for estimate in estimates:
        judge.update(estimate, base)
    return None if judge.fault is None else judge.fault.kind


def test_a_constant_offset_is_a_base_and_a_growing_one_is_led_away():
    assert named(offset(1.7), offset(1.7, end_s=130)) == "base"
    growth = 2.0 * 3.0 / LASTS_S
    assert named(offset(3.0, growth), offset(3.1, growth, end_s=130)) == "drift"
    assert named(offset(-1.7), offset(-1.7, end_s=130)) == "base"


def test_one_estimate_is_not_enough_and_the_same_one_again_is_one():
    judge = TrackFaults(RULES)
    assert judge.update(offset(1.7), "base")
    assert not judge.update(offset(1.7), "base")
    assert judge.fault is None
    assert not judge.update(None, "base")
    judge.update(offset(0.5, end_s=130), "base")
    judge.update(offset(1.7, end_s=140), "base")
    assert judge.fault is None


def test_another_base_begins_anew():
    judge = TrackFaults(RULES)
    for end_s in (120, 130):
        judge.update(offset(1.7, end_s=end_s), "one")
    assert judge.fault is not None
    judge.update(offset(1.7, end_s=140), "other")
    assert judge.fault is None


def test_it_lasts_until_the_offset_is_gone():
    judge = TrackFaults(RULES)
    for end_s, east_m in ((120, 1.7), (130, 1.7), (140, 0.9)):
        judge.update(offset(east_m, end_s=end_s), "base")
    assert judge.fault is not None
    judge.update(offset(0.3, end_s=150), "base")
    assert judge.fault is None


def test_right_fixes_are_not_named():
    rng = np.random.default_rng(1)
    print("seed 1")
    for _ in range(200):
        estimates = [offset(rng.normal(0.0, SIGMA_M), end_s=end_s) for end_s in range(120, 220, 10)]
        assert named(*estimates) is None


@pytest.mark.parametrize("covariance", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (1.0, 2.0, 1.0)])
def test_covariances_that_are_none_show_nothing(covariance):
    estimate = replace(offset(5.0), covariance_m2=covariance)
    assert estimate.chi2(0.0) == 0.0
    assert named(estimate, replace(estimate, end_ns=estimate.end_ns + 1)) in (None, "base")
    assert replace(offset(5.0), growth_covariance=covariance).kind == "base"


def test_operators_read_what_it_is():
    assert offset().describe() == "the track of the fixes is off by one vector, by heights"
    assert "+0.05 m/s east" in offset(3.0, 0.05).describe()


@pytest.mark.parametrize(("growth_m_s", "cause"), [(0.0, "base"), (2.0 * 1.7 / LASTS_S, "drift")])
def test_it_becomes_the_cause_of_verdicts(growth_m_s, cause):
    causes = OffsetCauses(CauseRules())
    for epoch in range(300):
        end_s = 120 + 10 * (epoch // 100)
        one = residual(epoch, key=KEY, track_offset=offset(1.7, growth_m_s, end_s=end_s))
        causes.update(one, 0.0)
    assert causes.common.cause == cause
    assert causes.common.east_north_m == (1.7, 0.0)
    assert [news.cause for news in causes.news()] == [cause]

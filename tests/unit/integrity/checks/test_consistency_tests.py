"""The determination says *agrees* only within the limits of the rates and the cap, and names what is against a fix."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from camber.integrity.checks.chi2_test import AGREES, CONTRADICTS, UNVERIFIED
from camber.integrity.checks.consistency_tests import (
    ALL_TESTS,
    REASONS,
    ConsistencyParameters,
    consistency_of_arrays,
)

SIGMA_M = np.array([0.1, 0.1, 0.08])
metres = st.floats(-3.0, 3.0)


def reason(d, sigma_m=SIGMA_M, **rules):
    return reasons([d], sigma_m, **rules)[0]


def reasons(d, sigma_m=SIGMA_M, **rules):
    d = np.array(d, np.float64)
    covariance_m2 = np.repeat(np.diag(np.square(sigma_m))[None], len(d), axis=0)
    result = consistency_of_arrays(
        d, covariance_m2, covariance_m2[:, :2, :2], ConsistencyParameters(**rules).limits()
    )
    return [REASONS[i] for i in result.outcome]


@pytest.mark.parametrize(
    ("d", "expected"),
    [
        ((0.0, 0.0, 0.0), "height_agrees"),
        ((0.3, 0.0, 0.2), "height_agrees"),
        ((0.0, 0.0, -0.29), "height_unverified"),
        ((0.0, 0.0, 0.5), "height_disagrees"),
        ((0.45, 0.0, 0.0), "position_unverified"),
        ((0.0, 0.6, 0.0), "position_disagrees"),
        ((0.6, 0.0, -0.5), "height_and_position_disagree"),
        ((0.44, 0.31, 0.39), "height_and_position_disagree"),
        ((0.39, 0.0, 0.2), "position_unverified"),
        ((0.28, 0.0, 0.27), "height_unverified"),
        ((math.nan, 0.0, 0.0), "position_disagrees"),
        ((0.0, 0.0, math.nan), "height_disagrees"),
    ],
)
def test_each_outcome_has_its_reason(d, expected):
    assert reason(d) == expected


@pytest.mark.parametrize(("tests", "axes"), [(("height",), 1), (("position",), 2), (("joint",), 3)])
def test_one_test_alone_spends_the_whole_rate(tests, axes):
    within, beyond = chi2.isf([1e-3, 1e-6], axes)
    limits = getattr(ConsistencyParameters(tests=tests).limits(), tests[0])
    assert limits == (pytest.approx(within), pytest.approx(beyond))


def test_three_tests_share_it():
    limits = ConsistencyParameters().limits()
    assert limits.height == (pytest.approx(chi2.isf(1e-3 / 3, 1)), pytest.approx(chi2.isf(1e-6 / 3, 1)))
    assert limits.joint[1] == pytest.approx(chi2.isf(1e-6 / 3, 3))


def test_right_fixes_contradict_and_are_held_back_no_oftener_than_the_rates():
    n, rng = 400_000, np.random.default_rng(7)
    root = np.linalg.cholesky([[0.01, 0.004, 0.001], [0.004, 0.02, 0.0], [0.001, 0.0, 0.0036]])
    rules = ConsistencyParameters(false_alarm_rate=1e-3, hold_back_rate=1e-2)
    covariance_m2 = np.repeat((root @ root.T)[None], n, axis=0)
    result = consistency_of_arrays(
        rng.normal(size=(n, 3)) @ root.T, covariance_m2, covariance_m2[:, :2, :2], rules.limits()
    )
    contradicts = np.mean(result.outcome >= REASONS.index("height_disagrees"))
    held = np.mean(result.outcome > 0)
    assert 0.5e-3 < contradicts < 1e-3
    assert 0.5e-2 < held < 1e-2


def test_what_is_not_asked_is_against_nothing():
    assert reason((9.0, 0.0, 0.1), tests=("height",)) == "height_agrees"
    assert reason((math.nan, math.inf, 0.1), tests=("height",)) == "height_agrees"
    assert reason((0.1, 0.0, 9.0), tests=("position",)) == "height_agrees"
    assert reason((0.1, 0.0, math.nan), tests=("position",)) == "height_agrees"
    assert reason((9.0, 9.0, 9.0), tests=("phase_residuals",)) == "height_agrees"
    assert reason((9.0, 9.0, 9.0), tests=("subset_agreement",)) == "height_agrees"


def test_the_joint_test_alone_sees_both():
    assert reason((0.1, 0.1, 0.1), tests=("joint",)) == "height_agrees"
    assert reason((0.6, 0.0, 0.0), tests=("joint",)) == "height_and_position_disagree"
    assert reason((0.0, 0.0, 0.5), tests=("joint",)) == "height_and_position_disagree"
    assert reason((0.42, 0.0, 0.0), tests=("joint",)) == "position_unverified"


@pytest.mark.parametrize("tests", [("height",), ("joint",), ALL_TESTS])
@pytest.mark.parametrize("sigma_m", [0.05, 0.1, 0.3, 1.0, 100.0])
def test_beyond_the_cap_nothing_agrees_however_badly_the_height_is_known(tests, sigma_m):
    judged_reasons = reasons(
        [(0.0, 0.0, up_m) for up_m in (0.301, -0.301, 1.0)], (0.1, 0.1, sigma_m), tests=tests
    )
    assert "height_agrees" not in judged_reasons
    assert reason((0.0, 0.0, 0.1), (0.1, 0.1, sigma_m), tests=tests) == "height_agrees"


def test_a_height_known_badly_turns_contradiction_into_not_known():
    assert reason((0.0, 0.0, 0.5), (0.1, 0.1, 0.05)) == "height_disagrees"
    assert reason((0.0, 0.0, 0.5), (0.1, 0.1, 0.5)) == "height_unverified"


def test_the_fixed_tolerance_knows_nothing_between():
    rules = {"tolerance": "fixed", "tests": ("height",)}
    assert reasons([(0, 0, 0.2), (0, 0, -0.2), (0, 0, 0.201), (0, 0, -0.201)], **rules) == [
        *["height_agrees"] * 2,
        *["height_disagrees"] * 2,
    ]
    assert reason((0.0, 0.0, math.nan), **rules) == "height_disagrees"
    assert reason((0.0, 0.0, 0.21), tolerance="fixed", tests=("joint",)) == "height_unverified"


def test_without_the_height_a_wide_pose_confirms_nothing():
    assert reason((0.0, 0.0, 0.0), (0.3, 0.1, 0.1), tests=("position",)) == "position_unverified"
    assert reason((0.0, 0.0, 0.0), (0.25, 0.25, 0.1), tests=("position",)) == "height_agrees"
    assert reason((0.0, 0.0, 0.0), (9.0, 9.0, 0.1)) == "height_agrees"


def test_tolerance_and_reach_are_where_agreement_ends():
    covariance_m2 = np.array([[[0.02, 0.01, 0.0], [0.01, 0.02, 0.0], [0.0, 0.0, 0.06**2]]])
    pose_m2 = covariance_m2[:, :2, :2]
    result = consistency_of_arrays(
        np.zeros((1, 3)), covariance_m2, pose_m2, ConsistencyParameters(tests=("height", "position")).limits()
    )
    assert result.tolerance_m[0] == pytest.approx(0.06 * math.sqrt(chi2.isf(5e-4, 1)))
    assert result.acceptance_radius_m[0] == pytest.approx(math.sqrt(0.03 * chi2.isf(5e-4, 2)))
    at_reach = result.acceptance_radius_m[0] * math.sqrt(0.5)
    limits = ConsistencyParameters(tests=("position",), hold_back_rate=5e-4).limits()
    near, far = (
        consistency_of_arrays(np.array([[k * at_reach, k * at_reach, 0.0]]), covariance_m2, pose_m2, limits)
        for k in (0.999, 1.001)
    )
    assert (REASONS[near.outcome[0]], REASONS[far.outcome[0]]) == ("height_agrees", "position_unverified")


@pytest.mark.parametrize("tests", [("position",), ("joint",), ALL_TESTS])
def test_a_fix_that_claims_to_be_wide_agrees_only_as_near_to_a_sharp_pose_as_a_right_one_is(tests):
    pose_m2 = np.diag([0.05**2, 0.2**2])[None]
    limits = ConsistencyParameters(tests=tests).limits()
    nearest_m = math.sqrt(limits.position[0]) * np.hypot([0.05, 0.2], 0.06)

    def judged_reasons(east_m, north_m, fix_sigma_m):
        covariance_m2 = np.diag([0.05**2 + fix_sigma_m**2, 0.2**2 + fix_sigma_m**2, 0.01])[None]
        result = consistency_of_arrays(np.array([[east_m, north_m, 0.0]]), covariance_m2, pose_m2, limits)
        return REASONS[result.outcome[0]], result.acceptance_radius_m[0]

    wide_m = 0.3
    assert judged_reasons(0.9 * nearest_m[0], 0.0, wide_m)[0] == "height_agrees"
    assert judged_reasons(1.1 * nearest_m[0], 0.0, wide_m) == (
        "position_unverified",
        pytest.approx(nearest_m[1]),
    )
    assert judged_reasons(0.0, 0.9 * nearest_m[1], wide_m)[0] == "height_agrees"
    assert judged_reasons(0.0, 1.1 * nearest_m[1], wide_m)[0] == "position_unverified"
    # What contradicts is what the fix's own covariance says: wide, it contradicts later.
    assert judged_reasons(0.6, 0.0, 0.02)[0].endswith("disagree" if tests == ("joint",) else "disagrees")
    assert judged_reasons(0.6, 0.0, wide_m)[0] == "position_unverified"


@pytest.mark.parametrize("correlation", [-0.9, -0.4, 0.0, 0.7])
def test_how_near_to_the_pose_a_wide_fix_agrees_is_that_of_another_implementation(correlation):
    """In every direction of errors of the pose that belong together."""
    en = correlation * 0.2 * 0.1
    pose_m2 = np.array([[0.2**2, en], [en, 0.1**2]])
    limits = ConsistencyParameters().limits()
    turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    horizontal_outcome = np.column_stack((np.cos(turn), np.sin(turn)))
    near_m2 = pose_m2 + 0.06**2 * np.eye(2)
    squared = np.sum(horizontal_outcome * np.linalg.solve(near_m2, horizontal_outcome.T).T, axis=1)
    edge_m = np.sqrt(limits.position[0] / squared)[:, None] * horizontal_outcome
    covariance_m2 = np.diag([0.0, 0.0, 0.01])
    covariance_m2[:2, :2] = pose_m2 + 0.3**2 * np.eye(2)
    for share, verdict in ((0.99, AGREES), (1.01, UNVERIFIED)):
        d = np.column_stack((share * edge_m, np.zeros(32)))
        result = consistency_of_arrays(
            d, np.tile(covariance_m2, (32, 1, 1)), np.tile(pose_m2, (32, 1, 1)), limits
        )
        assert result.position.tolist() == [verdict] * 32


def test_where_the_position_is_not_asked_no_pose_holds_a_fix_back():
    limits = ConsistencyParameters(tests=("height",)).limits()
    for d, pose_m2 in (((9.0, 0.0, 0.1), np.eye(2) * 1e-4), ((0.0, 0.0, 0.1), np.full((2, 2), math.nan))):
        result = consistency_of_arrays(np.array([d]), np.eye(3)[None] * 0.01, pose_m2[None], limits)
        assert REASONS[result.outcome[0]] == "height_agrees"


@pytest.mark.parametrize("pose_m2", [np.full((2, 2), math.nan), -np.eye(2)])
def test_a_pose_covariance_that_is_none_lets_nothing_agree(pose_m2):
    result = consistency_of_arrays(
        np.zeros((1, 3)), np.eye(3)[None] * 0.01, pose_m2[None], ConsistencyParameters().limits()
    )
    assert REASONS[result.outcome[0]] == "position_unverified"


def test_a_pose_that_claims_to_be_exact_has_no_reach_and_lets_nothing_agree():
    limits = ConsistencyParameters(fix_sigma_cap_m=0.0).limits()
    result = consistency_of_arrays(np.zeros((1, 3)), np.eye(3)[None] * 0.01, np.zeros((1, 2, 2)), limits)
    assert REASONS[result.outcome[0]] == "position_unverified"
    assert math.isnan(result.acceptance_radius_m[0])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"tests": ()}, "tests"),
        ({"tests": ("receiver", "continuity")}, "tests"),
        ({"false_alarm_rate": 1e-2}, "false_alarm_rate"),
        ({"false_alarm_rate": 0.0}, "false_alarm_rate"),
        ({"hold_back_rate": 1.0}, "false_alarm_rate"),
    ],
)
def test_rules_by_which_nothing_can_be_judged_are_refused(changes, named):
    with pytest.raises(ValueError, match=f"^{named}: expected"):
        ConsistencyParameters(**changes)


RANK = {"height_agrees": 2, "height_unverified": 1, "position_unverified": 1}
some_tests = st.sets(st.sampled_from(["height", "position", "joint"]), min_size=1).map(tuple)
sigmas = st.tuples(*[st.floats(0.02, 2.0)] * 3)


@settings(deadline=None, derandomize=True)
@given(st.tuples(metres, metres, metres), st.floats(1.0, 10.0), sigmas, some_tests)
def test_a_larger_contradiction_never_raises_trust(d, times, sigma_m, tests):
    near, far = reasons([d, np.multiply(d, times)], sigma_m, tests=tests)
    assert RANK.get(far, 0) <= RANK.get(near, 0)


@settings(deadline=None, derandomize=True)
@given(st.tuples(metres, metres, metres), sigmas, st.floats(1.0, 10.0), some_tests)
def test_wider_uncertainty_never_turns_what_is_beyond_the_cap_into_agreement(d, sigma_m, times, tests):
    wider = reason(d, np.multiply(sigma_m, times), tests=tests)
    if "position" not in tests and abs(d[2]) > 0.3:
        assert wider != "height_agrees"
    if wider == "height_agrees" and tests != ("position",):
        assert abs(d[2]) <= 0.3


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 2), st.sampled_from([math.nan, math.inf, -math.inf]), st.tuples(metres, metres, metres))
def test_what_is_not_a_number_never_agrees(axis, value, d):
    broken = [*d]
    broken[axis] = value
    assert reason(broken) != "height_agrees"
    sigma_m = [*SIGMA_M]
    sigma_m[axis] = value
    assert reason((0.0, 0.0, 0.0), sigma_m) != "height_agrees"


@settings(deadline=None, derandomize=True)
@given(st.lists(st.tuples(metres, metres, metres), min_size=1, max_size=20), sigmas)
def test_many_at_once_are_judged_as_each_alone(d, sigma_m):
    assert reasons(d, sigma_m) == [reason(one, sigma_m) for one in d]


def test_the_outcomes_of_many_are_small_numbers_one_each():
    d = np.array([(0.0, 0.0, 0.0), (0.45, 0.0, 0.0), (0.0, 0.6, 0.0)])
    covariance_m2 = np.repeat(np.diag(np.square(SIGMA_M))[None], 3, axis=0)
    result = consistency_of_arrays(
        d, covariance_m2, covariance_m2[:, :2, :2], ConsistencyParameters().limits()
    )
    assert result.position.tolist() == [AGREES, UNVERIFIED, CONTRADICTS]
    assert result.outcome.dtype == result.position.dtype == np.int8


def test_an_error_names_the_tests_that_support_a_fix():
    speak = "height, position, joint, phase_residuals, subset_agreement"
    with pytest.raises(ValueError, match=f"^tests: expected one at least of {speak}$"):
        ConsistencyParameters(tests=("continuity", "receiver"))


def test_both_rates_may_be_the_same_and_then_nothing_is_between():
    limits = ConsistencyParameters(false_alarm_rate=1e-3, hold_back_rate=1e-3).limits()
    assert limits.height[0] == limits.height[1] < math.inf

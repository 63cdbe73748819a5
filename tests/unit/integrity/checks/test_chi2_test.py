"""Height and position together: the distances are those of a χ² variable, and nothing unknown passes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from camber.integrity.checks.chi2_test import (
    AGREES,
    CONTRADICTS,
    UNVERIFIED,
    chi2_limit,
    chi2_survival,
    difference_covariance,
    outcome_of,
    upper_triangle,
)
from camber.integrity.checks.chi2_test import distances as distances_of

FIX = np.array([[[4e-4, 1e-4, 2e-4], [1e-4, 5e-4, 0.0], [2e-4, 0.0, 1e-3]]])
POSE = np.array([[[2.5e-3, 1e-3], [1e-3, 3e-3]]])
SLOPE = np.array([[0.08, -0.03]])


def distances(d, covariance_m2):
    """Of rows (n, 3) and matrices (n, 3, 3); those of each row alone are the same."""
    with np.errstate(all="ignore"):
        result = distances_of(tuple(d.T), upper_triangle(covariance_m2))
    for i, row in enumerate(d[:20].tolist()):
        alone = distances_of(
            tuple(row), tuple(part[i] for part in map(np.ndarray.tolist, upper_triangle(covariance_m2)))
        )
        for name in ("height", "position", "joint", "height_sigma_m"):
            assert getattr(alone, name) == getattr(result, name)[i], name
    return result


@pytest.mark.parametrize("degrees", [1, 2, 3])
@pytest.mark.parametrize("probability", [0.5, 1e-2, 1e-5, 1e-9])
def test_limits_are_those_of_another_implementation(degrees: int, probability: float) -> None:
    limit = chi2_limit(probability, degrees)
    assert limit == pytest.approx(chi2.isf(probability, degrees), rel=1e-9)
    assert chi2_survival(limit, degrees) == pytest.approx(probability, rel=1e-9)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1.0, float("nan")])
def test_a_probability_that_is_none_is_refused(probability: float) -> None:
    with pytest.raises(ValueError, match="expected between 0 and 1"):
        chi2_limit(probability, 3)


def test_other_degrees_of_freedom_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 1, 2 or 3"):
        chi2_survival(1.0, 4)


def test_differences_of_right_fixes_are_as_large_as_the_covariance_says() -> None:
    rng = np.random.default_rng(4)
    n = 200_000
    fix_m = rng.multivariate_normal(np.zeros(3), FIX[0], n)
    pose_m = rng.multivariate_normal(np.zeros(2), POSE[0], n)
    difference_m = fix_m.copy()
    difference_m[:, :2] -= pose_m
    difference_m[:, 2] -= fix_m[:, :2] @ SLOPE[0] + rng.normal(0.0, 0.04, n)
    covariance_m2 = difference_covariance(FIX, POSE, np.array([0.04**2]), SLOPE)
    result = distances(difference_m, np.repeat(covariance_m2, n, axis=0))
    assert np.mean(result.joint > chi2_limit(0.01, 3)) == pytest.approx(0.01, abs=1e-3)
    assert np.mean(result.position > chi2_limit(0.01, 2)) == pytest.approx(0.01, abs=1e-3)
    assert np.mean(result.height > chi2_limit(0.01, 1)) == pytest.approx(0.01, abs=1e-3)


def test_the_covariance_is_that_of_fix_pose_and_height_along_the_slope_of_each() -> None:
    fix_m2, pose_m2 = np.concatenate([FIX, 4.0 * FIX, FIX]), np.concatenate([POSE, POSE, 0.0 * POSE])
    height_m2, slope = np.array([1e-3, 2e-3, 3e-3]), np.array([[0.08, -0.03], [0.0, 0.1], [-0.2, 0.05]])
    result = difference_covariance(fix_m2, pose_m2, height_m2, slope)
    for k in range(3):
        j = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-slope[k, 0], -slope[k, 1], 1.0]])
        expected = j @ fix_m2[k] @ j.T
        expected[:2, :2] += pose_m2[k]
        expected[2, 2] += height_m2[k]
        assert result[k] == pytest.approx(expected)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.floats(1.0, 5.0))
def test_a_larger_contradiction_is_further_off(d: tuple[float, float, float], times: float) -> None:
    covariance_m2 = difference_covariance(FIX, POSE, np.array([1e-3]), SLOPE)
    near = distances(np.array([d]), covariance_m2)
    far = distances(times * np.array([d]), covariance_m2)
    for name in ("height", "position", "joint"):
        assert getattr(far, name)[0] >= getattr(near, name)[0] * (1.0 - 1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_infinitely_far(bad: float) -> None:
    covariance_m2 = difference_covariance(FIX, POSE, np.array([1e-3]), SLOPE)
    result = distances(np.array([[0.0, bad, bad]]), covariance_m2)
    assert (result.height[0], result.position[0], result.joint[0]) == (np.inf, np.inf, np.inf)
    result = distances(np.zeros((1, 3)), np.where(np.eye(3) > 0, bad, covariance_m2))
    assert (result.height[0], result.position[0], result.joint[0]) == (np.inf, np.inf, np.inf)
    assert result.height_sigma_m[0] == np.inf


@pytest.mark.parametrize("variances", [(-1.0, 1.0, 1.0), (1.0, 1.0, 0.0)])
def test_a_covariance_that_is_none_vouches_for_nothing(variances: tuple[float, float, float]) -> None:
    result = distances(np.zeros((1, 3)), np.diag(variances)[None])
    assert result.joint[0] == np.inf


def test_between_the_limits_nobody_can_say() -> None:
    result = outcome_of(np.array([0.0, 4.0, 4.1, 9.0, 9.1, np.inf, np.nan]), 4.0, 9.0)
    assert result.tolist() == [AGREES, AGREES, UNVERIFIED, UNVERIFIED, CONTRADICTS, CONTRADICTS, CONTRADICTS]


@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_another_implementation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 3, 3)) * rng.uniform(0.05, 10.0, (5, 3, 1))
    covariance_m2 = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    d = rng.normal(size=(5, 3))
    result = distances(d, covariance_m2)
    for i in range(5):
        s = covariance_m2[i]
        assert result.joint[i] == pytest.approx(d[i] @ np.linalg.solve(s, d[i]), rel=1e-6)
        assert result.position[i] == pytest.approx(d[i, :2] @ np.linalg.solve(s[:2, :2], d[i, :2]), rel=1e-6)
        assert result.height[i] == pytest.approx(d[i, 2] ** 2 / s[2, 2])
        assert result.height_sigma_m[i] == pytest.approx(np.sqrt(s[2, 2]))


def test_where_only_the_height_is_not_known_the_position_still_counts() -> None:
    covariance_m2 = difference_covariance(FIX, POSE, np.array([np.inf]), SLOPE)
    result = distances(np.array([[0.1, 0.0, np.nan]]), covariance_m2)
    assert 0.0 < result.position[0] < np.inf
    assert (result.height[0], result.joint[0]) == (np.inf, np.inf)


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]],
        np.zeros((3, 3)),
    ],
)
def test_an_indefinite_matrix_is_no_covariance(matrix: list[list[float]]) -> None:
    assert distances(np.ones((1, 3)), np.array([matrix])).joint[0] == np.inf

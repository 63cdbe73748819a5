"""Lever arm and base offset from differences of fixes and poses: separable by turns alone, with honest σ."""

import numpy as np
import pytest

from camber.tools.calibrate.calibration import (
    LEAST_FIXES,
    FixPosePairs,
    HorizontalCalibration,
    calibrate_horizontal,
    clusters_of,
)

SEED = 20261122
LEVER_M, BASE_M = np.array([0.35, -0.2]), np.array([0.8, -0.5])
RATE_HZ = 5


def pairs(
    seed: int = SEED,
    *,
    seconds: float = 300.0,
    turns: float = 1.0,
    wrong: float = 0.07,
    noise_m: float = 0.05,
) -> FixPosePairs:
    """A drive round some blocks; errors are alike for three seconds, wrong fixes lie anywhere."""
    rng, n = np.random.default_rng(seed), int(seconds * RATE_HZ)
    yaw_rad = 0.5 * np.pi * turns * np.floor(np.arange(n) / RATE_HZ / 25.0)
    memory, errors = np.exp(-1.0 / RATE_HZ / 3.0), rng.normal(0.0, noise_m, (n, 2))
    errors[1:] *= np.sqrt(1.0 - memory**2)
    for row in range(1, n):
        errors[row] += memory * errors[row - 1]
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    lever = np.column_stack((cos * LEVER_M[0] - sin * LEVER_M[1], sin * LEVER_M[0] + cos * LEVER_M[1]))
    seen_m = lever + BASE_M + errors
    off = rng.random(n) < wrong
    seen_m[off] += rng.normal(0.0, 2.0, (int(off.sum()), 2))
    time_ns = (np.arange(n) / RATE_HZ * 1e9).astype(np.int64)
    return FixPosePairs(time_ns=time_ns, east_north_m=seen_m, yaw_rad=yaw_rad, sigma_m=np.full(n, 0.1))


def calibrated(seed: int = SEED, **more: float) -> HorizontalCalibration:
    result = calibrate_horizontal(pairs(seed, **more))
    assert result is not None
    return result


def test_with_turns_both_are_estimated_wrong_fixes_or_not() -> None:
    result = calibrated()
    assert result.separable
    assert result.lever_m == pytest.approx(LEVER_M, abs=0.02)
    assert result.base_m == pytest.approx(BASE_M, abs=0.02)
    assert 0.9 < result.used < 0.96


def test_their_sigma_is_that_of_their_errors() -> None:
    print("seeds 0 to 59")
    off = []
    for seed in range(60):
        result = calibrated(seed)
        off += ((result.lever_m - LEVER_M) / result.lever_sigma_m).tolist()
        off += ((result.base_m - BASE_M) / result.base_sigma_m).tolist()
    print(f"{np.std(off):.2f} of their σ")
    assert 0.7 < float(np.std(off)) < 1.4


def test_without_turns_each_is_estimated_as_if_the_other_were_right() -> None:
    result = calibrated(turns=0.0)
    assert not result.separable
    assert result.lever_m == pytest.approx(LEVER_M + BASE_M, abs=0.03)
    assert result.base_m == pytest.approx(LEVER_M + BASE_M, abs=0.03)


def test_a_few_degrees_are_no_turn() -> None:
    assert not calibrated(turns=0.01).separable


def test_a_third_of_wrong_fixes_does_not_pull_it() -> None:
    result = calibrated(wrong=0.33)
    assert result.lever_m == pytest.approx(LEVER_M, abs=0.04)
    assert result.base_m == pytest.approx(BASE_M, abs=0.04)


def test_differences_without_noise_are_explained_to_the_micrometre() -> None:
    result = calibrated(noise_m=0.0, wrong=0.0)
    assert np.concatenate((result.lever_m - LEVER_M, result.base_m - BASE_M)) == pytest.approx(0.0, abs=1e-6)
    assert result.used == 1.0


@pytest.mark.parametrize("seconds", [0.0, (LEAST_FIXES - 1) / RATE_HZ, 29.0])
def test_of_too_few_pairs_or_of_too_short_a_time_nothing_is_estimated(seconds: float) -> None:
    assert calibrate_horizontal(pairs(seconds=seconds)) is None


def test_stretches_are_of_ten_seconds() -> None:
    assert clusters_of(np.array([5, 14_999_999_999, 9_999_999_999], np.int64)).tolist() == [0, 1, 0]
    assert clusters_of(np.empty(0, np.int64)).tolist() == []

"""Weighted least squares with tests, against numpy, scipy and leaving out one row after another."""

import math
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import chi2

from camber.gnss.position.robust_least_squares import (
    DEGENERATE,
    INCONSISTENT,
    OK,
    TOO_FEW,
    LinearModel,
    RobustFit,
    chi_squared_survival,
    consistent_fit,
    horizontal_dilution,
)

FALSE_ALARM = 1e-3
ALARMLESS = 0.0


def problem(seed: int, n: int = 20, p: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Design, observed, σ, true values."""
    rng = np.random.default_rng(seed)
    design, truth = rng.normal(size=(n, p)), rng.normal(size=p) * 10.0
    sigma = rng.uniform(0.5, 3.0, n)
    return design, design @ truth + sigma * rng.normal(size=n), sigma, truth


def fit(design, observed, sigma, false_alarm=FALSE_ALARM, candidate=None) -> RobustFit:
    model = LinearModel(design, observed, sigma, np.full(design.shape[1], np.inf))
    candidate = np.ones(len(observed), np.bool_) if candidate is None else candidate
    return consistent_fit(model, candidate, false_alarm)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 10, 33, 80])
def test_the_tail_of_chi_squared_is_scipys(degrees):
    for x in (0.0, 1e-3, 0.5, 1.0, 5.0, 20.0, 100.0, 400.0):
        assert chi_squared_survival(x, degrees) == pytest.approx(chi2.sf(x, degrees), rel=1e-9, abs=1e-300)
    assert chi_squared_survival(math.nan, degrees) == 0.0
    assert chi_squared_survival(math.inf, degrees) == 0.0


def test_what_is_consistent_is_fitted_as_numpy_does():
    design, observed, sigma, _ = problem(1)
    estimate = fit(design, observed, sigma)
    weighted = design / sigma[:, None]
    expected, rss, _, _ = np.linalg.lstsq(weighted, observed / sigma, rcond=None)
    np.testing.assert_allclose(estimate.value, expected, rtol=1e-9)
    np.testing.assert_allclose(estimate.covariance, np.linalg.inv(weighted.T @ weighted), rtol=1e-9)
    assert estimate.chi_squared == pytest.approx(rss[0])
    assert (estimate.status, estimate.degrees, bool(estimate.used.all())) == (OK, 16, True)


def test_a_prior_is_an_observation_of_zero():
    design, observed, sigma, _ = problem(2)
    prior = np.array([np.inf, 0.5, np.inf, 2.0])
    estimate = consistent_fit(LinearModel(design, observed, sigma, prior), np.ones(20, np.bool_), ALARMLESS)
    more = np.vstack((design, np.eye(4)[[1, 3]]))
    expected = fit(more, np.append(observed, [0.0, 0.0]), np.append(sigma, [0.5, 2.0]), ALARMLESS)
    np.testing.assert_allclose(estimate.value, expected.value, rtol=1e-9)
    np.testing.assert_allclose(estimate.covariance, expected.covariance, rtol=1e-9)
    assert estimate.chi_squared == pytest.approx(expected.chi_squared)
    assert estimate.degrees == expected.degrees == 18


def test_false_alarms_come_as_often_as_was_asked_for():
    alarms = sum(not fit(*problem(seed)[:3], 0.05).used.all() for seed in range(1000))
    # One test at 5 % of the sum of squares and one of all residuals at 5 %, which go together in part.
    assert 40 <= alarms <= 110


# Sixteen satellites of a street, of which two came by a wall: those two agree with each other, and one after the other
# the right ones would go. Elevation and azimuth [°], what the two are wrong by [m/s].
HIDING = [
    (35, 10), (60, 80), (25, 180), (75, 200), (40, 350), (30, 170), (65, 20), (50, 5), (22, 190), (45, 185),
    (28, 12), (70, 120), (33, 352), (55, 300), (38, 178), (80, 60),
]  # fmt: skip


def lines_of_sight(angles: list[tuple[float, float]]) -> np.ndarray:
    elevation, azimuth = np.radians(np.array(angles, float)).T
    east, north = np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth)
    return -np.column_stack((east, north, np.sin(elevation), -np.ones(len(angles))))


def test_two_wrong_rows_that_mask_one_another_are_excluded_and_the_right_ones_stay():
    """Over many such skies: where no more than two are wrong, and by a lot, no other rows go with them."""
    tried = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        chosen = rng.permutation(len(HIDING))[: rng.integers(10, 17)]
        design = lines_of_sight([HIDING[k] for k in chosen])
        sigma = rng.uniform(0.03, 0.1, len(chosen))
        truth = np.array([-3.7, 0.2, 0.0, 0.05])
        observed = design @ truth + sigma * rng.normal(size=len(chosen))
        observed[:2] += np.array([-6.0, -5.6]) + 0.2 * rng.normal(size=2)
        if not fit(design[2:], observed[2:], sigma[2:], 1e-4).used.all():
            continue
        tried += 1
        estimate = fit(design, observed, sigma, 1e-4)
        assert estimate.status == OK
        assert estimate.used.sum() >= len(chosen) - 2, f"seed {seed}"
        if estimate.used[2:].all():
            miss = estimate.value - truth
            assert miss @ np.linalg.solve(estimate.covariance, miss) < chi2.isf(1e-6, 4)
    assert tried > 150


@pytest.mark.parametrize("count", [1, 2, 3])
def test_what_goes_is_the_fewest_that_have_to_go(count):
    """Every two and every three are tried by numpy: no smaller set than the one that was left out would do."""
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        design, observed, sigma, _ = problem(seed, n=12)
        wrong = rng.permutation(12)[:count]
        observed[wrong] += rng.choice([-1.0, 1.0]) * 12.0 * sigma[wrong]
        estimate = fit(design, observed, sigma)
        left_out = 12 - int(estimate.used.sum())
        if estimate.status != OK or left_out < 2:
            continue
        for rows in combinations(range(12), left_out - 1):
            kept = np.ones(12, np.bool_)
            kept[list(rows)] = False
            assert not fit(design[kept], observed[kept], sigma[kept]).used.all(), f"seed {seed}: {rows}"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_rows_that_are_wrong_by_many_sigma_go_and_no_others(count):
    for seed in range(50):
        design, observed, sigma, _ = problem(seed)
        rng = np.random.default_rng(1000 + seed)
        wrong = rng.choice(20, count, replace=False)
        observed[wrong] += rng.choice([-1.0, 1.0], count) * rng.uniform(40.0, 400.0, count)
        estimate = fit(design, observed, sigma, 1e-4)
        assert estimate.status == OK
        assert np.flatnonzero(~estimate.used).tolist() == sorted(wrong.tolist())


def test_the_row_that_goes_is_the_leave_one_out_that_fits_best():
    for seed in range(50):
        design, observed, sigma, _ = problem(seed, n=9)
        observed[seed % 9] += 12.0 * sigma[seed % 9]
        estimate = fit(design, observed, sigma, 1e-3)
        if estimate.used.sum() != 8:
            continue
        rest = ~np.eye(9, dtype=np.bool_)
        chi_squared = [fit(design[r], observed[r], sigma[r], ALARMLESS).chi_squared for r in rest]
        assert int(np.argmin(chi_squared)) == int(np.flatnonzero(~estimate.used)[0])
        assert estimate.chi_squared == pytest.approx(min(chi_squared))


def test_whatever_is_left_out_would_contradict_what_stays():
    """Two wrong rows of one direction drag the fit so far that a right one looks worst at first: it comes back."""
    consistent = 0
    for seed in range(1000):
        design, observed, sigma, _ = problem(seed, n=12, p=3)
        design[1] = design[0] + 0.05
        observed[:2] += 1.0 + seed % 25
        alarm = 0.1 if seed % 2 else 1e-4
        estimate = fit(design, observed, sigma, alarm)
        if estimate.status != OK:
            continue
        consistent += 1
        for k in np.flatnonzero(~estimate.used):
            with_it = estimate.used.copy()
            with_it[k] = True
            again = fit(design, observed, sigma, alarm, with_it)
            variance = sigma[k] ** 2 + design[k] @ estimate.covariance @ design[k]
            residual = observed[k] - design[k] @ estimate.value
            unlikely = 12 * math.erfc(math.sqrt(0.5 * residual**2 / variance)) < alarm
            assert unlikely or not again.used[with_it].all()
        of_used = fit(design, observed, sigma, ALARMLESS, estimate.used)
        np.testing.assert_allclose(estimate.value, of_used.value, rtol=1e-9)
        assert estimate.chi_squared == pytest.approx(of_used.chi_squared)
        assert estimate.degrees == of_used.degrees
    assert consistent > 100


@pytest.mark.parametrize(
    ("rows", "status", "degrees"), [(5, INCONSISTENT, 1), (4, OK, 0), (3, TOO_FEW, 0), (0, TOO_FEW, 0)]
)
def test_a_fault_in_few_rows_is_seen_where_there_is_redundancy_and_blamed_on_no_row(rows, status, degrees):
    design, observed, sigma, _ = problem(3, n=rows)
    observed[2:3] += 1000.0
    estimate = fit(design, observed, sigma)
    assert (estimate.status, estimate.degrees) == (status, degrees)


def test_more_than_half_of_the_rows_never_go():
    design, observed, sigma, _ = problem(4)
    observed += np.random.default_rng(4).uniform(-1e3, 1e3, 20)
    estimate = fit(design, observed, sigma)
    assert estimate.status == INCONSISTENT
    assert estimate.used.sum() >= 10


def test_rows_that_do_not_determine_all_unknowns_are_degenerate():
    design, observed, sigma, _ = problem(6)
    design[:, 3] = design[:, 2] * 2.0
    assert fit(design, observed, sigma).status == DEGENERATE
    assert np.isnan(fit(design, observed, sigma).value).all()


def test_an_unknown_that_no_row_has_is_not_known_and_the_others_are():
    design, observed, sigma, _ = problem(7)
    wide = np.insert(design, 2, 0.0, axis=1)
    estimate, expected = fit(wide, observed, sigma), fit(design, observed, sigma)
    assert np.isnan(estimate.value[2])
    assert np.isnan(estimate.covariance[2]).all()
    np.testing.assert_allclose(np.delete(estimate.value, 2), expected.value, rtol=1e-9)
    assert estimate.degrees == expected.degrees


def test_the_horizontal_dilution_is_that_of_the_unweighted_geometry():
    design, _, _, _ = problem(8)
    cofactor = np.linalg.inv(design.T @ design)
    hdop = horizontal_dilution(design, np.ones(20, np.bool_))
    assert hdop == pytest.approx(math.sqrt(cofactor[0, 0] + cofactor[1, 1]))
    assert np.isnan(horizontal_dilution(design, np.zeros(20, np.bool_)))

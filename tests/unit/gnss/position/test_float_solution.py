"""Float positions against double differences with their full covariance, and what wrong codes and priors do."""

import numpy as np
import pytest

from camber.gnss.position.float_solution import (
    NO_PRIOR,
    PositionPrior,
    float_position,
    float_with_prior,
    inverse_3,
)
from support.single_difference_rows import made_up_rows, slow_float

NO_OUTLIERS = np.inf


def position_from(rows, usable=None, prior=NO_PRIOR, limit=3.5):
    usable = np.ones(rows.group.size, np.bool_) if usable is None else usable
    return float_position(rows, usable, prior, limit)


def joined_with(rows, position_m, information):
    """All codes with a prior that may share their errors."""
    usable = np.ones(rows.group.size, np.bool_)
    return float_with_prior(rows, usable, PositionPrior(position_m, information), 3.5)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("last", [False, True])
def test_it_is_that_of_double_differences_whatever_their_reference(seed, last):
    rows = made_up_rows(np.random.default_rng(seed), systems="GEC", bands=3, noise=0.5).rows
    result = position_from(rows, limit=NO_OUTLIERS)
    dx, covariance, chi2, freedom = slow_float(rows, np.ones(rows.group.size, np.bool_), last)
    np.testing.assert_allclose(result.dx_m, dx, atol=1e-6)
    assert (result.freedom, result.chi2) == (freedom, pytest.approx(chi2, rel=1e-4))
    np.testing.assert_allclose(result.covariance_m2, covariance * max(1.0, chi2 / freedom), rtol=1e-6)


def test_its_covariance_is_that_of_its_errors():
    nees, chi2, freedom = [], 0.0, 0
    for seed in range(300):
        made = made_up_rows(np.random.default_rng(1000 + seed))
        result = position_from(made.rows, limit=NO_OUTLIERS)
        error = result.dx_m - made.dx_m
        nees.append(error @ np.linalg.solve(result.covariance_m2, error))
        chi2, freedom = chi2 + result.chi2, freedom + result.freedom
    # Scaled up where χ² is large by chance, so a little below 3.
    assert 2.3 < np.mean(nees) < 3.4
    assert chi2 / freedom == pytest.approx(1.0, abs=0.05)


def test_wrong_codes_are_left_out_and_the_others_are_not():
    for seed in range(40):
        made = made_up_rows(np.random.default_rng(seed), noise=0.5)
        wrong = np.random.default_rng(seed + 500).choice(made.rows.group.size, 3, replace=False)
        code = made.rows.code_m.copy()
        code[wrong] += (40.0, -25.0, 60.0)
        result = position_from(made.rows._replace(code_m=code))
        assert not result.used[wrong].any()
        assert result.used.sum() >= made.rows.group.size - 4
        assert np.linalg.norm(result.dx_m - made.dx_m) < 1.5


def test_codes_that_scatter_more_than_they_say_make_the_position_less_sure():
    calm = position_from(made_up_rows(np.random.default_rng(3), noise=0.5).rows, limit=NO_OUTLIERS)
    wild = position_from(made_up_rows(np.random.default_rng(3), noise=4.0).rows, limit=NO_OUTLIERS)
    assert np.trace(wild.covariance_m2) > 4.0 * np.trace(calm.covariance_m2)


def test_rows_without_a_code_or_not_to_be_used_do_not_count():
    rows = made_up_rows(np.random.default_rng(4)).rows
    code = rows.code_m.copy()
    code[[2, 7]] = np.nan
    usable = np.ones(rows.group.size, np.bool_)
    usable[[1, 5]] = False
    result = position_from(rows._replace(code_m=code), usable)
    assert not result.used[[1, 2, 5, 7]].any()
    expected, *_ = slow_float(rows._replace(code_m=code), result.used)
    np.testing.assert_allclose(result.dx_m, expected, atol=1e-6)


@pytest.mark.parametrize(("satellites", "systems"), [(0, "G"), (1, "G"), (3, "G"), (2, "GE"), (1, "GEC")])
def test_too_few_satellites_make_no_position(satellites, systems):
    rows = made_up_rows(np.random.default_rng(5), satellites=satellites, systems=systems, bands=1).rows
    assert position_from(rows).freedom < 0


def test_satellites_in_one_direction_make_no_position():
    rows = made_up_rows(np.random.default_rng(6), systems="G").rows
    one_direction = np.tile(rows.direction[0], (rows.group.size, 1))
    assert position_from(rows._replace(direction=one_direction)).freedom < 0


def test_a_sharp_prior_is_the_position_and_a_vague_one_is_nothing():
    rows = made_up_rows(np.random.default_rng(7)).rows
    prior_m = np.array([1.0, -1.0, 2.0])
    sharp = joined_with(rows, prior_m, np.eye(3) / 0.001**2)
    np.testing.assert_allclose(sharp.dx_m, prior_m, atol=0.01)
    vague = joined_with(rows, prior_m, np.eye(3) / 1000.0**2)
    alone = position_from(rows)
    np.testing.assert_allclose(vague.dx_m, alone.dx_m, atol=1e-3)
    np.testing.assert_allclose(vague.covariance_m2, alone.covariance_m2, rtol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_with_a_prior_no_more_is_claimed_than_the_better_of_both_has(seed):
    """Joined as if independent the same error twice would be halved: the prior may be of the very same reflections."""
    rng = np.random.default_rng(seed)
    rows = made_up_rows(rng).rows
    alone = position_from(rows)
    root = rng.normal(size=(3, 3)) * rng.uniform(0.1, 2.0)
    covariance = root @ root.T + 0.01 * np.eye(3)
    joined = joined_with(rows, alone.dx_m, np.linalg.inv(covariance))
    least = min(np.trace(covariance), np.trace(alone.covariance_m2))
    assert np.trace(joined.covariance_m2) <= least * (1.0 + 1e-9)
    # Its information is a weighted mean of both, and so never exceeds their sum.
    both = np.linalg.inv(covariance) + np.linalg.inv(alone.covariance_m2)
    assert np.linalg.eigvalsh(both - np.linalg.inv(joined.covariance_m2)).min() > -1e-6 * np.abs(both).max()
    again = joined_with(rows, alone.dx_m, np.linalg.inv(alone.covariance_m2))
    np.testing.assert_allclose(again.covariance_m2, alone.covariance_m2, rtol=1e-6)


def test_a_prior_identifies_wrong_codes_that_they_alone_cannot():
    made = made_up_rows(np.random.default_rng(8), satellites=5, systems="G", bands=1, noise=0.3)
    code = made.rows.code_m.copy()
    code[0] += 30.0
    rows = made.rows._replace(code_m=code)
    alone, helped = position_from(rows), joined_with(rows, made.dx_m + 0.2, np.eye(3))
    assert np.linalg.norm(alone.dx_m - made.dx_m) > 5.0
    assert np.linalg.norm(helped.dx_m - made.dx_m) < 1.5


def test_a_prior_alone_is_the_position_where_codes_make_none():
    rows = made_up_rows(np.random.default_rng(9), satellites=3, systems="G", bands=1).rows
    prior_m = np.array([1.0, 2.0, 3.0])
    result = joined_with(rows, prior_m, np.eye(3))
    np.testing.assert_array_equal(result.dx_m, prior_m)
    np.testing.assert_allclose(result.covariance_m2, np.eye(3))


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_is_numpys(seed):
    root = np.random.default_rng(seed).normal(size=(3, 3))
    matrix = root @ root.T + 0.1 * np.eye(3)
    inverse, possible = inverse_3(matrix)
    assert possible
    np.testing.assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-9)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.ones((3, 3)), -np.eye(3), np.full((3, 3), np.nan)])
def test_what_has_no_inverse_says_so(matrix):
    assert not inverse_3(matrix)[1]

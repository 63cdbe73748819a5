"""The common part of height differences whose map errors are alike along the road."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.common_part import Differences, common_part

SEED = 20261122


def differences(up_m, *, gap_m=20.0, sigma_m=0.02, map_sigma_m=0.05):
    up_m = np.asarray(up_m, np.float64)
    n = len(up_m)
    along_m = gap_m * np.arange(n)
    return Differences(
        up_m,
        np.full(n, sigma_m**2),
        np.full(n, map_sigma_m),
        np.column_stack((along_m, np.zeros(n))),
        2.0 * np.arange(n),
    )


def part(up_m, *, prior_m=0.0, prior_sigma_m=0.1, **changes):
    return common_part(differences(up_m, **changes), 20.0, prior_m, prior_sigma_m)


def test_it_is_the_generalised_least_squares_of_a_textbook():
    found = differences([0.1, 0.06, 0.12, 0.09], gap_m=10.0)
    gap = np.abs(np.subtract.outer(np.arange(4), np.arange(4))) * 10.0
    inverse = np.linalg.inv(0.05**2 * np.exp(-gap / 20.0) + 0.02**2 * np.eye(4))
    precision = inverse.sum() + 0.1**-2
    assert common_part(found, 20.0, 0.0, 0.1).value_m == pytest.approx(
        (inverse @ found.up_m).sum() / precision
    )
    assert common_part(found, 20.0, 0.0, 0.1).sigma_m == pytest.approx(inverse.sum() ** 0.5 / precision)


def test_stretches_in_one_place_weigh_as_one():
    apart, together = part([0.1] * 40), part([0.1] * 40, gap_m=0.0)
    assert together.sigma_m > 2.5 * apart.sigma_m
    assert together.value_m == pytest.approx(0.08, abs=0.002)  # 0.1² against 0.05² of the map
    assert apart.value_m == pytest.approx(0.1, abs=0.004)


def test_its_sigma_is_that_of_its_errors():
    print(f"seed {SEED}")
    rng, values, sigma_m = np.random.default_rng(SEED), [], 0.0
    along = 20.0 * np.arange(30)
    map_m = np.linalg.cholesky(0.05**2 * np.exp(-np.abs(np.subtract.outer(along, along)) / 20.0))
    for _ in range(400):
        found = part(map_m @ rng.standard_normal(30) + rng.normal(0.0, 0.02, 30), prior_sigma_m=10.0)
        values.append(found.value_m)
        sigma_m = found.sigma_m
    assert np.std(values) == pytest.approx(sigma_m, rel=0.15)


def test_outliers_are_left_out_while_they_are_fewer():
    found = part([0.05] * 13 + [0.6, -0.9, 3.0, 0.6, 0.6])
    assert found.used == 13
    assert found.value_m == pytest.approx(0.05, abs=0.005)


def test_what_the_fixes_could_be_off_alike_makes_no_room_for_a_changed_road():
    found = part([0.01, -0.01, 0.0, 0.02] * 4 + [0.28] * 6, sigma_m=0.1, map_sigma_m=0.03)
    assert found.used == 16
    assert found.value_m == pytest.approx(0.005, abs=0.002)


def test_of_a_few_that_scatter_little_by_chance_the_next_may_still_differ_by_its_sigma():
    assert part([0.0, 0.0, 0.0, 0.0, 0.12], map_sigma_m=0.05).used == 5
    assert part([0.0] * 10 + [0.12], map_sigma_m=0.05).used == 11  # the map's own


def test_where_nothing_agrees_the_prior_stays():
    found = part([40.0], prior_m=0.02)
    assert (found.used, found.value_m, found.sigma_m) == (0, 0.02, 0.0)


def test_a_single_difference_is_weighed_against_the_prior():
    assert part([0.1]).value_m == pytest.approx(0.1 * 0.01 / (0.01 + 0.05**2 + 0.02**2))


def test_a_drift_is_seen_and_a_constant_is_none():
    rising, flat = part(0.005 * np.arange(30)), part([0.1] * 30)
    assert rising.drift_m == pytest.approx(0.005 * 29)
    assert rising.drift_sigmas > 5.0
    assert flat.drift_m == pytest.approx(0.0, abs=1e-12)


def test_of_few_stretches_or_of_one_time_no_drift_is_told():
    assert part([0.0, 0.05, 0.1]).drift_sigmas == 0.0
    still = differences([0.0, 0.05, 0.1, 0.15])
    at_once = Differences(still.up_m, still.variance_m2, still.map_sigma_m, still.place_m, np.zeros(4))
    assert common_part(at_once, 20.0, 0.0, 0.1).drift_sigmas == 0.0


@settings(derandomize=True, deadline=None, max_examples=80)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(-0.3, 0.3))
def test_it_lies_between_the_prior_and_what_was_heard(up_m, prior_m):
    found = part(up_m, prior_m=prior_m, gap_m=100.0)
    low, high = min(*up_m, prior_m), max(*up_m, prior_m)
    assert low - 1e-6 <= found.value_m <= high + 1e-6
    assert 0.0 <= found.sigma_m <= 0.1
    assert 0 <= found.used <= len(up_m)

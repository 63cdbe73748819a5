"""The common part of height differences whose map errors are alike along the road."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.learning.common_offset import HeightDifferences, estimate_common_offset
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel

SEED = 20261122
MODEL = MapErrorModel(short_share=1.0, short_m=20.0)
"""One exponential, of which most numbers here are known by hand."""


def differences(up_m, *, gap_m=20.0, sigma_m=0.02, map_sigma_m=0.05):
    up_m = np.asarray(up_m, np.float64)
    n = len(up_m)
    along_m = gap_m * np.arange(n)
    return HeightDifferences(
        up_m=up_m,
        variance_m2=np.full(n, sigma_m**2),
        map_sigma_m=np.full(n, map_sigma_m),
        place_m=np.column_stack((along_m, np.zeros(n))),
        time_s=2.0 * np.arange(n),
    )


def part(up_m, *, prior_m=0.0, prior_sigma_m=0.1, **changes):
    return estimate_common_offset(differences(up_m, **changes), MODEL, prior_m, prior_sigma_m)


def test_it_is_the_generalised_least_squares_of_a_textbook():
    result = differences([0.1, 0.06, 0.12, 0.09], gap_m=10.0)
    gap = np.abs(np.subtract.outer(np.arange(4), np.arange(4))) * 10.0
    inverse = np.linalg.inv(0.05**2 * np.exp(-gap / 20.0) + 0.02**2 * np.eye(4))
    precision = inverse.sum() + 0.1**-2
    assert estimate_common_offset(result, MODEL, 0.0, 0.1).value_m == pytest.approx(
        (inverse @ result.up_m).sum() / precision
    )
    assert estimate_common_offset(result, MODEL, 0.0, 0.1).sigma_m == pytest.approx(
        inverse.sum() ** 0.5 / precision
    )


def test_stretches_in_one_place_weigh_as_one():
    apart, together = part([0.1] * 40), part([0.1] * 40, gap_m=0.0)
    assert together.sigma_m > 2.5 * apart.sigma_m
    assert together.value_m == pytest.approx(0.08, abs=0.002)  # 0.1² against 0.05² of the map
    assert apart.value_m == pytest.approx(0.1, abs=0.004)


@pytest.mark.parametrize("model", [MODEL, MAP_ERRORS], ids=["one scale", "as measured"])
def test_its_sigma_is_that_of_its_errors(model):
    print(f"seed {SEED}")
    rng, values, sigma_m = np.random.default_rng(SEED), [], 0.0
    along_m = 20.0 * np.arange(30)
    for _ in range(400):
        up_m = model.simulate(along_m, 0.05, rng) + rng.normal(0.0, 0.02, 30)
        result = estimate_common_offset(differences(up_m), model, 0.0, 10.0)
        values.append(result.value_m)
        sigma_m = result.sigma_m
    assert np.std(values) == pytest.approx(sigma_m, rel=0.15)


def test_outliers_are_left_out_while_they_are_fewer():
    result = part([0.05] * 13 + [0.6, -0.9, 3.0, 0.6, 0.6])
    assert result.used == 13
    assert result.value_m == pytest.approx(0.05, abs=0.005)


def test_what_the_fixes_could_be_off_alike_makes_no_room_for_a_changed_road():
    result = part([0.01, -0.01, 0.0, 0.02] * 4 + [0.28] * 6, sigma_m=0.1, map_sigma_m=0.03)
    assert result.used == 16
    assert result.value_m == pytest.approx(0.005, abs=0.002)


def test_of_a_few_that_scatter_little_by_chance_the_next_may_still_differ_by_its_sigma():
    assert part([0.0, 0.0, 0.0, 0.0, 0.12], map_sigma_m=0.05).used == 5
    assert part([0.0] * 10 + [0.12], map_sigma_m=0.05).used == 11  # the map's own


def test_of_a_few_what_differs_by_more_than_its_sigma_explains_is_left_out():
    """3 · √(0.02² + 0.05²) m = 0.162 m; where there are eight, the observed scatter decides, here the map's 0.15 m."""
    assert [part([0.0] * n + [0.155]).used for n in (5, 6, 7, 8)] == [6, 7, 7, 8]
    assert part([0.0, 0.0, 0.0, 0.0, 0.17]).used == 4


def test_of_many_the_observed_scatter_counts_between_map_sigma_and_their_sigma():
    for sign in (1.0, -1.0):  # 3 · 1.4826 · 0.06 m about the middle
        for off_m, used in ((0.12, 11), (0.32, 10)):
            result = part([0.04, -0.04] * 5 + [sign * off_m], sigma_m=0.1, map_sigma_m=0.02, gap_m=100.0)
            assert result.used == used
    assert part([0.2] * 10 + [0.36], prior_m=0.2).used == 10, "about what they have in common"
    assert part([0.2, -0.2] * 5).used == 0, "more than 0.162 m off"


def test_it_takes_two_to_outvote_the_prior():
    assert part([0.4]).used == 1, "within 3 · √(0.054² + 0.1²) m of the middle between both"
    assert part([0.8]).used == 0
    assert part([0.0, 0.0, 0.3]).used == 2, "of three the prior's own error makes no room"


def test_where_nothing_agrees_the_prior_stays():
    result = part([40.0], prior_m=0.02)
    assert (result.used, result.value_m, result.sigma_m) == (0, 0.02, 0.0)


def test_a_single_difference_is_weighed_against_the_prior():
    assert part([0.1]).value_m == pytest.approx(0.1 * 0.01 / (0.01 + 0.05**2 + 0.02**2))


def test_a_drift_is_seen_and_a_constant_is_none():
    rising, flat = part(0.005 * np.arange(30), map_sigma_m=0.02), part([0.1] * 30)
    assert rising.drift_m == pytest.approx(0.005 * 29)
    assert rising.drift_sigmas > 5.0
    assert flat.drift_m == pytest.approx(0.0, abs=1e-12)


def test_what_the_map_errs_by_over_hundreds_of_metres_is_no_drift():
    """By its own σ the slope exceeds 3.5 σ in 5 of 10,000 normal draws; in more than 8 of 300 once in 10¹³ times."""
    print(f"seed {SEED}")
    rng, along_m, exceeding = np.random.default_rng(SEED), 20.0 * np.arange(60), 0
    for _ in range(300):
        result = differences(
            MAP_ERRORS.simulate(along_m, 0.05, rng) + rng.normal(0.0, 0.002, 60), sigma_m=0.05
        )
        exceeding += estimate_common_offset(result, MAP_ERRORS, 0.0, 0.1).drift_sigmas > 3.5
    assert exceeding <= 8


@pytest.mark.parametrize(("bend_m", "scatter"), [(0.0, 0.1), (0.04, None), (0.12, 1.0)])
def test_a_drift_is_as_sure_as_generalised_least_squares_make_it(bend_m, scatter):
    """By the scatter seen, no less than a tenth of what the σ of the fixes say and no more; the map's counts whole."""
    up_m = 0.01 * np.arange(6) + bend_m * np.array([0.0, 1.0, 0.0, -1.0, 0.0, 1.0])
    given_ = differences(up_m)
    inverse = np.linalg.inv(given_.covariance_m2(MODEL))
    design = np.column_stack((np.ones(6), given_.time_s))
    normal = np.linalg.inv(design.T @ inverse @ design)
    level_and_slope = normal @ design.T @ inverse @ up_m
    left_m = up_m - design @ level_and_slope
    seen = left_m @ inverse @ left_m / 4.0
    assert seen == pytest.approx(0.0, abs=1e-9) if bend_m == 0.0 else seen > 0.1
    result = part(up_m)
    assert result.used == 6
    weights = normal[1] @ design.T @ inverse
    error_m2 = given_.covariance_m2(MODEL) - (1.0 - (scatter or seen)) * np.diag(given_.variance_m2)
    sigma = np.sqrt(weights @ error_m2 @ weights)
    assert result.drift_sigmas == pytest.approx(abs(level_and_slope[1]) / sigma)
    assert result.drift_m == pytest.approx(abs(level_and_slope[1]) * 10.0)


def test_four_stretches_show_a_drift():
    assert part([0.0, 0.03, 0.06, 0.09]).drift_m == pytest.approx(0.09)
    slowly = differences([0.0, 0.03, 0.06, 0.09])
    at_once = replace(slowly, time_s=0.1 * np.arange(4))
    assert estimate_common_offset(at_once, MODEL, 0.0, 0.1).drift_m == pytest.approx(0.09)


def test_a_drift_is_the_same_from_whatever_moment_the_time_is_counted():
    result = differences([0.0, 0.03, 0.05, 0.09, 0.12], map_sigma_m=0.03, sigma_m=0.01)
    since_1970 = replace(result, time_s=result.time_s + 1.4e9)
    here, there = (estimate_common_offset(given_, MODEL, 0.0, 0.1) for given_ in (result, since_1970))
    assert here.drift_m > 0.1
    assert here.drift_sigmas > 2.0
    assert there.drift_m == pytest.approx(here.drift_m)
    assert there.drift_sigmas == pytest.approx(here.drift_sigmas)


def test_of_few_stretches_or_of_one_time_there_is_no_drift():
    assert part([0.0, 0.05, 0.1]).drift_sigmas == part([0.0, 0.05, 0.1]).drift_m == 0.0
    still = differences([0.0, 0.05, 0.1, 0.15])
    at_once = HeightDifferences(
        up_m=still.up_m,
        variance_m2=still.variance_m2,
        map_sigma_m=still.map_sigma_m,
        place_m=still.place_m,
        time_s=np.zeros(4),
    )
    assert estimate_common_offset(at_once, MODEL, 0.0, 0.1).drift_sigmas == 0.0


@settings(derandomize=True, deadline=None, max_examples=80)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(-0.3, 0.3))
def test_it_lies_between_the_prior_and_the_residuals(up_m, prior_m):
    result = part(up_m, prior_m=prior_m, gap_m=100.0)
    low, high = min(*up_m, prior_m), max(*up_m, prior_m)
    assert low - 1e-6 <= result.value_m <= high + 1e-6
    assert 0.0 <= result.sigma_m <= 0.1
    assert 0 <= result.used <= len(up_m)

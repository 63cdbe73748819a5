"""Integer ambiguities: the published cases to their digits, exhaustive search, what must hold for any input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from camber.gnss.ambiguity.ambiguity_resolution import (
    INVALID,
    RATIO_TOO_LOW,
    RESOLVED,
    SEARCH_CUT,
    UNLIKELY,
    Resolution,
    bootstrapped_log_success,
    conditional_update,
)
from camber.gnss.ambiguity.lambda_decorrelation import decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers
from support.ambiguity_models import drawn, float_covariance
from support.ambiguity_resolution import resolved

Floats = NDArray[np.float64]
SEED = 20260

# RTKLIB, test/utest/t_lambda.c: six ambiguities, and ten of two frequencies.
SIX = np.array([1585184.171, -6716599.430, 3915742.905, 7627233.455, 9565990.879, 989457273.200])
SIX_BEST = [1585184, -6716599, 3915743, 7627234, 9565991, 989457273]
SIX_SECOND = [1585184, -6716600, 3915743, 7627233, 9565991, 989457273]
TEN = np.array(
    [
        -13324172.755747, -10668894.713608, -7157225.010770, -6149367.974367, -7454133.571066,
        -5969200.494550, 8336734.058423, 6186974.084502, -17549093.883655, -13970158.922370,
    ]
)  # fmt: skip
TEN_BEST = [
    -13324188, -10668901, -7157236, -6149379, -7454143, -5969220, 8336726, 6186960, -17549108, -13970171,
]  # fmt: skip
TEN_SECOND = [
    -13324188, -10668908, -7157236, -6149379, -7454143, -5969220, 8336717, 6186960, -17549108, -13970171,
]  # fmt: skip
# de Jonge and Tiberius (1996).
THREE = np.array([5.450, 3.100, 2.970])
THREE_COVARIANCE = np.array([[6.290, 5.978, 0.544], [5.978, 6.292, 2.340], [0.544, 2.340, 6.288]])


def block(diagonal: float, other: float, size: int = 5) -> Floats:
    return np.full((size, size), other) + np.diag(np.full(size, diagonal - other))


SIX_COVARIANCE = block(0.227134, 0.112202, 6)
SIX_COVARIANCE[5, :] = SIX_COVARIANCE[:, 5] = 0.103473
SIX_COVARIANCE[5, 5] = 0.434339
BOTH = block(0.572775, 0.286388)
TEN_COVARIANCE = np.block([[block(0.446320, 0.223160), BOTH], [BOTH, block(0.735063, 0.367531)]])


def two_best(floats: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Both vectors (2, n) and their squared norms (2,), by decorrelation and search."""
    definite, (upper, variances, transform) = decorrelated(covariance)
    assert definite
    whole = np.rint(floats)
    result, vectors, norms, _ = nearest_integers(upper, variances, transform @ (floats - whole), 2, 1_000_000)
    assert result == 2
    return np.rint(np.linalg.solve(transform, vectors.T)).T + whole, norms


def all_of_them(floats: Floats, covariance: Floats, partial: bool = False) -> Resolution:
    return resolved(floats, covariance, most_nodes=1_000_000, partial=partial)


def random_covariance(random: np.random.Generator, count: int) -> Floats:
    """From round to very long: half of them as double differences are, a few directions metres, the others not."""
    if random.random() < 0.5:
        root = random.standard_normal((count, count + 1))
        return np.asarray(root @ root.T * 10.0 ** random.uniform(-2.0, 0.5))
    long = random.standard_normal((count, min(count, 3))) * random.uniform(1.0, 6.0)
    return np.asarray(long @ long.T + np.diag(10.0 ** random.uniform(-4.0, -1.5, count)))


def integers_within(floats: Floats, covariance: Floats, limit: float) -> tuple[Floats, Floats]:
    """Every integer vector whose squared norm is at most `limit`, and the norms: nothing reduced, nothing ordered.

    The vectors of the first places are kept with their distances given the places before, which only grow.
    """
    root = np.linalg.cholesky(covariance)
    vectors, whitened = np.zeros((1, 0)), np.zeros((1, 0))
    norms = np.zeros(1)
    for place in range(floats.size):
        centres = floats[place] + whitened @ root[place, :place]
        reach = np.sqrt(np.maximum(limit - norms, 0.0)) * root[place, place]
        first, last = np.ceil(centres - reach - 1e-9), np.floor(centres + reach + 1e-9)
        counts = np.maximum(last - first + 1, 0).astype(int)
        rows = np.repeat(np.arange(counts.size), counts)
        within = np.arange(rows.size) - np.repeat(np.cumsum(counts) - counts, counts)
        values = first[rows] + within
        steps = (values - centres[rows]) / root[place, place]
        vectors = np.column_stack((vectors[rows], values))
        whitened = np.column_stack((whitened[rows], steps))
        norms = norms[rows] + steps**2
    keep = norms <= limit
    order = np.argsort(norms[keep])
    return vectors[keep][order], norms[keep][order]


@pytest.mark.parametrize(
    ("floats", "covariance", "integers", "squared_norms", "off"),
    [
        (THREE, THREE_COVARIANCE, [[5, 3, 4], [6, 4, 4]], [0.21833, 0.30727], 5e-6),
        (SIX, SIX_COVARIANCE, [SIX_BEST, SIX_SECOND], [3.507984, 3.708456], 5e-7),
        # Printed there as 1506.435789 and 1612.811795 and compared to 1e-4: this covariance is all but singular. In
        # rational arithmetic the printed numbers give these.
        (TEN, TEN_COVARIANCE, [TEN_BEST, TEN_SECOND], [1506.43581472, 1612.81176646], 3e-5),
    ],
    ids=["three", "six", "ten"],
)
def test_the_published_cases_to_their_digits(
    floats: Floats, covariance: Floats, integers: list[list[int]], squared_norms: list[float], off: float
) -> None:
    vectors, norms = two_best(floats, covariance)
    assert vectors.tolist() == integers
    np.testing.assert_allclose(norms, squared_norms, rtol=0.0, atol=off)
    resolution = all_of_them(floats, covariance)
    assert (resolution.status, resolution.ambiguities.tolist()) == (RESOLVED, integers[0])
    assert resolution.ratio == pytest.approx(norms[1] / norms[0], rel=1e-6)


def test_a_thousand_random_cases_have_nothing_nearer_than_the_two_returned() -> None:
    random = np.random.default_rng(SEED)
    for case in range(1000):
        count = 1 + case % 6
        covariance = random_covariance(random, count)
        floats = random.uniform(-50.0, 50.0, count)
        vectors, norms = two_best(floats, covariance)
        every, all_norms = integers_within(floats, covariance, norms[1] * (1.0 + 1e-7))
        assert len(every) == 2, (case, count)
        np.testing.assert_array_equal(every, vectors, str(case))
        np.testing.assert_allclose(all_norms, norms, rtol=1e-7, err_msg=str(case))


def test_more_than_two_are_returned_in_order() -> None:
    random = np.random.default_rng(SEED + 2)
    for count in (1, 2, 4):
        covariance = random_covariance(random, count)
        _, (upper, variances, transform) = decorrelated(covariance)
        floats = transform @ random.uniform(-0.5, 0.5, count)
        result, vectors, norms, _ = nearest_integers(upper, variances, floats, 7, 100_000)
        of_z = transform @ covariance @ transform.T
        every, all_norms = integers_within(floats, of_z, norms[-1] * (1.0 + 1e-9))
        assert result == len(every) == 7
        np.testing.assert_allclose(all_norms, norms, rtol=1e-7)
        np.testing.assert_array_equal(every, vectors)


@pytest.mark.parametrize(("satellites", "bands"), [(5, 1), (6, 2), (11, 3), (25, 2), (25, 3)])
def test_the_transformation_is_unimodular_and_gives_the_decorrelated_covariance(
    satellites: int, bands: int
) -> None:
    random = np.random.default_rng(SEED + satellites)
    covariance = float_covariance(random, satellites, bands)
    definite, (upper, variances, transform) = decorrelated(covariance)
    assert definite
    np.testing.assert_array_equal(transform, np.rint(transform))
    inverse = np.rint(np.linalg.inv(transform))
    np.testing.assert_array_equal(transform @ inverse, np.eye(len(variances)))
    of_z, rounding = upper @ np.diag(variances) @ upper.T, 1e-10 * np.abs(covariance).max()
    np.testing.assert_allclose(of_z, transform @ covariance @ transform.T, rtol=0.0, atol=rounding)
    np.testing.assert_array_equal(np.tril(upper), np.eye(len(variances)))


def test_decorrelation_levels_the_conditional_variances() -> None:
    random = np.random.default_rng(SEED + 3)
    covariance = float_covariance(random, 16, 2)
    _, (upper, variances, _) = decorrelated(covariance)
    # Lovász' condition of each pair of neighbours, and sizes of at most a half.
    pairs = np.diag(upper, 1) ** 2 * variances[1:] + variances[:-1]
    assert (pairs >= variances[1:] * (1.0 - 1e-6)).all()
    assert np.abs(np.triu(upper, 1)).max() <= 0.5 + 1e-9
    before = np.diag(np.linalg.cholesky(covariance)) ** 2
    assert variances.max() / variances.min() < 0.01 * before.max() / before.min()
    assert np.log(variances).sum() == pytest.approx(np.log(before).sum(), abs=1e-6)


def test_whole_cycles_and_the_order_of_ambiguities_change_nothing_else() -> None:
    random = np.random.default_rng(SEED + 4)
    for satellites, bands in ((6, 1), (8, 2), (12, 2)):
        covariance = float_covariance(random, satellites, bands)
        floats = drawn(random, covariance, 1)[0]
        plain = all_of_them(floats, covariance)
        shift = np.rint(random.uniform(-1e8, 1e8, floats.size))
        order = random.permutation(floats.size)
        other = all_of_them((floats + shift)[order], covariance[np.ix_(order, order)])
        np.testing.assert_array_equal(other.ambiguities, (plain.ambiguities + shift)[order])
        assert other.squared_norm == pytest.approx(plain.squared_norm, rel=1e-5)
        assert other.ratio == pytest.approx(plain.ratio, rel=1e-5)


@pytest.mark.parametrize(
    ("floats", "covariance"),
    [
        ([0.1, 0.2], [[1.0, np.nan], [np.nan, 1.0]]),
        ([0.1, 0.2], [[np.inf, 0.0], [0.0, 1.0]]),
        ([0.1, np.nan], [[1.0, 0.0], [0.0, 1.0]]),
        ([0.1, np.inf], [[1.0, 0.0], [0.0, 1.0]]),
        ([0.1, 1e300], [[1.0, 0.0], [0.0, 1.0]]),
        ([0.1, 0.2], [[1.0, 1.0], [1.0, 1.0]]),
        ([0.1, 0.2], [[1.0, 2.0], [2.0, 1.0]]),
        ([0.1, 0.2], [[1.0, 0.3], [-0.3, 1.0]]),
        ([0.1, 0.2], [[-1.0, 0.0], [0.0, 1.0]]),
        ([0.1, 0.2], [[0.0, 0.0], [0.0, 0.0]]),
        ([0.1, 0.2, 0.3], [[1.0, 0.0], [0.0, 1.0]]),
        ([0.1, 0.2], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        ([], np.zeros((0, 0))),
    ],
)
def test_what_is_no_distribution_is_refused(floats: list[float], covariance: list[list[float]]) -> None:
    for partial in (False, True):
        resolution = all_of_them(np.array(floats), np.array(covariance), partial)
        assert (resolution.status, resolution.fixed) == (INVALID, 0)
        assert np.isnan(resolution.z_fixed).all()
        np.testing.assert_array_equal(resolution.ambiguities, floats)


@given(st.integers(0, 2**32), st.integers(1, 9), st.booleans())
@settings(derandomize=True, max_examples=300, deadline=None)
def test_of_any_numbers_the_answer_is_integers_or_nothing(seed: int, count: int, partial: bool) -> None:
    random = np.random.default_rng(seed)
    root = random.standard_normal((count, int(random.integers(1, count + 2))))
    root *= 10.0 ** random.uniform(-9.0, 9.0, (count, 1))
    covariance = root @ root.T
    floats = random.standard_normal(count) * 10.0 ** random.uniform(-3.0, 20.0, count)
    for _ in range(int(random.integers(0, 3))):
        row, column = random.integers(0, count, 2).tolist()
        odd = random.choice([0.0, -1.0, 1e300, math.inf, math.nan])
        covariance[row, column] = covariance[column, row] = odd
    resolution = resolved(floats, covariance, least_ratio=1.5, most_nodes=2000, partial=partial)
    assert resolution.nodes <= 2000
    if resolution.status != RESOLVED:
        assert resolution.fixed == 0
        np.testing.assert_array_equal(resolution.ambiguities, floats)
        assert np.isnan(resolution.z_fixed).all()
        return
    fixed = resolution.z_fixed[count - resolution.fixed :]
    np.testing.assert_array_equal(fixed, np.rint(fixed))
    assert np.isfinite(resolution.ambiguities).all()
    assert resolution.squared_norm >= 0.0
    assert resolution.ratio >= 1.0
    if resolution.fixed == count:
        np.testing.assert_array_equal(resolution.ambiguities, np.rint(resolution.ambiguities))
        np.testing.assert_array_equal(resolution.z.transform @ resolution.ambiguities, resolution.z_fixed)


def test_a_satellite_counted_twice_is_refused() -> None:
    covariance = float_covariance(np.random.default_rng(SEED), 9, 2)
    twice = [*range(16), 3]
    assert all_of_them(np.zeros(17), covariance[np.ix_(twice, twice)]).status == INVALID


def test_a_search_that_was_cut_off_resolves_nothing() -> None:
    covariance = float_covariance(np.random.default_rng(SEED), 9, 2)
    floats = drawn(np.random.default_rng(SEED), covariance, 1)[0] + 17.0
    whole = all_of_them(floats, covariance)
    assert whole.status == RESOLVED
    for most_nodes in (-1, 0, 1, 15, whole.nodes - 1):
        cut = resolved(floats, covariance, most_nodes=most_nodes)
        assert (cut.status, cut.fixed) == (SEARCH_CUT, 0)
        assert np.isnan(cut.z_fixed).all()
        np.testing.assert_array_equal(cut.ambiguities, floats)
    assert resolved(floats, covariance, most_nodes=whole.nodes).status == RESOLVED


def test_a_hopeless_case_ends_at_the_limit_of_nodes() -> None:
    # Nearly all corners of the cube around it are as near as one another.
    resolution = resolved(np.full(30, 0.4999), np.eye(30), least_ratio=3.0, most_nodes=5000)
    assert (resolution.status, resolution.nodes) == (SEARCH_CUT, 5000)


def test_the_ratio_must_exceed_what_is_asked_for() -> None:
    ratio = 0.30727 / 0.21833
    taken = resolved(THREE, THREE_COVARIANCE, least_ratio=ratio - 1e-3, most_nodes=1000)
    refused = resolved(THREE, THREE_COVARIANCE, least_ratio=ratio + 1e-3, most_nodes=1000)
    assert (taken.status, taken.fixed) == (RESOLVED, 3)
    assert (refused.status, refused.fixed, refused.trials) == (RATIO_TOO_LOW, 0, 1)
    assert refused.ratio == pytest.approx(ratio, rel=1e-4)


def test_floats_that_are_integers_have_an_infinite_ratio() -> None:
    resolution = resolved(np.array([3.0, -7.0, 12.0]), THREE_COVARIANCE, least_ratio=3.0, most_nodes=1000)
    assert (resolution.status, resolution.ratio) == (RESOLVED, math.inf)
    assert resolution.ambiguities.tolist() == [3.0, -7.0, 12.0]


def test_the_success_rate_is_that_of_bootstrapping_by_simulation() -> None:
    random = np.random.default_rng(SEED + 5)
    covariance = float_covariance(random, 7, 1, code_sigma_m=0.3)
    _, (upper, variances, transform) = decorrelated(covariance)
    count = variances.size
    samples = 100_000
    floats = drawn(random, transform @ covariance @ transform.T, samples)
    right = np.ones(samples, bool)
    # Bootstrapping: the last is rounded, the others are corrected by what was rounded off, and so on.
    for place in range(count - 1, -1, -1):
        integer = np.rint(floats[:, place])
        right &= integer == 0.0
        offset = (floats[:, place] - integer) / variances[place]
        for other in range(place):
            floats[:, other] -= (upper[other, place] * variances[place]) * offset
        share = right.mean()
        expected = math.exp(bootstrapped_log_success(variances, count - place))
        assert abs(share - expected) < 4.0 * math.sqrt(expected * (1.0 - expected) / samples) + 1e-12


def test_the_success_rate_bounds_that_of_least_squares_from_below() -> None:
    random = np.random.default_rng(SEED + 6)
    covariance = float_covariance(random, 6, 1, code_sigma_m=0.25)
    floats = drawn(random, covariance, 3000)
    resolutions = [all_of_them(row, covariance) for row in floats]
    right = np.mean([not resolution.ambiguities.any() for resolution in resolutions])
    assert right > resolutions[0].success_rate - 3.0 * math.sqrt(0.25 / 3000)
    assert 0.05 < resolutions[0].success_rate < 0.999


def weak_and_strong(random: np.random.Generator) -> Floats:
    """Double differences of which the last two are all but unknown."""
    covariance = float_covariance(random, 10, 2)
    noisy = np.zeros(18)
    noisy[[8, 17]] = 40.0
    return covariance + np.diag(noisy)


def test_the_largest_part_that_is_sure_enough_is_fixed() -> None:
    random = np.random.default_rng(SEED + 7)
    covariance = weak_and_strong(random)
    errors = drawn(random, covariance, 200)
    fixed = []
    sure = {"least_ratio": 1.5, "least_success_rate": 0.999, "least_fixed": 4}
    for row in errors:
        resolution = resolved(row, covariance, partial=True, **sure)
        # All at once reach no success rate worth naming.
        assert resolved(row, covariance, **sure).status == UNLIKELY
        if resolution.status == RESOLVED:
            fixed.append(resolution.fixed)
            first = 18 - resolution.fixed
            assert resolution.success_rate >= 0.999
            log_success = bootstrapped_log_success(resolution.z.variances, resolution.fixed)
            assert math.exp(log_success) == pytest.approx(resolution.success_rate)
            if resolution.trials == 1:
                one_more = bootstrapped_log_success(resolution.z.variances, resolution.fixed + 1)
                assert one_more < math.log(0.999)
            assert not np.isfinite(resolution.z_fixed[:first]).any()
            # The truth is zero, and so are its combinations.
            assert not resolution.z_fixed[first:].any()
            off = (resolution.z.transform @ row)[first:]
            np.testing.assert_allclose(resolution.z_residual[first:], off, atol=1e-8)
    assert len(fixed) > 190
    assert max(fixed) < 18


def test_a_part_is_made_smaller_while_its_ratio_is_too_low_but_not_below_the_least() -> None:
    random = np.random.default_rng(SEED + 8)
    covariance = float_covariance(random, 8, 2, code_sigma_m=0.8)
    statuses = set()
    sure = {"least_success_rate": 0.9, "partial": True}
    for row in drawn(random, covariance, 300):
        resolution = resolved(row, covariance, least_ratio=12.0, least_fixed=6, **sure)
        statuses.add((resolution.status, resolution.trials > 1))
        if resolution.status == RESOLVED:
            assert resolution.fixed >= 6
        if resolution.status == RATIO_TOO_LOW:
            assert resolution.fixed == 0
            assert resolution.trials <= 14 - 6 + 1
    assert {(RESOLVED, False), (RESOLVED, True)} <= statuses
    assert resolved(row, covariance, least_ratio=3.0, least_fixed=15, **sure).status == UNLIKELY


def test_the_conditional_update_is_the_textbooks() -> None:
    random = np.random.default_rng(SEED + 9)
    for partial in (False, True):
        covariance = weak_and_strong(random) if partial else float_covariance(random, 10, 2)
        floats = drawn(random, covariance, 1)[0] + 100.0
        cross = random.standard_normal((5, 18)) @ covariance * 0.01
        spread = cross @ np.linalg.solve(covariance, cross.T)
        state, state_covariance = random.standard_normal(5), spread + np.diag(np.full(5, 0.01))
        success = 0.99 if partial else 0.0
        resolution = resolved(
            floats, covariance, least_ratio=1.0, least_success_rate=success, partial=partial
        )
        assert resolution.status == RESOLVED
        updated, updated_covariance = conditional_update(state, state_covariance, cross, resolution)
        chosen = resolution.z.transform[18 - resolution.fixed :]
        z_covariance = chosen @ covariance @ chosen.T
        gain = np.linalg.solve(z_covariance, chosen @ cross.T).T
        residual = chosen @ floats - resolution.z_fixed[18 - resolution.fixed :]
        np.testing.assert_allclose(updated, state - gain @ residual, atol=1e-7)
        expected = state_covariance - gain @ chosen @ cross.T
        np.testing.assert_allclose(updated_covariance, expected, rtol=1e-6, atol=1e-9)
        gain_a = np.linalg.solve(z_covariance, chosen @ covariance).T
        np.testing.assert_allclose(resolution.ambiguities, floats - gain_a @ residual, atol=1e-6)


def test_where_nothing_is_fixed_the_update_gives_back_the_float_state() -> None:
    resolution = resolved(THREE, THREE_COVARIANCE, least_ratio=100.0, most_nodes=1000)
    updated, covariance = conditional_update(np.ones(2), np.eye(2), np.ones((2, 3)), resolution)
    assert updated.tolist() == [1.0, 1.0]
    assert covariance.tolist() == np.eye(2).tolist()

"""The ratio that keeps a failure rate: what the table says is strict enough, also between and outside its entries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.gnss.ambiguity.ambiguity_resolution import RATIO_TOO_LOW, RESOLVED, bootstrapped_log_success
from camber.gnss.ambiguity.lambda_decorrelation import decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers
from camber.gnss.ambiguity.ratio_threshold_table import ratio_for_failure_rate
from support.ambiguity_models import drawn, float_covariance
from support.ambiguity_resolution import resolved

Floats = NDArray[np.float64]
SEED = 77_000


def failing(covariance: Floats, failure: float) -> Floats:
    """The covariance times what makes bootstrapping fail so often."""
    _, (_, variances, _) = decorrelated(covariance)
    low, high = 1e-6, 1e6
    for _ in range(100):
        middle = math.sqrt(low * high)
        failed = -math.expm1(bootstrapped_log_success(middle * variances, variances.size))
        low, high = (middle, high) if failed < failure else (low, middle)
    return low * covariance


@pytest.mark.parametrize("failure_rate", [0.001, 0.01])
@pytest.mark.parametrize(
    ("satellites", "bands", "failure"),
    [
        (5, 1, 0.05), (5, 1, 0.4), (7, 1, 0.1), (5, 2, 0.03), (8, 1, 0.3), (8, 2, 0.1), (10, 2, 0.02), (9, 3, 0.015),
    ],
)  # fmt: skip
def test_wrong_integers_are_taken_no_more_often_than_the_failure_rate(
    satellites: int, bands: int, failure: float, failure_rate: float
) -> None:
    # Geometries and noise that the table was not made with.
    random = np.random.default_rng(SEED + satellites * 10 + bands)
    code_sigma_m = float(random.uniform(0.3, 2.0))
    covariance = failing(float_covariance(random, satellites, bands, code_sigma_m=code_sigma_m), failure)
    _, (upper, variances, transform) = decorrelated(covariance)
    count = variances.size
    needed = ratio_for_failure_rate(count, failure, failure_rate)
    samples = 20_000
    wrong = right = 0
    for row in drawn(random, transform @ covariance @ transform.T, samples):
        result, vectors, norms, _ = nearest_integers(upper, variances, row, 2, 100_000)
        assert result == 2
        if norms[1] > needed * norms[0]:
            wrong += bool(vectors[0].any())
            right += not vectors[0].any()
    allowed = failure_rate * samples
    assert wrong <= allowed + 3.0 * math.sqrt(allowed)
    # And not by taking nothing.
    assert right > wrong


def test_between_entries_the_strictest_neighbour_counts() -> None:
    for failure_rate in (0.001, 0.01):
        for count in range(1, 26):
            failures = np.linspace(0.0, 0.6, 200).tolist()
            ratios = [ratio_for_failure_rate(count, failure, failure_rate) for failure in failures]
            assert ratios == sorted(ratios)
            assert ratios[0] == 1.0
            assert ratios[-1] == math.inf
        for count, below, above in ((7, 6, 8), (9, 8, 10), (18, 16, 20), (23, 20, 25)):
            for failure in (0.005, 0.02):
                around = [ratio_for_failure_rate(n, failure, failure_rate) for n in (below, above)]
                assert ratio_for_failure_rate(count, failure, failure_rate) == max(around)
    assert ratio_for_failure_rate(10, 0.03, 0.005) == ratio_for_failure_rate(10, 0.05, 0.001)
    for count, failure in ((5, 0.1), (10, 0.05), (20, 0.3)):
        assert ratio_for_failure_rate(count, failure, 0.001) > ratio_for_failure_rate(count, failure, 0.01)


@pytest.mark.parametrize(
    ("count", "failure", "failure_rate"),
    [
        (10, 0.51, 0.01), (26, 0.02, 0.01), (25, 0.03, 0.01), (0, 0.02, 0.01), (10, 0.02, 0.0009), (10, math.nan, 0.01),
    ],
)  # fmt: skip
def test_outside_the_table_nothing_is_accepted(count: int, failure: float, failure_rate: float) -> None:
    assert ratio_for_failure_rate(count, failure, failure_rate) == math.inf


def test_resolving_with_a_failure_rate_asks_for_the_tables_ratio() -> None:
    random = np.random.default_rng(SEED)
    covariance = failing(float_covariance(random, 6, 2), 0.04)
    needed = ratio_for_failure_rate(10, 0.05, 0.01)
    statuses = set()
    for row in drawn(random, covariance, 300):
        resolution = resolved(row, covariance, least_ratio=1e9, failure_rate=0.01)
        assert resolution.ratio_needed == needed
        assert resolution.status == (RESOLVED if resolution.ratio > needed else RATIO_TOO_LOW)
        statuses.add(resolution.status)
    assert statuses == {RESOLVED, RATIO_TOO_LOW}
    assert resolved(row, covariance, failure_rate=1e-6).status == RATIO_TOO_LOW


def test_a_model_that_hardly_fails_needs_no_ratio() -> None:
    covariance = failing(float_covariance(np.random.default_rng(SEED), 10, 2), 1e-4)
    row = drawn(np.random.default_rng(SEED), covariance, 1)[0]
    resolution = resolved(row, covariance, least_ratio=1e9, partial=True, failure_rate=0.001)
    assert (resolution.status, resolution.fixed, resolution.ratio_needed) == (RESOLVED, 18, 1.0)
    assert ratio_for_failure_rate(60, 1e-4, 0.001) == 1.0

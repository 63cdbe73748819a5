"""Bounds of counted rates against closed forms and a second implementation."""

from __future__ import annotations

import pytest
from scipy import stats

from camber.validation.lab.rate_bounds import clopper_pearson, incomplete_beta


@pytest.mark.parametrize("a", [0.5, 1.0, 3.0, 40.0])
@pytest.mark.parametrize("b", [0.7, 2.0, 1000.0])
@pytest.mark.parametrize("x", [1e-6, 1e-3, 0.2, 0.5, 0.99])
def test_the_incomplete_beta_function_is_the_beta_distribution(x: float, a: float, b: float) -> None:
    assert incomplete_beta(x, a, b) == pytest.approx(float(stats.beta.cdf(x, a, b)), rel=1e-9, abs=1e-14)


@pytest.mark.parametrize(
    ("events", "trials"), [(1, 10), (3, 1000), (17, 1_000_000), (999, 1000), (2.5, 700.5)]
)
def test_bounds_are_those_of_clopper_and_pearson(events: float, trials: float) -> None:
    low, high = clopper_pearson(events, trials)
    assert low == pytest.approx(float(stats.beta.ppf(0.05, events, trials - events + 1)), rel=1e-8)
    assert high == pytest.approx(float(stats.beta.ppf(0.95, events + 1, trials - events)), rel=1e-8)


def test_without_events_the_bound_is_three_by_the_trials() -> None:
    low, high = clopper_pearson(0, 1_000_000)
    assert low == 0.0
    assert high == pytest.approx(3.0e-6, rel=0.01)


def test_certain_events_and_no_trials_at_all_have_bounds_too() -> None:
    assert clopper_pearson(20, 20)[1] == 1.0
    assert clopper_pearson(20, 20)[0] == pytest.approx(0.05 ** (1 / 20), rel=1e-8)
    assert clopper_pearson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("events", "trials"), [(3, 2), (-1, 2)])
def test_more_events_than_trials_are_refused(events: int, trials: int) -> None:
    with pytest.raises(ValueError, match="events of"):
        clopper_pearson(events, trials)

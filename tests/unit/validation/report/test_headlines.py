"""Headlines of the report: what they claim of how many trials, and in which words."""

from __future__ import annotations

import numpy as np
import pytest

from camber.validation.report.headlines import (
    LEAST_TRIALS,
    NBSP,
    count_headline,
    interval_text,
    pieces_of,
    quantile_headline,
    rate_claim,
    share_headline,
)
from camber.validation.statistics import clopper_pearson

TENTH_NS = 100_000_000


def times(seconds: float) -> np.ndarray:
    """Epochs at 10 Hz."""
    return np.arange(round(10 * seconds), dtype=np.int64) * TENTH_NS


def plain(text: str) -> str:
    return text.replace(NBSP, " ")


def test_one_episode_supports_no_rate() -> None:
    assert plain(rate_claim(0, 1, "episodes")) == "no rate: n = 1 (episodes), below 20"
    assert count_headline("missed", 0, 1, more="", trials=1).kind == ""


@pytest.mark.parametrize(
    ("missed", "n", "text"),
    [
        (0, 19, "no rate: n = 19 (episodes), below 20"),
        (0, 20, "rate at most 15 % (95 %, 3/n), n = 20 (episodes)"),
        (0, 400, "rate at most 0.8 % (95 %, 3/n), n = 400 (episodes)"),
        (5, 50, "rate 10.0 %, 95 %: 3–22 %, n = 50 (episodes)"),
        (None, None, "not known"),
    ],
)
def test_what_episodes_support(missed: int | None, n: int | None, text: str) -> None:
    assert plain(rate_claim(missed, n, "episodes")) == text


def test_the_bound_of_twenty_trials_is_the_rate_without_a_judge() -> None:
    assert clopper_pearson(0, LEAST_TRIALS)[1] == pytest.approx(3.0 / LEAST_TRIALS, rel=0.08)


def test_only_a_count_of_enough_trials_is_good_and_any_event_is_bad() -> None:
    kinds = [
        count_headline("missed", events, 30, more="", trials=n).kind
        for events, n in ((0, 20), (0, 19), (1, 1))
    ]
    assert kinds == ["good", "", "bad"]
    assert count_headline("missed", 0, 0, more="", trials=0).value == "none occurred"
    assert count_headline("missed", None, 30, more="", trials=30).value == "not known"


def test_epochs_near_in_time_are_one_trial() -> None:
    assert pieces_of(times(120.0)) == 12
    short = share_headline("available", 0.5, times(120.0), "epochs")
    assert (plain(short.value), plain(short.more)) == (
        "600 of 1,200",
        "epochs; no rate: n = 12 (pieces of 10 s), below 20",
    )
    long = share_headline("available", 0.5, times(1000.0), "epochs")
    assert plain(long.value) == "50.0 %"
    # Clopper and Pearson of 50 of 100, not of 5,000 of 10,000.
    assert plain(long.more) == "of 10,000 epochs; 95 %: 39–61 %, n = 100 (pieces of 10 s)"


def test_an_interval_is_rounded_outwards() -> None:
    assert plain(interval_text(0.0, 1000.0)) == "95 %: 0.0–0.3 %"
    assert plain(interval_text(100.0, 100.0)) == "95 %: 97.0–100.0 %"


def test_a_quantile_of_few_pieces_is_not_given() -> None:
    few = quantile_headline("error", np.linspace(0.0, 1.0, 100), times(10.0))
    assert plain(few.value) == "0.50 m"
    assert "no quantile: n = 1" in plain(few.more)
    assert "median" in few.name
    many = quantile_headline("error", np.linspace(0.0, 1.0, 10_000), times(1000.0))
    assert plain(many.value) == "0.95 m"
    assert plain(many.more).startswith("95 %: 0.89–0.98 m, n = 100 (pieces of 10 s)")
    assert quantile_headline("error", np.full(3, np.nan), times(0.3)).value == "not known"

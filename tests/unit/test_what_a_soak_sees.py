"""By what `make soak` judges: what grows is seen, what comes and goes is none, a verdict that is late counts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from soak import run
from soak.readings import growth, lasting_growth

HOURS = 1.75
AT_S = np.arange(0.0, HOURS * 3600.0, 10.0)
PART = AT_S / AT_S[-1]
HELD_MB = 50.0
SEED = 20261123


def grown_mb(more_mb: np.ndarray) -> float:
    """Of a process that holds 50 MB and so much more, read with a noise of 0.2 MB."""
    noise = np.random.default_rng(SEED).normal(0.0, 0.2, len(AT_S))
    return growth(AT_S.tolist(), (HELD_MB + noise + more_mb).tolist())


@pytest.mark.parametrize(
    "more_mb",
    [
        pytest.param(3.0 * PART, id="all the time"),
        pytest.param(np.where(PART > 0.3, 5.0, 0.0), id="a step that stays"),
        pytest.param(np.where(PART > 0.8, 100.0 * (PART - 0.8), 0.0), id="late"),
        pytest.param(np.minimum(PART, 0.25) * 20.0, id="early, and kept"),
    ],
)
def test_memory_that_grows_is_seen(more_mb: np.ndarray) -> None:
    assert grown_mb(more_mb) > run.GROWTH_SHARE * HELD_MB


@pytest.mark.parametrize(
    "more_mb",
    [
        pytest.param(0.0 * PART, id="nothing"),
        pytest.param(np.where(abs(PART - 0.9) < 0.02, 80.0, 0.0), id="a peak"),
        pytest.param(3.0 * np.sin(40.0 * PART), id="up and down"),
    ],
)
def test_memory_that_comes_and_goes_is_none(more_mb: np.ndarray) -> None:
    assert grown_mb(more_mb) < run.GROWTH_SHARE * HELD_MB


def test_descriptors_that_leak_are_seen_through_noise_a_peak_and_a_dip() -> None:
    held = 20 + np.random.default_rng(SEED).integers(0, 3, len(AT_S))
    assert lasting_growth(held.tolist()) == 0
    leak = held + (4.0 * AT_S / 3600.0).astype(int)
    assert lasting_growth(leak.tolist()) >= 3
    leak[100], leak[-50] = 200, 5
    assert lasting_growth(leak.tolist()) >= 3


class Witness:
    """Fixes at 5 Hz; of each what is said, and after how many milliseconds."""

    def __init__(self, seconds: float, late_ms: list[float | None]) -> None:
        self.items = []
        for n in range(round(5.0 * seconds)):
            late = late_ms[n % len(late_ms)]
            self.items.append(SimpleNamespace(at_s=0.2 * n, message=Fix.model_construct(fix_id=n)))
            if late is not None:
                verdict = Verdict.model_construct(fix_id=n)
                self.items.append(SimpleNamespace(at_s=0.2 * n + 1e-3 * late, message=verdict))

    def since(self, from_s: float, until_s: float = float("inf")) -> list[SimpleNamespace]:
        return [item for item in self.items if from_s <= item.at_s < until_s]

    def words(self, *_: float) -> dict[tuple[str, str], int]:
        return {("right", "confirmed"): 1000}

    def wrong_that_was_trusted(self, *_: float) -> SimpleNamespace:
        return SimpleNamespace(total=lambda: 0)


def complaints_of(seconds: float, late_ms: list[float | None]) -> list[str]:
    seen = run.windows(Witness(seconds, late_ms), 0.0, seconds, [])  # type: ignore[arg-type]
    return run.complaints({}, seen, least_mb=0.5, latency=True)


def test_verdicts_in_time_are_no_complaint_and_all_of_the_time_is_looked_at() -> None:
    seen = run.windows(Witness(1000.0, [5.0]), 0.0, 1000.0, [])  # type: ignore[arg-type]
    assert [(w.from_s, w.until_s) for w in seen] == [(0.0, 300.0), (300.0, 600.0), (600.0, 1000.0)]
    assert sum(w.fixes for w in seen) == 4995
    assert complaints_of(1000.0, [5.0]) == []


@pytest.mark.parametrize(
    "late_ms",
    [[5.0] * 49 + [30.0], [5.0] * 49 + [None], [5.0] + [None] * 9],
    ids=["late", "a few never", "most never"],
)
def test_verdicts_that_are_late_or_never_come_are_a_complaint(late_ms: list[float | None]) -> None:
    assert any("p99 of verdicts" in said for said in complaints_of(600.0, late_ms))


def test_a_short_run_complains_of_fixes_without_a_verdict_too() -> None:
    seen = run.windows(Witness(300.0, [5.0] * 9 + [None]), 0.0, 300.0, [])  # type: ignore[arg-type]
    (said,) = run.complaints({}, seen, least_mb=2.0, latency=False)
    assert said == "0 to 300 s: 149 of 1495 fixes without a verdict"

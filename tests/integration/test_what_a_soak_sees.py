"""The soak's judgement of what it reads: a leak is seen, and what comes and goes is none."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from random import Random
from types import SimpleNamespace

import pytest

from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict
from soak.readings import Reading, lasting_growth, read
from soak.run import LEAST_MB, Window, complaints, drift, windows
from support.running import started

LEAKING = """
import sys, threading, time
kept = []
print("begun", flush=True)
for n in range(400):
    kept.append(bytearray(250_000))
    if n % 40 == 0:
        kept.append(open("/dev/null"))
        threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
    time.sleep(0.01)
print("done", flush=True)
time.sleep(60.0)
"""
CALM = Window(0.0, 300.0, 1500, 0, 5.0, 9.0, 15.0, 1200, 0, 0.4)
HOUR_S = 3600.0


def readings(mb_an_hour: float, *, steps: dict[int, float] | None = None, seed: int = 1) -> list[Reading]:
    """Two hours of a process of 50 MB: its memory comes and goes by half a megabyte; `steps` by reading."""
    random, taken, level = Random(seed), [], 50.0
    for n in range(720):
        level += (steps or {}).get(n, 0.0)
        uss = level + mb_an_hour * n * 10.0 / HOUR_S + random.uniform(0.0, 0.5)
        taken.append(Reading(10.0 * n, uss, uss, 16 + random.randrange(3), 8, 0.1 * n))
    return taken


def complaints_about(taken: list[Reading], window: Window = CALM) -> list[str]:
    return complaints({"gnss": drift(taken)}, [window], least_mb=LEAST_MB, latency=True)


def test_a_calm_process_is_no_leak():
    assert complaints_about(readings(0.0)) == []


@pytest.mark.parametrize("mb_an_hour", [0.7, 5.0])
def test_memory_that_grows_all_the_time_is_a_leak(mb_an_hour):
    assert ["memory grew" in text for text in complaints_about(readings(mb_an_hour))] == [True]


@pytest.mark.parametrize(
    "steps",
    [{216: 5.0}, dict.fromkeys(range(580, 720), 0.2), dict.fromkeys(range(180), 0.05)],
    ids=["a step that stays", "late", "early, and kept"],
)
def test_memory_that_is_more_in_the_end_is_a_leak(steps):
    assert ["memory grew" in text for text in complaints_about(readings(0.0, steps=steps))] == [True]


def test_descriptors_that_leak_slowly_are_seen_through_a_peak_and_a_dip():
    held = [20 + Random(n).randrange(3) for n in range(720)]
    assert lasting_growth(held) == 0
    leak = [fds + n // 90 for n, fds in enumerate(held)]
    leak[100], leak[-50] = 200, 5
    assert lasting_growth(leak) >= 3


def test_a_step_up_and_down_again_is_none():
    assert complaints_about(readings(0.0, steps={300: 10.0, 420: -10.0})) == []


def test_descriptors_and_threads_that_stay_are_a_leak():
    taken = readings(0.0)
    grown = [Reading(r.at_s, r.uss_mb, r.pss_mb, r.descriptors + 4 * (n > 300), r.threads + (n > 300), r.cpu_s)
             for n, r in enumerate(taken)]  # fmt: skip
    assert len(complaints_about(grown)) == 2


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"p99_ms": 21.0}, "p99"),
        ({"p99_ms": float("nan")}, "p99"),
        ({"confirmed_wrong": 1}, "wrong"),
        ({"confirmed_right": 0}, "nothing confirmed"),
        ({"unjudged": 80}, "80 of 1500 fixes without a verdict"),
    ],
)
def test_late_wrong_and_missing_verdicts_are_complaints(changes, complaint):
    (text,) = complaints_about(readings(0.0), replace(CALM, **changes))
    assert complaint in text


def test_a_process_that_leaks_is_read_as_one():
    with started("-c", LEAKING) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "begun"
        taken = []
        while (
            not taken or taken[-1].uss_mb - taken[0].uss_mb < 20.0 or taken[-1].threads - taken[0].threads < 2
        ):
            taken.append(read(process.pid, time.monotonic()))
            time.sleep(0.05)
            assert len(taken) < 2000, "it does not grow"
    assert taken[-1].descriptors > taken[0].descriptors
    assert drift(taken)["growth_mb"] > 5.0


class Witness:
    """Fixes at 5 Hz and the delay of each verdict in milliseconds (None: no verdict)."""

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

    def verdict_counts(self, *_: float) -> Counter[tuple[str, str]]:
        return Counter({("right", "confirmed"): 1000})

    def wrong_but_trusted(self, *_: float) -> SimpleNamespace:
        return SimpleNamespace(total=lambda: 0)


def complaints_of(seconds: float, late_ms: list[float | None]) -> list[str]:
    seen = windows(Witness(seconds, late_ms), 0.0, seconds, [])  # type: ignore[arg-type]
    return complaints({}, seen, least_mb=0.5, latency=True)


def test_verdicts_in_time_are_no_complaint_and_all_of_the_time_is_looked_at() -> None:
    seen = windows(Witness(1000.0, [5.0]), 0.0, 1000.0, [])  # type: ignore[arg-type]
    assert [(w.from_s, w.until_s) for w in seen] == [(0.0, 300.0), (300.0, 600.0), (600.0, 1000.0)]
    assert sum(w.fixes for w in seen) == 4995
    assert complaints_of(1000.0, [5.0]) == []


@pytest.mark.parametrize(
    "late_ms",
    [[5.0] * 49 + [30.0], [5.0] * 49 + [None], [5.0] + [None] * 9],
    ids=["late", "a few never", "most never"],
)
def test_verdicts_that_are_late_or_never_come_are_a_complaint(late_ms: list[float | None]) -> None:
    assert any("p99 of verdicts" in complaint for complaint in complaints_of(600.0, late_ms))

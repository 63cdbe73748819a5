"""GPS time from the machine's clock, and from the ticks of a replay."""

from __future__ import annotations

import time
from datetime import UTC, datetime

import pytest

from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.runtime.clock import ReplayClock, SystemClock

NS = 1_000_000_000


def unix_ns(*calendar: int) -> int:
    return int(datetime(*calendar, tzinfo=UTC).timestamp()) * NS  # type: ignore[misc, arg-type]


@pytest.mark.parametrize(
    "utc",
    [
        (1999, 1, 1, 0, 0, 0),
        (2016, 12, 31, 23, 59, 58),
        (2017, 1, 1, 0, 0, 0),
        (2017, 1, 1, 0, 0, 1),
        (2026, 7, 1, 12, 0, 0),
    ],
)
def test_the_machines_clock_is_gps_time(monkeypatch: pytest.MonkeyPatch, utc: tuple[int, ...]) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: unix_ns(*utc) + 123)
    assert SystemClock().now_ns() == gps_ns_from_utc(CalendarTime(*utc)) + 123


def test_it_goes_on_after_a_leap_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: unix_ns(2017, 1, 1, 0, 0, 0))
    after = SystemClock().now_ns()
    monkeypatch.setattr(time, "time_ns", lambda: unix_ns(2016, 12, 31, 23, 59, 58))
    assert after - SystemClock().now_ns() == 3 * NS  # :58, :59, :60


def test_a_machine_without_a_time_is_below_zero_and_does_not_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 5 * NS)  # 1970
    assert SystemClock().now_ns() < 0


def test_the_clock_of_a_replay_stands_at_its_tick() -> None:
    clock = ReplayClock()
    assert clock.now_ns() == 0
    clock.set(7)
    assert clock.now_ns() == 7
    assert clock.now_ns() == 7

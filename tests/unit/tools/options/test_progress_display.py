"""A bar on a terminal; in a log a line every ten seconds, no more, and none of what is over sooner."""

from __future__ import annotations

import time

import pytest

from camber.tools.options.progress_display import ProgressDisplay


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, in its only item."""
    now_s = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    return now_s


def advance(display: ProgressDisplay, clock: list[float], steps: int, step_s: float) -> None:
    with display:
        for _ in range(steps):
            clock[0] += step_s
            display.advance()


def test_a_line_every_ten_seconds(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    advance(ProgressDisplay(3000, "epoch"), clock, 3000, 1.0 / 128.0)
    assert capsys.readouterr() == ("", "1,280 of 3,000 epochs, 10 s\n2,560 of 3,000 epochs, 20 s\n")


def test_a_long_step_gives_one_line_with_what_was_done_and_its_label(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    display = ProgressDisplay(None, "function", label="compiling")
    advance(display, clock, 2, 35.0)
    display.describe("linking")
    advance(display, clock, 1, 35.0)
    expected = "compiling: 1 functions, 35 s\ncompiling: 2 functions, 70 s\nlinking: 3 functions, 105 s\n"
    assert capsys.readouterr().err == expected


def test_what_is_over_sooner_shows_nothing(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    advance(ProgressDisplay(900, "epoch"), clock, 900, 0.01)
    assert capsys.readouterr().err == ""


def test_quiet_shows_nothing(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    advance(ProgressDisplay(3, "part", quiet=True), clock, 3, 20.0)
    assert capsys.readouterr().err == ""

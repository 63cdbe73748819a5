"""The page of common faults: what was run, in the table of its setting, and nothing of what was not."""

from __future__ import annotations

from typing import Any

from camber.validation.common_faults.page import page

FIGURES: dict[str, Any] = {
    "part": "faults",
    "fault": "along-0.05",
    "reference": "required",
    "scene": "country",
    "ground": "hilly",
    "seed": 1,
    "lasts_s": 600.0,
    "fixes": 3000,
    "wrong": 1000,
    "wrong_confirmed": 12,
    "worst_m": 1.25,
    "right": 2000,
    "right_confirmed": 1990,
    "right_erroneous": 1,
    "epochs": 6000,
    "usable": 4000,
    "beyond_level": 3,
    "beyond_level_and_limit": 2,
    "usable_share": 0.7,
    "usable_share_after_2_km": 0.9,
    "usable_until_s": 21.0,
    "median_level_m": 0.5,
    "median_error_m": 0.01,
    "named_by": "drift",
    "named_after_s": 33.0,
    "causes": {},
    "issues": {},
}
EPISODES = FIGURES | {
    "part": "episodes",
    "fault": "none",
    "episodes": 18,
    "captured": 2,
    "to_unknown_s": [2.0, None],
    "to_confirmed_s": [5.0, 9.0],
    "availability": 0.8,
}


def _lines(text: str, start: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith(f"| {start}")]


def test_a_row_adds_up_its_seeds_and_has_the_worst_of_them() -> None:
    other = FIGURES | {
        "seed": 2,
        "wrong_confirmed": 8,
        "worst_m": 2.5,
        "named_after_s": None,
        "named_by": None,
    }
    (row,) = _lines(page([FIGURES, other]), "led away along the road, 0.05 m/s |")
    for cell in ("hilly", "20 of 2000", "2.5", "6 of 8000", "33 (drift, 1 of 2)", "21"):
        assert f"| {cell} |" in row


def test_what_was_not_run_is_missing() -> None:
    text = page([])
    assert text.count("Not run.") == 6
    assert not _lines(text, "led away")


def test_settings_are_apart() -> None:
    text = page([FIGURES | {"reference": "assumed"}])
    required, assumed = text.split('## horizontal_reference = "assumed"')
    assert not _lines(required, "led away")
    assert len(_lines(assumed, "led away")) == 1


def test_a_false_alarm_is_a_cause_named_by_verdicts_or_an_issue_once_a_drive() -> None:
    quiet = FIGURES | {"fault": "none", "part": "controls"}
    loud = quiet | {"causes": {"base": 40}, "issues": {"base_wrong": 2, "fixes_led_away": 1}}
    (row,) = _lines(page([quiet, loud]), "hilly, no LiDAR")
    assert row.split(" | ")[1:3] == ["0.3", "2"]


def test_captured_poses_have_their_longest_times() -> None:
    (row,) = _lines(page([EPISODES]), "hilly |")
    assert "2 of 18 episodes" in row
    assert "median 2.0, longest 2.0, never 1" in row
    assert "median 9.0, longest 9.0" in row

"""The page of the evidence: what was run with its n, what was not run as such."""

from __future__ import annotations

from typing import Any

import pytest

from camber.validation.evidence.nagoya import total
from camber.validation.evidence.page import NOT_RUN, page, percent, table

LEVEL = {"epochs": 200, "misleading": 2, "unavailable_misleading": 1, "hazardous": 1}
LEVEL |= {"median_level_m": 1.25, "median_error_m": 0.25, "ratio": 5.0}


def judged(confirmed_wrong: int = 0, kept: float = 0.99, missed: int = 0) -> dict[str, Any]:
    return {
        "confirmed_wrong": confirmed_wrong,
        "right": 1000,
        "right_kept": kept,
        "right_erroneous": 2,
        "episodes": 30,
        "missed": missed,
    }


def nagoya(seed: int, sigma_m: float = 0.05, wrong_at_s: tuple[float, ...] = ()) -> dict[str, Any]:
    wrong_epochs = [
        {
            "at_s": at_s,
            "fix_error_enu_m": [0.1, -0.17, -0.49],
            "word": "confirmed",
            "evidence": ["height"],
            "height_difference_m": 0.187,
            "position_difference_m": None,
            "joint_distance2": 12.3,
            "correction_m": 0.01,
        }
        for at_s in wrong_at_s
    ]
    ratio = judged(114, 1.0, 30)
    return {
        "seed": seed,
        "map_sigma_m": sigma_m,
        "wrong": 114,
        "judges": {
            "camber": judged(len(wrong_epochs), missed=len(wrong_epochs)),
            "ratio_test_only": ratio,
            "height_only": ratio,
            "always_unknown": judged(0, 0.0),
        },
        "held_back": {"unknown: starting": 4},
        "wrong_confirmed": wrong_epochs,
    }


def drive(seed: int) -> dict[str, Any]:
    return {
        "scenario": "canyon",
        "seed": seed,
        "overrides": [],
        "positions": "engine",
        "duration_s": 40.0,
        "epochs": 400,
        "fixed": 100,
        "wrong": 5,
        "confirmed_wrong": 0,
        "right_kept": 0.9,
        "usable": 0.5,
        "levels": {"sensors": {"hpl": LEVEL, "vpl": LEVEL | {"epochs": 0}}},
        "errors": [[200, 200, 200, 200, 200], [200, 200, 150, 180, 200]],
        "modes": {
            "rtk": [[100, 100, 100], [100, 99, 100]],
            "doppler": [[0, 0, 0], [0, 0, 0]],
            "sensors": [[100, 98, 100], [100, 97, 99]],
            "scan_match": [[0, 0, 0], [0, 0, 0]],
        },
    }


def test_a_drive_without_re_estimation_is_in_a_row_with_the_same_one_with_it_and_in_no_other_table() -> None:
    with_it = drive(51) | {"re_estimation": "agreement", "confirmed": 116}
    without = drive(51) | {"re_estimation": "off", "confirmed": 100, "epochs": 10_000}
    text = page([], [with_it, without], [])
    assert "| canyon | 51 | 100 | 116 | 16.0 % | 0 | 0 | yes |" in text
    assert "10000" not in text
    for worse in ({"confirmed": 114}, {"confirmed": 117, "confirmed_wrong": 1}):
        assert "| **no** |" in page([], [with_it | worse, without], [])


def test_without_the_drive_that_has_no_re_estimation_that_part_was_not_run() -> None:
    text = page([], [drive(51)], [])
    assert f"### Re-estimation\n\n{NOT_RUN}" in text


def faults() -> dict[str, Any]:
    row = {"begin_s": 30.0, "end_s": 50.0, "fixed": 90, "wrong": 88, "wrong_confirmed": 0}
    row |= {"wrong_confirmed_after": 0, "correction_before_m": 0.0}
    row |= {"correction_at_end_m": None, "correction_after_m": 0.01}
    return {
        "scenario": "faults",
        "seed": 7,
        "overrides": [],
        "positions": "receiver",
        "sweeps": 0,
        "wrong": 88,
        "confirmed_wrong": 0,
        "right_kept": 0.9,
        "faults": [
            {"kind": "wrong_base", "named_by": "cause base", "named_after_s": 0.4, **row},
            {"kind": "jamming", "named_by": None, "named_after_s": None, **row},
        ],
    }


def test_a_page_without_results_claims_nothing() -> None:
    text = page([], [], [], notes=["Nagoya was skipped."])
    assert text.count(NOT_RUN) == 4
    assert "Nagoya was skipped." in text
    assert "%" not in text.split("## A recorded drive")[1]


def test_a_table_for_each_sigma_names_seeds_and_n_and_a_sigma_that_was_not_run_says_so() -> None:
    text = page([nagoya(1), nagoya(2)], [], [])
    assert "seeds 1 to 2 (2 drives)" in text
    assert "| Camber | 0 of 228 | 99.00 % | 4 | 0 of 30 × 2 | 10 % |" in text
    assert "met so far, with fewer seeds" in text
    assert "σ 0.10 m: not run" in text
    assert "unknown: starting 8" in text


def test_a_wrong_epoch_that_was_confirmed_is_listed_with_what_the_judge_measured() -> None:
    text = page([nagoya(1), nagoya(2, wrong_at_s=(512.4, 513.0))], [], [])
    assert "**not met**" in text
    assert "| 2 | 512.4 | +0.10, -0.17, -0.49 | +0.19 | — | 12.3 | +0.010 | confirmed (height) |" in text


def test_all_seeds_within_the_limits_meet_what_is_asked_for() -> None:
    assert "**met**" in page([nagoya(seed) for seed in range(1, 51)], [], [])


def test_the_figures_of_a_judge_are_summed_over_seeds_but_episodes_are_the_recordings() -> None:
    summed = total([nagoya(1, wrong_at_s=(1.0,)), nagoya(2)], "camber")
    assert (summed["wrong"], summed["confirmed_wrong"], summed["episodes"]) == (228, 1, 30)
    assert summed["missed"] == 1


def test_errors_are_in_a_row_with_those_of_the_source_and_modes_without_epochs_say_none() -> None:
    text = page([], [drive(51), drive(52)], [])
    assert "| error < 1.0 m | 91.8 % | 99.0 % | 87.50 % |" in text
    assert "| error < 2.0 m | 99.9 % | 100.0 % | 100.00 % | 100.00 % – 100.00 % |" in text
    assert "| doppler | 0 | — | none |" in text
    assert "| sensors | 400 | 98.1 % | 97.50 % |" in text
    assert "seeds 51, 52" in text
    assert "| sensors, horizontal | 400 | 6 | 2 | 1.25 m | 5.0 |" in text
    assert "sensors, vertical" not in text


def test_a_fault_that_nothing_names_is_marked() -> None:
    text = page([], [], [faults()])
    assert "| wrong_base 30–50 s | cause base after 0.4 s | 88 of 90 | 0 | 0 | +0.000 → — → +0.010 |" in text
    assert "| jamming 30–50 s | **not named** |" in text
    assert "without LiDAR" in text


def test_the_labs_part_stands_as_the_lab_made_it() -> None:
    text = page([], [], [], lab="## The lab\n\nA million trials.\n")
    assert text.count("## The lab") == 1
    assert "A million trials." in text


@pytest.mark.parametrize(
    ("share", "text"),
    [(None, "none"), (1.0, "100.00 %"), (0.99999, "99.99 %"), (0.5, "50.00 %"), (0.0, "0.00 %")],
)
def test_a_share_below_one_is_never_shown_as_all(share: float | None, text: str) -> None:
    assert percent(share) == text


def test_a_table_has_a_line_for_its_head() -> None:
    assert table(("a", "b"), [(1, "x")]) == "| a | b |\n| --- | --- |\n| 1 | x |\n"

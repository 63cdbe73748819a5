"""What a replay prints at its end: figures of the truth only where there is one, and why fixes were not confirmed."""

from __future__ import annotations

from typing import Any

from camber.validation.evaluate import headline


def summary(*, truth: bool) -> dict[str, Any]:
    def known(value: float) -> float | None:
        return value if truth else None

    return {
        "drive": "tour",
        "epochs": 901,
        "truth": truth,
        "tentative": {"fixed": 710, "wrong": known(33)},
        "confirmed": {"count": 658, "wrong": known(0)},
        "unknown": {"count": 210, "of_fixed": 19},
        "erroneous": {"count": 33},
        "right": {"kept": known(0.975)},
        "episodes": {"missed": known(0), "n": known(2)},
        "position": {"usable": 0.8657},
        "surrogates": ["map: simulated survey of a city"],
        "verdicts": {
            "by_reason": [
                {"verdict": "confirmed", "reason": "height_agrees", "count": 600},
                {"verdict": "unknown", "reason": "not_a_fix", "count": 191},
                {"verdict": "confirmed_after_verification", "reason": "height_agrees", "count": 58},
                {"verdict": "erroneous", "reason": "position_disagrees", "count": 33},
                {"verdict": "unknown", "reason": "pose_missing", "count": 11},
                {"verdict": "unknown", "reason": "starting", "count": 8},
            ]
        },
    }


def test_without_truth_verdicts_and_their_reasons_are_counted_and_nothing_is_claimed() -> None:
    assert headline(summary(truth=False)).splitlines() == [
        "tour: 901 epochs, 710 fixes",
        "confirmed 658; unknown 210, 19 of them fixes; erroneous 33",
        "not confirmed, most often: not_a_fix 191, position_disagrees 33, pose_missing 11",
        "position usable: 86.6 % of the epochs",
        "surrogate: map: simulated survey of a city",
    ]


def test_with_truth_wrong_fixes_are_counted() -> None:
    lines = headline(summary(truth=True)).splitlines()
    assert lines[:3] == [
        "tour: 901 epochs, 710 fixes, 33 of them wrong",
        "confirmed 658, wrong among them 0; unknown 210, 19 of them fixes; erroneous 33",
        "right fixes kept 97.5 %; wrong episodes missed 0 of 2",
    ]

"""Evidence from the Nagoya recording: the same fixes, and for each seed another map, other sensors, another start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.schemas.drive import load_manifest
from camber.validation.evaluation import Evaluation
from camber.validation.evidence.evaluated_drive import evaluate_drive
from camber.validation.judged_fixes import JudgedFix

BASELINES = ("ratio_test_only", "height_only", "always_unknown")


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """What a judge must keep to with the map's σ at a value: wrong epochs confirmed over 50 seeds, right ones."""

    map_sigma_m: float
    wrong_confirmed: int
    right_confirmed: float


REQUIREMENTS = (
    Requirement(map_sigma_m=0.05, wrong_confirmed=1, right_confirmed=0.985),
    Requirement(map_sigma_m=0.10, wrong_confirmed=10, right_confirmed=0.95),
)


def run_seed(manifest: Path, folder: Path, *, seed: int, map_sigma_m: float) -> dict[str, Any]:
    """One drive through one process; the figures, and each wrong epoch that was confirmed."""
    overrides = [f"surrogates.seed={seed}", f"surrogates.map_sigma_m={map_sigma_m}"]
    drive = evaluate_drive(load_manifest(manifest, overrides), folder)
    summary = drive.evaluation.summary
    return {
        "seed": seed,
        "map_sigma_m": map_sigma_m,
        "surrogates": summary["surrogates"],
        "epochs": summary["epochs"],
        "fixed": summary["tentative"]["fixed"],
        "wrong": summary["tentative"]["wrong"],
        "judges": {"camber": _figures(summary)}
        | {name: _figures(summary["controls"][name]) for name in BASELINES},
        "held_back": held_back(drive.evaluation),
        "wrong_confirmed": wrong_confirmed(drive.evaluation, drive.inputs.tick_times_ns[0]),
        "availability": summary["position"]["availability"],
    }


def _figures(table: dict[str, Any]) -> dict[str, Any]:
    return {
        "confirmed": table["confirmed"]["count"],
        "confirmed_wrong": table["confirmed"]["wrong"],
        "right": table["right"]["count"],
        "right_kept": table["right"]["kept"],
        "right_erroneous": table["right"]["erroneous"],
        "episodes": table["episodes"]["n"],
        "missed": table["episodes"]["missed"],
        "cautious": table["episodes"]["cautious"]["n"],
        "cautious_missed": table["episodes"]["cautious"]["missed"],
    }


def held_back(evaluation: Evaluation) -> dict[str, int]:
    """Right fixes that were not confirmed, by verdict and reason."""
    rows: list[JudgedFix] = [evaluation.rows[i] for i in evaluation.fix_rows[evaluation.fixes.right].tolist()]
    reasons = Counter(
        f"{row.verdict_name}: {'no verdict' if row.verdict is None else row.verdict.reason}"
        for row in rows
        if not row.confirmed
    )
    return dict(reasons.most_common())


_MEASURED = (
    "height_difference_m", "tolerance_m", "position_difference_m", "joint_distance2", "joint_limit", "correction_m",
    "trials",
)  # fmt: skip


def wrong_confirmed(evaluation: Evaluation, start_ns: int) -> list[dict[str, Any]]:
    """Each wrong position that was confirmed: its error, and what the judge measured."""
    wrong = []
    for i in np.flatnonzero(evaluation.confirmed_error_m > WRONG_M).tolist():
        row: JudgedFix = evaluation.rows[i]
        assert row.verdict is not None
        wrong.append(
            {
                "at_s": round((row.time_ns - start_ns) / 1e9, 3),
                "error_m": round(float(evaluation.confirmed_error_m[i]), 3),
                "fix_error_enu_m": evaluation.tentative_error_enu_m[i].round(3).tolist(),
                "word": row.verdict.verdict,
                "evidence": list(row.verdict.evidence),
                **{name: getattr(row.verdict, name) for name in _MEASURED},
            }
        )
    return wrong


def total(results: Sequence[dict[str, Any]], judge: str) -> dict[str, Any]:
    """The figures of one judge over all seeds; the episodes are the recording's, the same for every seed."""
    figures = [result["judges"][judge] for result in results]
    right = sum(item["right"] for item in figures)
    kept = sum(item["right"] * (item["right_kept"] or 0.0) for item in figures)
    return {
        "wrong": sum(result["wrong"] for result in results),
        "confirmed_wrong": sum(item["confirmed_wrong"] or 0 for item in figures),
        "right_kept": kept / right if right else None,
        "right_erroneous": sum(item["right_erroneous"] for item in figures),
        "episodes": max(item["episodes"] for item in figures),
        "missed": sum(item["missed"] for item in figures),
    }

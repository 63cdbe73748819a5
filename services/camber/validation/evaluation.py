"""From what was recorded and the truth to figures: pure, the same for a replay and for a drive on the
road."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.drive.recording import Recorded
from camber.replay.run_folder import DriveFacts, RunFacts
from camber.schemas.base import Float64, Int64
from camber.schemas.gnss import Fix
from camber.validation.baselines import always_unknown, height_differences_m, height_only, ratio_test_only
from camber.validation.figures import Episode, Judgement, Tentative, episodes_of, figures, some_known
from camber.validation.judged_fixes import CONFIRMED_WORDS, Judged, put_together
from camber.validation.localization_summary import Localized
from camber.validation.protection import (
    Positions,
    availability,
    coverage,
    levels_by_source,
    percentiles,
    positions_by_epoch,
    stanford,
)
from camber.validation.truth import Truth

CHANNELS = ("motion", "fix", "verdict", "position", "pose", "scan_match", "antenna_height")
"""What evaluation reads of a recording."""

_NOWHERE = (np.nan, np.nan, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The summary, and what it was made from, for the report.

    `rows` in the order of time, `tentative_error_enu_m` and `confirmed_error_m` (3D) for each, NaN where
    there is no such position or no truth; `fixes` are the rows `fix_rows`, of which `episodes` speak.
    """

    summary: dict[str, Any]
    rows: list[Judged]
    tentative_error_enu_m: Float64
    confirmed_error_m: Float64
    fixes: Tentative
    fix_rows: Int64
    episodes: list[Episode]
    positions: Positions
    localized: Localized


def evaluate(
    recorded: Mapping[str, Sequence[Recorded[Any]]],
    drive: DriveFacts,
    run: RunFacts,
    truth: Truth | None,
    *,
    damage: Sequence[str] = (),
) -> Evaluation:
    """Compute the figures of one drive.

    `recorded` has the messages by channel (`CHANNELS`; a missing one counts as empty); `damage` says what of
    the recording could not be read and is passed on. Without truth, everything that rests on it is None.
    """
    rows = put_together(recorded.get("fix", ()), recorded.get("verdict", ()))
    tentative_error_m, confirmed_error_m = _errors(rows, truth, drive.offset_enu_m)
    fix_rows, judgement = _camber(rows, confirmed_error_m)
    fixes = Tentative(
        time_ns=np.array([rows[i].time_ns for i in fix_rows.tolist()], dtype=np.int64),
        error_m=np.linalg.norm(tentative_error_m[fix_rows], axis=1),
    )
    positions = positions_by_epoch(
        recorded.get("position", ()), truth, drive.offset_enu_m, drive.alert_limit_m
    )
    localized = Localized.of(recorded)
    epochs = _epoch_times(recorded.get("motion", ()), positions)
    known = truth is not None
    summary = {
        "drive": drive.drive,
        "surrogates": list(drive.surrogates),
        "truth": known,
        "epochs": len(epochs),
        "duration_s": float(epochs[-1] - epochs[0]) / 1e9 if len(epochs) else None,
        "tentative": {
            "fixed": len(fix_rows),
            "wrong": int(fixes.wrong.sum()) if known and some_known(fixes.error_m) else None,
            "truth_unknown": int(np.isnan(fixes.error_m).sum()),
        },
        **figures(fixes, judgement, truth=known),
        "controls": _controls(rows, fix_rows, fixes, recorded, drive.fixed_tolerance_m, known),
        "position": {
            "availability": availability(positions, epochs),
            "alert_limit_m": _alert_limit_m(positions, drive),
            "error_m": percentiles(positions.horizontal_error_m, {"p50": 0.5, "p95": 0.95, "p999": 0.999}),
        },
        "coverage": coverage(positions) if known else None,
        "stanford": stanford(positions) if known else None,
        "levels": levels_by_source(positions) if known else None,
        "verdicts": _verdicts(rows),
        "localizer": localized.summary(),
        "latency_ms": percentiles(_latencies_ms(rows), {"p50": 0.5, "p99": 0.99}),
        "speed_factor": run.speed_factor,
        "wall_s": run.wall_s,
        "notes": list(run.notes),
        "damage": list(damage),
    }
    return Evaluation(
        summary=summary,
        rows=rows,
        tentative_error_enu_m=tentative_error_m,
        confirmed_error_m=confirmed_error_m,
        fixes=fixes,
        fix_rows=fix_rows,
        episodes=episodes_of(fixes, judgement),
        positions=positions,
        localized=localized,
    )


def _errors(
    rows: Sequence[Judged], truth: Truth | None, offset_enu_m: tuple[float, float, float]
) -> tuple[Float64, Float64]:
    """Errors of the tentative fixes, east, north, up (n, 3), and of the confirmed positions, 3D (n,)."""
    fixed_error_m = np.full((len(rows), 3), np.nan)
    confirmed_error_m = np.full(len(rows), np.nan)
    if truth is None or not rows:
        return fixed_error_m, confirmed_error_m
    time_ns = np.array([row.time_ns for row in rows], dtype=np.int64)
    fixed = np.array([_point(row.fix if row.tentative else None) for row in rows])
    confirmed = np.array([row.confirmed_position or _NOWHERE for row in rows])
    fixed_error_m = truth.error_enu_m(time_ns, fixed[:, 0], fixed[:, 1], fixed[:, 2], offset_enu_m)
    enu_m = truth.error_enu_m(time_ns, confirmed[:, 0], confirmed[:, 1], confirmed[:, 2], offset_enu_m)
    return fixed_error_m, np.linalg.norm(enu_m, axis=1)


def _point(fix: Fix | None) -> tuple[float, float, float]:
    return _NOWHERE if fix is None else (fix.latitude_rad, fix.longitude_rad, fix.height_m)


def _camber(rows: Sequence[Judged], confirmed_error_m: Float64) -> tuple[Int64, Judgement]:
    """Rows of the tentative fixes, each once, and what Camber said of them.

    Where a fix has several verdicts, it is confirmed if any confirmed it (consumers had that one), else the
    last counts.
    """
    words: dict[tuple[int, int], str] = {}
    row_of: dict[tuple[int, int], int] = {}
    for i, row in enumerate(rows):
        if row.fix is not None and row.tentative:
            key = (row.fix.fix_id, row.fix.time_ns)
            row_of.setdefault(key, i)
            if row.confirmed or words.get(key) not in CONFIRMED_WORDS:
                words[key] = row.word
    confirmed = np.array([words[key] in CONFIRMED_WORDS for key in row_of], dtype=bool)
    erroneous = np.array([words[key] == "erroneous" for key in row_of], dtype=bool)
    confirmed_rows = np.array([i for i, row in enumerate(rows) if row.confirmed], dtype=np.int64)
    return np.array(list(row_of.values()), dtype=np.int64), Judgement(
        confirmed=confirmed,
        erroneous=erroneous,
        unknown=~(confirmed | erroneous),
        unknown_count=sum(row.word == "unknown" for row in rows),
        confirmed_time_ns=np.array([rows[i].time_ns for i in confirmed_rows.tolist()], dtype=np.int64),
        confirmed_error_m=confirmed_error_m[confirmed_rows],
    )


def _controls(
    rows: Sequence[Judged],
    fix_rows: Int64,
    fixes: Tentative,
    recorded: Mapping[str, Sequence[Recorded[Any]]],
    tolerance_m: float,
    truth: bool,
) -> dict[str, Any]:
    messages = [fix for i in fix_rows.tolist() if (fix := rows[i].fix) is not None]
    difference_m = height_differences_m(
        messages, recorded.get("pose", ()), recorded.get("antenna_height", ())
    )
    return {
        "ratio_test_only": figures(fixes, ratio_test_only(fixes), truth=truth),
        "height_only": {
            "tolerance_m": tolerance_m,
            **figures(fixes, height_only(fixes, difference_m, tolerance_m), truth=truth),
        },
        "always_unknown": figures(fixes, always_unknown(fixes), truth=truth),
    }


def _epoch_times(motion: Sequence[Recorded[Any]], positions: Positions) -> Int64:
    """The epoch grid: the distinct times of motion, or of positions where the drive has no motion."""
    times = np.array([item.message.time_ns for item in motion], dtype=np.int64)
    return np.unique(times) if len(times) else positions.time_ns


def _alert_limit_m(positions: Positions, drive: DriveFacts) -> float | None:
    limits = np.unique(positions.alert_limit_m)
    return drive.alert_limit_m or (float(limits[0]) if len(limits) == 1 else None)


def _verdicts(rows: Sequence[Judged]) -> dict[str, Any]:
    said = [row.verdict for row in rows if row.verdict is not None]
    judged = [
        (row.fix.fix_id, row.fix.time_ns) for row in rows if row.fix is not None and row.verdict is not None
    ]
    by_reason = Counter((verdict.verdict, verdict.reason) for verdict in said)
    return {
        "count": len(said),
        "by_reason": [
            {"verdict": word, "reason": reason, "count": count}
            for (word, reason), count in sorted(by_reason.items(), key=lambda item: (-item[1], item[0]))
        ],
        "fixes_without_verdict": sum(row.verdict is None for row in rows),
        "repeated": len(judged) - len(set(judged)),
    }


def _latencies_ms(rows: Sequence[Judged]) -> Float64:
    """From the arrival of a fix at the recorder to that of its verdict."""
    return np.array(
        [
            (row.verdict_arrival_ns - row.fix_arrival_ns) / 1e6
            for row in rows
            if row.verdict_arrival_ns is not None and row.fix_arrival_ns is not None
        ],
        dtype=np.float64,
    )

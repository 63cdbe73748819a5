"""Statistics of a recorded or replayed drive against its truth."""

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
from camber.schemas.integrity import CONFIRMED_VERDICTS
from camber.validation.baselines import baseline_decisions, height_differences_m
from camber.validation.fix_statistics import (
    CandidateFixes,
    Episode,
    FixDecisions,
    decision_statistics,
    episodes_of,
    is_evaluable,
)
from camber.validation.judged_fixes import JudgedFix, pair_fixes_with_verdicts
from camber.validation.localization_columns import LocalizerRecord
from camber.validation.protection_level_statistics import (
    Positions,
    availability,
    coverage,
    percentiles,
    positions_by_epoch,
    usable_share,
)
from camber.validation.reference_trajectory import ReferenceTrajectory
from camber.validation.stanford_chart import levels_by_source, stanford

CHANNELS = ("motion", "fix", "verdict", "position", "pose", "scan_match", "antenna_height")
"""Channels of a recording that are evaluated."""

_NOWHERE = (np.nan, np.nan, np.nan)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Evaluation:
    """The summary, and the data behind it for the report.

    `rows` in the order of time, with `tentative_error_enu_m` and `confirmed_error_m` (3D), NaN without such a position
    or without truth; `fixes` and `episodes` are of the rows `fix_rows`; `epochs_ns` are the times of all epochs.
    """

    summary: dict[str, Any]
    rows: list[JudgedFix]
    tentative_error_enu_m: Float64
    confirmed_error_m: Float64
    fixes: CandidateFixes
    fix_rows: Int64
    episodes: list[Episode]
    positions: Positions
    localizer_record: LocalizerRecord
    epochs_ns: Int64


def evaluate(
    recorded: Mapping[str, Sequence[Recorded[Any]]],
    drive: DriveFacts,
    run: RunFacts,
    truth: ReferenceTrajectory | None,
    *,
    damage: Sequence[str] = (),
) -> Evaluation:
    """Return the statistics of one drive.

    `recorded` has the messages by channel (`CHANNELS`; a missing one counts as empty); `damage` lists what could not be
    read of the recording. Without truth, everything that needs it is None.
    """
    rows = pair_fixes_with_verdicts(recorded.get("fix", ()), recorded.get("verdict", ()))
    tentative_error_m, confirmed_error_m = _errors(rows, truth, drive.offset_enu_m)
    fix_rows, decisions = _decisions(rows, confirmed_error_m)
    fixes = CandidateFixes(
        time_ns=np.array([rows[i].time_ns for i in fix_rows.tolist()], dtype=np.int64),
        error_m=np.linalg.norm(tentative_error_m[fix_rows], axis=1),
    )
    positions = positions_by_epoch(
        recorded.get("position", ()), truth, drive.offset_enu_m, drive.alert_limit_m
    )
    localizer_record = LocalizerRecord.from_recording(recorded)
    motion_ns = np.unique([item.message.time_ns for item in recorded.get("motion", ())]).astype(np.int64)
    epochs = motion_ns if len(motion_ns) else positions.time_ns
    known = truth is not None
    summary = {
        "drive": drive.drive,
        "surrogates": list(drive.surrogates),
        "truth": known,
        "epochs": len(epochs),
        "duration_s": float(epochs[-1] - epochs[0]) / 1e9 if len(epochs) else None,
        "tentative": {
            "fixed": len(fix_rows),
            "wrong": int(fixes.wrong.sum()) if known and is_evaluable(fixes.error_m) else None,
            "truth_unknown": int(np.isnan(fixes.error_m).sum()),
        },
        **decision_statistics(fixes, decisions, truth=known),
        "controls": _baselines(
            fixes,
            [fix for i in fix_rows.tolist() if (fix := rows[i].fix) is not None],
            recorded,
            tolerance_m=drive.fixed_tolerance_m,
            truth=known,
        ),
        "position": {
            "availability": availability(positions, epochs),
            "usable": usable_share(positions, epochs),
            "horizontal_reference": _horizontal_references(recorded),
            "alert_limit_m": _alert_limit_m(positions, drive),
            "error_m": percentiles(positions.horizontal_error_m, {"p50": 0.5, "p95": 0.95, "p999": 0.999}),
        },
        "coverage": coverage(positions) if known else None,
        "stanford": stanford(positions) if known else None,
        "levels": levels_by_source(positions) if known else None,
        "verdicts": _verdicts(rows),
        "localizer": localizer_record.summary(),
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
        episodes=episodes_of(fixes, decisions),
        positions=positions,
        localizer_record=localizer_record,
        epochs_ns=epochs,
    )


def _errors(
    rows: Sequence[JudgedFix], truth: ReferenceTrajectory | None, offset_enu_m: tuple[float, float, float]
) -> tuple[Float64, Float64]:
    """Errors east, north, up of the candidate fixes (n, 3), and 3D errors of the confirmed positions (n,)."""
    fixed_error_m = np.full((len(rows), 3), np.nan)
    confirmed_error_m = np.full(len(rows), np.nan)
    if truth is None or not rows:
        return fixed_error_m, confirmed_error_m
    time_ns = np.array([row.time_ns for row in rows], dtype=np.int64)
    fixed = np.array([_point(row.fix if row.tentative else None) for row in rows])
    confirmed = np.array([row.confirmed_position or _NOWHERE for row in rows])
    fixed_error_m = truth.error_enu_m(time_ns, *fixed.T, offset_enu_m=offset_enu_m)
    enu_m = truth.error_enu_m(time_ns, *confirmed.T, offset_enu_m=offset_enu_m)
    return fixed_error_m, np.linalg.norm(enu_m, axis=1)


def _point(fix: Fix | None) -> tuple[float, float, float]:
    return _NOWHERE if fix is None else (fix.latitude_rad, fix.longitude_rad, fix.height_m)


def _decisions(rows: Sequence[JudgedFix], confirmed_error_m: Float64) -> tuple[Int64, FixDecisions]:
    """Rows of the candidate fixes, each once, and Camber's decisions on them.

    A fix with several verdicts is confirmed if any of them confirmed it (consumers had that one), else the last counts.
    """
    verdicts: dict[tuple[int, int], str] = {}
    row_of: dict[tuple[int, int], int] = {}
    for i, row in enumerate(rows):
        if row.fix is not None and row.tentative:
            key = (row.fix.fix_id, row.fix.time_ns)
            row_of.setdefault(key, i)
            if row.confirmed or verdicts.get(key) not in CONFIRMED_VERDICTS:
                verdicts[key] = row.verdict_name
    confirmed = np.array([verdicts[key] in CONFIRMED_VERDICTS for key in row_of], dtype=bool)
    erroneous = np.array([verdicts[key] == "erroneous" for key in row_of], dtype=bool)
    confirmed_rows = np.array([i for i, row in enumerate(rows) if row.confirmed], dtype=np.int64)
    return np.array(list(row_of.values()), dtype=np.int64), FixDecisions(
        confirmed=confirmed,
        erroneous=erroneous,
        unknown=~(confirmed | erroneous),
        unknown_count=sum(row.verdict_name == "unknown" for row in rows),
        confirmed_time_ns=np.array([rows[i].time_ns for i in confirmed_rows.tolist()], dtype=np.int64),
        confirmed_error_m=confirmed_error_m[confirmed_rows],
    )


def _baselines(
    fixes: CandidateFixes,
    messages: Sequence[Fix],
    recorded: Mapping[str, Sequence[Recorded[Any]]],
    *,
    tolerance_m: float,
    truth: bool,
) -> dict[str, Any]:
    difference_m = height_differences_m(
        messages, recorded.get("pose", ()), recorded.get("antenna_height", ())
    )
    decisions = baseline_decisions(fixes, difference_m, tolerance_m)
    figures = {name: decision_statistics(fixes, each, truth=truth) for name, each in decisions.items()}
    figures["height_only"] = {"tolerance_m": tolerance_m, **figures["height_only"]}
    return figures


def _horizontal_references(recorded: Mapping[str, Sequence[Recorded[Any]]]) -> list[str]:
    """The judge's settings that the positions name; one where it was not changed."""
    return sorted({item.message.horizontal_reference for item in recorded.get("position", ())})


def _alert_limit_m(positions: Positions, drive: DriveFacts) -> float | None:
    limits = np.unique(positions.alert_limit_m)
    return drive.alert_limit_m or (float(limits[0]) if len(limits) == 1 else None)


def _verdicts(rows: Sequence[JudgedFix]) -> dict[str, Any]:
    verdicts = [row.verdict for row in rows if row.verdict is not None]
    judged = [
        (row.fix.fix_id, row.fix.time_ns) for row in rows if row.fix is not None and row.verdict is not None
    ]
    by_reason = Counter((verdict.verdict, verdict.reason) for verdict in verdicts)
    return {
        "count": len(verdicts),
        "by_reason": [
            {"verdict": name, "reason": reason, "count": count}
            for (name, reason), count in sorted(by_reason.items(), key=lambda item: (-item[1], item[0]))
        ],
        "fixes_without_verdict": sum(row.verdict is None for row in rows),
        "repeated": len(judged) - len(set(judged)),
    }


def _latencies_ms(rows: Sequence[JudgedFix]) -> Float64:
    """Time from the arrival of a fix at the recorder to that of its verdict."""
    return np.array(
        [
            (row.verdict_arrival_ns - row.fix_arrival_ns) / 1e6
            for row in rows
            if row.verdict_arrival_ns is not None and row.fix_arrival_ns is not None
        ],
        dtype=np.float64,
    )

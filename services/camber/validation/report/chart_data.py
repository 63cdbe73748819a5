"""Data of the charts of report.html, as JSON that can be embedded in the page."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Float64, Int64
from camber.validation.evaluation import Evaluation
from camber.validation.fix_statistics import RIGHT_M
from camber.validation.judged_fixes import CONFIRMED_VERDICTS
from camber.validation.localization_summary import LocalizerRecord


def start_ns_of(evaluation: Evaluation) -> int:
    """GPS time that the report counts from."""
    firsts = [row.time_ns for row in evaluation.rows[:1]] + evaluation.positions.time_ns[:1].tolist()
    return min(firsts or evaluation.localizer_record.poses.time_ns[:1].tolist(), default=0)


def chart_data(evaluation: Evaluation) -> dict[str, Any]:
    """Columns for the page's script: seconds since the start, metres in a common plane, None where unknown."""
    rows, positions, summary = evaluation.rows, evaluation.positions, evaluation.summary
    start_ns = start_ns_of(evaluation)
    times_ns = np.array([row.time_ns for row in rows], dtype=np.int64)
    latitude, longitude, height = _row_positions(evaluation, times_ns)
    frame = _frame(latitude, longitude, height)
    row_plane, position_plane = (
        _plane(frame, latitude, longitude, height),
        _plane(frame, positions.latitude_rad, positions.longitude_rad, positions.height_m),
    )
    verdict_names = [*CONFIRMED_VERDICTS, "erroneous", "unknown", "no_verdict"]
    reasons = sorted({row.verdict.reason for row in rows if row.verdict is not None})
    sources = sorted(set(positions.source.tolist()))
    verdicts = [row.verdict for row in rows]
    ends = [start_ns, *times_ns[-1:].tolist(), *positions.time_ns[-1:].tolist()]
    return {
        "truth": summary["truth"],
        "wrong_m": WRONG_M,
        "right_m": RIGHT_M,
        "alert_limit_m": summary["position"]["alert_limit_m"],
        "stanford": summary["stanford"],
        "duration_s": (max(ends) - start_ns) / 1e9,
        "verdict_names": verdict_names,
        "reasons": reasons,
        "sources": sources,
        "rows": {
            "t": _column((times_ns - start_ns) / 1e9),
            "e": _column(row_plane[:, 0], 2),
            "n": _column(row_plane[:, 1], 2),
            "verdict": [verdict_names.index(row.verdict_name) for row in rows],
            "reason": [-1 if v is None else reasons.index(v.reason) for v in verdicts],
            "difference": _column(
                _optional([None if v is None else v.height_difference_m for v in verdicts])
            ),
            "tolerance": _column(_optional([None if v is None else v.tolerance_m for v in verdicts])),
            "error": _column(np.linalg.norm(evaluation.tentative_error_enu_m, axis=1)),
            "confirmed_error": _column(evaluation.confirmed_error_m),
        },
        "positions": {
            "t": _column((positions.time_ns - start_ns) / 1e9),
            "e": _column(position_plane[:, 0], 2),
            "n": _column(position_plane[:, 1], 2),
            "de": _column(positions.error_enu_m[:, 0], 2),
            "dn": _column(positions.error_enu_m[:, 1], 2),
            "source": [sources.index(source) for source in positions.source.tolist()],
            "error": _column(positions.horizontal_error_m),
            "radius": _column(positions.semi_major_999_m),
            "hpl": _column(positions.hpl_m),
        },
        "localizer": _localizer(evaluation.localizer_record, start_ns),
    }


def _localizer(localizer: LocalizerRecord, start_ns: int) -> dict[str, Any]:
    matches = localizer.matches
    return {
        "t": _column((matches.time_ns - start_ns) / 1e9),
        "layers": [_column(column) for column in matches.layer_mean_distance_m.T],
        "heights": {
            method: {"t": _column((time_ns - start_ns) / 1e9), "h": _column(height_m)}
            for method, (time_ns, height_m) in localizer.heights.items()
        },
    }


def _row_positions(evaluation: Evaluation, times_ns: Int64) -> tuple[Float64, Float64, Float64]:
    """Position of each row on the track: the candidate fix, else the published position of that epoch."""
    positions = evaluation.positions
    columns = (positions.latitude_rad, positions.longitude_rad, positions.height_m)
    position = np.full((len(times_ns), 3), np.nan)
    if len(positions.time_ns):
        at = np.searchsorted(positions.time_ns, times_ns).clip(0, len(positions.time_ns) - 1)
        same = positions.time_ns[at] == times_ns
        position[same] = np.column_stack(columns)[at[same]]
    for i, row in enumerate(evaluation.rows):
        fix = row.fix
        if fix is not None and (row.tentative or np.isnan(position[i, 0])):
            position[i] = fix.latitude_rad, fix.longitude_rad, fix.height_m
    return position[:, 0], position[:, 1], position[:, 2]


def _frame(latitude_rad: Float64, longitude_rad: Float64, height_m: Float64) -> LocalFrame | None:
    known = np.flatnonzero(np.isfinite(latitude_rad) & np.isfinite(longitude_rad) & np.isfinite(height_m))
    if not len(known):
        return None
    first = known[0]
    return LocalFrame(float(latitude_rad[first]), float(longitude_rad[first]), float(height_m[first]))


def _plane(
    frame: LocalFrame | None, latitude_rad: Float64, longitude_rad: Float64, height_m: Float64
) -> Float64:
    plane = np.full((len(latitude_rad), 2), np.nan)
    known = np.isfinite(latitude_rad) & np.isfinite(longitude_rad) & np.isfinite(height_m)
    if frame is not None and known.any():
        plane[known] = frame.east_north_from_geodetic_array(
            latitude_rad[known], longitude_rad[known], height_m[known]
        )
    return plane


def _optional(values: list[float | None]) -> Float64:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _column(values: Float64, decimals: int = 3) -> list[float | None]:
    return [None if value != value else value for value in np.round(values, decimals).tolist()]


def embedded_json(data: dict[str, Any]) -> str:
    """JSON that cannot end the script element around it."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")

"""Data of the charts of report.html, as JSON that can be embedded in the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Float64, Int64
from camber.validation.evaluation import Evaluation
from camber.validation.fix_statistics import RIGHT_M
from camber.validation.judged_fixes import CONFIRMED_VERDICTS
from camber.validation.localization_columns import LocalizerRecord


def start_ns_of(evaluation: Evaluation) -> int:
    """GPS time that the report counts from."""
    firsts = [row.time_ns for row in evaluation.rows[:1]] + evaluation.positions.time_ns[:1].tolist()
    return min(firsts or evaluation.localizer_record.poses.time_ns[:1].tolist(), default=0)


def chart_data(evaluation: Evaluation) -> dict[str, Any]:
    """Columns for the page's script: seconds since the start, metres in a common plane, None where unknown."""
    rows, positions, summary = evaluation.rows, evaluation.positions, evaluation.summary
    start_ns = start_ns_of(evaluation)
    times_ns = np.array([row.time_ns for row in rows], dtype=np.int64)
    published = np.column_stack((positions.latitude_rad, positions.longitude_rad, positions.height_m))
    places = _row_places(evaluation, times_ns, published)
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    frame = LocalFrame(*places[known[0]].tolist()) if len(known) else None
    row_plane, position_plane = _plane(frame, places), _plane(frame, published)
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
            "difference": _column([None if v is None else v.height_difference_m for v in verdicts]),
            "tolerance": _column([None if v is None else v.tolerance_m for v in verdicts]),
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


def _row_places(evaluation: Evaluation, times_ns: Int64, published: Float64) -> Float64:
    """Place (n, 3) of each row on the track: the candidate fix, else the published position of that epoch."""
    position_ns, places = evaluation.positions.time_ns, np.full((len(times_ns), 3), np.nan)
    if len(position_ns):
        at = np.searchsorted(position_ns, times_ns).clip(0, len(position_ns) - 1)
        same = position_ns[at] == times_ns
        places[same] = published[at[same]]
    for i, row in enumerate(evaluation.rows):
        fix = row.fix
        if fix is not None and (row.tentative or np.isnan(places[i, 0])):
            places[i] = fix.latitude_rad, fix.longitude_rad, fix.height_m
    return places


def _plane(frame: LocalFrame | None, places: Float64) -> Float64:
    """East and north (n, 2) of latitudes, longitudes, heights (n, 3); NaN where one of them is."""
    plane = np.full((len(places), 2), np.nan)
    known = np.isfinite(places).all(axis=1)
    if frame is not None and known.any():
        plane[known] = frame.east_north_from_geodetic_array(*places[known].T)
    return plane


def _column(values: Float64 | Sequence[float | None], decimals: int = 3) -> list[float | None]:
    rounded = np.round(np.array(values, np.float64), decimals).tolist()
    return [None if value != value else value for value in rounded]


def embedded_json(data: dict[str, Any]) -> str:
    """JSON that cannot end the script element around it."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")

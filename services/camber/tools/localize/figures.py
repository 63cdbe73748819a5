"""The summary of `camber localize`: a paragraph of figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from camber.formats.observations import Floats
from camber.tools.gnss.recording_summary import time_text
from camber.tools.localize.localizer_run import LocalizedDrive
from camber.validation.localization_columns import MatchColumns, Names, PoseColumns, PoseErrors


def drive_summary(
    name: str,
    drive: LocalizedDrive,
    *,
    poses: PoseColumns,
    matches: MatchColumns,
    errors: PoseErrors | None,
    surrogates: Sequence[str],
) -> str:
    """Return the summary; `surrogates` describe inputs that a vehicle would not have."""
    parts = [
        f"{name}: {len(poses.time_ns):,} poses from {time_text(int(poses.time_ns[0]))} GPS time: "
        f"{_shares(poses.mode)}.",
        "".join(f"Surrogate: {line}. " for line in surrogates).strip(),
        f"{len(matches.time_ns):,} scan matches: {_shares(matches.status)}." if len(matches.time_ns) else "",
        _why(drive),
        _layers(matches),
        _sweep_times(drive.sweep_s),
        "" if errors is None else _accuracy(errors),
        f"Issues: {_counted(drive.tally.issues)}." if drive.tally.issues else "",
    ]
    return " ".join(part for part in parts if part)


def _shares(values: Names) -> str:
    counts = Counter(values.tolist()).most_common()
    return ", ".join(f"{n:,} {value.replace('_', ' ')} ({n / len(values):.1%})" for value, n in counts)


def _why(drive: LocalizedDrive) -> str:
    others = (match for match in drive.matches if match.status != "converged")
    reasons = Counter(f"{match.status}: {match.reason}" for match in others)
    return f"Not converged: {_counted(reasons)}." if reasons else ""


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in counts.most_common(8))


def _layers(matches: MatchColumns) -> str:
    distance_m = matches.layer_mean_distance_m
    known = [column[np.isfinite(column)] for column in distance_m.T]
    if not any(column.size for column in known):
        return ""
    texts = ["–" if not column.size else f"{np.median(column):.3f}" for column in known]
    return f"Mean distance by layer from the lowest up, median: {', '.join(texts)} m."


def _sweep_times(sweep_s: Sequence[float]) -> str:
    """The first sweeps build the map's structures and load compiled code: the largest says so."""
    if not sweep_s:
        return ""
    p50, p95 = np.quantile(sweep_s, (0.5, 0.95)) * 1e3
    return f"A sweep took {p50:.0f} ms (p50), {p95:.0f} ms (p95), {max(sweep_s) * 1e3:.0f} ms (largest)."


def _accuracy(errors: PoseErrors) -> str:
    horizontal_m = errors.horizontal_m
    known = np.isfinite(horizontal_m)
    if not known.any():
        return "No pose has a truth beside it."
    inside = errors.share_of_ellipse[known] <= 1.0
    parts = [
        f"Against the truth at {int(known.sum()):,} poses: horizontal p50 {_quantile(horizontal_m, 0.5)} m, "
        f"p95 {_quantile(horizontal_m, 0.95)} m, largest {_quantile(horizontal_m, 1.0)} m",
        f"across p95 {_quantile(errors.cross_m, 0.95)} m, along p95 {_quantile(errors.along_m, 0.95)} m",
        f"heading p95 {_quantile(np.degrees(errors.yaw_rad), 0.95, '.2f')}°",
        f"{inside.mean():.1%} inside the 99 % ellipse",
    ]
    level = errors.level[np.isfinite(errors.level)]
    if level.size:
        wrong = int((level == 0.0).sum())
        parts.append(f"level right at {level.size - wrong:,} of {level.size:,}")
    if np.isfinite(errors.elevation_m).any():
        parts.append(f"road's elevation p95 {_quantile(errors.elevation_m, 0.95)} m")
    return "; ".join(parts) + "."


def _quantile(values: Floats, share: float, form: str = ".3f") -> str:
    """Of the absolute values that are known."""
    known = np.abs(values[np.isfinite(values)])
    return "–" if not known.size else format(float(np.quantile(known, share)), form)

"""What `camber localize` says of a drive: poses.csv and matches.csv, one row each, and a paragraph of figures.

Cells are empty where there is nothing to say. Times are GPS time in nanoseconds; the place of a pose is the antenna's,
that of a match the sensor's. Ages count back from the pose. Along and across are those of the truth's heading.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from camber.formats.observations import Floats
from camber.schemas.pose import Pose, ScanMatch
from camber.tools.gnss.recording_summary import time_text
from camber.tools.localize.localizer_run import LocalizedDrive
from camber.validation.localization_columns import MatchColumns, Names, PoseColumns, PoseErrors

_POSES = (
    "time_ns", "mode", "provenance", "latitude_deg", "longitude_deg", "yaw_deg", "covariance_ee_m2", "covariance_en_m2",
    "covariance_nn_m2", "sigma_yaw_deg", "roll_deg", "pitch_deg", "speed_m_s", "link_id", "road_status", "surface_id",
    "level", "elevation_m", "elevation_sigma_m", "anchor_age_s", "motion_age_s", "match_age_s", "error_along_m",
    "error_cross_m", "error_yaw_deg", "error_elevation_m", "reason",
)  # fmt: skip
_MATCHES = (
    "time_ns", "status", "reason", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "yaw_deg",
    "covariance_ee_m2", "covariance_en_m2", "covariance_nn_m2", "overlap", "sensor_height_m", "sensor_height_sigma_m",
    "ground_height_m", "ground_height_sigma_m", "road_slope_forward", "road_slope_left",
)  # fmt: skip


def poses_csv(poses: Sequence[Pose], errors: PoseErrors | None) -> str:
    """A row for each pose; errors are empty without truth."""
    return _csv(_POSES, (_pose(pose, errors, row) for row, pose in enumerate(poses)))


def matches_csv(matches: Sequence[ScanMatch]) -> str:
    """A row for each match; a column for each layer's mean distance, from the lowest up."""
    layers = max((match.layers for match in matches), default=0)
    columns = (*_MATCHES, *(f"layer_{number}_mean_distance_m" for number in range(1, layers + 1)))
    return _csv(columns, (_match(match, layers) for match in matches))


def _csv(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def _pose(pose: Pose, errors: PoseErrors | None, row: int) -> list[str]:
    covariance, road = pose.covariance_east_north_yaw, pose.road
    ee, en, _, nn, _, yy = covariance or (None,) * 6
    along_m = cross_m = yaw_rad = elevation_m = None
    if errors is not None:
        columns = (errors.along_m, errors.cross_m, errors.yaw_rad, errors.elevation_m)
        along_m, cross_m, yaw_rad, elevation_m = (float(column[row]) for column in columns)
    return [
        str(pose.time_ns),
        pose.mode,
        pose.provenance,
        _degrees(pose.latitude_rad, 10),
        _degrees(pose.longitude_rad, 10),
        _degrees(pose.yaw_rad),
        *(_number(value, ".6g") for value in (ee, en, nn)),
        *map(_degrees, (None if yy is None else math.sqrt(yy), pose.roll_rad, pose.pitch_rad)),
        _number(pose.speed_m_s),
        _whole(pose.link_id),
        road.status if road.status == "known" else road.reason,
        *map(_whole, (road.surface_id, road.level)),
        *map(_number, (road.elevation_m, road.sigma_m)),
        *(_age(pose, then_ns) for then_ns in (pose.anchor_time_ns, pose.motion_time_ns, pose.match_time_ns)),
        *map(_number, (along_m, cross_m)),
        _degrees(yaw_rad),
        _number(elevation_m),
        pose.reason,
    ]


def _match(match: ScanMatch, layers: int) -> list[str]:
    heights = (
        "overlap",
        "sensor_height_m",
        "sensor_height_sigma_m",
        "ground_height_m",
        "ground_height_sigma_m",
    )
    return [
        str(match.time_ns),
        match.status,
        match.reason,
        _degrees(match.latitude_rad, 10),
        _degrees(match.longitude_rad, 10),
        _number(match.height_m),
        *map(_degrees, match.roll_pitch_yaw_rad or (None,) * 3),
        *(_number(value, ".6g") for value in match.covariance_east_north or (None,) * 3),
        *(_number(getattr(match, name)) for name in heights),
        *(_number(slope, ".6f") for slope in (match.road_slope_forward, match.road_slope_left)),
        *map(_number, match.distances_m(layers).tolist()),
    ]


def _age(pose: Pose, then_ns: int | None) -> str:
    return "" if then_ns is None else f"{(pose.time_ns - then_ns) * 1e-9:.3f}"


def _whole(value: int | None) -> str:
    return "" if value is None else str(value)


def _number(value: float | None, form: str = ".4f") -> str:
    return "" if value is None or math.isnan(value) else format(value, form)


def _degrees(angle_rad: float | None, decimals: int = 5) -> str:
    return "" if angle_rad is None else _number(math.degrees(angle_rad), f".{decimals}f")


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

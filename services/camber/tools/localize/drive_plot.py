"""The plot of `camber localize`: the trajectory on the map, and below it errors, layers' distances and overlap."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from camber.formats.drive.truth_csv import TruthTable
from camber.formats.observations import Floats, Integers
from camber.geodesy.covariance import error_ellipse
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.tools.gnss.recording_summary import time_text
from camber.tools.localize.map_drawing import draw_map
from camber.validation import plots
from camber.validation.localization_columns import INSIDE_PROBABILITY, MatchColumns, PoseColumns, PoseErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MODES = {
    "none": plots.PALE,
    "provisional": plots.AMBER,
    "dead_reckoning": plots.ORANGE,
    "anchored": plots.GREEN,
    "scan_match": plots.PRIMARY,
}
"""In drawing order: the most important mode last."""
STATUS = {"lost": plots.RED, "ambiguous": plots.AMBER, "converged": plots.PRIMARY}
_LAYERS = (plots.PRIMARY, plots.GREEN, plots.AMBER, plots.ORANGE, plots.PURPLE, plots.RED)
_ELLIPSES = 40  # chosen: more of them overlap on a page
_LARGE_QUANTILE, _LARGE_ELLIPSE_SHARE = 0.95, 0.1
"""A large ellipse (this quantile of their radii) is enlarged to at most this share of the track's size; by eye."""
_ERROR_LIMITS_M = (1e-3, 1e2)  # of the panel of errors: from what the tables resolve to a lost pose


def drive_figure(
    name: str,
    *,
    poses: PoseColumns,
    matches: MatchColumns,
    errors: PoseErrors | None,
    truth: TruthTable | None,
    release: Release,
) -> Figure:
    """Figure of a drive with at least one pose that has a position. Raises ReleaseError."""
    known = np.isfinite(poses.latitude_rad)
    first = int(np.argmax(known))
    frame = LocalFrame(float(poses.latitude_rad[first]), float(poses.longitude_rad[first]), 0.0)
    position_m = _plane(frame, poses.latitude_rad, poses.longitude_rad)
    scale = _ellipse_scale(poses, position_m)
    counts = Counter(poses.mode.tolist())
    with plots.plot_style():
        figure, track, strips = plots.track_and_strips(name, 4)
        plots.equal_limits(track, position_m[known])
        plots.draw_scale_and_north(track)
        enlarged = "" if scale == 1.0 else f", drawn {scale:g} times as large"
        track.set_title(f"north over east of the first position [m]; 99 % ellipses{enlarged}")
        plots.draw_key(
            track, {f"{counts[mode]:,} {mode}": colour for mode, colour in MODES.items() if counts[mode]}
        )
        draw_map(track, release, frame)
        if truth is not None:
            track.plot(*_plane(frame, truth.latitude_rad, truth.longitude_rad).T, color=plots.INK, lw=0.8)
        plots.draw_lines(track, _ellipses(poses, position_m, scale), plots.GREY, 0.7)
        plots.draw_dots(track, position_m[:, 0], position_m[:, 1], classes=poses.mode, colours=MODES)
        _draw_position(strips[0], poses, errors)
        _draw_heading(strips[1], poses, errors)
        _draw_layers(strips[2], poses, matches)
        _draw_overlap(strips[3], poses, matches)
        strips[3].set_xlim(0.0, max(float((poses.time_ns[-1] - poses.time_ns[0]) * 1e-9), 1.0))
        strips[3].set_xlabel(f"seconds since {time_text(int(poses.time_ns[0]))} GPS time")
    return figure


def _draw_position(axes: Axes, poses: PoseColumns, errors: PoseErrors | None) -> None:
    title = "99 % radius (line)" if errors is None else "horizontal error, and the 99 % radius as a line"
    axes.set_title(f"{title} [m]")
    plots.use_log_scale(axes.yaxis, *_ERROR_LIMITS_M)
    since_s = _since_s(poses.time_ns, poses)
    axes.plot(since_s, np.clip(poses.radius_m, *_ERROR_LIMITS_M), color=plots.GREY)
    if errors is not None:
        horizontal_m = np.clip(errors.horizontal_m, *_ERROR_LIMITS_M)
        plots.draw_dots(axes, since_s, horizontal_m, classes=poses.mode, colours=MODES)


def _draw_heading(axes: Axes, poses: PoseColumns, errors: PoseErrors | None) -> None:
    three_sigma_deg = 3.0 * np.degrees(np.sqrt(poses.covariance[:, 2, 2]))
    error_deg = np.zeros(0) if errors is None else np.degrees(errors.yaw_rad)
    title = "3 σ of the heading (line)" if errors is None else "error of the heading, and 3 σ as a line"
    axes.set_title(f"{title} [°]")
    both = np.abs(np.concatenate((three_sigma_deg, error_deg)))
    both = both[np.isfinite(both)]
    # An initial error of degrees must not hide the tenths that follow.
    limit = max(1.3 * float(np.quantile(both, 0.9)), 0.1) if both.size else 1.3
    axes.set_ylim(-limit, limit)
    since_s = _since_s(poses.time_ns, poses)
    for sign in (-1.0, 1.0):
        axes.plot(since_s, sign * three_sigma_deg, color=plots.GREY)
    if errors is not None:
        plots.draw_dots(axes, since_s, error_deg, classes=poses.mode, colours=MODES)


def _draw_layers(axes: Axes, poses: PoseColumns, matches: MatchColumns) -> None:
    distance_m = matches.layer_mean_distance_m
    finite = distance_m[np.isfinite(distance_m)]
    axes.set(
        title="mean distance by layer [m]",
        ylim=(0.0, plots.range_limits(finite, 0.1)[1] if finite.size else 0.5),
    )
    names = [f"layer {number + 1}" for number in range(distance_m.shape[1])]  # from the lowest up
    colours = {name: _LAYERS[number % len(_LAYERS)] for number, name in enumerate(names)}
    plots.draw_key(axes, colours)
    since_s = _since_s(matches.time_ns, poses)
    for number, name in enumerate(names):
        plots.draw_dots(
            axes, since_s, distance_m[:, number], classes=np.full(len(since_s), name), colours={name: colours[name]}
        )  # fmt: skip


def _draw_overlap(axes: Axes, poses: PoseColumns, matches: MatchColumns) -> None:
    axes.set(title="overlap of the match; 0 where none is given", ylim=(-0.05, 1.05))
    plots.draw_key(axes, STATUS)
    overlap = np.where(np.isnan(matches.overlap), 0.0, matches.overlap)
    plots.draw_dots(axes, _since_s(matches.time_ns, poses), overlap, classes=matches.status, colours=STATUS)


def _since_s(time_ns: Integers, poses: PoseColumns) -> Floats:
    since_s: Floats = (time_ns - poses.time_ns[0]) * 1e-9
    return since_s


def _plane(frame: LocalFrame, latitude_rad: Floats, longitude_rad: Floats) -> Floats:
    """(n, 2), NaN without a position."""
    plane_m = np.full((len(latitude_rad), 2), np.nan)
    known = np.isfinite(latitude_rad)
    plane_m[known] = frame.east_north_from_geodetic_array(
        latitude_rad[known], longitude_rad[known], np.zeros(int(known.sum()))
    )
    return plane_m


def _ellipse_scale(poses: PoseColumns, position_m: Floats) -> float:
    """The power of ten, 1 to 1000, by which ellipses can be enlarged without hiding the track."""
    radius_m = poses.radius_m[np.isfinite(poses.radius_m)]
    if not radius_m.size:
        return 1.0
    size_m = max(float(np.ptp(position_m[np.isfinite(position_m[:, 0])], axis=0).max()), 1.0)
    share = float(np.quantile(radius_m, _LARGE_QUANTILE)) / size_m
    return float(10.0 ** min(max(math.floor(math.log10(_LARGE_ELLIPSE_SHARE / max(share, 1e-12))), 0), 3))


def _ellipses(poses: PoseColumns, position_m: Floats, scale: float) -> Iterator[Floats]:
    """Some of the poses' error ellipses as closed lines (49, 2)."""
    known = np.flatnonzero(np.isfinite(poses.radius_m) & np.isfinite(position_m[:, 0]))
    angle = np.linspace(0.0, 2.0 * math.pi, 49)
    for row in known[:: max(len(known) // _ELLIPSES, 1)].tolist():
        (ee, en, _), (_, nn, _), _ = poses.covariance[row].tolist()
        ellipse = error_ellipse((ee, en, nn), INSIDE_PROBABILITY)
        cos, sin = math.cos(ellipse.orientation_rad), math.sin(ellipse.orientation_rad)
        major_m = scale * ellipse.semi_major_m * np.cos(angle)
        minor_m = scale * ellipse.semi_minor_m * np.sin(angle)
        yield position_m[row] + np.column_stack(
            (major_m * cos - minor_m * sin, major_m * sin + minor_m * cos)
        )

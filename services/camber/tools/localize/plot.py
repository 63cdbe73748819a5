"""The plot of `camber localize`: the trajectory on the map, and below it errors, layers' distances and overlap."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

from camber.formats.drive.truth_csv import TruthTable
from camber.formats.observations import Floats, Integers
from camber.geodesy.covariance import error_ellipse
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.tools.gnss.recording_summary import time_text
from camber.tools.localize.map_drawing import map_drawing
from camber.validation.localization_columns import INSIDE_PROBABILITY, MatchColumns, PoseColumns, PoseErrors
from camber.validation.plot_frame import (
    INNER,
    STRIP_HEIGHT,
    TOP,
    TRACK_HEIGHT,
    Panel,
    document,
    heading,
    limits,
    short,
    square_panel,
    strip_tops,
)

MODES = {
    "none": "#a9b1bc", "provisional": "#d99a1c", "dead_reckoning": "#dc5a2c", "anchored": "#2fa79b",
    "scan_match": "#1f6fb2",
}  # fmt: skip
"""In the order in which they are drawn: what matters most lies on top."""
STATUS = {"lost": "#c2185b", "ambiguous": "#d99a1c", "converged": "#1f6fb2"}
_LAYERS = ("#1f6fb2", "#2fa79b", "#d99a1c", "#dc5a2c", "#8e7cc3", "#c2185b")
_TRUTH, _INK = "#1c2430", "#5b6675"
_ELLIPSES = 40
_LARGE, _LARGE_ELLIPSE_PIXELS = 0.95, 100.0
_DECADES = (-3.0, 2.0)  # of the strip of errors: a millimetre to a hundred metres


def plot(
    name: str,
    poses: PoseColumns,
    matches: MatchColumns,
    errors: PoseErrors | None,
    truth: TruthTable | None,
    release: Release,
) -> str:
    """SVG of a drive; there is a pose at least that has a place. Raises ReleaseError."""
    known = np.isfinite(poses.latitude_rad)
    first = int(np.argmax(known))
    frame = LocalFrame(float(poses.latitude_rad[first]), float(poses.longitude_rad[first]), 0.0)
    place_m = _plane(frame, poses.latitude_rad, poses.longitude_rad)
    growth = _growth(poses, place_m)
    grown = "" if growth == 1.0 else f", drawn {growth:g} times as large"
    track = square_panel(
        place_m[known],
        TOP,
        TRACK_HEIGHT,
        f"north over east of the first position [m]; 99 % ellipses{grown}",
    )
    seconds = (0.0, max(float((poses.time_ns[-1] - poses.time_ns[0]) * 1e-9), 1.0))
    counts = Counter(poses.mode.tolist())
    words = [
        (f"{counts[word]:,} {word.replace('_', ' ')}", MODES.get(word)) for word in MODES if counts[word]
    ]
    tops = strip_tops(4)
    parts = [
        *heading(name, words),
        *map_drawing(release, frame, track).parts(),
        *track.frame(short, short),
        *(
            ()
            if truth is None
            else track.lines([_plane(frame, truth.latitude_rad, truth.longitude_rad)], _TRUTH, 0.8)
        ),
        *track.lines(_ellipses(poses, place_m, growth), _INK, 0.7),
        *track.dots(place_m[:, 0], place_m[:, 1], poses.mode, MODES),
        *_position_strip(tops[0], seconds, poses, errors),
        *_heading_strip(tops[1], seconds, poses, errors),
        *_layer_strip(tops[2], seconds, poses, matches),
        *_overlap_strip(tops[3], seconds, poses, matches),
    ]
    since = f"seconds since {time_text(int(poses.time_ns[0]))} GPS time"
    return document(parts, tops[3] + STRIP_HEIGHT + 40, since)


def _position_strip(
    top: float, seconds: tuple[float, float], poses: PoseColumns, errors: PoseErrors | None
) -> Iterator[str]:
    title = "99 % radius (line)" if errors is None else "horizontal error, and the 99 % radius as a line"
    panel = Panel(top, STRIP_HEIGHT, seconds, _DECADES, f"{title} [m]")
    yield from panel.frame(None, lambda power: f"{10.0**power:g}")
    since_s = _since(poses.time_ns, poses)
    yield from panel.lines([np.column_stack((since_s, _log(poses.radius_m)))], _INK, 1.0)
    if errors is not None:
        yield from panel.dots(since_s, _log(errors.horizontal_m), poses.mode, MODES)


def _heading_strip(
    top: float, seconds: tuple[float, float], poses: PoseColumns, errors: PoseErrors | None
) -> Iterator[str]:
    sigma_deg = np.degrees(np.sqrt(poses.covariance[:, 2, 2]))
    error_deg = np.zeros(0) if errors is None else np.degrees(errors.yaw_rad)
    title = "3 σ of the heading (line)" if errors is None else "error of the heading, and 3 σ as a line"
    both = np.abs(np.concatenate((3.0 * sigma_deg, error_deg)))
    # A start of degrees must not hide the tenths that follow.
    most = max(
        1.3 * float(np.quantile(both[np.isfinite(both)], 0.9)) if np.isfinite(both).any() else 1.0, 0.1
    )
    panel = Panel(top, STRIP_HEIGHT, seconds, (-most, most), f"{title} [°]")
    yield from panel.frame(None, short)
    since_s = _since(poses.time_ns, poses)
    for sign in (-3.0, 3.0):
        yield from panel.lines([np.column_stack((since_s, sign * sigma_deg))], _INK, 1.0)
    if errors is not None:
        yield from panel.dots(since_s, error_deg, poses.mode, MODES)


def _layer_strip(
    top: float, seconds: tuple[float, float], poses: PoseColumns, matches: MatchColumns
) -> Iterator[str]:
    distance_m = matches.layer_mean_distance_m
    finite = distance_m[np.isfinite(distance_m)]
    high = limits(finite, 0.1)[1] if finite.size else 0.5
    names = [f"layer {number + 1}" for number in range(distance_m.shape[1])]  # from the lowest up
    colours = dict(zip(names, _cycled(len(names)), strict=True))
    panel = Panel(top, STRIP_HEIGHT, seconds, (0.0, high), "mean distance by layer [m]")
    yield from panel.frame(None, short)
    yield from _keys(panel, colours)
    since_s = _since(matches.time_ns, poses)
    for number, (word, colour) in enumerate(colours.items()):
        yield from panel.dots(since_s, distance_m[:, number], np.full(len(since_s), word), {word: colour})


def _overlap_strip(
    top: float, seconds: tuple[float, float], poses: PoseColumns, matches: MatchColumns
) -> Iterator[str]:
    panel = Panel(top, STRIP_HEIGHT, seconds, (-0.05, 1.05), "overlap of the match; 0 where it says none")
    yield from panel.frame(short, short)
    yield from _keys(panel, STATUS)
    overlap = np.where(np.isnan(matches.overlap), 0.0, matches.overlap)
    yield from panel.dots(_since(matches.time_ns, poses), overlap, matches.status, STATUS)


def _keys(panel: Panel, colours: Mapping[str, str]) -> Iterator[str]:
    """What colours mean, above the panel's right end."""
    x = panel.left + panel.width
    for word, colour in reversed(list(colours.items())):
        yield f'<text x="{x}" y="{panel.top - 7}" text-anchor="end">{word}</text>'
        x -= 7.6 * len(word) + 12
        yield f'<circle cx="{x + 3}" cy="{panel.top - 11}" r="4" fill="{colour}"/>'
        x -= 12


def _cycled(count: int) -> list[str]:
    return [_LAYERS[number % len(_LAYERS)] for number in range(count)]


def _since(time_ns: Integers, poses: PoseColumns) -> Floats:
    """Seconds."""
    since_s: Floats = (time_ns - poses.time_ns[0]) * 1e-9
    return since_s


def _log(values_m: Floats) -> Floats:
    """Powers of ten, those beyond the strip at its edge; NaN stays."""
    powers: Floats = np.log10(np.clip(values_m, *(10.0**power for power in _DECADES)))
    return powers


def _plane(frame: LocalFrame, latitude_rad: Floats, longitude_rad: Floats) -> Floats:
    """(n, 2), NaN where there is no place."""
    plane_m = np.full((len(latitude_rad), 2), np.nan)
    known = np.isfinite(latitude_rad)
    plane_m[known] = frame.east_north_from_geodetic_array(
        latitude_rad[known], longitude_rad[known], np.zeros(int(known.sum()))
    )
    return plane_m


def _growth(poses: PoseColumns, place_m: Floats) -> float:
    """The power of ten, 1 to 1000, by which ellipses can grow without the largest filling the panel."""
    radius_m = poses.radius_m[np.isfinite(poses.radius_m)]
    if not radius_m.size:
        return 1.0
    size_m = max(float(np.ptp(place_m[np.isfinite(place_m[:, 0])], axis=0).max()), 1.0)
    pixels = float(np.quantile(radius_m, _LARGE)) / size_m * INNER
    return float(10.0 ** min(max(math.floor(math.log10(_LARGE_ELLIPSE_PIXELS / max(pixels, 1e-9))), 0), 3))


def _ellipses(poses: PoseColumns, place_m: Floats, growth: float) -> Iterator[Floats]:
    """Now and then one, as closed lines (49, 2)."""
    known = np.flatnonzero(np.isfinite(poses.radius_m) & np.isfinite(place_m[:, 0]))
    turn = np.linspace(0.0, 2.0 * math.pi, 49)
    for row in known[:: max(len(known) // _ELLIPSES, 1)].tolist():
        (ee, en, _), (_, nn, _), _ = poses.covariance[row].tolist()
        ellipse = error_ellipse((ee, en, nn), INSIDE_PROBABILITY)
        cos, sin = math.cos(ellipse.orientation_rad), math.sin(ellipse.orientation_rad)
        major, minor = (
            growth * ellipse.semi_major_m * np.cos(turn),
            growth * ellipse.semi_minor_m * np.sin(turn),
        )
        yield place_m[row] + np.column_stack((major * cos - minor * sin, major * sin + minor * cos))

"""The plot of `camber gnss solve`: one SVG with the track, and heights, satellites and ratios over time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.local_frame import LocalFrame
from camber.tools.gnss.recording_summary import time_text
from camber.validation.plot_frame import (
    INNER,
    LEFT,
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

_COLOURS = {"single": "#a9b1bc", "float": "#d99a1c", "fixed": "#1f6fb2"}
"""In the order in which they are drawn: what matters most lies on top."""
_RATIO_LIMIT = 1000.0


def plot(
    name: str,
    time_ns: Integers,
    places: Floats,
    quality: NDArray[np.str_],
    satellites: Integers,
    ratio: Floats,
    least_ratio: float,
) -> str:
    """SVG of n epochs: `places` (n, 3) are latitude, longitude [rad] and height [m], NaN where there is no position."""
    since_s = (time_ns - time_ns.min()) * 1e-9
    seconds = (0.0, max(float(since_s.max()), 1.0))
    east_north_m, height_m = _east_north_m(places), places[:, 2]
    # Where there are positions of decimetres, those of metres must not set the scale.
    precise = (quality == "fixed") | (quality == "float")
    leading = precise if precise.any() else quality != "none"
    track = square_panel(
        east_north_m[leading], TOP, TRACK_HEIGHT, "north over east of the first position [m]"
    )
    tops = strip_tops(3)
    heights = Panel(
        tops[0], STRIP_HEIGHT, seconds, limits(height_m[leading], 0.5), "height above the ellipsoid [m]"
    )
    most = max(float(satellites.max(initial=0)), 10.0)
    counted = Panel(tops[1], STRIP_HEIGHT, seconds, (0.0, 1.1 * most), "satellites in the position")
    powers = Panel(
        tops[2], STRIP_HEIGHT, seconds, (0.0, math.log10(_RATIO_LIMIT)), "ratio of the ambiguity test"
    )
    log_ratio = np.log10(np.clip(ratio, 1.0, _RATIO_LIMIT))
    threshold = float(powers.down(np.array(math.log10(least_ratio))))
    words = [(f"{int((quality == word).sum()):,} {word}", _COLOURS.get(word)) for word in ("none", *_COLOURS)]
    parts = [
        *heading(name, words),
        *track.frame(short, short),
        *track.dots(east_north_m[:, 0], east_north_m[:, 1], quality, _COLOURS),
        *heights.frame(None, short),
        *heights.dots(since_s, height_m, quality, _COLOURS),
        *counted.frame(None, short),
        *counted.dots(since_s, np.where(quality == "none", np.nan, satellites), quality, _COLOURS),
        *powers.frame(short, lambda power: f"{10.0**power:.4g}"),
        f'<path class="l" d="M{LEFT} {threshold:.1f}H{LEFT + INNER}"/>',
        *powers.dots(since_s, log_ratio, quality, _COLOURS),
    ]
    since = f"seconds since {time_text(int(time_ns.min()))} GPS time"
    return document(parts, tops[2] + STRIP_HEIGHT + 40, since)


def _east_north_m(places: Floats) -> Floats:
    """(n, 2) about the first position; NaN where there is none."""
    plane = np.full((len(places), 2), np.nan)
    known = np.flatnonzero(~np.isnan(places[:, 0]))
    if known.size:
        frame = LocalFrame(*places[known[0]].tolist())
        plane[known] = frame.east_north_from_geodetic_array(*places[known].T)
    return plane

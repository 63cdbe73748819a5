"""The plot of `camber gnss solve`: the track, and heights, satellites and ratios over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.local_frame import LocalFrame
from camber.tools.gnss.recording_summary import time_text
from camber.validation.plots import (
    AMBER,
    PALE,
    PRIMARY,
    RED,
    draw_dots,
    draw_key,
    equal_limits,
    plot_style,
    range_limits,
    track_and_strips,
    use_log_scale,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"single": PALE, "float": AMBER, "fixed": PRIMARY}
"""In drawing order: the most important class last."""
_LARGEST_RATIO = 1000.0  # end of the axis; larger ratios are drawn there


def solution_figure(
    name: str,
    *,
    time_ns: Integers,
    geodetic: Floats,
    quality: NDArray[np.str_],
    satellites: Integers,
    ratio: Floats,
    least_ratio: float,
) -> Figure:
    """Figure of n epochs: `geodetic` (n, 3) is latitude, longitude [rad], height [m], NaN without a position."""
    since_s = (time_ns - time_ns.min()) * 1e-9
    east_north_m, height_m = _east_north_m(geodetic), geodetic[:, 2]
    # Positions good to decimetres set the scale where there are any, not those good to metres.
    precise = (quality == "fixed") | (quality == "float")
    leading = precise if precise.any() else quality != "none"
    with plot_style():
        figure, track, (heights, counts, ratios) = track_and_strips(name, 3)
        equal_limits(track, east_north_m[leading])
        track.set_title("north over east of the first position [m]")
        number = {key: int((quality == key).sum()) for key in ("none", *_COLOURS)}
        draw_key(track, {f"{n:,} {key}": _COLOURS.get(key, "none") for key, n in number.items()})
        heights.set(title="height above the ellipsoid [m]", ylim=range_limits(height_m[leading], 0.5))
        counts.set(title="satellites in the position", ylim=(0.0, 1.1 * max(satellites.max(initial=0), 10)))
        ratios.set(title="ratio of the ambiguity test")
        use_log_scale(ratios.yaxis, 1.0, _LARGEST_RATIO)
        ratios.axhline(least_ratio, color=RED, ls="--")
        ratios.set(xlim=(0.0, max(float(since_s.max()), 1.0)))
        ratios.set_xlabel(f"seconds since {time_text(int(time_ns.min()))} GPS time")
        counted = np.where(quality == "none", np.nan, satellites)
        draw_dots(track, east_north_m[:, 0], east_north_m[:, 1], classes=quality, colours=_COLOURS)
        for axes, values in (
            (heights, height_m),
            (counts, counted),
            (ratios, np.clip(ratio, 1.0, _LARGEST_RATIO)),
        ):
            draw_dots(axes, since_s, values, classes=quality, colours=_COLOURS)
    return figure


def _east_north_m(geodetic: Floats) -> Floats:
    """(n, 2) in the plane at the first position; NaN without a position."""
    plane = np.full((len(geodetic), 2), np.nan)
    known = np.flatnonzero(~np.isnan(geodetic[:, 0]))
    if known.size:
        frame = LocalFrame(*geodetic[known[0]].tolist())
        plane[known] = frame.east_north_from_geodetic_array(*geodetic[known].T)
    return plane

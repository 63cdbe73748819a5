"""The plot of `camber gnss solve`: the track, and heights, satellites and ratios over time."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.local_frame import LocalFrame
from camber.tools.gnss.recording_summary import time_text
from camber.validation import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"single": plots.PALE, "float": plots.AMBER, "fixed": plots.PRIMARY}
"""In drawing order: the most important class last."""
_LARGEST_RATIO = 1000.0  # end of the axis; larger ratios are drawn there


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SolvedDrive:
    """The engine's solution of every rover epoch, columns (n,).

    `quality` is `fixed`, `float`, `single` or `none`; `position_ecef_m` (n, 3) and `covariance_ecef_m2` (n, 3, 3) are
    NaN where that is `none`, `ratio` and `age_s` where there is none.
    """

    time_ns: Integers
    quality: NDArray[np.str_]
    continuity: NDArray[np.str_]
    position_ecef_m: Floats
    covariance_ecef_m2: Floats
    satellites: Integers
    ratio: Floats
    age_s: Floats
    reasons: Counter[str]
    warnings: Counter[str]
    epochs_per_s: float | None
    """Without the first epoch, in which compiled code is loaded; None where there is no other."""


def solution_figure(name: str, solved: SolvedDrive, geodetic: Floats, least_ratio: float) -> Figure:
    """Figure of n epochs: `geodetic` (n, 3) is latitude, longitude [rad], height [m], NaN without a position."""
    time_ns, quality = solved.time_ns, solved.quality
    since_s = (time_ns - time_ns.min()) * 1e-9
    east_north_m, height_m = _east_north_m(geodetic), geodetic[:, 2]
    # Positions good to decimetres set the scale where there are any, not those good to metres.
    precise = (quality == "fixed") | (quality == "float")
    leading = precise if precise.any() else quality != "none"
    with plots.plot_style():
        figure, track, (heights, counts, ratios) = plots.track_and_strips(name, 3)
        plots.equal_limits(track, east_north_m[leading])
        plots.draw_scale_and_north(track)
        track.set_title("north over east of the first position [m]")
        number = {key: int((quality == key).sum()) for key in ("none", *_COLOURS)}
        plots.draw_key(track, {f"{n:,} {key}": _COLOURS.get(key, "none") for key, n in number.items()})
        heights.set(title="height above the ellipsoid [m]", ylim=plots.range_limits(height_m[leading], 0.5))
        counts.set(
            title="satellites in the position", ylim=(0.0, 1.1 * max(solved.satellites.max(initial=0), 10))
        )
        ratios.set(title="ratio of the ambiguity test")
        plots.use_log_scale(ratios.yaxis, 1.0, _LARGEST_RATIO)
        ratios.axhline(least_ratio, color=plots.RED, ls="--")
        ratios.set(xlim=(0.0, max(float(since_s.max()), 1.0)))
        ratios.set_xlabel(f"seconds since {time_text(int(time_ns.min()))} GPS time")
        counted = np.where(quality == "none", np.nan, solved.satellites)
        plots.draw_dots(track, east_north_m[:, 0], east_north_m[:, 1], classes=quality, colours=_COLOURS)
        drawn_ratios = np.clip(solved.ratio, 1.0, _LARGEST_RATIO)
        for axes, values in ((heights, height_m), (counts, counted), (ratios, drawn_ratios)):
            plots.draw_dots(axes, since_s, values, classes=quality, colours=_COLOURS)
    return figure


def _east_north_m(geodetic: Floats) -> Floats:
    """(n, 2) in the plane at the first position; NaN without a position."""
    plane = np.full((len(geodetic), 2), np.nan)
    known = np.flatnonzero(~np.isnan(geodetic[:, 0]))
    if known.size:
        frame = LocalFrame(*geodetic[known[0]].tolist())
        plane[known] = frame.east_north_from_geodetic_array(*geodetic[known].T)
    return plane

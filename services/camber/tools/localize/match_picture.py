"""A picture of one scan match: local map and map from above, and both by their height above the road.

Points are coloured by their distance from the map's planes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats
from camber.localizer.matching.match_view import MatchView
from camber.tools.gnss.recording_summary import time_text
from camber.validation import plots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FULL_SCALE_M = 0.3
"""Residuals from here on have the last colour; chosen: several times the σ of a converged match."""
_EXTENT_M = 40.0  # around the vehicle; chosen: a match rests on points about as near
_STRIP_M = 15.0  # to each side of the vehicle, shown from the side; chosen: the width of a street
_ARROW_M = 2.5  # half the length of the vehicle's arrow: about a car
_HEIGHTS_M = (-0.5, 6.0)  # includes every layer's bounds
_MAP, _NO_PARTNER, _NO_LAYER = "#cbd1d9", plots.PURPLE, "#969eaa"
_SCALE = (plots.PRIMARY, plots.GREEN, "#f2c14e", plots.ORANGE, plots.RED)
"""Colours of residuals from zero to `FULL_SCALE_M`, evenly spaced."""
_STATUS = {"converged": plots.PRIMARY, "ambiguous": plots.AMBER, "lost": plots.RED}
_COLUMN_WIDTHS = (0.16, 0.1, 0.18, 0.11, 0.14, 0.15, 0.16)
_COLUMNS = ("layer", "points", "mean distance", "overlap", "on a plane", "residual / σ", "outcome")
_ROW_IN = 0.2  # chosen: a line of small text


def match_figure(name: str, view: MatchView, *, start_ns: int) -> Figure:
    """Figure of a match; its time is given since `start_ns`."""
    position_m = np.array([view.match.east_m, view.match.north_m])
    yaw_rad = view.match.yaw_rad
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    left = np.array([-ahead[1], ahead[0]])
    map_m, points_m = view.map_m[:, :2] - position_m, view.points_m[:, :2] - position_m
    map_near, points_near = np.abs(map_m @ left) < _STRIP_M, np.abs(points_m @ left) < _STRIP_M
    rows = len(view.match.layers)
    with plots.plot_style():
        figure, (above, side) = plots.stacked_panels(
            f"{name}: scan match at {(view.time_ns - start_ns) * 1e-9:.1f} s",
            [6.0, 2.2],
            _ROW_IN * rows + 0.9,
        )
        above.set_title("from above: north over east of the map block's centre [m]")
        plots.draw_key(above, {_outcome(view): _STATUS[view.match.status]})
        plots.equal_limits(above, position_m + _EXTENT_M * np.array([(-1.0, -1.0), (1.0, 1.0)]))
        plots.draw_scale_and_north(above)
        _draw_points(above, view.map_m[:, 0], view.map_m[:, 1], _MAP)
        _draw_residuals(above, view, (view.points_m[:, 0], view.points_m[:, 1]), view.layer >= 0)
        arrow = {"arrowstyle": "-|>", "color": plots.INK, "mutation_scale": 20}
        tip, tail = (tuple((position_m + sign * _ARROW_M * ahead).tolist()) for sign in (1.0, -1.0))
        above.annotate("", tip, tail, arrowprops=arrow)
        side.set_title(
            "height above the road over distance ahead of the vehicle [m], out to 15 m to its sides"
        )
        half_m = 0.5 * (above.get_xlim()[1] - above.get_xlim()[0])
        side.set(xlim=(-half_m, half_m), ylim=_HEIGHTS_M)
        _draw_points(side, (map_m @ ahead)[map_near], view.map_heights_m[map_near], _MAP)
        _draw_residuals(side, view, (points_m @ ahead, view.heights_m), points_near)
        for height_m in sorted({bound for row in view.match.layers for bound in row.bounds_m}):
            side.axhline(height_m, color=plots.RED, ls="--", lw=0.8)
        side.set_xlabel(f"{time_text(view.time_ns)} GPS time", loc="right")
        _draw_table(figure, view)
        _draw_scale(figure)
    return figure


def residual_colours(residual_m: Floats) -> NDArray[np.float64]:
    """Colours (n, 4) of residuals (n,); NaN has that of a point without a partner in the map."""
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("residual", _SCALE).with_extremes(bad=_NO_PARTNER)
    return np.asarray(colours(np.ma.masked_invalid(residual_m / FULL_SCALE_M)))


def _outcome(view: MatchView) -> str:
    reason = view.match.reason
    return view.match.status if reason == "agreed" else f"{view.match.status}: {reason}"


def _draw_points(axes: Axes, x: Floats, y: Floats, colour: str | Floats) -> None:
    axes.scatter(x, y, s=1.0, c=colour, linewidths=0, rasterized=True)


def _draw_residuals(
    axes: Axes, view: MatchView, xy: tuple[Floats, Floats], chosen: NDArray[np.bool_]
) -> None:
    """Points in no layer first, then by growing residual: the largest lie on top."""
    from matplotlib.colors import to_rgba

    colours = residual_colours(view.residual_m)
    colours[view.layer < 0] = to_rgba(_NO_LAYER)
    size = np.where(view.layer < 0, -1.0, np.nan_to_num(view.residual_m, nan=FULL_SCALE_M))
    order = np.argsort(size, kind="stable")
    order = order[chosen[order]]
    _draw_points(axes, xy[0][order], xy[1][order], colours[order])


def _draw_table(figure: Figure, view: MatchView) -> None:
    """The layers' figures below the panels."""
    from matplotlib.transforms import Bbox

    rows = [_COLUMNS]
    for row in view.match.layers:
        distance_m, residual = row.fit.mean_distance_m, row.residual
        rows.append(
            (
                f"{row.bounds_m[0]:g} to {row.bounds_m[1]:g} m",
                f"{row.fit.points:,}",
                f"{distance_m:.3f} m" if math.isfinite(distance_m) else "–",
                f"{row.fit.overlap:.0%}",
                f"{row.inliers:.0%}",
                f"{residual:.2f}" if math.isfinite(residual) else "–",
                row.outcome.replace("_", " "),
            )
        )
    width_in, height_in = figure.get_size_inches()
    height = _ROW_IN * len(rows) / height_in
    axes = figure.add_axes((0.74 / width_in, 0.85 / height_in + 0.07 - height, 0.62, height))
    axes.axis("off")
    table = axes.table(
        [list(row) for row in rows], colWidths=_COLUMN_WIDTHS, cellLoc="left", bbox=Bbox.unit(), edges="open"
    )
    table.auto_set_font_size(False)


def _draw_scale(figure: Figure) -> None:
    """The colours of residuals, and what the other colours are."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    _, height_in = figure.get_size_inches()
    colours = ScalarMappable(
        Normalize(0.0, FULL_SCALE_M), LinearSegmentedColormap.from_list("residual", _SCALE)
    )
    bar = figure.add_axes((0.76, 0.62 / height_in, 0.2, 0.12 / height_in))
    figure.colorbar(
        colours, cax=bar, orientation="horizontal", extend="max", label="distance from the map's plane [m]"
    )
    plots.draw_key(bar, {"no map near": _NO_PARTNER, "in no layer": _NO_LAYER, "map": _MAP})

"""Figures of the lab: a Stanford chart and errors in their ellipse by source; missed episodes by size of error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from camber.formats.observations import Floats
from camber.validation.lab.error_model import HEADLINE, scene_of
from camber.validation.lab.misleading_information import ALERT_LIMIT_M
from camber.validation.plots import (
    AMBER,
    GREEN,
    INK,
    ORANGE,
    PRIMARY,
    RED,
    draw_key,
    plot_style,
    stacked_panels,
    svg_text,
    use_log_scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BASELINES = {
    "height only": ORANGE, "LiDAR only": AMBER, "height and LiDAR": PRIMARY, "all, with residuals": GREEN,
}  # fmt: skip
_PANEL_IN, _SMALLEST_SHARE = 4.3, 1e-6


def charts(figures: dict[str, Any]) -> dict[str, str]:
    """SVG by file name."""
    levels = figures["levels"]
    with plot_style():
        drawn = {"missed.svg": _missed_figure(figures)}
        for mode, counts in levels["modes"].items():
            drawn[f"stanford-{mode}.svg"] = _stanford_figure(mode, levels, counts)
        return {name: svg_text(figure) for name, figure in drawn.items()}


def _stanford_figure(mode: str, levels: dict[str, Any], counts: dict[str, Any]) -> Figure:
    """Left the Stanford chart (protection level over error), right the errors in units of the 99.9 % ellipse."""
    share = counts["inside_999"]["share"]
    name = mode.replace("_", " ")
    title = f"{name}: {counts['draws']:,} positions, level at {levels['risk']:g}, {share:.3%} inside 99.9 %"
    figure, (chart,) = stacked_panels(title, [_PANEL_IN])
    box = chart.get_position()
    width = box.height * figure.get_figheight() / figure.get_figwidth()
    chart.set_position((box.x0, box.y0, width, box.height))
    unit_circle = figure.add_axes((box.x1 - width, box.y0, width, box.height))
    _draw_stanford(chart, np.array(levels["chart_edges_m"]), np.array(counts["chart"]))
    points = np.array(counts["circle"]).reshape(-1, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    unit_circle.set(
        title="errors in the unit circle of the 99.9 % ellipse", xlim=(-1.5, 1.5), ylim=(-1.5, 1.5)
    )
    unit_circle.plot(points[:, 0], points[:, 1], ".", color=INK, ms=3, mew=0, rasterized=True)
    unit_circle.plot(np.cos(angle), np.sin(angle), color=RED)
    return figure


def _draw_stanford(axes: Axes, edges_m: Floats, counts: Floats) -> None:
    """Counts of (error, level) cells on a logarithmic scale; beyond the diagonal the error exceeds its level."""
    from matplotlib.colors import LogNorm

    edges_m = np.maximum(edges_m, 0.5 * edges_m[1])  # the first cell starts at zero
    shown = np.ma.masked_equal(counts[: len(edges_m) - 1, : len(edges_m) - 1].T, 0)
    norm = LogNorm(1.0, max(float(shown.max()), 10.0) if shown.count() else 10.0)
    axes.pcolormesh(edges_m, edges_m, shown, norm=norm, cmap="Blues", rasterized=True)
    for axis in (axes.xaxis, axes.yaxis):
        use_log_scale(axis, edges_m[0], edges_m[-1])
    axes.set_title("protection level over horizontal error [m]")
    axes.axline((1.0, 1.0), (2.0, 2.0), color=RED)
    for draw_limit in (axes.axhline, axes.axvline):
        draw_limit(ALERT_LIMIT_M, color="grey")
    axes.set_xlabel(f"lines: level = error, alert limit {ALERT_LIMIT_M} m")


def _missed_figure(figures: dict[str, Any]) -> Figure:
    """Share of episodes confirmed at any epoch, over the size of the error, of the two headline scenes by kind."""
    scenes = [rows for rows in figures["missed"] if scene_of(rows) in HEADLINE]
    figure, panels = stacked_panels("wrong fixes confirmed", [1.9] * len(scenes))
    draw_key(panels[0], _BASELINES)
    for axes, rows in zip(panels, scenes, strict=True):
        axes.set_title(
            f"{rows['kind']}, LiDAR σ {rows['pose_sigma_m']:.2f} m: share over horizontal error [m]"
        )
        use_log_scale(axes.xaxis, 0.2, 10.0)
        use_log_scale(axes.yaxis, _SMALLEST_SHARE, 1.0)
        for name, colour in _BASELINES.items():
            axes.plot(*_curve(rows["curve"], name).T, color=colour, lw=2.0)
    panels[-1].set_xlabel(
        "of episodes by their size, those confirmed at any epoch; a line ends where none was"
    )
    return figure


def _curve(bins: list[dict[str, Any]], baseline: str) -> Floats:
    """Error and share confirmed (n, 2); NaN where none was."""
    points = []
    for row in bins:
        share = row["confirmed"][baseline] / row["episodes"] if row["episodes"] else 0.0
        middle_m = math.sqrt(row["from_m"] * (row["to_m"] or 2.0 * row["from_m"]))
        points.append((middle_m, share if share > 0.0 else math.nan))
    return np.array(points)

"""The lab's plots: for each mode a Stanford chart and the errors in their ellipse; missed episodes over the error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from camber.formats.observations import Floats
from camber.validation.plot_frame import INNER, LEFT, TOP, Panel, document, heading, short

ALERT_LIMIT_M = 1.5
_SIDE = 430.0
_INK, _RED, _GREY = "#1c2430", "#c2185b", "#8a94a3"
_SHADES = ("#d6e4f2", "#a6c5e3", "#6ba0d1", "#3b7cbd", "#1f5a96", "#0f3866")
_CONTROLS = {
    "height only": "#dc5a2c", "LiDAR only": "#d99a1c", "height and LiDAR": "#1f6fb2", "all, with residuals": "#2fa79b",
}  # fmt: skip
_SMALLEST = 1e-6


def charts(figures: dict[str, Any]) -> dict[str, str]:
    """SVG by the name of its file."""
    made = {"missed.svg": _missed(figures)}
    levels = figures["levels"]
    for mode, counts in levels["modes"].items():
        made[f"stanford-{mode}.svg"] = _stanford(mode, levels, counts)
    return made


def _stanford(mode: str, levels: dict[str, Any], counts: dict[str, Any]) -> str:
    """Left the level over the error, right the errors in units of the 99.9 % ellipse."""
    low, high = math.log10(levels["chart_edges_m"][1]), math.log10(levels["chart_edges_m"][-1])
    chart = Panel(
        TOP, _SIDE, (low, high), (low, high), "protection level over horizontal error [m]", LEFT, _SIDE
    )
    circle = Panel(
        TOP, _SIDE, (-1.5, 1.5), (-1.5, 1.5), "errors in the unit circle of the 99.9 % ellipse",
        LEFT + INNER - _SIDE, _SIDE,
    )  # fmt: skip
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    round_line = np.column_stack((np.cos(angle), np.sin(angle)))
    limit = math.log10(ALERT_LIMIT_M)
    points = np.array(counts["circle"]).reshape(-1, 2)
    words = np.full(len(points), "error")
    share = counts["inside_999"]["share"]
    title = f"{mode.replace('_', ' ')}: {counts['draws']:,} positions, level at {levels['risk']:g}"
    parts = [
        *heading(title, [(f"{100.0 * share:.3f} % inside 99.9 %", None)]),
        *_cells(chart, levels, np.array(counts["chart"])),
        *chart.lines([np.array([(low, low), (high, high)])], _RED, 1.2),
        *chart.lines(
            [np.array([(low, limit), (high, limit)]), np.array([(limit, low), (limit, high)])], _GREY
        ),
        *chart.frame(_metres, _metres),
        *circle.lines([round_line], _RED, 1.2),
        *circle.frame(short, short),
        *circle.dots(points[:, 0], points[:, 1], words, {"error": _INK}),
    ]
    return document(parts, TOP + _SIDE + 48.0, f"lines: level = error, alert limit {ALERT_LIMIT_M} m")


def _cells(panel: Panel, levels: dict[str, Any], count: Floats) -> Iterator[str]:
    """Rectangles of error (across) and level (up), the darker the more positions."""
    edges = np.array(levels["chart_edges_m"])
    at = np.log10(np.maximum(edges, 10.0 ** panel.x[0]))
    for i, j in np.argwhere(count > 0).tolist():
        if i + 1 >= len(at) or j + 1 >= len(at):
            continue
        x, y = panel.across(at[i : i + 2]), panel.down(at[j : j + 2])
        left = float(x[0]) if i else panel.left
        shade = _SHADES[min(int(math.log10(count[i, j])), len(_SHADES) - 1)]
        width, height = max(float(x[1]) - left, 6.0 if not i else 0.0), float(y[0] - y[1])
        yield f'<rect x="{left:.1f}" y="{float(y[1]):.1f}" width="{width:.1f}" height="{height:.1f}" fill="{shade}"/>'


def _missed(figures: dict[str, Any]) -> str:
    """Share of episodes confirmed at any epoch, over the size of the error, of the two headline scenes by kind."""
    parts = list(heading("wrong fixes confirmed", list(_CONTROLS.items())[::-1]))
    top, height = TOP + 10.0, 190.0
    for rows in figures["missed"]:
        if (rows["pose_sigma_m"], rows["map_sigma_m"]) not in ((0.05, 0.05), (0.10, 0.05)):
            continue
        panel = Panel(
            top, height, (math.log10(0.2), 1.0), (math.log10(_SMALLEST), 0.0),
            f"{rows['kind']}, LiDAR σ {rows['pose_sigma_m']:.2f} m: share over horizontal error [m]",
        )  # fmt: skip
        parts += panel.frame(_metres, lambda power: f"1e{power:g}")
        for name, colour in _CONTROLS.items():
            parts += panel.lines([_curve(rows["curve"], name)], colour, 2.0)
        top += height + 56.0
    return document(
        parts, top, "of episodes by their size, those confirmed at any epoch; a line ends where none was"
    )


def _curve(bins: list[dict[str, Any]], control: str) -> Floats:
    points = []
    for b in bins:
        share = b["confirmed"][control] / b["episodes"] if b["episodes"] else 0.0
        middle = math.sqrt(b["from_m"] * (b["to_m"] or 2.0 * b["from_m"]))
        points.append((math.log10(middle), math.log10(share) if share > 0.0 else math.nan))
    return np.array(points)


def _metres(power: float) -> str:
    return f"{10.0**power:.3g}"

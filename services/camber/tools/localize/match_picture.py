"""A picture of one scan match: the local map on the map from above, and both by their height above the road.

Points are coloured by how far they are from the map's planes. The points are a PNG inside the SVG, text and frames are
not.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator

import numpy as np

from camber.formats.observations import Floats
from camber.localizer.matching.match_view import MatchView
from camber.tools.gnss.recording_summary import time_text
from camber.validation.plot_frame import (
    INNER,
    LEFT,
    SPACE,
    TOP,
    Panel,
    document,
    heading,
    short,
    square_panel,
)
from camber.validation.raster import Colours, Raster

FULL_M = 0.3
"""Residuals from here on have the last colour."""
_REACH_M = 40.0  # around the vehicle
_ABOVE_M, _SIDE_HEIGHT = 560, 200
_HEIGHTS_M = (-0.5, 6.0)
_PIXELS = 2  # of the picture for one of the page
_MAP = np.array([203, 209, 217], np.uint8)
_ALONE = np.array([0x8E, 0x7C, 0xC3], np.uint8)
_OUTSIDE = np.array([150, 158, 170], np.uint8)
_SCALE = np.array(
    [(0x1F, 0x6F, 0xB2), (0x2F, 0xA7, 0x9B), (0xF2, 0xC1, 0x4E), (0xDC, 0x5A, 0x2C), (0xC2, 0x18, 0x5B)],
    np.float64,
)
"""From nothing to `FULL_M`, evenly."""
_STATUS = {"converged": "#1f6fb2", "ambiguous": "#d99a1c", "lost": "#c2185b"}
_ROW = 18


def residual_colours(residual_m: Floats) -> Colours:
    """Colours (n, 3) of residuals (n,); NaN is that of a point without a partner."""
    at = np.clip(residual_m / FULL_M, 0.0, 1.0) * (len(_SCALE) - 1)
    known = np.isfinite(at)
    low = np.minimum(np.floor(np.where(known, at, 0.0)).astype(np.int64), len(_SCALE) - 2)
    share = (np.where(known, at, 0.0) - low)[:, None]
    colours: Colours = np.round((1.0 - share) * _SCALE[low] + share * _SCALE[low + 1]).astype(np.uint8)
    colours[~known] = _ALONE
    return colours


def picture(name: str, view: MatchView, start_ns: int) -> str:
    """SVG of a match; `start_ns` is what its time is counted from."""
    place = np.array([view.match.east_m, view.match.north_m])
    corners = place + _REACH_M * np.array([(-1.0, -1.0), (1.0, 1.0)])
    # A wide page shows more to the sides than ahead: what is drawn is cut at the frame.
    above = square_panel(corners, TOP, _ABOVE_M, "from above: north over east of the map block's centre [m]")
    yaw = view.match.yaw_rad
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    side_top = TOP + _ABOVE_M + SPACE
    reach_m = 0.5 * (above.x[1] - above.x[0])
    side = Panel(
        side_top,
        _SIDE_HEIGHT,
        (-reach_m, reach_m),
        _HEIGHTS_M,
        "height above the road over distance ahead of the vehicle [m], out to 15 m to its sides",
    )
    status = view.match.status
    since_s = (view.time_ns - start_ns) * 1e-9
    below = side_top + _SIDE_HEIGHT + 42
    rows = list(_rows(view, below))
    parts = [
        *heading(f"{name}: scan match at {since_s:.1f} s", [(_said(view), _STATUS[status])]),
        above.image(_from_above(above, view)),
        *above.frame(short, short),
        _vehicle(above, place, yaw),
        side.image(_from_the_side(side, view, place, ahead)),
        *side.frame(short, short),
        *_bounds(side, view),
        *_legend(below - 16),
        *rows,
    ]
    return document(
        parts, below + 26 + _ROW * len(view.match.layers) + 26, f"{time_text(view.time_ns)} GPS time"
    )


def _said(view: MatchView) -> str:
    reason = view.match.reason.replace("_", " ")
    return view.match.status if reason == "agreed" else f"{view.match.status}: {reason}"


def _raster(panel: Panel) -> Raster:
    return Raster(round(panel.width * _PIXELS), round(panel.height * _PIXELS))


def _put(raster: Raster, panel: Panel, x: Floats, y: Floats, colour: Colours, size: int) -> None:
    raster.dots((panel.across(x) - panel.left) * _PIXELS, (panel.down(y) - panel.top) * _PIXELS, colour, size)


def _order(view: MatchView) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Points outside of all layers first, then the small residuals: what is wrong lies on top."""
    return np.argsort(
        np.where(view.layer < 0, -1.0, np.where(np.isnan(view.residual_m), FULL_M, view.residual_m)),
        kind="stable",
    )


def _colours(view: MatchView) -> Colours:
    colours = residual_colours(view.residual_m)
    colours[view.layer < 0] = _OUTSIDE
    return colours


def _from_above(panel: Panel, view: MatchView) -> bytes:
    raster = _raster(panel)
    _put(raster, panel, view.map_m[:, 0], view.map_m[:, 1], _MAP, 2)
    order = _order(view)
    order = order[view.layer[order] >= 0]
    points_m = view.points_m[order]
    _put(raster, panel, points_m[:, 0], points_m[:, 1], _colours(view)[order], 3)
    return raster.png()


def _from_the_side(panel: Panel, view: MatchView, place: Floats, ahead: Floats) -> bytes:
    raster = _raster(panel)
    across = np.array([-ahead[1], ahead[0]])
    near = np.abs((view.map_m[:, :2] - place) @ across) < 15.0
    _put(raster, panel, (view.map_m[near, :2] - place) @ ahead, view.map_heights_m[near], _MAP, 2)
    order = _order(view)
    offset_m = view.points_m[order, :2] - place
    near = np.abs(offset_m @ across) < 15.0
    _put(raster, panel, (offset_m @ ahead)[near], view.heights_m[order][near], _colours(view)[order][near], 3)
    return raster.png()


def _vehicle(panel: Panel, place: Floats, yaw_rad: float) -> str:
    """An arrow at the vehicle's origin, along its x."""
    x, y = float(panel.across(place[:1])[0]), float(panel.down(place[1:])[0])
    turned = f"translate({x:.1f} {y:.1f}) rotate({-math.degrees(yaw_rad):.2f})"
    return f'<path transform="{turned}" d="M14 0L-8 7L-4 0L-8 -7Z" fill="#1c2430"/>'


def _bounds(panel: Panel, view: MatchView) -> Iterator[str]:
    for height_m in sorted({bound for row in view.match.layers for bound in row.bounds_m}):
        at = float(panel.down(np.array(height_m)))
        if panel.y[0] < height_m < panel.y[1]:
            yield f'<path class="l" d="M{panel.left} {at:.1f}h{panel.width}"/>'


def _legend(top: float) -> Iterator[str]:
    """The colours of residuals, and what the other colours are."""
    steps = 40
    edges = np.linspace(0.0, FULL_M, steps)
    x = LEFT + INNER - 4.0 * steps
    for number, colour in enumerate(residual_colours(edges).tolist()):
        yield f'<rect x="{x + 4.0 * number:g}" y="{top + 14}" width="4.5" height="10" fill="rgb{tuple(colour)}"/>'
    yield f'<text x="{x}" y="{top + 38}">0</text>'
    yield f'<text x="{LEFT + INNER}" y="{top + 38}" text-anchor="end">{FULL_M:g} m and more</text>'
    yield f'<text x="{x - 10}" y="{top + 23}" text-anchor="end">from the map’s plane</text>'
    others = (("no map near", _ALONE), ("in no layer", _OUTSIDE), ("map", _MAP))
    for number, (word, colour) in enumerate(others):
        y = top + 56 + 16 * number
        yield f'<rect x="{x}" y="{y - 9}" width="10" height="10" fill="rgb{tuple(colour.tolist())}"/>'
        yield f'<text x="{x + 16}" y="{y}">{word}</text>'


def _rows(view: MatchView, top: float) -> Iterator[str]:
    """The layers' figures."""
    columns = (0, 110, 180, 290, 360, 450, 550)
    head = ("layer", "points", "mean distance", "overlap", "on a plane", "residual / σ", "")
    yield _row(columns, head, top, "n")
    for number, row in enumerate(view.match.layers):
        low_m, high_m = row.bounds_m
        words = (
            f"{low_m:g} to {high_m:g} m",
            f"{row.fit.points:,}",
            "–" if not math.isfinite(row.fit.mean_distance_m) else f"{row.fit.mean_distance_m:.3f} m",
            f"{row.fit.overlap:.0%}",
            f"{row.inliers:.0%}",
            "–" if not math.isfinite(row.residual) else f"{row.residual:.2f}",
            row.outcome.replace("_", " "),
        )
        yield _row(columns, words, top + _ROW * (number + 1), "")


def _row(columns: tuple[int, ...], words: tuple[str, ...], y: float, kind: str) -> str:
    return "".join(
        f'<text class="{kind}" x="{LEFT + x}" y="{y}">{html.escape(word)}</text>'
        for x, word in zip(columns, words, strict=True)
    )

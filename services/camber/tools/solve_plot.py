"""The plot of `camber gnss solve`: one SVG with the track, and heights, satellites and ratios over time."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.local_frame import LocalFrame
from camber.tools.recording_summary import time_text

_COLOURS = {"single": "#a9b1bc", "float": "#d99a1c", "fixed": "#1f6fb2"}
"""In the order in which they are drawn: what matters most lies on top."""
_WIDTH, _LEFT, _RIGHT, _TOP, _SPACE = 1040, 74, 24, 64, 44
_TRACK_HEIGHT, _STRIP_HEIGHT = 520, 130
_INNER = _WIDTH - _LEFT - _RIGHT
_RATIO_LIMIT = 1000.0
_STYLE = (
    "text{font:12px system-ui,'Segoe UI','Noto Sans','DejaVu Sans',sans-serif;fill:#5b6675}"
    ".t{font-size:17px;font-weight:600;fill:#1c2430}.n{fill:#1c2430;font-weight:600}"
    ".g{stroke:#e3e7ec;fill:none}.f{stroke:#8a94a3;fill:none}.l{stroke:#c2185b;stroke-dasharray:5 4;fill:none}"
    ".p{fill:none;stroke-linecap:round;stroke-width:3.2}"
)


@dataclass(frozen=True, slots=True)
class _Panel:
    """A frame and what its values are: `low` and `high` of x and y at its edges."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]
    title: str

    def across(self, value: Floats) -> Floats:
        """Pixels."""
        return _LEFT + (value - self.x[0]) / (self.x[1] - self.x[0]) * _INNER

    def down(self, value: Floats) -> Floats:
        """Pixels."""
        return self.top + self.height - (value - self.y[0]) / (self.y[1] - self.y[0]) * self.height

    def frame(self, x_label: Callable[[float], str] | None, y_label: Callable[[float], str]) -> Iterator[str]:
        """Lines and numbers at round values; without `x_label` no numbers below."""
        bottom = self.top + self.height
        for x in _round_values(*self.x, 10):
            at = float(self.across(np.array(x)))
            yield f'<path class="g" d="M{at:.1f} {self.top}V{bottom}"/>'
            if x_label is not None:
                yield f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{x_label(x)}</text>'
        for y in _round_values(*self.y, 9 if self.height > _STRIP_HEIGHT else 5):
            at = float(self.down(np.array(y)))
            yield f'<path class="g" d="M{_LEFT} {at:.1f}H{_LEFT + _INNER}"/>'
            yield f'<text x="{_LEFT - 7}" y="{at + 4:.1f}" text-anchor="end">{y_label(y)}</text>'
        yield f'<rect class="f" x="{_LEFT}" y="{self.top}" width="{_INNER}" height="{self.height}"/>'
        yield f'<text class="n" x="{_LEFT}" y="{self.top - 7}">{self.title}</text>'

    def dots(self, x: Floats, y: Floats, quality: NDArray[np.str_]) -> Iterator[str]:
        """A dot for each point (n,) inside the frame, by quality; points on one spot are drawn once."""
        inside = (x >= self.x[0]) & (x <= self.x[1]) & (y >= self.y[0]) & (y <= self.y[1])
        for word, colour in _COLOURS.items():
            mine = inside & (quality == word)
            if mine.any():
                at = np.unique(
                    np.round(2.0 * np.column_stack((self.across(x[mine]), self.down(y[mine])))), axis=0
                )
                marks = "".join(f"M{a:g} {b:g}h0" for a, b in (at / 2.0).tolist())
                yield f'<path class="p" stroke="{colour}" d="{marks}"/>'


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
    track = _track(east_north_m[leading])
    tops = [_TOP + _TRACK_HEIGHT + _SPACE + k * (_STRIP_HEIGHT + _SPACE) for k in range(3)]
    heights = _Panel(
        tops[0], _STRIP_HEIGHT, seconds, _limits(height_m[leading], 0.5), "height above the ellipsoid [m]"
    )
    most = max(float(satellites.max(initial=0)), 10.0)
    counted = _Panel(tops[1], _STRIP_HEIGHT, seconds, (0.0, 1.1 * most), "satellites in the position")
    powers = _Panel(
        tops[2], _STRIP_HEIGHT, seconds, (0.0, math.log10(_RATIO_LIMIT)), "ratio of the ambiguity test"
    )
    log_ratio = np.log10(np.clip(ratio, 1.0, _RATIO_LIMIT))
    threshold = float(powers.down(np.array(math.log10(least_ratio))))
    parts = [
        *_heading(name, time_ns, quality),
        *track.frame(_short, _short),
        *track.dots(east_north_m[:, 0], east_north_m[:, 1], quality),
        *heights.frame(None, _short),
        *heights.dots(since_s, height_m, quality),
        *counted.frame(None, _short),
        *counted.dots(since_s, np.where(quality == "none", np.nan, satellites), quality),
        *powers.frame(_short, lambda power: f"{10.0**power:.4g}"),
        f'<path class="l" d="M{_LEFT} {threshold:.1f}H{_LEFT + _INNER}"/>',
        *powers.dots(since_s, log_ratio, quality),
    ]
    bottom = tops[2] + _STRIP_HEIGHT + 40
    since = f"seconds since {time_text(int(time_ns.min()))} GPS time"
    parts.append(f'<text x="{_LEFT + _INNER / 2}" y="{bottom - 6}" text-anchor="middle">{since}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {bottom}" width="{_WIDTH}" height="{bottom}">'
        f'<style>{_STYLE}</style><rect width="{_WIDTH}" height="{bottom}" fill="#fff"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _heading(name: str, time_ns: Integers, quality: NDArray[np.str_]) -> Iterator[str]:
    yield f'<text class="t" x="{_LEFT}" y="26">{html.escape(name)}</text>'
    x = _LEFT + _INNER
    for word in ("none", *_COLOURS):
        text = f"{int((quality == word).sum()):,} {word}"
        yield f'<text x="{x}" y="26" text-anchor="end">{text}</text>'
        x -= 7 * len(text) + 14
        if word in _COLOURS:
            yield f'<circle cx="{x + 5}" cy="22" r="5" fill="{_COLOURS[word]}"/>'
        x -= 12


def _east_north_m(places: Floats) -> Floats:
    """(n, 2) about the first position; NaN where there is none."""
    plane = np.full((len(places), 2), np.nan)
    known = np.flatnonzero(~np.isnan(places[:, 0]))
    if known.size:
        frame = LocalFrame(*places[known[0]].tolist())
        plane[known] = frame.east_north_from_geodetic_array(*places[known].T)
    return plane


def _track(east_north_m: Floats) -> _Panel:
    """One scale for both directions, all of it inside."""
    low, high = np.zeros(2), np.zeros(2)
    if len(east_north_m):
        low, high = east_north_m.min(axis=0), east_north_m.max(axis=0)
    middle = 0.5 * (low + high)
    m_a_pixel = max(float(high[0] - low[0]) / _INNER, float(high[1] - low[1]) / _TRACK_HEIGHT, 1e-4) * 1.08
    half = 0.5 * m_a_pixel * np.array([_INNER, _TRACK_HEIGHT])
    (left, south), (right, north) = (middle - half).tolist(), (middle + half).tolist()
    return _Panel(
        _TOP, _TRACK_HEIGHT, (left, right), (south, north), "north over east of the first position [m]"
    )


def _limits(values: Floats, least_range: float) -> tuple[float, float]:
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    half = 0.54 * max(high - low, least_range)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _round_values(low: float, high: float, most: int) -> list[float]:
    """At most so many, 1, 2 or 5 times a power of ten apart."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _short(value: float) -> str:
    return f"{value:.10g}" if abs(value) > 1e-9 else "0"

"""What Camber's plots share: one look, and panels that know where their values stand. All of it is SVG as text."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats

WIDTH, LEFT, RIGHT, TOP, SPACE = 1040, 74, 24, 64, 44
TRACK_HEIGHT, STRIP_HEIGHT = 520, 130
INNER = WIDTH - LEFT - RIGHT
_STYLE = (
    "text{font:12px system-ui,'Segoe UI','Noto Sans','DejaVu Sans',sans-serif;fill:#5b6675}"
    ".t{font-size:17px;font-weight:600;fill:#1c2430}.n{fill:#1c2430;font-weight:600}"
    ".g{stroke:#e3e7ec;fill:none}.f{stroke:#8a94a3;fill:none}.l{stroke:#c2185b;stroke-dasharray:5 4;fill:none}"
    ".p{fill:none;stroke-linecap:round;stroke-width:3.2}.w{fill:none;stroke-linejoin:round}"
)


@dataclass(frozen=True, slots=True)
class Panel:
    """A frame and what its values are: `low` and `high` of x and y at its edges."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]
    title: str
    left: float = LEFT
    width: float = INNER

    def across(self, value: Floats) -> Floats:
        """Pixels."""
        return self.left + (value - self.x[0]) / (self.x[1] - self.x[0]) * self.width

    def down(self, value: Floats) -> Floats:
        """Pixels."""
        return self.top + self.height - (value - self.y[0]) / (self.y[1] - self.y[0]) * self.height

    def frame(self, x_label: Callable[[float], str] | None, y_label: Callable[[float], str]) -> Iterator[str]:
        """Lines and numbers at round values; without `x_label` no numbers below."""
        bottom = self.top + self.height
        for x in _round_values(*self.x, max(2, round(self.width / 94))):
            at = float(self.across(np.array(x)))
            yield f'<path class="g" d="M{at:.1f} {self.top}V{bottom}"/>'
            if x_label is not None:
                yield f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{x_label(x)}</text>'
        for y in _round_values(*self.y, 9 if self.height > STRIP_HEIGHT else 5):
            at = float(self.down(np.array(y)))
            yield f'<path class="g" d="M{self.left} {at:.1f}h{self.width}"/>'
            yield f'<text x="{self.left - 7}" y="{at + 4:.1f}" text-anchor="end">{y_label(y)}</text>'
        yield f'<rect class="f" x="{self.left}" y="{self.top}" width="{self.width}" height="{self.height}"/>'
        yield f'<text class="n" x="{self.left}" y="{self.top - 7}">{html.escape(self.title)}</text>'

    def dots(self, x: Floats, y: Floats, word: NDArray[np.str_], colours: Mapping[str, str]) -> Iterator[str]:
        """A dot for each point (n,) inside the frame, by its word, in the order of `colours`; points on one spot are
        drawn once."""
        inside = (x >= self.x[0]) & (x <= self.x[1]) & (y >= self.y[0]) & (y <= self.y[1])
        for name, colour in colours.items():
            mine = inside & (word == name)
            if mine.any():
                at = np.unique(
                    np.round(2.0 * np.column_stack((self.across(x[mine]), self.down(y[mine])))), axis=0
                )
                marks = "".join(f"M{a:g} {b:g}h0" for a, b in (at / 2.0).tolist())
                yield f'<path class="p" stroke="{colour}" d="{marks}"/>'

    def lines(self, lines_m: Iterable[Floats], colour: str, width: float = 1.0) -> Iterator[str]:
        """Lines of points (k, 2), cut at the frame; a point that is NaN ends a line."""
        pieces = [piece for line in lines_m for piece in _pieces(line)]
        if not pieces:
            return
        marks = "".join("M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in self._at(piece)) for piece in pieces)
        name = f"c{self.left:.0f}-{self.top:.0f}"
        yield (
            f'<clipPath id="{name}"><rect x="{self.left}" y="{self.top}" width="{self.width}" '
            f'height="{self.height}"/></clipPath><path class="w" clip-path="url(#{name})" stroke="{colour}" '
            f'stroke-width="{width:g}" d="{marks}"/>'
        )

    def image(self, png: bytes) -> str:
        """A picture that fills the frame."""
        data = base64.b64encode(png).decode("ascii")
        return (
            f'<image x="{self.left}" y="{self.top}" width="{self.width}" height="{self.height}" '
            f'preserveAspectRatio="none" href="data:image/png;base64,{data}"/>'
        )

    def _at(self, line: Floats) -> list[list[float]]:
        at: list[list[float]] = np.column_stack((self.across(line[:, 0]), self.down(line[:, 1]))).tolist()
        return at


def square_panel(points_m: Floats, top: float, height: float, title: str, width: float = INNER) -> Panel:
    """One scale for both directions, all of the points (n, 2) inside."""
    low, high = np.zeros(2), np.zeros(2)
    if len(points_m):
        low, high = points_m.min(axis=0), points_m.max(axis=0)
    middle = 0.5 * (low + high)
    m_a_pixel = max(float(high[0] - low[0]) / width, float(high[1] - low[1]) / height, 1e-4) * 1.08
    half = 0.5 * m_a_pixel * np.array([width, height])
    (left, south), (right, north) = (middle - half).tolist(), (middle + half).tolist()
    return Panel(top, height, (left, right), (south, north), title, width=width)


def strip_tops(count: int) -> list[float]:
    """Where strips below a track begin."""
    return [TOP + TRACK_HEIGHT + SPACE + k * (STRIP_HEIGHT + SPACE) for k in range(count)]


def heading(title: str, words: Sequence[tuple[str, str | None]]) -> Iterator[str]:
    """The title, and to the right words, each with its colour or with none, the last of them first."""
    yield f'<text class="t" x="{LEFT}" y="26">{html.escape(title)}</text>'
    x = LEFT + INNER
    for text, colour in words:
        yield f'<text x="{x}" y="26" text-anchor="end">{html.escape(text)}</text>'
        x -= 7 * len(text) + 14
        if colour is not None:
            yield f'<circle cx="{x + 5}" cy="22" r="5" fill="{colour}"/>'
        x -= 12


def document(parts: Iterable[str], height: float, below: str = "") -> str:
    """The whole picture, with a line of text at its lower end."""
    said = f'<text x="{LEFT + INNER / 2}" y="{height - 6}" text-anchor="middle">{html.escape(below)}</text>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}">'
        f'<style>{_STYLE}</style><rect width="{WIDTH}" height="{height}" fill="#fff"/>\n'
        + "\n".join((*parts, said))
        + "\n</svg>\n"
    )


def limits(values: Floats, least_range: float) -> tuple[float, float]:
    """A little more than the range of finite values (n,)."""
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    half = 0.54 * max(high - low, least_range)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def short(value: float) -> str:
    """A number as short as it is."""
    return f"{value:.10g}" if abs(value) > 1e-9 else "0"


def _pieces(line: Floats) -> list[Floats]:
    """The parts of a line between points that are NaN."""
    known = np.isfinite(line).all(axis=1)
    cuts = np.flatnonzero(np.diff(known)) + 1
    return [part for part in np.split(line, cuts) if len(part) > 1 and np.isfinite(part[0]).all()]


def _round_values(low: float, high: float, most: int) -> list[float]:
    """At most so many, 1, 2 or 5 times a power of ten apart."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]

"""The shared look of all figures. matplotlib is the extra `plots`: it is imported when a figure is drawn, never before.

Text stays text in SVG, points are rasterized where there may be many, and the same data give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

WIDTH_IN = 10.4
"""Width of every figure of a page."""
PRIMARY, GREEN, AMBER, ORANGE, RED, PURPLE = "#1f6fb2", "#2fa79b", "#d99a1c", "#dc5a2c", "#c2185b", "#8e7cc3"
INK, GREY, PALE = "#1c2430", "#5b6675", "#a9b1bc"
_TRACK_IN, _STRIP_IN = 5.6, 1.3
_SPACE_IN = 0.44  # between panels, with room for a title
_TOP_IN, _BOTTOM_IN, _LEFT_IN, _RIGHT_IN = 0.64, 0.5, 0.74, 0.24
_SCALE_SHARE = 0.2  # of a map's width: the longest bar of its scale; chosen: a quarter would meet the key
_DPI = 150  # chosen: rasterized points stay sharp at double zoom
_STYLE: dict[Any, Any] = {
    "axes.edgecolor": "#8a94a3",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "font.size": 9,
    "grid.color": "#e3e7ec",
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "camber",
    "text.parse_math": False,  # names of drives may hold dollar signs
    "xtick.color": GREY,
    "ytick.color": GREY,
}


def require_matplotlib() -> None:
    """Raise ModuleNotFoundError where it is missing, before hours of work; `camber` reports it with its extra."""
    import matplotlib  # noqa: F401


@contextmanager
def plot_style() -> Iterator[None]:
    """Camber's style for figures that are created inside."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def track_and_strips(title: str, strips: int) -> tuple[Figure, Axes, list[Axes]]:
    """A figure with one large panel for a track in the plane, and strips over time below it."""
    figure, axes = stacked_panels(title, [_TRACK_IN, *[_STRIP_IN] * strips])
    track, *rest = axes
    for strip in rest[:-1]:
        strip.sharex(rest[-1])
        strip.tick_params(labelbottom=False)
    return figure, track, rest


def stacked_panels(title: str, heights_in: list[float], below_in: float = 0.0) -> tuple[Figure, list[Axes]]:
    """A figure with panels one below the other; `below_in` leaves room under the last one."""
    from matplotlib.figure import Figure

    height_in = _TOP_IN + sum(heights_in) + _SPACE_IN * (len(heights_in) - 1) + _BOTTOM_IN + below_in
    figure = Figure(figsize=(WIDTH_IN, height_in))
    figure.text(_LEFT_IN / WIDTH_IN, 1.0 - 0.3 / height_in, title, fontsize=13, fontweight="bold", color=INK)
    axes, top_in = [], height_in - _TOP_IN
    for panel_in in heights_in:
        top_in -= panel_in
        width = 1.0 - (_LEFT_IN + _RIGHT_IN) / WIDTH_IN
        axes.append(figure.add_axes((_LEFT_IN / WIDTH_IN, top_in / height_in, width, panel_in / height_in)))
        top_in -= _SPACE_IN
    return figure, axes


def equal_limits(axes: Axes, points: Floats) -> None:
    """Set limits with one scale for both axes and all finite points (n, 2) inside, 4 % away from the edges."""
    box, inches = axes.get_position(), axes.get_figure(root=True).get_size_inches()  # type: ignore[union-attr]
    size = np.array([box.width, box.height]) * inches
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = (finite.min(axis=0), finite.max(axis=0)) if len(finite) else (np.zeros(2), np.zeros(2))
    half = 0.54 * max(float(((high - low) / size).max()), 1e-3) * size
    (left, south), (right, north) = (0.5 * (low + high) - half).tolist(), (0.5 * (low + high) + half).tolist()
    axes.set_xlim(left, right)
    axes.set_ylim(south, north)


def draw_scale_and_north(axes: Axes) -> None:
    """A bar of a round length at the lower left and an arrow to the north at the upper right of a map in metres.

    The axes' limits must be set.
    """
    west_m, east_m = axes.get_xlim()
    most_m = _SCALE_SHARE * (east_m - west_m)
    decade_m = 10.0 ** np.floor(np.log10(most_m))
    length_m = max(step * decade_m for step in (1.0, 2.0, 5.0) if step * decade_m <= most_m)
    share = length_m / (east_m - west_m)
    box: dict[str, Any] = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 2.0}
    axes.plot([0.03, 0.03 + share], [0.03, 0.03], color=INK, lw=3.0, transform=axes.transAxes, zorder=5)
    text = f"{length_m / 1000.0:g} km" if length_m >= 1000.0 else f"{length_m:g} m"
    axes.text(0.03, 0.042, text, color=INK, transform=axes.transAxes, va="bottom", bbox=box, zorder=5)
    arrow = {"arrowstyle": "-|>", "color": INK, "mutation_scale": 16}
    at, ends = "axes fraction", {"xy": (0.97, 0.98), "xytext": (0.97, 0.88)}
    axes.annotate("N", **ends, xycoords=at, ha="center", color=INK, arrowprops=arrow, bbox=box, zorder=5)  # type: ignore[arg-type]


def range_limits(values: Floats, least_range: float) -> tuple[float, float]:
    """The range of finite values (n,) with a margin of 4 % on each side."""
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    half = 0.54 * max(high - low, least_range)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def use_log_scale(axis: Axis, low: float, high: float) -> None:
    """Logarithmic, with plain numbers at powers of ten (exponents would need math text)."""
    from matplotlib.ticker import NullFormatter, StrMethodFormatter

    if axis is axis.axes.xaxis:
        axis.axes.set(xscale="log", xlim=(low, high))
    else:
        axis.axes.set(yscale="log", ylim=(low, high))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_dots(
    axes: Axes, x: Floats, y: Floats, *, classes: NDArray[np.str_], colours: Mapping[str, str]
) -> None:
    """Draw a dot for each point (n,) in the colour of its class, in the order of `colours`."""
    for name, colour in colours.items():
        chosen = (classes == name) & np.isfinite(x) & np.isfinite(y)
        if chosen.any():
            axes.plot(x[chosen], y[chosen], ".", color=colour, ms=4, mew=0, label=name, rasterized=True)


def draw_lines(
    axes: Axes, lines: Iterable[Floats], colour: str, width: float, *, antialiased: bool = True
) -> None:
    """Draw lines of points (k, 2) without changing the limits."""
    from matplotlib.collections import LineCollection

    collection = LineCollection(list(lines), colors=colour, linewidths=width, antialiaseds=antialiased)
    axes.add_collection(collection, autolim=False)


def draw_key(axes: Axes, colours: Mapping[str, str]) -> None:
    """Write what colours mean above the panel's right end, in one row; `_` in names becomes a space."""
    from matplotlib.lines import Line2D

    marks = [Line2D([], [], marker="o", ls="", ms=5, mew=0, color=colour) for colour in colours.values()]
    axes.legend(
        marks,
        [name.replace("_", " ") for name in colours],
        ncols=max(len(marks), 1),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderpad=0.0,
        handletextpad=0.1,
        columnspacing=1.0,
    )


def svg_text(figure: Figure) -> str:
    """The figure as SVG."""
    file = io.BytesIO()
    with plot_style():
        figure.savefig(file, format="svg", dpi=_DPI, metadata={"Date": None})
    return file.getvalue().decode("utf-8")


def png_bytes(figure: Figure, dpi: float, *, software: str) -> bytes:
    """The figure as PNG, drawn by Agg, which names in its first bytes what it was made with."""
    file = io.BytesIO()
    with plot_style():
        figure.savefig(file, format="png", dpi=dpi, metadata={"Software": software})
    return file.getvalue()

"""Random places on lanes of an OpenDRIVE file with their heights, evaluated one by one from the XML.

A second reading, to check the import with: it shares no function with `opendrive` and `opendrive_geometry`, and goes
from road coordinates s, t to x, y, z by chords and closed forms, where those integrate and cut into cross-sections.
Source: ASAM OpenDRIVE 1.8.0, chapters 9 to 11; 1.4H, 5.3.6.2.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Element = ElementTree.Element

_CHORDS = 20_000  # chosen: of a polynomial of 1 km, 5 cm each; chords are then short by micrometres
_SIMPSON_M = 0.2  # chosen: error of a clothoid of any road far below a micrometre


@dataclass(frozen=True, slots=True, kw_only=True)
class LanePlace:
    """A place on a lane: `name` as the import names the lane, `at` where on it; x, y, z [m], NaN where unreadable."""

    name: str
    at: str
    x_m: float
    y_m: float
    z_m: float


def lane_places(data: bytes, types: frozenset[str], count: int, rng: np.random.Generator) -> list[LanePlace]:
    """Return `count` places on lanes of some types, by length. Empty where no lane can be read."""
    root = ElementTree.fromstring(data)
    lanes = [lane for road in root.iterfind("{*}road") for lane in _lanes(road, types)]
    length_m = np.array([lane.end_m - lane.begin_m for lane in lanes])
    if not len(lanes) or not length_m.sum() > 0.0:
        return []
    shift = _shift(root)
    chosen = rng.choice(len(lanes), count, p=length_m / length_m.sum())
    shares = rng.uniform(0.0, 1.0, (count, 2))
    curves: dict[Element, tuple[Floats, Floats]] = {}
    return [_place(lanes[k], share, shift, curves) for k, share in zip(chosen, shares.tolist(), strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _XmlLane:
    road: Element
    section: Element
    lane: Element
    number: int
    begin_m: float
    end_m: float


def _lanes(road: Element, types: frozenset[str]) -> Iterator[_XmlLane]:
    sections = list(road.iterfind("{*}lanes/{*}laneSection"))
    try:
        starts = [float(section.get("s", "")) for section in sections] + [float(road.get("length", ""))]
    except ValueError:
        return
    for number, section in enumerate(sections):
        if not 1e-3 < starts[number + 1] - starts[number] < 1e6:
            continue
        for lane in section.iterfind("*/{*}lane"):
            if lane.get("type") in types and lane.get("id") != "0":
                yield _XmlLane(
                    road=road,
                    section=section,
                    lane=lane,
                    number=number,
                    begin_m=starts[number],
                    end_m=starts[number + 1],
                )


def _shift(root: Element) -> tuple[float, float, float]:
    offset = root.find("{*}header/{*}offset")
    if offset is None:
        return 0.0, 0.0, 0.0
    x, y, z = (float(offset.get(key, "0")) for key in ("x", "y", "z"))
    return x, y, z


def _place(
    lane: _XmlLane,
    share: Sequence[float],
    shift: tuple[float, float, float],
    curves: dict[Element, tuple[Floats, Floats]],
) -> LanePlace:
    s = lane.begin_m + share[0] * (lane.end_m - lane.begin_m)
    try:
        x, y, z = _lane_point(lane, s, share[1], curves)
    except (ValueError, TypeError, OverflowError, ZeroDivisionError, StopIteration):
        x = y = z = math.nan
    return LanePlace(
        name=f"road {lane.road.get('id', '')}, section {lane.number}, lane {lane.lane.get('id')}",
        at=f"s {s:.3f}",
        x_m=x + shift[0],
        y_m=y + shift[1],
        z_m=z + shift[2],
    )


def _lane_point(
    lane: _XmlLane, s: float, across: float, curves: dict[Element, tuple[Floats, Floats]]
) -> tuple[float, float, float]:
    road, ds = lane.road, s - lane.begin_m
    lane_id = int(lane.lane.get("id", ""))
    side = 1 if lane_id > 0 else -1
    by_id = {int(each.get("id", "")): each for each in lane.section.iterfind("*/{*}lane")}
    edge = 0.0  # distance of a lane's outer border from the centre lane
    inner = 0.0
    for k in range(1, abs(lane_id) + 1):
        inner, edge = edge, _outer_edge(by_id[side * k], ds, edge, side)
    t = _value(road.findall("{*}lanes/{*}laneOffset"), s) + side * (inner + across * (edge - inner))
    roll = _value(road.findall("{*}lateralProfile/{*}superelevation"), s)
    hump = _shape(road.findall("{*}lateralProfile/{*}shape"), s, t) - abs(t) * math.tan(
        _crossfall(road, s, t)
    )
    x, y, heading = _reference_point(road, s, curves)
    sideways = t * math.cos(roll) - hump * math.sin(roll)
    z = (
        _value(road.findall("{*}elevationProfile/{*}elevation"), s)
        + t * math.sin(roll)
        + hump * math.cos(roll)
    )
    kerb = _last(lane.lane.findall("{*}height"), ds, "sOffset")
    if kerb is not None:
        low, high = float(kerb.get("inner", "")), float(kerb.get("outer", ""))
        z += low + across * (high - low)
    return x - math.sin(heading) * sideways, y + math.cos(heading) * sideways, z


def _outer_edge(lane: Element, ds: float, inner: float, side: int) -> float:
    widths = lane.findall("{*}width")
    if widths:
        return inner + max(_value(widths, ds, "sOffset"), 0.0)
    return max(side * _value(lane.findall("{*}border"), ds, "sOffset"), inner)


def _last(elements: Sequence[Element], at: float, key: str) -> Element | None:
    """Return the last element that begins at or before a distance."""
    before = [each for each in elements if float(each.get(key, "")) <= at]
    return before[-1] if before else None


def _value(elements: Sequence[Element], at: float, key: str = "s") -> float:
    element = _last(elements, at, key)
    if element is None:
        return 0.0
    ds = at - float(element.get(key, ""))
    return sum(float(element.get(name, "")) * ds**power for power, name in enumerate("abcd"))


def _crossfall(road: Element, s: float, t: float) -> float:
    sides = ("left" if t >= 0.0 else "right", "both")
    falls = road.findall("{*}lateralProfile/{*}crossfall")
    return _value([each for each in falls if each.get("side", "both") in sides], s)


def _shape(shapes: Sequence[Element], s: float, t: float) -> float:
    """Return the height of the lateral shape: linear along between the places where it is given."""
    stations = sorted({float(each.get("s", "")) for each in shapes})
    if not stations:
        return 0.0
    heights = []
    for station in stations:
        rows = sorted((each for each in shapes if float(each.get("s", "")) == station), key=_shape_start)
        row = ([each for each in rows if _shape_start(each) <= t] or rows[:1])[-1]
        dt = t - _shape_start(row)
        heights.append(sum(float(row.get(name, "")) * dt**power for power, name in enumerate("abcd")))
    return float(np.interp(s, stations, heights))


def _shape_start(shape: Element) -> float:
    return float(shape.get("t", ""))


# -- reference line --------------------------------------------------------------------------------------------------


def _reference_point(
    road: Element, s: float, curves: dict[Element, tuple[Floats, Floats]]
) -> tuple[float, float, float]:
    parts = road.findall("{*}planView/{*}geometry")
    part = _last(parts, s, "s")
    if part is None:
        raise ValueError("no geometry")
    x0, y0, heading, length, start = (float(part.get(key, "")) for key in ("x", "y", "hdg", "length", "s"))
    shape = next(child for child in part if child.tag.rpartition("}")[2] in _LOCAL)
    u, v, turn = _LOCAL[shape.tag.rpartition("}")[2]](shape, min(s - start, length), length, curves)
    along, left = (
        complex(math.cos(heading), math.sin(heading)),
        complex(-math.sin(heading), math.cos(heading)),
    )
    place = complex(x0, y0) + u * along + v * left
    return place.real, place.imag, heading + turn


Curves = dict[Element, tuple[Floats, Floats]]


def _on_line(shape: Element, d: float, length: float, curves: Curves) -> tuple[float, float, float]:
    return d, 0.0, 0.0


def _on_arc(shape: Element, d: float, length: float, curves: Curves) -> tuple[float, float, float]:
    curvature = float(shape.get("curvature", ""))
    if abs(curvature) < 1e-12:
        return d, 0.0, 0.0
    turn = curvature * d
    return math.sin(turn) / curvature, (1.0 - math.cos(turn)) / curvature, turn


def _on_spiral(shape: Element, d: float, length: float, curves: Curves) -> tuple[float, float, float]:
    """Simpson's rule over the direction."""
    begin, end = float(shape.get("curvStart", "")), float(shape.get("curvEnd", ""))
    count = 2 * max(int(d / _SIMPSON_M), 8)
    at = np.linspace(0.0, d, count + 1)
    turn = begin * at + (end - begin) / (2.0 * length) * at**2
    weights = np.ones(count + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    step = d / count / 3.0
    return float(weights @ np.cos(turn)) * step, float(weights @ np.sin(turn)) * step, float(turn[-1])


def _on_poly3(shape: Element, d: float, length: float, curves: Curves) -> tuple[float, float, float]:
    cubic = np.array([float(shape.get(key, "")) for key in "abcd"])
    if shape not in curves:
        u = np.linspace(0.0, length, _CHORDS + 1)
        curves[shape] = u, _chords(u, np.polynomial.polynomial.polyval(u, cubic))
    u_of, along = curves[shape]
    at = float(np.interp(d, along, u_of))
    slope = np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyder(cubic))
    return at, float(np.polynomial.polynomial.polyval(at, cubic)), math.atan(slope)


def _on_param_poly3(shape: Element, d: float, length: float, curves: Curves) -> tuple[float, float, float]:
    """The share of the curve's length that d is of the length stated."""
    cubics = [np.array([float(shape.get(name + axis, "")) for name in "abcd"]) for axis in "UV"]
    last = length if shape.get("pRange") == "arcLength" else 1.0
    if shape not in curves:
        p = np.linspace(0.0, last, _CHORDS + 1)
        curves[shape] = p, _chords(*(np.polynomial.polynomial.polyval(p, cubic) for cubic in cubics))
    p_of, along = curves[shape]
    at = float(np.interp(d / length * along[-1], along, p_of))
    u, v = (float(np.polynomial.polynomial.polyval(at, cubic)) for cubic in cubics)
    du, dv = (
        float(np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyder(cubic)))
        for cubic in cubics
    )
    return u, v, math.atan2(dv, du)


def _chords(u: Floats, v: Floats) -> Floats:
    return np.append(0.0, np.cumsum(np.hypot(np.diff(u), np.diff(v))))


_LOCAL = {
    "line": _on_line,
    "arc": _on_arc,
    "spiral": _on_spiral,
    "poly3": _on_poly3,
    "paramPoly3": _on_param_poly3,
}
"""Shapes of a geometry: from the distance along it to u, v and the direction in its axes."""

"""Geometry of OpenDRIVE roads: reference line, lane borders, heights.

Source: ASAM OpenDRIVE 1.8.0, chapters 9 (geometries), 10.4–10.5 (elevation, superelevation, lateral shape), 11 (lanes;
11.6: a lane's height is an offset in z that is valid until the next one); 1.4H, 5.3.6.2 (crossfall). Spirals are
integrated by Gauss-Legendre quadrature from station to station, with eight nodes for at most half a metre: exact to
rounding for every curvature of a road.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.opendrive import LaneSection, OpenDriveLane, OpenDriveRoad, PlanViewGeometry

Floats = NDArray[np.float64]

MOST_POINTS = 400_000
"""Cross-sections of one lane section; chosen: 20 km at 0.05 m."""
SLIVER_M = 1e-4
"""Lane sections that are shorter have no surface: writers leave them where they split a road; chosen: rounding."""
_CHORD_M = 2.5e-4  # chosen: half the 0.5 mm within which the grids of `lane_pieces` follow a lane
_LONGEST_STEP_M, _SHORTEST_STEP_M = 1.0, 0.05
_GAP_M = 0.5  # chosen: published maps have gaps of centimetres from rounding; a larger one is an error
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_ACROSS = 9  # chosen: points across a lane whose cross-section is curved
_STEEPEST_RAD = 1.0  # chosen: bounds the tangent; no road has such a crossfall


def reference_line(road: OpenDriveRoad, s_m: Floats) -> Floats:
    """Return x, y [m] and heading [rad] (n, 3) of the reference line at ascending distances (n,)."""
    starts = np.array([part.s_m for part in road.geometries])
    which = np.clip(np.searchsorted(starts, s_m, "right") - 1, 0, len(starts) - 1)
    line = np.zeros((len(s_m), 3))
    for k in np.unique(which).tolist():
        rows = which == k
        line[rows] = _along(road.geometries[k], s_m[rows] - starts[k])
    return line


def cubics_at(table: Floats, s_m: Floats) -> Floats:
    """Evaluate cubics (k, 5) at distances (n,); 0 before the first."""
    if not len(table):
        return np.zeros(len(s_m))
    which = np.searchsorted(table[:, 0], s_m, "right") - 1
    s, a, b, c, d = table[np.maximum(which, 0)].T
    ds = s_m - s
    values: Floats = np.where(which >= 0, a + ds * (b + ds * (c + ds * d)), 0.0)
    return values


def section_span(road: OpenDriveRoad, number: int) -> tuple[float, float]:
    """Return start and end of a lane section."""
    end = road.sections[number + 1].s_m if number + 1 < len(road.sections) else road.length_m
    return road.sections[number].s_m, end


def is_sliver(road: OpenDriveRoad, number: int) -> bool:
    """Return whether a lane section is too short to be a part of the road."""
    begin, end = section_span(road, number)
    return abs(end - begin) < SLIVER_M


def stations(road: OpenDriveRoad, number: int, file: str) -> Floats:
    """Return the distances of a section's cross-sections: its breakpoints, and more between them in curves."""
    begin, end = section_span(road, number)
    name = f"road {road.identity}, laneSection at s {begin:g}"
    if not 0.0 <= begin < end <= road.length_m + _GAP_M:
        raise FormatError(file, f"{name}, s", f"less than the next one and the length {road.length_m:g}")
    breaks = [[begin, end], [part.s_m for part in road.geometries]]
    profiles = (
        road.elevation, road.superelevation, road.crossfall_left, road.crossfall_right, road.shape, road.lane_offset,
    )  # fmt: skip
    breaks += [table[:, 0].tolist() for table in profiles]
    breaks += [
        (begin + table[:, 0]).tolist()
        for lane in road.sections[number].lanes
        for table in (lane.widths, lane.borders)
    ]
    steps = [(begin + lane.heights[:, 0]).tolist() for lane in road.sections[number].lanes]
    steps += [_steps(table) for table in profiles if table.shape[1] == 5]
    # Before a step there is a cross-section too, a millimetre earlier: else the metre before it would be a ramp.
    breaks += [[s - 1e-3 * k for s in step for k in (0, 1)] for step in steps]
    at = np.unique(np.concatenate([np.asarray(part, np.float64) for part in breaks]))
    at = at[(at >= begin) & (at <= end)]
    at = at[np.concatenate(([True], np.diff(at) > SLIVER_M))]
    if len(at) < 2:
        raise FormatError(file, f"{name}, s", "a section longer than 0.1 mm")
    step_m = np.array([_step(road, float(a), float(b)) for a, b in pairwise(at)])
    parts = np.maximum(np.ceil(np.diff(at) / step_m), 1.0)
    if parts.sum() > MOST_POINTS:
        raise FormatError(file, f"{name}", f"at most {MOST_POINTS} cross-sections")
    pieces = [a + (b - a) * np.arange(n) / n for (a, b), n in zip(pairwise(at), parts.tolist(), strict=True)]
    return np.concatenate([*pieces, at[-1:]])


def _steps(table: Floats) -> list[float]:
    """Return where a profile of cubics (k, 5) jumps by more than a tenth of a millimetre (or a tenth of a mrad)."""
    jumps = []
    for before, after in pairwise(table):
        ds = after[0] - before[0]
        if abs(before[1] + ds * (before[2] + ds * (before[3] + ds * before[4])) - after[1]) > 1e-4:
            jumps.append(float(after[0]))
    return jumps


def lane_points(
    road: OpenDriveRoad,
    number: int,
    s_m: Floats,
    file: str,
    *,
    errors: dict[int, FormatError] | None = None,
) -> dict[int, Floats]:
    """Return for each lane of a section the points (n, k, 3), x, y, z [m], at stations (n,), from its right to its left
    border in the direction of the road.

    An invalid lane raises FormatError; with `errors` it is entered there and has no points, nor have the lanes outside
    of it, whose place depends on its width.
    """
    section = road.sections[number]
    line = _checked_line(road, s_m, file)
    offset_m = cubics_at(road.lane_offset, s_m)
    flat = not (len(road.shape) or len(road.crossfall_left) or len(road.crossfall_right))
    across = np.linspace(0.0, 1.0, 2 if flat else _ACROSS)
    points: dict[int, Floats] = {}
    for side in (1, -1):
        inner = offset_m
        lanes = sorted(
            (each for each in section.lanes if each.lane_id * side > 0), key=lambda each: abs(each.lane_id)
        )
        for k, lane in enumerate(lanes):
            try:
                width_m = _checked_width_m(
                    road, section, lane, s_m=s_m, inner_m=side * (inner - offset_m), file=file
                )
            except FormatError as error:
                if errors is None:
                    raise
                errors |= {each.lane_id: error for each in lanes[k:]}
                break
            outer = inner + side * width_m
            right, left = (inner, outer) if side > 0 else (outer, inner)
            at = _points(road, line, s_m, right[:, None] + (left - right)[:, None] * across)
            at[:, :, 2] += _lane_heights(lane, s_m - section.s_m, across if side > 0 else across[::-1])
            points[lane.lane_id] = at
            inner = outer
    return points


def _checked_line(road: OpenDriveRoad, s_m: Floats, file: str) -> Floats:
    line = reference_line(road, s_m)
    gap_m = np.hypot(*np.diff(line[:, :2], axis=0).T) - np.diff(s_m)
    if not np.isfinite(line).all() or (gap_m > _GAP_M).any():
        at = float(s_m[int(np.argmax(np.append(gap_m, 0.0) > _GAP_M))])
        raise FormatError(file, f"road {road.identity}, planView", f"no gap after s {at:.2f}")
    _check_lengths(road, file)
    return line


def _checked_width_m(
    road: OpenDriveRoad, section: LaneSection, lane: OpenDriveLane, *, s_m: Floats, inner_m: Floats, file: str
) -> Floats:
    if lane.error is not None:
        raise lane.error
    width_m = _width_m(lane, s_m - section.s_m, inner_m)
    if width_m is None:
        raise FormatError(file, _lane_name(road, section, lane), "a width or a border")
    if not ((width_m > -0.05) & (width_m < 500.0)).all():
        worst_m = width_m[np.argmax(np.abs(width_m))]
        raise FormatError(
            file, f"{_lane_name(road, section, lane)}, width", "0 to 500", actual=f"{worst_m:.3g}"
        )
    return np.maximum(width_m, 0.0)


def _lane_heights(lane: OpenDriveLane, ds: Floats, share: Floats) -> Floats:
    """Return how far a lane (n, k) is above the road, at shares (k,) of its width from the inner border."""
    if not len(lane.heights):
        return np.zeros((len(ds), len(share)))
    # 10 µm of slack: a distance from the section's start is rounded.
    which = np.searchsorted(lane.heights[:, 0], ds + 0.1 * SLIVER_M, "right") - 1
    inner_m, outer_m = lane.heights[np.maximum(which, 0), 1:].T
    heights: Floats = inner_m[:, None] * (1.0 - share) + outer_m[:, None] * share
    return np.where((which >= 0)[:, None], heights, 0.0)


def _check_lengths(road: OpenDriveRoad, file: str) -> None:
    """Refuse a paramPoly3 that is longer or shorter than it says: places along it, and so heights, are not known."""
    for part in road.geometries:
        if part.shape == "paramPoly3":
            length_m = float(_arc_lengths(part)[0][-1])
            if not abs(length_m - part.length_m) <= _GAP_M:
                field = f"road {road.identity}, geometry at s {part.s_m:g}, length"
                raise FormatError(file, field, f"its curve's, {length_m:.2f}", actual=f"{part.length_m:g}")


def _width_m(lane: OpenDriveLane, ds: Floats, inner_m: Floats) -> Floats | None:
    """Return the width (n,) of a lane, `inner_m` being the distance of its inner border from the lane offset."""
    if len(lane.widths):
        return cubics_at(lane.widths, ds)
    side = 1.0 if lane.lane_id > 0 else -1.0
    return side * cubics_at(lane.borders, ds) - inner_m if len(lane.borders) else None


def _lane_name(road: OpenDriveRoad, section: LaneSection, lane: OpenDriveLane) -> str:
    return f"road {road.identity}, laneSection at s {section.s_m:g}, lane {lane.lane_id}"


def _points(road: OpenDriveRoad, line: Floats, s_m: Floats, t_m: Floats) -> Floats:
    """Return x, y, z (n, k, 3) of points at offsets t (n, k) from the reference line (n, 3).

    Superelevation turns the cross-section about the reference line; positive: left side up.
    """
    above_m = _shape_heights(road.shape, s_m, t_m) + _crossfall_heights(road, s_m, t_m)
    roll = np.clip(cubics_at(road.superelevation, s_m), -_STEEPEST_RAD, _STEEPEST_RAD)[:, None]
    lateral_m = t_m * np.cos(roll) - above_m * np.sin(roll)
    z = cubics_at(road.elevation, s_m)[:, None] + t_m * np.sin(roll) + above_m * np.cos(roll)
    x = line[:, :1] - np.sin(line[:, 2:]) * lateral_m
    y = line[:, 1:2] + np.cos(line[:, 2:]) * lateral_m
    return np.stack((x, y, z), axis=2)


def _crossfall_heights(road: OpenDriveRoad, s_m: Floats, t_m: Floats) -> Floats:
    """Return heights of the crossfall, which descends from the reference line to both sides."""
    falls = [cubics_at(table, s_m)[:, None] for table in (road.crossfall_left, road.crossfall_right)]
    left, right = (np.tan(np.clip(fall, -_STEEPEST_RAD, _STEEPEST_RAD)) for fall in falls)
    heights: Floats = np.where(t_m >= 0.0, -left, right) * t_m
    return heights


def _shape_heights(shape: Floats, s_m: Floats, t_m: Floats) -> Floats:
    if not len(shape):
        return np.zeros(t_m.shape)
    places = np.unique(shape[:, 0])
    over = [_over_t(shape[shape[:, 0] == s], t_m) for s in places]
    after = np.clip(np.searchsorted(places, s_m, "right"), 1, max(len(places) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(places) - 1)
    run = np.maximum(places[after] - places[before], 1e-9)
    share = np.clip((s_m - places[before]) / run, 0.0, 1.0)[:, None]
    rows, table = np.arange(len(s_m)), np.stack(over)
    heights: Floats = table[before, rows] * (1.0 - share) + table[after, rows] * share
    return heights


def _over_t(rows: Floats, t_m: Floats) -> Floats:
    """Evaluate the polynomials over t (n, k) at one s; the first also before its start."""
    which = np.maximum(np.searchsorted(rows[:, 1], t_m.ravel(), "right") - 1, 0)
    _, t, a, b, c, d = rows[which].T
    dt = t_m.ravel() - t
    return np.asarray(a + dt * (b + dt * (c + dt * d))).reshape(t_m.shape)


def _step(road: OpenDriveRoad, begin: float, end: float) -> float:
    """Return the distance of cross-sections at which chords deviate from the road by at most _CHORD_M."""
    middle = 0.5 * (begin + end)
    starts = [part.s_m for part in road.geometries]
    part = road.geometries[max(int(np.searchsorted(starts, middle, "right")) - 1, 0)]
    bend = _bend(part)
    for table in (road.elevation, road.superelevation):
        rows = table[np.searchsorted(table[:, 0], middle, "right") - 1] if len(table) else np.zeros(5)
        ends = (begin - rows[0], end - rows[0])
        scale = 1.0 if table is road.elevation else 10.0  # borders are about as far from the reference line
        bend = max(bend, *(scale * abs(2.0 * rows[3] + 6.0 * rows[4] * ds) for ds in ends))
    return float(np.clip(math.sqrt(8.0 * _CHORD_M / max(bend, 1e-9)), _SHORTEST_STEP_M, _LONGEST_STEP_M))


def _bend(part: PlanViewGeometry) -> float:
    """Return the largest curvature of a geometry, approximately for polynomials."""
    if part.shape in ("arc", "spiral"):
        return max(map(abs, part.numbers))
    if part.shape == "line" or part.length_m <= 0.0:
        return 0.0
    s = np.linspace(0.0, part.length_m, 33)
    heading = np.unwrap(_along(part, s)[:, 2])
    return float(np.abs(np.diff(heading)).max() / (s[1] - s[0]))


# -- geometries ------------------------------------------------------------------------------------------------------


def _along(part: PlanViewGeometry, s: Floats) -> Floats:
    """Return x, y, heading (n, 3) at ascending distances s (n,) from the geometry's start."""
    match part.shape:
        case "line" | "arc" | "spiral":
            c0 = part.numbers[0] if part.numbers else 0.0
            c1 = part.numbers[-1] if part.numbers else 0.0
            rate = (c1 - c0) / part.length_m if part.length_m > 0.0 else 0.0
            turn = s * (c0 + 0.5 * rate * s)
            u, v = _integrated(s, c0, rate)
        case "poly3":
            u = _abscissa(part.numbers, s, part.length_m)
            a, b, c, d = part.numbers
            v = a + u * (b + u * (c + u * d))
            turn = np.arctan(b + u * (2.0 * c + 3.0 * d * u))
        case _:
            table_m, table_p = _arc_lengths(part)
            # Scaled to @length, which writers round: the geometry ends where p does and the next one begins.
            p = np.interp(s, table_m * (part.length_m / max(table_m[-1], 1e-9)), table_p)
            (u, du), (v, dv) = (_parametric(part.numbers[k : k + 4], p) for k in (0, 4))
            turn = np.arctan2(dv, du)
    cos, sin = math.cos(part.heading_rad), math.sin(part.heading_rad)
    return np.column_stack(
        (part.x_m + cos * u - sin * v, part.y_m + sin * u + cos * v, part.heading_rad + turn)
    )


def _integrated(s: Floats, c0: float, rate: float) -> tuple[Floats, Floats]:
    """Return u, v (n,) at ascending distances s (n,) along a clothoid of curvature c0 + rate · s."""
    stops = np.concatenate(([0.0], s))
    pieces = np.maximum(np.ceil(np.abs(np.diff(stops)) / 0.5), 1.0).astype(int)
    edges = np.concatenate(
        [a + (b - a) * np.arange(n) / n for (a, b), n in zip(pairwise(stops), pieces.tolist(), strict=True)]
        + [stops[-1:]]
    )
    half = 0.5 * np.diff(edges)
    at = (edges[:-1] + half)[:, None] + half[:, None] * _NODES
    turn = at * (c0 + 0.5 * rate * at)
    last = np.cumsum(pieces)
    u, v = (
        np.concatenate(([0.0], np.cumsum((f(turn) * _WEIGHTS).sum(axis=1) * half)))[last]
        for f in (np.cos, np.sin)
    )
    return u, v


def _abscissa(numbers: Sequence[float], s: Floats, length_m: float) -> Floats:
    """Return u (n,) of a cubic v(u) at arc lengths s (n,)."""
    u = np.linspace(0.0, max(length_m, 1e-9), _table_steps(length_m) + 1)
    _, slope = _parametric(numbers, u)
    return np.interp(s, _cumulated(np.sqrt(1.0 + slope**2), u), u)


def _arc_lengths(part: PlanViewGeometry) -> tuple[Floats, Floats]:
    """Return arc lengths [m] and parameters p, both (n,) and ascending, of a paramPoly3.

    p ends at 1 or at @length (ASAM OpenDRIVE 1.8.0, 9.6, pRange). In between it is not proportional to the arc length,
    which s is: a curve that is passed at uneven speed would be metres off along the road, and off in height on a slope.
    """
    p = np.linspace(0.0, 1.0 if part.normalised else part.length_m, _table_steps(part.length_m) + 1)
    (_, du), (_, dv) = (_parametric(part.numbers[k : k + 4], p) for k in (0, 4))
    return _cumulated(np.hypot(du, dv), p), p


def _table_steps(length_m: float) -> int:
    # Chosen: a step of 1 cm, between which the speed of a road's curve is constant to micrometres.
    return int(min(max(length_m / 0.01, 16.0), 1e5))


def _cumulated(speed: Floats, parameter: Floats) -> Floats:
    """Integrate (n,) by the trapezoidal rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(parameter))))


def _parametric(numbers: Sequence[float], p: Floats) -> tuple[Floats, Floats]:
    """Return value and derivative of a cubic."""
    a, b, c, d = numbers
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + 3.0 * d * p)

"""Lanes cut into rectangles with grids of heights.

A piece ends where the lane has turned by 12°, its chord leaves it by 5 cm, its width has changed by 0.4 m, or after
20 m: by the plan alone, so a map with corrected heights has the same surfaces. Its rectangle about the chord holds all
of the piece, so there are no gaps and rectangles overlap a little. Heights between the borders are linear across; the
grid has as many rows and columns as it needs to be within half a millimetre of the lane at all its points, within 3 mm
where that takes many.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camber.formats.errors import FormatError
from camber.road_map.tile_checks import MAX_SLOPE
from camber.tools.maps.importers.lanes import Floats, Integers, Lane

# Chosen: docs/maps.md, from lanes to surfaces; a piece must be nearly straight and of nearly constant width.
_LONGEST_M = 20.0
_TURN_RAD = math.radians(12.0)
_SAGITTA_M = 0.05  # chosen: about the σ of good maps
_WIDENING_M = 0.4  # chosen: a tenth of a lane's width
_STEP_M = 1.0  # chosen: finer than the features of a lane's border
_LEAST_HALF_M = 0.05  # chosen: keeps the rectangle of a lane without length from being empty
_NARROW_M = 0.5
"""Where borders are nearer than this, the slope across is taken as if they were this far apart."""
_FINE_M, _FINE_ROWS, _COARSE_M = 0.0005, 9, 0.003
"""A grid is within _FINE_M where _FINE_ROWS can be; kinks that need more rows are followed to _COARSE_M."""
_ROWS = (2, 3, 5, 9, 17, 33, 65)
MOST_LENGTH_M, MOST_WIDTH_M = 20_000.0, 100.0
"""No lane is larger; a map in which one is has a point somewhere else on earth."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LanePiece:
    """A rectangle in the plane and its grid (rows, columns): rear to front, right to left.

    `off_m`: how far the lane's points are off the grid at most.
    """

    centre_m: Floats
    yaw_rad: float
    half_length_m: float
    half_width_m: float
    heights_m: Floats
    off_m: float


def pieces_of(lane: Lane, file: str) -> list[LanePiece]:
    """The pieces of a lane from its beginning to its end; FormatError for a lane that is no road."""
    sections = _dense(lane, file)
    return [_piece(lane, sections, ends, file) for ends in _cuts(sections)]


def _dense(lane: Lane, file: str) -> Floats:
    """The cross-sections, and more of them between those that are farther apart than _STEP_M."""
    sections = lane.sections
    step_m = np.hypot(*np.moveaxis(np.diff(sections[:, :, :2], axis=0), 2, 0)).max(axis=1)
    parts = np.maximum(np.ceil(step_m / _STEP_M), 1.0)
    width_m = np.hypot(*(sections[:, 0, :2] - sections[:, -1, :2]).T)
    if not (step_m.sum() <= MOST_LENGTH_M and width_m.max() <= MOST_WIDTH_M):
        expected = f"a lane of at most {MOST_LENGTH_M / 1e3:.0f} km, at most {MOST_WIDTH_M:.0f} m wide"
        actual = f"{step_m.sum() / 1e3:.1f} km, {width_m.max():.0f} m"
        raise FormatError(file, lane.name, expected, actual=actual)
    at = np.concatenate([i + np.arange(n) / n for i, n in enumerate(parts.astype(int))] + [[len(step_m)]])
    flat = sections.reshape(len(sections), -1)
    numbers = np.arange(len(flat))
    columns = [np.interp(at, numbers, column) for column in flat.T]
    return np.column_stack(columns).reshape(len(at), *sections.shape[1:])


def _cuts(sections: Floats) -> Iterator[tuple[int, int]]:
    """First and last cross-section of each piece."""
    centre_m = 0.5 * (sections[:, 0, :2] + sections[:, -1, :2])
    step = np.diff(centre_m, axis=0)
    yaw = np.unwrap(np.arctan2(step[:, 1], step[:, 0])).tolist()
    length = np.hypot(*step.T).tolist()
    width = np.hypot(*(sections[:, 0, :2] - sections[:, -1, :2]).T).tolist()
    first, last_end = 0, len(length)
    while first < last_end:
        last, run_m, low, high = first + 1, length[first], yaw[first], yaw[first]
        while last < last_end:
            run = run_m + length[last]
            low_next, high_next = min(low, yaw[last]), max(high, yaw[last])
            turn = high_next - low_next
            if (
                run > _LONGEST_M
                or turn > _TURN_RAD
                or 0.125 * turn * run > _SAGITTA_M
                or abs(width[last + 1] - width[first]) > _WIDENING_M
            ):
                break
            last, run_m, low, high = last + 1, run, low_next, high_next
        yield first, last
        first = last


def _piece(lane: Lane, sections: Floats, ends: tuple[int, int], file: str) -> LanePiece:
    part = sections[ends[0] : ends[1] + 1]
    ends_m = 0.5 * (part[[0, -1], 0, :2] + part[[0, -1], -1, :2])
    yaw_rad = math.atan2(ends_m[1, 1] - ends_m[0, 1], ends_m[1, 0] - ends_m[0, 0])
    axes = np.array([[math.cos(yaw_rad), -math.sin(yaw_rad)], [math.sin(yaw_rad), math.cos(yaw_rad)]])
    uv = (part[:, :, :2] @ axes).reshape(-1, 2)
    low, high = uv.min(axis=0), uv.max(axis=0)
    centre_uv, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), _LEAST_HALF_M)
    lines = _lines(sections, ends, axes=axes, centre_uv=centre_uv, half_m=float(half[0]))
    heights_m, off_m = _grid(lines, part[:, :, 2].ravel(), uv - centre_uv, half)
    slope = [
        np.abs(np.diff(heights_m, axis=a)).max() * (heights_m.shape[a] - 1) / (2.0 * half[a]) for a in (0, 1)
    ]
    if math.hypot(*slope) > MAX_SLOPE:
        place = f"{lane.name}, {sum(slope):.1f} steep"
        raise FormatError(file, "heights", f"a road of slopes up to {MAX_SLOPE:.0f}", actual=place)
    return LanePiece(
        centre_m=axes @ centre_uv,
        yaw_rad=yaw_rad,
        half_length_m=float(half[0]),
        half_width_m=float(half[1]),
        heights_m=heights_m,
        off_m=off_m,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Line:
    """One border (or a line between borders) in the axes of a piece: u ascending, v and height there."""

    u: Floats
    v: Floats
    height_m: Floats

    def at(self, u: Floats) -> tuple[Floats, Floats]:
        """v and height; beyond the ends straight on with the slope of the last metre."""
        v, height_m = np.interp(u, self.u, self.v), np.interp(u, self.u, self.height_m)
        run = min(1.0, float(self.u[-1] - self.u[0]))
        if run > 0.1:
            for end, inner in ((self.u[0], self.u[0] + run), (self.u[-1], self.u[-1] - run)):
                at_end, at_inner = np.interp((end, inner), self.u, self.height_m)
                beyond = u < end if end < inner else u > end
                slope = (at_end - at_inner) / (end - inner)
                height_m = np.where(beyond, at_end + slope * (u - end), height_m)
        return v, height_m

    def within(self, half: Floats) -> Floats:
        """Its points (n, 3) on the rectangle: u, v, height."""
        inside = (np.abs(self.u) <= half[0]) & (np.abs(self.v) <= half[1])
        points: Floats = np.column_stack((self.u, self.v, self.height_m))[inside]
        return points


def _lines(
    sections: Floats, ends: tuple[int, int], *, axes: Floats, centre_uv: Floats, half_m: float
) -> list[_Line]:
    """The lane's lines along, as far as they go forward in the piece's axes, and no farther than the piece needs."""
    first, last = ends
    before, after = max(first - 30, 0), min(last + 31, len(sections))
    around = sections[before:after]
    uv = around[:, :, :2] @ axes - centre_uv
    lines = []
    for k in range(sections.shape[1]):
        u = uv[:, k, 0]
        forward = np.diff(u) > 0.0
        a, b = first - before, last - before
        while a > 0 and forward[a - 1] and u[a] > -half_m - 1.0:
            a -= 1
        while b < len(u) - 1 and forward[b] and u[b] < half_m + 1.0:
            b += 1
        rows = np.arange(a, b + 1)
        # A border that turns back within the piece, as the inner one of a tight corner, is taken in the order of u.
        rows = rows[np.argsort(u[rows], kind="stable")]
        lines.append(_Line(u=u[rows], v=uv[rows, k, 1], height_m=around[rows, k, 2]))
    return lines


def _grid(lines: list[_Line], height_m: Floats, uv: Floats, half: Floats) -> tuple[Floats, float]:
    """The coarsest grid that is near enough to the lane's points on it, or the best there is; and how far it is.

    The points are those of the piece, `uv` (n, 2) with `height_m` (n,), and those of its neighbours on its rectangle.
    """
    near = [line.within(half) for line in lines]
    uv = np.concatenate([uv, *(points[:, :2] for points in near)])
    height_m = np.concatenate([height_m, *(points[:, 2] for points in near)])
    columns = (2,) if len(lines) == 2 else (2, 3, 5, 9)
    best, least_m = np.zeros((2, 2)), math.inf
    for m in columns:
        v = np.linspace(-half[1], half[1], m)
        for n in _ROWS:
            grid = _across(lines, np.linspace(-half[0], half[0], n), v)
            error_m = float(np.abs(_bilinear(grid, uv, half) - height_m).max())
            if error_m < least_m - 1e-4:
                best, least_m = grid, error_m
            if least_m <= (_FINE_M if n <= _FINE_ROWS else _COARSE_M):
                return best, least_m
    return best, least_m


def _across(lines: list[_Line], u: Floats, v: Floats) -> Floats:
    """Heights (len(u), len(v)): linear between neighbouring lines, straight on beyond the outer ones."""
    at = [line.at(u) for line in lines]
    v_of, h_of = (np.stack([line[i] for line in at], axis=1) for i in (0, 1))
    cell: Integers = np.clip((v[None, :, None] > v_of[:, None, 1:-1]).sum(axis=2), 0, len(lines) - 2)
    rows = np.arange(len(u))[:, None]
    v0, v1, h0, h1 = v_of[rows, cell], v_of[rows, cell + 1], h_of[rows, cell], h_of[rows, cell + 1]
    slope = (h1 - h0) / np.maximum(v1 - v0, _NARROW_M if len(lines) == 2 else 0.02)
    heights: Floats = 0.5 * (h0 + h1) + slope * (v[None, :] - 0.5 * (v0 + v1))
    return heights


def _bilinear(grid: Floats, uv: Floats, half: Floats) -> Floats:
    n, m = grid.shape
    p = np.clip((uv[:, 0] + half[0]) / (2.0 * half[0]) * (n - 1), 0.0, n - 1.0)
    q = np.clip((uv[:, 1] + half[1]) / (2.0 * half[1]) * (m - 1), 0.0, m - 1.0)
    i, j = np.minimum(p.astype(int), n - 2), np.minimum(q.astype(int), m - 2)
    p, q = p - i, q - j
    rear, front = (grid[i + k, j] * (1.0 - q) + grid[i + k, j + 1] * q for k in (0, 1))
    heights: Floats = rear * (1.0 - p) + front * p
    return heights

"""Levels of lanes: what lies over something else is on a higher level.

Lanes are over one another where they are at one place, in the plane, with more than 3 m between their heights. A lane
is on the lowest level that is above all it lies over, 0 where it lies over none; lanes side by side are on one level.
What the map itself says stays; what it does not say fits in. A lane that lies over itself becomes several links.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from camber.formats.errors import FormatError
from camber.road_map.tile_checks import MAX_LEVEL
from camber.tools.maps.importers.lane_pieces import LanePiece
from camber.tools.maps.importers.lanes import Floats, Integers, JoinedSets, Lane

APART_M = 3.0  # chosen: below the clearance of every bridge for vehicles, above any step in one road
_CELL_M = 2.0  # chosen: about half the width of a lane
_SAMPLE_M = 0.9  # chosen: less than half a cell, so that no cell on a piece stays empty

Pair = tuple[int, int]


def cuts_and_levels(
    lanes: Sequence[Lane], pieces: Sequence[Sequence[LanePiece]], file: str
) -> tuple[list[list[int]], list[list[int]]]:
    """For each lane the pieces at which it is cut (none, but where it lies over itself), and the levels of its parts.

    Raises FormatError where the levels that the map says contradict its heights.
    """
    lane_of = [lane for lane, each in enumerate(pieces) for _ in each]
    number = [k for each in pieces for k in range(len(each))]
    pairs = _over_one_another([piece for each in pieces for piece in each])
    self_overlaps: list[list[Pair]] = [[] for _ in lanes]
    for a, b in pairs:
        if lane_of[a] == lane_of[b]:
            self_overlaps[lane_of[a]].append((min(number[a], number[b]), max(number[a], number[b])))
    cuts = [_stabs(intervals) for intervals in self_overlaps]
    starts = np.cumsum([0] + [len(each) + 1 for each in cuts])
    unit = [int(starts[k]) + bisect_right(cuts[k], n) for k, n in zip(lane_of, number, strict=True)]
    over = {(unit[a], unit[b]) for a, b in pairs}
    lane_of_unit = np.repeat(np.arange(len(lanes)), np.diff(starts)).tolist()
    stated_levels = [lanes[k].level for k in lane_of_unit]
    names = [lanes[k].name for k in lane_of_unit]
    group = _side_by_side(lanes, starts)
    torn = {group[a] for a, b in over if group[a] == group[b]}
    alone = [k if g in torn else g for k, g in enumerate(group)]
    try:
        levels = _levels(alone, over, stated_levels, names=names, file=file)
    except FormatError:
        levels = _levels(list(range(len(stated_levels))), over, stated_levels, names=names, file=file)
    return cuts, [levels[a:b] for a, b in pairwise(starts.tolist())]


def _over_one_another(pieces: Sequence[LanePiece]) -> set[Pair]:
    """Pairs (lower, upper) of pieces that are at one place more than APART_M apart, nothing between them."""
    if not pieces:
        return set()
    samples = [_samples(piece) for piece in pieces]
    owner = np.repeat(np.arange(len(pieces)), [len(points) for points in samples])
    points = np.concatenate(samples)
    cell = np.floor(points[:, :2] / _CELL_M).astype(np.int64)
    order = np.lexsort((points[:, 2], cell[:, 1], cell[:, 0]))
    cell, height_m, owner = cell[order], points[order, 2], owner[order]
    begins = np.concatenate(([0], np.flatnonzero((np.diff(cell, axis=0) != 0).any(axis=1)) + 1, [len(cell)]))
    pairs: set[Pair] = set()
    last = begins[1:] - 1
    for i in np.flatnonzero(height_m[last] - height_m[begins[:-1]] > APART_M).tolist():
        rows = slice(begins[i], begins[i + 1])
        gaps = np.flatnonzero(np.diff(height_m[rows]) > APART_M) + 1
        layers = [np.unique(layer).tolist() for layer in np.split(owner[rows], gaps)]
        pairs |= {(a, b) for low, high in pairwise(layers) for a in low for b in high}
    return pairs


def _samples(piece: LanePiece) -> Floats:
    """Points (n, 3) all over a piece, no farther apart than _SAMPLE_M."""
    n, m = (int(2.0 * half / _SAMPLE_M) + 2 for half in (piece.half_length_m, piece.half_width_m))
    p, q = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij"))
    u, v = (2.0 * p - 1.0) * piece.half_length_m, (2.0 * q - 1.0) * piece.half_width_m
    c, s = np.cos(piece.yaw_rad), np.sin(piece.yaw_rad)
    corners = piece.heights_m[[0, 0, -1, -1], [0, -1, 0, -1]]
    weights = np.column_stack(((1 - p) * (1 - q), (1 - p) * q, p * (1 - q), p * q))
    return np.column_stack(
        (piece.centre_m[0] + c * u - s * v, piece.centre_m[1] + s * u + c * v, weights @ corners)
    )


def _stabs(intervals: Sequence[Pair]) -> list[int]:
    """The fewest pieces to cut before, such that none of the pairs is in one part."""
    cuts: list[int] = []
    for low, high in sorted(intervals, key=lambda pair: pair[1]):
        if not cuts or cuts[-1] <= low:
            cuts.append(high)
    return [cut for cut in cuts if cut > 0]


def _side_by_side(lanes: Sequence[Lane], starts: Integers) -> list[int]:
    """A number for each part of a lane, the same for lanes that share a border; parts of cut lanes have their own."""
    sets, first = JoinedSets[int](), dict[str, int]()
    for k, lane in enumerate(lanes):
        if starts[k + 1] - starts[k] == 1:
            for border in lane.borders:
                sets.join(int(starts[k]), first.setdefault(border, int(starts[k])))
    return [sets.least(k) for k in range(int(starts[-1]))]


def _levels(
    group: Sequence[int],
    over: set[Pair],
    stated_levels: Sequence[int | None],
    *,
    names: Sequence[str],
    file: str,
) -> list[int]:
    """Levels of units by relaxation; `over` has pairs (lower, upper) of units."""
    edges = sorted({(group[a], group[b]) for a, b in over})
    fixed = {g: level for g, level in zip(group, stated_levels, strict=True) if level is not None}
    name = dict(zip(group, names, strict=True))
    level = {g: fixed.get(g, 0) for g in group}
    for _ in range(2 * MAX_LEVEL + 4):
        changed = False
        for low, high in edges:
            if level[high] > level[low]:
                continue
            changed = True
            if high not in fixed:
                level[high] = level[low] + 1
            elif low not in fixed:
                level[low] = level[high] - 1
            else:
                actual = f"{name[low]} at {level[low]}, {name[high]} over it at {level[high]}"
                raise FormatError(file, "levels", "a higher one for what is above", actual=actual)
        if not changed and all(abs(value) <= MAX_LEVEL for value in level.values()):
            return [level[g] if each is None else each for g, each in zip(group, stated_levels, strict=True)]
    low, _ = edges[0]
    raise FormatError(file, "heights", f"at most {MAX_LEVEL} levels, none above itself", actual=name[low])

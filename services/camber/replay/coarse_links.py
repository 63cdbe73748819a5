"""Links between nodes along the roads of a drive, as coarse as the maps that navigation uses.

Where roads meet, a link of the one ends at a node of the other. Vertices are thinned (Douglas-Peucker) and moved
by an error across the road that changes smoothly along it. Thinning moves a line by at most a sixth of the
deviation asked for, the error by at most the rest, so that a link is nowhere further off its road than that.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from camber.replay.road_lines import SPACING_M, RoadLines
from camber.schemas.base import Float64, Int64

LONGEST_LINK_M = 300.0
"""Chosen, as all lengths here: of the size found in maps that navigation uses."""
_SPLIT_M = 200.0  # chosen: the middle of the links' lengths
_LEVEL_MARGIN_M = 30.0
"""A link over or under another road begins this far before it, so that each link is on one level."""
_SNAP_M = 10.0
"""Nodes of one road nearer to one another than this are one node; shorter roads between roads have no link."""
_KNOT_M = 50.0  # chosen: the error changes more slowly than a road bends
_THINNING_SHARE = 1.0 / 6.0  # chosen: most of the deviation is left to the error


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneLinks:
    """Link i has id i + 1; `link_of_sample` gives the id of each sample's link."""

    start_node: Int64
    end_node: Int64
    vertices_m: list[Float64]
    link_of_sample: Int64
    level: Int64


def coarse_links(lines: RoadLines, deviation_m: float, rng: np.random.Generator) -> PlaneLinks:
    """Links of 100 to 300 m (shorter between junctions), nowhere more than `deviation_m` off their road."""
    kept = [r for r in range(len(lines.runs)) if _has_links(lines, r)]
    run_of_sample = np.full(len(lines.height_m), -1)
    for r in kept:
        run_of_sample[slice(*lines.runs[r])] = r
    joints = {r: [j for j in lines.joined[r] if j >= 0 and run_of_sample[j] >= 0] for r in kept}
    met = [j for of_run in joints.values() for j in of_run]
    nodes_of_run = {
        r: _nodes(lines, r, [j for j in met if run_of_sample[j] == r] + _level_changes(lines, r))
        for r in kept
    }
    moved_m = lines.east_north_m + _error(lines, deviation_m * (1.0 - _THINNING_SHARE), rng)
    node_ids: dict[int, int] = {}
    start, end, vertices, level = [], [], [], []
    link_of_sample = np.zeros(len(lines.height_m), dtype=np.int64)
    for r in kept:
        path, nodes = _path(lines, r, nodes_of_run, run_of_sample)
        for a, b in pairwise(nodes):
            samples = path[a : b + 1]
            corners = thinned(lines.east_north_m[samples], deviation_m * _THINNING_SHARE)
            vertices.append(moved_m[samples[corners]])
            start.append(node_ids.setdefault(int(samples[0]), len(node_ids) + 1))
            end.append(node_ids.setdefault(int(samples[-1]), len(node_ids) + 1))
            of_run = samples[run_of_sample[samples] == r]
            link_of_sample[of_run] = len(vertices)
            level.append(_furthest_from_zero(lines.level[of_run]))
    _lend(lines, link_of_sample)
    return PlaneLinks(
        start_node=np.array(start), end_node=np.array(end), vertices_m=vertices,
        link_of_sample=link_of_sample, level=np.array(level),
    )  # fmt: skip


def thinned(line_m: Float64, tolerance_m: float) -> Int64:
    """Int64 of the vertices to keep so that no vertex of `line_m` (n, 2) is further off (Douglas & Peucker 1973)."""
    keep = np.zeros(len(line_m), dtype=bool)
    keep[[0, -1]] = True
    open_ends = [(0, len(line_m) - 1)]
    while open_ends:
        a, b = open_ends.pop()
        if b - a < 2:
            continue
        away_m = _away_from_segment(line_m[a + 1 : b], line_m[a], line_m[b])
        worst = int(np.argmax(away_m))
        if away_m[worst] > tolerance_m:
            middle = a + 1 + worst
            keep[middle] = True
            open_ends += [(a, middle), (middle, b)]
    return np.flatnonzero(keep)


def _has_links(lines: RoadLines, run: int) -> bool:
    """Whether a run is a road of its own: long enough, or where the drive begins or ends."""
    first, stop = lines.runs[run]
    dead_end = min(lines.joined[run]) < 0 and stop - first > 1
    return dead_end or float(lines.distance_m[stop - 1] - lines.distance_m[first]) >= _SNAP_M


def _nodes(lines: RoadLines, run: int, met: list[int]) -> Int64:
    """Samples of a run that are nodes: its ends, where other roads meet it, and what keeps links short."""
    first, stop = lines.runs[run]
    nodes = [first, stop - 1]
    for sample in sorted(set(met)):
        if np.abs(lines.distance_m[nodes] - lines.distance_m[sample]).min() > _SNAP_M:
            nodes.append(sample)
    nodes.sort()
    for a, b in list(pairwise(nodes)):
        length_m = lines.distance_m[b] - lines.distance_m[a]
        if length_m > LONGEST_LINK_M:
            parts = round(length_m / _SPLIT_M)
            nodes += np.linspace(a, b, parts + 1)[1:-1].astype(int).tolist()
    return np.array(sorted(nodes), dtype=np.int64)


def _level_changes(lines: RoadLines, run: int) -> list[int]:
    """Samples of a run between which it goes over or under another road, with some road to both sides."""
    first, stop = lines.runs[run]
    margin = round(_LEVEL_MARGIN_M / SPACING_M)
    wide = np.zeros(stop - first, dtype=bool)
    for k in np.flatnonzero(lines.level[first:stop]).tolist():
        wide[max(k - margin, 0) : k + margin + 1] = True
    return [first + int(k) + 1 for k in np.flatnonzero(np.diff(wide.astype(np.int8)))]


def _furthest_from_zero(levels: Int64) -> int:
    return int(levels[np.argmax(np.abs(levels))]) if len(levels) else 0


def _path(
    lines: RoadLines, run: int, nodes_of_run: dict[int, Int64], run_of_sample: Int64
) -> tuple[Int64, list[int]]:
    """The samples that the links of a run go along, and where its nodes stand among them.

    An end that meets another road goes on to the nearest node of that road.
    """

    def beyond(joint: int) -> list[int]:
        if joint < 0 or run_of_sample[joint] < 0:
            return []
        nodes = nodes_of_run[int(run_of_sample[joint])]
        return [int(nodes[np.argmin(np.abs(lines.distance_m[nodes] - lines.distance_m[joint]))])]

    before, after = map(beyond, lines.joined[run])
    path = np.array([*before, *range(*lines.runs[run]), *after], dtype=np.int64)
    places = [node - lines.runs[run][0] + len(before) for node in nodes_of_run[run].tolist()]
    places[0], places[-1] = 0, len(path) - 1
    return path, places


def _error(lines: RoadLines, largest_m: float, rng: np.random.Generator) -> Float64:
    """An error (n, 2) across the road: every 50 m to either side, half to all of the largest; straight in between."""
    knots = int(lines.distance_m[-1] // _KNOT_M) + 2
    size_m = largest_m * (0.5 + 0.5 * rng.random(knots)) * np.where(rng.random(knots) < 0.5, -1.0, 1.0)
    across_m = np.interp(lines.distance_m, np.arange(knots) * _KNOT_M, size_m)
    along = np.gradient(lines.east_north_m, axis=0)
    left = np.column_stack((-along[:, 1], along[:, 0]))
    length = np.maximum(np.hypot(*left.T), 1e-9)
    error: Float64 = (across_m / length)[:, None] * left
    return error


def _lend(lines: RoadLines, link_of_sample: Int64) -> None:
    """Samples without a link of their own take that of the sample at their place, else of the nearest one."""
    without = link_of_sample == 0
    link_of_sample[without] = link_of_sample[lines.same_as[without]]
    having = np.flatnonzero(link_of_sample)
    for k in np.flatnonzero(link_of_sample == 0).tolist():
        away_m = np.hypot(*(lines.east_north_m[having] - lines.east_north_m[k]).T)
        away_m += np.abs(lines.height_m[having] - lines.height_m[k])
        link_of_sample[k] = link_of_sample[having[np.argmin(away_m)]]


def _away_from_segment(points_m: Float64, a_m: Float64, b_m: Float64) -> Float64:
    step = b_m - a_m
    length2 = float(step @ step)
    share = np.clip((points_m - a_m) @ step / length2, 0.0, 1.0) if length2 > 0.0 else np.zeros(len(points_m))
    away: Float64 = np.hypot(*(points_m - a_m - share[:, None] * step).T)
    return away

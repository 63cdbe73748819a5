"""The path of a vehicle along links: keeping left, round corners, smooth in its curvature.

In a link the path keeps the lane's distance from the centre line; where two links meet at an angle an arc joins the two
lanes. The whole line is then averaged over a few metres of itself, which leaves straight road as it is, moves an arc
inwards by a few centimetres and makes the curvature continuous, as steering does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from camber.simulator.scene import Floats, Integers, Path
from camber.simulator.world.roads import Roads

# Chosen: comfortable driving of a passenger car that keeps left.
STEP_M = 0.1
LEFT_TURN_RADIUS_M = 9.0
RIGHT_TURN_RADIUS_M = 13.0
LATERAL_ACCELERATION_M_S2 = 2.0
# Chosen: fine against the step; averaged over the length in which a wheel is turned.
_FINE_M = 0.02
_AVERAGED_M = 6.0
_SAME_DIRECTION_RAD = 1.0e-3
_DIFFERENCE_M = 0.01
_STOP_BEFORE_M = 14.0  # chosen: before a node


@dataclass(frozen=True, slots=True)
class Leg:
    """One link of a route, by its row; `forward`: from its start to its end."""

    link: int
    forward: bool


def route_path(
    roads: Roads, legs: Sequence[Leg], stops_s: Mapping[int, float], start_m: float = 0.0, end_m: float = 0.0
) -> Path:
    """The Path along some links, each of which ends where the next one begins.

    It begins `start_m` after the start of the first leg and ends `end_m` before the end of the last. `stops_s`: by the
    number of a leg, how long to stop before its end. Raises ValueError where legs do not follow one another, or leave
    no room for a turn.
    """
    line_m, leg_of = _fine(*_lane_line(roads, legs, start_m, end_m))
    line_m = _averaged(line_m)
    fine_s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line_m, axis=0).T))))
    tangent = np.gradient(line_m, axis=0)
    fine_yaw = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    s = STEP_M * np.arange(int(fine_s[-1] / STEP_M) + 1, dtype=np.float64)
    east, north, yaw = (np.interp(s, fine_s, v) for v in (line_m[:, 0], line_m[:, 1], fine_yaw))
    leg = leg_of[_nearest(s, fine_s)]
    link = np.array([one.link for one in legs])[leg]
    direction = np.where(np.array([one.forward for one in legs])[leg], 1.0, -1.0)
    level = roads.level[link]
    along, offset = roads.place(link, east, north)
    slope_east, slope_north = _slopes(roads, east, north, level)
    covered = roads.covered_m[link]
    curvature = np.abs(np.gradient(yaw, STEP_M))
    limit_in_curves = np.sqrt(LATERAL_ACCELERATION_M_S2 / np.maximum(curvature, 1.0e-4))
    limit = np.minimum(roads.speed_m_s[link], limit_in_curves)
    stop_s = np.zeros(len(s))
    for number, for_s in stops_s.items():
        where = int(np.flatnonzero(leg == number)[-1] - round(_STOP_BEFORE_M / STEP_M))
        limit[where], stop_s[where] = 0.0, for_s
    return Path(
        step_m=STEP_M,
        east_m=east,
        north_m=north,
        up_m=roads.surface_m(east, north, level),
        yaw_rad=yaw,
        grade=slope_east * np.cos(yaw) + slope_north * np.sin(yaw),
        crossfall=slope_north * np.cos(yaw) - slope_east * np.sin(yaw),
        level=level,
        link_id=roads.link_id[link],
        link_offset_m=direction * offset,
        speed_limit_m_s=limit,
        stop_s=stop_s,
        tunnel=(along > covered[:, 0]) & (along < covered[:, 1]),
        surface_m=roads.surface_m,
    )


def _nearest(at: Floats, distance_m: Floats) -> Integers:
    """The number of the nearest of ascending distances, for each."""
    place = np.rint(np.interp(at, distance_m, np.arange(len(distance_m)))).astype(np.int64)
    return np.clip(place, 0, len(distance_m) - 1)


def _slopes(roads: Roads, east: Floats, north: Floats, level: Integers) -> tuple[Floats, Floats]:
    """Slopes of the surface towards east and north, by central differences of the closed form."""
    d = _DIFFERENCE_M
    towards_east = roads.surface_m(east + d, north, level) - roads.surface_m(east - d, north, level)
    towards_north = roads.surface_m(east, north + d, level) - roads.surface_m(east, north - d, level)
    return towards_east / (2.0 * d), towards_north / (2.0 * d)


@dataclass(slots=True, kw_only=True)
class _LaneEnd:
    """The lane of a leg at one of its ends: where, in which direction, and by how much it is cut there."""

    place: Floats
    yaw: float
    cut_m: float = 0.0


def _lane_line(roads: Roads, legs: Sequence[Leg], start_m: float, end_m: float) -> tuple[Floats, Integers]:
    """Points of the lanes and of the arcs between them, and the leg of each."""
    for a, b in pairwise(legs):
        if _nodes(roads, a)[1] != _nodes(roads, b)[0]:
            first, second = roads.link_id[a.link], roads.link_id[b.link]
            raise ValueError(f"link {second} does not begin where {first} ends")
    begins = [_lane_end(roads, leg, np.zeros(1)) for leg in legs]
    ends = [_lane_end(roads, leg, roads.length_m[leg.link : leg.link + 1]) for leg in legs]
    begins[0].cut_m, ends[-1].cut_m = start_m, end_m
    arcs = [_arc(end, begin) for end, begin in zip(ends[:-1], begins[1:], strict=True)]
    points, leg_of = [], []
    for k, leg in enumerate(legs):
        long = float(roads.length_m[leg.link]) - ends[k].cut_m
        if begins[k].cut_m >= long:
            raise ValueError(f"link {roads.link_id[leg.link]} is too short for the turns at its ends")
        s = np.linspace(begins[k].cut_m, long, max(2, int((long - begins[k].cut_m) / 0.05) + 1))
        points.append(_lane(roads, leg, s)[0].reshape(-1, 2))
        leg_of.append(np.full(len(s), k))
        if k < len(arcs):
            points.append(arcs[k])
            leg_of.append(np.where(np.arange(len(arcs[k])) * 2 < len(arcs[k]), k, k + 1))
    line = np.concatenate(points)
    new = np.concatenate(([True], np.hypot(*np.diff(line, axis=0).T) > 1.0e-9))
    return line[new], np.concatenate(leg_of)[new]


def _nodes(roads: Roads, leg: Leg) -> tuple[int, int]:
    nodes = int(roads.start_node[leg.link]), int(roads.end_node[leg.link])
    return nodes if leg.forward else nodes[::-1]


def _lane(roads: Roads, leg: Leg, s_m: Floats) -> tuple[Floats, float]:
    """Points (n, 2) of a leg's lane at distances from where the leg begins, and the yaw at the last one."""
    at = s_m if leg.forward else roads.length_m[leg.link] - s_m
    east, north, yaw = roads.centre_line(leg.link, at)
    yaw = yaw if leg.forward else yaw + np.pi
    left = float(roads.lane_offset_m[leg.link])
    return np.column_stack((east - left * np.sin(yaw), north + left * np.cos(yaw))), float(yaw[-1])


def _lane_end(roads: Roads, leg: Leg, s_m: Floats) -> _LaneEnd:
    place, yaw = _lane(roads, leg, s_m)
    return _LaneEnd(place=place, yaw=yaw)


def _arc(end: _LaneEnd, begin: _LaneEnd) -> Floats:
    """The arc from one lane into another, (n, 2), n may be 0; sets what is cut off the lanes."""
    turn = (begin.yaw - end.yaw + np.pi) % (2.0 * np.pi) - np.pi
    if abs(turn) < _SAME_DIRECTION_RAD:
        return np.zeros((0, 2))
    radius = LEFT_TURN_RADIUS_M if turn > 0.0 else RIGHT_TURN_RADIUS_M
    ahead = np.array([np.cos(end.yaw), np.sin(end.yaw)])
    after = np.array([np.cos(begin.yaw), np.sin(begin.yaw)])
    # end + a · ahead = begin + b · after: where the lanes' lines cross.
    a, b = np.linalg.solve(np.column_stack((ahead, -after)), (begin.place - end.place).ravel())
    tangent = radius * np.tan(0.5 * abs(turn))
    end.cut_m, begin.cut_m = float(tangent - a), float(tangent + b)
    if end.cut_m < 0.0 or begin.cut_m < 0.0:
        raise ValueError("lanes meet beyond their ends, expected links that cross at their node")
    start = end.place.ravel() - end.cut_m * ahead
    side = 1.0 if turn > 0.0 else -1.0
    angle = np.linspace(0.0, abs(turn), max(3, int(radius * abs(turn) / 0.02)))[1:-1]
    left = np.array([-ahead[1], ahead[0]])
    forward, sideways = radius * np.sin(angle), side * radius * (1 - np.cos(angle))
    return start + np.outer(forward, ahead) + np.outer(sideways, left)


def _fine(line_m: Floats, leg_of: Integers) -> tuple[Floats, Integers]:
    """The line at even distances of 2 cm."""
    at_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line_m, axis=0).T))))
    at = np.linspace(0.0, at_m[-1], int(at_m[-1] / _FINE_M) + 1)
    fine = np.column_stack([np.interp(at, at_m, line_m[:, k]) for k in range(2)])
    return fine, leg_of[_nearest(at, at_m)]


def _averaged(line_m: Floats) -> Floats:
    """Each point the weighted mean of some metres about it; the ends are lengthened straight."""
    half = round(0.5 * _AVERAGED_M / _FINE_M)
    weight = np.hanning(2 * half + 3)[1:-1]
    weight /= weight.sum()
    k = np.arange(half, 0, -1)[:, None]
    before = line_m[0] - k * (line_m[1] - line_m[0])
    after = line_m[-1] + k[::-1] * (line_m[-1] - line_m[-2])
    padded = np.concatenate((before, line_m, after))
    return np.column_stack([np.convolve(padded[:, c], weight, mode="valid") for c in range(2)])

"""Roads of a district: links and nodes, and the one height of the road at each place and level.

The surface of a link is

    height = ground(east, north) + lift(s) + crossfall · f(s) · y + resurfaced · g(s)

with s along and y to the left of its centre line, which is made of straight lines and arcs. `lift` goes from one height
above the ground to another by the quintic 10 x³ − 15 x⁴ + 6 x⁵, so grade and vertical curvature are continuous. f and g
fade out towards both ends, so that at a node all links lie on the ground plus the node's lift; around it a disc of the
node's radius is road too, for the turns. Everything is in closed form: what the path says is what the wheels stand on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from camber.compiled.decorator import compiled, compiled_without_gil
from camber.simulator.scene import Floats, Integers
from camber.simulator.world.terrain import Terrain, ground_height

FADE_M = 20.0  # chosen: crossfall comes in over this length
RESURFACING_FADE_M = 20.0  # chosen: as the crossfall, so that the offset gives no bump
BEYOND_NODE_M = 15.0
"""Chosen: longer than a vehicle; so far onto roads of another level that begin at a common node a level is known."""
_TOUCH_M = 1.0e-6  # chosen: micrometres, for rounding

# columns of `shape`
HALF_WIDTH, CROSSFALL, LIFT_START, LIFT_END, RISE_FROM = range(5)
RISE_TO, FLAT_START, FLAT_END, LENGTH, RESURFACED = range(5, 10)
# columns of `elements`
_E0, _N0, _YAW0, _LONG, _CURVATURE, _S0 = range(6)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Roads:
    """Links (n,), nodes (m,) and the elements (k,) of the centre lines, in the order of their links.

    `shape` (n, 10): half width, crossfall (dz/dy, to the left), lift at start and end, the part s to s in which it
    changes, length without crossfall at start and end, length, height of a new surface. `elements` (k, 6): east, north,
    yaw at its start, length, curvature (positive to the left), s at its start. `nodes_m` (m, 4): east, north, radius of
    the disc, lift. `covered_m`, `bridge_m` (n, 2): the part s to s that lies in a tunnel, or on a bridge; none: (0, 0).
    `lane_offset_m`: middle of a lane from the centre line. `style` names what stands along it.
    """

    terrain: Terrain
    link_id: Integers
    start_node: Integers
    end_node: Integers
    level: Integers
    shape: Floats
    covered_m: Floats
    bridge_m: Floats
    lane_offset_m: Floats
    speed_m_s: Floats
    style: tuple[str, ...]
    elements: Floats
    element_link: Integers
    node_id: Integers
    nodes_m: Floats
    node_level: Integers
    _rows: tuple[Integers, Floats, Integers]

    @property
    def length_m(self) -> Floats:
        """Length of each link, (n,)."""
        return self.shape[:, LENGTH]

    def surface_m(self, east_m: Floats, north_m: Floats, level: Integers) -> Floats:
        """Ellipsoidal height of the road of a level at places (n,); NaN beside any road of that level."""
        east, north, on = np.broadcast_arrays(east_m, north_m, level)
        heights = _surface(
            (self.terrain, self.shape, self.elements, self.element_link, self.nodes_m),
            self._rows,
            (_flat(east), _flat(north)),
            np.array(on, np.int64).ravel(),
        )
        return heights.reshape(east.shape)

    def place(self, link: Integers, east_m: Floats, north_m: Floats) -> tuple[Floats, Floats]:
        """s and y of places (n,) against the centre line of given links (row numbers, (n,)), its ends lengthened."""
        east, north, row = np.broadcast_arrays(east_m, north_m, link)
        first = np.searchsorted(self.element_link, np.arange(len(self.link_id) + 1))
        rows = np.array(row, np.int64).ravel()
        s, y = _place(self.elements, first, rows, (_flat(east), _flat(north)))
        return s.reshape(east.shape), y.reshape(east.shape)

    def link_height_m(self, link: Integers, east_m: Floats, north_m: Floats) -> Floats:
        """Height (n,) of given links' surfaces, each continued beyond its sides and ends."""
        s, y = self.place(link, east_m, north_m)
        row = np.array(np.broadcast_to(link, s.shape), np.int64)
        rise = _rises(self.shape, row.ravel(), s.ravel(), y.ravel()).reshape(s.shape)
        return self.terrain.height_m(east_m, north_m) + rise

    def centre_line(self, link: int, s_m: Floats) -> tuple[Floats, Floats, Floats]:
        """East, north, yaw (n,) of the centre line of one link at s."""
        rows = np.flatnonzero(self.element_link == link)
        elements = self.elements[rows]
        of = elements[np.clip(np.searchsorted(elements[:, _S0], s_m, side="right") - 1, 0, len(rows) - 1)]
        d = s_m - of[:, _S0]
        turn = of[:, _CURVATURE] * d
        yaw = of[:, _YAW0] + turn
        # Chord of an arc: length d · sinc(turn / 2), in the direction of half the turn.
        chord = d * np.sinc(0.5 * turn / np.pi)
        middle = of[:, _YAW0] + 0.5 * turn
        return of[:, _E0] + chord * np.cos(middle), of[:, _N0] + chord * np.sin(middle), yaw

    def at_offset(self, link: int, s_m: Floats, y_m: Floats | float) -> tuple[Floats, Floats, Floats]:
        """East, north (n,) at y to the left of the centre line of one link at s, and its yaw there."""
        east, north, yaw = self.centre_line(link, s_m)
        return east - y_m * np.sin(yaw), north + y_m * np.cos(yaw), yaw

    def lift_m(self, link: int, s_m: Floats) -> Floats:
        """Height above the ground of one link's centre line as it was first built, (n,)."""
        shape = self.shape.copy()
        shape[:, RESURFACED] = 0.0
        return _rises(shape, np.full(len(s_m), link), np.ascontiguousarray(s_m), np.zeros(len(s_m)))

    def resurfaced(self, offset_m: Floats) -> Roads:
        """The same roads with new surfaces, (n,) metres higher; towards their ends the offset fades out."""
        shape = self.shape.copy()
        shape[:, RESURFACED] = offset_m
        return replace(self, shape=shape)


def _flat(values: Floats) -> Floats:
    return np.array(values, np.float64).ravel()


def answering_rows(
    ends: tuple[Integers, Integers], levels: tuple[Integers, Integers], shape: Floats, element_link: Integers
) -> tuple[Integers, Floats, Integers]:
    """Which elements answer for which level: (rows, 3) element, level, rank; (rows, 2) the part of the link, s to s.

    And which nodes' discs: (discs, 3) row of the node, level, rank. Rank 0: of that level. Rank 1: the beginning of a
    road of another level that has a node in common with it, and that node. `ends`: nodes of the links at their start
    and end, numbered from 1; `levels` of links and of nodes.
    """
    (start_node, end_node), (level, node_level) = ends, levels
    whole, parts = [], []
    elements_of = [np.flatnonzero(element_link == link).tolist() for link in range(len(level))]
    levels_at: dict[int, set[int]] = {}
    for node, on in zip([*start_node.tolist(), *end_node.tolist()], [*level.tolist()] * 2, strict=True):
        levels_at.setdefault(node, set()).add(on)
    for link, link_level in enumerate(level.tolist()):
        long = float(shape[link, LENGTH])
        for element in elements_of[link]:
            whole.append((element, link_level, 0))
            parts.append((-_TOUCH_M, long + _TOUCH_M))
        for node, low, high in (
            (int(start_node[link]), 0.0, BEYOND_NODE_M),
            (int(end_node[link]), long - BEYOND_NODE_M, long),
        ):
            for other in sorted(levels_at[node] - {link_level}):
                for element in elements_of[link]:
                    whole.append((element, other, 1))
                    parts.append((low - _TOUCH_M, high + _TOUCH_M))
    discs = [
        (node - 1, on, 0 if on == int(node_level[node - 1]) else 1)
        for node, levels in sorted(levels_at.items())
        for on in sorted(levels | {int(node_level[node - 1])})
    ]
    rows, discs_of = np.array(whole, np.int64).reshape(-1, 3), np.array(discs, np.int64).reshape(-1, 3)
    return rows, np.array(parts).reshape(-1, 2), discs_of


@compiled
def _smooth(x: float) -> float:
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@compiled
def _fade(shape: Floats, link: int, s: float, over: float) -> float:
    """From 0 where the link is flat at its ends to 1 in its middle."""
    begin: float = (s - shape[link, FLAT_START]) / over
    end: float = (shape[link, LENGTH] - shape[link, FLAT_END] - s) / over
    return _smooth(begin) * _smooth(end)


@compiled
def _rise(shape: Floats, link: int, s: float, y: float) -> float:
    """Height of a link's surface above the ground."""
    low: float = shape[link, LIFT_START]
    high: float = shape[link, LIFT_END]
    rise: float = low + shape[link, CROSSFALL] * _fade(shape, link, s, FADE_M) * y
    if low != high:
        rise_m = shape[link, RISE_TO] - shape[link, RISE_FROM]
        rise += (high - low) * _smooth((s - shape[link, RISE_FROM]) / rise_m)
    if shape[link, RESURFACED] != 0.0:
        rise += shape[link, RESURFACED] * _fade(shape, link, s, RESURFACING_FADE_M)
    return rise


@compiled
def _rises(shape: Floats, link: Integers, s: Floats, y: Floats) -> Floats:
    rises = np.empty(len(s))
    for i in range(len(s)):
        rises[i] = _rise(shape, link[i], s[i], y[i])
    return rises


@compiled
def _along_across(elements: Floats, k: int, e: float, n: float) -> tuple[float, float]:
    """s within an element, not bounded by its ends, and y."""
    de, dn = e - elements[k, 0], n - elements[k, 1]
    c, s = math.cos(elements[k, 2]), math.sin(elements[k, 2])
    ahead, left = c * de + s * dn, c * dn - s * de
    curvature = elements[k, 4]
    if curvature == 0.0:
        return ahead, left
    # From the arc's centre, which lies 1/curvature to the left of its start.
    radius = 1.0 / curvature
    out = math.sqrt(ahead * ahead + (left - radius) ** 2)
    side = 1.0 if curvature > 0.0 else -1.0
    angle = math.atan2(side * ahead, side * (radius - left))
    middle = 0.5 * elements[k, 3] * curvature
    turned = angle - middle
    turned -= 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
    return (turned + middle) / curvature, radius - side * out


@compiled_without_gil
def _surface(
    roads: tuple[Terrain, Floats, Floats, Integers, Floats],
    answering: tuple[Integers, Floats, Integers],
    places: tuple[Floats, Floats],
    level: Integers,
) -> Floats:
    terrain, shape, elements, element_link, nodes = roads
    rows, parts, discs = answering
    east, north = places
    result = np.full(len(east), np.nan)
    for i in range(len(east)):
        e, n = east[i], north[i]
        best_rank, best_away, rise = 9, np.inf, 0.0
        for r in range(len(rows)):
            if rows[r, 1] != level[i]:
                continue
            k = rows[r, 0]
            link = element_link[k]
            width = shape[link, HALF_WIDTH]
            de, dn = e - elements[k, 0], n - elements[k, 1]
            reach = elements[k, 3] + width + 1.0
            if de * de + dn * dn > reach * reach:
                continue
            s, y = _along_across(elements, k, e, n)
            if s < -1.0e-6 or s > elements[k, 3] + 1.0e-6 or abs(y) > width + 1.0e-6:
                continue
            at = s + elements[k, 5]
            rank, away = rows[r, 2], abs(y)
            better = rank < best_rank or (rank == best_rank and away < best_away)
            if better and parts[r, 0] <= at <= parts[r, 1]:
                best_rank, best_away = rank, away
                rise = _rise(shape, link, at, y)
        for d in range(len(discs)):
            k = discs[d, 0]
            if discs[d, 1] == level[i] and discs[d, 2] < best_rank:
                de, dn = e - nodes[k, 0], n - nodes[k, 1]
                if de * de + dn * dn <= nodes[k, 2] * nodes[k, 2]:
                    best_rank, rise = discs[d, 2], nodes[k, 3]
        if best_rank < 9:
            result[i] = ground_height(terrain, e, n) + rise
    return result


@compiled
def _place(
    elements: Floats, first: Integers, link: Integers, places: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    east, north = places
    s, y = np.empty(len(east)), np.empty(len(east))
    for i in range(len(east)):
        best = np.inf
        for k in range(first[link[i]], first[link[i] + 1]):
            at, left = _along_across(elements, k, east[i], north[i])
            beyond = 0.0
            if at < 0.0 and k > first[link[i]]:
                beyond = -at
            if at > elements[k, 3] and k < first[link[i] + 1] - 1:
                beyond = at - elements[k, 3]
            # An inner end is no place to lengthen; beyond it the neighbouring element answers.
            away = beyond * beyond + left * left + (1.0e6 if beyond > 1.0e-6 else 0.0)
            if away < best:
                best = away
                s[i], y[i] = at + elements[k, 5], left
    return s, y

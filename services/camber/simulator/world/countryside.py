"""Roads through open country, on flat or on hilly ground: a lattice of bends, and drives of any length through it."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_streams import stream
from camber.simulator.world.district import NAGOYA_RAD, District
from camber.simulator.world.layouts import Layout, Route
from camber.simulator.world.road_building import LinkKind, Pair, RoadBuilder
from camber.simulator.world.roads import Roads
from camber.simulator.world.routes import Leg
from camber.simulator.world.terrain import hilly_terrain, rolling_terrain

Ground = Literal["flat", "hilly"]

_LATTICE = 4  # chosen, with the spacing
_SPACING_M = (
    700.0  # chosen: 17 km of road within a kilometre of the origin, where the world frame is Cartesian
)
_BASE_M = 45.0  # as the plain of the other districts
_FLAT_SLOPE = 0.003  # chosen: at most; a river plain
_HILLY_SLOPE = 0.035
"""Root mean square, along the roads and across. Chosen: twice that of a rather flat road as measured (`boreas-tracks`,
1.6 % along), steepest as roads for 60 km/h may be (Japanese Road Structure Ordinance, article 20: 5 %, exceptionally
8 %); across with the crossfall 4 %, in the middle of 2 % on straight road and 6 % in bends (article 16)."""
_CROSSFALL = (0.015, 0.02)
"""Japanese Road Structure Ordinance, article 24: 1.5 to 2 % on paved roads."""
_SPEED_M_S = 14.0  # chosen: 50 km/h
_STRAIGHT_M = 60.0  # chosen: before and after the bends, so that crossings have room
_BEND_RAD = (0.25, 0.7)  # chosen, as the radius: bends that are driven at that speed
_BEND_RADIUS_M = (110.0, 180.0)


def country_district(seed: int, ground: Ground, *, length_m: float) -> District:
    """Country of a seed with a route "default" of at least `length_m`, which goes where it has been least."""
    b = RoadBuilder()
    for column in range(_LATTICE):
        for row in range(_LATTICE):
            middle = 0.5 * (_LATTICE - 1)
            b.node(f"{column}{row}", _SPACING_M * (column - middle), _SPACING_M * (row - middle))
    rng = stream(seed, "country roads")
    for line in range(_LATTICE):
        for at in range(_LATTICE - 1):
            for nodes, yaw_rad in (
                (f"{at}{line} {at + 1}{line}", 0.0),
                (f"{line}{at} {line}{at + 1}", 0.5 * math.pi),
            ):
                crossfall = float(rng.uniform(*_CROSSFALL)) * (1.0 if rng.random() < 0.5 else -1.0)
                kind = LinkKind(style="open", speed_m_s=_SPEED_M_S, crossfall=crossfall)
                b.chain(nodes, yaw_rad, _bends(rng), kind)
    terrain = (
        rolling_terrain(seed, base_m=_BASE_M, slope=_FLAT_SLOPE)
        if ground == "flat"
        else hilly_terrain(seed, base_m=_BASE_M, slope=_HILLY_SLOPE)
    )
    roads = b.roads(terrain)
    route = Route(legs=_drive_through(roads, length_m, stream(seed, "country route")))
    frame = LocalFrame(*NAGOYA_RAD, 0.0)
    return District(
        kind="open-sky", seed=seed, frame=frame, layout=Layout(roads, {"default": route}), changed_roads={}
    )


def _bends(rng: np.random.Generator) -> list[Pair]:
    """Straight, an S-bend to one side, straight, an S-bend back, straight: it ends a spacing farther on its line."""
    turn_rad, radius_m = float(rng.uniform(*_BEND_RAD)), float(rng.uniform(*_BEND_RADIUS_M))
    side = 1.0 if rng.random() < 0.5 else -1.0
    bend = turn_rad * radius_m
    middle_m = _SPACING_M - 2.0 * _STRAIGHT_M - 4.0 * radius_m * math.sin(turn_rad)
    first, second = (bend, side / radius_m), (bend, -side / radius_m)
    return [(_STRAIGHT_M, 0.0), first, second, (middle_m, 0.0), second, first, (_STRAIGHT_M, 0.0)]


def _drive_through(roads: Roads, length_m: float, rng: np.random.Generator) -> tuple[Leg, ...]:
    """Legs that together are at least so long; at each crossing the road driven least, never back at once."""
    at, last, driven_m = int(rng.integers(1, len(roads.node_id) + 1)), -1, 0.0
    times = np.zeros(len(roads.link_id))
    legs: list[Leg] = []
    while driven_m < length_m:
        rows = np.flatnonzero((roads.start_node == at) | (roads.end_node == at))
        rows = rows[rows != last]
        last = int(rows[np.argmin(times[rows] + 0.5 * rng.random(len(rows)))])
        forward = int(roads.start_node[last]) == at
        legs.append(Leg(last, forward))
        at = int((roads.end_node if forward else roads.start_node)[last])
        times[last] += 1.0
        driven_m += float(roads.length_m[last])
    return tuple(legs)

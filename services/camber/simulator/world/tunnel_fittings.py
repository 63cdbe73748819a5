"""What hangs and stands in a tunnel: lamps, fans, cabinets, doors. Without them nothing says how far along one is.

Spacings are those of common rules: fire extinguishers, hydrants and alarms every 50 m (Japan, standard for emergency
facilities of road tunnels; cabinets that stand out of the wall), telephones every 150 m at most and emergency exits
every 500 m at most (Directive 2004/54/EC, annex I, 2.10 and 2.3.8; exits of urban tunnels are much closer), lamps every
10 to 20 m (CIE 88: where the spacing lets them flicker neither slowly nor fast at 36 km/h), fans about ten hydraulic
diameters of the tube apart (some 60 to 100 m for one of 9 m × 4.8 m). Nothing of it changes between the days.

The middle of a long tunnel is bare on purpose: for some 20 m a sensor sees next to nothing but even walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.simulator.random_streams import stream
from camber.simulator.scene import Booleans, Floats
from camber.simulator.world.road_mesh import CEILING_M, WALL_BEYOND_M
from camber.simulator.world.roads import HALF_WIDTH, Roads

BARE_M = 100.0  # chosen: longer than a LiDAR with 32 beams sees along even walls
_BARE_FROM_M = 300.0  # chosen: a link's tunnel of this length and more has a bare stretch in its middle
# Chosen: behind the wall's surface, and clear of the road's edge.
_INTO_WALL_M = 0.05
_OFF_ROAD_M = 0.4
_LEFT, _RIGHT, _BOTH = (1.0,), (-1.0,), (-1.0, 1.0)


Pair = tuple[float, float]


class Fitting(NamedTuple):
    """One sort: drawn `every_m` (least, most), on the sides of the road that are named (left positive).

    Sizes along, across and upwards, drawn between two; `up_m` of the base above the road, None: hung from the ceiling.
    `inwards_m`: its middle from the wall, None: it stands at the wall.
    """

    every_m: Pair
    sides: tuple[float, ...]
    long_m: Pair
    deep_m: Pair
    high_m: Pair
    up_m: float | None
    inwards_m: float | None


FITTINGS = {
    name: Fitting._make(row)
    for name, row in {
        "lamps": ((10.0, 18.0), _BOTH, (1.1, 1.3), (0.3, 0.3), (0.16, 0.2), None, 1.6),
        "fans": ((60.0, 100.0), _BOTH, (2.6, 3.2), (0.85, 0.85), (0.85, 0.85), None, 3.2),
        "hydrants": ((46.0, 54.0), _LEFT, (1.4, 1.9), (0.25, 0.35), (1.2, 1.6), 0.5, None),
        "telephones": ((90.0, 150.0), _RIGHT, (0.7, 1.0), (0.3, 0.4), (1.9, 2.1), 0.1, None),
        "cabinets": ((40.0, 110.0), _RIGHT, (0.9, 2.2), (0.3, 0.5), (1.3, 1.9), 0.1, None),
        "doors": ((150.0, 250.0), _LEFT, (2.0, 2.4), (0.15, 0.25), (2.3, 2.5), 0.0, None),
        "signs": ((60.0, 140.0), _BOTH, (0.12, 0.16), (0.6, 0.8), (0.6, 0.8), 2.4, None),
    }.items()
}


def tunnel_fittings(roads: Roads, seed: int) -> Floats:
    """Boxes (n, 7) as in Shapes, in the covered parts of all links."""
    boxes: list[Floats] = [np.zeros((0, 7))]
    for link in range(len(roads.link_id)):
        begin, end = roads.covered_m[link].tolist()
        if end > begin:
            for name, fitting in FITTINGS.items():
                for side in fitting.sides:
                    rng = stream(seed, f"tunnel {name} {link} {'left' if side > 0.0 else 'right'}")
                    boxes.append(_row((roads, link), fitting, side, rng))
    return np.concatenate(boxes)


def _row(at: tuple[Roads, int], fitting: Fitting, side: float, rng: np.random.Generator) -> Floats:
    """One sort on one side of one link."""
    roads, link = at
    begin, end = roads.covered_m[link].tolist()
    most = int((end - begin) / fitting.every_m[0]) + 1
    first = begin + rng.uniform(0.2, 1.0) * fitting.every_m[0]
    s = first + np.append(0.0, np.cumsum(rng.uniform(*fitting.every_m, most)))
    long, deep, high = (
        rng.uniform(*between, most + 1) for between in (fitting.long_m, fitting.deep_m, fitting.high_m)
    )
    stands = s + long < end
    if end - begin >= _BARE_FROM_M:
        stands &= np.abs(s - 0.5 * (begin + end)) > 0.5 * (BARE_M + long)
    stands &= _at_a_wall(at, side, s, long)
    inwards = 0.5 * deep - _INTO_WALL_M if fitting.inwards_m is None else fitting.inwards_m
    y = side * (roads.shape[link, HALF_WIDTH] + WALL_BEYOND_M - inwards)
    east, north, yaw = roads.at_offset(link, s, y)
    above = CEILING_M - high if fitting.up_m is None else fitting.up_m
    up = roads.link_height_m(np.array(link), east, north) + above
    boxes: Floats = np.column_stack((east, north, up, 0.5 * long, 0.5 * deep, high, yaw))[stands]
    return boxes


def _at_a_wall(at: tuple[Roads, int], side: float, s: Floats, long: Floats) -> Booleans:
    """Is there a wall along the whole of a fitting, or another tube that joins this one?"""
    roads, link = at
    y = side * (roads.shape[link, HALF_WIDTH] + _OFF_ROAD_M)
    free = np.ones(len(s), bool)
    for end in (-0.5, 0.0, 0.5):
        east, north, _ = roads.at_offset(link, s + end * long, y)
        free &= np.isnan(roads.surface_m(east, north, roads.level[link]))
    return free

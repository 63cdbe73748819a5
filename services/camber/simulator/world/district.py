"""A district: its roads, what stands beside them on two days, and the routes through it.

The map is made on the *survey day* (`world.survey`), the vehicle drives on the *drive day*: by then vehicles are parked
elsewhere, some posts and cabinets have moved, trees have grown, and some links have a new surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_streams import stream
from camber.simulator.scene import Path, Shapes, Walls
from camber.simulator.world.layouts import LAYOUTS, Layout, canyon_layout
from camber.simulator.world.roads import Roads
from camber.simulator.world.roadside import Day, buildings, shapes_of
from camber.simulator.world.routes import route_path

Kind = Literal["open-sky", "city", "canyon", "canyons", "overpass", "tunnel"]
KINDS: tuple[Kind, ...] = get_args(Kind)
NAGOYA_RAD = (math.radians(35.17), math.radians(136.88))
# Chosen: enough changed roads for the map's update to have work, by what a repair and an overlay amount to.
CHANGED_SHARE = 0.2
_RESURFACED_M = (0.03, 0.30)
_SHORTEST_CHANGED_M = 80.0  # chosen: the new surface fades out over 20 m at both ends
# Chosen: red lights as in a city centre.
_STOP_CHANCE = 0.4
_STOP_S = (4.0, 15.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class District:
    """A made place. `layout.roads` are those of the survey day.

    `changed_roads`: link id → metres by which its surface is higher (or lower) on the drive day.
    """

    kind: Kind
    seed: int
    frame: LocalFrame
    layout: Layout
    changed_roads: dict[int, float]

    def roads(self, day: Day) -> Roads:
        """The roads of a day."""
        survey = self.layout.roads
        if day == "survey":
            return survey
        return survey.resurfaced(
            np.array([self.changed_roads.get(link, 0.0) for link in survey.link_id.tolist()])
        )

    def shapes(self, day: Day) -> Shapes:
        """All that a ray may meet on a day."""
        return shapes_of(self.roads(day), self.seed, day)

    def walls(self) -> Walls:
        """The four sides of each building."""
        boxes = buildings(self.layout.roads, self.seed)
        c, s = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
        ahead, left = np.column_stack((c, s)), np.column_stack((-s, c))
        long, wide = boxes[:, 3:4], boxes[:, 4:5]
        # Counter-clockwise about the building, so that outwards is to the right of each side.
        sides = [
            (long * ahead - wide * left, left, wide),
            (long * ahead + wide * left, -ahead, long),
            (-long * ahead + wide * left, -left, wide),
            (-long * ahead - wide * left, ahead, long),
        ]
        foot = np.concatenate([boxes[:, :2] + corner for corner, _, _ in sides])
        along = np.concatenate([direction for _, direction, _ in sides])
        return Walls(
            foot_m=np.column_stack((foot, np.tile(boxes[:, 2], 4))),
            along=along,
            length_m=2.0 * np.concatenate([half for _, _, half in sides]).ravel(),
            height_m=np.tile(boxes[:, 5], 4),
            normal=np.column_stack((along[:, 1], -along[:, 0])),
        )

    def path(self, name: str = "default", day: Day = "drive") -> Path:
        """The Path along a route of the layout."""
        route, roads = self.layout.routes[name], self.roads(day)
        rng = stream(self.seed, f"stops {name}")
        stops_s = {}
        for number, leg in enumerate(route.legs[:-1]):
            wants, for_s = rng.random() < _STOP_CHANCE, float(rng.uniform(*_STOP_S))
            node = int((roads.end_node if leg.forward else roads.start_node)[leg.link]) - 1
            # Signals stand where roads cross, and not at the foot of a ramp.
            if route.signals and wants and roads.nodes_m[node, 2] > 0.0 and roads.length_m[leg.link] > 60.0:
                stops_s[number] = for_s
        return route_path(roads, route.legs, stops_s, start_m=route.start_m, end_m=route.end_m)


def make_district(
    kind: Kind,
    seed: int,
    origin_latitude_rad: float = NAGOYA_RAD[0],
    origin_longitude_rad: float = NAGOYA_RAD[1],
    *,
    heading_rad: float = 0.0,
    length_m: float = 1000.0,
    changed_roads: dict[int, float] | None = None,
) -> District:
    """A district of a kind; the same arguments give the same one.

    `heading_rad` (clockwise from north) and `length_m` are those of the canyon's street. `changed_roads`: link id →
    metres that its surface is raised (or lowered) by between the days; None: in a city and at an overpass a fifth of
    the longer links, drawn, by 3 to 30 cm, else none.
    """
    layout = canyon_layout(seed, heading_rad, length_m) if kind == "canyon" else LAYOUTS[kind](seed)
    if changed_roads is None:
        changed_roads = _drawn_changes(layout.roads, seed) if kind in ("city", "overpass") else {}
    return District(
        kind=kind,
        seed=seed,
        frame=LocalFrame(origin_latitude_rad, origin_longitude_rad, 0.0),
        layout=layout,
        changed_roads=changed_roads,
    )


def _drawn_changes(roads: Roads, seed: int) -> dict[int, float]:
    rng = stream(seed, "changed roads")
    chosen = (rng.random(len(roads.link_id)) < CHANGED_SHARE) & (roads.length_m >= _SHORTEST_CHANGED_M)
    by_m = rng.uniform(*_RESURFACED_M, len(chosen)) * np.where(rng.random(len(chosen)) < 0.5, -1.0, 1.0)
    return {int(roads.link_id[k]): round(float(by_m[k]), 3) for k in np.flatnonzero(chosen)}

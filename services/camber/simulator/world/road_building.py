"""Draw roads: nodes by name, links as straight lines and arcs between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.simulator.world.roads import Roads, answering_rows
from camber.simulator.world.terrain import Terrain

# Chosen: a street of two lanes of 3.5 m with space for parking; room for the turns of a lorry.
JUNCTION_RADIUS_M = 14.0
STREET_HALF_WIDTH_M = 5.0
STREET_LANE_M = 1.75
_CLOSED_M = 1.0e-6  # chosen: micrometres, for rounding

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkKind:
    """What a link is like; `lift_m` at start and end changes within `rise_m`, s to s (None: all along).

    `flat_m`: lengths without crossfall at start and end (None: the radius of the node and 2 m).
    """

    style: str = "street"
    level: int = 0
    speed_m_s: float = 11.0
    half_width_m: float = STREET_HALF_WIDTH_M
    lane_offset_m: float = STREET_LANE_M
    crossfall: float = 0.0
    lift_m: Pair = (0.0, 0.0)
    rise_m: Pair | None = None
    flat_m: Pair | None = None
    covered_m: Pair = (0.0, 0.0)
    bridge_m: Pair = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Node:
    """Radius 0: roads go straight through, and there is no disc for turns."""

    east_m: float
    north_m: float
    radius_m: float = JUNCTION_RADIUS_M
    lift_m: float = 0.0
    level: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Link:
    start: int
    end: int
    length_m: float
    kind: LinkKind


class RoadBuilder:
    """Collects nodes and links; their ids are their numbers in the order drawn, from 1.

    `row_of_link`: by name, which is "start-end" of the names of its nodes.
    """

    def __init__(self) -> None:
        self._nodes: list[_Node] = []
        self._number: dict[str, int] = {}
        self._links: list[_Link] = []
        self._elements: list[tuple[float, ...]] = []
        self._element_link: list[int] = []
        self.row_of_link: dict[str, int] = {}

    def node(self, name: str, east_m: float, north_m: float, **more: Any) -> None:
        """A node with its place, and more of its fields."""
        self._number[name] = len(self._nodes)
        self._nodes.append(_Node(east_m=east_m, north_m=north_m, **more))

    def straight(self, start: str, end: str, kind: LinkKind) -> None:
        """A straight link between two nodes."""
        a, b = self._nodes[self._number[start]], self._nodes[self._number[end]]
        east, north = b.east_m - a.east_m, b.north_m - a.north_m
        self.chain(f"{start} {end}", math.atan2(north, east), [(math.hypot(east, north), 0.0)], kind)

    def chain(self, nodes: str, yaw_rad: float, pieces: Sequence[Pair], kind: LinkKind) -> None:
        """A link by pieces of (length [m], curvature [1/m]) from its start, in direction `yaw_rad`, to its end.

        `nodes` names the two. Raises ValueError where the pieces do not end at the second one.
        """
        start, end = nodes.split()
        a, b = self._nodes[self._number[start]], self._nodes[self._number[end]]
        east, north, yaw, s = a.east_m, a.north_m, yaw_rad, 0.0
        for length, curvature in pieces:
            self._elements.append((east, north, yaw, length, curvature, s))
            self._element_link.append(len(self._links))
            turn = curvature * length
            chord = length * float(np.sinc(0.5 * turn / np.pi))
            east += chord * math.cos(yaw + 0.5 * turn)
            north += chord * math.sin(yaw + 0.5 * turn)
            yaw, s = yaw + turn, s + length
        missed = math.hypot(east - b.east_m, north - b.north_m)
        if missed > _CLOSED_M:
            raise ValueError(f"link {start} to {end} ends {missed:.3f} m off its node, expected at it")
        self.row_of_link[f"{start}-{end}"] = len(self._links)
        ends = self._number[start], self._number[end]
        self._links.append(_Link(start=ends[0], end=ends[1], length_m=s, kind=kind))

    def roads(self, terrain: Terrain) -> Roads:
        """All that was drawn, on a terrain."""
        kinds = [link.kind for link in self._links]
        start = np.array([link.start for link in self._links]) + 1
        end = np.array([link.end for link in self._links]) + 1
        level = np.array([kind.level for kind in kinds], np.int64)
        shape = np.array([self._shape(link) for link in self._links])
        element_link = np.array(self._element_link, np.int64)
        node_level = np.array([node.level for node in self._nodes], np.int64)
        places = [(node.east_m, node.north_m, node.radius_m, node.lift_m) for node in self._nodes]
        return Roads(
            terrain=terrain,
            link_id=np.arange(1, len(level) + 1),
            start_node=start,
            end_node=end,
            level=level,
            shape=shape,
            covered_m=np.array([kind.covered_m for kind in kinds]),
            bridge_m=np.array([kind.bridge_m for kind in kinds]),
            lane_offset_m=np.array([kind.lane_offset_m for kind in kinds]),
            speed_m_s=np.array([kind.speed_m_s for kind in kinds]),
            style=tuple(kind.style for kind in kinds),
            elements=np.array(self._elements, np.float64),
            element_link=element_link,
            node_id=np.arange(1, len(self._nodes) + 1),
            nodes_m=np.array(places),
            node_level=node_level,
            _rows=answering_rows((start, end), (level, node_level), shape, element_link),
        )

    def _shape(self, link: _Link) -> tuple[float, ...]:
        kind, ends = link.kind, (self._nodes[link.start], self._nodes[link.end])
        flat = kind.flat_m or (ends[0].radius_m + 2.0, ends[1].radius_m + 2.0)
        rise = kind.rise_m or (0.0, link.length_m)
        return kind.half_width_m, kind.crossfall, *kind.lift_m, *rise, *flat, link.length_m, 0.0

"""Links of the map as coarse as those of maps that navigation uses: thinned, and metres off the road.

Nodes are off by a vector each; along a link the error goes from that of its first node over errors across the road,
drawn every 50 m, to that of its last node, always a mean of such errors, so that it is nowhere larger than the largest.
"""

from __future__ import annotations

import math

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.replay.coarse_links import thinned
from camber.road_map.road_columns import RoadLinks
from camber.simulator.random_streams import stream
from camber.simulator.world.roads import Roads

# Chosen: fine against the knots of the error, of which a small share is left to the thinning.
_STEP_M = 2.0
_KNOT_M = 50.0
_THINNING_SHARE = 1.0 / 6.0


def surveyed_links(roads: Roads, frame: LocalFrame, seed: int, deviation_m: float) -> RoadLinks:
    """The links of all roads, with their ids; no point of a line is further than `deviation_m` off the centre line."""
    rng = stream(seed, "survey links")
    largest_m = deviation_m * (1.0 - _THINNING_SHARE)
    size = largest_m * rng.uniform(0.5, 1.0, len(roads.node_id))
    angle = rng.uniform(0.0, 2.0 * math.pi, len(roads.node_id))
    of_nodes = np.column_stack((size * np.cos(angle), size * np.sin(angle)))
    vertices = []
    for link in range(len(roads.link_id)):
        length = float(roads.length_m[link])
        s = np.linspace(0.0, length, math.ceil(length / _STEP_M) + 1)
        east, north, yaw = roads.centre_line(link, s)
        line = np.column_stack((east, north))
        knots = int(length // _KNOT_M) + 2
        across = largest_m * rng.uniform(0.5, 1.0, knots) * np.where(rng.random(knots) < 0.5, -1.0, 1.0)
        inner = np.interp(s, np.arange(knots) * _KNOT_M, across)
        left = np.column_stack((-np.sin(yaw), np.cos(yaw)))
        reach = min(_KNOT_M, 0.5 * length)
        at_start = np.clip(1.0 - s / reach, 0.0, 1.0)[:, None]
        at_end = np.clip(1.0 - (length - s) / reach, 0.0, 1.0)[:, None]
        error = at_start * of_nodes[roads.start_node[link] - 1] + at_end * of_nodes[roads.end_node[link] - 1]
        error += (1.0 - at_start - at_end) * inner[:, None] * left
        corners = thinned(line, deviation_m * _THINNING_SHARE)
        moved = (line + error)[corners]
        latitude, longitude, _ = frame.geodetic_from_east_north_array(moved, np.zeros(len(moved)))
        vertices.append(np.column_stack((latitude, longitude)))
    return RoadLinks(
        link_id=roads.link_id,
        start_node=roads.start_node,
        end_node=roads.end_node,
        level=roads.level,
        sigma_m=np.full(len(roads.link_id), 0.5 * deviation_m),
        vertices=vertices,
    )

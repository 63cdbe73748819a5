"""Links around a point: all that come near, each once and whole, or unknown."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from camber.map_server.links import MAX_REPLY_BYTES, links_around
from camber.road_map.road_tiles import link_tiles
from camber.road_map.tile_grid import tiles_around
from camber.schemas.codec import encode
from camber.schemas.road import LinksReply, LinksRequest
from support.small_map import FRAME, MADE_NS, at, link, links


def ask(rows: list[dict[str, Any]], radius_m: float, east_m: float = 0.0, north_m: float = 0.0) -> LinksReply:
    latitude, longitude = at(east_m, north_m)
    request = LinksRequest(time_ns=MADE_NS, latitude_rad=latitude, longitude_rad=longitude, radius_m=radius_m)
    near = set(tiles_around(latitude, longitude, radius_m))
    tiles = [tile for tile in link_tiles(links(rows)) if (tile.x, tile.y) in near]
    return links_around(tiles, request, map_version=7, time_ns=MADE_NS)


def test_links_within_the_radius_are_returned_whole() -> None:
    rows = [
        link(1, (1, 2), [(-1500.0, 30.0), (0.0, 30.0), (1500.0, 40.0)], level=1),
        link(2, (2, 3), [(0.0, 51.0), (0.0, 300.0)]),
    ]
    reply = ask(rows, 50.0)
    assert (reply.status, reply.reason, reply.map_version) == ("known", "", 7)
    assert reply.link_id.tolist() == [1]
    assert (reply.start_node[0], reply.end_node[0], reply.level[0], reply.sigma_m[0]) == (1, 2, 1, 0.5)
    assert reply.first_vertex.tolist() == [0, 3]
    vertices = np.column_stack((reply.latitude_rad, reply.longitude_rad))
    assert np.allclose(vertices, rows[0]["vertices"], rtol=0.0, atol=1.1e-11)


def test_links_of_several_tiles_are_returned_once_by_id() -> None:
    rng = np.random.default_rng(5)
    rows = [link(90 - i, (i, i + 1), rng.uniform(-900.0, 900.0, (3, 2)).tolist()) for i in range(40)]
    reply = ask(rows, 1300.0)
    assert reply.link_id.tolist() == sorted(row["link_id"] for row in rows)


@pytest.mark.parametrize("seed", range(5))
def test_the_distance_is_that_to_the_nearest_point_of_the_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = [link(i, (i, i), (rng.uniform(-600.0, 600.0, (4, 2))).tolist()) for i in range(30)]
    want = []
    for row in rows:
        line_m = FRAME.east_north_from_geodetic_array(*row["vertices"].T, np.zeros(4))
        samples_m = np.concatenate([np.linspace(a, b, 20_000) for a, b in itertools.pairwise(line_m)])
        if np.hypot(*samples_m.T).min() <= 150.0:
            want.append(row["link_id"])
    assert 3 < len(want) < 27
    assert ask(rows, 150.0).link_id.tolist() == want


def test_within_the_map_there_may_be_no_link_near() -> None:
    reply = ask([link(1, (1, 2), [(50.0, 0.0), (60.0, 0.0)])], 5.0)
    assert reply.status == "known"
    assert len(reply.link_id) == 0


def test_beyond_the_map_links_are_unknown() -> None:
    reply = ask([link(1, (1, 2), [(50.0, 0.0), (60.0, 0.0)])], 5.0, east_m=20_000.0)
    assert (reply.status, reply.reason) == ("unknown", "no links of the map are near")


def test_a_reply_too_large_for_a_message_is_unknown() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 400)
    circle_m = np.column_stack((20.0 * np.cos(angle), 20.0 * np.sin(angle))).tolist()
    rows = [link(i, (i, i), circle_m) for i in range(60)]
    statuses = []
    for n in range(1, 61, 4):
        reply = ask(rows[:n], 100.0)
        statuses.append(reply.status)
        assert len(encode(reply)) <= MAX_REPLY_BYTES
    assert statuses[0] == "known"
    assert statuses[-1] == "unknown"
    assert sorted(statuses) == statuses  # more links never make it known again
    assert "at most 256000 go into a reply" in reply.reason

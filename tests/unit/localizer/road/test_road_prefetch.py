"""The road ahead: the map's reply for the places to come does where they come, and nowhere else."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.road.road_prefetch import RoadAhead, places_ahead
from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.road_tiles import link_tiles, surface_tiles
from camber.schemas.road import ElevationReply, ElevationRequest
from support.small_map import at, link, links, surface, surfaces

NS = 1_300_000_000 * 1_000_000_000
SECOND_NS = 1_000_000_000
# A road to the east that rises by 5 %, cut into surfaces of 20 m; 100 m on there is a bridge on another level.
ROAD = [
    surface(10 + k, 20.0 * k, link_id=1, heights_m=[[50.0 + k, 50.0 + k], [51.0 + k, 51.0 + k]])
    for k in range(5)
]
BRIDGE = surface(20, 100.0, link_id=2, level=1, heights_m=57.0)
LINKS = [link(1, (1, 2), [(-10.0, 0.0), (90.0, 0.0)]), link(2, (2, 3), [(90.0, 0.0), (110.0, 0.0)], level=1)]


def the_map() -> ElevationMap:
    tiles = {(tile.x, tile.y): tile for tile in surface_tiles(surfaces([*ROAD, BRIDGE]))}
    of_links = {(tile.x, tile.y): tile for tile in link_tiles(links(LINKS))}
    return ElevationMap(
        lambda x, y: tiles.get((x, y)), lambda x, y: of_links.get((x, y)), datum="WGS84", map_version=7
    )


MAP = the_map()
OFF_THE_PLACES = [(-1.5, 0.0), (23.0, 0.0), (10.0, 1.6), (10.0, -1.6), (5e3, 0.0)]


def ask(east_m: float = 0.0, *, speed_m_s: float = 10.0, yaw_rad: float = 0.0, **changes: Any) -> RoadAhead:
    latitude_rad, longitude_rad = at(east_m, 0.0)
    request = ElevationRequest(
        time_ns=NS,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        link_ids=(1,),
        ahead=places_ahead(yaw_rad, speed_m_s, 0.0),
    )
    assert request.ahead is not None
    reply = ElevationReply(
        time_ns=NS,
        road=MAP.road(latitude_rad, longitude_rad, request.link_ids),
        ahead=MAP.roads_ahead(latitude_rad, longitude_rad, request.ahead, request.link_ids),
    )
    answer = RoadAhead.of(request, reply.model_copy(update=changes))
    assert answer is not None
    return answer


@pytest.mark.parametrize("speed_m_s", [12.0, 2.5, -3.0])
@pytest.mark.parametrize("yaw_rate_rad_s", [0.0, 0.4, -0.4])
@pytest.mark.parametrize("yaw_rad", [0.0, 2.3, -1.1])
def test_the_places_are_where_the_vehicle_comes(
    speed_m_s: float, yaw_rate_rad_s: float, yaw_rad: float
) -> None:
    places = places_ahead(yaw_rad, speed_m_s, yaw_rate_rad_s)
    east_m = north_m = 0.0
    step_s = 1e-3
    for k in range(2000):  # for two seconds, in small straight steps
        assert np.hypot(places.east_m - east_m, places.north_m - north_m).min() < 0.4
        yaw = yaw_rad + yaw_rate_rad_s * (k + 0.5) * step_s
        east_m += speed_m_s * step_s * math.cos(yaw)
        north_m += speed_m_s * step_s * math.sin(yaw)


@pytest.mark.parametrize("speed_m_s", [0.0, 80.0, -80.0])
def test_at_any_speed_the_places_are_few_and_fit_into_the_question(speed_m_s: float) -> None:
    assert len(places_ahead(0.3, speed_m_s, 1.0).east_m) <= 1024


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.floats(-0.4, 20.0), st.floats(-1.2, 1.2))
def test_it_says_what_the_map_would_say_there(along_m: float, across_m: float) -> None:
    point = at(along_m, across_m)
    result, asked = ask().road_at(NS + SECOND_NS, point, link_ids=(1,), radius_m=0.5), MAP.road(*point, (1,))
    assert (result.status, result.level, result.datum, result.map_version) == ("known", 0, "WGS84", 7)
    assert result.elevation_m == pytest.approx(asked.elevation_m, abs=1e-3)
    assert (result.slope_east, result.slope_north) == pytest.approx(
        (asked.slope_east, asked.slope_north), abs=1e-5
    )
    assert result.sigma_m == asked.sigma_m
    # At the joint of two surfaces either of them may be named.
    assert result.surface_id == asked.surface_id or abs((along_m + 10.0) % 20.0) < 0.9 or along_m % 20.0 > 9.1


@pytest.mark.parametrize(
    ("place_m", "after_ns", "link_ids", "radius_m", "known"),
    [
        *(((east, north), 0, (1,), 0.5, False) for east, north in OFF_THE_PLACES),
        ((1.0, 0.0), 2 * SECOND_NS, (1,), 0.5, True),
        ((1.0, 0.0), 2 * SECOND_NS + 1, (1,), 0.5, False),
        ((1.0, 0.0), -1, (1,), 0.5, False),
        ((1.0, 0.0), 0, (1, 2), 0.5, False),
        ((1.0, 0.0), 0, (), 0.5, False),
        # Half the diagonal of a surface is 10.2 m.
        ((1.25, 0.0), 0, (1,), 9.5, True),
        ((1.25, 0.0), 0, (1,), 11.0, False),
    ],
)
def test_it_is_good_on_its_places_for_two_seconds_for_its_links_and_as_far_as_its_plane_holds(
    place_m: tuple[float, float], after_ns: int, link_ids: tuple[int, ...], radius_m: float, known: bool
) -> None:
    road = ask().road_at(NS + after_ns, at(*place_m), link_ids=link_ids, radius_m=radius_m)
    assert (road is not None) == known


def test_beyond_the_end_of_the_road_it_says_nothing() -> None:
    answer = ask(80.0)
    assert answer.road_at(NS, at(89.0, 0.0), link_ids=(1,), radius_m=0.5) is not None
    # The bridge is another link and another level, where the candidates are on this one: ambiguous to the map.
    assert answer.road_at(NS, at(91.5, 0.0), link_ids=(1,), radius_m=0.5) is None


def test_a_level_other_than_the_one_it_was_asked_from_is_asked_for_anew() -> None:
    answer = ask(80.0)
    upstairs = answer.road.model_copy(update={"level": 1})
    assert replace(answer, road=upstairs).road_at(NS, at(81.0, 0.0), link_ids=(1,), radius_m=0.5) is None


def test_an_answer_that_knows_nothing_or_names_places_never_asked_for_is_none() -> None:
    answer = ask()
    reply = ElevationReply(time_ns=NS, road=answer.road, ahead=answer.known)
    assert RoadAhead.of(answer.request, reply.model_copy(update={"ahead": None})) is None
    unknown = answer.road.model_copy(update={"status": "unknown"})
    assert RoadAhead.of(answer.request, reply.model_copy(update={"road": unknown})) is None
    fewer = answer.request.model_copy(update={"ahead": places_ahead(0.0, 1.0, 0.0)})
    assert RoadAhead.of(fewer, reply) is None


def test_its_extent_is_measured_from_the_place_sampled_a_quarter_metre_away() -> None:
    result = ask().road_at(NS, at(1.25, 0.0), link_ids=(1,), radius_m=0.0)
    assert result.extent_m <= math.hypot(10.0, 2.0) - 0.25 + 1e-6


def test_where_the_nearest_place_is_not_known_no_neighbour_stands_for_it() -> None:
    answer = ask()
    at_ten = int(np.argmin(np.hypot(answer.east_m - 10.0, answer.north_m)))
    assert answer.road_at(NS, at(10.1, 0.0), link_ids=(1,), radius_m=0.5) is not None
    unknown = answer.row.copy()
    unknown[at_ten] = -1
    assert replace(answer, row=unknown).road_at(NS, at(10.1, 0.0), link_ids=(1,), radius_m=0.5) is None

"""The localizer's plane: metres about a place nearby, and the honest word when a place is not nearby."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.localizer.local_plane import MOVE_AFTER_M, LocalPlane
from camber.schemas.road import LinksReply

LATITUDE, LONGITUDE = math.radians(35.17), math.radians(136.9)


def test_beyond_two_kilometres_it_is_time_for_another() -> None:
    plane = LocalPlane(LATITUDE, LONGITUDE)
    assert not plane.is_too_far(MOVE_AFTER_M, 0.0)
    assert not plane.is_too_far(-1400.0, 1400.0)
    assert plane.is_too_far(0.0, -MOVE_AFTER_M - 1.0)
    assert plane.is_too_far(1500.0, 1500.0)


@given(east_m=st.floats(-5000.0, 5000.0), north_m=st.floats(-5000.0, 5000.0))
def test_it_reaches_as_far_as_it_is_good(east_m: float, north_m: float) -> None:
    plane = LocalPlane(LATITUDE, LONGITUDE)
    distance = math.hypot(east_m, north_m)
    if abs(distance - MOVE_AFTER_M) > 0.005 * MOVE_AFTER_M:  # a sphere of mean radius
        assert plane.covers(*plane.geodetic(east_m, north_m)) is (distance < MOVE_AFTER_M)


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [(0.0, 0.0), (-LATITUDE, LONGITUDE - math.pi), (LATITUDE, -LONGITUDE), (-LATITUDE, LONGITUDE)],
)
def test_it_does_not_reach_the_other_side_of_the_earth(latitude: float, longitude: float) -> None:
    assert not LocalPlane(LATITUDE, LONGITUDE).covers(latitude, longitude)


def test_it_reaches_across_the_antimeridian() -> None:
    assert LocalPlane(0.3, math.pi - 1e-6).covers(0.3, -math.pi + 1e-6)


def test_links_are_laid_into_the_plane_each_with_its_vertices() -> None:
    plane = LocalPlane(LATITUDE, LONGITUDE)
    lines = [np.array([[0.0, 0.0], [100.0, 0.0], [150.0, 20.0]]), np.array([[150.0, 20.0], [150.0, 90.0]])]
    points = np.array([plane.geodetic(*point) for line in lines for point in line])
    reply = LinksReply(
        time_ns=1_300_000_000 * 10**9,
        status="known",
        map_version=1,
        link_id=np.array([7, 8], dtype=np.int64),
        start_node=np.array([1, 2], dtype=np.int64),
        end_node=np.array([2, 3], dtype=np.int64),
        level=np.array([0, 1], dtype=np.int32),
        sigma_m=np.array([0.5, 1.5]),
        first_vertex=np.array([0, 3, 5], dtype=np.int32),
        latitude_rad=np.ascontiguousarray(points[:, 0]),
        longitude_rad=np.ascontiguousarray(points[:, 1]),
    )
    links = plane.links(reply)
    assert [(x.link_id, x.start_node, x.end_node, x.level, x.sigma_m) for x in links] == [
        (7, 1, 2, 0, 0.5),
        (8, 2, 3, 1, 1.5),
    ]
    for link, line in zip(links, lines, strict=True):
        assert link.vertices_m == pytest.approx(line, abs=1e-6)

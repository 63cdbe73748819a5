"""Small offsets in east and north metres, and back."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.offsets import east_north_between, geodetic_at_offset

latitude = st.floats(-1.5, 1.5)
longitude = st.floats(-math.pi, math.pi)
metres = st.floats(-1000.0, 1000.0)


def test_a_point_is_nowhere_from_itself():
    assert east_north_between(0.6, 2.4, 0.6, 2.4) == (0.0, 0.0)


@pytest.mark.parametrize("height_m", [0.0, 50.0, 4000.0])
@pytest.mark.parametrize("latitude_rad", [-1.2, -0.6, 0.0, 0.6, 1.2])
@pytest.mark.parametrize("offset", [(100.0, 0.0), (0.0, -100.0), (300.0, 400.0), (-5.0, 12.0)])
def test_it_departs_from_the_tangent_plane_by_no_more_than_the_meridians_turn(latitude_rad, height_m, offset):
    to = geodetic_at_offset(latitude_rad, 2.4, *offset, height_m)
    enu = LocalFrame(latitude_rad, 2.4, height_m).enu_from_geodetic(*to, height_m)
    turned_m = math.hypot(*offset) ** 2 * abs(math.tan(latitude_rad)) / (2.0 * 6.36e6)
    assert math.dist(enu[:2], offset) <= 1.01 * turned_m + 1e-5


@given(latitude, longitude, metres, metres)
def test_there_and_back_is_where_it_began(latitude_rad, longitude_rad, east_m, north_m):
    to = geodetic_at_offset(latitude_rad, longitude_rad, east_m, north_m)
    assert east_north_between(latitude_rad, longitude_rad, *to) == pytest.approx((east_m, north_m), abs=1e-5)


@given(latitude, longitude, metres, metres)
def test_the_way_back_is_the_opposite(latitude_rad, longitude_rad, east_m, north_m):
    to = geodetic_at_offset(latitude_rad, longitude_rad, east_m, north_m)
    back = east_north_between(*to, latitude_rad, longitude_rad)
    assert back == pytest.approx((-east_m, -north_m), abs=2e-4)


def test_across_the_antimeridian_the_short_way_counts():
    east_m, north_m = east_north_between(0.0, math.pi - 1e-6, 0.0, -math.pi + 1e-6)
    assert east_m == pytest.approx(2e-6 * 6378137.0, rel=1e-6)
    assert north_m == 0.0
    _, longitude_rad = geodetic_at_offset(0.0, math.pi - 1e-6, east_m, 0.0)
    assert longitude_rad == pytest.approx(-math.pi + 1e-6, abs=1e-12)


def test_higher_up_the_same_angle_is_farther():
    low = east_north_between(0.6, 2.4, 0.6001, 2.4001)
    high = east_north_between(0.6, 2.4, 0.6001, 2.4001, 1000.0)
    assert high[0] > low[0]
    assert high[1] > low[1]

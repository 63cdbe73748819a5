"""Small offsets in east and north metres."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.angles import wrap_pi
from camber.geodesy.horizontal_offsets import east_north_between, place_at
from camber.geodesy.local_frame import LocalFrame

latitude = st.floats(-1.5, 1.5)
longitude = st.floats(-math.pi, math.pi)
angle = st.floats(-1.5e-4, 1.5e-4)  # a kilometre


def test_a_point_is_nowhere_from_itself():
    assert east_north_between(0.6, 2.4, 0.6, 2.4) == (0.0, 0.0)


@pytest.mark.parametrize("height_m", [0.0, 50.0, 4000.0])
@pytest.mark.parametrize("latitude_rad", [-1.2, -0.6, 0.0, 0.6, 1.2])
@pytest.mark.parametrize("offset", [(100.0, 0.0), (0.0, -100.0), (300.0, 400.0), (-5.0, 12.0)])
def test_it_departs_from_the_tangent_plane_by_no_more_than_the_meridians_turn(latitude_rad, height_m, offset):
    frame = LocalFrame(latitude_rad, 2.4, height_m)
    to_latitude_rad, to_longitude_rad, _ = frame.geodetic_from_east_north(*offset, height_m)
    between = east_north_between(latitude_rad, 2.4, to_latitude_rad, to_longitude_rad, height_m)
    turned_m = math.hypot(*offset) ** 2 * abs(math.tan(latitude_rad)) / (2.0 * 6.36e6)
    assert math.dist(between, offset) <= 1.01 * turned_m + 1e-5


@given(latitude, longitude, angle, angle)
def test_the_reverse_offset_is_the_opposite(latitude_rad, longitude_rad, north_rad, east_rad):
    to = latitude_rad + north_rad, wrap_pi(longitude_rad + east_rad)
    there = east_north_between(latitude_rad, longitude_rad, *to)
    back = east_north_between(*to, latitude_rad, longitude_rad)
    assert back == pytest.approx((-there[0], -there[1]), abs=1e-5)


def test_across_the_antimeridian_the_smaller_angle_counts():
    east_m, north_m = east_north_between(0.0, math.pi - 1e-6, 0.0, -math.pi + 1e-6)
    assert east_m == pytest.approx(2e-6 * 6378137.0, rel=1e-6)
    assert north_m == 0.0


def test_higher_up_the_same_angle_is_farther():
    low, high = (east_north_between(0.6, 2.4, 0.6001, 2.4001, height_m) for height_m in (0.0, 1000.0))
    assert np.all(np.greater(high, low))


@settings(derandomize=True, deadline=None)
@given(st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
def test_the_place_at_an_offset_has_that_offset(latitude_rad, longitude_rad, east_m, north_m):
    there = place_at(latitude_rad, longitude_rad, east_m, north_m, height_m=100.0)
    offset = east_north_between(latitude_rad, longitude_rad, *there, height_m=100.0)
    assert offset == pytest.approx((east_m, north_m), abs=1e-3)

"""Geodetic and earth-centred coordinates, against RTKLIB's published values and against each other."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.ellipsoid import (
    SEMI_MAJOR_AXIS_M,
    SEMI_MINOR_AXIS_M,
    ecef_from_geodetic,
    ecef_from_geodetic_scalar,
    geodetic_from_ecef,
    geodetic_from_ecef_scalar,
    meridian_radius_m,
    prime_vertical_radius_m,
)

# One unit of the last place of an ECEF coordinate is 9.3e-10 m; a height is a sum of three such terms.
ROUNDING_M = 5.0e-9

latitudes = st.floats(-math.pi / 2, math.pi / 2)
longitudes = st.floats(-math.pi, math.pi)
heights = st.floats(-12_000.0, 100_000.0)


def test_rtklib_t_coord_values() -> None:
    # RTKLIB test/utest/t_coord.c, utest1
    latitude, longitude, height = geodetic_from_ecef_scalar(-3517319.7701, 4131667.9161, 3341265.1227)
    assert math.degrees(latitude) == pytest.approx(31.796021375, abs=1e-9)
    assert math.degrees(longitude) == pytest.approx(130.40799917, abs=1e-8)
    assert height == pytest.approx(68.8632, abs=1e-4)


def test_reference_of_nagoya_agrees_with_its_ecef() -> None:
    # first row of a recorded reference: both forms, printed to 1e-8 degrees and 1 mm
    x, y, z = ecef_from_geodetic_scalar(math.radians(35.16536109), math.radians(136.88140866), 41.391)
    assert math.dist((x, y, z), (-3810228.582, 3567868.547, 3652903.300)) < 2.0e-3


@given(latitudes, longitudes, heights)
def test_round_trip_in_metres(latitude: float, longitude: float, height: float) -> None:
    point = ecef_from_geodetic_scalar(latitude, longitude, height)
    latitude_again, longitude_again, height_again = geodetic_from_ecef_scalar(*point)
    assert abs(height_again - height) < ROUNDING_M
    assert abs(latitude_again - latitude) * SEMI_MAJOR_AXIS_M < ROUNDING_M
    assert -math.pi < longitude_again <= math.pi
    again = ecef_from_geodetic_scalar(latitude_again, longitude_again, height_again)
    assert math.dist(again, point) < ROUNDING_M


@given(latitudes, longitudes, st.floats(-300_000.0, 4.0e7))
def test_round_trip_from_deep_to_satellites(latitude: float, longitude: float, height: float) -> None:
    point = ecef_from_geodetic_scalar(latitude, longitude, height)
    again = ecef_from_geodetic_scalar(*geodetic_from_ecef_scalar(*point))
    assert math.dist(again, point) < 5.0e-8


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_poles(sign: float) -> None:
    latitude, longitude, height = geodetic_from_ecef_scalar(0.0, 0.0, sign * (SEMI_MINOR_AXIS_M + 100.0))
    assert latitude == sign * math.pi / 2
    assert longitude == 0.0
    assert height == pytest.approx(100.0, abs=ROUNDING_M)


@given(st.floats(0.0, 1.0e-3), longitudes)
def test_next_to_the_pole(distance: float, longitude: float) -> None:
    point = (distance * math.cos(longitude), distance * math.sin(longitude), SEMI_MINOR_AXIS_M + 5.0)
    again = ecef_from_geodetic_scalar(*geodetic_from_ecef_scalar(*point))
    assert math.dist(again, point) < ROUNDING_M


@pytest.mark.parametrize("y", [0.0, -0.0])
def test_antimeridian_is_plus_pi_on_both_sides_of_zero(y: float) -> None:
    assert geodetic_from_ecef_scalar(-6378137.0, y, 0.0) == (0.0, math.pi, 0.0)
    _, longitude, _ = geodetic_from_ecef(np.array([[-6378137.0, y, 0.0]]))
    assert longitude[0] == math.pi


def test_across_the_antimeridian_positions_are_neighbours() -> None:
    east = ecef_from_geodetic_scalar(0.3, math.pi - 1e-9, 10.0)
    west = ecef_from_geodetic_scalar(0.3, -math.pi + 1e-9, 10.0)
    assert math.dist(east, west) < 0.02


def test_arrays_agree_with_scalars() -> None:
    rng = np.random.default_rng(20230711)
    latitude = rng.uniform(-math.pi / 2, math.pi / 2, 500)
    longitude = rng.uniform(-math.pi, math.pi, 500)
    height = rng.uniform(-500.0, 9000.0, 500)
    ecef = ecef_from_geodetic(latitude, longitude, height)
    back = np.column_stack(geodetic_from_ecef(ecef))
    for i in range(500):
        one = ecef_from_geodetic_scalar(latitude[i], longitude[i], height[i])
        assert math.dist(one, tuple(ecef[i])) < ROUNDING_M
        assert back[i] == pytest.approx(geodetic_from_ecef_scalar(*ecef[i]), abs=ROUNDING_M)
    assert np.max(np.abs(back[:, 2] - height)) < ROUNDING_M
    assert np.max(np.abs(back[:, 0] - latitude)) * SEMI_MAJOR_AXIS_M < ROUNDING_M


def test_empty_and_broadcast_arrays() -> None:
    assert ecef_from_geodetic([], [], []).shape == (0, 3)
    assert geodetic_from_ecef(np.empty((0, 3)))[0].shape == (0,)
    assert ecef_from_geodetic([0.1, 0.2], 0.3, 0.0).shape == (2, 3)


@pytest.mark.parametrize(
    "point", [(0.0, 0.0, 0.0), (math.nan, 0.0, 6.4e6), (math.inf, 0.0, 0.0), (1.0e6, 1.0e6, 1.0e6)]
)
def test_no_position_is_refused(point: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="centre"):
        geodetic_from_ecef_scalar(*point)
    with pytest.raises(ValueError, match="centre"):
        geodetic_from_ecef(np.array([point]))


def test_shape_errors_name_the_argument() -> None:
    with pytest.raises(ValueError, match=r"ecef_m has shape \(3,\), expected \(n, 3\)"):
        geodetic_from_ecef(np.zeros(3))
    with pytest.raises(ValueError, match=r"expected \(n,\)"):
        ecef_from_geodetic(np.zeros((2, 2)), 0.0, 0.0)


@given(st.floats(-1.5, 1.5))
def test_radii_of_curvature_are_those_of_small_steps(latitude: float) -> None:
    step = 1.0e-6
    here = ecef_from_geodetic_scalar(latitude, 0.0, 0.0)
    north = ecef_from_geodetic_scalar(latitude + step, 0.0, 0.0)
    east = ecef_from_geodetic_scalar(latitude, step, 0.0)
    axis_m = prime_vertical_radius_m(latitude) * math.cos(latitude)
    assert math.dist(here, north) == pytest.approx(meridian_radius_m(latitude) * step, rel=1e-6)
    assert math.dist(here, east) == pytest.approx(axis_m * step, rel=1e-6)

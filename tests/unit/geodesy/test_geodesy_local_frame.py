"""Tangent frames: up is not height, and (east, north, ellipsoidal height) has an exact inverse."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.geodesy.local_frame import LocalFrame

NAGOYA = LocalFrame(math.radians(35.1653), math.radians(136.8814), 41.0)

frames = st.builds(
    LocalFrame, st.floats(-math.pi / 2, math.pi / 2), st.floats(-math.pi, math.pi), st.floats(-400.0, 5000.0)
)
offsets = st.floats(-20_000.0, 20_000.0)
heights = st.floats(-400.0, 9000.0)


def test_origin_is_zero() -> None:
    assert NAGOYA.enu_from_geodetic(NAGOYA.latitude_rad, NAGOYA.longitude_rad, 41.0) == (0.0, 0.0, 0.0)


def test_axes_point_east_north_up() -> None:
    latitude, longitude = NAGOYA.latitude_rad, NAGOYA.longitude_rad
    east = NAGOYA.enu_from_geodetic(latitude, longitude + 1e-6, 41.0)
    north = NAGOYA.enu_from_geodetic(latitude + 1e-6, longitude, 41.0)
    assert east == pytest.approx((5.22, 0.0, 0.0), abs=0.01)
    assert north == pytest.approx((0.0, 6.36, 0.0), abs=0.01)
    assert NAGOYA.enu_from_geodetic(latitude, longitude, 42.0) == pytest.approx((0.0, 0.0, 1.0), abs=1e-8)


@pytest.mark.parametrize(("distance", "drop"), [(1000.0, 0.078), (4000.0, 1.25), (20_000.0, 31.4)])
def test_up_is_not_height(distance: float, drop: float) -> None:
    latitude, longitude, height = NAGOYA.geodetic_from_east_north(distance, 0.0, 41.0)
    _, _, up = NAGOYA.enu_from_geodetic(latitude, longitude, height)
    assert height == 41.0
    assert up == pytest.approx(-drop, rel=0.01)


@given(frames, offsets, offsets, st.floats(-500.0, 9000.0))
def test_enu_round_trip(frame: LocalFrame, east: float, north: float, up: float) -> None:
    again = frame.enu_from_geodetic(*frame.geodetic_from_enu(east, north, up))
    assert again == pytest.approx((east, north, up), abs=1e-8)


@given(frames, offsets, offsets, heights)
def test_east_north_round_trip_keeps_the_ellipsoidal_height(
    frame: LocalFrame, east: float, north: float, height: float
) -> None:
    latitude, longitude, height_again = frame.geodetic_from_east_north(east, north, height)
    assert height_again == height
    plane = frame.east_north_from_geodetic(latitude, longitude, height)
    assert plane == pytest.approx((east, north), abs=1e-6)
    again = ecef_from_geodetic_scalar(*frame.geodetic_from_east_north(*plane, height))
    assert math.dist(again, ecef_from_geodetic_scalar(latitude, longitude, height)) < 1e-6


def test_frame_across_the_antimeridian() -> None:
    frame = LocalFrame(-0.3, math.pi, 0.0)
    _, longitude, _ = frame.geodetic_from_east_north(100.0, 0.0, 0.0)
    assert longitude < 0.0
    assert frame.east_north_from_geodetic(-0.3, longitude, 0.0)[0] == pytest.approx(100.0, abs=0.01)


@pytest.mark.parametrize("latitude", [math.pi / 2, -math.pi / 2])
def test_frame_at_a_pole(latitude: float) -> None:
    frame = LocalFrame(latitude, 0.4, 2800.0)
    plane = frame.east_north_from_geodetic(*frame.geodetic_from_east_north(30.0, -40.0, 2801.0))
    assert plane == pytest.approx((30.0, -40.0), abs=1e-8)


def test_arrays_agree_with_scalars() -> None:
    rng = np.random.default_rng(4711)
    plane = rng.uniform(-20_000.0, 20_000.0, (200, 2))
    height = rng.uniform(0.0, 500.0, 200)
    latitude, longitude, height_again = NAGOYA.geodetic_from_east_north_array(plane, height)
    assert np.array_equal(height_again, height)
    back = NAGOYA.east_north_from_geodetic_array(latitude, longitude, height)
    assert np.max(np.abs(back - plane)) < 1e-6
    enu = NAGOYA.enu_from_geodetic_array(latitude, longitude, height)
    geodetic = np.column_stack(NAGOYA.geodetic_from_enu_array(enu))
    assert np.max(np.abs(geodetic - np.column_stack((latitude, longitude, height)))) < 1e-8
    for i in range(200):
        one = NAGOYA.geodetic_from_east_north(plane[i, 0], plane[i, 1], height[i])
        assert one == pytest.approx((latitude[i], longitude[i], height[i]), abs=1e-13)
        assert NAGOYA.enu_from_geodetic(*one) == pytest.approx(enu[i], abs=1e-8)


def test_rotation_is_orthonormal_and_right_handed() -> None:
    rotation = NAGOYA.enu_from_ecef_rotation()
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_frames_compare_by_their_origin() -> None:
    assert LocalFrame(0.1, 0.2, 3.0) == LocalFrame(0.1, 0.2, 3.0)
    assert LocalFrame(0.1, 0.2, 3.0) != LocalFrame(0.1, 0.2, 3.1)


@pytest.mark.parametrize(
    "origin", [(1.6, 0.0, 0.0), (math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, math.nan)]
)
def test_bad_origins_are_refused(origin: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        LocalFrame(*origin)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 7.0e6])
def test_no_such_point_is_an_error(bad: float) -> None:
    with pytest.raises(ValueError, match=r"point"):
        NAGOYA.geodetic_from_east_north(bad, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"point"):
        NAGOYA.geodetic_from_east_north_array([[bad, 0.0]], [0.0])


def test_shape_errors_name_the_argument() -> None:
    with pytest.raises(ValueError, match=r"enu_m has shape \(3,\)"):
        NAGOYA.geodetic_from_enu_array(np.zeros(3))
    with pytest.raises(ValueError, match=r"east_north_m has shape \(2, 3\)"):
        NAGOYA.geodetic_from_east_north_array(np.zeros((2, 3)), np.zeros(2))

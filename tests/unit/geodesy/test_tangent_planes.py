"""Compiled tangent planes are those of LocalFrame, to the rounding of earth-centred coordinates."""

import math

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.tangent_planes import east_north, east_north_near, plane_origins, plane_series

SEED = 71


@pytest.mark.parametrize("reach_m", [10.0, 1e3, 6e4])
def test_positions_are_those_of_the_local_frame_anywhere_on_earth(reach_m: float) -> None:
    rng = np.random.default_rng(SEED)
    latitudes = np.concatenate((rng.uniform(-1.48, 1.48, 200), [0.0, math.pi / 2, -math.pi / 2]))
    longitudes = np.concatenate((rng.uniform(-math.pi, math.pi, 201), [math.pi, -math.pi]))
    error_m = []
    for origin, latitude, longitude in zip(
        plane_origins(latitudes, longitudes), latitudes.tolist(), longitudes.tolist(), strict=True
    ):
        frame = LocalFrame(latitude, longitude, 0.0)
        point = frame.geodetic_from_east_north(*rng.uniform(-reach_m, reach_m, 2), 0.0)
        error_m.append(np.subtract(east_north(origin, *point[:2]), frame.east_north_from_geodetic(*point)))
    assert np.abs(error_m).max() < 5e-9


def test_what_is_far_off_or_no_number_is_nowhere() -> None:
    (origin,) = plane_origins([0.6], [3.0])
    for point in [
        (-0.6, 3.0 - math.pi),
        (0.62, 3.0),
        (0.6, 3.02),
        (math.nan, 3.0),
        (0.6, math.nan),
        (0.6, math.inf),
    ]:
        assert east_north(origin, *point) == (math.inf, math.inf)


@pytest.mark.parametrize("reach_m", [1.0, 600.0, 1e4])
def test_the_series_near_an_origin_says_the_same(reach_m: float) -> None:
    rng = np.random.default_rng(SEED + 1)
    latitudes = np.concatenate((rng.uniform(-1.48, 1.48, 300), [0.0, 1.4844, -1.4844]))
    longitudes = np.concatenate((rng.uniform(-math.pi, math.pi, 301), [math.pi, -math.pi]))
    for origin, latitude, longitude in zip(
        plane_origins(latitudes, longitudes), latitudes.tolist(), longitudes.tolist(), strict=True
    ):
        frame = LocalFrame(latitude, longitude, 0.0)
        point = frame.geodetic_from_east_north(*rng.uniform(-reach_m, reach_m, 2), 0.0)[:2]
        near_m = east_north_near(plane_series(latitude, longitude), origin, *point)
        assert near_m == pytest.approx(east_north(origin, *point), abs=5e-9)
    assert east_north_near(plane_series(0.6, 3.0), origin, math.nan, 3.0) == (math.inf, math.inf)

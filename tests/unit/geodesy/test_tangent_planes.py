"""Compiled tangent planes are those of LocalFrame, to the rounding of earth-centred coordinates."""

import math

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.tangent_planes import east_north, east_north_near, plane_origins, plane_series

SEED = 71


def origins_and_points(seed: int, reach_m: float, extreme_latitude_rad: float):
    """Origins anywhere on earth, the frame of each, and a point within reach of it."""
    rng = np.random.default_rng(seed)
    edges = [0.0, extreme_latitude_rad, -extreme_latitude_rad]
    latitudes = np.concatenate((rng.uniform(-1.48, 1.48, 300), edges))
    longitudes = np.concatenate((rng.uniform(-math.pi, math.pi, 301), [math.pi, -math.pi]))
    frames = [LocalFrame(*at, 0.0) for at in zip(latitudes.tolist(), longitudes.tolist(), strict=True)]
    points = [f.geodetic_from_east_north(*rng.uniform(-reach_m, reach_m, 2), 0.0) for f in frames]
    return zip(plane_origins(latitudes, longitudes), frames, points, strict=True)


@pytest.mark.parametrize("reach_m", [10.0, 1e3, 6e4])
def test_positions_are_those_of_the_local_frame_anywhere_on_earth(reach_m: float) -> None:
    for origin, frame, point in origins_and_points(SEED, reach_m, math.pi / 2):
        expected_m = frame.east_north_from_geodetic(*point)
        assert east_north(origin, *point[:2]) == pytest.approx(expected_m, rel=0.0, abs=5e-9)


def test_what_is_far_off_or_no_number_is_nowhere() -> None:
    (origin,) = plane_origins([0.6], [3.0])
    far = [(-0.6, 3.0 - math.pi), (0.62, 3.0), (0.6, 3.02)]
    for point in [*far, (math.nan, 3.0), (0.6, math.nan), (0.6, math.inf)]:
        assert east_north(origin, *point) == (math.inf, math.inf)


@pytest.mark.parametrize("reach_m", [1.0, 600.0, 1e4])
def test_the_series_near_an_origin_says_the_same(reach_m: float) -> None:
    for origin, frame, point in origins_and_points(SEED + 1, reach_m, 1.4844):
        near_m = east_north_near(plane_series(frame.latitude_rad, frame.longitude_rad), origin, *point[:2])
        assert near_m == pytest.approx(east_north(origin, *point[:2]), abs=5e-9)
    assert east_north_near(plane_series(0.6, 3.0), origin, math.nan, 3.0) == (math.inf, math.inf)

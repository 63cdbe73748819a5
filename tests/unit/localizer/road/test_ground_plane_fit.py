"""Height and tilt over the road, by the map and by the sweep's own returns."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from camber.geodesy.se3 import rotation_from_roll_pitch_yaw, transform_points
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.road.ground_plane_fit import ground_plane, road_line

Floats = NDArray[np.float64]
MOUNT = SensorMount(x_m=1.1, y_m=0.0, z_m=1.95)


def road(
    seed: int = 1,
    n: int = 4000,
    *,
    ahead: float = 0.0,
    left: float = 0.0,
    up_m: float = 0.0,
    bend_per_m: float = 0.0,
    noise_m: float = 0.01,
    least_m: float = 0.0,
    half_width_m: float = 6.0,
) -> Floats:
    """Points of a road about the origin: z = up + ahead x + left y + bend x² / 2."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-14.0, 14.0, n), rng.uniform(-half_width_m, half_width_m, n)
    z = up_m + ahead * x + left * y + 0.5 * bend_per_m * x * x + noise_m * rng.standard_normal(n)
    return np.column_stack((x, y, z))[np.hypot(x - MOUNT.x_m, y) > least_m]


def cars(seed: int, n: int = 600) -> Floats:
    return np.random.default_rng(seed).uniform((4.0, -2.5, 0.2), (9.0, 2.5, 1.6), (n, 3))


@settings(derandomize=True, max_examples=30, deadline=None)
@given(
    up_m=st.floats(-0.5, 0.5),
    ahead=st.floats(-0.12, 0.12),
    left=st.floats(-0.04, 0.04),
    seed=st.integers(0, 999),
)
def test_the_map_s_road_under_the_vehicle(up_m: float, ahead: float, left: float, seed: int) -> None:
    result = road_line(road(seed, up_m=up_m, ahead=ahead, left=left))
    assert result.dz_m == pytest.approx(up_m, abs=0.02)
    assert result.dpitch_rad == pytest.approx(-math.atan(ahead), abs=math.radians(0.2))


def test_the_correction_puts_the_frame_onto_the_road() -> None:
    result = road_line(road(ahead=0.1, up_m=0.3, noise_m=0.0))
    on_road = transform_points(result.local_from_road, np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    np.testing.assert_allclose(on_road[:, 2], 0.3 + 0.1 * on_road[:, 0], atol=1e-3)


CROSSFALL = road(left=0.03)


@pytest.mark.parametrize(
    "points",
    [
        CROSSFALL[CROSSFALL[:, 1] > -0.5],
        np.concatenate((road(2, n=800), road(3, n=8000, up_m=6.0))),
        np.concatenate((road(4), cars(5))),
    ],
    ids=["crossfall with points to one side only", "another road above", "kerbs and clutter"],
)
def test_what_else_is_seen_does_not_lift_the_line(points: Floats) -> None:
    assert road_line(points).dz_m == pytest.approx(0.0, abs=0.01)


def test_a_crowned_road_is_measured_on_the_driven_side() -> None:
    """Both halves fall by 3 % from the crown, two metres to the vehicle's left."""
    points = road(13, noise_m=0.005, least_m=3.0, half_width_m=8.0)
    points[:, 2] -= 0.03 * (np.abs(points[:, 1] - 2.0) - 2.0)
    line, plane = road_line(points), ground_plane(points, MOUNT)
    assert line.dz_m == pytest.approx(0.0, abs=0.008)
    assert math.tan(plane.roll_rad) == pytest.approx(-0.03, abs=0.004)
    assert plane.distance_m == pytest.approx(MOUNT.z_m / math.hypot(1.0, 0.03), abs=0.012)


@pytest.mark.parametrize("n", [0, 5, 14])
def test_too_few_points_are_no_line_and_no_plane(n: int) -> None:
    assert road_line(road(n=4000)[:n]) is None
    assert ground_plane(road(n=4000, least_m=3.0)[:n], MOUNT) is None


@settings(derandomize=True, max_examples=30, deadline=None)
@given(
    ahead=st.floats(-0.03, 0.03),
    left=st.floats(-0.03, 0.03),
    bend_per_m=st.floats(-0.004, 0.004),
    up_m=st.floats(-0.1, 0.1),
    seed=st.integers(0, 999),
)
def test_the_sensor_above_the_road_it_sees(
    ahead: float, left: float, bend_per_m: float, up_m: float, seed: int
) -> None:
    """Crests and sags of 250 m radius, the body tilted against the road, vehicles about."""
    points = road(seed, n=3000, ahead=ahead, left=left, up_m=up_m, bend_per_m=bend_per_m, least_m=4.0)
    result = ground_plane(np.concatenate((points, cars(seed, 200))), MOUNT)
    foot_m = up_m + ahead * MOUNT.x_m + 0.5 * bend_per_m * MOUNT.x_m**2
    truth = (MOUNT.z_m - foot_m) / math.sqrt(1.0 + ahead**2 + left**2)
    assert result.distance_m == pytest.approx(truth, abs=4.0 * result.distance_sigma_m)
    assert result.distance_sigma_m < 0.012
    assert result.problem is None


def test_the_stated_sigma_is_honest() -> None:
    errors, sigmas = [], []
    for seed in range(100):
        result = ground_plane(road(seed, n=400, noise_m=0.02, least_m=4.0), MOUNT)
        errors.append(result.distance_m - MOUNT.z_m)
        sigmas.append(result.distance_sigma_m)
    normalised = np.array(errors) / np.array(sigmas)
    assert (np.abs(normalised) < 3.0).mean() >= 0.99
    assert np.std(normalised) > 0.2


def test_tilt_is_that_of_the_body_against_the_road() -> None:
    roll, pitch = 0.02, -0.015
    body_from_road = rotation_from_roll_pitch_yaw(roll, pitch, 0.0).T
    result = ground_plane(road(6, least_m=4.0, noise_m=0.002) @ body_from_road.T, MOUNT)
    assert (result.roll_rad, result.pitch_rad) == pytest.approx((roll, pitch), abs=1e-3)


def test_on_a_grade_the_vertical_height_is_more_than_the_distance() -> None:
    result = ground_plane(road(7, least_m=4.0), MOUNT)
    assert result.height_m(0.0) == result.distance_m
    assert result.height_m(0.1) == pytest.approx(result.distance_m * 1.00499, abs=1e-4)


@pytest.mark.parametrize(
    ("higher_m", "roll_deg", "pitch_deg", "problem"),
    [
        (0.0, 0.0, 0.0, None),
        (0.2, 0.0, 0.0, None),
        (0.4, 0.0, 0.0, "mounting"),
        (-0.4, 0.0, 0.0, "mounting"),
        (0.0, 2.0, 0.0, None),
        (0.0, 0.0, -2.0, None),
        (0.0, 5.0, 0.0, "mounting"),
        (0.0, 0.0, 6.0, "mounting"),
        (0.0, 0.0, -8.0, "mounting"),
    ],
)
def test_a_sensor_that_is_not_where_its_mount_says_is_noticed(
    higher_m: float, roll_deg: float, pitch_deg: float, problem: str | None
) -> None:
    """What the sensor sees is turned about the sensor by how far its true mount is from the stated one."""
    points = np.concatenate((road(8, least_m=4.0), cars(9)))
    sensor = np.array([MOUNT.x_m, MOUNT.y_m, MOUNT.z_m])
    turned = rotation_from_roll_pitch_yaw(math.radians(roll_deg), math.radians(pitch_deg), 0.0)
    seen = (points - sensor - [0.0, 0.0, higher_m]) @ turned + sensor
    result = ground_plane(seen, MOUNT)
    assert result.problem == problem


def test_a_sweep_that_sees_no_road_has_no_plane() -> None:
    high = np.random.default_rng(12).uniform((-12.0, -12.0, 4.0), (12.0, 12.0, 9.0), (3000, 3))
    assert ground_plane(high, MOUNT) is None

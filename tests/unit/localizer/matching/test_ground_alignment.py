"""What one matched sweep says of the sensor's height and attitude, on a slope of known plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import map_from_vehicle, roll_pitch_yaw_from_rotation, transform_points
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.ground_alignment import (
    PlanarPose,
    RoadBy,
    SensorHeights,
    align_to_road,
    measure_sensor_heights,
)
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.road.ground_plane_fit import GroundPlane, ground_plane
from camber.localizer.road.road_raster import RoadHeights

Floats = NDArray[np.float64]

GRADE, CROSSFALL = 0.10, -0.02
MOUNT = SensorMount(x_m=1.2, y_m=0.1, z_m=1.9)
NOSE_UP_RAD = math.radians(0.4)
"""Of the body against the road, about the vehicle frame's origin."""


def road(step_m: float, seed: int) -> Floats:
    """Eight metres of a street (n, 3) with 5 mm of noise."""
    rng = np.random.default_rng(seed)
    east, north = np.meshgrid(np.arange(-40.0, 40.0, step_m), np.arange(-4.0, 4.0, step_m))
    up = GRADE * east + CROSSFALL * north + rng.normal(0.0, 0.005, east.shape)
    return np.column_stack((east.ravel(), north.ravel(), up.ravel()))


MAP = road(0.25, 1)
BLOCK = MapBlock(
    frame=LocalFrame(0.6, 2.4, 0.0),
    base_height_m=0.0,
    environment_m=np.zeros((0, 3)),
    road_m=MAP,
    road=RoadHeights.of(MAP),
)
TRUTH = map_from_vehicle(
    0.0, 0.0, 0.0, math.atan(CROSSFALL * math.cos(math.atan(GRADE))), -math.atan(GRADE) - NOSE_UP_RAD, 0.0
)
SEEN = transform_points(np.linalg.inv(TRUTH), road(0.4, 2))
SEEN = SEEN[np.hypot(SEEN[:, 0], SEEN[:, 1]) > 3.0]
SENSOR_M = (TRUTH @ MOUNT.vehicle_from_sensor)[:3, 3]
HEIGHT_M = float(SENSOR_M[2] - GRADE * SENSOR_M[0] - CROSSFALL * SENSOR_M[1])


def heights(match: Floats, ground: GroundPlane | None = None, sweep_m: Floats = SEEN) -> SensorHeights:
    return measure_sensor_heights(sweep_m, ground, MOUNT, matched=match, block=BLOCK)


def off(east_m: float = 0.0, up_m: float = 0.0, pitch_deg: float = 0.0) -> Floats:
    """The match, off by so much."""
    shift = map_from_vehicle(east_m, 0.0, up_m, 0.0, 0.0, 0.0)
    return shift @ TRUTH @ map_from_vehicle(0.0, 0.0, 0.0, 0.0, math.radians(pitch_deg), 0.0)


@pytest.mark.parametrize(
    "match", [off(), off(up_m=0.08), off(pitch_deg=0.3), off(up_m=-0.05, pitch_deg=-0.4)]
)
def test_height_and_attitude_are_those_of_the_sweep_and_not_of_the_overlay(match: Floats) -> None:
    result = heights(match)
    assert result.matched_m == pytest.approx(HEIGHT_M, abs=0.004)
    assert 0.01 < result.matched_sigma_m < 0.02
    wanted = roll_pitch_yaw_from_rotation(TRUTH)
    assert roll_pitch_yaw_from_rotation(result.map_from_vehicle) == pytest.approx(wanted, abs=5e-4)
    assert result.slope_forward == pytest.approx(GRADE, abs=0.002)
    assert result.slope_left == pytest.approx(CROSSFALL, abs=0.002)


def test_a_match_that_moves_along_the_grade_takes_its_height_along() -> None:
    result = heights(off(east_m=1.0))  # at the height of the place before
    assert result.matched_m == pytest.approx(HEIGHT_M, abs=0.004)
    assert result.map_from_vehicle[2, 3] == pytest.approx(GRADE, abs=0.004)


def test_a_sweep_without_road_gives_no_height_and_leaves_the_match() -> None:
    walls = np.column_stack((np.full(500, 12.0), np.linspace(-9.0, 9.0, 500), np.linspace(0.5, 4.0, 500)))
    match = off(up_m=0.05)
    result = heights(match, sweep_m=walls)
    assert result.matched_m is None
    np.testing.assert_array_equal(result.map_from_vehicle, match)


def test_off_the_road_of_the_map_no_height_is_known() -> None:
    result = heights(map_from_vehicle(0.0, 14.0, 0.0, 0.0, 0.0, 0.0))
    assert (result.matched_m, result.ground_m, result.slope_forward) == (None, None, None)


def test_the_bodys_tilt_against_the_road_is_that_of_the_sweeps_ground() -> None:
    ground = ground_plane(SEEN, MOUNT)
    assert ground.tilt == pytest.approx((0.0, -NOSE_UP_RAD), abs=1e-3)
    assert heights(off(), ground).ground_m == pytest.approx(HEIGHT_M, abs=0.004)
    turned = ground_plane(SEEN @ TRUTH[:3, :3].T, MOUNT)  # as if it were level: six degrees
    assert (turned.problem, turned.tilt) == ("mounting", (0.0, 0.0))
    assert heights(off(), turned).misplaced


@pytest.mark.parametrize("by", ["surface", "line"])
def test_a_local_map_is_aligned_to_the_grade_by_its_ground_or_by_the_maps_line(by: RoadBy) -> None:
    alignment = align_to_road(SEEN, BLOCK, PlanarPose(0.0, 0.0, 0.0), near_m=0.2, by=by)
    _, pitch_rad, _ = roll_pitch_yaw_from_rotation(alignment.map_from_local)
    assert abs(alignment.map_from_local[2, 3]) < 0.03
    # The line is the road's; only its own ground shows how the body stands on it.
    body_rad = NOSE_UP_RAD if by == "surface" else 0.0
    assert pitch_rad == pytest.approx(-math.atan(GRADE) - body_rad, abs=math.radians(0.1))


def test_without_ground_in_sight_the_maps_line_serves() -> None:
    walls = SEEN + np.array([0.0, 0.0, 2.0])
    alignment = align_to_road(walls, BLOCK, PlanarPose(0.0, 0.0, 0.0), near_m=0.2)
    assert alignment.road is None
    assert abs(alignment.map_from_local[2, 3]) < 0.03


def test_without_a_road_in_the_map_there_is_no_alignment() -> None:
    assert align_to_road(SEEN, BLOCK, PlanarPose(500.0, 500.0, 0.0), near_m=0.0) is None

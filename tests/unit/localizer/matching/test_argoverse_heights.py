"""Real sweeps on a real road: a LiDAR's height above the ground by its own returns and by matching to the map's road.

Truth is the calibration with the pose over the log's ground raster. At this height the raster is a grid of 6 cm, and
the vehicle's origin stands 0.30 to 0.32 m above it with a spread of 1 to 4 cm along a log: 3 cm can be asked for.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.formats.map_exchange.argoverse import ArgoverseLog, Floats, GroundRaster, LidarSweep, read_log
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.deskewing import SweepOptions
from camber.localizer.matching.ground_alignment import (
    PlanarPose,
    SensorHeights,
    align_to_road,
    measure_sensor_heights,
)
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.road.ground_plane_fit import ground_plane
from camber.localizer.road.road_raster import RoadHeights

SENSORS = ("up_lidar", "down_lidar")
AXLES_M = (0.25, 0.40)
"""What is taken for the height of the rear axle, where the vehicle's origin is: no result may rest on it."""
WITHIN_M = 0.03
OPTIONS = SweepOptions()


def log_named(name: str) -> ArgoverseLog:
    if not os.environ.get("CAMBER_DATA"):
        pytest.skip("CAMBER_DATA is not set: no recordings")
    return read_log(Path(os.environ["CAMBER_DATA"]) / "av2" / name)


@pytest.fixture(scope="module")
def log() -> ArgoverseLog:
    return log_named("7fab2350")


def is_of(name: str, sweep: LidarSweep) -> NDArray[np.bool_]:
    """Which points (n,) are of a LiDAR: the first 32 of 64 lasers belong to up_lidar."""
    mask: NDArray[np.bool_] = (sweep.laser < 32) == (name == "up_lidar")
    return mask


def ground_near(ground: GroundRaster, city_m: Floats, reach_m: float) -> Floats:
    """The centres (n, 3) in city of the known cells within a square around a place."""
    rows, columns = np.nonzero(np.isfinite(ground.height_m))
    places = ground.corner_m + ground.cell_m * (np.column_stack((columns, rows)) + 0.5)
    near = (np.abs(places - city_m[:2]) < reach_m).all(axis=1)
    return np.column_stack((places[near], ground.height_m[rows[near], columns[near]]))


def of_sensor(log: ArgoverseLog, sweep: LidarSweep, name: str, axle_m: float) -> tuple[Floats, SensorMount]:
    """Its points and where it is, in the vehicle frame, whose origin is on the road: thinned, own vehicle left out."""
    motion = log.egovehicle_from_sensor[name]
    x_m, y_m, z_m = motion[:3, 3].tolist()
    roll_rad, pitch_rad, yaw_rad = roll_pitch_yaw_from_rotation(motion)
    mount = SensorMount(
        x_m=x_m, y_m=y_m, z_m=z_m + axle_m, roll_rad=roll_rad, pitch_rad=pitch_rad, yaw_rad=yaw_rad
    )
    points_m = sweep.points_m[is_of(name, sweep)]
    forward, left = points_m[:, 0], points_m[:, 1]
    vehicle = (-OPTIONS.vehicle_rear_m < forward) & (forward < OPTIONS.vehicle_front_m)
    vehicle &= np.abs(left) < OPTIONS.vehicle_half_width_m
    near = np.linalg.norm(points_m - motion[:3, 3], axis=1) < OPTIONS.max_range_m
    return voxel_means(points_m[near & ~vehicle] + [0.0, 0.0, axle_m], OPTIONS.voxel_m), mount


def heights(log: ArgoverseLog, sweep: LidarSweep, name: str, axle_m: float) -> SensorHeights:
    """As the localizer finds them, where the raster is the map's road cloud."""
    place_m = sweep.city_from_egovehicle[:3, 3]
    corner_m = np.floor(place_m)
    road_m = ground_near(log.ground, place_m, 60.0) - corner_m
    block = MapBlock(
        frame=LocalFrame(0.7, -1.4, 0.0),
        base_height_m=float(corner_m[2]),
        environment_m=np.zeros((0, 3)),
        road_m=road_m,
        road=RoadHeights.of(road_m),
    )
    points_m, mount = of_sensor(log, sweep, name, axle_m)
    east_m, north_m, up_m = (place_m - corner_m).tolist()
    _, _, yaw_rad = roll_pitch_yaw_from_rotation(sweep.city_from_egovehicle)
    alignment = align_to_road(points_m, block, PlanarPose(east_m, north_m, yaw_rad), near_m=up_m)
    return measure_sensor_heights(
        points_m, ground_plane(points_m, mount), mount, matched=alignment.map_from_local, block=block
    )


def calibrated_m(log: ArgoverseLog, sweep: LidarSweep, name: str) -> float:
    """Where the calibration has the sensor in egovehicle, and how high that stands above the raster there."""
    place_m = sweep.city_from_egovehicle[:3, 3]
    return float(log.egovehicle_from_sensor[name][2, 3] + place_m[2] - log.ground.height(place_m[None, :])[0])


@pytest.mark.parametrize("axle_m", AXLES_M)
@pytest.mark.parametrize("name", SENSORS)
def test_by_the_ground_in_its_sweep_and_by_matching_the_ground_a_sensor_is_as_high_as_calibrated(
    log: ArgoverseLog, name: str, axle_m: float
) -> None:
    assert len(log.sweeps) == 2
    for sweep in log.sweeps:
        measured, true_m = heights(log, sweep, name, axle_m), calibrated_m(log, sweep, name)
        assert measured.ground_m is not None
        assert measured.matched_m is not None
        print(f"{sweep.time_ns} {name}: ranging {measured.ground_m - true_m:+.4f}, "
              f"matching {measured.matched_m - true_m:+.4f} m off {true_m:.3f} m")  # fmt: skip
        assert abs(measured.ground_m - true_m) < WITHIN_M
        assert abs(measured.matched_m - true_m) < WITHIN_M
        assert not measured.misplaced


def test_the_slope_is_that_of_the_pose(log: ArgoverseLog) -> None:
    for sweep in log.sweeps:
        measured = heights(log, sweep, "up_lidar", AXLES_M[0])
        roll_rad, pitch_rad, _ = roll_pitch_yaw_from_rotation(sweep.city_from_egovehicle)
        # A body that drives is tilted against its road by a degree at most.
        assert measured.slope_forward == pytest.approx(-math.tan(pitch_rad), abs=0.02)
        assert measured.slope_left == pytest.approx(math.tan(roll_rad), abs=0.02)


@pytest.mark.parametrize("name", ["7fab2350", "3bffdcff"])
def test_the_vehicle_s_origin_stands_an_axle_above_the_raster(name: str) -> None:
    log = log_named(name)
    places_m = log.city_from_egovehicle[:, :3, 3]
    above_m = places_m[:, 2] - log.ground.height(places_m)
    assert np.median(above_m) == pytest.approx(0.31, abs=0.02)
    assert np.std(above_m) < 0.05

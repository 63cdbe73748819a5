"""Drives for the localizer's statistics are in order, repeatable, and in the world that their truth speaks of."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from camber.geodesy.se3 import map_from_vehicle
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.pose_track import PoseTrack
from support.lidar_drives import HILL, LidarDrive, Tick, lidar_drive, route_duration_s


@lru_cache
def hill() -> LidarDrive:
    return lidar_drive(HILL, 2, start_s=60.0, duration_s=1.5)


@lru_cache
def hill_ticks() -> tuple[Tick, ...]:
    return tuple(hill().ticks())


def test_what_arrives_is_in_order_and_complete() -> None:
    times = [tick.time_ns for tick in hill_ticks()]
    assert times == sorted(times)
    for name, rate_hz in (("motion", 10), ("suspension", 10), ("ranging", 10), ("sweep", 10)):
        count = sum(getattr(tick, name) is not None for tick in hill_ticks())
        assert count == pytest.approx(1.5 * rate_hz, abs=2), name
    motion = [tick.motion for tick in hill_ticks() if tick.motion is not None]
    assert all(m.pitch_rad is not None and m.wheel_speed_m_s is not None for m in motion)  # it drives already
    assert [tick.time_ns for tick in hill_ticks() if tick.sweep] == hill().sweep_times_ns.tolist()


def test_a_sweep_at_the_true_pose_lies_on_the_road_of_the_drive_day() -> None:
    drive, truth = hill(), hill().truth
    sweeps = [tick.sweep for tick in hill_ticks() if tick.sweep is not None]
    pose = [c[-1] for c in (*truth.vehicle_m.T, truth.roll_rad, truth.pitch_rad, truth.yaw_rad)]
    world_from_vehicle = map_from_vehicle(*(float(v) for v in pose))
    sensor = world_from_vehicle[:3, :3] @ np.array(CAR.lidar) + world_from_vehicle[:3, 3]
    points = np.asarray(sweeps[-1].points_m, np.float64)
    last = sweeps[-1].offset_ns > -2_000_000  # hardly moved since
    placed = points[last] @ world_from_vehicle[:3, :3].T + sensor
    track = PoseTrack.of(drive.trajectory, CAR, CAR.lidar)
    position, rotation = track.at(sweeps[-1].time_ns + sweeps[-1].offset_ns.astype(np.int64))
    exact = position + np.einsum("nij,nj->ni", rotation, points)
    np.testing.assert_allclose(placed, exact[last], atol=0.03)
    road = drive.path.surface_m(exact[:, 0], exact[:, 1], np.zeros(len(exact), np.int64))
    near = np.abs(exact[:, 2] - road) < 0.3
    assert near.sum() > 5_000
    assert abs(np.median(exact[near, 2] - road[near])) < 0.01


def test_the_hill_is_steep() -> None:
    truth = lidar_drive(HILL, 2, start_s=0.0, duration_s=route_duration_s(HILL, 2) - 1.0).truth
    assert np.tan(-truth.pitch_rad).max() > 0.095  # nose up
    assert np.tan(truth.pitch_rad).max() > 0.095  # and down


def test_truth_hangs_together() -> None:
    truth = hill().truth
    np.testing.assert_allclose(truth.antenna_m[:, 2], truth.road_height_m + truth.antenna_height_m, atol=1e-3)
    lever = truth.antenna_m - truth.vehicle_m
    np.testing.assert_allclose(np.linalg.norm(lever, axis=1), np.linalg.norm(CAR.antenna), atol=1e-4)
    step = np.linalg.norm(np.diff(truth.vehicle_m, axis=0), axis=1)
    np.testing.assert_allclose(step, np.diff(truth.driven_m), atol=0.02)


def test_the_map_is_of_the_roads_around() -> None:
    assert len(hill().map_release.manifest.layer) > 3


def test_the_same_drive_says_the_same_and_another_seed_does_not() -> None:
    again = tuple(lidar_drive(HILL, 2, start_s=60.0, duration_s=1.5).ticks(sweeps=False))
    assert again == tuple(tick for tick in hill_ticks() if tick.sweep is None)
    other = tuple(lidar_drive(HILL, 2, start_s=60.0, duration_s=1.5, drive_seed=9).ticks(sweeps=False))
    assert again != other


def test_the_drive_on_both_levels_is_on_both_levels() -> None:
    truth = lidar_drive("overpass", 3, duration_s=140.0).truth
    assert set(truth.level.tolist()) == {0, 1}


def test_a_drive_longer_than_its_route_is_refused_and_rounds_make_it_longer() -> None:
    with pytest.raises(ValueError, match="expected 1000"):
        lidar_drive("city", 1, duration_s=1000.0)
    assert route_duration_s("city", 1, "round", 2) > 1.9 * route_duration_s("city", 1, "round")

"""The last ten sweeps overlaid: static points coincide, on grades too."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.localizer.filter.track import TrackPoint
from camber.localizer.matching.local_map import LocalMap
from camber.localizer.matching.sweep_preparation import PreparedSweep

BEGIN_NS = 1_400_000_000 * 10**9


def sweep(points_m: NDArray[np.float64], k: int) -> PreparedSweep:
    return PreparedSweep(time_ns=BEGIN_NS + k * 100_000_000, points_m=points_m, problem=None, at=None)


def world(seed: int = 1, n: int = 2000) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform((-30.0, -30.0, 0.0), (60.0, 30.0, 8.0), (n, 3))


def seen_from(
    points_m: NDArray[np.float64], at: TrackPoint, up_m: float = 0.0, roll: float = 0.0, pitch: float = 0.0
) -> NDArray[np.float64]:
    world_from_vehicle = rotation_from_roll_pitch_yaw(roll, pitch, at.yaw_rad)
    seen: NDArray[np.float64] = (points_m - np.array([at.east_m, at.north_m, up_m])) @ world_from_vehicle
    return seen


def largest_gap_m(points_m: NDArray[np.float64], truth_m: NDArray[np.float64]) -> float:
    return float(np.abs(points_m[:, None] - truth_m[None]).max(axis=2).min(axis=1).max())


def arc(k: int, step_m: float = 1.5, turn_rad: float = 0.03) -> TrackPoint:
    yaw, radius = k * turn_rad, step_m / turn_rad
    return TrackPoint(
        east_m=radius * math.sin(yaw), north_m=radius * (1.0 - math.cos(yaw)), yaw_rad=yaw, path_m=k * step_m
    )


def test_static_points_coincide() -> None:
    local, points = LocalMap(voxel_m=0.001, reach_m=200.0), world()
    for k in range(10):
        local.add(sweep(seen_from(points, arc(k)), k), arc(k))
    result = local.overlay()
    assert len(local) == 10
    truth = seen_from(points, arc(9))
    assert len(result.points_m) < 1.5 * len(truth)  # what falls on an edge of a voxel may stand twice
    assert largest_gap_m(result.points_m, truth) < 1e-9


def test_only_the_last_ten_are_kept() -> None:
    local, points = LocalMap(), world()
    for k in range(25):
        local.add(sweep(seen_from(points, arc(k)), k), arc(k))
    assert local.overlay().lag.path_m == pytest.approx(4.5 * 1.5)
    assert len(local) == 10


def test_standing_still_adds_nothing() -> None:
    local, points = LocalMap(), world()
    here = TrackPoint(east_m=0.0, north_m=0.0, yaw_rad=0.3, path_m=0.0)
    local.add(sweep(seen_from(points, here), 0), here)
    alone = local.overlay()
    for k in range(1, 30):
        local.add(sweep(seen_from(points, here), k), here)
    result = local.overlay()
    np.testing.assert_allclose(result.points_m, alone.points_m, atol=1e-9)


@pytest.mark.parametrize("grade_rad", [0.1, -0.1])
def test_on_a_grade_the_path_rises_and_falls(grade_rad: float) -> None:
    """Track metres are metres of road; body and road tilt alike, up where pitch is negative."""
    local, points = LocalMap(voxel_m=0.001, reach_m=200.0), world()
    for k in range(10):
        along = 1.5 * k
        true = TrackPoint(east_m=along * math.cos(grade_rad), north_m=0.0, yaw_rad=0.0, path_m=along)
        up = along * math.sin(grade_rad)
        seen = seen_from(points, true, up, pitch=-grade_rad)
        local.add(
            sweep(seen, k),
            TrackPoint(east_m=along, north_m=0.0, yaw_rad=0.0, path_m=along),
            (0.0, -grade_rad),
        )
    result = local.overlay()
    truth = seen_from(points, true, up, pitch=-grade_rad)
    assert largest_gap_m(result.points_m, truth) < 1e-9


def test_a_body_that_rolls_and_pitches_on_level_road_is_turned_back() -> None:
    local, points = LocalMap(voxel_m=0.001, reach_m=200.0), world()
    for k in range(10):
        roll, pitch = 0.02 * math.sin(k), 0.03 * math.cos(k)
        seen = seen_from(points, arc(k), roll=roll, pitch=pitch)
        local.add(sweep(seen, k), arc(k), (roll, pitch), road_tilt=(roll, pitch))
    result = local.overlay()
    truth = seen_from(points, arc(9), roll=roll, pitch=pitch)
    assert largest_gap_m(result.points_m, truth) < 1e-9


def test_a_steady_grade_needs_no_attitude() -> None:
    local, points = LocalMap(voxel_m=0.001, reach_m=200.0), world()
    for k in range(10):
        along = 1.5 * k
        place = TrackPoint(east_m=along * math.cos(0.1), north_m=0.0, yaw_rad=0.0, path_m=along)
        seen = seen_from(points, place, along * math.sin(0.1), pitch=-0.1)
        local.add(sweep(seen, k), TrackPoint(east_m=along, north_m=0.0, yaw_rad=0.0, path_m=along))
    result = local.overlay()
    assert largest_gap_m(result.points_m, seen) < 1e-9


def add_two(k: int, second: TrackPoint, attitude: tuple[float, float] | None = None) -> LocalMap:
    local, points = LocalMap(), world()
    local.add(sweep(points, 0), TrackPoint(east_m=0.0, north_m=0.0, yaw_rad=0.0, path_m=5.0))
    local.add(sweep(points, k), second, attitude)
    return local


@pytest.mark.parametrize(
    ("k", "path_m", "kept"),
    [(1, 6.0, 2), (9, 6.0, 2), (11, 6.0, 1), (0, 6.0, 1), (-3, 6.0, 1), (1, 4.0, 1), (1, 40.0, 1)],
)
def test_after_a_gap_a_clock_set_back_or_a_jump_it_begins_anew(k: int, path_m: float, kept: int) -> None:
    assert len(add_two(k, TrackPoint(east_m=1.0, north_m=0.0, yaw_rad=0.0, path_m=path_m))) == kept


def test_levelled_and_unlevelled_sweeps_are_not_mixed() -> None:
    assert len(add_two(1, TrackPoint(east_m=1.0, north_m=0.0, yaw_rad=0.0, path_m=6.0), (0.0, 0.0))) == 1


def test_after_a_reset_there_is_nothing() -> None:
    local = add_two(1, TrackPoint(east_m=1.0, north_m=0.0, yaw_rad=0.0, path_m=6.0))
    local.reset()
    assert local.overlay() is None


def test_points_beyond_the_reach_are_left_out() -> None:
    local = LocalMap(reach_m=20.0)
    local.add(sweep(world(), 0), TrackPoint(east_m=0.0, north_m=0.0, yaw_rad=0.0, path_m=0.0))
    result = local.overlay()
    assert 0 < len(result.points_m) < 2000
    assert np.hypot(result.points_m[:, 0], result.points_m[:, 1]).max() < 20.0

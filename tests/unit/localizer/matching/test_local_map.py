"""The last ten sweeps overlaid: static points coincide, on grades too."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.localizer.filter.track import TrackPoint
from camber.localizer.matching.local_map import LEVEL, LocalMap, Tilt
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


def overlaid(
    place: Callable[[int], TrackPoint],
    *,
    true: Callable[[int], TrackPoint] | None = None,
    up_m: Callable[[int], float] = lambda k: 0.0,
    tilt: Callable[[int], Tilt] = lambda k: LEVEL,
    attitude: Callable[[int], Tilt | None] = lambda k: None,
    road_tilt: Callable[[int], Tilt] = lambda k: LEVEL,
) -> None:
    """Ten sweeps of a world that stands still, by the track's places where they are not the `true` ones: they must
    coincide with the last one."""
    local, points = LocalMap(voxel_m=0.001, reach_m=200.0), world()
    for k in range(10):
        seen = seen_from(points, (true or place)(k), up_m(k), *tilt(k))
        local.add(sweep(seen, k), place(k), attitude(k), road_tilt=road_tilt(k))
    result = local.overlay()
    assert len(local) == 10
    assert len(result.points_m) < 1.5 * len(seen)  # what falls on an edge of a voxel may stand twice
    assert largest_gap_m(result.points_m, seen) < 1e-9


def east(along_m: float) -> TrackPoint:
    return TrackPoint(east_m=along_m, path_m=along_m)


def test_static_points_coincide() -> None:
    overlaid(arc)


@pytest.mark.parametrize("grade_rad", [0.1, -0.1])
@pytest.mark.parametrize("measured", [True, False])
def test_on_a_grade_the_path_rises_and_falls(grade_rad: float, measured: bool) -> None:
    """Track metres are metres of road; body and road tilt alike, up where pitch is negative."""
    tilt = (0.0, -grade_rad)
    overlaid(
        lambda k: east(1.5 * k),
        true=lambda k: east(1.5 * k * math.cos(grade_rad)),
        up_m=lambda k: 1.5 * k * math.sin(grade_rad),
        tilt=lambda k: tilt,
        attitude=lambda k: tilt if measured else None,
    )


def test_a_body_that_rolls_and_pitches_on_level_road_is_turned_back() -> None:
    def body(k: int) -> Tilt:
        return 0.02 * math.sin(k), 0.03 * math.cos(k)

    overlaid(arc, tilt=body, attitude=body, road_tilt=body)


def test_only_the_last_ten_are_kept() -> None:
    local, points = LocalMap(), world()
    for k in range(25):
        local.add(sweep(seen_from(points, arc(k)), k), arc(k))
    assert local.overlay().lag.path_m == pytest.approx(4.5 * 1.5)
    assert len(local) == 10


def test_standing_still_adds_nothing() -> None:
    local, points, here = LocalMap(), world(), TrackPoint(yaw_rad=0.3)
    local.add(sweep(seen_from(points, here), 0), here)
    alone = local.overlay()
    for k in range(1, 30):
        local.add(sweep(seen_from(points, here), k), here)
    np.testing.assert_allclose(local.overlay().points_m, alone.points_m, atol=1e-9)


def add_two(k: int, second: TrackPoint, attitude: tuple[float, float] | None = None) -> LocalMap:
    local, points = LocalMap(), world()
    local.add(sweep(points, 0), TrackPoint(path_m=5.0))
    local.add(sweep(points, k), second, attitude)
    return local


@pytest.mark.parametrize(
    ("k", "path_m", "kept"),
    [(1, 6.0, 2), (9, 6.0, 2), (11, 6.0, 1), (0, 6.0, 1), (-3, 6.0, 1), (1, 4.0, 1), (1, 40.0, 1)],
)
def test_after_a_gap_a_clock_set_back_or_a_jump_it_begins_anew(k: int, path_m: float, kept: int) -> None:
    assert len(add_two(k, TrackPoint(east_m=1.0, path_m=path_m))) == kept


def test_levelled_and_unlevelled_sweeps_are_not_mixed() -> None:
    assert len(add_two(1, TrackPoint(east_m=1.0, path_m=6.0), (0.0, 0.0))) == 1


def test_after_a_reset_there_is_nothing() -> None:
    local = add_two(1, TrackPoint(east_m=1.0, path_m=6.0))
    local.reset()
    assert local.overlay() is None


def test_points_beyond_the_reach_are_left_out() -> None:
    local = LocalMap(reach_m=20.0)
    local.add(sweep(world(), 0), TrackPoint())
    result = local.overlay()
    assert 0 < len(result.points_m) < 2000
    assert np.hypot(result.points_m[:, 0], result.points_m[:, 1]).max() < 20.0

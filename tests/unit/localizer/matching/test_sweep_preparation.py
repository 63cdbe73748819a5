"""Sweeps made ready for matching, and the problems of those that cannot be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.se3 import invert, map_from_vehicle, rotation_from_roll_pitch_yaw, transform_points
from camber.localizer.filter.odometry import MotionStep
from camber.localizer.filter.track import RelativeTrack
from camber.localizer.matching.deskewing import SweepOptions, SweepTimes, deskew, sweep_motions
from camber.localizer.matching.sweep_preparation import (
    PreparedSweep,
    SensorMount,
    prepare_sweep,
)
from camber.schemas.lidar import Sweep

END_NS = 1_400_000_000 * 10**9
TURN_NS = 100_000_000

MOUNT = SensorMount(x_m=1.1, y_m=0.2, z_m=1.95, roll_rad=0.02, pitch_rad=-0.03, yaw_rad=0.4)
FINE = SweepOptions(voxel_m=0.001)


def driving(speed_m_s: float = 20.0, rate_rad_s: float = 0.4) -> RelativeTrack:
    track = RelativeTrack()
    for k in range(-200, 1):
        step = MotionStep("applied", dt_s=0.01, speed_m_s=speed_m_s, yaw_rate_rad_s=rate_rad_s)
        track.append(END_NS + k * 10_000_000, step, speed_m_s, rate_rad_s)
    return track


def walls(n: int = 3000, seed: int = 1) -> NDArray[np.float64]:
    """Points that stand still, in the vehicle frame of the sweep's end, all around it."""
    rng = np.random.default_rng(seed)
    around, far = rng.uniform(-math.pi, math.pi, n), rng.uniform(12.0, 50.0, n)
    return np.column_stack((far * np.cos(around), far * np.sin(around), rng.uniform(0.0, 8.0, n)))


def measured(
    points_m: NDArray[np.float64], track: RelativeTrack, seed: int = 2
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """As the sensor sees them on the way: each from where it was at the point's own time, by the track itself."""
    offset_ns = -np.random.default_rng(seed).integers(0, TURN_NS, len(points_m)).astype(np.int32)
    end = track.at(END_NS)
    track_from_end = map_from_vehicle(end.east_m, end.north_m, 0.0, 0.0, 0.0, end.yaw_rad)
    seen = np.empty(points_m.shape, np.float32)
    for i, (point, offset) in enumerate(zip(points_m, offset_ns.tolist(), strict=True)):
        at = track.at(END_NS + offset)
        track_from_vehicle = map_from_vehicle(at.east_m, at.north_m, 0.0, 0.0, 0.0, at.yaw_rad)
        sensor_from_end = invert(track_from_vehicle @ MOUNT.vehicle_from_sensor) @ track_from_end
        seen[i] = transform_points(sensor_from_end, point[None])[0]
    return seen, offset_ns


def prepared(
    points_m: NDArray[np.float32] | None = None,
    offset_ns: NDArray[np.int32] | None = None,
    *,
    track: RelativeTrack | None = None,
    **options: object,
) -> PreparedSweep:
    track = driving() if track is None else track
    if points_m is None:
        points_m, offset_ns = measured(walls(), track)
    assert offset_ns is not None
    sweep = Sweep.model_construct(
        time_ns=END_NS,
        sensor="lidar",
        points_m=points_m,
        intensity=np.zeros(len(points_m), np.float32),
        offset_ns=offset_ns,
    )
    return prepare_sweep(sweep, MOUNT, track, **options)  # type: ignore[arg-type]


def test_static_points_are_deskewed_to_the_end_of_the_sweep() -> None:
    truth, track = walls(), driving()
    result = prepared(*measured(truth, track), track=track, options=FINE)
    assert result.problem is None
    assert result.at == track.at(END_NS)
    np.testing.assert_allclose(result.points_m, truth, atol=2e-3)


def test_without_the_motion_it_would_be_metres_off() -> None:
    truth, track = walls(), driving()
    points, _ = measured(truth, track)
    frozen = prepared(points, np.zeros(len(points), np.int32), track=track, options=FINE)
    assert frozen.problem == "no_offsets"
    assert frozen.usable
    assert np.abs(frozen.points_m - truth).max() > 1.0


def test_a_standing_vehicle_needs_no_de_skewing() -> None:
    track = driving(0.0, 0.0)
    truth = walls()
    result = prepared(*measured(truth, track), track=track, options=FINE)
    np.testing.assert_allclose(result.points_m, truth, atol=1e-4)


def test_it_is_thinned_and_no_voxel_is_lost() -> None:
    track = driving()
    result = prepared(track=track)
    fine = prepared(track=track, options=FINE)
    cells = {tuple(cell) for cell in np.floor(fine.points_m / 0.3).astype(int).tolist()}
    assert len(result.points_m) == len(cells)


def test_points_that_are_no_numbers_are_left_out() -> None:
    points, offset = measured(walls(), driving())
    points[::10] = np.nan
    points[5] = np.inf
    points[6, 1] = -np.inf
    result = prepared(points, offset)
    assert result.problem is None
    assert np.isfinite(result.points_m).all()


def test_the_vehicle_itself_and_what_is_too_near_or_too_far_is_left_out() -> None:
    track = driving(0.0, 0.0)
    truth = walls()
    truth[:4] = [[2.0, 0.5, 1.0], [-1.0, -1.0, 0.3], [1.3, 0.3, 2.1], [80.0, 0.0, 1.0]]
    result = prepared(*measured(truth, track), track=track, options=FINE)
    assert len(result.points_m) == len(truth) - 4


@pytest.mark.parametrize("points", [np.zeros((0, 3), np.float32), np.full((500, 3), np.nan, np.float32)])
def test_a_sweep_without_points_is_empty(points: NDArray[np.float32]) -> None:
    result = prepared(points, np.zeros(len(points), np.int32))
    assert result.problem == "empty"
    assert not result.usable
    assert result.points_m.shape == (0, 3)


def test_a_handful_of_points_is_too_few() -> None:
    points, offset = measured(walls(150), driving())
    assert prepared(points, offset).problem == "too_few_points"


def test_half_a_sweep_is_used_with_its_problem() -> None:
    points, offset = measured(walls(), driving())
    ahead = points[:, 0] > 0.0
    result = prepared(points[ahead], offset[ahead])
    assert result.problem == "half_sweep"
    assert result.usable
    assert prepared(points, offset, options=SweepOptions(min_coverage=0.98)).problem is None


@pytest.mark.parametrize("part", [0.1, 0.3, 0.75])
def test_coverage_is_the_share_of_all_directions(part: float) -> None:
    points, offset = measured(walls(20_000), driving())
    seen = (np.arctan2(points[:, 1], points[:, 0]) % (2.0 * math.pi)) < part * 2.0 * math.pi
    for share, problem in ((part - 0.015, None), (part + 0.015, "half_sweep")):
        options = SweepOptions(min_coverage=share)
        assert prepared(points[seen], offset[seen], options=options).problem == problem


def test_times_identify_repeated_future_and_old_sweeps() -> None:
    assert prepared(last_time_ns=END_NS).problem == "repeated"
    assert prepared(last_time_ns=END_NS + 1).problem == "repeated"
    assert prepared(last_time_ns=END_NS - 1).problem is None
    assert prepared(now_ns=END_NS - 60_000_000).problem == "from_the_future"
    assert prepared(now_ns=END_NS - 40_000_000).problem is None
    assert prepared(now_ns=END_NS + 1_100_000_000).problem == "too_old"
    assert not prepared(now_ns=END_NS + 1_100_000_000).usable


def test_without_a_track_over_the_whole_sweep_there_is_no_motion() -> None:
    late = RelativeTrack()
    late.append(END_NS - 50_000_000, MotionStep("first"), 0.0, 0.0)
    points, offset = measured(walls(), driving())
    for track in (RelativeTrack(), late):
        result = prepared(points, offset, track=track)
        assert result.problem == "no_motion"
        assert result.at is None
        assert not result.usable


def test_points_of_another_time_are_left_out() -> None:
    points, offset = measured(walls(), driving())
    offset[:300] = -250_000_000
    offset[300:400] = 1_000
    result = prepared(points, offset, options=FINE)
    assert result.problem == "bad_offsets"
    assert len(result.points_m) == len(points) - 400


def test_the_order_of_points_does_not_matter() -> None:
    points, offset = measured(walls(), driving())
    order = np.random.default_rng(3).permutation(len(points))
    one, other = prepared(points, offset), prepared(points[order], offset[order])
    np.testing.assert_allclose(
        one.points_m[np.lexsort(one.points_m.T)], other.points_m[np.lexsort(other.points_m.T)], atol=1e-9
    )


def test_arrays_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="shapes"):
        prepared(np.zeros((5, 2), np.float32), np.zeros(5, np.int32))
    with pytest.raises(ValueError, match="shapes"):
        prepared(np.zeros((5, 3), np.float32), np.zeros(4, np.int32))


def test_a_body_that_rolls_and_pitches_is_deskewed_by_an_inertial_unit() -> None:
    """Points of a resting world, seen from a body that sways, are where they are seen from at the end."""
    track, rng = RelativeTrack(), np.random.default_rng(6)

    def tilt(s: float) -> tuple[float, float]:
        return 0.05 * math.sin(20.0 * s), 0.08 * math.cos(15.0 * s)

    begin_ns = 10**18
    for k in range(26):
        step = MotionStep("first" if k == 0 else "applied", 0.01, speed_m_s=0.0)
        track.append(begin_ns + k * 10_000_000, step, 0.0, 0.0, tilt_rad=tilt(0.01 * k))
    end_s, offsets_s = 0.2, np.sort(rng.uniform(-0.1, 0.0, 500))
    world_m = rng.uniform(-20.0, 20.0, (500, 3)) + np.array([30.0, 0.0, 3.0])
    seen_m = np.array(
        [
            rotation_from_roll_pitch_yaw(*tilt(end_s + s), 0.0).T @ point
            for s, point in zip(offsets_s, world_m, strict=True)
        ]
    )
    motions, at = sweep_motions(track, begin_ns + 200_000_000, 100_000_000)
    assert at is not None
    times = SweepTimes((offsets_s * 1e9).astype(np.int32), 200_000_000, 100_000_000)
    kept_m, _ = deskew(seen_m.astype(np.float32), times, motions, SweepOptions(max_range_m=100.0))
    expected_m = world_m @ rotation_from_roll_pitch_yaw(*tilt(end_s), 0.0)
    assert np.abs(kept_m - expected_m).max() < 0.03
    assert np.abs(seen_m - expected_m).max() > 1.0

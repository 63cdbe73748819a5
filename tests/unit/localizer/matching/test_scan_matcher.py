"""Sweeps hold the pose where they can, and whatever is wrong with them shows in words and covariance."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import pytest

from camber.localizer.matching.ground_alignment import RoadBy
from camber.localizer.matching.layered_matching import MatchOptions
from camber.localizer.matching.registration import Method
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.warm_up import SyntheticMap, synthetic_street
from camber.schemas.codec import encode
from camber.schemas.lidar import Sweep
from camber.schemas.road import TileReply, TileRequest
from support.street_drive import LIDAR_HEIGHT_M, NS, StreetDrive


def only(sweep: Sweep, rows: np.ndarray) -> Sweep:
    columns = ("points_m", "intensity", "offset_ns")
    return sweep.model_copy(update={name: getattr(sweep, name)[rows] for name in columns})


def test_a_given_pose_that_is_off_is_put_right_and_held() -> None:
    drive = StreetDrive(off_m=(0.4, -0.3), off_rad=0.02)
    drive.run(40)
    assert drive.error_m() < 0.05
    assert drive.poses[-1].mode == "scan_match"
    assert drive.poses[-1].match_time_ns is not None
    assert {match.status for match in drive.matches[-20:]} == {"converged"}


def test_a_start_that_is_metres_off_is_searched_for() -> None:
    drive = StreetDrive(off_m=(2.3, -0.8), off_rad=0.05, sigma_m=1.0)
    drive.run(30)
    assert drive.error_m() < 0.1


def test_the_sensors_height_is_that_above_the_road() -> None:
    drive = StreetDrive()
    drive.run(20)
    match = drive.matches[-1]
    assert match.sensor_height_m == pytest.approx(LIDAR_HEIGHT_M, abs=0.02)
    assert match.ground_height_m == pytest.approx(LIDAR_HEIGHT_M, abs=0.02)
    assert match.road_slope_forward == pytest.approx(0.0, abs=0.005)


def no_sweeps(sweep: Sweep) -> list[Sweep]:
    return []


BROKEN: dict[str, Callable[[Sweep], list[Sweep]]] = {
    "none": no_sweeps,
    "empty": lambda sweep: [only(sweep, np.zeros(0, np.int64))],
    "from the future": lambda sweep: [sweep.model_copy(update={"time_ns": sweep.time_ns + 3600 * NS})],
    "from the past": lambda sweep: [sweep.model_copy(update={"time_ns": sweep.time_ns - 60 * NS})],
    "stopped clock": lambda sweep: [
        sweep.model_copy(update={"time_ns": sweep.time_ns // (100 * NS) * 100 * NS})
    ],
    "all nan": lambda sweep: [sweep.model_copy(update={"points_m": np.full_like(sweep.points_m, np.nan)})],
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_without_usable_sweeps_the_mode_is_dead_reckoning_with_a_reason(
    broken: Callable[[Sweep], list[Sweep]],
) -> None:
    drive = StreetDrive(begin_m=-40.0)
    drive.run(20)
    held_m = drive.sigma_m()
    drive.run(60, sweeps=broken)
    pose = drive.poses[-1]
    assert pose.mode == "dead_reckoning"
    assert drive.sigma_m() > 1.5 * held_m
    assert drive.error_m() < 4.0 * drive.sigma_m()
    if broken is not no_sweeps:
        assert {match.status for match in drive.matches[-20:]} == {"lost"}
        assert pose.reason


def test_some_nan_points_and_half_a_sweep_do_no_harm() -> None:
    def damaged(sweep: Sweep) -> list[Sweep]:
        points_m = sweep.points_m.copy()
        points_m[::3] = np.nan
        damaged = sweep.model_copy(update={"points_m": points_m})
        return [only(damaged, np.flatnonzero(sweep.points_m[:, 0] > 0.0))]

    drive = StreetDrive()
    drive.run(40, sweeps=damaged)
    assert drive.error_m() < 0.1
    assert drive.diagnostics.issues["sweep_half_sweep"] > 0


def test_a_sensor_that_is_not_where_its_mount_says_moves_nothing() -> None:
    drive = StreetDrive(mount=SensorMount(x_m=0.0, y_m=0.0, z_m=LIDAR_HEIGHT_M + 0.5))
    drive.run(40)
    assert drive.diagnostics.issues["sensor_mounting"] > 0
    assert all(match.status != "converged" for match in drive.matches[15:])
    assert drive.poses[-1].mode == "dead_reckoning"


def test_a_mirrored_sensor_never_gives_a_confident_wrong_pose() -> None:
    def mirrored(sweep: Sweep) -> list[Sweep]:
        return [sweep.model_copy(update={"points_m": sweep.points_m * np.array([1, -1, 1], np.float32)})]

    drive = StreetDrive(begin_m=-40.0)
    drive.run(80, sweeps=mirrored)
    assert drive.error_m() < 4.0 * drive.sigma_m()


def test_without_clouds_in_the_map_the_pose_gives_the_reason() -> None:
    class NoClouds(SyntheticMap):
        def tile(self, request: TileRequest) -> TileReply:
            return TileReply(
                time_ns=request.time_ns, status="unknown", reason="none here", payload=np.zeros(0, np.uint8)
            )

    drive = StreetDrive(answers=NoClouds(*synthetic_street()))
    drive.run(10)
    assert drive.poses[-1].mode == "dead_reckoning"
    assert "none here" in drive.poses[-1].reason


def test_in_a_bare_corridor_the_along_direction_stays_unknown() -> None:
    road_m, _ = synthetic_street()
    along, up = np.arange(-70.0, 70.0, 0.2), np.arange(0.1, 5.0, 0.2)
    walls_m = np.array([(x, side * 7.0, z) for x in along for side in (-1, 1) for z in up])
    drive = StreetDrive(
        off_m=(0.8, 0.3),
        sigma_m=0.8,
        seen_m=np.concatenate((road_m, walls_m)),
        answers=SyntheticMap(road_m, walls_m),
    )
    drive.run(30)
    covariance = drive.poses[-1].covariance_east_north_yaw
    assert covariance[0] > 0.5**2
    assert covariance[3] < 0.1**2
    assert drive.error_m() < 3.0 * drive.sigma_m()


def test_fixes_change_no_bit_of_a_given_pose_whatever_they_say() -> None:
    seed = 20261121
    print(f"seed {seed}")
    runs = []
    for wild in (False, True):
        random = Random(seed)
        drive = StreetDrive()
        drive.run(10)
        drive.run(
            20, fixes=(lambda d, r=random: d.fix(r.uniform(-50, 50), r.uniform(-50, 50))) if wild else None
        )
        # Since when fixes have not stepped is all that a pose has of them.
        poses = [pose.model_copy(update={"fix_run_begin_time_ns": None}) for pose in drive.poses]
        runs.append([encode(message) for message in (*poses, *drive.matches)])
    assert runs[0] == runs[1]


def test_started_from_fixes_alone_the_pose_is_provisional_until_matches_support_it() -> None:
    drive = StreetDrive(given=False, begin_m=-40.0)
    drive.run(25, sweeps=no_sweeps, fixes=lambda d: d.fix(d.at_m(d.time_ns), 0.0))
    assert drive.poses[-1].mode == "provisional"
    drive.run(90)
    pose = drive.poses[-1]
    assert (pose.mode, pose.provenance) == ("scan_match", "scan_match")
    assert drive.error_m() < 0.1


def test_wrong_fixes_that_wander_together_never_make_a_confident_wrong_pose() -> None:
    drive = StreetDrive(given=False, begin_m=-40.0)
    drive.run(25, sweeps=no_sweeps, fixes=lambda d: d.fix(d.at_m(d.time_ns) + 2.0, 1.5))
    assert drive.poses[-1].mode == "provisional"
    drive.run(90, fixes=lambda d: d.fix(d.at_m(d.time_ns) + 2.0, 1.5))
    assert drive.poses[-1].mode == "provisional" or drive.error_m() < 0.1


def test_the_same_drive_gives_the_same_bytes() -> None:
    runs = []
    for _ in range(2):
        drive = StreetDrive()
        drive.run(15)
        runs.append([encode(message) for message in (*drive.poses, *drive.matches)])
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("road_by", "method", "choice"),
    [
        ("line", "point_to_point", "best"),
        ("line", "plane_to_plane", "mean"),
        ("surface", "vgicp", "weighted"),
        ("surface", "point_to_plane", "whole"),
    ],
)
def test_the_documents_variants_hold_the_pose_too(road_by: RoadBy, method: Method, choice: Any) -> None:
    match = MatchOptions(method=method, choice=choice)
    drive = StreetDrive(matching=ScanMatchOptions(match=match, road_by=road_by))
    drive.run(30)
    assert drive.poses[-1].mode == "scan_match"
    assert drive.error_m() < 0.15

"""A drive with a LiDAR through a street, in a replay: the same bytes at any speed, and no fix in any of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from camber.formats.drive.motion_csv import write_samples
from camber.formats.map_exchange.pcd import write_sweep
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.localizer.warm_up import synthetic_street, synthetic_tile
from camber.road_map.release import write_release
from camber.schemas.motion import Motion
from support.running import payloads, recorded, replayed
from support.small_map import DAY_NS, link, links, surface, surfaces
from support.street_drive import FRAME, START_NS, StreetDrive, geodetic

SECONDS = 6
WRONG_M = 3.0
"""All fixes are off by that, to the east and to the north; their height is right."""


def fix(drive: StreetDrive, off_m: float) -> ReceiverSolution:
    latitude_rad, longitude_rad = geodetic(drive.at_m(drive.time_ns) + off_m, off_m)
    return ReceiverSolution(
        time_ns=drive.time_ns,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=51.5,
        quality=SolutionQuality.FIX,
        satellites=9,
        covariance_enu_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
        age_s=0.0,
        ratio=5.0,
    )


def write_drive(folder: Path) -> Path:
    (folder / "sweeps").mkdir(parents=True)
    drive = StreetDrive()
    motion, fixes = [], [format_pos_header()]
    for drive.tenth in range(10 * SECONDS + 1):
        motion.append(drive.motion())
        write_sweep(folder / "sweeps", drive.sweep())
        fixes.append(format_pos_line(fix(drive, WRONG_M)))
    (folder / "receiver.pos").write_bytes(b"".join(fixes))
    write_samples(folder / "motion.csv", Motion, motion)
    road_m, walls_m = synthetic_street()
    write_release(
        folder / "map",
        region="street",
        map_version=1,
        datum="WGS84",
        epoch_year=2024.0,
        time_ns=START_NS - DAY_NS,
        surfaces=surfaces([surface(1, half_length_m=70.0, half_width_m=4.0, frame=FRAME)]),
        links=links([link(1, (1, 2), [(-70.0, 0.0), (70.0, 0.0)])]),
        clouds=[synthetic_tile("road_cloud", road_m), synthetic_tile("environment_cloud", walls_m)],
        surrogate="made up",
    )
    latitude_rad, longitude_rad = geodetic(drive.begin_m + 0.5, -0.4)
    manifest = folder / "drive.toml"
    manifest.write_text(
        f"""\
name = "street"
[receiver]
format = "pos"
file = "receiver.pos"
[motion]
file = "motion.csv"
[sweeps]
folder = "sweeps"
[map]
release = "map"
[lever_arms.lidar]
z_m = 1.8
[antenna_height]
height_m = 1.5
sigma_m = 0.01
[initial_pose]
latitude_deg = {math.degrees(latitude_rad):.9f}
longitude_deg = {math.degrees(longitude_rad):.9f}
yaw_deg = 1.0
horizontal_sigma_m = 0.5
yaw_sigma_deg = 1.0
"""
    )
    return manifest


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def out(manifest: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed(manifest, tmp_path_factory.mktemp("fast"))


def test_matches_hold_the_pose(out: Path) -> None:
    messages = recorded(out)
    poses, matches = messages["pose"], messages["scan_match"]
    assert len(poses) == 10 * SECONDS + 1
    assert sum(match.message.status == "converged" for match in matches) > 50
    last = poses[-1].message
    assert last.mode == "scan_match"
    east_m, north_m = FRAME.east_north_from_geodetic(last.latitude_rad, last.longitude_rad, 0.0)
    assert math.hypot(east_m - StreetDrive().at_m(last.time_ns), north_m) < 0.1


def test_matches_carry_the_sensors_height(out: Path) -> None:
    matches = [match.message for match in recorded(out)["scan_match"] if match.message.status == "converged"]
    heights = [match.sensor_height_m for match in matches if match.sensor_height_m is not None]
    assert len(heights) > 0.8 * len(matches)
    assert np.median(heights) == pytest.approx(1.8, abs=0.02)


def test_fixes_that_only_the_lidar_can_contradict_are_not_confirmed(out: Path) -> None:
    verdicts = [verdict.message for verdict in recorded(out)["verdict"]]
    assert len(verdicts) > 50
    assert {verdict.verdict for verdict in verdicts if verdict.time_ns > START_NS + 1_000_000_000}.isdisjoint(
        {"confirmed", "confirmed_after_verification"}
    )


def test_the_same_drive_gives_the_same_bytes_at_any_speed(manifest: Path, out: Path, tmp_path: Path) -> None:
    slow = payloads(replayed(manifest, tmp_path / "slow", "--processes", "--speed", "1.5"))
    fast = payloads(out)
    for kind in ("localizer/pose", "localizer/match", "antenna_height/height"):
        (key,) = (key for key in fast if key.endswith(kind))
        assert slow[key] == fast[key]

"""`camber import`: a drive folder of a bag, with what is guessed and missing; what cannot be used is one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.motion_csv import read_samples
from camber.formats.map_exchange.pcd import write_sweep
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import gps_ns_from_unix_ns, unix_ns_from_gps_ns
from camber.replay.drive_inputs import prepare_drive
from camber.replay.sweep_files import sweep_files
from camber.schemas.drive import DriveManifest, load_manifest
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, LeverArm, Motion
from camber.simulator.scenario import load_scenario
from camber.tools.bags import import_command
from camber.tools.simulate import simulate
from support.refusals import Refused
from support.ros_bags import (
    LIVOX,
    LIVOX_ROS1,
    NS,
    BagKind,
    BagWriter,
    bag_writer,
    cloud_fields,
    write_drive_bag,
)

UNIX_NS = 1_716_000_000 * NS
SOLUTION = ReceiverSolution(
    time_ns=0,
    latitude_rad=0.6,
    longitude_rad=2.4,
    height_m=50.0,
    quality=SolutionQuality.FIX,
    covariance_enu_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
)


def imported(bag: Path, out: Path, *options: str) -> DriveManifest:
    assert import_command.main([str(bag), "--out", str(out), *options]) == 0
    return load_manifest(out / "drive.toml")


def made(path: Path, fill: Callable[[BagWriter], None], kind: BagKind = "mcap") -> Path:
    with bag_writer(path, kind) as bag:
        fill(bag)
    return path


def sweep_at(unix_ns: int, seed: int = 1) -> Sweep:
    rng = np.random.default_rng(seed)
    offset_ns = np.sort(rng.integers(-100_000_000, 0, 64))
    offset_ns[-1] = 0
    return Sweep(
        time_ns=gps_ns_from_unix_ns(unix_ns),
        sensor="lidar",
        points_m=rng.normal(0.0, 20.0, (64, 3)).astype(np.float32),
        intensity=rng.uniform(0.0, 1.0, 64).astype(np.float32),
        offset_ns=offset_ns.astype(np.int32),
    )


def add_sweep(bag: BagWriter, topic: str, unix_ns: int, maker: str = "ouster") -> None:
    stamp_ns, fields = cloud_fields(sweep_at(unix_ns), maker)
    bag.point_cloud(topic, unix_ns, stamp_ns, fields)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_positions_and_motion_are_those_of_the_drive(blind: Path, tmp_path: Path, kind: BagKind) -> None:
    bag = write_drive_bag(blind, tmp_path / ("tour.bag" if kind == "ros1" else "tour"), kind)
    manifest, drive = imported(bag, tmp_path / "drive"), load_manifest(blind)
    assert manifest.name == "tour"
    assert manifest.lever_arms.antenna == LeverArm(z_m=1.6)
    assert [one.model_copy(update={"steering_angle_rad": None}) for one in motion(drive)] == motion(manifest)
    again, expected = positions(manifest), positions(drive)
    assert len(again) == len(expected) > 500
    for one, other in zip(again, expected, strict=True):
        assert (one.time_ns, one.quality, one.satellites) == (other.time_ns, other.quality, other.satellites)
        assert one.height_m == other.height_m
        assert one.latitude_rad == pytest.approx(other.latitude_rad, abs=1e-11)
        assert (one.age_s, one.ratio) == (None, None)  # GPSFix has neither


def motion(manifest: DriveManifest) -> list[Motion]:
    assert manifest.motion is not None
    return read_samples(manifest.motion.file, Motion)


def positions(manifest: DriveManifest) -> list[ReceiverSolution]:
    assert manifest.receiver is not None
    decoded = PosDecoder("receiver").feed(manifest.receiver.file.read_bytes())
    assert not [one for one in decoded if not isinstance(one, ReceiverSolution)]
    return [one for one in decoded if isinstance(one, ReceiverSolution)]


def test_the_manifest_says_what_is_guessed_missing_and_not_taken(blind: Path, tmp_path: Path) -> None:
    def fill(bag: BagWriter) -> None:
        bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION)
        bag.write("/note", "std_msgs/msg/String", UNIX_NS, bag.new("std_msgs/msg/String", data="x"))

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    assert positions(manifest)[0].quality is SolutionQuality.DGPS  # GBAS_FIX
    text = (tmp_path / "drive" / "drive.toml").read_text()
    for line in (
        "# /fix (sensor_msgs/msg/NavSatFix): 1 of 1 messages, recorded 0.000 s after their stamps (median)",
        "# missing: whether integers are resolved. NavSatFix does not contain it: no position is a fix",
        "# missing: wheel speed and yaw rate",
        "# missing: sweeps of a LiDAR",
        "# missing: [lever_arms.antenna]; no transform from 'gps' in /tf_static",
        "# missing: the antenna's height above the road at rest; without it no fix is confirmed",
        "# missing: a start, since no position is a fix: [initial_pose]",
        "# guess: 'base_link' is on the road, below the middle of the rear axle",
        "# not taken: /note (std_msgs/msg/String, 1)",
    ):
        assert line in text.splitlines()
    assert manifest.antenna_height is None


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
def test_sweeps_are_in_the_axes_of_the_vehicle(tmp_path: Path, turn_deg: float) -> None:
    folder = tmp_path / "given"
    (folder / "sweeps").mkdir(parents=True)
    given = [sweep_at(UNIX_NS + k * NS // 10, k) for k in range(5)]
    for sweep in given:
        write_sweep(folder / "sweeps", sweep)
    lever = "[lever_arms.lidar]\nx_m = 1.2\nz_m = 1.9\n"
    (folder / "drive.toml").write_text(f'name = "given"\n[sweeps]\nfolder = "sweeps"\n{lever}')
    bag = write_drive_bag(folder / "drive.toml", tmp_path / "bag", lidar_turn_rad=math.radians(turn_deg))
    manifest = imported(bag, tmp_path / "drive")
    assert manifest.lever_arms.lidar == LeverArm(x_m=1.2, y_m=0.0, z_m=1.9)
    assert manifest.sweeps is not None
    again = [file.read() for file in sweep_files(manifest.sweeps.folder)[0]]
    assert [sweep.time_ns for sweep in again] == [sweep.time_ns for sweep in given]
    for sweep, expected in zip(again, given, strict=True):
        assert np.allclose(sweep.points_m, expected.points_m, atol=1e-4)
        assert np.array_equal(sweep.offset_ns, expected.offset_ns)
        assert np.array_equal(sweep.intensity, expected.intensity)
    text = (tmp_path / "drive" / "drive.toml").read_text()
    assert ("# turned from 'lidar' into the axes of 'base_link'" in text) == bool(turn_deg)
    assert "# times of points: field t (Ouster)" in text


def test_sweeps_without_times_of_points_are_taken_and_named(tmp_path: Path) -> None:
    def fill(bag: BagWriter) -> None:
        stamp_ns, fields = cloud_fields(sweep_at(UNIX_NS), "velodyne")
        fields["fields"] = [field for field in fields["fields"] if field[0] != "time"]
        bag.point_cloud("/points", UNIX_NS, stamp_ns, fields)

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    assert manifest.sweeps is not None
    (file,) = sweep_files(manifest.sweeps.folder)[0]
    assert not file.read().offset_ns.any()
    text = (tmp_path / "drive" / "drive.toml").read_text()
    assert "# missing: times of points (none of the fields t, " in text
    assert "# guess: axes of 'lidar' are the vehicle's" in text


def samples() -> list[Imu]:
    start_ns = gps_ns_from_unix_ns(UNIX_NS)
    return [
        Imu(
            time_ns=start_ns + k * 5_000_000,
            angular_rate_rad_s=(0.01 * k, -0.02, 0.125),
            specific_force_m_s2=(0.5, -0.25, 9.75),
        )
        for k in range(20)
    ]


def add_samples(bag: BagWriter, topic: str = "/imu/data", **changes: Any) -> None:
    for sample in samples():
        bag.imu(topic, unix_ns_from_gps_ns(sample.time_ns), sample, **changes)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_inertial_samples_come_with_their_mounting(tmp_path: Path, kind: BagKind) -> None:
    def fill(bag: BagWriter) -> None:
        bag.static_transforms(
            UNIX_NS, {"imu": LeverArm(x_m=0.2, y_m=-0.1, z_m=0.4)}, {"imu": math.radians(-90.0)}
        )
        add_samples(bag)

    bag = made(tmp_path / ("tour.bag" if kind == "ros1" else "tour"), fill, kind)
    manifest = imported(bag, tmp_path / "drive")
    assert manifest.imu is not None
    assert manifest.imu.model_dump(exclude={"file"}) == pytest.approx(
        {
            **{"imu_class": "phone", "x_m": 0.2, "y_m": -0.1, "z_m": 0.4},
            **{"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": -90.0},
        }
    )
    assert read_samples(manifest.imu.file, Imu) == samples()
    text = (tmp_path / "drive" / "drive.toml").read_text()
    assert "# guess: its class; mems or tactical, if it is as accurate as those" in text
    assert "# missing: an inertial measurement unit" not in text


def test_an_inertial_unit_whose_place_is_not_known_is_guessed_to_have_the_vehicles_axes(
    tmp_path: Path,
) -> None:
    manifest = imported(made(tmp_path / "bag", add_samples), tmp_path / "drive")
    assert manifest.imu is not None
    assert manifest.imu.yaw_deg == 0.0
    text = (tmp_path / "drive" / "drive.toml").read_text()
    assert "# missing: where 'imu' is; guess: its axes are the vehicle's" in text


def test_of_two_inertial_units_one_must_be_chosen(tmp_path: Path, refused: Refused) -> None:
    def fill(bag: BagWriter) -> None:
        add_samples(bag, "/imu/data")
        add_samples(bag, "/ouster/imu")

    bag = made(tmp_path / "bag", fill)
    assert "choose with --imu TOPIC" in refused(import_command.main, bag, "--out", tmp_path / "drive")
    imported(bag, tmp_path / "drive", "--imu", "/ouster/imu")
    assert "# not taken: /imu/data" in (tmp_path / "drive" / "drive.toml").read_text()


@pytest.mark.parametrize("name", ["angular_velocity", "linear_acceleration"])
def test_an_imu_that_measures_only_half_is_one_line(tmp_path: Path, refused: Refused, name: str) -> None:
    absent = {f"{name}_covariance": np.array([-1.0, *[0.0] * 8])}
    bag = made(tmp_path / "bag", lambda bag: add_samples(bag, **absent))
    line = refused(import_command.main, bag, "--out", tmp_path / "drive")
    assert f"/imu/data: {name}_covariance is '-1', expected not -1" in line


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_sweeps_of_a_livox_in_its_drivers_message_are_taken(tmp_path: Path, kind: BagKind) -> None:
    sweep, message_kind = sweep_at(UNIX_NS), LIVOX_ROS1 if kind == "ros1" else LIVOX

    def fill(bag: BagWriter) -> None:
        bag.write("/livox/lidar", message_kind, UNIX_NS, bag.livox_message(sweep, message_kind))

    bag = made(tmp_path / ("bag.bag" if kind == "ros1" else "bag"), fill, kind)
    manifest = imported(bag, tmp_path / "drive")
    assert manifest.sweeps is not None
    (file,) = sweep_files(manifest.sweeps.folder)[0]
    taken = file.read()
    assert taken.time_ns == sweep.time_ns
    assert np.array_equal(
        taken.points_m[np.lexsort(taken.points_m.T)], sweep.points_m[np.lexsort(sweep.points_m.T)]
    )


def test_of_two_lidars_one_must_be_chosen(tmp_path: Path, refused: Refused) -> None:
    def fill(bag: BagWriter) -> None:
        add_sweep(bag, "/front/points", UNIX_NS)
        add_sweep(bag, "/rear/points", UNIX_NS)
        add_sweep(bag, "/rear/points", UNIX_NS + NS)

    bag = made(tmp_path / "bag", fill)
    line = refused(import_command.main, bag, "--out", tmp_path / "drive")
    kind = "sensor_msgs/msg/PointCloud2"
    assert f"/front/points ({kind}, 1), /rear/points ({kind}, 2): choose with --lidar TOPIC" in line
    assert not (tmp_path / "drive").exists()
    manifest = imported(bag, tmp_path / "drive", "--lidar", "/rear/points")
    assert manifest.sweeps is not None
    assert len(sweep_files(manifest.sweeps.folder)[0]) == 2
    assert "# not taken: /front/points" in (tmp_path / "drive" / "drive.toml").read_text()


def test_a_topic_that_is_not_there_is_one_line_with_those_that_are(tmp_path: Path, refused: Refused) -> None:
    bag = made(tmp_path / "bag", lambda bag: bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION))
    line = refused(import_command.main, bag, "--out", tmp_path / "drive", "--receiver", "/gps/fix")
    assert line.endswith(
        "--receiver: topic is '/gps/fix', expected a topic for it; "
        "the bag has /fix (sensor_msgs/msg/NavSatFix, 1)"
    )
    line = refused(import_command.main, bag, "--out", tmp_path / "drive", "--lidar", "/points")
    assert line.endswith("the bag has none")


def test_a_base_frame_that_is_not_there_is_one_line_with_those_that_are(
    tmp_path: Path, refused: Refused
) -> None:
    def fill(bag: BagWriter) -> None:
        bag.static_transforms(UNIX_NS, {"gps": LeverArm(x_m=1.0, y_m=0.0, z_m=2.0)}, {})
        bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION)

    bag = made(tmp_path / "bag", fill)
    line = refused(import_command.main, bag, "--out", tmp_path / "drive", "--base-frame", "rear_axle")
    expected = "--base-frame: frame is 'rear_axle', expected one of /tf_static: base_link, gps"
    assert line == f"camber import: {expected}"
    assert not (tmp_path / "drive").exists()
    imported(bag, tmp_path / "drive", "--base-frame", "/base_link")


def test_a_bag_of_other_things_is_one_line(tmp_path: Path, refused: Refused) -> None:
    def fill(bag: BagWriter) -> None:
        bag.write("/note", "std_msgs/msg/String", UNIX_NS, bag.new("std_msgs/msg/String", data="x"))

    line = refused(import_command.main, made(tmp_path / "bag", fill), "--out", tmp_path / "drive")
    assert "expected one of PointCloud2, Livox's CustomMsg, NavSatFix, GPSFix" in line
    assert "it has /note (std_msgs/msg/String, 1)" in line


@pytest.mark.parametrize(
    ("stamps_ns", "expected"),
    [
        ([0, 0], "/points: header.stamp is '0.000000000', expected Unix time"),
        (
            [UNIX_NS - 200_000 * NS] * 2,
            "/points: header.stamp is '1715800000.000', expected a time within a day",
        ),
    ],
)
def test_a_topic_whose_stamps_are_all_wrong_is_one_line(
    tmp_path: Path, refused: Refused, stamps_ns: list[int], expected: str
) -> None:
    def fill(bag: BagWriter) -> None:
        _, fields = cloud_fields(sweep_at(UNIX_NS), "ouster")
        for k, stamp_ns in enumerate(stamps_ns):
            bag.point_cloud("/points", UNIX_NS + k * NS, stamp_ns, fields)

    assert expected in refused(import_command.main, made(tmp_path / "bag", fill), "--out", tmp_path / "drive")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_single_messages_with_wrong_stamps_are_left_out_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fill(bag: BagWriter) -> None:
        for k in range(10):
            header = bag.header(0 if k == 3 else UNIX_NS + k * NS + (90 * NS if k == 6 else 0), "gps")
            bag.nav_sat_fix("/fix", UNIX_NS + k * NS, SOLUTION, header=header)

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    assert len(positions(manifest)) == 8
    printed = capsys.readouterr().out
    assert "/fix (sensor_msgs/msg/NavSatFix): 8 of 10 messages" in printed
    assert "left out: 2, the first: /fix: header.stamp is '0.000000000'" in printed


def test_a_receiver_without_position_is_missing_and_alone_one_line(tmp_path: Path, refused: Refused) -> None:
    def none(bag: BagWriter) -> None:
        status = bag.new("sensor_msgs/msg/NavSatStatus", status=-1, service=1)
        bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION, status=status)

    def and_motion(bag: BagWriter) -> None:
        none(bag)
        bag.twist("/twist", UNIX_NS, 1.0, 0.0)

    line = refused(import_command.main, made(tmp_path / "none", none), "--out", tmp_path / "drive")
    assert line.endswith(
        "/fix: messages, expected a position, a sample of motion or an IMU, a sweep or a frame of UBX or RTCM 3"
    )
    manifest = imported(made(tmp_path / "bag", and_motion), tmp_path / "drive")
    assert manifest.receiver is None
    assert manifest.motion is not None
    assert "# missing: positions of a receiver" in (tmp_path / "drive" / "drive.toml").read_text()


def test_clocks_that_differ_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def fill(bag: BagWriter) -> None:
        for k in range(10):
            ahead = bag.header(UNIX_NS + (k + 18) * NS, "gps")  # GPS time as if it were UTC
            bag.nav_sat_fix("/fix", UNIX_NS + k * NS, SOLUTION, header=ahead)
            bag.twist("/twist", UNIX_NS + k * NS, 1.0, 0.0)

    imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    expected = "wrong: stamps of /fix are 18.0 s ahead of those of /twist, by the times of recording"
    assert expected in capsys.readouterr().out.splitlines()


def test_half_a_bag_is_one_line_and_leaves_nothing(blind: Path, tmp_path: Path, refused: Refused) -> None:
    bag = write_drive_bag(blind, tmp_path / "bag")
    file = bag / "bag.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    line = refused(import_command.main, bag, "--out", tmp_path / "drive")
    assert "bag: data, expected a whole bag: `ros2 bag reindex`, `mcap recover`" in line
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_a_folder_that_exists_is_not_written_into(tmp_path: Path, refused: Refused) -> None:
    bag = made(tmp_path / "bag", lambda bag: bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION))
    line = refused(import_command.main, bag, "--out", tmp_path)
    assert line == f"camber import: {tmp_path}: not empty, expected a new folder"
    (tmp_path / "empty").mkdir()
    assert imported(bag, tmp_path / "empty").name == "bag"


def test_names_of_a_bag_cannot_add_lines_to_the_manifest(tmp_path: Path) -> None:
    evil = 'x"\nname = "evil"\n#'

    def fill(bag: BagWriter) -> None:
        bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION, header=bag.header(UNIX_NS, evil))
        bag.twist(f"/twist{evil}", UNIX_NS, 1.0, 0.0)
        stamp_ns, fields = cloud_fields(sweep_at(UNIX_NS), "ouster")
        bag.point_cloud("/points", UNIX_NS, stamp_ns, fields)
        fields["fields"] = [(f"z{evil}", 2**31, 7), *fields["fields"]]
        bag.point_cloud("/points", UNIX_NS + NS, stamp_ns + NS, fields)

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    assert manifest.name == "bag"
    assert manifest.motion is None
    text = (tmp_path / "drive" / "drive.toml").read_text()
    assert not [line for line in text.splitlines() if line.startswith('name = "evil"')]
    assert "left out: 1" in text


def test_frames_of_ubx_and_rtcm_become_observations(tmp_path: Path) -> None:
    scenario = load_scenario("open-sky", ["duration_s=4.0"])
    folder = simulate(scenario, tmp_path / "simulated", quiet=True).parent
    rover, base = (folder / "rover.ubx").read_bytes(), (folder / "base.rtcm").read_bytes()

    def fill(bag: BagWriter) -> None:
        for k, start in enumerate(range(0, len(rover), 700)):
            bag.raw("/ublox/raw", UNIX_NS + k, rover[start : start + 700])
        rtcm = "rtcm_msgs/msg/Message"
        for k, start in enumerate(range(0, len(base), 900)):
            values: dict[str, Any] = {"message": np.frombuffer(base[start : start + 900], np.uint8).copy()}
            bag.write("/rtcm", rtcm, UNIX_NS + k, bag.new(rtcm, header=bag.header(0, ""), **values))
        bag.raw("/camera", UNIX_NS, b"\xff\xd8 no frames at all" * 100)

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    raw = manifest.observations
    assert raw is not None
    assert raw.rover_obs.read_bytes() == rover
    assert raw.base_obs.read_bytes() == base
    assert raw.ephemerides == (raw.rover_obs,)
    assert manifest.judged_positions == "engine"
    inputs = prepare_drive(manifest, tmp_path / "work")
    assert {arrival.message.stream for arrival in inputs.receiver} == {"rover", "base", "ephemerides"}
    assert sorted(path.name for path in (tmp_path / "drive").iterdir()) == [
        "drive.toml", "rtcm.rtcm", "ublox_raw.ubx",
    ]  # fmt: skip


def test_bytes_of_one_side_alone_are_kept_and_named(tmp_path: Path) -> None:
    folder = simulate(
        load_scenario("open-sky", ["duration_s=4.0"]), tmp_path / "simulated", quiet=True
    ).parent
    data = (folder / "base.rtcm").read_bytes()

    def fill(bag: BagWriter) -> None:
        bag.raw("/base/rtcm", UNIX_NS, data)
        bag.raw("/base_rtcm", UNIX_NS, data[:1000])
        bag.nav_sat_fix("/fix", UNIX_NS, SOLUTION)

    manifest = imported(made(tmp_path / "bag", fill), tmp_path / "drive")
    assert manifest.observations is None
    assert (tmp_path / "drive" / "base_rtcm.rtcm").read_bytes() == data
    assert (tmp_path / "drive" / "base_rtcm-1.rtcm").exists()
    assert "# missing for [observations]: one UBX" in (tmp_path / "drive" / "drive.toml").read_text()

"""The replay tool: what it makes of a drive for the services, and how it ends."""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from camber.antenna_height.settings import AntennaHeightSettings, BodyPoint
from camber.replay import command as replay
from camber.replay.drive_inputs import DriveInputs, DriveTick, prepare_drive
from camber.replay.lock_step.drive import process_settings
from camber.replay.lock_step.processes import Processes
from camber.replay.service_settings import antenna_height_settings, service_settings
from camber.replay.short_drive import write_short_drive
from camber.replay.sweep_files import SweepReader
from camber.runtime.settings import load
from camber.schemas.channels import SERVICES
from camber.schemas.drive import (
    AntennaHeightMethod,
    ImuFile,
    LeverArms,
    RawObservations,
    SampleFile,
    Sweeps,
    load_manifest,
)
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.motion import Imu, LeverArm, Motion, Ranging, Suspension
from camber.tools import demo
from camber.tools.localize.localizer_config import localizer_config
from support.refusals import refusal

NS = 1_300_000_000 * 1_000_000_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> DriveInputs:
    folder = tmp_path_factory.mktemp("drive")
    return prepare_drive(load_manifest(write_short_drive(folder / "drive", 1)), folder / "work")


@pytest.mark.parametrize("service", SERVICES)
def test_the_settings_of_a_drive_are_settings_of_the_service(
    service: str, drive: DriveInputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / 'a folder "with" späces'
    configs = process_settings(drive, out, "tcp/127.0.0.1:7999")
    assert set(configs) == set(SERVICES)
    monkeypatch.setattr(Processes, "_spawn", lambda self, name: Ended())
    Processes(folder=out, configs=configs).start()
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    settings, _ = load(cls, ["--config", str(out / "config" / f"{service}.toml")], prog="camber")
    assert settings.clock == "replay"
    assert settings.vehicle == drive.manifest.vehicle
    assert settings.state_dir == out / "state" / service
    assert settings.zenoh.connect == ["tcp/127.0.0.1:7999"]


def test_the_antenna_and_the_start_of_a_drive_reach_the_services(drive: DriveInputs, tmp_path: Path) -> None:
    manifest, start = drive.manifest, drive.initial_pose
    configs = service_settings(drive, tmp_path)
    assert configs["localizer"]["antenna_x_m"] == manifest.lever_arms.antenna.x_m
    assert configs["antenna_height"]["way"] == manifest.antenna_height.way
    assert configs["integrity"]["alert_limit_m"] == manifest.alert_limit_m
    assert configs["localizer"]["initial_pose"] == start.model_dump()


def test_a_drive_can_carry_the_ambiguities_of_its_observations(drive: DriveInputs, tmp_path: Path) -> None:
    files = {"rover_obs": tmp_path, "base_obs": tmp_path, "ephemerides": (tmp_path,)}
    raw = RawObservations.model_construct(**files, base_ecef_m=None, ambiguities="carried")
    with_raw = replace(drive, manifest=drive.manifest.model_copy(update={"observations": raw}))
    assert service_settings(with_raw, tmp_path)["gnss"]["engine"]["ambiguities"] == "carried"


def test_the_mounting_of_an_inertial_unit_reaches_the_localizer(drive: DriveInputs, tmp_path: Path) -> None:
    assert not [name for name in service_settings(drive, tmp_path)["localizer"] if name.startswith("imu_")]
    mounted = {"x_m": 0.2, "y_m": -0.1, "z_m": 0.4, "roll_deg": 180.0, "pitch_deg": 1.5, "yaw_deg": -90.0}
    imu = ImuFile.model_construct(file=tmp_path, imu_class="phone", **mounted)
    localizer = localizer_config(drive.manifest.model_copy(update={"imu": imu}), None)
    assert {name: value for name, value in localizer.items() if name.startswith("imu_")} == {
        "imu_class": "phone",
        **{f"imu_{name}": value for name, value in mounted.items()},
    }


@pytest.mark.parametrize("method", get_args(AntennaHeightMethod.model_fields["way"].annotation))
def test_every_source_of_the_antenna_height_is_in_the_settings(
    method: str, drive: DriveInputs, tmp_path: Path
) -> None:
    place = LeverArm(x_m=1.0, z_m=1.5)
    height = AntennaHeightMethod(
        way=method,
        height_m=1.58,
        sigma_m=0.02,
        suspension_to_antenna_m=0.9,
        tyre_radius_m=0.3,
        beam_azimuth_deg=180.0,
    )
    table = SampleFile.model_construct(file=tmp_path)
    there = {
        "antenna_height": height,
        "suspension": table,
        "ranging": table,
        "sweeps": Sweeps.model_construct(folder=tmp_path),
        "lever_arms": LeverArms(antenna=place, lidar=place, ranging=place, suspension=place),
    }
    settings_table = antenna_height_settings(drive.manifest.model_copy(update=there))
    settings = AntennaHeightSettings(**settings_table)
    assert (settings.way, settings.fixed_height_m, settings.fixed_sigma_m) == (method, 1.58, 0.02)
    assert (settings.suspension_to_antenna_m, settings.tyre_radius_m) == (0.9, 0.3)
    assert settings.beam_azimuth_deg == 180.0
    places = (settings.antenna, settings.lidar, settings.ranging, settings.suspension)
    assert all(place == BodyPoint(x_m=1.0, y_m=0.0, z_m=1.5) for place in places)


def test_a_sensor_that_a_drive_has_not_got_is_not_waited_for(drive: DriveInputs) -> None:
    settings_table = antenna_height_settings(drive.manifest)
    assert settings_table.keys() & {"antenna", "lidar", "ranging", "suspension"} == {"antenna"}


def test_the_messages_of_a_tick_come_in_the_order_of_the_table() -> None:
    payload = np.zeros(0, np.uint8)
    tick = DriveTick(
        time_ns=NS,
        receiver=(ReceiverBytes(time_ns=NS, protocol="pos", payload=payload),),
        motion=(Motion(time_ns=NS - 1), Motion(time_ns=NS)),
        imu=(Imu(time_ns=NS, angular_rate_rad_s=(0.0, 0.0, 0.0), specific_force_m_s2=(0.0, 0.0, 9.8)),),
        suspension=(Suspension(time_ns=NS, stroke_height_m=0.4, stroke_sigma_m=0.01),),
        ranging=(Ranging(time_ns=NS, distance_m=2.0, beam_angle_rad=1.0, distance_sigma_m=0.02),),
    )
    names = [name for name, _ in tick.messages(SweepReader())]
    assert names == ["receiver_bytes", "motion", "motion", "imu", "suspension", "ranging"]


def test_what_cannot_be_replayed_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, out = write_short_drive(tmp_path / "drive", 1), tmp_path / "out"
    line = refusal(capsys, replay.main, tmp_path / "none.toml", "--out", out)
    assert line.startswith("camber replay: ")
    assert "none.toml" in line
    assert "nothing" in refusal(capsys, replay.main, drive, "--out", out, "--set", "nothing=1")
    (tmp_path / "file").write_text("")
    line = refusal(capsys, demo.main, "--out", tmp_path / "file" / "out")
    assert line.startswith(f"camber demo: {tmp_path / 'file'}")


@pytest.mark.parametrize(("text", "speed"), [("max", math.inf), ("1", 1.0), ("0.5", 0.5), ("1e3", 1000.0)])
def test_a_speed_is_max_or_a_number_above_zero(text: str, speed: float) -> None:
    assert replay.argument_parser().parse_args(["drive.toml", "--processes", "--speed", text]).speed == speed


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "fast", ""])
@pytest.mark.parametrize("tool", [replay, demo])
def test_any_other_speed_is_refused(tool: Any, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["drive.toml"] if tool is replay else []
    assert "--speed" in refusal(capsys, tool.main, *argv, f"--speed={text}")


class Ended:
    """A process that has ended at once, as it should not have."""

    pid = 1

    def poll(self) -> int:
        return 3


def test_a_process_that_ends_again_and_again_is_left_alone_at_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Processes, "_spawn", lambda self, name: Ended())
    processes = Processes(folder=tmp_path, configs={"gnss": {}})
    processes.start()
    for _ in range(50):
        processes.restart_ended()
    assert processes.notes == ["gnss ended (exit code 3) and was started again"] * 20


def test_a_map_that_cannot_be_read_costs_confirmations_and_not_the_replay(tmp_path: Path) -> None:
    manifest = write_short_drive(tmp_path / "drive", 1)
    for blob in (tmp_path / "drive" / "map" / "blobs").rglob("*/*"):
        blob.write_bytes(b"damaged")
    out = tmp_path / "out"
    assert replay.main([str(manifest), "--out", str(out), "--set", "end_s=3", "--quiet"]) == 0
    rows = json.loads((out / "summary.json").read_text("utf-8"))["verdicts"]["by_reason"]
    assert {row["verdict"] for row in rows} == {"unknown"}
    assert "map" in (out / "logs" / "map_server.log").read_text("utf-8")


def test_a_replay_leaves_no_log_of_an_earlier_one(tmp_path: Path) -> None:
    manifest, out = write_short_drive(tmp_path / "drive", 1), tmp_path / "out"
    (out / "logs").mkdir(parents=True)
    (out / "drive.json").write_text("{}")
    (out / "logs" / "nobody.log").write_text("before the drive\n")
    assert replay.main([str(manifest), "--out", str(out), "--set", "end_s=3", "--quiet"]) == 0
    assert "nobody.log" not in [path.name for path in (out / "logs").iterdir()]

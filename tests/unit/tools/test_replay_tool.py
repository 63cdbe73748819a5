"""The replay tool: what it makes of a drive for the services, how it ends, and how it looks after processes."""

from __future__ import annotations

import importlib
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.runtime.feeder import ReplayStuck
from camber.runtime.session import BusError
from camber.runtime.settings import load
from camber.schemas.channels import SERVICES
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.simulator.drive_inputs import DriveInputs, Tick, prepare_drive
from camber.simulator.short_drive import write_short_drive
from camber.simulator.sweep_files import SweepReader
from camber.tools import demo, replay
from camber.tools.processes import Processes

NS = 1_300_000_000 * 1_000_000_000
PATIENCE_S = 30.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[DriveManifest, DriveInputs]:
    folder = tmp_path_factory.mktemp("drive")
    manifest = load_manifest(write_short_drive(folder / "drive", 1))
    return manifest, prepare_drive(manifest, folder / "work")


# What the services are told


@pytest.mark.parametrize("service", SERVICES)
def test_the_settings_of_a_drive_are_settings_of_the_service(
    service: str, drive: tuple[DriveManifest, DriveInputs], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / 'a folder "with" späces'
    configs = replay._configs(*drive, out, "tcp/127.0.0.1:7999")
    assert set(configs) == set(SERVICES)
    monkeypatch.setattr(Processes, "_spawn", lambda self, name: Ended())
    Processes(out, configs).start()
    cls = importlib.import_module(f"camber.{service}.service").SERVICE.SETTINGS
    settings, _ = load(cls, ["--config", str(out / "config" / f"{service}.toml")], prog="camber")
    assert settings.clock == "replay"
    assert settings.vehicle == drive[0].vehicle
    assert settings.state_dir == out / "state" / service
    assert settings.zenoh.connect == ["tcp/127.0.0.1:7999"]


def test_the_antenna_and_the_start_of_a_drive_reach_the_services(
    drive: tuple[DriveManifest, DriveInputs], tmp_path: Path
) -> None:
    manifest, inputs = drive
    configs = replay._configs(manifest, inputs, tmp_path, "tcp/127.0.0.1:7999")
    assert configs["localizer"]["antenna_x_m"] == manifest.lever_arms.antenna.x_m
    assert configs["antenna_height"]["way"] == manifest.antenna_height.way
    assert configs["integrity"]["alert_limit_m"] == manifest.alert_limit_m
    start = inputs.initial_pose
    assert configs["localizer"].get("initial_pose") == (None if start is None else start.model_dump())


def test_a_way_of_knowing_the_height_that_is_not_there_yet_is_refused(
    drive: tuple[DriveManifest, DriveInputs], tmp_path: Path
) -> None:
    manifest, inputs = drive
    height = manifest.antenna_height.model_copy(update={"way": "ranging"})
    with pytest.raises(ManifestError, match=r"antenna_height\.way 'ranging', expected fixed or stroke"):
        replay._configs(manifest.model_copy(update={"antenna_height": height}), inputs, tmp_path, "tcp/x:1")


def test_the_messages_of_a_tick_come_in_the_order_of_the_table() -> None:
    payload = np.zeros(0, np.uint8)
    tick = Tick(
        NS,
        (ReceiverBytes(time_ns=NS, protocol="pos", payload=payload),),
        (Motion(time_ns=NS - 1), Motion(time_ns=NS)),
        (Suspension(time_ns=NS, stroke_height_m=0.4, stroke_sigma_m=0.01),),
        (Ranging(time_ns=NS, distance_m=2.0, beam_angle_rad=1.0, distance_sigma_m=0.02),),
    )
    names = [name for name, _ in replay._messages(tick, SweepReader())]
    assert names == ["receiver_bytes", "motion", "motion", "suspension", "ranging"]


# The command line


def test_a_drive_that_is_not_there_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay.main([str(tmp_path / "none.toml"), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("camber replay: ")
    assert "none.toml" in line


def test_an_override_that_the_manifest_does_not_know_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_short_drive(tmp_path / "drive", 1)
    assert replay.main([str(path), "--out", str(tmp_path / "out"), "--set", "nothing=1"]) == 2
    assert "nothing" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert demo.main(["--out", str(tmp_path / "file" / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"camber demo: {tmp_path / 'file'}")


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (ManifestError("drive.toml: bad"), 2),
        (FormatError("rover.pos", "datum", "WGS84"), 2),
        (OSError(28, "No space left on device"), 2),
        (OSError("no number"), 2),
        (ReplayStuck("tick 7 not done"), 1),
        (BusError("cannot join"), 1),
        (replay._Stopped(), 130),
    ],
)
def test_every_way_to_fail_has_a_line_and_a_code(
    fault: Exception, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> int:
        raise fault

    assert replay.in_words("camber replay", tmp_path, work) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("camber replay: ")
    assert not line.endswith("None")


@pytest.mark.parametrize(("text", "speed"), [("max", math.inf), ("1", 1.0), ("0.5", 0.5), ("1e3", 1000.0)])
def test_a_speed_is_max_or_a_number_above_zero(text: str, speed: float) -> None:
    assert replay._parser().parse_args(["drive.toml", "--speed", text]).speed == speed


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "fast", ""])
@pytest.mark.parametrize("tool", [replay, demo])
def test_any_other_speed_is_refused(tool: Any, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["drive.toml"] if tool is replay else []
    with pytest.raises(SystemExit) as ended:
        tool.main([*argv, f"--speed={text}"])
    assert ended.value.code == 2
    assert "--speed" in capsys.readouterr().err


# Processes


class Ended:
    """A process that has ended at once, as it should not have."""

    pid = 1

    def poll(self) -> int:
        return 3


def sleeper(*, deaf: bool = False) -> subprocess.Popen[bytes]:
    """A process that sleeps; a deaf one does not hear SIGTERM. It says when it is ready."""
    code = "import signal, time; "
    code += (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); " * deaf
        + "print('ready', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    process.stdout.close()
    return process


def test_a_process_that_ends_unasked_is_started_again_and_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spawned: list[subprocess.Popen[bytes]] = []

    def spawn(self: Processes, name: str) -> subprocess.Popen[bytes]:
        spawned.append(sleeper())
        return spawned[-1]

    monkeypatch.setattr(Processes, "_spawn", spawn)
    processes = Processes(tmp_path, {"gnss": {}, "localizer": {}})
    processes.start()
    try:
        processes.supervise()
        assert processes.notes == []
        spawned[0].send_signal(signal.SIGKILL)
        spawned[0].wait(PATIENCE_S)
        processes.supervise()
        assert processes.notes == ["gnss ended (signal SIGKILL) and was started again"]
        assert str(spawned[2].pid) in (tmp_path / "processes.json").read_text()
        assert spawned[2].poll() is None
    finally:
        processes.stop()
    assert all(process.poll() is not None for process in spawned)


def test_a_process_that_ends_again_and_again_is_left_alone_at_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Processes, "_spawn", lambda self, name: Ended())
    processes = Processes(tmp_path, {"gnss": {}})
    processes.start()
    for _ in range(50):
        processes.supervise()
    assert processes.notes == ["gnss ended (exit code 3) and was started again"] * 20


def test_a_process_that_does_not_hear_is_killed_and_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spawned: list[subprocess.Popen[bytes]] = []

    def spawn(self: Processes, name: str) -> subprocess.Popen[bytes]:
        spawned.append(sleeper(deaf=name == "deaf"))
        return spawned[-1]

    monkeypatch.setattr(Processes, "_spawn", spawn)
    processes = Processes(tmp_path, {"deaf": {}, "good": {}})
    processes.start()
    processes.stop(timeout_s=1.0)
    assert [process.returncode for process in spawned] == [-signal.SIGKILL, -signal.SIGTERM]
    assert processes.notes == ["deaf did not end within 1 s and was killed"]


def test_a_service_sees_its_settings_and_nothing_of_the_operators_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMBER_ANTENNA_HEIGHT_NONSENSE", "1")
    processes = Processes(tmp_path, {"antenna_height": {"check": True}})  # a setting that does not exist
    processes.start()
    log = tmp_path / "logs" / "antenna_height.log"
    deadline = time.monotonic() + PATIENCE_S
    while not log.read_text().endswith("\n"):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    processes.stop()
    path = tmp_path / "config" / "antenna_height.toml"
    assert log.read_text() == f"camber antenna_height: {path}: check: unknown setting\n"

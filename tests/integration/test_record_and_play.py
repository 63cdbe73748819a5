"""`camber record` and `camber play`: real processes on a real router, killed, out of disk, and onto a bus in use."""

from __future__ import annotations

import json
import resource
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.drive.motion_csv import write_samples
from camber.formats.drive.recording import Recorded, RecordingError, read_recording
from camber.runtime.subscription import Subscription
from camber.schemas.codec import encode
from camber.schemas.gnss import Fix
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion
from support.messages import build
from support.running import CLOCK, bus_of, camber, camber_started, loopback_router, wait_until

FIX = build(Fix, Random(1), filled=True)
SWEEP = build(Sweep, Random(1), filled=True)


@pytest.fixture
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


class Driving(threading.Thread):
    """Motion, fixes and sweeps until it is stopped."""

    def __init__(self, endpoint: str, *, rate_hz: float = 50.0, points: int = 0) -> None:
        super().__init__(daemon=True)
        self.ended = threading.Event()
        self.vehicle, self.gnss = bus_of(endpoint, "vehicle"), bus_of(endpoint, "gnss")
        self._period_s, self._points = 1.0 / rate_hz, points

    def run(self) -> None:
        while not self.ended.wait(self._period_s):
            now_ns = CLOCK.now_ns()
            self.vehicle.publish("motion", Motion(time_ns=now_ns, wheel_speed_m_s=1.0, yaw_rate_rad_s=0.0))
            times = {"time_ns": now_ns, "fix_id": now_ns // 1_000_000, "continuous_since_ns": now_ns - 10**9}
            self.gnss.publish("fix", FIX.model_copy(update=times))
            if self._points:
                self.vehicle.publish("sweep", _sweep(now_ns, self._points))

    def end(self) -> None:
        self.ended.set()
        self.join(10.0)
        self.vehicle.close()
        self.gnss.close()


def _sweep(time_ns: int, points: int) -> Sweep:
    noise = np.random.default_rng(time_ns % 2**32)
    return SWEEP.model_copy(
        update={
            "time_ns": time_ns,
            "points_m": noise.normal(size=(points, 3)).astype(SWEEP.points_m.dtype),
            "intensity": np.zeros(points, SWEEP.intensity.dtype),
            "offset_ns": np.zeros(points, SWEEP.offset_ns.dtype),
        }
    )


@contextmanager
def driving(endpoint: str, **more: Any) -> Iterator[Driving]:
    thread = Driving(endpoint, **more)
    thread.start()
    try:
        yield thread
    finally:
        thread.end()


def record(stack: ExitStack, endpoint: str, out: Path, *more: str, **options: Any) -> subprocess.Popen[str]:
    command = ("record", "--out", out, "--vehicle", "car", "--connect", endpoint, "--leave-mb", "1", *more)
    return stack.enter_context(camber_started(*command, **options))


def has_bytes(out: Path, least: int) -> bool:
    return sum(path.stat().st_size for path in out.glob("*.mcap")) >= least


def contents(out: Path) -> tuple[list[Recorded[Any]], list[RecordingError]]:
    items = [item for path in sorted(out.glob("*.mcap")) for item in read_recording(path)]
    good = [item for item in items if isinstance(item, Recorded)]
    return good, [item for item in items if isinstance(item, RecordingError)]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_file_that_any_reader_of_mcap_takes(
    endpoint: str, tmp_path: Path, number: signal.Signals
) -> None:
    with ExitStack() as stack:
        process = record(stack, endpoint, tmp_path / "out")
        stack.enter_context(driving(endpoint))
        wait_until(lambda: list((tmp_path / "out").glob("*.mcap")), timeout_s=30.0, why="it records")
        time.sleep(1.5)
        process.send_signal(number)
        output, _ = process.communicate(timeout=30.0)
    assert process.returncode == 0
    assert "0 dropped, 0 malformed" in output
    recorded, errors = contents(tmp_path / "out")
    assert errors == []
    assert {item.channel for item in recorded} == {"motion", "fix"}
    for channel in ("motion", "fix"):
        numbers = [item.sequence for item in recorded if item.channel == channel]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "none is missing, all in order"
        assert len(numbers) > 20
    (path,) = (tmp_path / "out").glob("*.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream)
        read = [message for _, channel, message in reader.iter_messages() if channel.metadata]
        summary = reader.get_summary()
    assert len(read) == len(recorded)
    assert summary is not None
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert "wheel_speed_m_s" in json.loads(schemas["camber.Motion.v1"].data)["properties"]
    assert {schema.encoding for schema in schemas.values()} == {"jsonschema", "protobuf"}


def test_inertial_samples_are_fed_recorded_and_played(endpoint: str, tmp_path: Path) -> None:
    samples = [
        Imu(
            time_ns=1_400_000_000 * 10**9 + k * 5_000_000,
            angular_rate_rad_s=(0.5, -0.25, k / 500),
            specific_force_m_s2=(k / 500, 0.125, 9.75),
        )
        for k in range(400)
    ]
    write_samples(tmp_path / "imu.csv", Imu, samples)
    (tmp_path / "drive.toml").write_text('name = "turns"\n[imu]\nfile = "imu.csv"\nclass = "phone"\n')

    def recorded_of(folder: str, *publisher: object) -> list[Imu]:
        with ExitStack() as stack:
            process = record(stack, endpoint, tmp_path / folder)
            with driving(endpoint):
                wait_until(lambda: list((tmp_path / folder).glob("*.mcap")), timeout_s=30.0, why="it records")
            done = camber(*publisher, "--connect", endpoint, "--vehicle", "car", timeout_s=60.0)
            assert done.returncode == 0, done.stderr
            time.sleep(1.0)
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30.0)
        return [item.message for item in contents(tmp_path / folder)[0] if item.channel == "imu"]

    fed = recorded_of("fed", "feed", tmp_path / "drive.toml")
    played = recorded_of("played", "play", *(tmp_path / "fed").glob("*.mcap"), "--channels", "imu")
    for again in (fed, played):
        steps_ns = np.diff([one.time_ns for one in again])
        assert (steps_ns == 5_000_000).all()
        assert [(one.angular_rate_rad_s, one.specific_force_m_s2) for one in again] == [
            (one.angular_rate_rad_s, one.specific_force_m_s2) for one in samples
        ]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_without_a_router_a_signal_ends_it_at_once(tmp_path: Path, number: signal.Signals) -> None:
    with ExitStack() as stack:
        mute = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        mute.settimeout(60.0)
        process = record(stack, f"tcp/127.0.0.1:{mute.getsockname()[1]}", tmp_path / "out")
        stack.enter_context(mute.accept()[0])  # it waits for the bus
        process.send_signal(number)
        output, _ = process.communicate(timeout=10.0)
    assert process.returncode == -number
    assert output == ""


def test_what_a_kill_leaves_can_be_read_to_its_last_whole_chunk_and_played(
    endpoint: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with ExitStack() as stack:
        process = record(stack, endpoint, out, "--sweeps")
        stack.enter_context(driving(endpoint, rate_hz=10.0, points=5000))
        wait_until(lambda: has_bytes(out, 2_000_000), timeout_s=60.0, why="some chunks are written")
        process.kill()
        process.wait()
    recorded, errors = contents(out)
    assert len(recorded) > 20
    assert {item.channel for item in recorded} == {"motion", "fix", "sweep"}
    assert len(errors) <= 1
    (path,) = out.glob("*.mcap")
    data = path.read_bytes()
    (out / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    path.unlink()
    fast = ("--times", "recorded", "--speed", "1000")
    done = camber("play", out / "cut.mcap", "--connect", endpoint, *fast, timeout_s=120.0)
    assert done.returncode == 1
    assert "messages before the damage were read" in done.stderr
    assert done.stdout.startswith("played fix ")


def test_a_disk_that_takes_no_more_ends_the_recording_and_spoils_nothing(
    endpoint: str, tmp_path: Path
) -> None:
    limit = 3_000_000

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    with ExitStack() as stack:
        process = record(stack, endpoint, tmp_path / "out", "--sweeps", preexec_fn=small_files)
        stack.enter_context(driving(endpoint, rate_hz=20.0, points=10_000))
        output, _ = process.communicate(timeout=90.0)
    assert process.returncode == 1
    assert "recording stopped: File too large" in output
    assert "Traceback" not in output
    recorded, _ = contents(tmp_path / "out")
    assert len(recorded) > 10


def test_files_follow_one_another_without_a_gap(endpoint: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with ExitStack() as stack:
        process = record(stack, endpoint, out, "--max-minutes", "0.02")
        stack.enter_context(driving(endpoint))
        wait_until(lambda: len(list(out.glob("*.mcap"))) >= 3, timeout_s=60.0, why="there are three")
        process.terminate()
        assert process.wait(30.0) == 0
    recorded, errors = contents(out)
    assert errors == []
    numbers = [item.sequence for item in recorded if item.channel == "fix"]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.fixture
def recording(endpoint: str, tmp_path: Path) -> Path:
    with ExitStack() as stack:
        stack.enter_context(driving(endpoint))
        process = record(stack, endpoint, tmp_path / "rec", "--duration", "2")
        output, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0, output
    (path,) = (tmp_path / "rec").glob("*.mcap")
    return path


def received_while(process: subprocess.Popen[str], listener: Subscription) -> list[Any]:
    """All until the process has ended, and what is on its way then."""
    received, over = [], False
    while not over:
        ended = process.poll() is not None
        message = listener.next(timeout_s=0.5)
        received += [] if message is None else [message]
        over = ended and message is None
    return received


def test_played_now_live_consumers_take_it_as_they_took_it_then(endpoint: str, recording: Path) -> None:
    time.sleep(1.0)  # what was recorded is older than any age limit
    before = [item for item in read_recording(recording, ["fix"]) if isinstance(item, Recorded)]
    with (
        Subscription("fix", vehicle="other", connect=[endpoint]) as listener,
        camber_started("play", recording, "--connect", endpoint, "--vehicle", "other") as process,
    ):
        received = received_while(process, listener)
        output = process.stdout.read() if process.stdout else ""
        assert listener.refused["undecodable"] == listener.refused["future"] == 0
        stale = listener.refused["stale"]
    assert process.returncode == 0, output
    assert len(received) + stale == len(before)
    assert len(received) > len(before) / 2
    assert all(fix.fix_id == fix.time_ns // 1_000_000 for fix in received), "called by their new epochs"
    assert {fix.time_ns - (fix.continuous_since_ns or 0) for fix in received} == {10**9}


def test_played_as_recorded_every_message_is_what_it_was(endpoint: str, recording: Path) -> None:
    before = [item.message for item in read_recording(recording, ["fix"]) if isinstance(item, Recorded)]
    fast = ("--times", "recorded", "--speed", "20")
    with (
        Subscription("fix", vehicle="car", connect=[endpoint], live=False) as listener,
        camber_started("play", recording, "--connect", endpoint, *fast) as process,
    ):
        received = received_while(process, listener)
        assert process.returncode == 0
        assert not listener.refused
    assert received == before


def test_it_is_not_played_where_the_same_producers_are(endpoint: str, recording: Path) -> None:
    def tried(*more: str) -> subprocess.CompletedProcess[str]:
        return camber("play", recording, "--connect", endpoint, *more)

    with driving(endpoint):  # recorded, though it has not declared itself
        done = tried()
        assert done.returncode == 1
        assert "gnss, vehicle of car is on this bus" in done.stderr
        assert tried("--vehicle", "other").returncode == 0
    with closing(bus_of(endpoint, "sensors")) as sensors:
        sensors.announce()  # they speak for the vehicle
        done = tried()
        assert done.returncode == 1
        assert "vehicle of car is on this bus" in done.stderr
    with closing(bus_of(endpoint, "gnss")) as gnss:
        gnss.announce()  # declared, though it is silent
        done = tried()
        assert done.returncode == 1
        assert "gnss of car is on this bus" in done.stderr
        assert "--without fix" in done.stderr
        assert tried("--without", "fix").returncode == 0
    assert tried().returncode == 0


def test_a_long_gap_is_printed_before_the_wait(endpoint: str, tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    with Recorder(path) as recorder:
        for n, time_ns in enumerate((1_400_000_000 * 10**9, 1_400_003_600 * 10**9)):
            motion = Motion(time_ns=time_ns, wheel_speed_m_s=1.0, yaw_rate_rad_s=0.0)
            output = encode(motion, source="vehicle", sequence=n)
            recorder.add("motion", output, key="camber/v1/car/vehicle/motion", arrival_ns=0)
    log = tmp_path / "log"
    with log.open("w") as out, camber_started("play", path, "--connect", endpoint, stdout=out) as process:
        wait_until(
            lambda: "a gap in the recording: nothing for 3600 s" in log.read_text(),
            timeout_s=30.0,
            why="the gap is not printed",
        )
        process.terminate()
        assert process.wait(30.0) == 0


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--speed", "2"], "expected 1 with --times now"),
        (["--channels", "health"], "channel 'health'"),
        (["--channels", "pose"], "no message of these channels"),
    ],
)
def test_what_cannot_be_played_is_one_line(
    endpoint: str, recording: Path, arguments: list[str], error: str
) -> None:
    done = camber("play", recording, "--connect", endpoint, *arguments)
    assert done.returncode == 2
    assert error in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_file_that_is_none_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"no recording" * 100)
    for name in ("no.mcap", "nosuch.mcap"):
        done = camber("play", tmp_path / name)
        assert done.returncode == 2
        assert name in done.stderr
        assert len(done.stderr.splitlines()) == 1

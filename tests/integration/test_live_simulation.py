"""`camber simulate --live`: the drive is made, then everything a vehicle would say is on the bus, when it is due."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.runtime.subscription import Subscription
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from support.running import camber, camber_started, free_endpoint, loopback_router

pytestmark = pytest.mark.timed

DURATION_S = 8
RATE_HZ = 10
NS = 1_000_000_000
GPS_EPOCH_UNIX_S = 315_964_800
SCENARIO = ("--set", f"duration_s={DURATION_S}", "--set", "lidar.beams=32", "--set", "lidar.traffic=2")


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with loopback_router() as endpoint:
        yield endpoint


@contextmanager
def simulating(log: Path, scenario: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """`camber simulate --live`, which logs into a file."""
    no_streams = ("--set", "satellites.streams=false", "--live")
    with (
        log.open("w") as file,
        camber_started("simulate", scenario, *no_streams, *arguments, stdout=file) as process,
    ):
        yield process


def received_while(process: subprocess.Popen[str], listener: Subscription) -> list[Any]:
    """Everything until the process has ended."""
    received: list[Any] = []
    while process.poll() is None:
        message = listener.next(0.2)
        if message is not None:
            received.append(message)
    return received


def test_every_message_of_the_drive_is_published_in_order_and_dated_now(
    endpoint: str, tmp_path: Path
) -> None:
    began_ns = time.time_ns()
    log = tmp_path / "log"
    with (
        Subscription("sweep", "motion", "receiver_bytes", vehicle="car", connect=[endpoint]) as listener,
        simulating(log, "overpass", *SCENARIO, "--out", tmp_path / "drive", "--connect", endpoint) as process,
    ):
        received = received_while(process, listener)
        refused = listener.refused
    assert process.returncode == 0, log.read_text()
    # Messages a busy machine delays are refused for their age, though they were published.
    assert sum(refused.values()) < 0.3 * len(received), refused
    for kind in (Sweep, Motion, ReceiverBytes):
        times = [message.time_ns for message in received if isinstance(message, kind)]
        # Of sweeps a consumer gets the newest only: one that was replaced while it worked on another is none missing.
        least = 0.6 if kind is Sweep else 0.9
        assert len(times) + sum(refused.values()) >= least * DURATION_S * RATE_HZ, kind
        assert len(times) >= 0.6 * DURATION_S * RATE_HZ, kind
        assert all(before < after for before, after in pairwise(times)), kind
        steps = sorted(after - before for before, after in pairwise(times))
        assert steps[len(steps) // 2] == pytest.approx(NS / RATE_HZ, rel=0.02), kind
    files = sorted(path.stem for path in (tmp_path / "drive" / "sweeps").iterdir())
    sweeps = [message for message in received if isinstance(message, Sweep)]
    offset_ns = sweeps[-1].time_ns - int(files[-1])
    assert {str(sweep.time_ns - offset_ns) for sweep in sweeps} <= set(files)
    assert all(len(sweep.points_m) > 1000 for sweep in sweeps)
    unix_minus_gps_ns = (315_964_800 - 18) * NS
    assert all(began_ns < m.time_ns + unix_minus_gps_ns < time.time_ns() + NS for m in received)
    solution = PosDecoder("live").feed(
        next(m for m in received if isinstance(m, ReceiverBytes)).payload.tobytes()
    )[0]
    assert isinstance(solution, ReceiverSolution)


def test_a_drive_in_the_future_is_fed_at_its_time_with_raw_observations(
    endpoint: str, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    with (
        Subscription("receiver_bytes", vehicle="raw", connect=[endpoint]) as listener,
        simulating(
            log, "open-sky", "--set", "duration_s=4", "--set", "satellites.rate_hz=2", "--starts-in", "25",
            "--out", tmp_path / "drive", "--connect", endpoint, "--vehicle", "raw",
        ) as process,
    ):  # fmt: skip
        received = received_while(process, listener)
        refused = sum(listener.refused.values())
    assert process.returncode == 0, log.read_text()
    assert "begins in" in log.read_text()
    scenario = json.loads((tmp_path / "drive" / "scenario.json").read_text())
    start = datetime.fromisoformat(scenario["start"]).replace(tzinfo=UTC)
    start_ns = round(start.timestamp() - GPS_EPOCH_UNIX_S) * NS
    raw = [message for message in received if message.protocol == "rinex"]
    assert {message.stream for message in raw} == {"ephemerides", "base", "rover"}
    epochs = [message for message in raw if message.stream == "rover"]
    numbers = [2 * (message.time_ns - start_ns) / NS for message in epochs]
    assert numbers == sorted(set(numbers) & set(range(9)))
    # Messages a busy machine delays are refused for their age, though they were published.
    assert len(numbers) + refused >= 8
    assert len(numbers) >= 5


def test_sigterm_ends_it_without_leftovers(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    with (
        Subscription("motion", vehicle="other", connect=[endpoint]) as listener,
        simulating(
            tmp_path / "log", "open-sky", "--set", "duration_s=600", "--set", "satellites.rate_hz=1",
            "--connect", endpoint, "--vehicle", "other",
        ) as process,
    ):  # fmt: skip
        assert listener.next(timeout_s=120.0) is not None
        assert list(folder.iterdir()) != []
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    assert list(folder.iterdir()) == []


def test_it_waits_for_a_router_and_says_so(tmp_path: Path) -> None:
    where, log = free_endpoint(), tmp_path / "log"
    arguments = ("--set", "duration_s=3", "--out", tmp_path / "drive", "--connect", where)
    with simulating(log, "open-sky", *arguments) as process:
        while "waiting" not in log.read_text():
            assert process.poll() is None, log.read_text()
            time.sleep(0.1)
        with loopback_router(where):
            assert process.wait(60.0) == 0
    lines = [line for line in log.read_text().splitlines() if "waiting" in line]
    assert len(lines) == 1


def test_a_fleet_cannot_be_played(tmp_path: Path) -> None:
    done = camber("simulate", "fleet", "--live", "--out", tmp_path / "fleet")
    assert done.returncode == 2
    assert done.stderr == "camber simulate: fleet: a fleet, expected one vehicle for --live\n"
    assert not (tmp_path / "fleet").exists()


def test_without_live_a_folder_is_asked_for() -> None:
    done = camber("simulate", "city")
    assert done.returncode == 2
    assert "expected --out DIR, --live or both" in done.stderr

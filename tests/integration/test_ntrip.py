"""RTKLIB's caster, str2str: interrupted, restarted, with passwords, slow; and two sources at once."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from camber.formats.rtcm.writer import format_reference_station
from camber.transport.byte_streams import open_stream
from camber.transport.ntrip_client import NtripAccess
from support.hostile_caster import HostileCaster, Peer
from support.streams import Reader, wait_for

GGA = "$GPGGA,090000.00,3510.0000,N,13658.0000,E,1,12,0.8,30.0,M,38.0,M,,*5E"
ACCESS = NtripAccess(user="driver", password="geheim")
STATION = (-3_816_000.0, 3_639_000.0, 3_559_000.0)


def message(number: int) -> bytes:
    """A message of a base station with its number."""
    return format_reference_station(STATION, station_id=number % 4096)


@dataclass
class Base:
    """A base station receiver; `sentences` is the data that the caster sends back to it."""

    pause_s: float = 0.02
    bytewise: bool = False
    muted: bool = False
    sentences: list[tuple[float, bytes]] = field(default_factory=list)

    def script(self, peer: Peer) -> None:
        """Send one message after another."""
        seen = 0
        for number in range(1_000_000):
            data = b"" if self.muted else message(number)
            for part in [data[at : at + 1] for at in range(len(data))] if self.bytewise else [data]:
                peer.say(part)
                peer.listen()
                time.sleep(self.pause_s)
                while (end := peer.sentences.find(b"\n", seen)) >= 0:
                    self.sentences.append((time.monotonic(), peer.sentences[seen : end + 1]))
                    seen = end + 1


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
    return port


@contextmanager
def caster(
    base: HostileCaster, port: int, folder: Path, password: str = "geheim"
) -> Iterator[subprocess.Popen[bytes]]:
    """A caster with the mount point BASE, which forwards the data of its clients to the base station."""
    program = shutil.which("str2str")
    if program is None:
        pytest.skip("str2str of RTKLIB is not installed")
    process = subprocess.Popen(
        [
            *(program, "-in", f"tcpcli://127.0.0.1:{base.port}", "-b", "1", "-r", "200"),
            *("-out", f"ntripc://driver:{password}@:{port}/BASE:base"),
        ],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for(lambda: listens(port))
        yield process
    finally:
        process.kill()
        process.wait()


def listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False


@pytest.fixture
def reader() -> Reader:
    return Reader()


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    wait_for(lambda: set(threading.enumerate()) <= before, within_s=5.0)


def messages_after(data: bytes) -> list[int]:
    """The numbers of the messages in `data`, which may begin in the middle of one."""
    size = len(message(0))
    begin = data.find(message(0)[:3])
    whole = [data[at : at + size] for at in range(begin, len(data) - size + 1, size)]
    known = {message(number): number for number in range(4096)}
    return [known[each] for each in whole]


@pytest.mark.parametrize("version", [1, 2])
def test_messages_are_intact_and_the_position_is_sent(version: int, reader: Reader, tmp_path: Path) -> None:
    base, port, opened_s = Base(), free_port(), time.monotonic()
    access = NtripAccess(
        user="driver", password="geheim", version=version, position=lambda: GGA, position_interval_s=1.0
    )
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port, tmp_path),
        closing(
            open_stream(f"ntrip://127.0.0.1:{port}/BASE", on_data=reader.arrived.set, ntrip=access)
        ) as stream,
    ):
        reader.until(stream, lambda data: len(base.sentences) >= 4)
        assert stream.failures == 0
    numbers = messages_after(reader.data)
    assert len(numbers) > 10
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert {sentence for _, sentence in base.sentences} == {f"{GGA}\r\n".encode()}
    assert base.sentences[3][0] - opened_s >= 3.0  # the first at once, and then one a second at most


def test_restarted_caster_is_reconnected(reader: Reader, tmp_path: Path) -> None:
    port = free_port()
    url = f"ntrip://127.0.0.1:{port}/BASE"
    with (
        HostileCaster(Base().script) as receiver,
        closing(open_stream(url, on_data=reader.arrived.set, ntrip=ACCESS)) as stream,
    ):
        wait_for(lambda: stream.failures > 0)
        assert stream.last_failure == "Connection refused"
        with caster(receiver, port, tmp_path):
            reader.until(stream, lambda data: len(data) > 100)
        wait_for(lambda: stream.problem is not None)
        assert stream.last_failure in (
            "the other side closed the connection",
            "Connection reset by peer",
            "Connection refused",
        )
        reader.data = b""
        with caster(receiver, port, tmp_path):
            reader.until(stream, lambda data: len(data) > 100)
            assert stream.problem is None


def test_a_wrong_password_and_an_unknown_mountpoint_are_named_until_they_are_right(
    reader: Reader, tmp_path: Path
) -> None:
    port = free_port()
    with (
        HostileCaster(Base().script) as receiver,
        closing(
            open_stream(f"ntrip://127.0.0.1:{port}/BASE", on_data=reader.arrived.set, ntrip=ACCESS)
        ) as stream,
        closing(
            open_stream(f"ntrip://127.0.0.1:{port}/BASIS", on_data=reader.arrived.set, ntrip=ACCESS)
        ) as lost,
        closing(open_stream(f"ntrip://127.0.0.1:{port}/BASE", on_data=reader.arrived.set)) as nobody,
    ):
        with caster(receiver, port, tmp_path, password="changed"):
            wait_for(lambda: stream.last_failure == "the caster does not accept user and password (401)")
            wait_for(
                lambda: nobody.last_failure == "the caster asks for user and password (401), and none are set"
            )
        with caster(receiver, port, tmp_path):
            reader.until(stream, lambda data: len(data) > 100)
            wait_for(lambda: "the mountpoint is unknown" in str(lost.last_failure))
    assert "geheim" not in str(stream.last_failure)


def test_silent_base_is_reported_and_received_again(reader: Reader, tmp_path: Path) -> None:
    base, port = Base(), free_port()
    url = f"ntrip://127.0.0.1:{port}/BASE"
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port, tmp_path),
        closing(open_stream(url, on_data=reader.arrived.set, ntrip=ACCESS, silence_s=0.5)) as stream,
    ):
        reader.until(stream, lambda data: len(data) > 100)
        base.muted = True
        wait_for(lambda: stream.last_failure == "silent for 0.5 s")
        base.muted = False
        reader.data = b""
        reader.until(stream, lambda data: len(data) > 100)
        assert stream.problem is None


def test_a_caster_that_gives_a_byte_at_a_time_is_slow_but_not_silent(reader: Reader, tmp_path: Path) -> None:
    base, port = Base(bytewise=True), free_port()
    url = f"ntrip://127.0.0.1:{port}/BASE"
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port, tmp_path),
        closing(open_stream(url, on_data=reader.arrived.set, ntrip=ACCESS, silence_s=2.0)) as stream,
    ):
        reader.until(stream, lambda data: len(data) >= 3 * len(message(0)))
        assert stream.failures == 0
    assert messages_after(reader.data)


def test_a_rover_and_its_base_are_read_at_once_while_both_come_and_go(reader: Reader, tmp_path: Path) -> None:
    """For some seconds; no stream contains bytes of the other source."""
    stop_s = time.monotonic() + 6.0
    of_base, port = Reader(), free_port()

    def rover_for_a_moment(peer: Peer) -> None:
        for _ in range(30):
            peer.say(b"$R" * 500)
            time.sleep(0.01)

    with HostileCaster(rover_for_a_moment) as rover, HostileCaster(Base().script) as receiver:
        rover_stream = open_stream(f"tcp:127.0.0.1:{rover.port}", on_data=reader.arrived.set)
        base_stream = open_stream(f"ntrip://127.0.0.1:{port}/BASE", on_data=of_base.arrived.set, ntrip=ACCESS)
        with closing(rover_stream), closing(base_stream):
            while time.monotonic() < stop_s:
                enough = len(of_base.data) + 300
                with caster(receiver, port, tmp_path):
                    of_base.until(base_stream, lambda data, enough=enough: len(data) >= enough)
                reader.data += rover_stream.take()
            wait_for(lambda: rover_stream.failures > 1 and base_stream.failures > 1)
            assert rover_stream.lost_bytes == base_stream.lost_bytes == 0
    assert len(reader.data) >= 30_000
    assert set(reader.data) == set(b"$R")
    assert b"$R" not in of_base.data

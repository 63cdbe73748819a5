"""RTKLIB's caster, str2str: interrupted, restarted, with passwords, slow; and two sources at once."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from camber.formats.rtcm.writer import format_reference_station
from camber.transport.byte_streams import ByteStream, open_stream
from camber.transport.ntrip_client import NtripAccess
from support.hostile_caster import HostileCaster, Peer
from support.running import free_port
from support.streams import Reader, rtklib_caster, wait_for

pytestmark = pytest.mark.usefixtures("no_thread_is_left")

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


@contextmanager
def stream_of(
    port: int,
    reader: Reader,
    access: NtripAccess | None = ACCESS,
    *,
    mountpoint: str = "BASE",
    silence_s: float = 15.0,
) -> Iterator[ByteStream]:
    url = f"ntrip://127.0.0.1:{port}/{mountpoint}"
    with closing(open_stream(url, on_data=reader.arrived.set, ntrip=access, silence_s=silence_s)) as stream:
        yield stream


def caster(base: HostileCaster, port: int, password: str = "geheim") -> Any:
    """RTKLIB's caster, which forwards the data of its clients to the base station."""
    return rtklib_caster(base.port, port, "-b", "1", password=password)


def messages_after(data: bytes) -> list[int]:
    """The numbers of the messages in `data`, which may begin in the middle of one."""
    size = len(message(0))
    begin = data.find(message(0)[:3])
    whole = [data[at : at + size] for at in range(begin, len(data) - size + 1, size)]
    known = {message(number): number for number in range(4096)}
    return [known[each] for each in whole]


@pytest.mark.parametrize("version", [1, 2])
def test_messages_are_intact_and_the_position_is_sent(version: int, reader: Reader) -> None:
    base, port, opened_s = Base(), free_port(), time.monotonic()
    access = replace(ACCESS, version=version, position=lambda: GGA, position_interval_s=1.0)
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port),
        stream_of(port, reader, access) as stream,
    ):
        reader.until(stream, lambda data: len(base.sentences) >= 4)
        assert stream.failures == 0
    numbers = messages_after(reader.data)
    assert len(numbers) > 10
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert {sentence for _, sentence in base.sentences} == {f"{GGA}\r\n".encode()}
    assert base.sentences[3][0] - opened_s >= 3.0  # the first at once, and then one a second at most


def test_restarted_caster_is_reconnected(reader: Reader) -> None:
    port = free_port()
    with HostileCaster(Base().script) as receiver, stream_of(port, reader) as stream:
        wait_for(lambda: stream.failures > 0)
        assert stream.last_failure == "Connection refused"
        with caster(receiver, port):
            reader.until(stream, lambda data: len(data) > 100)
        wait_for(lambda: stream.problem is not None)
        assert stream.last_failure in (
            "the other side closed the connection",
            "Connection reset by peer",
            "Connection refused",
        )
        reader.data = b""
        with caster(receiver, port):
            reader.until(stream, lambda data: len(data) > 100)
            assert stream.problem is None


def test_a_wrong_password_and_an_unknown_mountpoint_are_named_until_they_are_right(reader: Reader) -> None:
    port = free_port()
    with (
        HostileCaster(Base().script) as receiver,
        stream_of(port, reader) as stream,
        stream_of(port, reader, mountpoint="BASIS") as lost,
        stream_of(port, reader, None) as nobody,
    ):
        with caster(receiver, port, "changed"):
            wait_for(lambda: stream.last_failure == "the caster does not accept user and password (401)")
            wait_for(
                lambda: nobody.last_failure == "the caster asks for user and password (401), and none are set"
            )
        with caster(receiver, port):
            reader.until(stream, lambda data: len(data) > 100)
            wait_for(lambda: "the mountpoint is unknown" in str(lost.last_failure))
    assert "geheim" not in str(stream.last_failure)


def test_silent_base_is_reported_and_received_again(reader: Reader) -> None:
    base, port = Base(), free_port()
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port),
        stream_of(port, reader, silence_s=0.5) as stream,
    ):
        reader.until(stream, lambda data: len(data) > 100)
        base.muted = True
        wait_for(lambda: stream.last_failure == "silent for 0.5 s")
        base.muted = False
        reader.data = b""
        reader.until(stream, lambda data: len(data) > 100)
        assert stream.problem is None


def test_a_caster_that_gives_a_byte_at_a_time_is_slow_but_not_silent(reader: Reader) -> None:
    base, port = Base(bytewise=True), free_port()
    with (
        HostileCaster(base.script) as receiver,
        caster(receiver, port),
        stream_of(port, reader, silence_s=2.0) as stream,
    ):
        reader.until(stream, lambda data: len(data) >= 3 * len(message(0)))
        assert stream.failures == 0
    assert messages_after(reader.data)


def test_a_rover_and_its_base_are_read_at_once_while_both_come_and_go(reader: Reader) -> None:
    """For some seconds; no stream contains bytes of the other source."""
    stop_s = time.monotonic() + 6.0
    of_base, port = Reader(), free_port()

    def rover_for_a_moment(peer: Peer) -> None:
        for _ in range(30):
            peer.say(b"$R" * 500)
            time.sleep(0.01)

    with HostileCaster(rover_for_a_moment) as rover, HostileCaster(Base().script) as receiver:
        rover_stream = open_stream(f"tcp:127.0.0.1:{rover.port}", on_data=reader.arrived.set)
        with closing(rover_stream), stream_of(port, of_base) as base_stream:
            while time.monotonic() < stop_s:
                enough = len(of_base.data) + 300
                with caster(receiver, port):
                    of_base.until(base_stream, lambda data, enough=enough: len(data) >= enough)
                reader.data += rover_stream.take()
            wait_for(lambda: rover_stream.failures > 1 and base_stream.failures > 1)
            assert rover_stream.lost_bytes == base_stream.lost_bytes == 0
    assert len(reader.data) >= 30_000
    assert set(reader.data) == set(b"$R")
    assert b"$R" not in of_base.data

"""Byte streams of a growing file, a TCP server and a serial port: bounded memory, and reconnection."""

from __future__ import annotations

import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest

from camber.transport import byte_streams
from camber.transport.byte_streams import ByteStream, ReconnectBackoff, open_stream, parse_source
from camber.transport.ntrip_client import NtripAccess
from support.streams import PATIENCE_S, Reader, wait_for


@pytest.fixture
def reader() -> Reader:
    return Reader()


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(PATIENCE_S)
        yield listening


def test_a_file_is_read_from_its_beginning_and_while_it_grows(tmp_path: Path, reader: Reader) -> None:
    path = tmp_path / "rover: night.pos"
    path.write_bytes(b"first\n")
    with closing(open_stream(f"file:{path}", on_data=reader.arrived.set)) as stream:
        assert reader.until(stream, lambda data: data.endswith(b"\n")) == b"first\n"
        with path.open("ab") as file:
            file.write(b"second\n")
        assert reader.until(stream, lambda data: len(data) > 6) == b"first\nsecond\n"
        assert stream.problem is None
        assert stream.failures == 0


def test_missing_file_is_reported_and_retried(tmp_path: Path, reader: Reader) -> None:
    path = tmp_path / "later.pos"
    with closing(open_stream(f"file:{path}", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.failures > 0)
        assert "No such file" in stream.problem
        path.write_bytes(b"here")
        assert reader.until(stream, bool) == b"here"
        assert stream.problem is None


def test_large_file_is_read_completely(
    tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_streams, "MAX_BACKLOG_BYTES", 20_000)
    content = bytes(range(256)) * 400
    path = tmp_path / "long.pos"
    path.write_bytes(content)
    with closing(open_stream(f"file:{path}", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.backlog_bytes > 15_000)
        time.sleep(0.05)  # were it to run away, it would by now
        assert stream.backlog_bytes <= 20_000
        assert reader.until(stream, lambda data: len(data) >= len(content)) == content
        assert stream.lost_bytes == 0


def test_stream_reconnects_to_a_restarted_server(server: socket.socket, reader: Reader) -> None:
    port = server.getsockname()[1]
    with closing(open_stream(f"tcp:127.0.0.1:{port}", on_data=reader.arrived.set)) as stream:
        with server.accept()[0] as peer:
            peer.sendall(b"one ")
            assert reader.until(stream, lambda data: len(data) == 4) == b"one "
            assert stream.problem is None
        wait_for(lambda: stream.failures > 0)
        with server.accept()[0] as peer:
            peer.sendall(b"two")
            assert reader.until(stream, lambda data: len(data) == 7) == b"one two"
            assert stream.problem is None


def test_refused_connection_is_reported(reader: Reader) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    with closing(open_stream(f"tcp:127.0.0.1:{port}", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.failures > 0)
        assert "refused" in stream.problem
        assert stream.take() == b""


def test_newest_bytes_are_kept_without_a_consumer(
    server: socket.socket, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_streams, "MAX_BACKLOG_BYTES", 10_000)
    content = b"".join(b"%09d\n" % n for n in range(20_000))
    with closing(
        open_stream(f"tcp:127.0.0.1:{server.getsockname()[1]}", on_data=reader.arrived.set)
    ) as stream:
        with server.accept()[0] as peer:
            peer.sendall(content)
            wait_for(lambda: stream.lost_bytes + stream.backlog_bytes == len(content))
        assert stream.take() == content[-10_000:]
        assert stream.lost_bytes == len(content) - 10_000


def test_a_serial_port_is_read_byte_for_byte(reader: Reader) -> None:
    ours, device = raw_terminal()
    sent = bytes(range(256)) * 8
    with closing(open_stream(f"serial:{device}:115200", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.problem is None)
        os.write(ours, sent)
        assert reader.until(stream, lambda data: len(data) >= len(sent)) == sent
        os.close(ours)
        wait_for(lambda: stream.failures > 0)  # unplugged
        assert stream.problem


def test_a_serial_port_takes_what_is_sent_and_what_it_cannot_take_is_noticed(reader: Reader) -> None:
    ours, device = raw_terminal()
    with closing(open_stream(f"serial:{device}:115200", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.problem is None)
        sent = bytes(range(256))
        assert stream.send(sent)
        received = b""
        while len(received) < len(sent):
            received += os.read(ours, 4096)
        assert received == sent
        assert not stream.send(bytes(10_000_000)), "nobody reads it"
        os.close(ours)
        wait_for(lambda: stream.failures > 0)
        assert not stream.send(b"x")


def test_a_tcp_server_takes_what_is_sent_and_a_file_does_not(
    server: socket.socket, reader: Reader, tmp_path: Path
) -> None:
    with (
        closing(
            open_stream(f"tcp:127.0.0.1:{server.getsockname()[1]}", on_data=reader.arrived.set)
        ) as stream,
        server.accept()[0] as peer,
    ):
        wait_for(lambda: stream.problem is None)
        assert stream.send(b"corrections")
        peer.settimeout(PATIENCE_S)
        assert peer.recv(100) == b"corrections"
    (tmp_path / "rover.pos").touch()
    with closing(open_stream(f"file:{tmp_path / 'rover.pos'}", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.problem is None)
        assert not stream.send(b"corrections")


def test_any_exception_of_a_port_is_retried(reader: Reader) -> None:
    faults = iter([ValueError("no such baud rate"), OSError(5, "Input/output error"), RuntimeError()])
    port = SimpleNamespace(lossless=False, silence_reason="", read=lambda: b"x", close=lambda: None)

    def connect(stop: threading.Event) -> SimpleNamespace:
        for fault in faults:
            raise fault
        return port

    with closing(ByteStream(connect, on_data=reader.arrived.set)) as stream:
        assert reader.until(stream, bool)[:1] == b"x"
        assert stream.failures == 3


def test_closing_ends_the_thread_and_closes_the_source(server: socket.socket, reader: Reader) -> None:
    stream = open_stream(f"tcp:127.0.0.1:{server.getsockname()[1]}", on_data=reader.arrived.set)
    with server.accept()[0] as peer:
        peer.settimeout(PATIENCE_S)
        stream.close()
        assert peer.recv(1) == b""
    wait_for(lambda: not stream.running)


@pytest.mark.parametrize(
    "url",
    [
        "", "bus", "file:", "tcp:", "tcp:host", "tcp::2101", "tcp:host:port", "tcp:host:0",
        "tcp:host:70000", "tcp:host:²", "serial:", "serial::9600", "serial:/dev/ttyS0:0", "udp:host:1",
        "http://host:1/BASE",
    ],
)  # fmt: skip
def test_malformed_source_is_refused_with_the_expected_form(url: str) -> None:
    with pytest.raises(ValueError, match="expected file:PATH, tcp:HOST:PORT or serial:DEVICE") as raised:
        parse_source(url)
    assert repr(url) in str(raised.value)


@pytest.mark.parametrize(
    "url",
    [
        "ntrip:", "ntrip://", "ntrip:host:2101/BASE", "ntrip://host/BASE", "ntrip://host:2101",
        "ntrip://host:2101/", "ntrip://host:70000/BASE", "ntrip://host:2101/BA SE",
        "ntrip://host:2101/BASE\r\nX: y", "ntrip://höst:2101/BASE",
    ],
)  # fmt: skip
def test_malformed_mountpoint_is_refused_with_the_expected_form(url: str) -> None:
    with pytest.raises(ValueError, match="expected ntrip://HOST:PORT/MOUNT"):
        parse_source(url)


@pytest.mark.parametrize(
    "url",
    [
        "ntrip://driver:geheim@host:2101/BASE", "ntrips://driver:ge/heim@host:2101/BASE",
        "driver:geheim@host:2101", "geheim@host", "tcp:driver:geheim@host:2101",
        "ntrip://driver:ge@heim@host:2101/BASE",
    ],
)  # fmt: skip
def test_a_password_in_an_address_is_refused_and_not_repeated(url: str) -> None:
    with pytest.raises(ValueError, match=r"\*\*\*\*@host") as raised:
        parse_source(url)
    assert "heim" not in str(raised.value)
    assert "driver" not in str(raised.value)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"user": "a:b"}, "no colon"),
        ({"password": "geheim"}, "needs a user"),
        ({"version": 3}, "expected 1 or 2"),
        ({"position_interval_s": 0.99}, "expected 1 s or more"),
        ({"position_interval_s": float("nan")}, "expected 1 s or more"),
    ],
)
def test_invalid_ntrip_access_is_refused(wrong: dict[str, object], expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as raised:
        NtripAccess(**wrong)  # type: ignore[arg-type]
    assert "geheim" not in str(raised.value)
    assert "geheim" not in repr(NtripAccess(user="driver", password="geheim"))


@pytest.mark.parametrize(
    "url",
    [
        "file:relative.pos", "file:/a:b", "tcp:caster.example:2101", "tcp:[::1]:2101", "serial:/dev/ttyACM0",
        "serial:/dev/ttyACM0:9600", "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
        "ntrip://caster.example:2101/BASE", "ntrips://[::1]:443/VRS_3_4G",
    ],
)  # fmt: skip
def test_valid_sources_are_parsed_without_opening(url: str) -> None:
    assert callable(parse_source(url))


def test_a_device_below_by_path_may_have_a_baud_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(byte_streams, "_SerialSource", lambda *opened: opened)
    device, stop = "/dev/serial/by-path/usb-0:1.0-port0", threading.Event()
    assert parse_source(f"serial:{device}:38400")(stop) == (device, 38_400)
    assert parse_source(f"serial:{device}")(stop) == (device, 115_200)


def test_pauses_grow_until_data_have_flowed_for_a_while() -> None:
    pauses = ReconnectBackoff(chance=lambda: 1.0)
    grown = [pauses.pause_s(flowed_s, refused=False) for flowed_s in (0.0, 9.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0)]
    assert grown == [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0]
    assert pauses.pause_s(10.0, refused=False) == 0.2
    assert pauses.pause_s(0.0, refused=False) == 0.4


def test_pause_after_refusal_is_longer() -> None:
    pauses = ReconnectBackoff(chance=lambda: 1.0)
    assert [pauses.pause_s(0.0, refused=True) for _ in range(11)][-2:] == [60.0, 60.0]
    assert pauses.pause_s(0.0, refused=False) == 10.0


def test_jitter_is_at_most_half_of_the_pause() -> None:
    assert ReconnectBackoff(chance=lambda: 0.0).pause_s(0.0, refused=False) == 0.1


def test_silent_server_is_reconnected(server: socket.socket, reader: Reader) -> None:
    url = f"tcp:127.0.0.1:{server.getsockname()[1]}"
    with closing(open_stream(url, on_data=reader.arrived.set, silence_s=0.3)) as stream:
        with server.accept()[0]:
            wait_for(lambda: stream.failures > 0)
            assert stream.last_failure == "silent for 0.3 s"
        with server.accept()[0] as peer:
            peer.sendall(b"again")
            assert reader.until(stream, bool) == b"again"
            assert stream.problem is None
            assert stream.last_failure == "silent for 0.3 s"


def test_a_file_may_be_silent_for_ever(tmp_path: Path, reader: Reader) -> None:
    path = tmp_path / "rover.pos"
    path.write_bytes(b"first")
    with closing(open_stream(f"file:{path}", on_data=reader.arrived.set, silence_s=0.01)) as stream:
        reader.until(stream, bool)
        time.sleep(0.3)
        with path.open("ab") as file:
            file.write(b", second")
        assert reader.until(stream, lambda data: len(data) > 5) == b"first, second"
        assert stream.failures == 0


def raw_terminal() -> tuple[int, str]:
    """A pair of pseudo-terminals: the end to write to, and the name of the port."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    os.close(theirs)
    return ours, name


def test_persistent_name_survives_replugging(tmp_path: Path, reader: Reader) -> None:
    port = tmp_path / "usb-receiver"
    first, device = raw_terminal()
    port.symlink_to(device)
    with closing(open_stream(f"serial:{port}", on_data=reader.arrived.set)) as stream:
        wait_for(lambda: stream.problem is None)
        os.write(first, b"one ")
        assert reader.until(stream, lambda data: len(data) == 4) == b"one "
        port.unlink()
        os.close(first)
        wait_for(lambda: stream.failures > 1)
        assert "No such file" in str(stream.last_failure)
        second, device = raw_terminal()
        port.symlink_to(device)
        wait_for(lambda: stream.problem is None)
        os.write(second, b"two")
        assert reader.until(stream, lambda data: len(data) == 7) == b"one two"
        os.close(second)


def test_a_port_is_read_by_one_reader_only(reader: Reader) -> None:
    ours, device = raw_terminal()
    with closing(open_stream(f"serial:{device}", on_data=reader.arrived.set)) as first:
        wait_for(lambda: first.problem is None)
        with closing(open_stream(f"serial:{device}", on_data=reader.arrived.set)) as second:
            wait_for(lambda: second.failures > 0)
            assert "lock" in str(second.last_failure)
        os.write(ours, b"whole")
        assert reader.until(first, lambda data: len(data) == 5) == b"whole"
    os.close(ours)


def test_closing_while_connecting_ends_the_thread(reader: Reader) -> None:
    listening, *waiting = (socket.socket() for _ in range(4))
    listening.bind(("127.0.0.1", 0))
    listening.listen(0)
    for client in waiting:  # the queue is full: others get no answer
        client.setblocking(False)
        client.connect_ex(listening.getsockname())
    stream = open_stream(f"tcp:127.0.0.1:{listening.getsockname()[1]}", on_data=reader.arrived.set)
    time.sleep(0.2)
    assert stream.failures == 0
    assert stream.problem == "not connected yet"
    stream.close()
    wait_for(lambda: not stream.running, within_s=2.0)  # a connection is given up after 5 s
    assert stream.failures == 0
    for each in [listening, *waiting]:
        each.close()

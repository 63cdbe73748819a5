"""Bytes of a receiver: a file that grows, a server that comes back, a serial port; bounded, and never given up."""

from __future__ import annotations

import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from camber.formats import byte_streams
from camber.formats.byte_streams import ByteStream, open_stream, source_of

PATIENCE_S = 20.0


class Reader:
    """What a consumer has taken so far; waits for what has to come, never for a time."""

    def __init__(self) -> None:
        self.arrived = threading.Event()
        self.data = b""

    def until(self, stream: ByteStream, done: Callable[[bytes], bool]) -> bytes:
        deadline = time.monotonic() + PATIENCE_S
        while not done(self.data):
            assert time.monotonic() < deadline, f"only {self.data[:80]!r}, {stream.problem}"
            self.arrived.wait(0.02)
            self.arrived.clear()
            self.data += stream.take()
        return self.data


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


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
    with closing(open_stream(f"file:{path}", arrived=reader.arrived.set)) as stream:
        assert reader.until(stream, lambda data: data.endswith(b"\n")) == b"first\n"
        with path.open("ab") as file:
            file.write(b"second\n")
        assert reader.until(stream, lambda data: len(data) > 6) == b"first\nsecond\n"
        assert stream.problem is None
        assert stream.failures == 0


def test_a_file_that_is_not_there_yet_is_said_and_tried_again(tmp_path: Path, reader: Reader) -> None:
    path = tmp_path / "later.pos"
    with closing(open_stream(f"file:{path}", arrived=reader.arrived.set)) as stream:
        wait_for(lambda: stream.failures > 0)
        assert stream.problem is not None
        assert "No such file" in stream.problem
        path.write_bytes(b"here")
        assert reader.until(stream, bool) == b"here"
        assert stream.problem is None


def test_a_file_larger_than_the_memory_comes_whole(
    tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_streams, "LIMIT_BYTES", 20_000)
    content = bytes(range(256)) * 400
    path = tmp_path / "long.pos"
    path.write_bytes(content)
    with closing(open_stream(f"file:{path}", arrived=reader.arrived.set)) as stream:
        wait_for(lambda: len(stream._bytes) > 15_000)
        time.sleep(0.05)  # were it to run away, it would by now
        assert len(stream._bytes) <= 20_000
        assert reader.until(stream, lambda data: len(data) >= len(content)) == content
        assert stream.lost_bytes == 0


def test_a_server_that_goes_away_is_said_and_found_again(server: socket.socket, reader: Reader) -> None:
    port = server.getsockname()[1]
    with closing(open_stream(f"tcp:127.0.0.1:{port}", arrived=reader.arrived.set)) as stream:
        with server.accept()[0] as peer:
            peer.sendall(b"one ")
            assert reader.until(stream, lambda data: len(data) == 4) == b"one "
            assert stream.problem is None
        wait_for(lambda: stream.failures > 0)
        with server.accept()[0] as peer:
            peer.sendall(b"two")
            assert reader.until(stream, lambda data: len(data) == 7) == b"one two"
            assert stream.problem is None


def test_where_nobody_listens_the_reason_is_said(reader: Reader) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    with closing(open_stream(f"tcp:127.0.0.1:{port}", arrived=reader.arrived.set)) as stream:
        wait_for(lambda: stream.failures > 0)
        assert stream.problem is not None
        assert "refused" in stream.problem
        assert stream.take() == b""


def test_of_a_server_that_nobody_takes_from_the_newest_bytes_stay(
    server: socket.socket, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_streams, "LIMIT_BYTES", 10_000)
    content = b"".join(b"%09d\n" % n for n in range(20_000))
    with closing(
        open_stream(f"tcp:127.0.0.1:{server.getsockname()[1]}", arrived=reader.arrived.set)
    ) as stream:
        with server.accept()[0] as peer:
            peer.sendall(content)
            wait_for(lambda: stream.lost_bytes + len(stream._bytes) == len(content))
        assert stream.take() == content[-10_000:]
        assert stream.lost_bytes == len(content) - 10_000


def test_a_serial_port_is_read_byte_for_byte(reader: Reader) -> None:
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    sent = bytes(range(256)) * 8
    with closing(open_stream(f"serial:{os.ttyname(theirs)}:115200", arrived=reader.arrived.set)) as stream:
        wait_for(lambda: stream.problem is None)
        os.write(ours, sent)
        assert reader.until(stream, lambda data: len(data) >= len(sent)) == sent
        os.close(ours)
        os.close(theirs)
        wait_for(lambda: stream.failures > 0)  # unplugged
        assert stream.problem


def test_whatever_a_port_raises_it_is_tried_again(reader: Reader) -> None:
    faults = iter([ValueError("no such baud rate"), OSError(5, "Input/output error"), RuntimeError()])

    class Port:
        waits = False

        def read(self) -> bytes:
            return b"x"

        def close(self) -> None:
            pass

    def connect() -> Port:
        for fault in faults:
            raise fault
        return Port()

    with closing(ByteStream(connect, arrived=reader.arrived.set)) as stream:
        assert reader.until(stream, bool)[:1] == b"x"
        assert stream.failures == 3


def test_closing_ends_the_thread_and_closes_the_source(server: socket.socket, reader: Reader) -> None:
    stream = open_stream(f"tcp:127.0.0.1:{server.getsockname()[1]}", arrived=reader.arrived.set)
    with server.accept()[0] as peer:
        peer.settimeout(PATIENCE_S)
        stream.close()
        assert peer.recv(1) == b""
    wait_for(lambda: not stream._thread.is_alive())


@pytest.mark.parametrize(
    "url",
    [
        "",
        "bus",
        "file:",
        "tcp:",
        "tcp:host",
        "tcp::2101",
        "tcp:host:port",
        "tcp:host:0",
        "tcp:host:70000",
        "tcp:host:²",
        "serial:",
        "serial::9600",
        "serial:/dev/ttyS0:0",
        "udp:host:1",
    ],
)
def test_a_source_that_is_none_is_refused_with_what_was_expected(url: str) -> None:
    with pytest.raises(ValueError, match="expected file:PATH, tcp:HOST:PORT or serial:DEVICE") as raised:
        source_of(url)
    assert repr(url) in str(raised.value)


@pytest.mark.parametrize(
    "url",
    [
        "file:relative.pos",
        "file:/a:b",
        "tcp:caster.example:2101",
        "tcp:[::1]:2101",
        "serial:/dev/ttyACM0",
        "serial:/dev/ttyACM0:9600",
        "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
    ],
)
def test_a_source_is_understood_without_being_opened(url: str) -> None:
    assert callable(source_of(url))


def test_a_device_below_by_path_may_have_a_baud_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[tuple[str, int]] = []

    def port(device: str, baud_rate: int) -> object:
        opened.append((device, baud_rate))
        return object()

    monkeypatch.setattr(byte_streams, "_Serial", port)
    source_of("serial:/dev/serial/by-path/usb-0:1.0-port0:38400")()
    source_of("serial:/dev/serial/by-path/usb-0:1.0-port0")()
    assert opened == [
        ("/dev/serial/by-path/usb-0:1.0-port0", 38_400),
        ("/dev/serial/by-path/usb-0:1.0-port0", 115_200),
    ]

"""Where a receiver's bytes come from: a file that may still grow, a TCP server, a serial port.

A stream has a thread of its own that reads, reconnects with growing pauses when the other side goes away, and says why.
"""

from __future__ import annotations

import socket
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import serial

_CHUNK = 4096
_LIMIT_CHUNKS = 1024  # 4 MB wait for a consumer at most; then the oldest goes
_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 10.0
_BAUD_RATE = 115_200


class Source(Protocol):
    """An open connection."""

    def read(self) -> bytes:
        """Some bytes; empty where nothing came for a while. Raises OSError when the other side has gone."""

    def close(self) -> None:
        """Close it."""


class ByteStream:
    """Reads a source in the background. `take()` hands out what has come; `problem` is why nothing comes, or None."""

    def __init__(self, open_source: Callable[[], Source], *, arrived: Callable[[], None]) -> None:
        self.problem: str | None = "not connected yet"
        self.reconnects = 0
        self._open = open_source
        self._arrived = arrived
        self._chunks: deque[bytes] = deque(maxlen=_LIMIT_CHUNKS)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="byte-stream", daemon=True)
        self._thread.start()

    def take(self) -> bytes:
        """All bytes that have come since the last call."""
        return b"".join(self._chunks.popleft() for _ in range(len(self._chunks)))

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._thread.join(0.5)

    def _run(self) -> None:
        pause_s = _SHORTEST_PAUSE_S
        while not self._stop.is_set():
            try:
                source = self._open()
                self.problem, pause_s = None, _SHORTEST_PAUSE_S
                try:
                    self._pump(source)
                finally:
                    source.close()
            except (OSError, serial.SerialException) as error:
                self.problem = str(error)[:300]
                self.reconnects += 1
            self._stop.wait(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _pump(self, source: Source) -> None:
        while not self._stop.is_set():
            data = source.read()
            if data:
                self._chunks.append(data)
                self._arrived()


class _File:
    """A file, from its beginning; at its end it is watched for more."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._idle = threading.Event()

    def read(self) -> bytes:
        data = self._file.read(_CHUNK)
        if not data:
            self._idle.wait(0.05)
        return data

    def close(self) -> None:
        self._file.close()


class _Tcp:
    def __init__(self, host: str, port: int) -> None:
        self._name = f"{host}:{port}"
        self._socket = socket.create_connection((host, port), timeout=5.0)
        self._socket.settimeout(0.2)

    def read(self) -> bytes:
        try:
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionResetError(f"{self._name}: the other side closed the connection")
        return data

    def close(self) -> None:
        self._socket.close()


class _Serial:
    def __init__(self, device: str, baud_rate: int) -> None:
        self._port = serial.Serial(device, baud_rate, timeout=0.2)

    def read(self) -> bytes:
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, _CHUNK)))
        return data

    def close(self) -> None:
        self._port.close()


def source_of(url: str) -> Callable[[], Source]:
    """What opens `file:PATH`, `tcp:HOST:PORT` or `serial:DEVICE[:BAUD]`; ValueError says what was expected."""
    kind, _, rest = url.partition(":")
    match kind, rest.rsplit(":", 1):
        case "file", _ if rest:
            return lambda: _File(Path(rest))
        case "tcp", [host, port] if host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536:
            return lambda: _Tcp(host.removeprefix("[").removesuffix("]"), int(port))
        case "serial", [device, baud] if device and baud.isascii() and baud.isdecimal() and int(baud) > 0:
            return lambda: _Serial(device, int(baud))
        case "serial", [device] if device:
            return lambda: _Serial(device, _BAUD_RATE)
    raise ValueError(f"source {url!r}: expected file:PATH, tcp:HOST:PORT or serial:DEVICE[:BAUD]")


def open_stream(url: str, *, arrived: Callable[[], None]) -> ByteStream:
    """A stream from a source that `source_of` knows; ValueError where it does not.

    `arrived` is called from the stream's thread whenever bytes have come.
    """
    return ByteStream(source_of(url), arrived=arrived)

"""Where a receiver's bytes come from: a file that may still grow, a TCP server, a serial port.

A stream has a thread of its own that reads, reconnects with growing pauses when the other side goes away, and says why.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import serial

_CHUNK = 4096
LIMIT_BYTES = 4 << 20
"""So much waits for a consumer at most. Then the oldest goes, but a file is read no further: it does not run away."""
_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 10.0
_BAUD_RATE = 115_200


class Source(Protocol):
    """An open connection. One that `waits` is read only as fast as it is consumed."""

    waits: bool

    def read(self) -> bytes:
        """Some bytes; empty where nothing came for a while. Raises OSError when the other side has gone."""

    def close(self) -> None:
        """Close it."""


class ByteStream:
    """Reads a source in the background. `take()` hands out what has come; `problem` is why nothing comes, or None.

    `failures` counts connections that failed or were lost, `lost_bytes` what nobody took in time.
    """

    def __init__(self, open_source: Callable[[], Source], *, arrived: Callable[[], None]) -> None:
        self.problem: str | None = "not connected yet"
        self.failures = 0
        self.lost_bytes = 0
        self._open = open_source
        self._arrived = arrived
        self._bytes = bytearray()
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="byte-stream", daemon=True)
        self._thread.start()

    def take(self) -> bytes:
        """All bytes that have come since the last call."""
        with self._lock:
            data = bytes(self._bytes)
            self._bytes.clear()
        return data

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
            except (
                Exception
            ) as error:  # a port may fail in many ways; none of them may end the reading for good
                self.problem = (str(error) or type(error).__name__)[:300]
                self.failures += 1
            self._stop.wait(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _pump(self, source: Source) -> None:
        while not self._stop.is_set():
            if source.waits and len(self._bytes) > LIMIT_BYTES - _CHUNK:
                self._stop.wait(0.01)
                continue
            data = source.read()
            if data:
                self._keep(data)
                self._arrived()

    def _keep(self, data: bytes) -> None:
        with self._lock:
            self._bytes += data
            excess = len(self._bytes) - LIMIT_BYTES
            if excess > 0:
                del self._bytes[:excess]
                self.lost_bytes += excess


class _File:
    """A file, from its beginning; at its end it is watched for more."""

    waits = True

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
    waits = False

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
    waits = False

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
        case "serial", [*_, last] if (
            rest and not last.isdecimal()
        ):  # names below /dev/serial/by-path have colons
            return lambda: _Serial(rest, _BAUD_RATE)
    raise ValueError(f"{url!r}: expected file:PATH, tcp:HOST:PORT or serial:DEVICE[:BAUD]")


def open_stream(url: str, *, arrived: Callable[[], None]) -> ByteStream:
    """A stream from a source that `source_of` knows; ValueError where it does not.

    `arrived` is called from the stream's thread whenever bytes have come.
    """
    return ByteStream(source_of(url), arrived=arrived)

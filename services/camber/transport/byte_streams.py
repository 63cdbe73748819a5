"""Byte streams of a receiver or a base station: a file that may still grow, TCP, a serial port, NTRIP.

A stream has a thread that reads, reconnects with growing pauses when the peer goes away, and reports why.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import serial

from camber.transport.ntrip_client import GgaSchedule, Mountpoint, NtripAccess, NtripSource
from camber.transport.tcp_connection import RefusedError, TcpConnection

CHUNK_BYTES = 4096  # chosen: several messages of a receiver
_READ_S = 0.2  # chosen: a stop is noticed after at most this time
MAX_BACKLOG_BYTES = 4 << 20
"""Chosen: minutes of a receiver's stream. Beyond, the oldest bytes are dropped; a file is not read further."""
SILENCE_S = 15.0  # chosen: fifteen epochs at 1 Hz
_BAUD_RATE = 115_200  # u-blox' and Septentrio's usual rate
_CLOSING_S = 0.5  # chosen: longer than any step of a source


class ByteSource(Protocol):
    """An open connection. A `lossless` one is read only as fast as it is consumed, and may be silent for ever."""

    lossless: bool

    @property
    def silence_reason(self) -> str:
        """A known reason for silence, appended to the error message; usually empty."""

    def read(self) -> bytes:
        """Return some bytes; empty where nothing has arrived for a while. Raises OSError when the peer has gone."""

    def send(self, data: bytes) -> int:
        """Send without waiting; return how many bytes were taken: 0 where nobody takes any."""

    def close(self) -> None:
        """Close it."""


class _FileSource:
    """A file, from its beginning; at its end it is polled for more."""

    lossless = True
    silence_reason = ""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._idle = threading.Event()

    def read(self) -> bytes:
        data = self._file.read(CHUNK_BYTES)
        if not data:
            self._idle.wait(0.05)
        return data

    def send(self, data: bytes) -> int:
        return 0

    def close(self) -> None:
        self._file.close()


class _SerialSource:
    """A serial port, opened exclusively: two readers of one port would each get only part of the bytes."""

    lossless = False
    silence_reason = ""

    def __init__(self, device: str, baud_rate: int) -> None:
        # Without a timeout for writing: what the port's buffer does not take is left over.
        self._port = serial.Serial(device, baud_rate, timeout=_READ_S, write_timeout=0, exclusive=True)

    def read(self) -> bytes:
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, CHUNK_BYTES)))
        return data

    def send(self, data: bytes) -> int:
        return int(self._port.write(data) or 0)

    def close(self) -> None:
        self._port.close()


Opener = Callable[[threading.Event], ByteSource]
"""Opens a source; aborts when the event is set."""


class ByteStream:
    """Reads a source in the background. `take()` returns the bytes received; `problem` is why there are none, or None.

    `failures` counts connections that failed or were lost, `last_failure` is the reason of the last one, `lost_bytes`
    counts bytes that were not taken in time. A source that is silent for `silence_s` is reopened.
    """

    def __init__(
        self, open_source: Opener, *, on_data: Callable[[], None], silence_s: float = SILENCE_S
    ) -> None:
        self.problem: str | None = "not connected yet"
        self.last_failure: str | None = None
        self.failures = 0
        self.lost_bytes = 0
        self._source: ByteSource | None = None
        self._open = open_source
        self._on_data = on_data
        self._silence_s = silence_s
        self._flowed_s = 0.0
        self._bytes = bytearray()
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="byte-stream", daemon=True)
        self._thread.start()

    @property
    def backlog_bytes(self) -> int:
        """Bytes received and not taken yet."""
        return len(self._bytes)

    @property
    def running(self) -> bool:
        """Whether the thread still reads or reconnects."""
        return self._thread.is_alive()

    def take(self) -> bytes:
        """Return all bytes received since the last call."""
        with self._lock:
            data = bytes(self._bytes)
            self._bytes.clear()
        return data

    def send(self, data: bytes) -> bool:
        """Send to the other side without waiting; False where it has not taken all of it."""
        source = self._source
        try:
            return source is not None and source.send(data) == len(data)
        except (OSError, serial.SerialException):
            return False  # the reading thread meets the same and reports it

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._thread.join(_CLOSING_S)

    def _run(self) -> None:
        backoff = ReconnectBackoff(random.random)
        while not self._stop.is_set():
            refused = False
            self._flowed_s = 0.0
            try:
                source = self._open(self._stop)
                self.problem, self._source = None, source
                try:
                    self._pump(source)
                finally:
                    self._source = None
                    source.close()
            except Exception as error:  # ports raise many types; none may end the thread
                if self._stop.is_set():
                    return
                self.problem = self.last_failure = _reason(error)
                self.failures += 1
                refused = isinstance(error, RefusedError)
            self._stop.wait(backoff.pause_s(self._flowed_s, refused=refused))

    def _pump(self, source: ByteSource) -> None:
        last_s = time.monotonic()
        first_s: float | None = None
        while not self._stop.is_set():
            if source.lossless and self.backlog_bytes > MAX_BACKLOG_BYTES - CHUNK_BYTES:
                self._stop.wait(0.01)
                continue
            data = source.read()
            now_s = time.monotonic()
            if data:
                self._keep(data)
                self._on_data()
                last_s = now_s
                first_s = now_s if first_s is None else first_s
                self._flowed_s = now_s - first_s
            elif not source.lossless and now_s - last_s > self._silence_s:
                raise TimeoutError(f"silent for {self._silence_s:g} s{source.silence_reason}")

    def _keep(self, data: bytes) -> None:
        with self._lock:
            self._bytes += data
            excess = len(self._bytes) - MAX_BACKLOG_BYTES
            if excess > 0:
                del self._bytes[:excess]
                self.lost_bytes += excess


class ReconnectBackoff:
    """Pauses before the next attempt: doubled each time, until data have flowed for a while.

    A connection alone is no success: a caster that accepts and drops each one would get too many requests. `chance`
    returns numbers in [0, 1), so that not all vehicles reconnect to a caster at the same moment.
    """

    # Chosen: short enough not to lose a fix after a glitch, long enough for a caster that refuses.
    MIN_S = 0.2
    MAX_S = 10.0
    MAX_AFTER_REFUSAL_S = 60.0
    STEADY_S = 10.0

    def __init__(self, chance: Callable[[], float]) -> None:
        self._chance = chance
        self._next_s = self.MIN_S

    def pause_s(self, flowed_s: float, *, refused: bool) -> float:
        """Return the pause after a connection over which data flowed for `flowed_s`, or which was `refused`."""
        if flowed_s >= self.STEADY_S:
            self._next_s = self.MIN_S
        pause_s = min(self._next_s, self.MAX_AFTER_REFUSAL_S if refused else self.MAX_S)
        self._next_s = min(2.0 * self._next_s, self.MAX_AFTER_REFUSAL_S)
        return pause_s * (0.5 + 0.5 * self._chance())


def parse_source(url: str, ntrip: NtripAccess | None = None) -> Opener:
    """Return the opener of `file:PATH`, `tcp:HOST:PORT`, `serial:DEVICE[:BAUD]`, `ntrip[s]://HOST:PORT/MOUNT`.

    The text of ValueError contains what was expected, and never a password.
    """
    kind, _, rest = url.partition(":")
    if kind in ("ntrip", "ntrips"):
        return _ntrip_opener(url, ntrip or NtripAccess())
    match kind, rest.rsplit(":", 1):
        case "file", _ if rest:
            return lambda stop: _FileSource(Path(rest))
        case "tcp", [host, port] if host and "@" not in host and _is_number(port) and int(port) < 65536:
            return lambda stop: TcpConnection(host.strip("[]"), int(port), stop=stop)
        case "serial", [device, baud] if device and _is_number(baud):
            return lambda stop: _SerialSource(device, int(baud))
        # Names below /dev/serial/by-path contain colons.
        case "serial", [*_, last] if rest and not last.isdecimal():
            return lambda stop: _SerialSource(rest, _BAUD_RATE)
    raise ValueError(
        f"{_without_credentials(url)!r}: expected file:PATH, tcp:HOST:PORT or serial:DEVICE[:BAUD], "
        "or of a caster ntrip://HOST:PORT/MOUNT or ntrips://HOST:PORT/MOUNT"
    )


def open_stream(
    url: str, *, on_data: Callable[[], None], ntrip: NtripAccess | None = None, silence_s: float = SILENCE_S
) -> ByteStream:
    """Open a source of `parse_source`; ValueError for any other.

    `on_data` is called from the stream's thread whenever bytes have arrived.
    """
    return ByteStream(parse_source(url, ntrip), on_data=on_data, silence_s=silence_s)


def _ntrip_opener(url: str, access: NtripAccess) -> Opener:
    mountpoint = Mountpoint.parse(url)
    if mountpoint is None:
        hint = "; user and password do not belong into the address" if "@" in url else ""
        expected = f"{url.partition(':')[0]}://HOST:PORT/MOUNT{hint}"
        raise ValueError(f"{_without_credentials(url)!r}: expected {expected}")
    schedule = GgaSchedule(access)
    return lambda stop: NtripSource(mountpoint, access, schedule, stop)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and int(text) > 0


def _without_credentials(url: str) -> str:
    _, at, rest = url.rpartition("@")
    return f"****@{rest}" if at else url


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return (text or type(error).__name__)[:300]

"""Where a receiver's bytes come from, and a base station's: a file that may still grow, TCP, a serial port, NTRIP.

A stream has a thread of its own that reads, reconnects with growing pauses when the other side goes away, and says why.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from pathlib import Path

from camber.transport.byte_sources import CHUNK_BYTES, File, Serial, Source, Tcp
from camber.transport.ntrip_client import GgaSchedule, Mountpoint, Ntrip, NtripAccess
from camber.transport.tcp_connection import RefusedError

LIMIT_BYTES = 4 << 20
"""So much waits for a consumer at most. Then the oldest goes, but a file is read no further: it does not run away."""
SILENCE_S = 15.0
_BAUD_RATE = 115_200
_CLOSING_S = 0.5

Opener = Callable[[threading.Event], Source]
"""Opens a source, and gives up where the event is set meanwhile."""


class ByteStream:
    """Reads a source in the background. `take()` hands out what has come; `problem` is why nothing comes, or None.

    `failures` counts connections that failed or were lost, `last_failure` is why the last one was, `lost_bytes` counts
    what nobody took in time. A source from which nothing comes for `silence_s` is opened anew.
    """

    def __init__(
        self, open_source: Opener, *, arrived: Callable[[], None], silence_s: float = SILENCE_S
    ) -> None:
        self.problem: str | None = "not connected yet"
        self.last_failure: str | None = None
        self.failures = 0
        self.lost_bytes = 0
        self._open = open_source
        self._arrived = arrived
        self._silence_s = silence_s
        self._flowed_s = 0.0
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
        self._thread.join(_CLOSING_S)

    def _run(self) -> None:
        pauses = ReconnectBackoff(random.random)
        while not self._stop.is_set():
            refused = False
            self._flowed_s = 0.0
            try:
                source = self._open(self._stop)
                self.problem = None
                try:
                    self._pump(source)
                finally:
                    source.close()
            except (
                Exception
            ) as error:  # a port may fail in many ways; none of them may end the reading for good
                if self._stop.is_set():
                    return
                self.problem = self.last_failure = _reason(error)
                self.failures += 1
                refused = isinstance(error, RefusedError)
            self._stop.wait(pauses.after(self._flowed_s, refused=refused))

    def _pump(self, source: Source) -> None:
        heard_s = time.monotonic()
        first_s: float | None = None
        while not self._stop.is_set():
            if source.waits and len(self._bytes) > LIMIT_BYTES - CHUNK_BYTES:
                self._stop.wait(0.01)
                continue
            data = source.read()
            now_s = time.monotonic()
            if data:
                self._keep(data)
                self._arrived()
                heard_s = now_s
                first_s = now_s if first_s is None else first_s
                self._flowed_s = now_s - first_s
            elif not source.waits and now_s - heard_s > self._silence_s:
                raise TimeoutError(f"silent for {self._silence_s:g} s{source.silent_because}")

    def _keep(self, data: bytes) -> None:
        with self._lock:
            self._bytes += data
            excess = len(self._bytes) - LIMIT_BYTES
            if excess > 0:
                del self._bytes[:excess]
                self.lost_bytes += excess


class ReconnectBackoff:
    """How long to wait before the next attempt: twice as long each time, until data have flowed for a while.

    A connection alone is no success: a caster that takes and drops each one would be hammered. `chance` gives numbers
    in [0, 1), so that not all vehicles come back to a caster in the same moment.
    """

    SHORTEST_S = 0.2
    LONGEST_S = 10.0
    LONGEST_AFTER_REFUSAL_S = 60.0
    STEADY_S = 10.0

    def __init__(self, chance: Callable[[], float]) -> None:
        self._chance = chance
        self._next_s = self.SHORTEST_S

    def after(self, flowed_s: float, *, refused: bool) -> float:
        """The pause after a connection over which data flowed for `flowed_s`, or which was `refused`, in seconds."""
        if flowed_s >= self.STEADY_S:
            self._next_s = self.SHORTEST_S
        longest_s = self.LONGEST_AFTER_REFUSAL_S if refused else self.LONGEST_S
        pause_s = min(self._next_s, longest_s)
        self._next_s = min(2.0 * self._next_s, self.LONGEST_AFTER_REFUSAL_S)
        return pause_s * (0.5 + 0.5 * self._chance())


def parse_source(url: str, ntrip: NtripAccess | None = None) -> Opener:
    """What opens `file:PATH`, `tcp:HOST:PORT`, `serial:DEVICE[:BAUD]`, `ntrip://HOST:PORT/MOUNT` or `ntrips://…`.

    ValueError says what was expected, and never repeats a password.
    """
    kind, _, rest = url.partition(":")
    if kind in ("ntrip", "ntrips"):
        return _caster(url, ntrip or NtripAccess())
    match kind, rest.rsplit(":", 1):
        case "file", _ if rest:
            return lambda stop: File(Path(rest))
        case "tcp", [host, port] if host and "@" not in host and _number(port) and int(port) < 65536:
            return lambda stop: Tcp(host.removeprefix("[").removesuffix("]"), int(port), stop)
        case "serial", [device, baud] if device and _number(baud):
            return lambda stop: Serial(device, int(baud))
        case "serial", [*_, last] if (
            rest and not last.isdecimal()
        ):  # names below /dev/serial/by-path have colons
            return lambda stop: Serial(rest, _BAUD_RATE)
    raise ValueError(
        f"{_shown(url)!r}: expected file:PATH, tcp:HOST:PORT or serial:DEVICE[:BAUD], "
        "or of a caster ntrip://HOST:PORT/MOUNT or ntrips://HOST:PORT/MOUNT"
    )


def open_stream(
    url: str,
    *,
    arrived: Callable[[], None],
    ntrip: NtripAccess | None = None,
    silence_s: float = SILENCE_S,
) -> ByteStream:
    """A stream from a source that `parse_source` knows; ValueError where it does not.

    `arrived` is called from the stream's thread whenever bytes have come.
    """
    return ByteStream(parse_source(url, ntrip), arrived=arrived, silence_s=silence_s)


def _caster(url: str, access: NtripAccess) -> Opener:
    at = Mountpoint.of(url)
    if at is None:
        told = "; user and password do not belong into the address" if "@" in url else ""
        raise ValueError(f"{_shown(url)!r}: expected {url.partition(':')[0]}://HOST:PORT/MOUNT{told}")
    pace = GgaSchedule(access)
    return lambda stop: Ntrip(at, access, pace, stop)


def _number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and int(text) > 0


def _shown(url: str) -> str:
    """The address without a user's name and password."""
    _, at, after = url.rpartition("@")
    return f"****@{after}" if at else url


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return (text or type(error).__name__)[:300]

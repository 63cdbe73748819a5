"""Sources of bytes: a file that may still grow, a serial port."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Protocol

import serial

CHUNK_BYTES = 4096  # chosen: several messages of a receiver
_READ_S = 0.2  # chosen: a stop is noticed after at most this time


class ByteSource(Protocol):
    """An open connection. A `lossless` one is read only as fast as it is consumed, and may be silent for ever."""

    lossless: bool

    @property
    def silence_reason(self) -> str:
        """A known reason for silence, appended to the error message; usually empty."""

    def read(self) -> bytes:
        """Return some bytes; empty where nothing has arrived for a while. Raises OSError when the peer has gone."""

    def close(self) -> None:
        """Close it."""


class FileSource:
    """A file, from its beginning; at its end it is polled for more."""

    lossless = True
    silence_reason = ""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._idle = threading.Event()

    def read(self) -> bytes:
        """Return the next bytes."""
        data = self._file.read(CHUNK_BYTES)
        if not data:
            self._idle.wait(0.05)
        return data

    def close(self) -> None:
        """Close it."""
        self._file.close()


class SerialSource:
    """A serial port, opened exclusively: two readers of one port would each get only part of the bytes."""

    lossless = False
    silence_reason = ""

    def __init__(self, device: str, baud_rate: int) -> None:
        self._port = serial.Serial(device, baud_rate, timeout=_READ_S, exclusive=True)

    def read(self) -> bytes:
        """Return the bytes received."""
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, CHUNK_BYTES)))
        return data

    def close(self) -> None:
        """Close it."""
        self._port.close()

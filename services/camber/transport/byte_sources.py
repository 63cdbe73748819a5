"""What bytes may be read from: a file that may still grow, a TCP server, a serial port."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Protocol

import serial

from camber.transport.tcp_connection import Connection

CHUNK_BYTES = 4096
_READ_S = 0.2


class Source(Protocol):
    """An open connection. One that `waits` is read only as fast as it is consumed, and may be silent for ever."""

    waits: bool

    @property
    def silent_because(self) -> str:
        """What is known of why nothing comes, to be said after the time that it has lasted; mostly empty."""

    def read(self) -> bytes:
        """Some bytes; empty where nothing came for a while. Raises OSError when the other side has gone."""

    def close(self) -> None:
        """Close it."""


class File:
    """A file, from its beginning; at its end it is watched for more."""

    waits = True
    silent_because = ""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._idle = threading.Event()

    def read(self) -> bytes:
        """What comes next."""
        data = self._file.read(CHUNK_BYTES)
        if not data:
            self._idle.wait(0.05)
        return data

    def close(self) -> None:
        """Close it."""
        self._file.close()


class Tcp:
    """Whatever a TCP server sends."""

    waits = False
    silent_because = ""

    def __init__(self, host: str, port: int, stop: threading.Event) -> None:
        self._connection = Connection(host, port, stop=stop)

    def read(self) -> bytes:
        """What has come."""
        return self._connection.receive(_READ_S)

    def close(self) -> None:
        """Close it."""
        self._connection.close()


class Serial:
    """A serial port, for us alone: two readers of one port take each other's bytes, and neither would know."""

    waits = False
    silent_because = ""

    def __init__(self, device: str, baud_rate: int) -> None:
        self._port = serial.Serial(device, baud_rate, timeout=_READ_S, exclusive=True)

    def read(self) -> bytes:
        """What has come."""
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, CHUNK_BYTES)))
        return data

    def close(self) -> None:
        """Close it."""
        self._port.close()

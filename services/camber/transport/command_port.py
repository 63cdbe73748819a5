"""A serial port or TCP connection to a receiver that answers what is written to it."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any

import serial

_READ_S = 0.05  # chosen: how late an end of waiting is noticed


class CommandPort:
    """An open port; use as a context. `address` is serial:DEVICE[:BAUD] or tcp:HOST:PORT.

    Raises ValueError for another address, OSError (serial.SerialException) where it cannot be opened.
    """

    def __init__(self, address: str, *, baud_rate: int = 115_200) -> None:
        kind, _, rest = address.partition(":")
        name, _, number = rest.rpartition(":")
        if kind == "tcp" and name and number.isdecimal():
            self._port: Any = serial.serial_for_url(f"socket://{rest}", timeout=_READ_S)
        elif kind == "serial" and rest:
            device, baud = (name, int(number)) if name and number.isdecimal() else (rest, baud_rate)
            self._port = serial.Serial(device, baud, timeout=_READ_S, exclusive=True)
        else:
            raise ValueError(f"{address!r}: expected serial:DEVICE[:BAUD] or tcp:HOST:PORT")

    def __enter__(self) -> CommandPort:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._port.close()

    def write(self, data: bytes) -> None:
        """Write all of it."""
        self._port.write(data)
        self._port.flush()

    def read(self, until_s: float) -> bytes:
        """Return what has arrived, waiting for it until a time of `time.monotonic`; empty where nothing came."""
        while True:
            data: bytes = self._port.read(max(1, self._port.in_waiting))
            if data or time.monotonic() >= until_s:
                return data

"""Consumers of byte streams that wait for a condition, never for a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from camber.transport.byte_streams import ByteStream

PATIENCE_S = 20.0


class Reader:
    """A consumer of a stream."""

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


def wait_for(condition: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)

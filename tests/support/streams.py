"""Consumers of byte streams that wait for a condition, never for a time; and RTKLIB's caster."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest

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


@contextmanager
def rtklib_caster(
    base_port: int, port: int, *more: str, password: str = "geheim"
) -> Iterator[subprocess.Popen[bytes]]:
    """A caster on a port, with one mountpoint, BASE, that takes a base station's data from another port."""
    program = shutil.which("str2str")
    if program is None:
        pytest.skip("str2str of RTKLIB is not installed")
    mountpoint = f"ntripc://driver:{password}@:{port}/BASE:base"
    process = subprocess.Popen(
        [program, "-in", f"tcpcli://127.0.0.1:{base_port}", "-r", "200", *more, "-out", mountpoint],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for(lambda: _listens(port))
        yield process
    finally:
        process.kill()
        process.wait()


def _listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False

"""A service whose machine's clock is set wrong while it runs: `python -m support.stepped_clock FILE SERVICE …`.

FILE holds the offset of the clock, an int64 of nanoseconds, that a test writes into it. Only what Python calls
the time moves, which is all that a service dates by; as on a machine whose clock is set, what waits goes on waiting.
"""

from __future__ import annotations

import mmap
import struct
import sys
import time
from pathlib import Path

_FORMAT = "<q"


def make(path: Path) -> Path:
    """A clock that is right."""
    path.write_bytes(struct.pack(_FORMAT, 0))
    return path


def step(path: Path, offset_s: float) -> None:
    """Set the clock that far from what is right."""
    with path.open("r+b") as file:
        file.write(struct.pack(_FORMAT, round(offset_s * 1e9)))


def _install(path: Path) -> None:
    with path.open("rb") as file:
        offset = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    right_ns = time.time_ns

    def time_ns() -> int:
        return int(right_ns() + struct.unpack(_FORMAT, offset[:8])[0])

    time.time_ns = time_ns
    time.time = lambda: time_ns() / 1e9


if __name__ == "__main__":
    _install(Path(sys.argv[1]))
    from camber.cli import main

    raise SystemExit(main(sys.argv[2:]))

"""Bytes of a plain file, bounded: a pipe or a device in its place would block, or never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def check_plain_file(path: Path) -> None:
    """Raise OSError where something that is no plain file has this path; nothing at all is right."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "not a plain file", str(path))


def read_plain_file(path: Path, limit_bytes: int) -> bytes:
    """Return the bytes of a file. Raises OSError, also for what is no plain file or has more than `limit_bytes`."""
    # Without O_NONBLOCK a pipe is not opened until somebody writes into it.
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "not a plain file", str(path))
        with open(handle, "rb", closefd=False) as stream:
            data = stream.read(limit_bytes + 1)
    finally:
        os.close(handle)
    if len(data) > limit_bytes:
        raise OSError(errno.EFBIG, f"larger than {limit_bytes} bytes", str(path))
    return data

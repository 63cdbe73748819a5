"""One process for each service and folder of state: two would overwrite what the other has learnt."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class FolderInUseError(RuntimeError):
    """Another process of this service works in the folder; the text names it."""


@contextmanager
def locked(folder: Path | None, service: str) -> Iterator[None]:
    """Hold the lock of a service on a folder, which ends with the process; raises FolderInUseError.

    Where no file can be made, none can be overwritten: there is no lock then.
    """
    handle = None if folder is None else _open_lock(folder, service)
    try:
        if handle is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise FolderInUseError(
            f"{folder}: another {service} uses this folder, expected one of its own"
        ) from None
    finally:
        if handle is not None:
            os.close(handle)


def _open_lock(folder: Path, service: str) -> int | None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(
            folder / f"{service}.lock", os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC, 0o644
        )
    except OSError:
        return None

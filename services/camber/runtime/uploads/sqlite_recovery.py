"""A damaged SQLite file: read what can be read, put a fresh file in its place, keep the damaged one beside it.

The swap may be cut off at any point. The fresh file is complete under the name `….fresh` before anything is moved, so
a process that sees that name only has to move on (`finish_swap`); a half-made `….making` is thrown away.
"""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from camber.schemas.plain_file import check_plain_file

_PARTS = ("-wal", "-shm", "")  # the file itself last: while it is there its log must not be lost sight of

_HINDRANCES = (
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_AUTH,
    sqlite3.SQLITE_INTERRUPT,
)


def is_damage(error: Exception) -> bool:
    """Does SQLite say that the file is no database, or a broken one?"""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def is_hindrance(error: sqlite3.Error) -> bool:
    """Does SQLite say that the disk, the system or another process is in the way, and not the file itself?"""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in _HINDRANCES


def is_plain(path: Path) -> bool:
    """Is each part of the file that exists a plain file? SQLite would wait for ever at a pipe."""
    try:
        for part in _PARTS:
            check_plain_file(_named(path, part))
    except OSError:
        return False
    return True


def readable_rows(path: Path, table: str, columns: Sequence[str]) -> list[tuple[Any, ...]]:
    """The rows of `table` that can still be read, by its integer key (`columns[0]`).

    Reads from both ends up to the damage. A row may be wrong in itself: the caller checks it.
    """
    rows: dict[Any, tuple[Any, ...]] = {}
    if not is_plain(path):
        return []
    with suppress(sqlite3.DatabaseError), closing(sqlite3.connect(path)) as db:
        db.text_factory = lambda raw: raw.decode("utf-8", "replace")
        for order in ("ASC", "DESC"):
            with suppress(sqlite3.DatabaseError):
                query = f"SELECT {', '.join(columns)} FROM {table} NOT INDEXED ORDER BY {columns[0]} {order}"
                for row in db.execute(query):
                    rows[row[0]] = row
    return [rows[key] for key in sorted(rows)]


def replace_damaged(path: Path, fill: Callable[[Path], None]) -> Path:
    """Put the file that `fill` makes in the place of `path`; returns where the damaged one is.

    An older damaged file under that name is overwritten: damage must not fill the disk. Where there is no room for the
    fresh one, all is left as it is; OSError or sqlite3.Error.
    """
    making = _named(path, ".making")
    _remove(making)
    try:
        fill(making)
        # On a full disk SQLite leaves in its log what it could not bring into the file, and says nothing.
        if _named(making, "-wal").exists():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(making))
    except (OSError, sqlite3.Error):
        _remove(making)
        raise
    _remove(_named(path, ".corrupt"))
    os.replace(making, _named(path, ".fresh"))
    _sync_folder(path)
    return finish_swap(path)


def finish_swap(path: Path) -> Path:
    """Carry a swap that has begun to its end; returns where a damaged file would be."""
    damaged = _named(path, ".corrupt")
    fresh = _named(path, ".fresh")
    if fresh.exists():
        for part in _PARTS:
            with suppress(FileNotFoundError):
                os.replace(_named(path, part), _named(damaged, part))
        os.replace(fresh, path)
        _sync_folder(path)
    _remove(_named(path, ".making"))
    return damaged


def _remove(path: Path) -> None:
    for part in _PARTS:
        _named(path, part).unlink(missing_ok=True)


def _named(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _sync_folder(path: Path) -> None:
    """Make the renames durable."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)

"""What a vehicle has promised to upload: on its disk from `put_many` until the cloud has acknowledged it.

An SQLite file with a write-ahead log, `synchronous=FULL`: a transaction that has returned survives SIGKILL and power
cuts. The outbox is the only copy of what it holds, so it is not asked to be faster than the disk; `put_many` shares one
flush among many uploads.

    OutboxError             the disk does not let the outbox work now; nothing stored is lost, the service goes on
    └── OutboxFull          the limit or the disk is reached: this upload was not taken
"""

from __future__ import annotations

import sqlite3
import threading
import zlib
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from camber.runtime.uploads.sqlite_recovery import (
    finish_swap,
    is_damage,
    is_hindrance,
    is_plain,
    readable_rows,
    replace_damaged,
)

T = TypeVar("T")

DEAD_LETTERS = 1_000  # chosen: kept for inspection
DAMAGED_ON_DISK = "damaged on disk"
_PAGE_BYTES = 4096  # SQLite's default page size
_LEAST_LIMIT_BYTES = 16 * _PAGE_BYTES
_WAIT_S = 1.0  # for another process that has the file open, an inspecting one for instance

_FORMAT = 2  # 1 had no table `identity`
_SCHEMA = """
CREATE TABLE identity (format INTEGER PRIMARY KEY, vehicle TEXT NOT NULL, checksum INTEGER NOT NULL);
CREATE TABLE upload (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    channel TEXT NOT NULL,
    payload BLOB NOT NULL,
    checksum INTEGER NOT NULL
);
CREATE TABLE dead_letter (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL,
    channel TEXT NOT NULL,
    payload BLOB NOT NULL,
    reason TEXT NOT NULL
);
"""


class OutboxError(RuntimeError):
    """The outbox cannot work now; the text names the file and what hinders it."""


class OutboxFull(OutboxError):  # noqa: N818  (the name says what is the matter)
    """There is no room: the upload that was put is not stored."""


class Upload(NamedTuple):
    """One upload as it is put in: its id, unique in this outbox, the channel it goes over, its encoded bytes."""

    id: str
    channel: str
    payload: bytes


class Pending(NamedTuple):
    """One upload as it waits; `number` grows in the order in which uploads were put."""

    number: int
    id: str
    channel: str
    payload: bytes


class OutboxCounts(NamedTuple):
    """How many uploads wait, and how many dead letters are kept."""

    pending: int
    dead_letters: int


class Outbox:
    """The durable queue; its methods may be called from any thread.

    `limit_bytes` bounds the file; dead letters get an eighth of it on top, the write-ahead log about 1 MB. A file that
    is damaged or of an earlier format is renamed to `….corrupt`, and what can be read of it is carried over; of another
    vehicle's nothing is. `notice` says so, else None.
    """

    def __init__(self, path: Path, *, vehicle: str, limit_bytes: int) -> None:
        if limit_bytes < _LEAST_LIMIT_BYTES:
            raise ValueError(f"limit_bytes is {limit_bytes}, expected {_LEAST_LIMIT_BYTES} or more")
        self.path = path
        self._vehicle = vehicle
        self.notice: str | None = None
        self._pages = limit_bytes // _PAGE_BYTES
        self._dead_letter_bytes = limit_bytes // 8
        self._lock = threading.RLock()
        self._db: sqlite3.Connection | None = None
        with suppress(OutboxError):  # a service starts with a full disk, too; `put_many` will say so
            self._run(lambda db: None)

    def put_many(self, uploads: Iterable[Upload]) -> None:
        """Store all or none; when this returns they are on the disk.

        An upload that waits already is left as it is. Raises OutboxFull or OutboxError (nothing was stored), and
        ValueError if another upload waits under the same id.
        """
        uploads = list(uploads)

        def work(db: sqlite3.Connection) -> None:
            for upload in uploads:
                _insert(db, upload)

        self._run(work, reserve=0)

    def pending(self, limit: int, *, after: int = 0) -> list[Pending]:
        """The oldest uploads that wait and have a number above `after`.

        One whose bytes have changed on the disk becomes a dead letter: the cloud shall not take it for the vehicle's.
        """

        def work(db: sqlite3.Connection) -> list[Pending]:
            rows = db.execute(
                "SELECT number, id, channel, payload, checksum FROM upload WHERE number > ? ORDER BY number LIMIT ?",
                (after, limit),
            ).fetchall()
            for row in rows:
                if not _intact(row):
                    self._bury(db, row[0], DAMAGED_ON_DISK)
            return [Pending(*row[:4]) for row in rows if _intact(row)]

        return self._run(work)

    def acknowledge(self, upload_ids: Iterable[str]) -> None:
        """The cloud has these: remove them. Unknown ids are ignored."""
        ids = [(upload_id,) for upload_id in upload_ids]
        self._run(lambda db: db.executemany("DELETE FROM upload WHERE id = ?", ids))

    def refused(self, upload_id: str, reason: str) -> None:
        """The cloud will never take this one: move it to the dead letters, of which the newest are kept."""

        def work(db: sqlite3.Connection) -> None:
            row = db.execute("SELECT number FROM upload WHERE id = ?", (upload_id,)).fetchone()
            if row is not None:
                self._bury(db, row[0], reason)

        self._run(work)

    def dead_letters(self) -> list[tuple[str, str]]:
        """Id and reason of the dead letters, oldest first."""
        return self._run(
            lambda db: db.execute("SELECT id, reason FROM dead_letter ORDER BY number").fetchall()
        )

    def counts(self) -> OutboxCounts:
        """How much there is."""
        return self._run(
            lambda db: OutboxCounts(
                *db.execute(
                    "SELECT (SELECT count(*) FROM upload), (SELECT count(*) FROM dead_letter)"
                ).fetchone()
            )
        )

    def close(self) -> None:
        """Close the file; a later call opens it again."""
        with self._lock:
            if self._db is not None:
                self._db.close()
                self._db = None

    def _run(self, work: Callable[[sqlite3.Connection], T], *, reserve: int | None = None) -> T:
        """Run `work` in one transaction; a damaged file is replaced first. `reserve`: pages beyond the limit."""
        with self._lock:
            try:
                return self._attempt(work, reserve)
            except (sqlite3.Error, OSError) as error:
                if not is_damage(error):
                    raise self._error(error) from error
            try:
                self._start_anew()
                return self._attempt(work, reserve)
            except (sqlite3.Error, OSError) as error:
                raise self._error(error) from error

    def _attempt(self, work: Callable[[sqlite3.Connection], T], reserve: int | None) -> T:
        db = self._db = self._db or self._open()
        # Acknowledging and burying must work in a full outbox, and deletions may need a page more.
        db.execute(
            f"PRAGMA max_page_count = {self._pages + (self._pages // 8 + 16 if reserve is None else reserve)}"
        )
        db.execute("BEGIN IMMEDIATE")
        try:
            result = work(db)
            db.execute("COMMIT")
        except BaseException:
            if db.in_transaction:
                db.execute("ROLLBACK")
            raise
        return result

    def _open(self) -> sqlite3.Connection:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        finish_swap(self.path)
        return _connect(self.path, self._vehicle)

    def _start_anew(self) -> None:
        self.close()
        foreign = _vehicle_named_in(self.path) not in (None, self._vehicle)
        kept = () if foreign else readable_rows(self.path, "upload", _COLUMNS)
        rows = [row for row in kept if _intact(row)]

        def fill(fresh: Path) -> None:
            with closing(_connect(fresh, self._vehicle)) as db:
                db.execute("BEGIN IMMEDIATE")
                db.executemany(
                    f"INSERT OR IGNORE INTO upload ({', '.join(_COLUMNS)}) VALUES (?, ?, ?, ?, ?)", rows
                )
                db.execute("COMMIT")

        damaged = replace_damaged(self.path, fill)
        what = "is of another vehicle" if foreign else "was damaged or of an earlier format"
        self.notice = f"{self.path} {what}: moved to {damaged.name}, {len(rows)} uploads carried over"

    def _bury(self, db: sqlite3.Connection, number: int, reason: str) -> None:
        db.execute(
            "INSERT INTO dead_letter (id, channel, payload, reason)"
            " SELECT id, channel, payload, ? FROM upload WHERE number = ?",
            (reason[:512], number),
        )
        db.execute("DELETE FROM upload WHERE number = ?", (number,))
        kept_bytes = 0
        sizes = db.execute("SELECT number, length(payload) FROM dead_letter ORDER BY number DESC").fetchall()
        for position, (letter, size) in enumerate(sizes):
            kept_bytes += size
            if position >= DEAD_LETTERS or kept_bytes > self._dead_letter_bytes:
                db.execute("DELETE FROM dead_letter WHERE number <= ?", (letter,))
                return

    def _error(self, error: Exception) -> OutboxError:
        full = getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL
        return OutboxFull(f"{self.path}: no room left") if full else OutboxError(f"{self.path}: {error}")


_COLUMNS = ("number", "id", "channel", "payload", "checksum")
_IDENTITY = ("format", "vehicle", "checksum")


def _connect(path: Path, vehicle: str) -> sqlite3.Connection:
    """Open a vehicle's sound file, or make one. Raises sqlite3.DatabaseError with SQLITE_CORRUPT for anything else."""
    if not is_plain(path):
        raise _damage("not a plain file")
    db = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False)
    # A damaged name must reach the checksum, not raise on the way to it.
    db.text_factory = lambda raw: raw.decode("utf-8", "replace")
    try:
        _prepare(db, vehicle)
    except sqlite3.Error as error:
        db.close()
        if is_hindrance(error):
            raise
        raise _damage(str(error)) from error
    return db


def _prepare(db: sqlite3.Connection, vehicle: str) -> None:
    db.execute(f"PRAGMA page_size = {_PAGE_BYTES}")
    db.execute("PRAGMA journal_mode = WAL")
    db.execute("PRAGMA synchronous = FULL")
    db.execute("PRAGMA wal_autocheckpoint = 256")
    db.execute(f"PRAGMA journal_size_limit = {256 * _PAGE_BYTES}")
    db.execute("PRAGMA cell_size_check = ON")
    if not _tables(db):
        _create(db, vehicle)
    db.execute("DELETE FROM upload WHERE number < 0")  # one flipped bit makes a file that can only be read
    (verdict,) = db.execute("PRAGMA integrity_check(1)").fetchone()
    if verdict != "ok":
        raise _damage(verdict)
    with closing(sqlite3.connect(":memory:")) as model:
        _create(model, vehicle)
        if _tables(db) != _tables(model):  # one flipped bit in a name hides a table
            raise _damage("not the tables of an outbox")
    if db.execute(f"SELECT {', '.join(_IDENTITY)} FROM identity").fetchall() != [_identity(vehicle)]:
        raise _damage("not the outbox of this vehicle")


def _create(db: sqlite3.Connection, vehicle: str) -> None:
    db.execute("BEGIN IMMEDIATE")
    for statement in _SCHEMA.split(";")[:-1]:
        db.execute(statement)
    db.execute("INSERT INTO identity VALUES (?, ?, ?)", _identity(vehicle))
    db.execute("COMMIT")


def _identity(vehicle: str) -> tuple[int, str, int]:
    return _FORMAT, vehicle, zlib.crc32(f"{_FORMAT} {vehicle}".encode())


def _vehicle_named_in(path: Path) -> str | None:
    """The vehicle whose outbox this is; None where that cannot be read any more."""
    for row in readable_rows(path, "identity", _IDENTITY):
        if isinstance(row[1], str) and row == _identity(row[1]):
            return row[1]
    return None


def _tables(db: sqlite3.Connection) -> list[tuple[str, str]]:
    return db.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()


def _insert(db: sqlite3.Connection, upload: Upload) -> None:
    taken = db.execute(
        "INSERT INTO upload (id, channel, payload, checksum) VALUES (?, ?, ?, ?) ON CONFLICT (id) DO NOTHING",
        (*upload, _checksum(*upload)),
    )
    if taken.rowcount == 0:
        waiting = db.execute("SELECT channel, payload FROM upload WHERE id = ?", (upload.id,)).fetchone()
        if waiting != (upload.channel, upload.payload):
            raise ValueError(f"upload {upload.id}: another one waits under this id")


def _checksum(upload_id: str, channel: str, payload: bytes) -> int:
    # SQLite checks the structure of its pages, not their contents.
    return zlib.crc32(payload, zlib.crc32(f"{upload_id} {channel}".encode()))


def _intact(row: tuple[Any, ...]) -> bool:
    number, upload_id, channel, payload, checksum = row
    kinds = isinstance(number, int) and isinstance(upload_id, str) and isinstance(channel, str)
    return kinds and isinstance(payload, bytes) and checksum == _checksum(upload_id, channel, payload)


def _damage(text: str) -> sqlite3.DatabaseError:
    error = sqlite3.DatabaseError(text)
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error

"""A vehicle's map on its disk: releases and their blobs in one SQLite file, of which a cut or a kill leaves all that
was there.

    blob      what a release is made of, by the SHA-256 of its bytes; verified when it comes and when it is read
    part      parts of a packed blob that has not come whole yet
    release   roots whose signature held; one is in force, the one before it is kept, one may be on its way
    fact      which ones these are, and the highest version that was ever accepted

A release is put in force by one row in one transaction, when all of it that is wanted is here. Versions go one way: a
root with a version below the highest that was accepted is refused, and so is another root under the same version.
Only the operator goes back (`go_back`), and then the release that was left does not come again by itself. Times of
day play no part in it, so a vehicle with a wrong clock is not led astray.

The file is a copy of what the cloud has: one that is damaged is moved aside, and begun anew.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.road_map.release import Release, release_of
from camber.road_map.release_files import BlobMissing, decoded
from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import check_signature
from camber.schemas.road import ReleaseRoot

T = TypeVar("T")

State = Literal["coming", "here", "left"]
"""Of a release: on its way; was in force; the operator went back from it."""

FORMAT = 1
_PAGE_BYTES = 4096
_WAIT_S = 2.0
_SCHEMA = f"""
BEGIN IMMEDIATE;
CREATE TABLE IF NOT EXISTS blob (sha256 TEXT PRIMARY KEY, data BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS part (
    sha256 TEXT NOT NULL,
    base TEXT NOT NULL,
    number INTEGER NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (sha256, number)
);
CREATE TABLE IF NOT EXISTS release (
    map_version INTEGER PRIMARY KEY,
    region TEXT NOT NULL,
    manifest TEXT NOT NULL,
    root BLOB NOT NULL,
    state TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS fact (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
PRAGMA user_version = {FORMAT};
COMMIT;
"""


class StoreFull(ReleaseError):  # noqa: N818 (the name says what is the matter)
    """The disk, or the limit, is full: nothing was changed."""


class Kept(NamedTuple):
    """A release in the store, and what it is there."""

    map_version: int
    region: str
    manifest_sha256: str
    state: State


class MapStore:
    """The file, for one thread; another thread or process opens its own. A BlobSource of the release in force.

    Every method raises ReleaseError where the file cannot be used, StoreFull where there is no room; then nothing was
    changed. `limit_bytes` bounds the file.
    """

    def __init__(self, path: Path, *, limit_bytes: int = 1 << 40) -> None:
        self.path = path
        self.notice: str | None = None
        self._limit_bytes = limit_bytes
        self._db = self._open()

    # -- as a source of blobs ----------------------------------------------------------------------------------------

    def stamp(self) -> object | None:
        """Version and manifest of the release in force."""
        kept = self.current()
        return None if kept is None else (kept.map_version, kept.manifest_sha256)

    def root(self) -> bytes:
        """The root of the release in force."""
        return self._root_of(self._fact("current"))

    def blob(self, digest: str, size: int | None) -> bytes:
        """The bytes of a blob, verified; BlobMissing where it is not here."""
        row = self._run(lambda db: db.execute("SELECT data FROM blob WHERE sha256 = ?", (digest,)).fetchone())
        if row is None:
            raise BlobMissing(self.name(digest), "blob", "one that has been fetched")
        data = bytes(row[0])
        if size is not None and len(data) != size:
            raise ReleaseError(self.name(digest), "size", f"{size} bytes", actual=str(len(data)))
        if hashlib.sha256(data).hexdigest() != digest:
            raise ReleaseError(self.name(digest), "SHA-256 of the bytes", "the blob's name")
        return data

    def name(self, digest: str | None) -> str:
        """The file, and in it the blob."""
        return str(self.path) if digest is None else f"{self.path}: blob {digest}"

    def to_verify(self, digest: str) -> bool:
        """None: each was verified when it came, and is again whenever it is read."""
        return False

    # -- releases ----------------------------------------------------------------------------------------------------

    def current(self) -> Kept | None:
        """The release in force."""
        return self._kept(self._fact("current"))

    def previous(self) -> Kept | None:
        """The release that was in force before it."""
        return self._kept(self._fact("previous"))

    def coming(self) -> Kept | None:
        """The newest release that is accepted and not yet in force."""
        row = self._run(
            lambda db: db.execute("SELECT max(map_version) FROM release WHERE state = 'coming'").fetchone()
        )
        return self._kept(row[0])

    def releases(self) -> list[Kept]:
        """All that are kept, the newest first."""
        rows = self._run(
            lambda db: db.execute(
                "SELECT map_version, region, manifest, state FROM release ORDER BY map_version DESC"
            ).fetchall()
        )
        return [Kept(*row) for row in rows]

    def highest(self) -> int | None:
        """The highest version that was ever accepted."""
        return self._fact("highest")

    def accept(
        self, data: bytes, *, file: str, region: str | None, public_key: Ed25519PublicKey | None
    ) -> bool:
        """Take in a root; True where its release is new and is now to be fetched.

        ReleaseError, which calls it `file`, where it is not signed with the key, of another region than `region` or
        the one that is in force, of a lower version than the highest accepted, or another one of the same version.
        """
        root = decoded(ReleaseRoot, data, file)
        if public_key is not None:
            check_signature(root, public_key, file)
        here, highest = self.current(), self.highest()
        expected = region or (None if here is None else here.region)
        if expected is not None and root.region != expected:
            raise ReleaseError(file, "region", expected, actual=root.region)
        if highest is not None and root.map_version < highest:
            newest = f"{highest} or more, which has been here already"
            raise ReleaseError(file, "map_version", newest, actual=str(root.map_version))
        known = self._kept(root.map_version)
        if known is not None:
            if known.manifest_sha256 != root.manifest_sha256:
                expected = f"the manifest of version {root.map_version} that was accepted before"
                raise ReleaseError(file, "manifest_sha256", expected, actual=root.manifest_sha256)
            return False

        def work(db: sqlite3.Connection) -> None:
            db.execute("DELETE FROM release WHERE state = 'coming'")
            row = (root.map_version, root.region, root.manifest_sha256, data)
            db.execute("INSERT INTO release VALUES (?, ?, ?, ?, 'coming')", row)
            _set(db, "highest", root.map_version)

        self._run(work, writes=True)
        return True

    def open(self, map_version: int) -> Release:
        """A release that is kept, its manifest verified; BlobMissing where that has not been fetched."""
        data = self._root_of(map_version)
        return release_of(self, decoded(ReleaseRoot, data, self.name(None)), self.name(None))

    def put_in_force(self, map_version: int) -> None:
        """From now on this release; the one in force until now is kept."""

        def work(db: sqlite3.Connection) -> None:
            current = _get(db, "current")
            if current is not None and current != map_version:
                _set(db, "previous", current)
            _set(db, "current", map_version)
            db.execute("UPDATE release SET state = 'here' WHERE map_version = ?", (map_version,))

        self._run(work, writes=True)

    def go_back(self) -> Kept:
        """The release before comes in force again, for the operator; the one that was does not return by itself."""
        current, previous = self.current(), self.previous()
        if previous is None:
            raise ReleaseError(str(self.path), "release", "one before the one in force")

        def work(db: sqlite3.Connection) -> None:
            db.execute("UPDATE release SET state = 'left' WHERE state = 'coming'")
            if current is not None:
                db.execute("UPDATE release SET state = 'left' WHERE map_version = ?", (current.map_version,))
            _set(db, "current", previous.map_version)
            db.execute("DELETE FROM fact WHERE name = 'previous'")
            db.execute("UPDATE release SET state = 'here' WHERE map_version = ?", (previous.map_version,))

        self._run(work, writes=True)
        return previous

    def allow_from(self, map_version: int) -> None:
        """Roots from this version on may come again, for the operator: the cloud's versions have begun anew."""

        def work(db: sqlite3.Connection) -> None:
            current = _get(db, "current")
            db.execute(
                "DELETE FROM release WHERE map_version >= ? AND map_version IS NOT ?", (map_version, current)
            )
            _set(db, "highest", map_version)

        self._run(work, writes=True)

    # -- blobs and parts of them -------------------------------------------------------------------------------------

    def missing(self, digests: Iterable[str]) -> list[str]:
        """Those that are not here, in their order."""
        return self._run(lambda db: [digest for digest in digests if not _has(db, digest)])

    def put(self, digest: str, data: bytes) -> None:
        """Keep a blob; ReleaseError where the bytes are not those of its name."""
        if hashlib.sha256(data).hexdigest() != digest:
            raise ReleaseError(self.name(digest), "SHA-256 of the bytes", "the blob's name")

        def work(db: sqlite3.Connection) -> None:
            db.execute("INSERT OR REPLACE INTO blob VALUES (?, ?)", (digest, data))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

        self._run(work, writes=True)

    def put_part(self, digest: str, base: str | None, number: int, data: bytes) -> None:
        """Keep a part of a packed blob for a fetch that goes on later."""
        row = (digest, base or "", number, data)
        self._run(lambda db: db.execute("INSERT OR REPLACE INTO part VALUES (?, ?, ?, ?)", row), writes=True)

    def parts(self, digest: str, base: str | None) -> list[bytes]:
        """The first parts that are here of a blob packed against `base`."""
        rows = self._run(
            lambda db: db.execute(
                "SELECT number, data FROM part WHERE sha256 = ? AND base = ? ORDER BY number",
                (digest, base or ""),
            ).fetchall()
        )
        return [bytes(data) for place, (number, data) in enumerate(rows) if number == place]

    def drop(self, digest: str) -> None:
        """Forget a blob, which proved to be damaged, and its parts: it is fetched again."""

        def work(db: sqlite3.Connection) -> None:
            db.execute("DELETE FROM blob WHERE sha256 = ?", (digest,))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

        self._run(work, writes=True)

    def collect(self, in_use: Collection[int] = (), keep: Callable[[Release], set[str]] | None = None) -> int:
        """Delete what no release that is kept needs; returns how many blobs went.

        Kept are those in force, before it, and on its way, and those `in_use` by a reader; of a release `keep` says
        which tiles, all without it. What the operator left stays known by its root, without blobs.
        """
        kept = [kept for kept in (self.current(), self.previous(), self.coming()) if kept is not None]
        versions = {kept.map_version for kept in kept} | set(in_use)
        needed: set[str] = set()
        for version in versions:
            with suppress(BlobMissing):
                release = self.open(version)
                needed |= {release.root.manifest_sha256}
                needed |= release.hashes() if keep is None else keep(release)

        def work(db: sqlite3.Connection) -> int:
            here = {row[0] for row in db.execute("SELECT sha256 FROM blob")}
            gone = [(digest,) for digest in here - needed]
            db.executemany("DELETE FROM blob WHERE sha256 = ?", gone)
            db.execute("DELETE FROM part WHERE sha256 IN (SELECT sha256 FROM blob)")
            marks = ", ".join("?" * len(versions))
            db.execute(
                f"DELETE FROM release WHERE state = 'here' AND map_version NOT IN ({marks})", [*versions]
            )
            return len(gone)

        gone = self._run(work, writes=True)
        if gone:
            self._run(lambda db: db.execute("PRAGMA incremental_vacuum").fetchall())
        return gone

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    # -- the file ----------------------------------------------------------------------------------------------------

    def _open(self) -> sqlite3.Connection:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                return self._connect()
            except sqlite3.DatabaseError as error:
                if getattr(error, "sqlite_errorcode", 0) & 0xFF not in (
                    sqlite3.SQLITE_CORRUPT,
                    sqlite3.SQLITE_NOTADB,
                ):
                    raise
            aside = self.path.with_name(f"{self.path.name}.corrupt")
            self.path.replace(aside)
            for ending in ("-wal", "-shm"):
                self.path.with_name(self.path.name + ending).unlink(missing_ok=True)
            self.notice = f"{self.path} was damaged: moved to {aside.name}; the map is fetched again"
            return self._connect()
        except (sqlite3.Error, OSError) as error:
            raise self._error(error) from None

    def _connect(self) -> sqlite3.Connection:
        db = sqlite3.connect(self.path, timeout=_WAIT_S, isolation_level=None)
        try:
            db.execute(f"PRAGMA page_size = {_PAGE_BYTES}")
            db.execute("PRAGMA auto_vacuum = INCREMENTAL")
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")
            db.execute("PRAGMA wal_autocheckpoint = 256")
            db.execute(f"PRAGMA journal_size_limit = {256 * _PAGE_BYTES}")
            db.execute("PRAGMA cell_size_check = ON")
            db.execute(f"PRAGMA max_page_count = {max(self._limit_bytes // _PAGE_BYTES, 16)}")
            (found,) = db.execute("PRAGMA user_version").fetchone()
            if found > FORMAT:
                expected = f"at most {FORMAT}: made by a later version of this program"
                raise ReleaseError(str(self.path), "format", expected, actual=str(found))
            if found < FORMAT:
                db.executescript(_SCHEMA)
        except BaseException:
            db.close()
            raise
        return db

    def _run(self, work: Callable[[sqlite3.Connection], T], *, writes: bool = False) -> T:
        """`work` in one transaction where it writes; all of it or nothing."""
        try:
            if not writes:
                return work(self._db)
            self._db.execute("BEGIN IMMEDIATE")
            try:
                result = work(self._db)
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
            return result
        except sqlite3.Error as error:
            raise self._error(error) from None

    def _error(self, error: Exception) -> ReleaseError:
        if getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL:
            return StoreFull(str(self.path), "store", "room on the disk and below the limit")
        return ReleaseError(str(self.path), "store", f"a file that can be used ({error})")

    def _fact(self, name: str) -> int | None:
        return self._run(lambda db: _get(db, name))

    def _kept(self, map_version: int | None) -> Kept | None:
        row = self._run(
            lambda db: db.execute(
                "SELECT map_version, region, manifest, state FROM release WHERE map_version = ?",
                (map_version,),
            ).fetchone()
        )
        return None if row is None else Kept(*row)

    def _root_of(self, map_version: int | None) -> bytes:
        row = self._run(
            lambda db: db.execute("SELECT root FROM release WHERE map_version = ?", (map_version,)).fetchone()
        )
        if row is None:
            raise ReleaseError(
                str(self.path), "release", "one that has been fetched", actual=str(map_version)
            )
        return bytes(row[0])


def _get(db: sqlite3.Connection, name: str) -> int | None:
    row = db.execute("SELECT value FROM fact WHERE name = ?", (name,)).fetchone()
    return None if row is None else int(row[0])


def _set(db: sqlite3.Connection, name: str, value: int) -> None:
    db.execute("INSERT OR REPLACE INTO fact VALUES (?, ?)", (name, value))


def _has(db: sqlite3.Connection, digest: str) -> bool:
    return db.execute("SELECT 1 FROM blob WHERE sha256 = ?", (digest,)).fetchone() is not None

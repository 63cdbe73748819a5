"""A vehicle's store: releases and their blobs in one SQLite file, safe against power cuts.

    blob      manifests and tiles by SHA-256; verified on arrival and when read
    part      parts of a compressed blob that has not arrived completely
    release   roots with a valid signature: the active one, the previous one, possibly one being downloaded
    fact      versions of the active and the previous release, and the highest version ever accepted

A release becomes active in one transaction, once all its required blobs are here. Versions only increase: a root with a
version below the highest accepted is refused, and so is another root of the same version. Only the operator goes back
(`go_back`); the release that was left does not return by itself. The time of day is not used, so a wrong clock does no
harm. The file is a copy of what the cloud has: a damaged one is renamed and a new one started.
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
from camber.road_map.release_files import BlobMissingError, decoded
from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import check_signature
from camber.schemas.road import ReleaseRoot

T = TypeVar("T")

State = Literal["coming", "here", "left"]
"""State of a release: being downloaded; was or is active; left by the operator."""

FORMAT = 1  # version of the tables below
_PAGE_BYTES = 4096  # page size of SQLite and of common file systems
_WAIT_S = 2.0  # chosen: time to wait for another writer; transactions take milliseconds
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


class StoreFullError(ReleaseError):
    """Disk or limit is full; nothing was changed."""


class StoredRelease(NamedTuple):
    """A release in the store and its state."""

    map_version: int
    region: str
    manifest_sha256: str
    state: State


class MapStore:
    """The store for one thread; other threads and processes open their own. A BlobSource of the active release.

    Every method raises ReleaseError if the file cannot be used, StoreFullError without space; nothing is changed then.
    `limit_bytes` bounds the file. `read_only`: for inspection; a damaged file is an error.
    """

    def __init__(self, path: Path, *, limit_bytes: int = 1 << 40, read_only: bool = False) -> None:
        self.path = path
        self.notice: str | None = None
        self._limit_bytes = limit_bytes
        self._read_only = read_only
        self._db = self._open()

    # -- as a source of blobs ----------------------------------------------------------------------------------------

    def stamp(self) -> object | None:
        """Return version and manifest of the active release."""
        kept = self.current()
        return None if kept is None else (kept.map_version, kept.manifest_sha256)

    def root(self) -> bytes:
        """Return the root of the active release."""
        return self._root_of(self._fact("current"))

    def blob(self, digest: str, size: int | None) -> bytes:
        """Return the bytes of a blob, verified; BlobMissingError if it has not been downloaded."""
        row = self._run(lambda db: db.execute("SELECT data FROM blob WHERE sha256 = ?", (digest,)).fetchone())
        if row is None:
            raise BlobMissingError(self.name(digest), "blob", "one that has been fetched")
        data = bytes(row[0])
        if size is not None and len(data) != size:
            raise ReleaseError(self.name(digest), "size", f"{size} bytes", actual=str(len(data)))
        if hashlib.sha256(data).hexdigest() != digest:
            raise ReleaseError(self.name(digest), "SHA-256 of the bytes", "the blob's name")
        return data

    def name(self, digest: str | None) -> str:
        """Return the name of the file, or of a blob in it."""
        return str(self.path) if digest is None else f"{self.path}: blob {digest}"

    def to_verify(self, digest: str) -> bool:
        """No blob: each was verified on arrival, and is again whenever it is read."""
        return False

    # -- releases ----------------------------------------------------------------------------------------------------

    def current(self) -> StoredRelease | None:
        """Return the active release."""
        return self._kept(self._fact("current"))

    def previous(self) -> StoredRelease | None:
        """Return the release that was active before."""
        return self._kept(self._fact("previous"))

    def coming(self) -> StoredRelease | None:
        """Return the newest release that is accepted and not yet active."""
        row = self._run(
            lambda db: db.execute("SELECT max(map_version) FROM release WHERE state = 'coming'").fetchone()
        )
        return self._kept(row[0])

    def releases(self) -> list[StoredRelease]:
        """Return all releases, the newest first."""
        rows = self._run(
            lambda db: db.execute(
                "SELECT map_version, region, manifest, state FROM release ORDER BY map_version DESC"
            ).fetchall()
        )
        return [StoredRelease(*row) for row in rows]

    def highest(self) -> int | None:
        """Return the highest version ever accepted."""
        return self._fact("highest")

    def accept(
        self, data: bytes, *, file: str, region: str | None, public_key: Ed25519PublicKey | None
    ) -> bool:
        """Accept a root; True if its release is new and must be downloaded.

        Raises ReleaseError, with the name `file`, for a root that is not signed with the key, is of another region than
        `region` or the active release, has a version below the highest accepted, or differs from one of its version.
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
        """Open a release of the store and verify its manifest; BlobMissingError if that has not been downloaded."""
        data = self._root_of(map_version)
        return release_of(self, decoded(ReleaseRoot, data, self.name(None)), self.name(None))

    def put_in_force(self, map_version: int) -> None:
        """Make this release active; the one before is kept."""

        def work(db: sqlite3.Connection) -> None:
            current = _get(db, "current")
            if current is not None and current != map_version:
                _set(db, "previous", current)
            _set(db, "current", map_version)
            db.execute("UPDATE release SET state = 'here' WHERE map_version = ?", (map_version,))

        self._run(work, writes=True)

    def go_back(self) -> StoredRelease:
        """Return to the previous release, for the operator; the one left does not return by itself."""
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
        """Accept roots from this version on again, for the operator, after the cloud's versions started anew."""

        def work(db: sqlite3.Connection) -> None:
            current = _get(db, "current")
            db.execute(
                "DELETE FROM release WHERE map_version >= ? AND map_version IS NOT ?", (map_version, current)
            )
            _set(db, "highest", map_version)

        self._run(work, writes=True)

    # -- blobs and parts of them -------------------------------------------------------------------------------------

    def missing(self, digests: Iterable[str]) -> list[str]:
        """Return the missing ones, in their order."""
        return self._run(lambda db: [digest for digest in digests if not _has(db, digest)])

    def put(self, digest: str, data: bytes) -> None:
        """Store a blob; ReleaseError if its hash is wrong."""
        if hashlib.sha256(data).hexdigest() != digest:
            raise ReleaseError(self.name(digest), "SHA-256 of the bytes", "the blob's name")

        def work(db: sqlite3.Connection) -> None:
            db.execute("INSERT OR REPLACE INTO blob VALUES (?, ?)", (digest, data))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

        self._run(work, writes=True)

    def put_part(self, digest: str, base: str | None, number: int, data: bytes) -> None:
        """Store a part of a compressed blob for a download that continues later."""
        row = (digest, base or "", number, data)
        self._run(lambda db: db.execute("INSERT OR REPLACE INTO part VALUES (?, ?, ?, ?)", row), writes=True)

    def parts(self, digest: str, base: str | None) -> list[bytes]:
        """Return the leading parts of a blob compressed against `base`."""
        rows = self._run(
            lambda db: db.execute(
                "SELECT number, data FROM part WHERE sha256 = ? AND base = ? ORDER BY number",
                (digest, base or ""),
            ).fetchall()
        )
        return [bytes(data) for place, (number, data) in enumerate(rows) if number == place]

    def drop(self, digest: str) -> None:
        """Delete a damaged blob and its parts, so that it is downloaded again."""

        def work(db: sqlite3.Connection) -> None:
            db.execute("DELETE FROM blob WHERE sha256 = ?", (digest,))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

        self._run(work, writes=True)

    def collect(self, in_use: Collection[int] = (), keep: Callable[[Release], set[str]] | None = None) -> int:
        """Delete the blobs that no kept release needs; returns their number.

        Kept are the active release, the previous one, the one being downloaded and those `in_use` by a reader; `keep`
        returns the tiles to keep of a release, by default all. Of releases left by the operator only the root remains.
        """
        kept = [kept for kept in (self.current(), self.previous(), self.coming()) if kept is not None]
        versions = {kept.map_version for kept in kept} | set(in_use)
        needed: set[str] = set()
        for version in versions:
            with suppress(BlobMissingError):
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
            if self._read_only:
                uri = f"{self.path.resolve().as_uri()}?mode=ro"
                return sqlite3.connect(uri, uri=True, timeout=_WAIT_S)
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                return self._connect()
            except sqlite3.DatabaseError as error:
                if getattr(error, "sqlite_errorcode", 0) & 0xFF not in (
                    sqlite3.SQLITE_CORRUPT,
                    sqlite3.SQLITE_NOTADB,
                ):
                    raise
            renamed = self.path.with_name(f"{self.path.name}.corrupt")
            self.path.replace(renamed)
            for ending in ("-wal", "-shm"):
                self.path.with_name(self.path.name + ending).unlink(missing_ok=True)
            self.notice = f"{self.path} was damaged: renamed to {renamed.name}; the map is downloaded again"
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
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version > FORMAT:
                expected = f"at most {FORMAT}: made by a later version of this program"
                raise ReleaseError(str(self.path), "format", expected, actual=str(version))
            if version < FORMAT:
                db.executescript(_SCHEMA)
        except BaseException:
            db.close()
            raise
        return db

    def _run(self, work: Callable[[sqlite3.Connection], T], *, writes: bool = False) -> T:
        """Run `work`, in one transaction if it writes."""
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
            return StoreFullError(str(self.path), "store", "free space on the disk and below the limit")
        return ReleaseError(str(self.path), "store", f"a readable store of the map ({error})")

    def _fact(self, name: str) -> int | None:
        return self._run(lambda db: _get(db, name))

    def _kept(self, map_version: int | None) -> StoredRelease | None:
        row = self._run(
            lambda db: db.execute(
                "SELECT map_version, region, manifest, state FROM release WHERE map_version = ?",
                (map_version,),
            ).fetchone()
        )
        return None if row is None else StoredRelease(*row)

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

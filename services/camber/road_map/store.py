"""A vehicle's store: releases and their blobs in one SQLite file, safe against power cuts.

    blob      manifests and tiles by SHA-256; verified on arrival and when read
    part      parts of a compressed blob that has not arrived completely
    release   roots with a valid signature: the active one, the previous one, possibly one being downloaded
    fact      versions of the active and the previous release, and the highest version ever accepted; `checksum` of
              all releases and facts, since format 2

A release becomes active in one transaction, once all its required blobs are here. Versions only increase: a root with a
version below the highest accepted is refused, and so is another root of the same version. Only the operator goes back
(`go_back`); the release that was left does not return by itself. The time of day is not used, so a wrong clock does no
harm. The file is a copy of what the cloud has: a damaged one is renamed and a new one started.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

from camber.road_map.release import Release, release_of
from camber.road_map.release_files import BlobMissingError, decoded, verified
from camber.road_map.release_order import check_order
from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import TrustedKey, check_signature
from camber.schemas.plain_file import check_plain_file
from camber.schemas.road import ReleaseRoot

State = Literal["coming", "here", "left"]
"""State of a release: being downloaded; was or is active; left by the operator."""

FORMAT = 2  # version of the tables below; 1 had no checksum and is given one
_PAGE_BYTES = 4096  # page size of SQLite and of common file systems
_WAIT_S = 2.0  # chosen: time to wait for another writer; transactions take milliseconds
_SCHEMA = """
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
"""
_CONTENTS = (  # as bytes: what is no text any more must reach the checksum
    "SELECT map_version, CAST(region AS BLOB), CAST(manifest AS BLOB), root, CAST(state AS BLOB) FROM release"
    " ORDER BY map_version",
    "SELECT CAST(name AS BLOB), value FROM fact WHERE name != 'checksum' ORDER BY CAST(name AS BLOB)",
)
_RELEASES = "SELECT map_version, region, manifest, state FROM release"
_SET_FACT = "INSERT OR REPLACE INTO fact VALUES (?, ?)"
_SET_STATE = "UPDATE release SET state = ? WHERE map_version = ?"


class StoreFullError(ReleaseError):
    """Disk or limit is full; nothing was changed."""


class StoredRelease(NamedTuple):
    """A release in the store and its state."""

    map_version: int
    region: str
    manifest_sha256: str
    state: State


class MapStore:
    """The store for one thread at a time; others and other processes open their own. BlobSource of the active release.

    Every method raises ReleaseError if the file cannot be used, StoreFullError without space; nothing is changed then.
    `limit_bytes` bounds the file. `read_only`: for inspection; a damaged file is an error.
    """

    def __init__(self, path: Path, *, limit_bytes: int = 1 << 40, read_only: bool = False) -> None:
        self.path = path
        self.notice: str | None = None
        self._limit_bytes = limit_bytes
        with self._errors():
            self._db = self._opened_read_only() if read_only else self._opened()

    def stamp(self) -> object | None:
        """Return version and manifest of the active release."""
        kept = self.current()
        return None if kept is None else (kept.map_version, kept.manifest_sha256)

    def root(self) -> bytes:
        """Return the root of the active release."""
        return self._root_of(self._fact("current"))

    def blob(self, digest: str, size: int | None) -> bytes:
        """Return the bytes of a blob, verified; BlobMissingError if it has not been downloaded."""
        rows = self._select("SELECT data FROM blob WHERE sha256 = ?", digest)
        if not rows:
            raise BlobMissingError(self.name(digest), "blob", "one that has been fetched")
        return verified(bytes(rows[0][0]), self.name(digest), digest=digest, size=size, named="blob")

    def name(self, digest: str | None) -> str:
        """Return the name of the file, or of a blob in it."""
        return str(self.path) if digest is None else f"{self.path}: blob {digest}"

    def to_verify(self, digest: str) -> bool:
        """No blob: each was verified on arrival, and is again whenever it is read."""
        return False

    def current(self) -> StoredRelease | None:
        """Return the active release."""
        return self._release(self._fact("current"))

    def previous(self) -> StoredRelease | None:
        """Return the release that was active before."""
        return self._release(self._fact("previous"))

    def coming(self) -> StoredRelease | None:
        """Return the newest release that is accepted and not yet active."""
        return self._release(
            self._select("SELECT max(map_version) FROM release WHERE state = 'coming'")[0][0]
        )

    def releases(self) -> list[StoredRelease]:
        """Return all releases, the newest first."""
        return [StoredRelease(*row) for row in self._select(f"{_RELEASES} ORDER BY map_version DESC")]

    def highest(self) -> int | None:
        """Return the highest version ever accepted."""
        return self._fact("highest")

    def accept(
        self,
        data: bytes,
        *,
        file: str,
        region: str | None,
        public_key: TrustedKey | None,
        may_be_old: bool = False,
    ) -> bool:
        """Accept a root; True if its release is new and must be downloaded.

        Raises ReleaseError, with the name `file`, for a root that is not signed with the key, is of another region than
        `region` or the active release, has a version below the highest accepted (False if it `may_be_old`), or differs
        from one of its version.
        """
        root, highest = decoded(ReleaseRoot, data, file), self.highest()
        if may_be_old and highest is not None and root.map_version < highest:
            return False
        if public_key is not None:
            check_signature(root, public_key, file)
        current = self.current()
        known = self._release(root.map_version)
        check_order(
            root,
            file,
            region=region or (None if current is None else current.region),
            highest=highest,
            manifest_sha256=None if known is None else known.manifest_sha256,
        )
        if known is not None:
            return False
        with self._writing() as db:
            db.execute("DELETE FROM release WHERE state = 'coming'")
            row = (root.map_version, root.region, root.manifest_sha256, data)
            db.execute("INSERT INTO release VALUES (?, ?, ?, ?, 'coming')", row)
            db.execute(_SET_FACT, ("highest", root.map_version))
        return True

    def open(self, map_version: int) -> Release:
        """Open a release of the store and verify its manifest; BlobMissingError if that has not been downloaded."""
        data = self._root_of(map_version)
        return release_of(self, decoded(ReleaseRoot, data, self.name(None)), self.name(None))

    def put_in_force(self, map_version: int) -> None:
        """Make this release active; the one before is kept."""
        with self._writing() as db:
            db.execute(
                "INSERT OR REPLACE INTO fact SELECT 'previous', value FROM fact"
                " WHERE name = 'current' AND value != ?",
                (map_version,),
            )
            db.execute(_SET_FACT, ("current", map_version))
            db.execute(_SET_STATE, ("here", map_version))

    def go_back(self) -> StoredRelease:
        """Return to the previous release, for the operator; the one left does not return by itself."""
        previous = self.previous()
        if previous is None:
            raise ReleaseError(str(self.path), "release", "one before the one in force")
        with self._writing() as db:
            db.execute(
                "UPDATE release SET state = 'left' WHERE state = 'coming'"
                " OR map_version = (SELECT value FROM fact WHERE name = 'current')"
            )
            db.execute(_SET_FACT, ("current", previous.map_version))
            db.execute("DELETE FROM fact WHERE name = 'previous'")
            db.execute(_SET_STATE, ("here", previous.map_version))
        return previous

    def allow_from(self, map_version: int) -> None:
        """Accept roots from this version on again, for the operator, after the cloud's versions started anew."""
        with self._writing() as db:
            db.execute(
                "DELETE FROM release WHERE map_version >= ?"
                " AND map_version IS NOT (SELECT value FROM fact WHERE name = 'current')",
                (map_version,),
            )
            db.execute(_SET_FACT, ("highest", map_version))

    def missing(self, digests: Iterable[str]) -> list[str]:
        """Return the missing ones, in their order."""
        return [each for each in digests if not self._select("SELECT 1 FROM blob WHERE sha256 = ?", each)]

    def put(self, digest: str, data: bytes) -> None:
        """Store a blob; ReleaseError if its hash is wrong."""
        verified(data, self.name(digest), digest=digest, named="blob")
        with self._writing() as db:
            db.execute("INSERT OR REPLACE INTO blob VALUES (?, ?)", (digest, data))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

    def put_part(self, digest: str, base: str | None, number: int, data: bytes) -> None:
        """Store a part of a compressed blob for a download that continues later."""
        with self._writing() as db:
            db.execute("INSERT OR REPLACE INTO part VALUES (?, ?, ?, ?)", (digest, base or "", number, data))

    def parts(self, digest: str, base: str | None) -> list[bytes]:
        """Return the leading parts of a blob compressed against `base`."""
        query = "SELECT number, data FROM part WHERE sha256 = ? AND base = ? ORDER BY number"
        rows = self._select(query, digest, base or "")
        return [bytes(data) for place, (number, data) in enumerate(rows) if number == place]

    def drop(self, digest: str) -> None:
        """Delete a damaged blob and its parts, so that it is downloaded again."""
        with self._writing() as db:
            db.execute("DELETE FROM blob WHERE sha256 = ?", (digest,))
            db.execute("DELETE FROM part WHERE sha256 = ?", (digest,))

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
        with self._writing() as db:
            unneeded = {row[0] for row in db.execute("SELECT sha256 FROM blob")} - needed
            db.executemany("DELETE FROM blob WHERE sha256 = ?", [(digest,) for digest in unneeded])
            db.execute("DELETE FROM part WHERE sha256 IN (SELECT sha256 FROM blob)")
            marks = ", ".join("?" * len(versions))
            query = f"DELETE FROM release WHERE state = 'here' AND map_version NOT IN ({marks})"
            db.execute(query, [*versions])
        if unneeded:
            self._select("PRAGMA incremental_vacuum")
        return len(unneeded)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def _opened_read_only(self) -> sqlite3.Connection:
        check_plain_file(self.path)
        return sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True, timeout=_WAIT_S)

    def _opened(self) -> sqlite3.Connection:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        check_plain_file(self.path)
        try:
            return self._connect()
        except sqlite3.DatabaseError as error:
            if _code_of(error) not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise
        renamed = self.path.with_name(f"{self.path.name}.corrupt")
        self.path.replace(renamed)
        for ending in ("-wal", "-shm"):
            self.path.with_name(self.path.name + ending).unlink(missing_ok=True)
        self.notice = f"{self.path} was damaged: renamed to {renamed.name}; the map is downloaded again"
        return self._connect()

    def _connect(self) -> sqlite3.Connection:
        db = sqlite3.connect(self.path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False)
        try:
            for setting in (
                f"page_size = {_PAGE_BYTES}",
                "auto_vacuum = INCREMENTAL",
                "journal_mode = WAL",
                "synchronous = FULL",
                "wal_autocheckpoint = 256",
                f"journal_size_limit = {256 * _PAGE_BYTES}",
                "cell_size_check = ON",
                f"max_page_count = {max(self._limit_bytes // _PAGE_BYTES, 16)}",
            ):
                db.execute(f"PRAGMA {setting}")
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version > FORMAT:
                expected = f"at most {FORMAT}: made by a later version of this program"
                raise ReleaseError(str(self.path), "format", expected, actual=str(version))
            if version < FORMAT:
                db.executescript(_SCHEMA)
                db.execute(_SET_FACT, ("checksum", _checksum(db)))
                db.execute(f"PRAGMA user_version = {FORMAT}")
                db.execute("COMMIT")
            _check_contents(db)
        except BaseException:
            db.close()
            raise
        return db

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            if _code_of(error) == sqlite3.SQLITE_FULL:
                expected = "free space on the disk and below the limit"
                raise StoreFullError(str(self.path), "store", expected) from None
            raise ReleaseError(str(self.path), "store", f"a readable store of the map ({error})") from None

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction."""
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute(_SET_FACT, ("checksum", _checksum(self._db)))
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _select(self, query: str, *parameters: object) -> list[Any]:
        with self._errors():
            return self._db.execute(query, parameters).fetchall()

    def _fact(self, name: str) -> int | None:
        rows = self._select("SELECT value FROM fact WHERE name = ?", name)
        return int(rows[0][0]) if rows else None

    def _release(self, map_version: int | None) -> StoredRelease | None:
        rows = self._select(f"{_RELEASES} WHERE map_version = ?", map_version)
        return StoredRelease(*rows[0]) if rows else None

    def _root_of(self, map_version: int | None) -> bytes:
        rows = self._select("SELECT root FROM release WHERE map_version = ?", map_version)
        if not rows:
            expected = "one that has been fetched"
            raise ReleaseError(str(self.path), "release", expected, actual=str(map_version))
        return bytes(rows[0][0])


def _checksum(db: sqlite3.Connection) -> int:
    return zlib.crc32(repr([db.execute(query).fetchall() for query in _CONTENTS]).encode())


def _check_contents(db: sqlite3.Connection) -> None:
    """Raise sqlite3.DatabaseError with SQLITE_CORRUPT where releases and facts are not those that were written.

    Blobs are verified when they are read.
    """
    problem = None
    try:
        (verdict,) = db.execute("PRAGMA integrity_check(fact)").fetchone()
        stored = db.execute("SELECT value FROM fact WHERE name = 'checksum'").fetchall()
        if verdict != "ok" or stored != [(_checksum(db),)] or _tables_of(db) != _EXPECTED_TABLES:
            problem = "checksum of releases and facts"
    except sqlite3.OperationalError as error:  # a name in the schema that was changed
        if _code_of(error) != sqlite3.SQLITE_ERROR:
            raise
        problem = str(error)
    if problem is not None:
        damage = sqlite3.DatabaseError(problem)
        damage.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
        raise damage


def _tables_of(db: sqlite3.Connection) -> list[tuple[str, str]]:
    return db.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()


def _expected_tables() -> list[tuple[str, str]]:
    with closing(sqlite3.connect(":memory:")) as model:
        model.executescript(_SCHEMA)
        return _tables_of(model)


_EXPECTED_TABLES = _expected_tables()


def _code_of(error: Exception) -> int:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF

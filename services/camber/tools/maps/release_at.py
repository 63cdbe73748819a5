"""The release that a path holds: a folder, or a vehicle's store, which is only read."""

from __future__ import annotations

import hashlib
import sqlite3
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.road_map.release import Release, open_release
from camber.road_map.release_files import BlobMissing
from camber.road_map.road_columns import ReleaseError

_MAGIC = b"SQLite format 3\x00"


def release_at(path: Path, public_key: Ed25519PublicKey | None = None) -> Release:
    """The release in a folder, or the one in force in a store; ReleaseError where there is none."""
    return open_release(path if path.is_dir() else _StoreToRead(path), public_key=public_key)


def is_release(path: Path) -> bool:
    """Is this a folder, or a store?"""
    if path.is_dir():
        return True
    with path.open("rb") as stream:
        return stream.read(len(_MAGIC)) == _MAGIC


class _StoreToRead:
    """A store of `camber.road_map.store` as it is: that one would move a damaged file aside to begin anew."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def stamp(self) -> object | None:
        return None

    def root(self) -> bytes:
        return self._one(
            "SELECT root FROM release JOIN fact ON fact.value = map_version WHERE fact.name = 'current'",
            (),
            ReleaseError(str(self._path), "release", "one in force"),
        )

    def blob(self, digest: str, size: int | None) -> bytes:
        missing = BlobMissing(self.name(digest), "blob", "one that has been fetched")
        data = self._one("SELECT data FROM blob WHERE sha256 = ?", (digest,), missing)
        if hashlib.sha256(data).hexdigest() != digest or size not in (None, len(data)):
            raise ReleaseError(self.name(digest), "SHA-256 of the bytes", "the blob's name")
        return data

    def name(self, digest: str | None) -> str:
        return str(self._path) if digest is None else f"{self._path}: blob {digest}"

    def to_verify(self, digest: str) -> bool:
        return True

    def _one(self, query: str, values: tuple[str, ...], otherwise: ReleaseError) -> bytes:
        try:
            database = sqlite3.connect(f"{self._path.resolve().as_uri()}?mode=ro", uri=True)
            try:
                row = database.execute(query, values).fetchone()
            finally:
                database.close()
        except sqlite3.Error as error:
            raise ReleaseError(str(self._path), "file", f"a store of the map ({error})") from None
        if row is None:
            raise otherwise
        return bytes(row[0])

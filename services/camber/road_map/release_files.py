"""Files of a release: bounded reads, verified blobs, atomic writes."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from camber.road_map.road_columns import ReleaseError
from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.plain_file import read_plain_file

ROOT_NAME = "root.msgpack"
MAX_ROOT_BYTES = 1 << 14  # chosen: a root has about 300 bytes
MAX_BLOB_BYTES = 64 << 20  # chosen: bounds memory; `write_release` makes tiles of a few hundred kB
PART_BYTES = 250_000  # with the header below the 256 kB of a reply (docs/conventions, delivery)

MessageT = TypeVar("MessageT", bound=Message)


class BlobSource(Protocol):
    """Source of a release's bytes, a folder or a vehicle's store; raises ReleaseError for what cannot be read."""

    def stamp(self) -> object | None:
        """Return a cheap value that differs after the root has changed; None without a root."""

    def root(self) -> bytes:
        """Return the bytes of the active root."""

    def blob(self, digest: str, size: int | None) -> bytes:
        """Return the bytes of a blob, verified against its hash and, if known, its size."""

    def name(self, digest: str | None) -> str:
        """Return the name of a blob, or for None of the root, for error texts."""

    def to_verify(self, digest: str) -> bool:
        """Whether this blob must be verified before its release is used; not if it was verified on arrival."""


class BlobMissingError(ReleaseError):
    """A blob of the manifest has not been downloaded; its contents are unknown."""


class ReleaseFolder:
    """The folder of a release as BlobSource."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def stamp(self) -> object | None:
        """Return inode, time and size of the root."""
        try:
            status = (self.folder / ROOT_NAME).stat()
        except (OSError, ValueError):
            return None
        return status.st_ino, status.st_mtime_ns, status.st_size

    def root(self) -> bytes:
        """Return the bytes of the root file."""
        return read_file(self.folder / ROOT_NAME, MAX_ROOT_BYTES)

    def blob(self, digest: str, size: int | None) -> bytes:
        """Return the bytes of a blob's file, verified."""
        path = blob_path(self.folder, digest)
        data = read_file(path, MAX_BLOB_BYTES if size is None else min(size, MAX_BLOB_BYTES))
        return verified(data, str(path), digest=digest, size=size, named="file")

    def name(self, digest: str | None) -> str:
        """Return the path of a file."""
        return str(self.folder / ROOT_NAME if digest is None else blob_path(self.folder, digest))

    def to_verify(self, digest: str) -> bool:
        """Every file of a folder."""
        return True


def decoded(cls: type[MessageT], data: bytes, file: str) -> MessageT:
    """Decode a file as a message of type `cls`; ReleaseError if it is none."""
    try:
        return decode(cls, data).message
    except DecodeError as error:
        why = " ".join(str(error).split())
        raise ReleaseError(file, cls.__name__, f"a message of {cls.schema_name()} ({why})") from None


def verified(data: bytes, name: str, *, digest: str, size: int | None = None, named: str) -> bytes:
    """Return the bytes of the `named` (file, blob) `name`; ReleaseError for another hash or, if known, another size."""
    if size is not None and len(data) != size:
        raise ReleaseError(name, "size", f"{size} bytes", actual=str(len(data)))
    if hashlib.sha256(data).hexdigest() != digest:
        raise ReleaseError(name, "SHA-256 of the bytes", f"the {named}'s name")
    return data


def read_file(path: Path, limit: int) -> bytes:
    """Read a plain file of at most `limit` bytes."""
    try:
        return read_plain_file(path, limit)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        expected = f"a plain, readable file of at most {limit} bytes ({reason})"
        raise ReleaseError(str(path), "file", expected) from None


def blob_path(folder: Path, digest: str) -> Path:
    """Return the path of a blob in the folder of a release."""
    return folder / "blobs" / digest[:2] / digest


def encoded(message: Message, name: str) -> bytes:
    """Encode a message; ReleaseError if it is too large for a file."""
    try:
        return encode(message)
    except ValueError as error:
        raise ReleaseError(name, "size", str(error)) from None


def write_blob(folder: Path, digest: str, data: bytes) -> None:
    """Write a blob unless it exists; a damaged one is replaced."""
    try:
        ReleaseFolder(folder).blob(digest, len(data))
    except ReleaseError:
        write_file(blob_path(folder, digest), data)


def write_file(path: Path, data: bytes) -> None:
    """Replace a file atomically: temporary name, fsync, rename."""
    with replaced_file(path) as stream:
        stream.write(data)


@contextlib.contextmanager
def replaced_file(path: Path) -> Iterator[BinaryIO]:
    """A stream whose bytes replace a file atomically at the end, and not at all after an exception."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:16]}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fchmod(stream.fileno(), 0o644)  # mkstemp restricts it to one user, but services run as others
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """fsync a folder, so that the names in it survive a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

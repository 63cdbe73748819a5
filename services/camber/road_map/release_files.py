"""Files of a release: plain files read up to a limit, blobs verified, and all written at once or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from pathlib import Path
from typing import Protocol, TypeVar

from camber.road_map.road_columns import ReleaseError
from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode

ROOT_NAME = "root.msgpack"
MAX_ROOT_BYTES = 1 << 14
MAX_BLOB_BYTES = 64 << 20
PART_BYTES = 250_000
"""Of a blob in one reply: with the header below the 256 kB that a reply may have."""

MessageT = TypeVar("MessageT", bound=Message)


class BlobSource(Protocol):
    """Where the bytes of releases are: a folder, or a vehicle's store. What cannot be read raises ReleaseError."""

    def stamp(self) -> object | None:
        """Something that is another after the root has changed, found at little cost; None: there is no root."""

    def root(self) -> bytes:
        """The bytes of the root that is in force."""

    def blob(self, digest: str, size: int | None) -> bytes:
        """The bytes of a blob, verified against its hash and, where it is known, its size."""

    def name(self, digest: str | None) -> str:
        """What to call a blob, or for None the root, where something is wrong with it."""

    def to_verify(self, digest: str) -> bool:
        """Must this blob be read through before its release is used? Not where it was verified when it came."""


class BlobMissing(ReleaseError):  # noqa: N818 (the name says what is the matter)
    """A blob that its manifest names is not here, and need not be: what it holds is not known."""


class ReleaseFolder:
    """The folder of a release as a source of its blobs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def stamp(self) -> object | None:
        """One `stat` of the root."""
        try:
            status = (self.folder / ROOT_NAME).stat()
        except (OSError, ValueError):
            return None
        return status.st_ino, status.st_mtime_ns, status.st_size

    def root(self) -> bytes:
        """The bytes of the root file."""
        return read_file(self.folder / ROOT_NAME, MAX_ROOT_BYTES)

    def blob(self, digest: str, size: int | None) -> bytes:
        """The bytes of a blob's file, verified."""
        return read_blob(self.folder, digest, size)

    def name(self, digest: str | None) -> str:
        """The path of a file."""
        return str(self.folder / ROOT_NAME if digest is None else blob_path(self.folder, digest))

    def to_verify(self, digest: str) -> bool:
        """Every file: nobody has looked at it before."""
        return True


def decoded(cls: type[MessageT], data: bytes, file: str) -> MessageT:
    """The message in the bytes of a file; ReleaseError where it is not one of `cls`."""
    try:
        return decode(cls, data).message
    except DecodeError as error:
        why = " ".join(str(error).split())
        raise ReleaseError(file, cls.__name__, f"a message of {cls.schema_name()} ({why})") from None


def read_blob(folder: Path, digest: str, size: int | None) -> bytes:
    """The bytes of a blob, which have the hash and, where it is known, the size that they must have."""
    path = blob_path(folder, digest)
    data = read_file(path, MAX_BLOB_BYTES if size is None else min(size, MAX_BLOB_BYTES))
    if size is not None and len(data) != size:
        raise ReleaseError(str(path), "size", f"{size} bytes", actual=str(len(data)))
    if hashlib.sha256(data).hexdigest() != digest:
        raise ReleaseError(str(path), "SHA-256 of the bytes", "the file's name")
    return data


def read_file(path: Path, limit: int) -> bytes:
    """The bytes of a plain file, no more than `limit` of them."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # opening a pipe would wait for ever
            raise ReleaseError(str(path), "file", "a plain file")
        if status.st_size > limit:
            raise ReleaseError(str(path), "size", f"at most {limit} bytes", actual=str(status.st_size))
        with path.open("rb") as stream:
            return stream.read(limit + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, ReleaseError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise ReleaseError(str(path), "file", f"a readable file ({reason})") from None


def blob_path(folder: Path, digest: str) -> Path:
    """Where a blob is in the folder of a release."""
    return folder / "blobs" / digest[:2] / digest


def encoded(message: Message, name: str) -> bytes:
    """The bytes of a message; ReleaseError where it is too large for a file."""
    try:
        return encode(message)
    except ValueError as error:
        raise ReleaseError(name, "size", str(error)) from None


def write_blob(folder: Path, digest: str, data: bytes) -> None:
    """Write a blob unless it is there; one that is there and damaged is replaced."""
    try:
        read_blob(folder, digest, len(data))
    except ReleaseError:
        write_file(blob_path(folder, digest), data)


def write_file(path: Path, data: bytes) -> None:
    """All of the bytes under this name, or what was there before: temporary name, fsync, rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:16]}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fchmod(stream.fileno(), 0o644)  # mkstemp's is for one user, and services run as others
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

"""Open the release at a path: a folder, or a vehicle's store, which is only read."""

from __future__ import annotations

import argparse
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.road_map.release import Release, load_public_key, open_release, read_release
from camber.road_map.store import MapStore

_MAGIC = b"SQLite format 3\x00"  # first bytes of every SQLite file (sqlite.org/fileformat.html, 1.3)


def add_public_key(parser: argparse.ArgumentParser) -> None:
    """Add `--public-key`."""
    parser.add_argument(
        "--public-key", type=Path, metavar="PEM", help="key that must have signed the release"
    )


def add_release(parser: argparse.ArgumentParser) -> None:
    """Add a release and `--public-key`, for `named_release`."""
    parser.add_argument("release", type=Path, metavar="RELEASE", help="folder of a release")
    add_public_key(parser)


def named_release(args: argparse.Namespace) -> Release:
    """Read the release that the arguments name, fully verified; raises ReleaseError."""
    key = None if args.public_key is None else load_public_key(args.public_key)
    return read_release(args.release, public_key=key)


def release_at(path: Path, public_key: Ed25519PublicKey | None = None) -> Release:
    """Open the release of a folder, or the active one of a store; ReleaseError if there is none."""
    return open_release(path if path.is_dir() else MapStore(path, read_only=True), public_key=public_key)


def is_release(path: Path) -> bool:
    """Whether a path is a folder or a store."""
    if path.is_dir():
        return True
    with path.open("rb") as stream:
        return stream.read(len(_MAGIC)) == _MAGIC

"""Sign and verify releases of the map: Ed25519 (RFC 8032), in PEM files as OpenSSL writes them.

    openssl genpkey -algorithm ed25519 -out release.key              # stays with the map's producer
    openssl pkey -in release.key -pubout -out release.pub            # goes to every vehicle

A key is replaced with an overlap, in which both are valid (`KeyRotation`): vehicles get the new one before it signs. A
key's id is the first 16 hexadecimal digits of the SHA-256 of its 32 public bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from camber.geodesy.gps_time import NS_PER_DAY
from camber.road_map.road_columns import ReleaseError
from camber.schemas.plain_file import read_plain_file
from camber.schemas.road import ReleaseRoot, signed_bytes

_GPS_EPOCH = date(1980, 1, 6)
_MOST_BYTES = 1 << 16  # chosen: a key in PEM has some hundred bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class DatedKey:
    """A public key, and the first and last day on which its signatures are accepted; None: no limit."""

    key: Ed25519PublicKey
    first_day: date | None = None
    last_day: date | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyRotation:
    """The keys that releases may be signed with, each within its days. `now_ns`: GPS time, of which days are UTC's
    but for leap seconds."""

    keys: tuple[DatedKey, ...]
    now_ns: Callable[[], int]

    def key_of(self, root: ReleaseRoot, file: str) -> Ed25519PublicKey:
        """Return the key that a root names; ReleaseError where it is none of these, or not valid today."""
        dated = next((each for each in self.keys if key_id(each.key) == root.key_id), None)
        if dated is None:
            raise ReleaseError(file, "key_id", f"key {_named(self)}", actual=str(root.key_id))
        today = _GPS_EPOCH + timedelta(days=self.now_ns() // NS_PER_DAY)
        if dated.first_day is not None and today < dated.first_day:
            raise ReleaseError(file, "key_id", f"a key before {dated.first_day}", actual=str(root.key_id))
        if dated.last_day is not None and today > dated.last_day:
            raise ReleaseError(file, "key_id", f"a key after {dated.last_day}", actual=str(root.key_id))
        return dated.key


TrustedKey = Ed25519PublicKey | KeyRotation


def _named(trusted: TrustedKey) -> str:
    keys = [each.key for each in trusted.keys] if isinstance(trusted, KeyRotation) else [trusted]
    return " or ".join(map(key_id, keys))


def load_public_key(path: Path) -> Ed25519PublicKey:
    """Load the public key of a PEM file; ReleaseError if there is none."""
    key: Ed25519PublicKey = _load(path, "public key", load_pem_public_key, Ed25519PublicKey)
    return key


def load_signing_key(path: Path) -> Ed25519PrivateKey:
    """Load the private key of a PEM file without passphrase; ReleaseError if there is none."""
    key: Ed25519PrivateKey = _load(
        path, "signing key", lambda data: load_pem_private_key(data, None), Ed25519PrivateKey
    )
    return key


def _load(path: Path, field: str, load: Callable[[bytes], object], cls: Any) -> Any:
    cause = ""
    try:
        key = load(read_plain_file(path, _MOST_BYTES))
        if isinstance(key, cls):
            return key
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        cause = f" ({(str(error) or type(error).__name__).splitlines()[0][:120]})"
    raise ReleaseError(str(path), field, f"an Ed25519 key in PEM{cause}")


def key_id(key: Ed25519PublicKey) -> str:
    """Return the id of a key, as in the roots it signed."""
    return hashlib.sha256(key.public_bytes_raw()).hexdigest()[:16]


def signed(root: ReleaseRoot, key: Ed25519PrivateKey) -> ReleaseRoot:
    """Return the root with its signature."""
    signature = np.frombuffer(key.sign(signed_bytes(root)), np.uint8)
    return ReleaseRoot(**root.__dict__ | {"key_id": key_id(key.public_key()), "signature": signature})


def check_signature(root: ReleaseRoot, trusted: TrustedKey, file: str) -> None:
    """Raise ReleaseError unless the key, or one of several that is valid today, signed this root."""
    if root.signature is None:
        raise ReleaseError(file, "signature", f"one by key {_named(trusted)}", actual="none")
    key = trusted.key_of(root, file) if isinstance(trusted, KeyRotation) else trusted
    if root.key_id != key_id(key):
        raise ReleaseError(file, "key_id", f"key {key_id(key)}", actual=str(root.key_id))
    try:
        key.verify(root.signature.tobytes(), signed_bytes(root))
    except InvalidSignature:
        raise ReleaseError(file, "signature", f"one by key {key_id(key)} over this root") from None

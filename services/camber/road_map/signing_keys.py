"""Sign and verify releases of the map: Ed25519 (RFC 8032), in PEM files as OpenSSL writes them.

    openssl genpkey -algorithm ed25519 -out release.key              # stays with the map's producer
    openssl pkey -in release.key -pubout -out release.pub            # goes to every vehicle

A key's id is the first 16 hexadecimal digits of the SHA-256 of its 32 public bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from camber.road_map.road_columns import ReleaseError
from camber.schemas.road import ReleaseRoot, signed_bytes


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
        key = load(path.read_bytes())
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


def check_signature(root: ReleaseRoot, key: Ed25519PublicKey, file: str) -> None:
    """Raise ReleaseError unless `key` signed this root."""
    if root.signature is None:
        raise ReleaseError(file, "signature", f"one by key {key_id(key)}", actual="none")
    if root.key_id != key_id(key):
        raise ReleaseError(file, "key_id", f"key {key_id(key)}", actual=str(root.key_id))
    try:
        key.verify(root.signature.tobytes(), signed_bytes(root))
    except InvalidSignature:
        raise ReleaseError(file, "signature", f"one by key {key_id(key)} over this root") from None

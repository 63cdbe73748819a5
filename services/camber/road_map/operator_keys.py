"""Keys of operators, and their signatures on decisions about the map: Ed25519, in PEM files as for releases.

openssl genpkey -algorithm ed25519 -out ann.key                  # stays with the operator
openssl pkey -in ann.key -pubout -out operators/ann.pub          # to map_update, in the folder `operator_keys`
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from camber.road_map.road_columns import ReleaseError
from camber.road_map.signing_keys import key_id, load_public_key
from camber.schemas.fleet import MapDecision, decision_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorKeys:
    """The public keys of those who may decide, by their ids."""

    keys: Mapping[str, Ed25519PublicKey]

    def to_json(self) -> str:
        """Return the keys as text: id and the 32 bytes in hexadecimal digits."""
        return json.dumps(
            {number: key.public_bytes_raw().hex() for number, key in self.keys.items()}, indent=1
        )

    @classmethod
    def from_json(cls, text: bytes) -> OperatorKeys:
        """Parse what `to_json` returns; raises ValueError, TypeError or AttributeError."""
        rows = json.loads(text)
        return cls(
            keys={
                number: Ed25519PublicKey.from_public_bytes(bytes.fromhex(raw)) for number, raw in rows.items()
            }
        )

    def check(self, decision: MapDecision) -> None:
        """Raise ReleaseError unless one of these keys signed the decision."""
        if decision.signature is None or decision.key_id is None:
            raise ReleaseError("decision", "signature", "one by an operator's key", actual="none")
        key = self.keys.get(decision.key_id)
        if key is None:
            raise ReleaseError("decision", "key_id", "an operator's key", actual=decision.key_id)
        try:
            key.verify(decision.signature.tobytes(), decision_bytes(decision))
        except InvalidSignature:
            raise ReleaseError("decision", "signature", f"one by key {decision.key_id} over it") from None


def load_operator_keys(folder: Path) -> OperatorKeys:
    """Load all files `*.pub` of a folder; ReleaseError where there is none, or one is no public key."""
    keys = [load_public_key(path) for path in sorted(folder.glob("*.pub"))]
    if not keys:
        raise ReleaseError(str(folder), "operator_keys", "a folder with public keys, NAME.pub")
    return OperatorKeys(keys={key_id(key): key for key in keys})


def sign_decision(decision: MapDecision, key: Ed25519PrivateKey) -> MapDecision:
    """Return the decision with its signature."""
    signature = np.frombuffer(key.sign(decision_bytes(decision)), np.uint8)
    return MapDecision(**decision.__dict__ | {"key_id": key_id(key.public_key()), "signature": signature})

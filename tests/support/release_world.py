"""Releases for tests: a reference over several tiles, what is made of it, and a supplier with faults on demand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from camber.map_server.release_download import SupplierUnavailableError
from camber.map_update.fusion.correction_rows import CORRECTION, Corrections
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.road_map.release import open_release
from camber.road_map.release_server import ReleaseServer
from camber.schemas.codec import encode
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest
from support.small_map import MADE_NS, link, surface, write

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))
LINK = link(1, (1, 2), [(-20.0, 0.0), (20.0, 0.0)])
STEP_M = 400.0
"""From one surface to the next, so that most stand in tiles of their own."""


def public_pem(key: Ed25519PrivateKey) -> bytes:
    """The public half of a key, as a file holds it."""
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def write_signing_keys(private: Path, public: Path) -> tuple[Path, Path]:
    """A new `release.key` and its `release.pub`, each in its folder."""
    key, paths = Ed25519PrivateKey.generate(), (private / "release.key", public / "release.pub")
    paths[0].write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    paths[1].write_bytes(public_pem(key))
    return paths


def offsets(**by_surface: float) -> Corrections:
    """Corrections of surfaces given as `s3=0.05`."""
    rows = [(int(name[1:]), offset_m, 0.01, 7, MADE_NS, 0) for name, offset_m in by_surface.items()]
    return np.array(rows, CORRECTION)


def making(folder: Path, count: int = 8, *, key: Any = KEY, **changed: Any) -> ReleaseBuilder:
    """Makes releases in `folder/out` from a reference in `folder/in`: `count` surfaces to the east of the origin."""
    rows = [surface(k, STEP_M * k, heights_m=50.0 + np.arange(18).reshape(6, 3) / 100) for k in range(count)]
    write(folder / "in", rows, [LINK], **changed)
    return ReleaseBuilder(folder / "out", open_release(folder / "in"), signing_key=key)


class Cloud:
    """A supplier that answers from a folder; `cut_after`, `spoil` and `change` change its answers."""

    name = "cloud"
    may_be_old = False

    def __init__(self, folder: Path) -> None:
        self.asked: list[MapBlobRequest] = []
        self.sent_bytes = 0
        self.cut_after: int | None = None
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self.spoil_more = self.spoil
        self.change: dict[str, Any] = {}
        self._serving = ReleaseServer(folder)

    def region(self) -> str | None:
        return None

    def root(self, request: MapRootRequest) -> MapRootReply:
        return self._serving.root(request, time_ns=MADE_NS)

    def blob(self, request: MapBlobRequest) -> MapBlobReply:
        if self.cut_after is not None and len(self.asked) >= self.cut_after:
            raise SupplierUnavailableError("the connection is cut")
        self.asked.append(request)
        reply = self._serving.blob(request, time_ns=MADE_NS)
        payload = np.frombuffer(self.spoil(reply.payload.tobytes()), np.uint8)
        more = np.frombuffer(self.spoil_more(reply.more_payload.tobytes()), np.uint8)
        self.sent_bytes += len(payload) + len(more)
        assert len(encode(reply)) <= 256_000
        return reply.model_copy(update={"payload": payload, "more_payload": more, **self.change})

"""Serve releases over the bus: the newest root of a region, and blobs by hash, whole or as differences."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camber.road_map.blob_delta import compress_blob, uncompressed_blob
from camber.road_map.release import ReleaseError, ReleaseFolder
from camber.road_map.release_files import PART_BYTES, decoded
from camber.schemas.base import Message
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest, ReleaseHead
from camber.schemas.road import ReleaseRoot

_KEPT_BYTES = 64 << 20  # chosen: memory for compressed differences
_NOTHING = np.zeros(0, np.uint8)


class ReleaseServer:
    """Answers queries from a folder of releases; clients verify signature and hashes themselves.

    map_update adds `answers` to its own, and publishes `head()` on the channel `release` after each new release. A
    vehicle imports a folder into its store through the same answers. `compress`: not needed within one process.
    """

    def __init__(self, folder: Path, *, compress: bool = True, kept_bytes: int = _KEPT_BYTES) -> None:
        self._source = ReleaseFolder(folder)
        self._compress = compress
        self._kept_bytes = kept_bytes
        # All vehicles request the same few differences: each is computed once.
        self._compressed: OrderedDict[tuple[str, str | None], bytes] = OrderedDict()
        self._size = 0

    def answers(
        self, now_ns: Callable[[], int]
    ) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Return the handlers of the two queries."""
        return {
            "map_root": lambda requests: [self.root(request, time_ns=now_ns()) for request in requests],
            "map_blob": lambda requests: [self.blob(request, time_ns=now_ns()) for request in requests],
        }

    def stamp(self) -> object | None:
        """Return a value that differs after the root has changed."""
        return self._source.stamp()

    def head(self, *, time_ns: int) -> ReleaseHead:
        """Return the notice of the newest release; ReleaseError if there is none."""
        root = decoded(ReleaseRoot, self._source.root(), self._source.name(None))
        fields = root.model_dump(include={"region", "map_version", "manifest_sha256"})
        return ReleaseHead(time_ns=time_ns, **fields)

    def root(self, request: MapRootRequest, *, time_ns: int | None = None) -> MapRootReply:
        """Return the newest root, unless the client has it; `time_ns` is by default that of the request."""
        time_ns = request.time_ns if time_ns is None else time_ns
        empty = partial(MapRootReply, time_ns=time_ns, payload=_NOTHING)
        try:
            data = self._source.root()
            root = decoded(ReleaseRoot, data, self._source.name(None))
        except ReleaseError:
            return empty(status="unknown", reason="no release")
        if root.region != request.region:
            return empty(status="unknown", reason=f"releases here are of {root.region}")
        if root.manifest_sha256 == request.have_sha256:
            return empty(status="unchanged")
        return MapRootReply(time_ns=time_ns, status="known", payload=np.frombuffer(data, np.uint8))

    def blob(self, request: MapBlobRequest, *, time_ns: int | None = None) -> MapBlobReply:
        """Return a part of a compressed blob; after an only part also the blobs requested next.

        Compressed without difference if the base blob does not exist here. `time_ns` is by default that of the request.
        """
        time_ns = request.time_ns if time_ns is None else time_ns
        unknown = partial(
            MapBlobReply,
            time_ns=time_ns,
            status="unknown",
            payload=_NOTHING,
            more_bytes=np.zeros(0, np.int32),
            more_payload=_NOTHING,
        )
        try:
            data = self._compressed_blob(request.sha256, request.base_sha256)
        except ReleaseError:
            return unknown(reason="no such blob")
        parts = -(-len(data) // PART_BYTES)
        if request.part >= parts:
            return unknown(reason=f"part {request.part} of {parts}")
        begin = request.part * PART_BYTES
        more = self._more(request, PART_BYTES - len(data)) if parts == 1 else []
        return MapBlobReply(
            time_ns=time_ns,
            status="known",
            parts=parts,
            payload=np.frombuffer(data[begin : begin + PART_BYTES], np.uint8),
            more_bytes=np.array([len(each) for each in more], np.int32),
            more_payload=np.frombuffer(b"".join(more), np.uint8),
        )

    def _more(self, request: MapBlobRequest, room: int) -> list[bytes]:
        """Return the first of the blobs requested next, as many as fit."""
        more: list[bytes] = []
        for digest, base in zip(request.more_sha256, request.more_base_sha256, strict=False):
            try:
                data = self._compressed_blob(digest, base)
            except ReleaseError:  # the client is informed when it requests this blob itself
                break
            room -= len(data)
            if room < 0:
                break
            more.append(data)
        return more

    def _compressed_blob(self, digest: str, base_digest: str | None) -> bytes:
        key = digest, base_digest
        if key in self._compressed:
            self._compressed.move_to_end(key)
            return self._compressed[key]
        blob = self._source.blob(digest, None)
        if not self._compress:
            return uncompressed_blob(blob)
        base: bytes | None = None
        if base_digest is not None:
            with suppress(ReleaseError):  # of a release that was deleted, or of another folder
                base = self._source.blob(base_digest, None)
        data = self._compressed[key] = compress_blob(blob, base)
        self._size += len(data)
        while self._size > self._kept_bytes and len(self._compressed) > 1:
            self._size -= len(self._compressed.popitem(last=False)[1])
        return data

"""Releases for whoever asks: the newest root of a region, and blobs by their hash, whole or as differences."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.road_map.blob_delta import as_it_is, packed
from camber.road_map.release import ReleaseError, ReleaseFolder
from camber.road_map.release_files import PART_BYTES, decoded
from camber.schemas.base import Message
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest, ReleaseHead
from camber.schemas.road import ReleaseRoot

_KEPT_BYTES = 64 << 20
_NOTHING = np.zeros(0, np.uint8)


class ReleaseServing:
    """Answers from a folder of releases. What is signed and hashed needs no trust in who serves it.

    map_update adds `answers` to its own, and publishes `head()` on the channel `release` after each new release. A
    vehicle takes a folder into its store through the same answers; `near`: the asker is in this process, and what
    need not travel is not packed.
    """

    def __init__(self, folder: Path, *, near: bool = False, kept_bytes: int = _KEPT_BYTES) -> None:
        self._source = ReleaseFolder(folder)
        self._near = near
        self._kept_bytes = kept_bytes
        # All vehicles ask for the same few differences: each is made once.
        self._packed: OrderedDict[tuple[str, str | None], bytes] = OrderedDict()
        self._size = 0

    def answers(
        self, now_ns: Callable[[], int]
    ) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """The two questions, as a service answers them."""
        return {
            "map_root": lambda requests: [self.root(request, time_ns=now_ns()) for request in requests],
            "map_blob": lambda requests: [self.blob(request, time_ns=now_ns()) for request in requests],
        }

    def head(self, *, time_ns: int) -> ReleaseHead:
        """The notice of the newest release; ReleaseError where there is none."""
        root = decoded(ReleaseRoot, self._source.root(), self._source.name(None))
        return ReleaseHead(
            time_ns=time_ns,
            region=root.region,
            map_version=root.map_version,
            manifest_sha256=root.manifest_sha256,
        )

    def root(self, request: MapRootRequest, *, time_ns: int) -> MapRootReply:
        """The newest root, unless the asker has it."""
        try:
            data = self._source.root()
            root = decoded(ReleaseRoot, data, self._source.name(None))
        except ReleaseError:
            return MapRootReply(time_ns=time_ns, status="unknown", reason="no release", payload=_NOTHING)
        if root.region != request.region:
            reason = f"releases here are of {root.region}"
            return MapRootReply(time_ns=time_ns, status="unknown", reason=reason, payload=_NOTHING)
        if root.manifest_sha256 == request.have_sha256:
            return MapRootReply(time_ns=time_ns, status="unchanged", payload=_NOTHING)
        return MapRootReply(time_ns=time_ns, status="known", payload=np.frombuffer(data, np.uint8))

    def blob(self, request: MapBlobRequest, *, time_ns: int) -> MapBlobReply:
        """A part of a packed blob, and after its only part others; as a whole where its base is not here."""
        try:
            data = self._in_few_bytes(request.sha256, request.base_sha256)
        except ReleaseError:
            return _unknown_blob("no such blob", time_ns)
        parts = -(-len(data) // PART_BYTES)
        if request.part >= parts:
            return _unknown_blob(f"part {request.part} of {parts}", time_ns)
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
        """The first of the blobs wanted next, as many as fit."""
        more: list[bytes] = []
        for digest, base in zip(request.more_sha256, request.more_base_sha256, strict=False):
            try:
                data = self._in_few_bytes(digest, base)
            except ReleaseError:  # asked for by itself it is told so
                break
            room -= len(data)
            if room < 0:
                break
            more.append(data)
        return more

    def _in_few_bytes(self, digest: str, base_digest: str | None) -> bytes:
        key = digest, base_digest
        if key in self._packed:
            self._packed.move_to_end(key)
            return self._packed[key]
        blob = self._source.blob(digest, None)
        if self._near:
            return as_it_is(blob)
        base: bytes | None = None
        if base_digest is not None:
            try:
                base = self._source.blob(base_digest, None)
            except ReleaseError:  # an older release than those that are kept, or of another folder
                base = None
        data = self._packed[key] = packed(blob, base)
        self._size += len(data)
        while self._size > self._kept_bytes and len(self._packed) > 1:
            self._size -= len(self._packed.popitem(last=False)[1])
        return data


def _unknown_blob(reason: str, time_ns: int) -> MapBlobReply:
    none = np.zeros(0, np.int32)
    return MapBlobReply(
        time_ns=time_ns,
        status="unknown",
        reason=reason,
        payload=_NOTHING,
        more_bytes=none,
        more_payload=_NOTHING,
    )

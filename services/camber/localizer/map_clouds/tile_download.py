"""Download of one cloud tile from the map server in parts: the map may change or go away in between.

    fetch = TileFetch("road_cloud", x, y, have_sha256=hash_of_the_last_time)
    while fetch.state == "loading":
        for request in fetch.requests(time_ns):          # a few parts per step
            fetch.receive(request.part, reply or None)   # None: no reply came

`state` *loaded*: `tile` and `sha256` are set; *unchanged*: the tile of `have_sha256` is still the map's; *unknown*:
there is no such tile, or none now, for `reason`. A blob is decoded only when all of it has the announced hash.
"""

from __future__ import annotations

import hashlib
from itertools import islice
from typing import Final, Literal, cast

from camber.schemas.base import UInt8
from camber.schemas.codec import DecodeError, decode
from camber.schemas.road import CloudTile, TileReply, TileRequest

CloudLayer = Literal["environment_cloud", "road_cloud"]
FetchState = Literal["loading", "loaded", "unchanged", "unknown"]

MAX_BYTES: Final = 64 << 20
"""Of a blob, as of every message."""
# Chosen: bounds against a map server that is faulty or hostile.
_MAX_PARTS: Final = 4096
_MAX_RESTARTS: Final = 3
_MAX_UNANSWERED: Final = 10


class TileFetch:
    """The download of one tile. Memory: the parts so far, then the tile; none after a failure."""

    def __init__(
        self, layer: CloudLayer, x: int, y: int, *, have_sha256: str | None = None, parts_per_step: int = 4
    ) -> None:
        self.layer, self.x, self.y = layer, x, y
        self.state: FetchState = "loading"
        self.reason = ""
        self.tile: CloudTile | None = None
        self.sha256: str | None = None
        self._have_sha256 = have_sha256
        self._parts_per_step = parts_per_step
        self._parts = 0  # 0: not known yet
        self._got: set[int] = set()
        self._buffer = bytearray()  # of all parts at once: a dense tile has 28 MB, and twice that is too much
        self._size = 0
        self._restarts = 0
        self._unanswered = 0

    def requests(self, time_ns: int) -> list[TileRequest]:
        """Return the requests of this step, in order; the first step requests one part, and learns their number."""
        if self.state != "loading":
            return []
        missing = (part for part in range(max(self._parts, 1)) if part not in self._got)
        return [
            TileRequest(
                time_ns=time_ns,
                x=self.x,
                y=self.y,
                layer=self.layer,
                have_sha256=self._have_sha256,
                part=part,
            )
            for part in islice(missing, self._parts_per_step)
        ]

    def receive(self, part: int, reply: TileReply | None) -> None:
        """Process the reply for a part; None: no reply came. A reply that is no longer expected is ignored."""
        if self.state != "loading" or part in self._got or part >= max(self._parts, 1):
            return
        if reply is None:
            self._unanswered += 1
            if self._unanswered >= _MAX_UNANSWERED:
                self._fail("the map server does not answer")
        elif reply.status == "unknown":
            self._fail(reply.reason or "unknown")
        elif reply.status == "unchanged":
            self._unchanged(reply)
        else:
            self._unanswered = 0
            self._receive_part(part, reply)

    def _unchanged(self, reply: TileReply) -> None:
        if self._have_sha256 is None or reply.sha256 != self._have_sha256:
            self._fail("called unchanged, but its hash is another one")
        else:
            self._forget()
            self.state, self.sha256 = "unchanged", reply.sha256

    def _receive_part(self, part: int, reply: TileReply) -> None:
        if reply.sha256 is None or not 0 < reply.parts <= _MAX_PARTS or not len(reply.payload):
            self._fail("a part without hash, number of parts or bytes")
            return
        if self.sha256 is not None and (reply.sha256, reply.parts) != (self.sha256, self._parts):
            self._restart()
            return
        self.sha256, self._parts = reply.sha256, reply.parts
        if not self._store(part, reply.payload):
            return
        self._got.add(part)
        if len(self._got) == self._parts:
            self._finish()

    def _store(self, part: int, payload: UInt8) -> bool:
        """Store a part; all have one size but the last, which may be smaller."""
        if not self._got:
            self._size = len(payload)
            if self._size * self._parts > MAX_BYTES + self._size:
                self._fail(f"more than {MAX_BYTES} bytes")
                return False
            self._buffer = bytearray(self._size * self._parts)
        last = part == self._parts - 1
        if len(payload) != self._size and not (last and len(payload) < self._size):
            self._fail(f"part {part} has {len(payload)} bytes, expected {self._size}")
            return False
        begin = part * self._size
        self._buffer[begin : begin + len(payload)] = payload.data
        if last:
            del self._buffer[begin + len(payload) :]
        return True

    def _restart(self) -> None:
        """Discard the parts so far: the map has changed, and they are of the old tile."""
        self._restarts += 1
        if self._restarts > _MAX_RESTARTS:
            self._fail("the tile changes faster than it can be loaded")
            return
        self._forget()

    def _finish(self) -> None:
        blob, self._buffer = self._buffer, bytearray()
        if hashlib.sha256(blob).hexdigest() != self.sha256:
            self._fail("the bytes do not have the announced hash")
            return
        try:
            tile = decode(CloudTile, cast(bytes, blob)).message  # decode accepts any sliceable buffer
        except DecodeError as error:
            self._fail(" ".join(str(error).split()))
            return
        if (tile.layer, tile.x, tile.y) != (self.layer, self.x, self.y):
            self._fail(f"{tile.layer} {tile.x} {tile.y} came, expected {self.layer} {self.x} {self.y}")
            return
        self.tile, self.state = tile, "loaded"

    def _fail(self, reason: str) -> None:
        self._forget()
        self.state, self.reason = "unknown", reason

    def _forget(self) -> None:
        self.sha256, self._parts, self._got, self._buffer = None, 0, set(), bytearray()

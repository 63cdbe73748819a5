"""Download of one cloud tile from the map server in parts: the map may change or go away in between.

    fetch = TileFetch("road_cloud", x, y, have_sha256=hash_of_the_last_time)
    while fetch.state == "loading":
        fetch.receive(map_queries.tile(fetch.request(time_ns)))

`state` *loaded*: `tile` and `sha256` are set; *unchanged*: the tile of `have_sha256` is still the map's; *unknown*:
there is no such tile, or none now, for `reason`. A blob is decoded only when all of it has the announced hash.
"""

from __future__ import annotations

import hashlib
from typing import Final, Literal, cast

from camber.schemas.codec import DecodeError, decode
from camber.schemas.road import CloudTile, TileReply, TileRequest

CloudLayer = Literal["environment_cloud", "road_cloud"]
FetchState = Literal["loading", "loaded", "unchanged", "unknown"]

MAX_BYTES: Final = 64 << 20
"""Of a blob, as of every message."""
# Chosen: bounds against a map server that is faulty or hostile.
_MAX_PARTS: Final = 4096
_MAX_RESTARTS: Final = 3


class TileFetch:
    """The download of one tile. Memory: the parts so far, then the tile; none after a failure."""

    def __init__(self, layer: CloudLayer, x: int, y: int, *, have_sha256: str | None = None) -> None:
        self.layer, self.x, self.y = layer, x, y
        self.state: FetchState = "loading"
        self.reason = ""
        self.tile: CloudTile | None = None
        self.sha256: str | None = None
        self._have_sha256 = have_sha256
        self._parts = 0  # 0: not known yet
        self._next = 0
        self._blob = bytearray()  # grows in place: a dense tile has 28 MB, and twice that is too much
        self._restarts = 0

    def request(self, time_ns: int) -> TileRequest:
        """Return the request of the next part, in order; their number is in the reply to the first one."""
        return TileRequest(
            time_ns=time_ns,
            x=self.x,
            y=self.y,
            layer=self.layer,
            have_sha256=self._have_sha256,
            part=self._next,
        )

    def receive(self, reply: TileReply) -> None:
        """Process the reply to the last request, while loading."""
        if reply.status == "unknown":
            self._fail(reply.reason or "unknown")
        elif reply.status == "unchanged":
            self._unchanged(reply)
        else:
            self._receive_part(reply)

    def _unchanged(self, reply: TileReply) -> None:
        if self._have_sha256 is None or reply.sha256 != self._have_sha256:
            self._fail("called unchanged, but its hash is another one")
        else:
            self._forget()
            self.state, self.sha256 = "unchanged", reply.sha256

    def _receive_part(self, reply: TileReply) -> None:
        if reply.sha256 is None or not 0 < reply.parts <= _MAX_PARTS or not len(reply.payload):
            self._fail("a part without hash, number of parts or bytes")
        elif self.sha256 is not None and (reply.sha256, reply.parts) != (self.sha256, self._parts):
            self._restart()
        elif len(self._blob) + len(reply.payload) > MAX_BYTES:
            self._fail(f"more than {MAX_BYTES} bytes")
        else:
            self.sha256, self._parts, self._next = reply.sha256, reply.parts, self._next + 1
            self._blob += reply.payload.data
            if self._next == self._parts:
                self._finish()

    def _restart(self) -> None:
        """Discard the parts so far: the map has changed, and they are of the old tile."""
        self._restarts += 1
        self._forget()
        if self._restarts > _MAX_RESTARTS:
            self._fail("the tile changes faster than it can be loaded")

    def _finish(self) -> None:
        blob, self._blob = self._blob, bytearray()
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
        self.sha256, self._parts, self._next, self._blob = None, 0, 0, bytearray()

"""The vehicle's own map, tile by tile from its map server."""

from __future__ import annotations

import hashlib
import threading
from typing import Any

from camber.road_map.release import AnyTile, ReleaseError, decode_tile
from camber.road_map.tile_grid import Tile
from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.runtime.settings import ServiceSettings
from camber.schemas.road import CloudTile, Layer, LinkTile, SurfaceTile, TileReply, TileRequest

_TIMEOUT_S = 2.0  # as the table of channels: a tile must come within it
_MOST_PARTS = 256
"""Of one tile. Chosen: 64 MB, the most that a blob may have."""


class BusMap:
    """Tiles that the map server has; those of a map that is not loaded there are not known."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = settings
        self._client: QueryClient | None = None
        self._lock = threading.Lock()  # one question at a time: the localizer's come first

    def surface_tile(self, x: int, y: int) -> SurfaceTile | None:
        """Road surfaces of a tile."""
        tile = self._tile("surfaces", x, y)
        return tile if isinstance(tile, SurfaceTile) else None

    def link_tile(self, x: int, y: int) -> LinkTile | None:
        """Links of a tile."""
        tile = self._tile("links", x, y)
        return tile if isinstance(tile, LinkTile) else None

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        """Points of a tile."""
        tile = self._tile(layer, x, y)
        return tile if isinstance(tile, CloudTile) else None

    def tiles(self) -> list[Tile] | None:
        """Not known: the server answers for one tile at a time."""
        return None

    def describe(self) -> dict[str, Any]:
        """It is the map of the vehicle."""
        return {"region": f"map of {self._settings.vehicle}"}

    def _tile(self, layer: Layer, x: int, y: int) -> AnyTile | None:
        first = self._ask(layer, x, y, 0)
        if first is None or first.sha256 is None:
            return None
        parts = [first]
        for part in range(1, min(first.parts, _MOST_PARTS)):
            reply = self._ask(layer, x, y, part)
            if reply is None or reply.sha256 != first.sha256:
                raise ReleaseError("map_server", "parts", "all parts of one tile")
            parts.append(reply)
        data = b"".join(reply.payload.tobytes() for reply in parts)
        if hashlib.sha256(data).hexdigest() != first.sha256:
            raise ReleaseError("map_server", "SHA-256 of the bytes", "the tile's")
        return decode_tile(layer, data, file="map_server", tile=(x, y))

    def _ask(self, layer: Layer, x: int, y: int, part: int) -> TileReply | None:
        """A part of a tile; None where the server has no such tile. ReleaseError where it does not answer."""
        request = TileRequest(time_ns=SystemClock().now_ns(), x=x, y=y, layer=layer, part=part)
        with self._lock:
            try:
                if self._client is None:
                    self._client = QueryClient(self._settings, timeout_s=_TIMEOUT_S, source="live")
                (reply,) = self._client.ask("tile", request, self._settings.vehicle, [""])[""]
            except (BusError, ValueError) as error:
                raise ReleaseError("map_server", "answer", f"a tile ({error})") from None
        if not isinstance(reply, TileReply):
            raise ReleaseError("map_server", "answer", f"a tile ({reply})")
        return reply if reply.status == "known" else None

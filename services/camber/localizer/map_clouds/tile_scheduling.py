"""Loads the clouds around the vehicle from the map server, some parts at a time."""

from __future__ import annotations

from camber.localizer.map_clouds.map_blocks import MapBlock, MapBlockOptions, MapBlockStore
from camber.localizer.map_clouds.tile_download import CloudLayer, TileFetch
from camber.localizer.map_queries import Diagnostics, MapQueries, MapQueryFailure
from camber.localizer.matching.registration import LayerBounds

# Chosen: 4 MB per step; pause after a query without reply; the map server may have had no map at the first query.
_PARTS_PER_STEP = 16
_PAUSE_NS = 1_000_000_000
_RETRY_MISSING_NS = 30_000_000_000

_TileKey = tuple[CloudLayer, int, int]


class CloudTileLoader:
    """Provides blocks of the map. Each tile is loaded once while it is in use, and again only where it has changed."""

    def __init__(self, options: MapBlockOptions, map_queries: MapQueries, diagnostics: Diagnostics) -> None:
        self._blocks = MapBlockStore(options)
        self._map_queries, self._diagnostics = map_queries, diagnostics
        self._fetch: TileFetch | None = None
        self._sha256: dict[_TileKey, str] = {}
        self._stale: list[_TileKey] = []
        self._version: int | None = None
        self._paused_ns: int | None = None
        self._retried_ns: int | None = None
        self.reason = ""

    def note_map_version(self, map_version: int | None) -> None:
        """Note the map's version: with another one, tiles may have changed."""
        if map_version is None or map_version == self._version:
            return
        if self._version is not None:
            self._stale = self._blocks.tiles_held()
            self._blocks.forget_missing()
        self._version = map_version

    def block_at(self, latitude_rad: float, longitude_rad: float, now_ns: int) -> MapBlock | None:
        """Return the block at a position, once its tiles are loaded; None: `reason` is set."""
        if self._retried_ns is None or not 0 <= now_ns - self._retried_ns < _RETRY_MISSING_NS:
            self._retried_ns = now_ns
            self._blocks.forget_missing()
        self._blocks.drop_far_tiles(latitude_rad, longitude_rad)
        needed = self._blocks.tiles_needed(latitude_rad, longitude_rad)
        held = set(self._blocks.tiles_held())
        self._sha256 = {key: sha256 for key, sha256 in self._sha256.items() if key in held}
        self._stale = [key for key in self._stale if key in held]
        self._load(needed, now_ns)
        block = self._blocks.block_at(latitude_rad, longitude_rad)
        self.reason = self._blocks.reason
        return block

    def build_ahead(self, latitude_rad: float, longitude_rad: float, bounds: LayerBounds) -> None:
        """Do one step of building the block at a position ahead, from tiles that are loaded."""
        self._blocks.build_ahead(latitude_rad, longitude_rad, bounds)

    def _load(self, needed: list[_TileKey], now_ns: int) -> None:
        paused = self._paused_ns is not None and 0 <= now_ns - self._paused_ns < _PAUSE_NS
        if paused or not self._map_queries.is_available():
            return
        parts = _PARTS_PER_STEP
        while parts > 0:
            if self._fetch is None:
                key = next(iter((*needed, *self._stale)), None)
                if key is None:
                    return
                self._fetch = TileFetch(*key, have_sha256=self._sha256.get(key), parts_per_step=parts)
            parts -= self._step(self._fetch, now_ns)
            if self._paused_ns == now_ns:
                return
            if self._fetch.state != "loading":
                done = self._finish(self._fetch)
                needed = [key for key in needed if key != done]
                self._fetch = None

    def _step(self, fetch: TileFetch, now_ns: int) -> int:
        """Request some parts; return their number."""
        requested = 0
        for request in fetch.requests(now_ns):
            reply = self._map_queries.tile(request)
            if isinstance(reply, MapQueryFailure):
                self._diagnostics.issue("no_tile", reply.text)
                self._paused_ns = now_ns
                break
            fetch.receive(request.part, reply)
            requested += 1
        return max(requested, 1)

    def _finish(self, fetch: TileFetch) -> _TileKey:
        key: _TileKey = (fetch.layer, fetch.x, fetch.y)
        if key in self._stale:
            self._stale.remove(key)
        if fetch.state == "loaded" and fetch.tile is not None and fetch.sha256 is not None:
            self._blocks.set_tile(*key, fetch.tile)
            self._sha256[key] = fetch.sha256
            self._diagnostics.count("tile.loaded")
        elif fetch.state == "unknown":
            self._blocks.set_tile(*key, None, fetch.reason)
            self._sha256.pop(key, None)
            self._diagnostics.count("tile.missing")
        return key

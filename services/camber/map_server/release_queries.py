"""Answer the three queries from one release, for the service and for tools that have the release itself."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from camber.map_server.batch_road_selection import SelectedRoads
from camber.map_server.elevation_queries import ElevationMap
from camber.map_server.links import links_around
from camber.road_map.release import BlobMissingError, Release
from camber.road_map.release_files import PART_BYTES
from camber.road_map.tile_grid import tiles_around
from camber.schemas.pose import Road
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    RoadsAhead,
    TileReply,
    TileRequest,
)


class ReleaseQueries:
    """Queries to one release. Each raises ReleaseError for a damaged tile, BlobMissingError for one not downloaded."""

    def __init__(self, release: Release, *, tiles_kept: int = 256) -> None:
        self._release = release
        manifest = release.manifest
        self._elevation = ElevationMap(
            release.surface_tile,
            release.link_tile,
            datum=manifest.datum,
            map_version=manifest.map_version,
            tiles_kept=tiles_kept,
        )
        self._blob: tuple[str, bytes] | None = None  # the last one requested, for its other parts

    def elevation(self, request: ElevationRequest, *, time_ns: int) -> ElevationReply:
        """Answer the road under a point, and the roads ahead if requested."""
        point = request.latitude_rad, request.longitude_rad
        topology = request.link_ids, request.last_surface_id
        road: Road = self._elevation.road_around(*point, request.radius_m, *topology)
        ahead: RoadsAhead | None = None
        if request.ahead is not None and road.status == "known":
            with suppress(BlobMissingError):
                ahead = self._elevation.roads_ahead(*point, request.ahead, *topology)
        return ElevationReply(time_ns=time_ns, road=road, ahead=ahead)

    def roads(self, latitude_rad: ArrayLike, longitude_rad: ArrayLike) -> SelectedRoads:
        """Return the roads under n points given as two arrays (n,), without topology."""
        return self._elevation.roads(latitude_rad, longitude_rad)

    def links(self, request: LinksRequest, *, time_ns: int) -> LinksReply:
        """Answer the links around a point."""
        around = tiles_around(request.latitude_rad, request.longitude_rad, request.radius_m)
        tiles = [tile for xy in around if (tile := self._release.link_tile(*xy)) is not None]
        return links_around(tiles, request, map_version=self._release.manifest.map_version, time_ns=time_ns)

    def tile(self, request: TileRequest, *, time_ns: int) -> TileReply:
        """Answer a part of a tile's blob."""
        digest = self._release.sha256(request.layer, request.x, request.y)
        if digest is None:
            return unknown_tile("the release has no such tile", time_ns=time_ns)
        if self._blob is None or self._blob[0] != digest:
            blob = self._release.blob(request.layer, request.x, request.y)
            assert blob is not None, "the release has its hash"
            self._blob = digest, blob
        return tile_part(self._blob[1], digest, request, time_ns=time_ns)


def tile_part(blob: bytes, sha256: str, request: TileRequest, *, time_ns: int) -> TileReply:
    """Return the requested part; `unchanged` if the client has the blob already.

    Every part has the blob's hash: if it differs from that of the part before, the map has changed and the client
    starts again.
    """
    if request.have_sha256 == sha256:
        return TileReply(time_ns=time_ns, status="unchanged", sha256=sha256, payload=np.zeros(0, np.uint8))
    parts = -(-len(blob) // PART_BYTES)
    if request.part >= parts:
        return unknown_tile(f"part {request.part} of {parts}", time_ns=time_ns)
    begin = request.part * PART_BYTES
    payload = np.frombuffer(blob[begin : begin + PART_BYTES], np.uint8)
    return TileReply(time_ns=time_ns, status="known", sha256=sha256, parts=parts, payload=payload)


def unknown_tile(reason: str, *, time_ns: int) -> TileReply:
    """Return a reply with the reason why the tile is unknown."""
    return TileReply(time_ns=time_ns, status="unknown", reason=reason, payload=np.zeros(0, np.uint8))

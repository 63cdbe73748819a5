"""Divide a tile's blob into parts that fit into replies."""

from __future__ import annotations

import numpy as np

from camber.road_map.release_files import PART_BYTES
from camber.schemas.road import TileReply, TileRequest


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

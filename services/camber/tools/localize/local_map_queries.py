"""The map as the localizer asks for it, straight from a release on this machine: no process, no bus."""

from __future__ import annotations

from pathlib import Path

from camber.map_server.release_queries import ReleaseQueries
from camber.road_map.release import ROOT_NAME, Release, ReleaseError, read_release
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)


class MapAtHand:
    """Answers at the time of the question. Raises ReleaseError where a tile has gone since `release_for` saw it."""

    def __init__(self, release: Release) -> None:
        self._answers = ReleaseQueries(release)

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        """The road under a point."""
        return self._answers.elevation(request, time_ns=request.time_ns)

    def links(self, request: LinksRequest) -> LinksReply:
        """The links around a point."""
        return self._answers.links(request, time_ns=request.time_ns)

    def tile(self, request: TileRequest) -> TileReply:
        """A part of a tile."""
        return self._answers.tile(request, time_ns=request.time_ns)

    def is_there(self) -> bool:
        """It is."""
        return True


def release_for(folder: Path, datum: str) -> Release:
    """The release in a folder, every byte verified. Raises ReleaseError for a damaged one and for another datum."""
    release = read_release(folder)
    if release.manifest.datum != datum:
        found = release.manifest.datum
        raise ReleaseError(str(folder / ROOT_NAME), "datum", f"{datum} as of the drive", actual=found)
    return release

"""Answer the localizer's map queries from a release on this machine, without process or bus."""

from __future__ import annotations

from pathlib import Path

from camber.map_server.release_queries import ReleaseQueries
from camber.road_map.release import ROOT_NAME, Release, ReleaseError, read_release
from camber.schemas import road


class LocalMapQueries:
    """Answers each query immediately. Raises ReleaseError where a tile was removed after `release_for`."""

    def __init__(self, release: Release) -> None:
        self._answers = ReleaseQueries(release)

    def elevation(self, request: road.ElevationRequest) -> road.ElevationReply:
        """The road under a point."""
        return self._answers.elevation(request, time_ns=request.time_ns)

    def links(self, request: road.LinksRequest) -> road.LinksReply:
        """The links around a point."""
        return self._answers.links(request, time_ns=request.time_ns)

    def tile(self, request: road.TileRequest) -> road.TileReply:
        """A part of a tile."""
        return self._answers.tile(request, time_ns=request.time_ns)

    def is_available(self) -> bool:
        """Always true."""
        return True


def release_for(folder: Path, datum: str) -> Release:
    """Return the release in a folder, fully verified. Raises ReleaseError where damaged or of another datum."""
    release = read_release(folder)
    if release.manifest.datum != datum:
        raise ReleaseError(
            str(folder / ROOT_NAME), "datum", f"{datum} as of the drive", actual=release.manifest.datum
        )
    return release

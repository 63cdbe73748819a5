"""`camber map build` as the tests of its kinds call it, and what the maps built say of roads and links."""

from __future__ import annotations

from pathlib import Path

from camber import cli
from camber.map_server.elevation_queries import ElevationMap, SelectedRoads
from camber.road_map.release import Release
from camber.road_map.road_columns import Floats


def build_map(kind: str, out: Path, *arguments: object) -> int:
    """Run the command for a region at 2024.5; returns its exit code."""
    common = ("--out", out, "--region", "town", "--datum", "WGS84", "--epoch-year", "2024.5")
    return cli.main(["map", "build", kind, *map(str, (*common, *arguments))])


def elevation_map(release: Release) -> ElevationMap:
    return ElevationMap(release.surface_tile, release.link_tile, datum="WGS84", map_version=1)


def known_roads(release: Release, latitude_rad: Floats, longitude_rad: Floats, *links: int) -> SelectedRoads:
    """The roads under n places on these links; all must be known."""
    roads = elevation_map(release).roads(latitude_rad, longitude_rad, links)
    assert len(roads.known) == len(latitude_rad)
    return roads


def link_levels(release: Release) -> dict[int, int]:
    links = release.road_links()
    return dict(zip(links.link_id.tolist(), links.level.tolist(), strict=True))


def link_ends(release: Release) -> dict[int, tuple[int, int]]:
    """Nodes at the start and the end of each link."""
    links = release.road_links()
    columns = (links.link_id.tolist(), links.start_node.tolist(), links.end_node.tolist())
    return {link: (start, end) for link, start, end in zip(*columns, strict=True)}

"""`camber map inspect`: what a release, a vehicle's store or a map that is not imported yet holds."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import LaneletMap, read_lanelet2
from camber.formats.map_exchange.opendrive import read_opendrive
from camber.geodesy.gps_time import gpst_from_gps_ns, text_from_calendar
from camber.road_map.release import Release, load_public_key
from camber.road_map.release_files import BlobMissingError
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import links_from_tiles, surfaces_from_tiles
from camber.schemas.road import LAYERS
from camber.tools.maps.importers.lanes import line_length_m
from camber.tools.maps.release_at import add_public_key, is_release, release_at
from camber.tools.options.error_report import report_failures
from camber.tools.options.parsers import tool_parser

_PROG = "camber map inspect"
_QUANTILES = (0.5, 0.9, 1.0)

Report = dict[str, Any]


def main(argv: Sequence[str]) -> int:
    """Print what a path holds; 0 done, 2 it cannot be read."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("path", type=Path, metavar="RELEASE|STORE|FILE")
    add_public_key(parser)
    parser.add_argument("--json", action="store_true", help="all of it, for machines")
    args = parser.parse_args(argv)

    def work() -> str:
        report = inspected(args.path, args.public_key)
        return json.dumps(report, indent=2, ensure_ascii=False) if args.json else "\n".join(_lines(report))

    return report_failures(_PROG, args.path, work)


def inspected(path: Path, public_key: Path | None = None) -> Report:
    """What a path holds, as plain values: labels, and numbers, texts or tables of them. FormatError, OSError."""
    if is_release(path):
        key = None if public_key is None else load_public_key(public_key)
        return _release(release_at(path, key), checked=key is not None)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(sorted(READERS))
        raise FormatError(
            str(path), "name", f"a folder of a release, a store, or a file that ends in {known}"
        )
    return reader(path)


def _release(release: Release, *, checked: bool) -> Report:
    root, manifest = release.root, release.manifest
    signature = "none" if root.key_id is None else f"by key {root.key_id}"
    tiles, missing = _tiles(release)
    surfaces = surfaces_from_tiles(tiles["surfaces"])
    links = links_from_tiles(tiles["links"])
    clouds = ("environment_cloud", "road_cloud")
    points = {layer: sum(len(tile.quanta) for tile in tiles[layer]) for layer in clouds}
    report: Report = {
        "region": root.region,
        "version": root.map_version,
        "made": _day(root.time_ns),
        "datum": manifest.datum,
        "epoch": manifest.epoch_year,
        "signature": signature + (", right" if checked else "" if root.key_id is None else ", not checked"),
        "previous": "none" if manifest.previous_sha256 is None else manifest.previous_sha256[:16],
        "surrogate": manifest.surrogate or "no",
        "bytes": int(manifest.size_bytes.sum()),
        "tiles": {
            layer: f"{len(release.tiles(layer))} of {int(manifest.size_bytes[manifest.layer == k].sum()):,} bytes"
            for k, layer in enumerate(LAYERS)
        },
        "surfaces": _surfaces(surfaces),
        "links": _links(links),
        "points": points,
        "lineage": len(manifest.lineage_surface_id),
    }
    return report | ({"tiles not fetched": missing} if missing else {})


def _tiles(release: Release) -> tuple[dict[str, list[Any]], int]:
    """Return all tiles by layer, and the number of tiles not downloaded, in a store of the area around a vehicle."""
    tiles: dict[str, list[Any]] = {layer: [] for layer in LAYERS}
    missing = 0
    for layer in LAYERS:
        for x, y in release.tiles(layer):
            try:
                tiles[layer].append(release.tile(layer, x, y))
            except BlobMissingError:
                missing += 1
    return tiles, missing


def _surfaces(surfaces: RoadSurfaces) -> Report:
    if not len(surfaces):
        return {"count": 0}
    area_m2 = float((4.0 * surfaces.half_length_m * surfaces.half_width_m).sum())
    heights = np.concatenate([grid.ravel() for grid in surfaces.heights_m])
    return {
        "count": len(surfaces),
        "by level": _counts(surfaces.level),
        "area": f"{area_m2 / 1e4:.2f} ha",
        "heights": f"{heights.min():.2f} to {heights.max():.2f} m",
        "sigma": _quantiles(surfaces.sigma_m),
        "vehicles": _quantiles(surfaces.vehicles, "{:.0f}"),
        "seen": f"{_day(int(surfaces.last_seen_ns.min()))} to {_day(int(surfaces.last_seen_ns.max()))}",
    }


def _links(links: RoadLinks) -> Report:
    return {
        "count": len(links),
        "by level": _counts(links.level),
        "nodes": len(np.unique(np.concatenate((links.start_node, links.end_node)))),
        "length": f"{sum(line_length_m(line) for line in links.vertices) / 1e3:.3f} km",
    }


def _lanelet2(path: Path) -> Report:
    source = read_lanelet2(path, strict=False)
    if not source.lanelets:
        raise next(iter(source.unreadable.values()))
    tags = Counter(lanelet.tags.get("subtype", "road") for lanelet in source.lanelets)
    return {
        "format": "Lanelet2",
        "lanelets": dict(tags),
        "left out": dict(source.left_out),
        "unreadable lanelets": len(source.unreadable),
        "points": len(source.row_of),
        "place": _place(source.latitude_rad, source.longitude_rad),
        "length": f"{_lanelets_m(source) / 1e3:.3f} km",
        "ele": f"{source.height_m.min():.2f} to {source.height_m.max():.2f} m",
        "vertical datum": "not stated: --vertical-datum names it",
    }


def _lanelets_m(source: LaneletMap) -> float:
    places = np.column_stack((source.latitude_rad, source.longitude_rad))
    return sum(
        0.5 * line_length_m(places[[source.row_of[ref] for ref in border]])
        for lanelet in source.lanelets
        for border in (lanelet.left, lanelet.right)
    )


def _opendrive(path: Path) -> Report:
    source = read_opendrive(path, strict=False)
    lanes = Counter(lane.kind for road in source.roads for part in road.sections for lane in part.lanes)
    shapes = Counter(part.shape for road in source.roads for part in road.geometries)
    with_roll = sum(bool(len(road.superelevation)) for road in source.roads)
    return {
        "format": "OpenDRIVE",
        "roads": len(source.roads),
        "unreadable roads": len(source.unreadable),
        "junctions": len({connection.junction for connection in source.connections}),
        "lanes": dict(lanes),
        "geometries": dict(shapes),
        "length": f"{sum(road.length_m for road in source.roads) / 1e3:.3f} km",
        "superelevation": f"in {with_roll} roads",
        "geoReference": source.georeference or "none: --georeference names it",
    }


READERS: dict[str, Callable[[Path], Report]] = {".osm": _lanelet2, ".xodr": _opendrive}
"""Ending of a file's name → what it holds."""


def _lines(report: Report) -> list[str]:
    lines = []
    for label, value in report.items():
        if value == {}:
            continue
        if isinstance(value, dict):
            lines += [label, *(f"  {name:<16} {_shown(item)}" for name, item in value.items())]
        else:
            lines.append(f"{label:<18} {_shown(value)}")
    return lines


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}: {item}" for name, item in value.items())
    return f"{value:,}" if isinstance(value, int) else str(value)


def _counts(values: NDArray[np.int64]) -> dict[str, int]:
    names, counts = np.unique(values, return_counts=True)
    return {str(name): int(count) for name, count in zip(names, counts, strict=True)}


def _quantiles(values: NDArray[Any], text: str = "{:.3f} m") -> str:
    shown = [text.format(value) for value in np.quantile(values, _QUANTILES).tolist()]
    return f"median {shown[0]}, 90 % {shown[1]}, most {shown[2]}"


def _place(latitude_rad: NDArray[np.float64], longitude_rad: NDArray[np.float64]) -> str:
    south, north = np.degrees((latitude_rad.min(), latitude_rad.max()))
    west, east = np.degrees((longitude_rad.min(), longitude_rad.max()))
    return f"{south:.5f}° to {north:.5f}°, {west:.5f}° to {east:.5f}°"


def _day(time_ns: int) -> str:
    return text_from_calendar(gpst_from_gps_ns(max(time_ns, 0)))[:16]

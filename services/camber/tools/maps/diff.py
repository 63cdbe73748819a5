"""`camber map diff A B`: what another release has, lacks and says otherwise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.road_map.release import Release
from camber.road_map.road_columns import RoadSurfaces
from camber.schemas.road import LAYERS
from camber.tools.maps.release_at import release_at
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import whole_from
from camber.tools.options.parsers import tool_parser

_PROG = "camber map diff"
_MOVED_M = 1e-3  # chosen: far above the 0.06 mm to which tiles round positions
_HEIGHT_M = 5e-5  # half of what tiles resolve
_EARTH_M = 6.371e6  # mean radius of the earth (IUGG), for approximate distances
_LISTS = (
    "surfaces added", "surfaces removed", "surfaces moved", "other columns changed", "links added", "links removed",
)  # fmt: skip
_LATTICE = np.linspace(0.0, 1.0, 5)

Report = dict[str, Any]


def main(argv: Sequence[str]) -> int:
    """Print the differences of two releases; 0 done, also where there are any, 2 one cannot be read."""
    parser = tool_parser(_PROG, __doc__)
    parser.add_argument("a", type=Path, metavar="A", help="folder of a release, or a store")
    parser.add_argument("b", type=Path, metavar="B", help="the same, later")
    text = "lines of each kind (default: %(default)s)"
    parser.add_argument("--most", type=whole_from(0, 10**9), default=20, metavar="N", help=text)
    parser.add_argument("--json", action="store_true", help="all of it, for machines")
    args = parser.parse_args(argv)

    def work() -> str:
        report = compared(release_at(args.a), release_at(args.b))
        return json.dumps(report, indent=2) if args.json else "\n".join(_lines(report, args.most))

    return report_failures(_PROG, args.b, work)


def compared(a: Release, b: Release) -> Report:
    """The differences as plain values; surfaces and links by their ids, heights as those of `b` less those of `a`."""
    before, after = a.road_surfaces(), b.road_surfaces()
    links = [set(release.road_links().link_id.tolist()) for release in (a, b)]
    changed, moved, otherwise = _changes(before, after)
    old, new = set(before.surface_id.tolist()), set(after.surface_id.tolist())
    return {
        "versions": [f"{each.root.region} {each.root.map_version}" for each in (a, b)],
        "datums": [f"{each.manifest.datum} {each.manifest.epoch_year:g}" for each in (a, b)],
        "surfaces added": sorted(new - old),
        "surfaces removed": sorted(old - new),
        "surfaces moved": moved,
        "heights changed": changed,
        "other columns changed": otherwise,
        "links added": sorted(links[1] - links[0]),
        "links removed": sorted(links[0] - links[1]),
        "lineage": _lineage(b),
        "tiles": _tiles(a, b),
    }


def _changes(before: RoadSurfaces, after: RoadSurfaces) -> tuple[list[Report], list[int], list[int]]:
    """Of surfaces that both have: those with other heights, at another place, with other level, link, σ or counts."""
    _, rows_a, rows_b = np.intersect1d(before.surface_id, after.surface_id, return_indices=True)
    changed, moved, otherwise = [], [], []
    for i, j in zip(rows_a.tolist(), rows_b.tolist(), strict=True):
        surface_id = int(before.surface_id[i])
        difference_m = _heights(after.heights_m[j]) - _heights(before.heights_m[i])
        if np.abs(difference_m).max() > _HEIGHT_M:
            parts = {
                "mean_m": difference_m.mean(),
                "least_m": difference_m.min(),
                "most_m": difference_m.max(),
            }
            rounded = {name: round(float(value), 4) for name, value in parts.items()}
            changed.append({"surface": surface_id, **rounded})
        if _apart_m(before, i, after, j) > _MOVED_M:
            moved.append(surface_id)
        columns = ("level", "link_id", "sigma_m", "vehicles", "last_seen_ns")
        if any(getattr(before, name)[i] != getattr(after, name)[j] for name in columns):
            otherwise.append(surface_id)
    return changed, moved, otherwise


def _heights(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights (5, 5) all over a surface, whatever its grid."""
    p, q = (_LATTICE * (size - 1) for size in grid.shape)
    along = np.stack([np.interp(p, np.arange(grid.shape[0]), column) for column in grid.T], axis=1)
    return np.stack([np.interp(q, np.arange(grid.shape[1]), row) for row in along])


def _apart_m(a: RoadSurfaces, i: int, b: RoadSurfaces, j: int) -> float:
    """How far corners of one rectangle are at most from those of the other, roughly."""
    north_m = _EARTH_M * (b.latitude_rad[j] - a.latitude_rad[i])
    east_m = _EARTH_M * (b.longitude_rad[j] - a.longitude_rad[i]) * np.cos(a.latitude_rad[i])
    size_m = abs(b.half_length_m[j] - a.half_length_m[i]) + abs(b.half_width_m[j] - a.half_width_m[i])
    turn_rad = abs(np.sin(b.yaw_rad[j] - a.yaw_rad[i]))
    radius_m = np.hypot(a.half_length_m[i], a.half_width_m[i])
    return float(np.hypot(east_m, north_m) + size_m + turn_rad * radius_m)


def _lineage(release: Release) -> list[list[int]]:
    """Pairs of a surface and one that it came from, as the later release says."""
    manifest = release.manifest
    return np.column_stack((manifest.lineage_surface_id, manifest.lineage_parent_id)).tolist()  # type: ignore[no-any-return]


def _tiles(a: Release, b: Release) -> list[Report]:
    """Tiles that are not the same in both: layer, numbers, bytes in each, 0 where it has none."""
    tables = [_sizes(release) for release in (a, b)]
    tiles = []
    for place in sorted(set(tables[0]) | set(tables[1])):
        (digest_a, bytes_a), (digest_b, bytes_b) = (table.get(place, ("", 0)) for table in tables)
        if digest_a != digest_b:
            layer, x, y = place
            tiles.append({"layer": LAYERS[layer], "x": x, "y": y, "bytes": [bytes_a, bytes_b]})
    return tiles


def _sizes(release: Release) -> dict[tuple[int, int, int], tuple[str, int]]:
    manifest = release.manifest
    places = zip(manifest.layer.tolist(), manifest.tile_x.tolist(), manifest.tile_y.tolist(), strict=True)
    hashes = (row.tobytes().hex() for row in manifest.sha256)
    return dict(zip(places, zip(hashes, manifest.size_bytes.tolist(), strict=True), strict=True))


def _lines(report: Report, most: int) -> list[str]:
    lines = [f"{' → '.join(report['versions'])}"]
    if len(set(report["datums"])) > 1:
        lines.append(f"datum: {' → '.join(report['datums'])}: heights of different datums are not compared")
    for name in _LISTS:
        ids = report[name]
        lines.append(f"{name:<22} {len(ids)}{': ' + _few(ids, most) if ids else ''}")
    changed = sorted(report["heights changed"], key=lambda row: -abs(row["mean_m"]))
    lines.append(f"{'heights changed':<22} {len(changed)}")
    lines += [
        f"  {row['surface']:<20} {row['mean_m']:+.4f} m ({row['least_m']:+.4f} to {row['most_m']:+.4f})"
        for row in changed[:most]
    ]
    lines.append(f"{'lineage':<22} {len(report['lineage'])} pairs")
    lines += [f"  {child} from {parent}" for child, parent in report["lineage"][:most]]
    sizes = np.array([row["bytes"] for row in report["tiles"]], np.int64).reshape(-1, 2).sum(axis=0)
    lines.append(f"{'tiles changed':<22} {len(report['tiles'])}: {sizes[0]:,} → {sizes[1]:,} bytes")
    lines += [
        f"  {row['layer']} {row['x']}/{row['y']}: {row['bytes'][0]:,} → {row['bytes'][1]:,} bytes"
        for row in report["tiles"][:most]
    ]
    return lines


def _few(ids: Sequence[int], most: int) -> str:
    return ", ".join(map(str, ids[:most])) + (", …" if len(ids) > most else "")

"""`camber map export RELEASE --to FORMAT --out PATH`: a release for other programs.

geotiff     one file for each level, LEVEL.tif in a folder: band 1 heights above the ellipsoid, band 2 their σ
geojson     one file: surfaces with all their columns, and links; `camber map build geojson` reads it again
geoparquet  a folder: surfaces.parquet and links.parquet with all their columns
pmtiles     one file: vector tiles for browsers and QGIS
pcd         a folder for Autoware: the clouds in square cells, their metadata, and how coordinates are projected
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.mgrs import utm_zone
from camber.formats.map_exchange.pcd import PointCloud, pcd_bytes
from camber.formats.map_exchange.vertical_datum import aligned_to_wgs84, crs_of
from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.release import Release
from camber.road_map.release_files import write_file
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.tile_grid import tile_frame, tiles_of
from camber.schemas.road import CloudTile, Layer
from camber.tools.maps.geojson import geojson_text
from camber.tools.maps.geoparquet import export_geoparquet
from camber.tools.maps.importers.height_raster import quiet_rasterio
from camber.tools.maps.importers.surfaces_along import Floats, Integers
from camber.tools.maps.release_at import add_release, named_release
from camber.tools.maps.tile_archive import export_pmtiles
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import number_from
from camber.tools.options.output_check import check_output_file, check_output_folder
from camber.tools.options.parsers import tool_parser

_PROG = "camber map export"
_MOST_CELLS = 200_000_000  # chosen: bounds memory
_NODATA = -9999.0  # chosen: the usual value of elevation models, no height on earth
_CLOUDS: tuple[Layer, ...] = ("environment_cloud", "road_cloud")


def main(argv: Sequence[str]) -> int:
    """Export one release; 0 done, 2 an error, reported in one line."""
    parser = tool_parser(_PROG, __doc__)
    add_release(parser)
    parser.add_argument("--to", required=True, choices=sorted(_EXPORTERS))
    parser.add_argument("--out", type=Path, required=True, metavar="PATH")
    text = "side of a cell: geotiff 0.5, pcd 20 where it is not given"
    parser.add_argument("--cell-m", type=number_from(0.01, 1e4, "m"), metavar="D", help=text)
    args = parser.parse_args(argv)

    def work() -> str:
        check, export = _EXPORTERS[args.to]
        check(args.out)  # before a release of minutes is read
        return "\n".join(export(named_release(args), str(args.release), args.out, args.cell_m))

    return report_failures(_PROG, args.out, work)


def export_geojson(release: Release, name: str, out: Path, _: float | None) -> list[str]:
    """Write one file."""
    datum = crs_of(release.manifest.datum, name, "datum", "one that PROJ knows").geodetic_crs.name
    surfaces, links = release.road_surfaces(), release.road_links()
    write_file(out, geojson_text(surfaces, links).encode())
    is_wgs84 = datum == "WGS 84" or aligned_to_wgs84(datum)
    remark = "" if is_wgs84 else f"; positions are of {datum}, which GeoJSON cannot express"
    return [f"{out}: {len(surfaces)} surfaces, {len(links)} links{remark}"]


def export_geotiff(release: Release, name: str, out: Path, cell_m: float | None) -> list[str]:
    """Write a file for each level. Raises FormatError for a map too large for cells of this size.

    Latitude, longitude and ellipsoidal height are the one system of three dimensions that GeoTIFF has keys for: a
    projected one would lose its vertical part to a file beside it.
    """
    surfaces, side_m = release.road_surfaces(), cell_m or 0.5
    if not len(surfaces):
        raise FormatError(name, "surfaces", "at least one")
    expected = "one that PROJ knows (WGS84, ITRF2014, …)"
    crs = crs_of(release.manifest.datum, name, "datum", expected).geodetic_crs.to_3d()
    latitude_rad = float(np.median(surfaces.latitude_rad))
    cell_rad = np.array([side_m / prime_vertical_radius_m(latitude_rad) / np.cos(latitude_rad),
                         side_m / meridian_radius_m(latitude_rad)])  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    lines = []
    for level in np.unique(surfaces.level).tolist():
        path = out / f"level_{level}.tif"
        rows = np.flatnonzero(surfaces.level == level)
        known = _write_level(path, surfaces, rows, crs=crs, cell_rad=cell_rad)
        lines.append(f"{path}: {known} cells of {side_m:g} m with a height, {crs.name}, ellipsoidal heights")
    return lines


def _write_level(path: Path, surfaces: RoadSurfaces, rows: Integers, *, crs: Any, cell_rad: Floats) -> int:
    """`cell_rad`: sides of a cell along longitude and latitude. Returns how many cells are known."""
    import rasterio

    low, high = _boxes(surfaces, rows, cell_rad)
    corner = np.floor(low.min(axis=0))
    size = np.ceil(high.max(axis=0)).astype(np.int64) - corner.astype(np.int64)
    if size[0] * size[1] > _MOST_CELLS:
        expected = f"at most {_MOST_CELLS} cells: a larger --cell-m"
        raise FormatError(str(path), "size", expected, actual=f"{size[0]} × {size[1]}")
    weight, height, variance = (np.zeros(size[::-1]) for _ in range(3))
    heights = SurfaceHeights(surfaces)
    for row, box_low, box_high in zip(rows.tolist(), low - corner, high - corner, strict=True):
        first, last = np.floor(box_low).astype(np.int64), np.ceil(box_high).astype(np.int64)
        axes = np.arange(first[0], last[0]), np.arange(first[1], last[1])
        column, line = (a.ravel() for a in np.meshgrid(*axes))
        longitude, latitude = ((corner + np.column_stack((column, line)) + 0.5) * cell_rad).T
        surface_m, outside = heights.heights_m(np.full(len(column), row), latitude, longitude)
        inside = outside == 0.0
        share = 1.0 / max(float(surfaces.sigma_m[row]), 1e-3) ** 2
        at = size[1] - 1 - line[inside], column[inside]  # from the north downwards
        weight[at] += share
        height[at] += share * surface_m[inside]
        # Surfaces that overlap are of one survey: lying there twice makes nothing surer.
        variance[at] = np.maximum(variance[at], surfaces.sigma_m[row] ** 2)
    known = weight > 0.0
    bands = np.full((2, *weight.shape), _NODATA, np.float32)
    bands[0][known] = height[known] / weight[known]
    bands[1][known] = np.sqrt(variance[known])
    dx, dy = np.degrees(cell_rad).tolist()
    transform = rasterio.Affine(dx, 0.0, corner[0] * dx, 0.0, -dy, (corner[1] + size[1]) * dy)
    options = {"compress": "deflate", "tiled": True, "blockxsize": 256, "blockysize": 256, "nodata": _NODATA}
    with quiet_rasterio(), rasterio.Env(GDAL_PAM_ENABLED="NO"), rasterio.open(
        path, "w", driver="GTiff", width=int(size[0]), height=int(size[1]), count=2, dtype="float32",
        crs=crs.to_wkt(), transform=transform, **options,
    ) as file:  # fmt: skip
        file.write(bands)
        file.set_band_description(1, "height above the ellipsoid [m]")
        file.set_band_description(2, "sigma of the height [m]")
    return int(known.sum())


def _boxes(surfaces: RoadSurfaces, rows: Integers, cell_rad: Floats) -> tuple[Floats, Floats]:
    """South-western and north-eastern corners (n, 2) of boxes that hold the surfaces, however they are turned; cells
    of longitude and latitude."""
    longitude, latitude = surfaces.longitude_rad[rows], surfaces.latitude_rad[rows]
    reach_m = np.hypot(surfaces.half_length_m[rows], surfaces.half_width_m[rows])
    # Both radii of curvature are least at the equator.
    reach = 1.01 * np.column_stack(
        (reach_m / prime_vertical_radius_m(0.0) / np.cos(latitude), reach_m / meridian_radius_m(0.0))
    )
    centre = np.column_stack((longitude, latitude))
    return (centre - reach) / cell_rad, (centre + reach) / cell_rad


def export_pcd(release: Release, name: str, out: Path, cell_m: float | None) -> list[str]:
    """Write the cells that Autoware's map loaders take. Raises FormatError for a release without clouds."""
    side_m = cell_m or 20.0
    tiles = [t for layer in _CLOUDS for xy in release.tiles(layer) if (t := release.cloud_tile(layer, *xy))]
    places = [_points(tile) for tile in tiles]
    points = np.concatenate([np.zeros((0, 3)), *places])
    if not len(points):
        raise FormatError(name, "clouds", "points of an environment or a road")
    import pyproj

    origin_deg = np.floor(np.degrees(points[:, :2].min(axis=0)) * 100.0) / 100.0
    zone = utm_zone(*origin_deg.tolist())
    utm = pyproj.Proj(proj="utm", zone=zone, south=bool(origin_deg[0] < 0.0), ellps="WGS84")
    east0, north0 = utm(origin_deg[1], origin_deg[0])
    east, north = utm(np.degrees(points[:, 1]), np.degrees(points[:, 0]))
    plane = np.column_stack((east - east0, north - north0, points[:, 2]))
    cell = np.floor(plane[:, :2] / side_m).astype(np.int64)
    order = np.lexsort((cell[:, 1], cell[:, 0]))
    cells, first = np.unique(cell[order], axis=0, return_index=True)
    metadata = [f"x_resolution: {side_m}", f"y_resolution: {side_m}"]
    for (x, y), part in zip((cells * side_m).tolist(), np.split(plane[order], first[1:]), strict=True):
        cell_name = f"{x:g}_{y:g}.pcd"
        data = pcd_bytes(PointCloud(points_m=part.astype(np.float32)))
        write_file(out / "pointcloud_map" / cell_name, data)
        metadata.append(f"{cell_name}: [{x:g}, {y:g}]")
    projector = [
        "projector_type: LocalCartesianUTM",
        "vertical_datum: WGS84",
        "map_origin:",
        f"  latitude: {origin_deg[0]:.2f}",
        f"  longitude: {origin_deg[1]:.2f}",
        "  altitude: 0.0",
    ]
    write_file(out / "pointcloud_map_metadata.yaml", ("\n".join(metadata) + "\n").encode())
    write_file(out / "map_projector_info.yaml", ("\n".join(projector) + "\n").encode())
    return [f"{out}: {len(points)} points in {len(cells)} cells of {side_m:g} m"]


def _points(tile: CloudTile) -> Floats:
    """Latitude, longitude [rad] and ellipsoidal height [m] (n, 3) of the points that are in no other tile.

    Of those within half a quantum of a border, which two tiles may place differently, some are in neither.
    """
    about = tile.quanta * tile.resolution_m
    latitude, longitude, _ = tile_frame(tile.x, tile.y).geodetic_from_east_north_array(about[:, :2], 0.0)
    x, y = tiles_of(latitude, longitude)
    in_tile = (x == tile.x) & (y == tile.y)
    points: Floats = np.column_stack((latitude, longitude, about[:, 2] + tile.base_height_m))[in_tile]
    return points


def _check_geotiff_folder(out: Path) -> None:
    check_output_folder(out, "level_*.tif")


def _check_geoparquet_folder(out: Path) -> None:
    check_output_folder(out, "surfaces.parquet")


def _check_pcd_folder(out: Path) -> None:
    check_output_folder(out, "map_projector_info.yaml", "pointcloud_map")


_Exporter = Callable[[Release, str, Path, float | None], list[str]]
_EXPORTERS: dict[str, tuple[Callable[[Path], None], _Exporter]] = {
    "geojson": (check_output_file, export_geojson),  # checked too, as it may have been edited
    "geoparquet": (_check_geoparquet_folder, export_geoparquet),
    "geotiff": (_check_geotiff_folder, export_geotiff),
    "pcd": (_check_pcd_folder, export_pcd),
    "pmtiles": (check_output_file, export_pmtiles),
}

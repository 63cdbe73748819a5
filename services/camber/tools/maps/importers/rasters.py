"""`camber map build geotiff`: heights of a GeoTIFF (or COG) become surfaces along roads that are given.

A raster has one height at each place: only roads of one level get surfaces of it. Where it has no data there are none.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import (
    VerticalDatum,
)
from camber.road_map.road_columns import RoadSurfaces, select_links
from camber.road_map.tile_checks import MAX_LEVEL
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.checks.height_check import (
    PLACES,
    SourceHeights,
    add_check_arguments,
    checked_heights,
    seed_of,
)
from camber.tools.maps.importers.checks.left_out import add_loss_arguments
from camber.tools.maps.importers.checks.level_heights import (
    add_flat_arguments,
    check_raster_slopes,
    flat_surrogate,
    level_sigma_of,
)
from camber.tools.maps.importers.given_roads import add_road_arguments, given_roads
from camber.tools.maps.importers.height_options import add_height_arguments, sigma_of, vertical_of
from camber.tools.maps.importers.height_raster import HeightRaster, quiet_rasterio
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from camber.tools.options.number_options import whole_from
from camber.tools.options.parsers import add_with_default

_SPACING_M = (0.25, 4.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only a raster needs."""
    parser.add_argument("file", type=Path, metavar="FILE.tif")
    text = "that holds heights in metres"
    add_with_default(parser, "--band", 1, text, type=whole_from(1, 65_535))
    text, levels = "of the roads that the raster shows", whole_from(-MAX_LEVEL, MAX_LEVEL)
    add_with_default(parser, "--level", 0, text, type=levels)
    add_road_arguments(parser)
    add_height_arguments(parser)
    add_loss_arguments(parser)
    add_flat_arguments(parser)
    add_check_arguments(parser)


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces along the roads of one level; all links are kept."""
    file = str(args.file)
    with HeightRaster.open(args.file, args.band, args.datum) as raster:
        roads, remarks = given_roads(args, bounds_rad=raster.bounds_rad())
        vertical = vertical_of(args, file, raster.vertical)
        sigma_m = math.hypot(sigma_of(args, vertical), level_sigma_of(args) or 0.0)

        def ground(latitude: Floats, longitude: Floats, _: Integers) -> tuple[Floats, Floats]:
            height_m = raster.heights_m(latitude, longitude)
            known = np.isfinite(height_m)
            height_m[known] = vertical.ellipsoidal_m(latitude[known], longitude[known], height_m[known], file)
            return height_m, np.where(known, sigma_m, np.nan)

        spacing_m = args.spacing_m or min(max(raster.cell_m, _SPACING_M[0]), _SPACING_M[1])
        shown = _of_level(roads, args.level)
        surfaces = surfaces_along(shown, ground, spacing_m=spacing_m, seen_ns=args.surveyed_ns)
    if not len(surfaces):
        raise FormatError(file, "heights", f"some along the roads of level {args.level} in {args.roads}")
    if not args.flat:
        check_raster_slopes(surfaces, file)
    bare = len(shown.links) - len(np.unique(surfaces.link_id))
    remarks.append(f"{file}: heights: {vertical.how}; every {spacing_m:g} m")
    if len(shown.links) < len(roads.links):
        remarks.append(f"{len(roads.links) - len(shown.links)} links of other levels get no surfaces")
    if bare:
        remarks.append(f"{bare} links lie where the raster has no data: no surfaces")
    seed = seed_of(args)
    source = cell_heights(args, surfaces, vertical, np.random.default_rng(seed))
    # Of a rough raster σ has the departure of the grids from it, which is random: 0.3 % of a normal one are beyond.
    remarks.append(checked_heights(surfaces, source, seed=seed, file=file, most_beyond=0.01))
    surrogate = flat_surrogate(args, vertical.surrogate)
    return BuiltMap(surfaces=surfaces, links=roads.links, surrogate=surrogate, remarks=remarks)


def cell_heights(
    args: argparse.Namespace, surfaces: RoadSurfaces, vertical: VerticalDatum, rng: np.random.Generator
) -> SourceHeights:
    """Heights of single cells at the middles of surfaces, for the middles of the cells, as the file has them."""
    import pyproj
    import rasterio
    from rasterio.windows import Window

    rows = rng.integers(len(surfaces), size=PLACES)
    cells: list[tuple[float, float, float, int]] = []
    with quiet_rasterio(), rasterio.open(args.file) as dataset:
        crs: Any = pyproj.CRS(dataset.crs.to_wkt())
        plane = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()
        to_raster = pyproj.Transformer.from_crs(plane.geodetic_crs.to_2d(), plane, always_xy=True)
        scale, offset = dataset.scales[args.band - 1], dataset.offsets[args.band - 1]
        places = to_raster.transform(*np.degrees((surfaces.longitude_rad[rows], surfaces.latitude_rad[rows])))
        for x, y, link in zip(*places, surfaces.link_id[rows].tolist(), strict=True):
            row, column = dataset.index(x, y)
            cell = dataset.read(args.band, window=Window(column, row, 1, 1), masked=True)
            if cell.count() == 1 and np.isfinite(cell[0, 0]):
                cells.append((*dataset.xy(row, column), float(cell[0, 0]) * scale + offset, link))
        at = np.array(cells).reshape(-1, 4)[:, :3]
        longitude, latitude = np.radians(to_raster.transform(at[:, 0], at[:, 1], direction="INVERSE"))
    degrees = np.degrees(np.column_stack((latitude, longitude))).tolist()
    return SourceHeights(
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=vertical.ellipsoidal_m(latitude, longitude, at[:, 2], str(args.file)),
        links=[[cell[3]] for cell in cells],
        names=[f"latitude {a:.7f}°, longitude {b:.7f}°" for a, b in degrees],
    )


def _of_level(roads: RoadCentreLines, level: int) -> RoadCentreLines:
    rows = np.flatnonzero(roads.links.level == level)
    return RoadCentreLines(select_links(roads.links, rows.tolist()), roads.half_width_m[rows])

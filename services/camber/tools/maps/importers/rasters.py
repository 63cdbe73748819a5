"""`camber map build geotiff`: heights of a GeoTIFF (or COG) become surfaces along roads that are given.

A raster has one height at each place: only roads of one level get surfaces of it. Where it has no data there are none.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import (
    ELLIPSOIDAL,
    FIELD,
    VerticalDatum,
    aligned_to_wgs84,
    crs_of,
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
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from camber.tools.options.number_options import whole_from
from camber.tools.options.parsers import add_with_default

_WINDOW = 1024  # chosen: cells read at a time, 8 MB
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
    roads, remarks = given_roads(args)
    with HeightRaster.open(args.file, args.band, args.datum) as raster:
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


@dataclass(frozen=True, eq=False, kw_only=True)
class HeightRaster:
    """A band of an open file; `vertical` names what its heights are above, None where the file does not say it."""

    file: str
    vertical: str | None
    cell_m: float
    _dataset: Any
    _band: int
    _to_raster: Any

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path, band: int, datum: str) -> Iterator[HeightRaster]:
        """Raises FormatError for what is no raster of heights in metres whose positions are of `datum`."""
        import rasterio

        file = str(path)
        path.stat()
        with contextlib.ExitStack() as stack:
            stack.enter_context(quiet_rasterio())
            try:
                dataset = stack.enter_context(rasterio.open(path))
            except (rasterio.errors.RasterioError, ValueError) as error:
                raise FormatError(file, "raster", f"a GeoTIFF ({_line(error)})") from None
            if not 1 <= band <= dataset.count:
                raise FormatError(file, "band", f"1 to {dataset.count}", actual=str(band))
            if dataset.crs is None:
                raise FormatError(file, "CRS", "a coordinate reference system")
            crs = crs_of(dataset.crs.to_wkt(version="WKT2_2019"), file, "CRS", "one that PROJ knows")
            horizontal, vertical = horizontal_and_vertical(crs, file)
            yield cls(
                file=file,
                vertical=vertical,
                cell_m=_cell_m(dataset, horizontal),
                _dataset=dataset,
                _band=band,
                _to_raster=to_horizontal(horizontal, datum, file),
            )

    def heights_m(self, latitude_rad: Floats, longitude_rad: Floats) -> Floats:
        """Bilinear between the middles of cells (n,); NaN where one of the four has no data, and beyond the raster."""
        x, y = self._to_raster.transform(np.degrees(longitude_rad), np.degrees(latitude_rad))
        a = ~self._dataset.transform
        column, row = a.a * x + a.b * y + a.c - 0.5, a.d * x + a.e * y + a.f - 0.5
        first = np.floor(np.column_stack((row, column)))
        size = np.array([self._dataset.height, self._dataset.width])
        inside = np.isfinite(first).all(axis=1) & (first >= 0).all(axis=1) & (first + 1 < size).all(axis=1)
        height_m = np.full(len(first), np.nan)
        index = first[inside].astype(np.int64)
        share = np.column_stack((row, column))[inside] - index
        windows = index // _WINDOW
        interpolated_m = np.full(len(index), np.nan)
        for window in np.unique(windows, axis=0):
            mine = np.flatnonzero((windows == window).all(axis=1))
            begin = window * _WINDOW
            cells = self._cells(*begin, *np.minimum(_WINDOW + 1, size - begin))
            i, j = (index[mine] - begin).T
            u, v = share[mine].T
            upper = (1.0 - v) * cells[i, j] + v * cells[i, j + 1]
            lower = (1.0 - v) * cells[i + 1, j] + v * cells[i + 1, j + 1]
            interpolated_m[mine] = (1.0 - u) * upper + u * lower
        height_m[inside] = interpolated_m
        return height_m

    def _cells(self, row: int, column: int, rows: int, columns: int) -> Floats:
        import rasterio
        from rasterio.windows import Window

        window = Window(int(column), int(row), int(columns), int(rows))
        try:
            cells = self._dataset.read(self._band, window=window, masked=True)
        except rasterio.errors.RasterioError as error:
            raise FormatError(self.file, "raster", f"a whole file ({_line(error)})") from None
        scale, offset = self._dataset.scales[self._band - 1], self._dataset.offsets[self._band - 1]
        known: Floats = np.ma.filled(cells.astype(np.float64) * scale + offset, np.nan)
        known[~np.isfinite(known)] = np.nan
        return known


@contextlib.contextmanager
def quiet_rasterio() -> Iterator[None]:
    """No warnings of what is looked at here: a file without a place, and rasterio's own use of another package."""
    import rasterio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        yield


def horizontal_and_vertical(crs: Any, file: str) -> tuple[Any, str | None]:
    """The horizontal part of a reference system, and the name of the vertical one where there is one, in metres."""
    horizontal, vertical = crs, None
    if crs.is_compound:
        horizontal, below = crs.sub_crs_list
        authority = below.to_authority(min_confidence=100)
        vertical = ":".join(authority) if authority else below.to_wkt()
        axes = below.axis_info
    else:
        axes = [axis for axis in crs.axis_info if axis.direction in ("up", "down")]
        if axes:
            horizontal, vertical = crs.to_2d(), ELLIPSOIDAL
    for axis in axes:
        if axis.unit_conversion_factor != 1.0 or axis.direction != "up":
            raise FormatError(file, FIELD, "metres upwards", actual=f"{axis.unit_name} {axis.direction}")
    if not (horizontal.is_geographic or horizontal.is_projected):
        raise FormatError(file, "CRS", "a geographic or projected one", actual=crs.name)
    return horizontal, vertical


def to_horizontal(horizontal: Any, datum: str, file: str) -> Any:
    """From longitude, latitude [deg] of the release's datum, which must be the raster's own."""
    import pyproj

    raster_crs = horizontal.geodetic_crs
    wanted = crs_of(datum, file, "datum", "one that PROJ knows (WGS84, ITRF2014, ETRS89, …)").geodetic_crs
    both = raster_crs.name, wanted.name
    if raster_crs.datum != wanted.datum and both[0] != both[1] and not all(map(aligned_to_wgs84, both)):
        expected = f"{wanted.name}, the release's --datum; warp the raster, or name its own"
        raise FormatError(file, "datum", expected, actual=raster_crs.name)
    return pyproj.Transformer.from_crs(raster_crs.to_2d(), horizontal, always_xy=True)


def _cell_m(dataset: Any, horizontal: Any) -> float:
    """The side of a cell, about."""
    a = dataset.transform
    side = math.sqrt(abs(a.a * a.e - a.b * a.d))
    unit = horizontal.axis_info[0].unit_conversion_factor
    if horizontal.is_geographic:
        middle_deg = a.d * 0.5 * dataset.width + a.e * 0.5 * dataset.height + a.f
        return float(side * unit * 6.37e6) * math.sqrt(max(math.cos(middle_deg * unit), 0.01))
    return float(side * unit)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__

"""Heights of a raster at places between its cells, read a window at a time.

A raster has one height at each place, above what its reference system says.
"""

from __future__ import annotations

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
    aligned_to_wgs84,
    crs_of,
)
from camber.tools.maps.importers.lanes import Floats

_EDGE_PLACES = 21  # chosen: an edge of 100 km is curved between them by 1.3 m at 70° of latitude
_WINDOW = 1024  # chosen: cells read at a time, 8 MB


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
        file = str(path)
        with opened_raster(path) as dataset:
            if not 1 <= band <= dataset.count:
                raise FormatError(file, "band", f"1 to {dataset.count}", actual=str(band))
            yield cls.of_dataset(dataset, file=file, band=band, datum=datum)

    @classmethod
    def of_dataset(cls, dataset: Any, *, file: str, band: int, datum: str) -> HeightRaster:
        """A band of an open dataset; raises FormatError as `open` does."""
        if dataset.crs is None:
            raise FormatError(file, "CRS", "a coordinate reference system")
        crs = crs_of(dataset.crs.to_wkt(version="WKT2_2019"), file, "CRS", "one that PROJ knows")
        horizontal, vertical = horizontal_and_vertical(crs, file)
        return cls(
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

    def bounds_rad(self) -> tuple[float, float, float, float]:
        """South, west, north and east [rad] of a raster that does not reach over 180° of longitude."""
        share = np.linspace(0.0, 1.0, _EDGE_PLACES)
        zero, one = np.zeros_like(share), np.ones_like(share)
        column = np.concatenate((share, share, zero, one)) * self._dataset.width
        row = np.concatenate((zero, one, share, share)) * self._dataset.height
        a = self._dataset.transform
        x, y = a.a * column + a.b * row + a.c, a.d * column + a.e * row + a.f
        longitude_deg, latitude_deg = self._to_raster.transform(x, y, direction="INVERSE")
        sides = np.min(latitude_deg), np.min(longitude_deg), np.max(latitude_deg), np.max(longitude_deg)
        south, west, north, east = np.radians(sides).tolist()
        return south, west, north, east

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
def opened_raster(path: Path) -> Iterator[Any]:
    """A file as rasterio's dataset; FormatError where it is none that it reads, OSError where it cannot be read."""
    import rasterio

    path.stat()
    with contextlib.ExitStack() as stack:
        stack.enter_context(quiet_rasterio())
        try:
            dataset = stack.enter_context(rasterio.open(path))
        except (rasterio.errors.RasterioError, ValueError) as error:
            raise FormatError(str(path), "raster", f"a GeoTIFF ({_line(error)})") from None
        yield dataset


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

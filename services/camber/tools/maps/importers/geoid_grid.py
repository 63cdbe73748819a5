"""Heights above the geoid become ellipsoidal with the grid of a file (`--geoid FILE`), bilinear between its nodes.

For a grid that PROJ does not find, or does not know yet (JPGEO2024 of JGD2024). GTX, ISG and GSIGEO's .asc name no
datum: theirs is taken to be the release's, for which the user is responsible. That of a GeoTIFF must be the release's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import MAX_UNDULATION_M, VerticalDatum, crs_of
from camber.tools.maps.importers.height_raster import HeightRaster, opened_raster, quiet_rasterio
from camber.tools.maps.importers.lanes import Floats

_WITHOUT_DATUM = frozenset({".gtx", ".isg"})
_GSIGEO_UNKNOWN_M = 999.0  # source: format of GSIGEO2011, where there is no geoid
_ARCSECONDS = 3600  # of a degree
_STEP_ROUNDING_DEG = 0.5e-6  # source: format of GSIGEO2011, six decimals
_GSIGEO_HEAD_FIELDS = 7  # source: format of GSIGEO2000 and GSIGEO2011, first line up to its kind


def geoid_grid(path: Path, datum: str) -> VerticalDatum:
    """Return the conversion with the grid of a file; FormatError for another datum or what is no geoid grid."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    opened = _opener(path, datum)

    def convert(latitude_rad: Floats, longitude_rad: Floats, height_m: Floats) -> Floats:
        with opened() as grid:
            undulation_m = grid.heights_m(latitude_rad, longitude_rad)
        wrong = np.abs(undulation_m) > MAX_UNDULATION_M
        if wrong.any():
            expected = f"heights of a geoid, at most {MAX_UNDULATION_M:g} m from the ellipsoid"
            raise FormatError(str(path), "grid", expected, actual=f"{undulation_m[wrong][0]:.3f} m")
        return height_m + undulation_m

    with opened():
        return VerticalDatum(how=f"geoid grid {path.name}, SHA-256 {digest}…", convert=convert)


def _opener(path: Path, datum: str) -> Callable[[], AbstractContextManager[HeightRaster]]:
    """Return what opens the grid. GSIGEO's text is read once, into a file in memory."""
    kind = path.suffix.lower()
    dataset_of = _gsigeo_in_memory(path, datum).open if kind == ".asc" else partial(opened_raster, path)

    @contextmanager
    def opened() -> Iterator[HeightRaster]:
        with quiet_rasterio(), dataset_of() as dataset:
            grid_datum = dataset.crs.to_wkt() if kind in _WITHOUT_DATUM and dataset.crs else datum
            yield HeightRaster.of_dataset(dataset, file=str(path), band=1, datum=grid_datum)

    return opened


def _gsigeo_in_memory(path: Path, datum: str) -> Any:
    """Return rasterio's MemoryFile with the grid as a GeoTIFF."""
    import rasterio

    nodes_m, (south_deg, west_deg), (latitude_step_deg, longitude_step_deg) = read_gsigeo(path)
    rows, columns = nodes_m.shape
    crs = crs_of(datum, str(path), "datum", "one that PROJ knows (WGS84, ITRF2014, ETRS89, …)").geodetic_crs
    form: dict[str, Any] = {
        "driver": "GTiff",
        "height": rows,
        "width": columns,
        "count": 1,
        "dtype": "float64",
        "nodata": np.nan,
        "crs": crs.to_2d().to_wkt(),
        "transform": rasterio.Affine(
            longitude_step_deg,
            0.0,
            west_deg - 0.5 * longitude_step_deg,
            0.0,
            -latitude_step_deg,
            south_deg + (rows - 0.5) * latitude_step_deg,
        ),
    }
    memory = rasterio.MemoryFile()
    with quiet_rasterio(), memory.open(**form) as written:
        written.write(nodes_m[::-1], 1)
    return memory


def read_gsigeo(path: Path) -> tuple[Floats, tuple[float, float], tuple[float, float]]:
    """Read undulations (rows from the south, columns from the west) [m], NaN where unknown, of GSIGEO's ASCII format.

    Also returned: latitude and longitude of the south-western node and the steps between nodes [deg]. The first line
    has these, the number of rows and columns, a kind and a version; steps are rounded there (0.016667 for one minute),
    so one that is a whole number of arcseconds to their rounding is taken as that. FormatError for anything else.
    Source: Geospatial Information Authority of Japan, format of GSIGEO2000 and GSIGEO2011.
    """
    file = str(path)
    head, _, body = path.read_text("ascii", "replace").partition("\n")
    fields = head.split()
    expected = "south, west, two steps [deg], rows, columns, kind and version of a GSIGEO grid"
    try:
        south_deg, west_deg, *steps_deg = map(float, fields[:4])
        rows, columns = map(int, fields[4:6])
    except ValueError:
        raise FormatError(file, "first line", expected, actual=head, line_number=1) from None
    plausible = (
        abs(south_deg) <= 90.0 and abs(west_deg) <= 360.0 and all(0.0 < step < 10.0 for step in steps_deg)
    )
    if len(fields) < _GSIGEO_HEAD_FIELDS or not plausible or min(rows, columns) < 2:
        raise FormatError(file, "first line", expected, actual=head, line_number=1)
    try:
        nodes_m = np.array(body.split(), np.float64)
    except ValueError:
        raise FormatError(file, "undulations", "numbers [m]") from None
    if nodes_m.size != rows * columns:
        raise FormatError(file, "undulations", f"{rows * columns}, rows by columns", actual=str(nodes_m.size))
    nodes_m[nodes_m == _GSIGEO_UNKNOWN_M] = np.nan
    latitude_step_deg, longitude_step_deg = map(_exact_step_deg, steps_deg)
    return nodes_m.reshape(rows, columns), (south_deg, west_deg), (latitude_step_deg, longitude_step_deg)


def _exact_step_deg(step_deg: float) -> float:
    parts = max(round(1.0 / step_deg), 1)
    is_rounded = _ARCSECONDS % parts == 0 and abs(1.0 / parts - step_deg) <= _STEP_ROUNDING_DEG
    return 1.0 / parts if is_rounded else step_deg

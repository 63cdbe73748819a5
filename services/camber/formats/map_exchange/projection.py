"""Convert coordinates in a map's projection to latitude and longitude, without changing the datum."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import ELLIPSOIDAL, aligned_to_wgs84, crs_of

Floats = NDArray[np.float64]

GEOREFERENCE_OPTION = "--georeference with one ('+proj=tmerc +lat_0=… +lon_0=… +datum=WGS84')"
"""What to do about a map that names no projection."""

_GEOID_GRID = re.compile(r"\+geoidgrids=(\S+)")
_VERTICAL_PARTS = re.compile(r"\s*\+(geoidgrids|vunits|vto_meter)=\S+")
_VERTICAL_UNIT = re.compile(r"\+(?:vunits|vto_meter)=(\S+)")
_VERTICAL_OF_GRID = {
    "@null": ELLIPSOIDAL,
    "egm96_15.gtx": "EPSG:5773",
    "us_nga_egm96_15.tif": "EPSG:5773",
    "egm08_25.gtx": "EPSG:3855",
    "us_nga_egm08_25.tif": "EPSG:3855",
}


@dataclass(frozen=True)
class Projection:
    """Conversion of x, y [m] to latitude and longitude [rad], and the vertical datum if the text names it."""

    geodetic: Callable[[Floats, Floats], tuple[Floats, Floats]]
    vertical: str | None


def projection_of(text: str, datum: str, file: str, field: str) -> Projection:
    """Parse a projection in PROJ or WKT notation, whose datum must be the release's `datum`.

    FormatError for an invalid text or another datum: positions are not transformed between datums. A text with only an
    ellipsoid is taken to be in the release's datum.
    """
    import pyproj

    unit = _VERTICAL_UNIT.search(text)
    if unit is not None and unit[1] not in ("m", "1", "1.0"):
        raise FormatError(file, f"{field}, vunits", "m", actual=unit[1])
    grid = _GEOID_GRID.search(text)
    # Some writers leave only +lat_0 and +lon_0: then the file does not say what the coordinates are.
    expected = f"a projection as PROJ knows it, or {GEOREFERENCE_OPTION}"
    crs = crs_of(_VERTICAL_PARTS.sub("", text), file, field, expected)
    vertical = None if grid is None else _VERTICAL_OF_GRID.get(grid[1], f"above {grid[1]}")
    if crs.is_compound:
        above = crs.sub_crs_list[1]
        authority = above.to_authority()
        vertical = ":".join(authority) if authority else above.name
    elif crs.is_projected and len(crs.axis_info) == 3:
        vertical = ELLIPSOIDAL
    flat = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()
    if not flat.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in flat.axis_info):
        raise FormatError(file, field, "a projection in metres", actual=text)
    geodetic_crs = flat.geodetic_crs
    of_map = crs_of(datum, file, "datum", "one that PROJ knows (WGS84, ITRF2014, ETRS89, …)").geodetic_crs
    name = geodetic_crs.name if geodetic_crs.name != "unknown" else geodetic_crs.datum.name
    name = "WGS 84" if name == "World Geodetic System 1984" else name
    same = name == of_map.name or (aligned_to_wgs84(name) and aligned_to_wgs84(of_map.name))
    if not same and not name.lower().startswith("unknown"):
        raise FormatError(file, f"{field}, datum", f"{datum}, the map's (--datum)", actual=name)
    inverse = pyproj.Transformer.from_crs(flat, geodetic_crs, always_xy=True)

    def geodetic(x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        longitude, latitude = inverse.transform(x_m, y_m)
        if not (
            np.isfinite(longitude).all() and np.isfinite(latitude).all() and (np.abs(latitude) < 85.0).all()
        ):
            raise FormatError(file, field, "coordinates within the projection's reach")
        return np.radians(latitude), np.radians(longitude)

    return Projection(geodetic, vertical)

"""Latitude and longitude of metres within the 100 km square of an MGRS code, as Autoware's local coordinates.

Source: NGA.SIG.0012_2.0.0_UTMUPS, "The Universal Grids and the Transverse Mercator and Polar Stereographic Map
Projections" (2014), chapter 10: letters of columns repeat every three zones from A, J, S; letters of rows every
2,000 km from A in odd zones and F in even ones; bands of 8° from C at 80° south.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import Any

from camber.formats.errors import FormatError

_CODE = re.compile(r"(\d{1,2})([C-HJ-NP-X])([A-HJ-NP-Z])([A-HJ-NP-V])(\d*)$")
_COLUMNS, _ROWS, _BANDS = "ABCDEFGHJKLMNPQRSTUVWXYZ", "ABCDEFGHJKLMNPQRSTUV", "CDEFGHJKLMNPQRSTUVWX"
# NGA.SIG.0012, chapter 10: side of a square, and distance after which the letters of rows repeat.
_SQUARE_M = 100_000.0
_CYCLE_M = 2_000_000.0


def geodetic_from_mgrs(code: str, x_m: float, y_m: float, file: str, field: str) -> tuple[float, float]:
    """Return latitude and longitude [rad, WGS 84] of a point `x_m`, `y_m` from the south-west corner of a square.

    Ignores the digits of the code. FormatError for an invalid code.
    """
    expected = "a code of the Military Grid Reference System, as 54SUE815501"
    match = _CODE.match(code.strip().upper())
    if match is None:
        raise FormatError(file, field, expected, actual=code)
    zone, band = int(match[1]), _BANDS.index(match[2])
    column = _COLUMNS.index(match[3]) - 8 * ((zone - 1) % 3)
    if not (1 <= zone <= 60 and 0 <= column < 8):
        raise FormatError(file, field, expected, actual=code)
    row = (_ROWS.index(match[4]) - 5 * (zone % 2 == 0)) % 20
    easting_m, northing_m = (column + 1) * _SQUARE_M + x_m, row * _SQUARE_M + y_m
    inverse = _inverse(zone)
    # Rows repeat every 2,000 km: the latitude band, 8° = 890 km high, selects the cycle.
    lowest_deg = -80.0 + 8.0 * band
    height_deg = 12.0 if match[2] == "X" else 8.0
    for cycle in range(-5, 5):
        longitude, latitude = inverse(easting_m, northing_m + cycle * _CYCLE_M)
        if lowest_deg - 1.0 <= latitude <= lowest_deg + height_deg + 1.0:
            return math.radians(latitude), math.radians(longitude)
    raise FormatError(file, field, expected, actual=code)


def utm_zone(latitude_deg: float, longitude_deg: float) -> int:
    """Return the zone of a place, 1 to 60, with the exceptions of Norway and Svalbard (NGA.SIG.0012, chapter 7)."""
    if 56.0 <= latitude_deg < 64.0 and 3.0 <= longitude_deg < 12.0:
        return 32
    if 72.0 <= latitude_deg <= 84.0 and 0.0 <= longitude_deg < 42.0:
        return 31 + 2 * int((longitude_deg + 3.0) // 12.0)
    return int((longitude_deg + 180.0) // 6.0) % 60 + 1


@lru_cache(maxsize=60)
def _inverse(zone: int) -> Any:
    """Easting and northing, negative south of the equator → longitude and latitude [deg]."""
    import pyproj

    projection = pyproj.Proj(proj="utm", zone=zone, ellps="WGS84")
    return lambda east, north: projection(east, north, inverse=True)

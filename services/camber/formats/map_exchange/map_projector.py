"""Read Autoware's `map_projector_info.yaml`: how `local_x` and `local_y` of a map are projected.

Source: documentation of `autoware_map_projection_loader` and of the message `autoware_map_msgs/MapProjectorInfo`. The
altitude of the origin is not used there, and the scale is 0.9996 but for `TransverseMercator`, where it may be given.
The vertical datum is taken from the file only if it is EGM2008: `WGS84` is what its template has, also beside maps with
heights above mean sea level, so those who use the map have to state theirs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.formats.errors import FormatError
from camber.formats.map_exchange.mgrs import geodetic_from_mgrs, utm_zone
from camber.geodesy.local_frame import LocalFrame

FILE_NAME = "map_projector_info.yaml"
_MAX_BYTES = 1 << 16  # chosen: ten lines are usual
_UTM_SCALE = 0.9996  # source: MapProjectorInfo.msg, scale_factor
_VERTICAL = {"EGM2008": "EPSG:3855", "WGS84": None, "": None}
"""Vertical datum by its name in the file; None: to be stated by those who use the map."""

PlaneToGeodetic = Callable[[float, float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class MapProjector:
    """How a map is projected.

    `geodetic`: latitude and longitude [rad, WGS 84] of x, y and height [m]; FormatError for no such place. `vertical`:
    vertical CRS of heights, None if the file does not settle it.
    """

    geodetic: PlaneToGeodetic
    vertical: str | None


def read_map_projector(path: Path) -> MapProjector:
    """Read a file; FormatError for invalid contents."""
    with path.open("rb") as opened:
        return map_projector(opened.read(_MAX_BYTES + 1), str(path))


def map_projector(data: bytes, file: str) -> MapProjector:
    """Parse the bytes of a file; as `read_map_projector`."""
    contents = _contents(data, file)
    kind = _text(contents, "projector_type", file)
    reader = _READERS.get(kind.capitalize() if kind == "local" else kind)
    if reader is None:
        raise FormatError(file, "projector_type", f"one of {', '.join(_READERS)}", actual=kind)
    datum = _text(contents, "vertical_datum", file, default="")
    if datum not in _VERTICAL:
        raise FormatError(file, "vertical_datum", "WGS84 or EGM2008", actual=datum)
    return MapProjector(geodetic=reader(contents, file), vertical=_VERTICAL[datum])


def _contents(data: bytes, file: str) -> Mapping[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    if len(data) > _MAX_BYTES:
        raise FormatError(file, "size", f"at most {_MAX_BYTES >> 10} kB")
    try:
        contents = YAML(typ="safe", pure=True).load(data)
    except (YAMLError, ValueError, LookupError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FormatError(file, "YAML", f"a whole document ({reason})") from None
    if not isinstance(contents, Mapping):
        raise FormatError(file, "YAML", "a mapping with projector_type")
    return contents


def _mgrs(contents: Mapping[str, Any], file: str) -> PlaneToGeodetic:
    code = _text(contents, "mgrs_grid", file)
    geodetic_from_mgrs(code, 0.0, 0.0, file=file, field="mgrs_grid")  # refuses a wrong code before any node
    return lambda x_m, y_m, _: geodetic_from_mgrs(code, x_m, y_m, file=file, field="mgrs_grid")


def _utm_about_origin(contents: Mapping[str, Any], file: str) -> PlaneToGeodetic:
    latitude_deg, longitude_deg = _origin_deg(contents, file)
    return _about_origin(contents, file, proj="utm", zone=utm_zone(latitude_deg, longitude_deg))


def _transverse_mercator(contents: Mapping[str, Any], file: str) -> PlaneToGeodetic:
    _, longitude_deg = _origin_deg(contents, file)
    scale = _number(contents, "scale_factor", file, low=0.9, high=1.1, default=_UTM_SCALE)
    return _about_origin(contents, file, proj="tmerc", lon_0=longitude_deg, k_0=scale)


def _about_origin(contents: Mapping[str, Any], file: str, **parameters: Any) -> PlaneToGeodetic:
    import pyproj

    latitude_deg, longitude_deg = _origin_deg(contents, file)
    projection = pyproj.Proj(ellps="WGS84", **parameters)
    east_m, north_m = projection(longitude_deg, latitude_deg)

    def geodetic(x_m: float, y_m: float, _: float) -> tuple[float, float]:
        longitude, latitude = projection(east_m + x_m, north_m + y_m, inverse=True)
        return _checked(math.radians(latitude), math.radians(longitude), file)

    return geodetic


def _local_cartesian(contents: Mapping[str, Any], file: str) -> PlaneToGeodetic:
    latitude_deg, longitude_deg = _origin_deg(contents, file)
    frame = LocalFrame(math.radians(latitude_deg), math.radians(longitude_deg), 0.0)

    def geodetic(x_m: float, y_m: float, height_m: float) -> tuple[float, float]:
        # Of a height above the geoid the undulation is missing: 100 m of it, 10 km from the origin, are 0.16 m.
        latitude, longitude, _ = frame.geodetic_from_east_north(x_m, y_m, height_m)
        return _checked(latitude, longitude, file)

    return geodetic


def _nowhere(_: Mapping[str, Any], file: str) -> PlaneToGeodetic:
    def geodetic(x_m: float, y_m: float, height_m: float) -> tuple[float, float]:
        raise FormatError(file, "projector_type", "one that has a place on the earth", actual="Local")

    return geodetic


_READERS: dict[str, Callable[[Mapping[str, Any], str], PlaneToGeodetic]] = {
    "MGRS": _mgrs,
    "LocalCartesianUTM": _utm_about_origin,
    "TransverseMercator": _transverse_mercator,
    "LocalCartesian": _local_cartesian,
    "Local": _nowhere,  # a map with latitudes and longitudes may have such a file too
}


def _checked(latitude_rad: float, longitude_rad: float, file: str) -> tuple[float, float]:
    if not (abs(latitude_rad) < math.radians(85.0) and math.isfinite(longitude_rad)):
        raise FormatError(file, "map_origin", "coordinates within the projection's reach")
    return latitude_rad, longitude_rad


def _origin_deg(contents: Mapping[str, Any], file: str) -> tuple[float, float]:
    origin = contents.get("map_origin")
    if not isinstance(origin, Mapping):
        raise FormatError(file, "map_origin", "latitude and longitude [deg]")
    return (
        _number(origin, "latitude", file, low=-80.0, high=84.0),
        _number(origin, "longitude", file, low=-180.0, high=180.0),
    )


def _text(contents: Mapping[str, Any], key: str, file: str, default: str | None = None) -> str:
    value = contents.get(key, default)
    if not isinstance(value, str):
        raise FormatError(file, key, "a text", actual=None if value is None else str(value))
    return value


def _number(
    contents: Mapping[str, Any], key: str, file: str, *, low: float, high: float, default: float | None = None
) -> float:
    value = contents.get(key, default)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:
        expected = f"a number from {low:g} to {high:g}".replace("-", "−")
        raise FormatError(file, key, expected, actual=None if value is None else str(value))
    return float(value)

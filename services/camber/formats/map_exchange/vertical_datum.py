"""Convert heights of a vertical datum to ellipsoidal heights, or refuse: never an approximate height.

Two geoid models of one country differ by up to 24 cm, and by default PROJ returns heights unchanged without a grid. So
a height is converted only with the exact grid that relates the vertical datum to the map's horizontal datum, in one
step and offline; "ballpark" operations and detours over other datums, which lose metres in null transformations, are
refused. Source: EPSG guidance note 373-7-2, 2.2.7; PROJ, `proj_create_operations` with `ALLOW_BALLPARK=NO` and
`ONLY_BEST=YES`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

ELLIPSOIDAL = "ellipsoidal"
FIELD = "vertical datum"
MAX_UNDULATION_M = 110.0
"""Largest distance of the geoid from the ellipsoid (EGM2008: −107 m to +86 m)."""
MAX_EXTENT_M = 10_000.0
"""Largest map with a constant undulation; chosen: geoids slope by some centimetres per kilometre."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class VerticalDatum:
    """Conversion of heights of a vertical datum to ellipsoidal heights.

    `how`: description. `convert`: from latitude, longitude [rad] and height [m], (n,) each, NaN where it is unknown.
    `surrogate`: not empty if the user is responsible for the conversion. `sigma_m`: σ that the conversion adds.
    `max_extent_m`: largest extent of a map.
    """

    how: str
    convert: Callable[[Floats, Floats, Floats], Floats]
    surrogate: str = ""
    sigma_m: float = 0.0
    max_extent_m: float = math.inf

    def ellipsoidal_m(
        self, latitude_rad: Floats, longitude_rad: Floats, height_m: Floats, file: str
    ) -> Floats:
        """Return ellipsoidal heights (n,) [m]; FormatError beyond the grid, or for a map larger than `max_extent_m`."""
        if not len(height_m):
            return np.asarray(height_m, np.float64)
        extent_m = 6.4e6 * math.hypot(
            np.ptp(latitude_rad), np.ptp(longitude_rad) * math.cos(float(np.mean(latitude_rad)))
        )
        if extent_m > self.max_extent_m:
            expected = f"a map of at most {self.max_extent_m / 1e3:.0f} km for one undulation"
            raise FormatError(file, "extent", expected, actual=f"{extent_m / 1e3:.1f} km")
        converted = self.convert(latitude_rad, longitude_rad, height_m)
        wrong = ~np.isfinite(converted)
        if wrong.any():
            k = int(np.argmax(wrong))
            place = f"{math.degrees(latitude_rad[k]):.5f}, {math.degrees(longitude_rad[k]):.5f}"
            raise FormatError(file, FIELD, f"a place within the grid of {self.how}", actual=place)
        return converted


def vertical_datum(name: str, datum: str, file: str) -> VerticalDatum:
    """Return the conversion from a vertical datum in a map with positions in `datum` (EPSG name: WGS84, ETRS89, …).

    `name` is `ellipsoidal` or a vertical CRS known to PROJ ("EPSG:7837", "EGM2008 height"); FormatError for others.
    Grids of one datum cover different areas, so a missing grid is detected at the conversion: `ellipsoidal_m` then
    raises FormatError with the missing file and the folders that PROJ searches.
    """
    if name.strip().lower() == ELLIPSOIDAL:
        return VerticalDatum(how="ellipsoidal heights", convert=lambda latitude, longitude, height: height)
    vertical = crs_of(name, file, FIELD, "ellipsoidal or a vertical CRS (EPSG:7837, EGM2008 height, …)")
    if not vertical.is_vertical:
        raise FormatError(file, FIELD, "a vertical CRS", actual=f"{name} ({vertical.type_name})")
    horizontal = _horizontal(datum, file)

    def convert(latitude_rad: Floats, longitude_rad: Floats, height_m: Floats) -> Floats:
        longitude_deg, latitude_deg = np.degrees(longitude_rad), np.degrees(latitude_rad)
        step = _step((vertical, horizontal), (longitude_deg, latitude_deg), datum, file)
        _, _, converted = step.transform(longitude_deg, latitude_deg, height_m)
        return np.asarray(converted, np.float64)

    return VerticalDatum(how=vertical.name, convert=convert)


def constant_undulation(undulation_m: float, sigma_m: float, source: str) -> VerticalDatum:
    """Return the conversion with a constant geoid undulation, for which the user is responsible.

    Raises ValueError for an impossible undulation or σ, and without a source.
    """
    if not abs(undulation_m) <= MAX_UNDULATION_M:
        expected = f"−{MAX_UNDULATION_M} to {MAX_UNDULATION_M}"
        raise ValueError(f"undulation is {undulation_m} m, expected {expected}")
    if not 0.0 < sigma_m < 10.0:
        raise ValueError(f"σ of the undulation is {sigma_m} m, expected more than 0, less than 10")
    if not source.strip():
        raise ValueError("the undulation has no source, expected its origin")
    how = f"geoid taken as {undulation_m:+.3f} ± {sigma_m:.3f} m above the ellipsoid everywhere ({source.strip()})"
    return VerticalDatum(
        how=how,
        convert=lambda latitude, longitude, height: height + undulation_m,
        surrogate=f"heights: {how}",
        sigma_m=sigma_m,
        max_extent_m=MAX_EXTENT_M,
    )


def crs_of(text: str, file: str, field: str, expected: str) -> Any:
    """Return the coordinate reference system (pyproj.CRS) of a text; FormatError if unknown."""
    import pyproj

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pyproj.CRS.from_user_input(text)
    except (pyproj.exceptions.CRSError, UnicodeError) as error:
        raise FormatError(file, field, expected, actual=text) from error


def _horizontal(datum: str, file: str) -> Any:
    """Return the two-dimensional geographic system of a datum; WGS 84 if aligned to it, as grids refer to that."""
    geodetic_crs = crs_of(
        datum, file, "datum", "one that PROJ knows (WGS84, ITRF2014, ETRS89, …)"
    ).geodetic_crs
    if geodetic_crs is None:
        raise FormatError(file, "datum", "one of positions (WGS84, ITRF2014, ETRS89, …)", actual=datum)
    if aligned_to_wgs84(geodetic_crs.name):
        return crs_of("WGS84", file, "datum", "WGS84")
    return geodetic_crs.to_2d()


def aligned_to_wgs84(name: str) -> bool:
    """Whether a datum is a realisation of ITRF or WGS 84, which agree to centimetres."""
    plain = "".join(letter for letter in name.upper() if letter.isalnum())
    return plain.startswith(("ITRF", "WGS84"))


def _step(crs: tuple[Any, Any], places_deg: tuple[Floats, Floats], datum: str, file: str) -> Any:
    """Return the operation between vertical and horizontal CRS with the best grid that covers the places.

    `places_deg`: longitude and latitude. Raises FormatError where there is none.
    """
    vertical, horizontal = crs
    import pyproj
    from pyproj.aoi import AreaOfInterest
    from pyproj.crs import CompoundCRS
    from pyproj.transformer import TransformerGroup

    area = AreaOfInterest(*(float(f(a)) for f in (np.min, np.max) for a in places_deg))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a missing grid is reported below
        group = TransformerGroup(
            CompoundCRS("heights", [horizontal, vertical]),
            horizontal.to_3d(),
            always_xy=True,
            area_of_interest=area,  # type: ignore[arg-type]
            allow_ballpark=False,
        )
    direct = [step for step in group.transformers if _is_one_step(step.description)]
    if group.best_available and direct:
        return direct[0]
    unavailable = [step for step in group.unavailable_operations if _is_one_step(step.name)]
    missing = [grid.short_name for step in unavailable for grid in step.grids if not grid.available]
    if not missing:
        expected = f"one that PROJ ties to {datum} by a grid at this place"
        raise FormatError(file, FIELD, expected, actual=vertical.name)
    folders = (pyproj.datadir.get_data_dir(), pyproj.datadir.get_user_data_dir())  # type: ignore[attr-defined]
    where, files = " or ".join(map(str, folders)), " or ".join(dict.fromkeys(missing))
    raise FormatError(
        file, FIELD, f"the grid {files} in {where} (https://cdn.proj.org)", actual=vertical.name
    )


def _is_one_step(description: str) -> bool:
    """Whether an operation uses only the grid, without a detour over another datum."""
    steps = [step for step in description.split(" + ") if not step.startswith("axis order change")]
    return len(steps) == 1 and " using " not in description

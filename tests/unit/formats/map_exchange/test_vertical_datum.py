"""Heights are converted exactly or refused: a missing grid is named, and a ballpark is never taken."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.vertical_datum import constant_undulation, vertical_datum

pyproj = pytest.importorskip("pyproj")

LATITUDE, LONGITUDE = np.radians([45.62, 45.63]), np.radians([9.28, 9.29])
HEIGHT = np.array([180.0, 181.5])


def convert(name: str, datum: str, latitude_rad: float, longitude_rad: float) -> None:
    place = np.array([latitude_rad]), np.array([longitude_rad]), np.array([500.0])
    vertical_datum(name, datum, "street.osm").ellipsoidal_m(*place, "street.osm")


def test_ellipsoidal_heights_stay_as_they_are() -> None:
    same = vertical_datum("Ellipsoidal", "WGS84", "a.osm").ellipsoidal_m(LATITUDE, LONGITUDE, HEIGHT, "a.osm")
    np.testing.assert_array_equal(same, HEIGHT)


@pytest.mark.parametrize(
    ("name", "datum", "place_deg", "grid"),
    [
        ("EPSG:5773", "WGS84", (45.6, 9.3), "us_nga_egm96_15.tif"),
        ("EGM2008 height", "ITRF2020", (45.6, 9.3), "us_nga_egm08_25.tif"),
        ("EPSG:7837", "ETRS89", (48.1, 11.6), "de_bkg_gcg2016.tif"),
        ("EPSG:6695", "JGD2011", (35.2, 136.9), "jp_gsi_gsigeo2011.tif"),
    ],
)
def test_without_its_grid_a_vertical_datum_is_refused_and_the_grid_named(
    name: str, datum: str, place_deg: tuple[float, float], grid: str
) -> None:
    latitude, longitude = np.radians(place_deg)
    with pytest.raises(FormatError) as refused:
        convert(name, datum, latitude, longitude)
    message = str(refused.value)
    assert message.startswith("street.osm: vertical datum is ")
    assert grid in message
    assert pyproj.datadir.get_data_dir() in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "datum", "expected"),
    [
        (
            "EPSG:7837",
            "WGS84",
            "one that PROJ ties to WGS84 by a grid",
        ),  # only by way of ETRS89, decimetres off
        ("EPSG:5861", "ETRS89", "one that PROJ ties to ETRS89 by a grid"),
        ("orthometric", "WGS84", "ellipsoidal or a vertical CRS"),
        ("EPSG:4326", "WGS84", "a vertical CRS"),
        ("EPSG:5773", "Atlantis", "one that PROJ knows"),
    ],
)
def test_inexact_conversions_are_refused(name: str, datum: str, expected: str) -> None:
    with pytest.raises(FormatError, match=expected):
        convert(name, datum, math.radians(48.1), math.radians(11.6))


@pytest.fixture
def geoid(tmp_path: Path) -> Iterator[None]:
    """A geoid under the name of EGM96's grid: 40 m at 44° N, 8° E, a metre a degree to the north, 0.5 to the east.

    NOAA VDatum GTX: latitude and longitude of the south-western node, steps, rows, columns, then rows from the south.
    """
    rows, columns = 4, 5
    nodes = 40.0 + np.arange(rows)[:, None] + 0.5 * np.arange(columns)
    head = struct.pack(">4d2i", 44.0, 8.0, 1.0, 1.0, rows, columns)
    (tmp_path / "egm96_15.gtx").write_bytes(head + nodes.astype(">f4").tobytes())
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(tmp_path))
    yield
    pyproj.datadir.set_data_dir(before)


@pytest.mark.usefixtures("geoid")
def test_with_its_grid_the_undulation_at_each_place_is_added() -> None:
    datum = vertical_datum("EPSG:5773", "WGS84", "street.osm")
    ellipsoidal_m = datum.ellipsoidal_m(LATITUDE, LONGITUDE, HEIGHT, "street.osm")
    expected = 40.0 + (np.degrees(LATITUDE) - 44.0) + 0.5 * (np.degrees(LONGITUDE) - 8.0)
    np.testing.assert_allclose(ellipsoidal_m - HEIGHT, expected, atol=1e-4)
    with pytest.raises(FormatError, match="expected a place within the grid of EGM96"):
        datum.ellipsoidal_m(np.radians([60.0]), np.radians([9.0]), HEIGHT[:1], "street.osm")


def test_a_constant_undulation_is_recorded_as_a_surrogate() -> None:
    datum = constant_undulation(45.2, 0.1, "levelled mark 17")
    assert datum.ellipsoidal_m(LATITUDE, LONGITUDE, HEIGHT, "a.osm").tolist() == [225.2, 226.7]
    assert "levelled mark 17" in datum.surrogate
    assert "+45.200 ± 0.100" in datum.surrogate
    assert datum.sigma_m == 0.1


def test_a_constant_undulation_serves_no_large_map() -> None:
    datum = constant_undulation(45.2, 0.1, "levelled mark 17")
    with pytest.raises(FormatError, match="extent"):
        datum.ellipsoidal_m(np.radians([45.0, 45.2]), np.radians([9.0, 9.0]), HEIGHT, "a.osm")


@pytest.mark.parametrize(
    ("undulation_m", "sigma_m", "source"),
    [(math.nan, 0.1, "x"), (200.0, 0.1, "x"), (45.0, 0.0, "x"), (45.0, math.nan, "x"), (45.0, 0.1, " ")],
)
def test_an_undulation_without_its_uncertainty_or_source_is_refused(
    undulation_m: float, sigma_m: float, source: str
) -> None:
    with pytest.raises(ValueError, match="expected"):
        constant_undulation(undulation_m, sigma_m, source)

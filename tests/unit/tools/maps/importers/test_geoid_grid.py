"""Geoid grids from files: PROJ reads the same undulations, and what is no geoid grid is refused in one line."""

from __future__ import annotations

import argparse
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.tools.maps.importers.geoid_grid import geoid_grid, read_gsigeo
from camber.tools.maps.importers.height_options import vertical_of

pyproj = pytest.importorskip("pyproj")
rasterio = pytest.importorskip("rasterio")

ROWS, COLUMNS = 61, 41
SOUTH_DEG, WEST_DEG = 35.0, 136.0
STEPS_DEG = 1.0 / 60.0, 1.0 / 40.0
RNG = np.random.default_rng(7)
NODES_M = 37.0 + np.cumsum(RNG.normal(0.0, 0.02, (ROWS, COLUMNS)), axis=0)
LATITUDE_DEG = RNG.uniform(35.0, 36.0, 500)
LONGITUDE_DEG = RNG.uniform(136.0, 137.0, 500)


def gtx(folder: Path) -> Path:
    """NOAA VDatum GTX: south-western node, steps, rows, columns, then rows from the south, big-endian."""
    path = folder / "town.gtx"
    head = struct.pack(">4d2i", SOUTH_DEG, WEST_DEG, *STEPS_DEG, ROWS, COLUMNS)
    path.write_bytes(head + NODES_M.astype(">f4").tobytes())
    return path


def asc(folder: Path, nodes_m: Any = NODES_M) -> Path:
    path = folder / "town.asc"
    lines = [f"{SOUTH_DEG:.5f} {WEST_DEG:.5f} {STEPS_DEG[0]:.6f} {STEPS_DEG[1]:.6f} {ROWS} {COLUMNS} 1 ver2"]
    for row in nodes_m:
        texts = [f"{undulation_m:9.4f}" for undulation_m in row]
        lines += ["".join(texts[k : k + 28]) for k in range(0, COLUMNS, 28)]
    path.write_text("\n".join(lines) + "\n")
    return path


def isg(folder: Path) -> Path:
    """International Service for the Geoid, format 2.0, as GDAL reads it: limits of nodes, rows from the north."""
    path = folder / "town.isg"
    head = {
        "lat min": SOUTH_DEG,
        "lat max": SOUTH_DEG + (ROWS - 1) * STEPS_DEG[0],
        "lon min": WEST_DEG,
        "lon max": WEST_DEG + (COLUMNS - 1) * STEPS_DEG[1],
        "delta lat": STEPS_DEG[0],
        "delta lon": STEPS_DEG[1],
        "nrows": ROWS,
        "ncols": COLUMNS,
        "nodata": -9999,
        "ISG format": 2.0,
    }
    lines = [
        "begin_of_head ===",
        "model name : town",
        "units : meters",
        *(f"{name} = {value!r}" for name, value in head.items()),
        "end_of_head ===",
    ]
    lines += [" ".join(f"{undulation_m:.6f}" for undulation_m in row) for row in NODES_M[::-1]]
    path.write_text("\n".join(lines) + "\n")
    return path


def geotiff(folder: Path, crs: str = "EPSG:6668") -> Path:
    path = folder / "town.tif"
    south_deg, (north_step_deg, east_step_deg) = SOUTH_DEG, STEPS_DEG
    form: dict[str, Any] = {
        "driver": "GTiff",
        "height": ROWS,
        "width": COLUMNS,
        "count": 1,
        "dtype": "float32",
        "crs": crs,
        "transform": rasterio.Affine(
            east_step_deg,
            0.0,
            WEST_DEG - 0.5 * east_step_deg,
            0.0,
            -north_step_deg,
            south_deg + (ROWS - 0.5) * north_step_deg,
        ),
    }
    with rasterio.open(path, "w", **form) as written:
        written.write(NODES_M[::-1].astype(np.float32), 1)
    return path


def undulations_m(path: Path) -> Any:
    place = np.radians(LATITUDE_DEG), np.radians(LONGITUDE_DEG)
    height_m = np.full(len(LATITUDE_DEG), 12.5)
    return geoid_grid(path, "JGD2011").ellipsoidal_m(*place, height_m, "town.osm") - height_m


@pytest.mark.parametrize("write", [gtx, asc, geotiff, isg])
def test_the_undulation_is_that_which_proj_reads(write: Any, tmp_path: Path) -> None:
    peer = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={gtx(tmp_path)} +multiplier=1"
    )
    _, _, expected_m = peer.transform(LONGITUDE_DEG, LATITUDE_DEG, np.zeros(len(LATITUDE_DEG)))
    np.testing.assert_allclose(undulations_m(write(tmp_path)), expected_m, atol=1e-4)


def test_rounded_steps_of_the_file_do_not_move_its_northern_rows(tmp_path: Path) -> None:
    _, _, steps_deg = read_gsigeo(asc(tmp_path))
    assert steps_deg == STEPS_DEG


@pytest.mark.parametrize("step_deg", [0.0015, 0.0013, 0.02])
def test_steps_that_are_no_part_of_a_degree_stay(step_deg: float, tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(f"35 136 {step_deg} {step_deg} 2 2 1 v\n1 2 3 4\n")
    _, _, steps_deg = read_gsigeo(tmp_path / "a.asc")
    assert steps_deg == pytest.approx((step_deg, step_deg), abs=1e-12)


def test_a_place_without_an_undulation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        FormatError, match=r"^town.osm: vertical datum .* a place within the grid of geoid grid"
    ):
        undulations_m(asc(tmp_path, np.where(NODES_M > 37.0, 999.0, NODES_M)))


def test_a_grid_of_another_datum_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="datum is 'NAD27'"):
        geoid_grid(geotiff(tmp_path, "EPSG:4267"), "JGD2011")


def test_heights_of_ground_are_no_geoid(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="heights of a geoid, at most 110 m"):
        undulations_m(asc(tmp_path, NODES_M + 400.0))


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("", "first line"),
        ("\x00\x01\n", "first line"),
        ("35 136 0.0167 nan 61 41 1 v\n", "first line"),
        ("35 136 0.0167 0.025 3 3 1 v\n1 2 3\n", "undulations"),
        ("35 136 0.0167 0.025 2 2 1 v\n1 2 x 4\n", "undulations"),
    ],
)
def test_what_is_damaged_is_refused_in_one_line(text: str, field: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.asc"
    path.write_text(text)
    with pytest.raises(FormatError) as refused:
        geoid_grid(path, "JGD2011")
    assert refused.value.field == field
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "stated"),
    [({}, "ellipsoidal"), ({"vertical_datum": "EPSG:6695"}, None), ({"geoid_sigma_m": 0.1}, None)],
)
def test_a_grid_with_another_statement_is_refused(
    changes: dict[str, Any], stated: str | None, tmp_path: Path
) -> None:
    none = dict.fromkeys(("geoid_undulation_m", "geoid_sigma_m", "geoid_source", "vertical_datum"))
    args = argparse.Namespace(datum="JGD2011", geoid=gtx(tmp_path), **none | changes)
    with pytest.raises(FormatError, match="--geoid"):
        vertical_of(args, "town.osm", stated)

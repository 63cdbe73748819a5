"""Releases as PMTiles, read by a reader of its own that is written from the specification."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.cli import main
from camber.geodesy.gps_time import NS_PER_DAY, UNIX_OF_GPS_EPOCH_NS
from camber.live.vector_tiles import EXTENT
from camber.road_map.release import Release, read_release
from camber.road_map.tile_grid import tile_frame
from support.refusals import Refused
from support.small_map import link, surface, write
from support.vector_tile_reader import decoded, varints

SEED = 12
SURFACES, LINKS = 300, 60
REACH_M = 900.0  # chosen: nine tiles and more at zoom 16
WORLD = 2.0 * np.pi


def hilbert_place(number: int) -> tuple[int, int, int]:
    """Zoom, x and y of a tile's number."""
    zoom = 0
    while number >= 4**zoom:
        number -= 4**zoom
        zoom += 1
    x = y = 0
    for bit in range(zoom):
        side = 2**bit
        right = 1 & number // 2
        low = 1 & (number ^ right)
        if low == 0:
            if right:
                x, y = side - 1 - x, side - 1 - y
            x, y = y, x
        x, y, number = x + side * right, y + side * low, number // 4
    return zoom, x, y


def archive_of(data: bytes) -> tuple[dict[str, int], dict[str, Any], dict[tuple[int, int, int], bytes]]:
    """Header, metadata and tiles of an archive, in the order of its directories."""
    assert data[:8] == b"PMTiles\x03"
    names = (
        "root root_size metadata metadata_size leaves leaves_size tiles tiles_size addressed entries contents"
    )
    header = dict(zip(names.split(), struct.unpack_from("<11Q", data, 8), strict=True))
    codes = ("clustered", "internal", "compression", "kind", "least", "most")
    header |= dict(zip(codes, data[96:102], strict=True))
    header |= dict(zip(("west", "south", "east", "north"), struct.unpack_from("<4i", data, 102), strict=True))

    def section(offset: int, size: int) -> bytes:
        return gzip.decompress(data[offset : offset + size])

    tiles: dict[tuple[int, int, int], bytes] = {}

    def read_directory(text: bytes) -> None:
        values = varints(text)
        count = values[0]
        steps, runs, sizes, offsets = np.array(values[1:]).reshape(4, count).tolist()
        number = end = 0
        for step, run, size, offset in zip(steps, runs, sizes, offsets, strict=True):
            number += step
            begin = offset - 1 if offset else end
            end = begin + size
            if run == 0:
                read_directory(section(header["leaves"] + begin, size))
            for nth in range(run):
                tiles[hilbert_place(number + nth)] = section(header["tiles"] + begin, size)

    assert header["root"] + header["root_size"] <= 16_384
    read_directory(section(header["root"], header["root_size"]))
    return header, json.loads(section(header["metadata"], header["metadata_size"])), tiles


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(SEED)
    rows = [
        surface(
            k + 2**40,
            *place,
            link_id=k % LINKS,
            level=int(rng.integers(-2, 3)),
            yaw_rad=float(rng.uniform(-3.0, 3.0)),
            sigma_m=float(rng.uniform(0.01, 0.5)),
            heights_m=50.0 + rng.uniform(-0.2, 0.2, (2, 3)),
        )
        for k, place in enumerate(rng.uniform(-REACH_M, REACH_M, (SURFACES, 2)).tolist())
    ]
    lines = rng.uniform(-REACH_M, REACH_M, (LINKS, 4, 2))
    path = tmp_path_factory.mktemp("release")
    write(path, rows, [link(k, (k, k + 1), line) for k, line in enumerate(lines)])
    return path


@pytest.fixture(scope="module")
def release(folder: Path) -> Release:
    return read_release(folder)


@pytest.fixture(scope="module")
def archive(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("out") / "map.pmtiles"
    assert main(["map", "export", str(folder), "--to", "pmtiles", "--out", str(path)]) == 0
    return archive_of(path.read_bytes())


def units(latitude_rad: Any, longitude_rad: Any, zoom: int, x: int, y: int) -> Any:
    """Web-Mercator places in units of a tile, not rounded."""
    column = (np.asarray(longitude_rad) + np.pi) / WORLD * 2**zoom - x
    northing = np.log(np.tan(np.pi / 4.0 + np.asarray(latitude_rad) / 2.0))
    return np.stack((column, (0.5 - northing / WORLD) * 2**zoom - y), axis=-1) * EXTENT


def test_the_header_says_what_is_in_the_file(archive: Any, release: Release) -> None:
    header, metadata, tiles = archive
    assert [header[name] for name in ("clustered", "internal", "compression", "kind")] == [1, 2, 2, 1]
    assert (header["least"], header["most"]) == (6, 16)
    assert header["addressed"] == header["entries"] == header["contents"] == len(tiles)
    assert {zoom for zoom, _, _ in tiles} == set(range(6, 17))
    fields = {layer["id"]: set(layer["fields"]) for layer in metadata["vector_layers"]}
    assert fields == {"surfaces": {"sigma", "level", "day", "height"}, "links": {"level"}}
    surfaces = release.road_surfaces()
    west, south, east, north = (header[name] / 1e7 for name in ("west", "south", "east", "north"))
    assert west < np.degrees(surfaces.longitude_rad).min() < np.degrees(surfaces.longitude_rad).max() < east
    assert south < np.degrees(surfaces.latitude_rad).min() < np.degrees(surfaces.latitude_rad).max() < north


@pytest.mark.parametrize("zoom", [15, 16])
def test_corners_are_within_half_a_unit_and_properties_those_of_the_release(
    archive: Any, release: Release, zoom: int
) -> None:
    surfaces, drawn = release.road_surfaces(), set()
    row_of = {number: row for row, number in enumerate(surfaces.surface_id.tolist())}
    for (z, x, y), tile in archive[2].items():
        for number, ring, properties in decoded(tile).get("surfaces", []) if z == zoom else []:
            row = row_of[number]
            drawn.add(number)
            # On the ellipsoid, from the centre along the rectangle's sides.
            half = np.array([surfaces.half_length_m[row], surfaces.half_width_m[row]])
            c, s = np.cos(surfaces.yaw_rad[row]), np.sin(surfaces.yaw_rad[row])
            offsets = (np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]) * half) @ np.array([(c, s), (-s, c)])
            frame = tile_frame(*np.array((x, y)).tolist()) if zoom == 16 else tile_frame(2 * x, 2 * y)
            place = frame.east_north_from_geodetic_array(
                surfaces.latitude_rad[[row]], surfaces.longitude_rad[[row]], np.zeros(1)
            )
            latitude, longitude, _ = frame.geodetic_from_east_north_array(place + offsets, 0.0)
            assert (
                np.abs(units(latitude, longitude, z, x, y) - ring).max() < 0.51
            )  # convergence between tiles
            area = np.array(ring, float)
            after = np.roll(area, -1, axis=0)
            assert (area[:, 0] * after[:, 1] - after[:, 0] * area[:, 1]).sum() > 0.0  # an outer ring
            assert properties["sigma"] == pytest.approx(surfaces.sigma_m[row], abs=5.1e-4)
            assert properties["height"] == pytest.approx(surfaces.heights_m[row].mean(), abs=5.1e-3)
            assert properties["level"] == surfaces.level[row]
            assert properties["day"] == (surfaces.last_seen_ns[row] + UNIX_OF_GPS_EPOCH_NS) // NS_PER_DAY
    assert drawn == row_of.keys()


@pytest.mark.parametrize("zoom", [12, 14, 16])
def test_vertices_of_links_are_within_half_a_unit(archive: Any, release: Release, zoom: int) -> None:
    links = release.road_links()
    drawn = set()
    for place, tile in archive[2].items():
        for number, line, _ in decoded(tile).get("links", []) if place[0] == zoom else []:
            drawn.add(number)
            expected = units(*links.vertices[number].T, *place)
            assert np.abs(expected - line).max() < 0.5 + 1e-6
    assert drawn == set(links.link_id.tolist())


def test_a_lower_zoom_has_the_roads_as_pairs_of_cells(archive: Any, release: Release) -> None:
    for (zoom, x, y), tile in archive[2].items():
        if zoom < 12:
            ((name, features),) = decoded(tile).items()
            assert name == "links"
            cells = np.array([line for _, line, _ in features])
            assert (cells % 32 == 16).all()
            assert len({frozenset(map(tuple, line)) for line in cells.tolist()}) == len(features)
            vertices = np.concatenate([units(*line.T, zoom, x, y) for line in release.road_links().vertices])
            distance = np.abs(cells.reshape(-1, 1, 2) - vertices).max(axis=2).min(axis=1)
            assert distance.max() <= 16.0 + 1e-6


def test_what_is_no_release_with_roads_is_one_clear_line(tmp_path: Path, refused: Refused) -> None:
    write(tmp_path / "map", [])
    line = refused(main, "map", "export", tmp_path / "map", "--to", "pmtiles", "--out", tmp_path / "x")
    assert "surfaces, links" in line
    (tmp_path / "x").write_text("mine")
    line = refused(main, "map", "export", tmp_path / "map", "--to", "pmtiles", "--out", tmp_path / "x")
    assert "exists" in line

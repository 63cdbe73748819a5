"""PMTiles: what is written is read again, with and without leaf directories; damaged files are refused."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.pmtiles import PmtilesFile, PmtilesWriter, first_number, hilbert_numbers

ZOOM = 10
BOUNDS = (139.5, 35.0, 140.0, 35.5)
SEED = 4


def written(path: Path, numbers: list[int]) -> None:
    with path.open("wb") as stream:
        writer = PmtilesWriter(stream)
        for number in numbers:
            writer.add(first_number(ZOOM) + number, b"tile %d" % number)
        assert writer.finish({"name": "a map"}, zooms=(ZOOM, ZOOM), bounds_deg=BOUNDS) == len(numbers)


def test_the_curve_is_that_of_the_specification() -> None:
    # source: PMTiles specification, section 4.1, table of tile ids
    expected = {(0, 0, 0): 0, (1, 0, 0): 1, (1, 0, 1): 2, (1, 1, 1): 3, (1, 1, 0): 4, (2, 0, 0): 5}
    expected |= {(12, 3423, 1763): 19_078_479}
    for (zoom, x, y), number in expected.items():
        assert first_number(zoom) + hilbert_numbers(zoom, np.array([x]), np.array([y])).tolist()[0] == number


def test_steps_along_the_curve_are_to_neighbours_and_parents_have_a_quarter() -> None:
    x, y = (axis.ravel() for axis in np.mgrid[0:64, 0:64])
    numbers = hilbert_numbers(6, x, y)
    order = np.argsort(numbers)
    assert numbers[order].tolist() == list(range(4096))
    assert (np.abs(np.diff(x[order])) + np.abs(np.diff(y[order])) == 1).all()
    assert (hilbert_numbers(5, x >> 1, y >> 1) == numbers >> 2).all()


@pytest.mark.parametrize("count", [1, 300, 60_000])
def test_tiles_come_back(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(SEED)
    numbers = np.sort(rng.permutation(4**ZOOM)[:count])
    written(tmp_path / "x.pmtiles", numbers.tolist())
    file = PmtilesFile(tmp_path / "x.pmtiles")
    assert (file.zooms, file.bounds_deg, file.metadata) == ((ZOOM, ZOOM), BOUNDS, {"name": "a map"})
    x, y = rng.integers(0, 2**ZOOM, (2, 300))
    of_places = hilbert_numbers(ZOOM, x, y)
    stored = set(numbers.tolist())
    for column, row, number in zip(x.tolist(), y.tolist(), of_places.tolist(), strict=True):
        assert file.tile(ZOOM, column, row) == (b"tile %d" % number if number in stored else None)
    for place in ((ZOOM + 1, 0, 0), (ZOOM, 2**ZOOM, 0), (ZOOM, -1, 0), (-1, 0, 0), (99, 0, 0)):
        assert file.tile(*place) is None


def test_tiles_out_of_order_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ascending"):
        written(tmp_path / "x", [3, 3])


def test_a_damaged_file_is_refused_or_read_but_never_anything_else(tmp_path: Path) -> None:
    rng = np.random.default_rng(SEED)
    path = tmp_path / "x.pmtiles"
    written(path, list(range(50)))
    data = path.read_bytes()
    x, y = (axis.ravel().tolist() for axis in np.mgrid[0:8, 0:8])
    refused = 0
    for _ in range(400):
        damaged = bytearray(data)
        # Half of the damage is where the header and the root directory are.
        end = 400 if rng.random() < 0.5 else len(data)
        for at in rng.integers(0, end, rng.integers(1, 4)).tolist():
            damaged[at] = int(rng.integers(256))
        path.write_bytes(damaged[: int(rng.integers(0, len(data)))] if rng.random() < 0.2 else damaged)
        try:
            file = PmtilesFile(path)
            for place in zip(x, y, strict=True):
                file.tile(ZOOM, *place)
        except FormatError:
            refused += 1
    assert refused > 50


def test_a_number_without_end_and_a_bomb_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.pmtiles"
    for directory in (b"\x01" + b"\xff" * 1000, bytes(100 << 20)):
        written(path, [1])
        data = bytearray(path.read_bytes())
        root = gzip.compress(directory)
        data[8:24] = struct.pack("<2Q", len(data), len(root))
        path.write_bytes(data + root)
        with pytest.raises(FormatError, match="directory"):
            PmtilesFile(path)

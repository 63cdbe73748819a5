"""Recorded observation files: every value compared with that of a simple reader."""

import numpy as np
import pytest

from camber.formats.rinex.observation_reader import RinexDecoder
from support.gnss_files import read_observations, recording
from support.simple_rinex import assert_equal_to_simple_reader

FILES = (
    "rooftop-2024-06-24/rover.obs",
    "rooftop-2024-06-24/base.obs",
    "fujisawa-2021-09-22/SEPT265G.21O",
    "fujisawa-2021-09-22/3034265G.21O",
)


@pytest.mark.parametrize("name", FILES)
def test_every_value_of_a_recording_equals_that_of_a_simple_reader(name):
    path = recording(name)
    read = read_observations(path)
    assert read.problems == []
    assert assert_equal_to_simple_reader(read.epochs, path.read_text("latin-1")) > 50_000


@pytest.mark.parametrize("name", FILES)
def test_header_of_a_recording(name):
    header = read_observations(recording(name)).header
    assert header.version == 3.04
    assert header.time_system == "GPS"
    assert header.delta_hen_m == (0.0, 0.0, 0.0)
    assert header.position_ecef_m is not None
    assert np.linalg.norm(header.position_ecef_m) == pytest.approx(6.371e6, rel=2e-3)
    if name == FILES[0]:
        assert header.receiver == "SEPT MOSAIC-X5"
        assert header.interval_s == 1.0
        assert header.leap_seconds == 18
        assert header.signals["C"] == ("2I", "7I", "6I")
        assert header.signals["G"] == ("1C", "2W", "2L", "5Q")
        assert header.signals["R"] == ()


def test_unsupported_satellites_are_counted():
    assert dict(read_observations(recording(FILES[0])).skipped) == {"R": 2408}


def test_each_epoch_is_returned_with_its_last_byte():
    data = recording(FILES[0]).read_bytes()
    begin = data.index(b"\n>") + 1
    pieces = [b">" + part for part in data[begin:].split(b">")[1:]]
    decoder = RinexDecoder("rover.obs")
    assert decoder.feed(data[:begin]) == []
    for piece in pieces[:20]:
        assert decoder.feed(piece[:-1]) == []
        assert len(decoder.feed(piece[-1:])) == 1

"""Dots on pixels, and the PNG of them."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from camber.validation.raster import Raster

RED, BLUE = np.array([255, 0, 0], np.uint8), np.array([0, 0, 255], np.uint8)


def decoded(png: bytes) -> np.ndarray:
    """The pixels of a truecolour PNG without filters, by the standard's own steps; every check sum looked at."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, data, shape = 8, b"", (0, 0)
    names = []
    while at < len(png):
        (length,) = struct.unpack_from(">I", png, at)
        name, body = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", png, at + 8 + length)[0] == zlib.crc32(name + body)
        names.append(name)
        if name == b"IHDR":
            width, height, *kind = struct.unpack(">IIBBBBB", body)
            assert kind == [8, 2, 0, 0, 0]
            shape = (height, width)
        data += body if name == b"IDAT" else b""
        at += 12 + length
    assert names == [b"IHDR", b"IDAT", b"IEND"]
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(shape[0], 1 + 3 * shape[1])
    assert (rows[:, 0] == 0).all()
    pixels: np.ndarray = rows[:, 1:].reshape(*shape, 3)
    return pixels


def test_the_file_holds_the_pixels() -> None:
    raster = Raster(7, 5)
    raster.pixels[:] = np.random.default_rng(1).integers(0, 256, raster.pixels.shape)
    assert np.array_equal(decoded(raster.png()), raster.pixels)


def test_a_dot_paints_the_pixel_that_it_is_in_and_the_later_lies_on_top() -> None:
    raster = Raster(4, 3)
    raster.dots(np.array([1.9, 1.1, 3.0]), np.array([0.0, 0.9, 2.5]), np.array([RED, BLUE, RED]))
    expected = np.full((3, 4, 3), 255, np.uint8)
    expected[0, 1], expected[2, 3] = BLUE, RED
    assert np.array_equal(raster.pixels, expected)


def test_larger_dots_are_squares_that_are_cut_at_the_edge() -> None:
    raster = Raster(6, 6)
    raster.dots(np.array([0.5, 4.0]), np.array([0.5, 3.5]), RED, 3)
    painted = (raster.pixels == RED).all(axis=2)
    expected = np.zeros((6, 6), bool)
    expected[:2, :2] = expected[2:5, 3:6] = True
    assert np.array_equal(painted, expected)


def test_points_that_are_nowhere_or_far_off_paint_nothing() -> None:
    raster = Raster(4, 4)
    raster.dots(np.array([np.nan, 1.0, 1e300, -1e300, -0.1]), np.array([1.0, np.inf, 1.0, 1.0, 1.0]), RED)
    assert (raster.pixels == 255).all()


def test_shades_go_from_white_to_the_colour_and_no_further() -> None:
    raster = Raster(3, 1)
    raster.shade(np.array([[0.0, 5.0, 30.0]]), (55, 155, 255), 10.0)
    assert raster.pixels.tolist() == [[[255, 255, 255], [155, 205, 255], [55, 155, 255]]]

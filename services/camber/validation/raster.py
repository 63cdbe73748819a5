"""Pictures of many points: dots on a grid of pixels, written as PNG. An SVG with a circle for each would be megabytes.

Source: W3C, Portable Network Graphics (Second Edition), 5 "Datastream structure", 11.2 "Critical chunks".
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TRUECOLOUR = 2


class Raster:
    """A white picture; `pixels` is (rows, columns, 3), red, green, blue, the first row on top."""

    def __init__(self, width: int, height: int) -> None:
        self.pixels: Colours = np.full((height, width, 3), 255, np.uint8)

    def dots(
        self, column: NDArray[np.float64], row: NDArray[np.float64], colour: Colours, size: int = 1
    ) -> None:
        """Squares of `size` pixels about n points, in colours (n, 3) or one (3,); the later lie on top.

        What is not inside is cut off; a point that is NaN is left out.
        """
        height, width, _ = self.pixels.shape
        known = np.isfinite(column) & np.isfinite(row)
        # Far-off points are clipped first: they would not fit into integers.
        x = np.floor(np.clip(column[known], -1e6, 1e6)).astype(np.int64)
        y = np.floor(np.clip(row[known], -1e6, 1e6)).astype(np.int64)
        paint = np.broadcast_to(colour, (len(column), 3))[known]
        for step in range(size * size):
            at_x, at_y = x + step % size - size // 2, y + step // size - size // 2
            inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
            self.pixels[at_y[inside], at_x[inside]] = paint[inside]

    def shade(self, counts: NDArray[np.float64], colour: tuple[int, int, int], full: float) -> None:
        """Paint pixels (rows, columns) towards a colour by how much there is; `full` and more is the colour itself."""
        share = np.clip(counts / full, 0.0, 1.0)[:, :, None]
        blended = (1.0 - share) * self.pixels + share * np.array(colour, np.float64)
        self.pixels[:] = np.round(blended).astype(np.uint8)

    def png(self) -> bytes:
        """The file; the same pixels give the same bytes with the same zlib."""
        height, width, _ = self.pixels.shape
        rows = np.zeros((height, 1 + 3 * width), np.uint8)  # each row begins with its filter: none
        rows[:, 1:] = self.pixels.reshape(height, 3 * width)
        header = struct.pack(">IIBBBBB", width, height, 8, _TRUECOLOUR, 0, 0, 0)
        return (
            _SIGNATURE
            + _chunk(b"IHDR", header)
            + _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
            + _chunk(b"IEND", b"")
        )


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

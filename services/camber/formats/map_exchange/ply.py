"""Read the points of PLY files: `ascii`, `binary_little_endian` and `binary_big_endian`, version 1.0.

Read are x, y and z of the element `vertex`; other properties and later elements are ignored. Elements before it must
have a fixed size. Points with NaN coordinates are left out. Open3D is not used here: of a truncated file it returns
uninitialised points without an error. Source: Greg Turk, "The PLY Polygon File
Format" (1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

Floats = NDArray[np.float64]

_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# Chosen: bounds that no real cloud reaches, so that a damaged header is refused before it fills the memory.
_MAX_HEADER_BYTES = 65_536
_MAX_ROWS = 200_000_000
_MAX_PROPERTIES = 1_024


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlyElement:
    """`kinds` are numpy's codes without byte order, None for a list."""

    name: str
    count: int
    names: list[str]
    kinds: list[str | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlyHeader:
    """Elements up to the vertices; the data begin at byte `begin`, after `lines` lines."""

    order: str
    before: list[_PlyElement]
    vertex: _PlyElement
    begin: int
    lines: int

    def row(self, element: _PlyElement) -> np.dtype[Any]:
        """Return the layout of an element in a binary file."""
        return np.dtype([(f"{k}", f"{self.order}{kind}") for k, kind in enumerate(element.kinds)])


def read_ply(path: Path) -> Floats:
    """Read points (n, 3). Raises FormatError for an invalid file, OSError if it cannot be read."""
    return points_from_ply(path.read_bytes(), path.name)


def points_from_ply(data: bytes, source_name: str) -> Floats:
    """Parse points (n, 3) of a file's bytes. Raises FormatError."""
    header = _read_header(data, source_name)
    points = (_binary_points if header.order else _ascii_points)(data, header, source_name)
    if np.isinf(points).any():
        raise FormatError(source_name, "x y z", "finite numbers, or NaN for a point that was not measured")
    kept: Floats = points[~np.isnan(points).any(axis=1)]
    return kept


def _read_header(data: bytes, source_name: str) -> _PlyHeader:
    order: str | None = None
    elements: list[_PlyElement] = []
    begin, number = 0, 0
    while True:
        number += 1
        end = data.find(b"\n", begin, begin + 4_096)
        if end < 0 or end > _MAX_HEADER_BYTES:
            actual = data[begin : begin + 40]
            raise FormatError(source_name, "header", "end_header", actual=actual, line_number=number)
        words = data[begin:end].decode("latin-1").split()
        begin = end + 1
        if number == 1:
            if words != ["ply"]:
                raise FormatError(source_name, "header", "ply", actual=" ".join(words), line_number=1)
        elif words[:1] == ["end_header"]:
            break
        elif words[:1] in (["comment"], ["obj_info"], []):
            continue
        elif words[0] == "format" and len(words) == 3 and words[1] in _ORDERS and words[2] == "1.0":
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and _is_count(words[2]):
            elements.append(_PlyElement(name=words[1], count=int(words[2]), names=[], kinds=[]))
        elif words[0] == "property" and elements and len(elements[-1].names) < _MAX_PROPERTIES:
            _add_property(elements[-1], words, source_name, number)
        else:
            expected = "a format of version 1.0, an element with its count, or a property"
            raise FormatError(source_name, "header", expected, actual=" ".join(words), line_number=number)
    if order is None:
        raise FormatError(source_name, "header", "a format")
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise FormatError(source_name, "header", "an element vertex")
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    if any(vertex.names.count(axis) != 1 for axis in "xyz"):
        raise FormatError(source_name, "vertex", "x, y and z, each once")
    if any(None in element.kinds for element in (*before, vertex)):
        raise FormatError(source_name, "vertex", "no lists in it or before it")
    return _PlyHeader(order=order, before=before, vertex=vertex, begin=begin, lines=number)


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 12 and int(text) <= _MAX_ROWS


def _add_property(element: _PlyElement, words: list[str], source_name: str, number: int) -> None:
    is_list = len(words) == 5 and words[1] == "list" and words[2] in _KINDS and words[3] in _KINDS
    if not is_list and not (len(words) == 3 and words[1] in _KINDS):
        expected = "property TYPE NAME or property list TYPE TYPE NAME"
        raise FormatError(source_name, "header", expected, actual=" ".join(words), line_number=number)
    element.names.append(words[-1])
    element.kinds.append(None if is_list else _KINDS[words[1]])


def _binary_points(data: bytes, header: _PlyHeader, source_name: str) -> Floats:
    begin = header.begin + sum(element.count * header.row(element).itemsize for element in header.before)
    vertex, row = header.vertex, header.row(header.vertex)
    want = row.itemsize * vertex.count
    if len(data) - begin < want:
        actual = f"{max(len(data) - begin, 0)} bytes"
        raise FormatError(source_name, "data", f"{want} bytes of vertices", actual=actual, byte_offset=begin)
    rows = np.frombuffer(data, row, vertex.count, begin)
    columns = [rows[f"{vertex.names.index(axis)}"].astype(np.float64) for axis in "xyz"]
    return np.column_stack(columns)


def _ascii_points(data: bytes, header: _PlyHeader, source_name: str) -> Floats:
    vertex, first = header.vertex, sum(element.count for element in header.before)
    lines = data[header.begin :].decode("latin-1").split("\n")
    rows = lines[first : first + vertex.count]
    if len(rows) < vertex.count or (rows and not rows[-1].strip()):
        actual = f"{sum(bool(row.strip()) for row in rows)} lines"
        raise FormatError(source_name, "data", f"{vertex.count} lines of vertices", actual=actual)
    columns = [vertex.names.index(axis) for axis in "xyz"]
    points = np.empty((vertex.count, 3))
    for number, line in enumerate(rows):
        words = line.split()
        try:
            if len(words) != len(vertex.names) or "_" in line:  # Python's notation, not the format's
                raise ValueError
            points[number] = [float(words[column]) for column in columns]
        except ValueError:
            expected = f"{len(vertex.names)} numbers, one per property"
            at = header.lines + first + number + 1
            raise FormatError(source_name, "data", expected, actual=line, line_number=at) from None
    return points

"""Observations as PostgreSQL's binary COPY wants them and gives them, all rows at once.

PostgreSQL's documentation, COPY, "Binary Format": a header of 19 bytes; of each row the number of fields (int16), and
of each field its length (int32) and value; then −1 (int16). Numbers are big-endian. As no field is ever NULL and none
varies in length, the rows are an array.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from camber.map_update.contribution import OBSERVATION
from camber.map_update.store import Ids, Rows

_HEADER = b"PGCOPY\n\xff\r\n\0" + bytes(8)
_TRAILER = b"\xff\xff"
_SQL = {"i": "bigint", "u": "smallint", "f": "double precision"}
_BINARY = {"i": ">i8", "u": ">i2", "f": ">f8"}
_NUMBER = "contribution"
_PART = 2048
_KINDS = {_NUMBER: "i", **{name: OBSERVATION[name].kind for name in OBSERVATION.names or ()}}
_ROW = np.dtype(
    [
        ("fields", ">i2"),
        *(
            item
            for name, kind in _KINDS.items()
            for item in ((f"{name} length", ">i4"), (name, _BINARY[kind]))
        ),
    ]
)

COLUMNS = tuple(_KINDS)
"""The number of the contribution, then the fields of OBSERVATION."""
DEFINITION = ", ".join(f"{name} {_SQL[kind]} NOT NULL" for name, kind in _KINDS.items())
"""The columns of the table, in SQL."""


def _template() -> bytes:
    row = np.zeros(1, _ROW)
    row["fields"] = len(COLUMNS)
    for name in COLUMNS:
        row[f"{name} length"] = _ROW[name].itemsize
    return row.tobytes()


_EMPTY_ROW = _template()


def to_copy(number: Ids, rows: Rows) -> Iterator[bytearray]:
    """Binary COPY of observations (n,) of OBSERVATION of the contributions `number` (n,), some thousand rows at a time.

    The server works on one part while the next is made.
    """
    yield bytearray(_HEADER)
    for first in range(0, len(rows), _PART):
        part, of = rows[first : first + _PART], number[first : first + _PART]
        data = bytearray(_EMPTY_ROW * len(part))
        table = np.frombuffer(data, _ROW)
        for name in COLUMNS:
            table[name] = of if name == _NUMBER else part[name]
        yield data
    yield bytearray(_TRAILER)


def from_copy(data: bytes) -> tuple[Ids, Rows]:
    """Numbers of contributions (n,) and observations (n,) of a binary COPY of COLUMNS, in this order.

    Raises ValueError for anything else.
    """
    size = len(data) - len(_HEADER) - len(_TRAILER)
    if size < 0 or size % _ROW.itemsize or not data.startswith(_HEADER) or not data.endswith(_TRAILER):
        raise ValueError(f"{len(data)} bytes are no binary COPY of observations")
    table = np.frombuffer(data, _ROW, size // _ROW.itemsize, len(_HEADER))
    if (table["fields"] != len(COLUMNS)).any():
        raise ValueError("a binary COPY with other columns than those of observations")
    rows = np.empty(len(table), OBSERVATION)
    for name in OBSERVATION.names or ():
        rows[name] = table[name]
    return table[_NUMBER].astype(np.int64), rows

"""Observations of road heights as CSV, one per row: written by `camber uploads --records`, sent by `camber upload`.

    vehicle,id,datum,map_version,epoch_year,time_ns,fix_id,fix_quality,surface_id,verdict,latitude_rad,longitude_rad,
    horizontal_sigma_m,road_height_m,road_height_sigma_m,antenna_height_m

Columns may be in any order, with others between them. `id` may be missing, or empty in all rows: then the batch is
identified by the file's content, so that the same file sent again is recognised. The meaning is that of
`camber.schemas.fleet.ElevationUpload`.

A file is read a batch at a time, so memory does not grow with it: once to check all rows, and again to send them.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import Any, TextIO, get_args

import numpy as np
from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.schemas.fleet import UploadBatch
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue
from camber.schemas.refused_field import first_refused

MOST_RECORDS = 2_000
"""In one batch: within the 256 kB of a query."""

_LONGEST_LINE = 65_536  # chosen: a row has some 300 characters
_LARGEST_INTEGER = 2**62  # chosen: within 64 bits, with room for a sum


def _integer(text: str) -> int:
    value = int(text)
    if not 0 <= value <= _LARGEST_INTEGER:
        raise ValueError(text)
    return value


def _number(text: str) -> float:
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(text)
    return value


_Parser = tuple[Callable[[str], Any], str, str]
"""Conversion of a text, what is expected, numpy's type."""
_INTEGER, _NUMBER = (_integer, "an integer", "<i8"), (_number, "a number", "<f8")
_BATCH: dict[str, _Parser] = {
    "vehicle": (str, "a text", ""),
    "datum": (str, "a text", ""),
    "map_version": _INTEGER,
    "epoch_year": (_number, "a year", ""),
}
_RECORD: dict[str, _Parser] = {
    **dict.fromkeys(("time_ns", "fix_id", "surface_id"), _INTEGER),
    **{
        name: (get_args(values).index, f"one of {', '.join(get_args(values))}", "|u1")
        for name, values in (("fix_quality", Quality), ("verdict", VerdictValue))
    },
    **dict.fromkeys(("latitude_rad", "longitude_rad", "horizontal_sigma_m"), _NUMBER),
    **dict.fromkeys(("road_height_m", "road_height_sigma_m", "antenna_height_m"), _NUMBER),
}
COLUMNS = (*_BATCH, *_RECORD)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedUploads:
    """A file whose rows have all been read once. `content`: digest that names batches without an id."""

    path: Path
    content: str
    batch_count: int

    def batches(self) -> Iterator[UploadBatch]:
        """Read the batches in the file's order. Raises FormatError for a file that has been changed since."""
        yield from _batches(self.path, self.content)
        if _content_of(self.path) != self.content:
            raise FormatError(self.path.name, "the file", "the content that was checked")


def check_uploads(path: Path) -> CheckedUploads:
    """Read all rows. Raises FormatError for the first bad one, OSError if the file is unreadable."""
    content = _content_of(path)
    count = sum(1 for _ in _batches(path, content))
    if not count:
        raise FormatError(path.name, "the file", "at least one row")
    return CheckedUploads(path=path, content=content, batch_count=count)


def _content_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:24]


def _batches(path: Path, content: str) -> Iterator[UploadBatch]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            position = 0
            rows = _rows(path.name, csv.DictReader(_lines(file, path.name), strict=True))
            for (_, given_id), group in groupby(rows, key=lambda row: (row[1], row[2])):
                for number, records in enumerate(_pieces(group)):
                    batch_id = (given_id or f"file-{content}-{position}") + (f".{number}" if number else "")
                    yield _batch(path.name, batch_id, records)
                    position += 1
        except UnicodeDecodeError:
            raise FormatError(path.name, "the file", "text in UTF-8") from None


def _lines(file: TextIO, source: str) -> Iterator[str]:
    while line := file.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise FormatError(source, "the row", f"at most {_LONGEST_LINE} characters")
        yield line


def _pieces(group: Iterable[_Row]) -> Iterator[list[_Row]]:
    rows = iter(group)
    while piece := list(islice(rows, MOST_RECORDS)):
        yield piece


_Row = tuple[int, dict[str, Any], str, dict[str, Any]]
"""Line, values of the batch, id, values of the record."""


def _rows(source: str, rows: csv.DictReader[str]) -> Iterator[_Row]:
    try:
        names = rows.fieldnames or ()
        for name in COLUMNS:
            if name not in names:
                raise FormatError(source, name, "a column of this name", line_number=1)
        for row in rows:
            fault = partial(FormatError, source, line_number=rows.line_num)
            if None in row or None in row.values():
                raise fault("the row", f"{len(names)} fields")
            values = {}
            for name, (parse, expected, _) in (_BATCH | _RECORD).items():
                try:
                    values[name] = parse(row[name])
                except ValueError:
                    raise fault(name, expected, actual=row[name]) from None
            batch = {name: values.pop(name) for name in _BATCH}
            yield rows.line_num, batch, row.get("id") or "", values
    except csv.Error as error:
        raise FormatError(source, "the row", f"CSV ({error})", line_number=rows.line_num) from None


def _batch(source: str, batch_id: str, rows: Sequence[_Row]) -> UploadBatch:
    line, batch, _, _ = rows[0]
    columns: dict[str, Any] = {
        name: np.array([record[name] for *_, record in rows], kind) for name, (_, _, kind) in _RECORD.items()
    }
    times_ns = columns.pop("time_ns")
    try:
        return UploadBatch(
            time_ns=int(times_ns[-1]), batch_id=batch_id, positioning_time_ns=times_ns, **batch, **columns
        )
    except ValidationError as error:
        field = first_refused(error, whole="the row")
        raise FormatError(source, field.name, field.expected, actual=field.value, line_number=line) from None

"""Observations of road heights as CSV, one row each: what `camber uploads --records` writes and `camber upload` sends.

    vehicle,id,datum,map_version,epoch_year,time_ns,fix_id,fix_quality,surface_id,verdict,latitude_rad,longitude_rad,
    horizontal_sigma_m,road_height_m,road_height_sigma_m,antenna_height_m

In any order, and others may stand among them. `id` may be missing, or empty in all rows: then the content names the
batch, so that the same file sent again is known. The meaning is that of `camber.schemas.fleet.ElevationUpload`.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.schemas.fleet import UploadBatch
from camber.schemas.gnss import Quality
from camber.schemas.integrity import VerdictValue

MOST_RECORDS = 2_000
"""In one batch: within the 256 kB that a question may have."""

T = TypeVar("T")
_HEADING = ("vehicle", "datum", "map_version", "epoch_year")
_WORDS: dict[str, tuple[str, ...]] = {"fix_quality": get_args(Quality), "verdict": get_args(VerdictValue)}
_INTEGERS = ("time_ns", "fix_id", "surface_id")
_NUMBERS = (
    "latitude_rad",
    "longitude_rad",
    "horizontal_sigma_m",
    "road_height_m",
    "road_height_sigma_m",
    "antenna_height_m",
)
COLUMNS = (*_HEADING, *_INTEGERS, *_WORDS, *_NUMBERS)
_LARGEST_INTEGER = 2**62


def read_uploads(path: Path) -> list[UploadBatch]:
    """All batches of a file, in its order. Raises FormatError for the first bad row, OSError if it cannot be read."""
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(path.name, "the file", "text in UTF-8") from None
    rows = csv.DictReader(text.splitlines(), strict=True)
    found = list(_rows(path.name, rows))
    if not found:
        raise FormatError(path.name, "the file", "at least one row")
    content = hashlib.sha256(data).hexdigest()[:24]
    batches: list[UploadBatch] = []
    for (_, own_id), group in groupby(found, key=lambda row: (row[1], row[2])):
        of_batch = list(group)
        parts = [of_batch[at : at + MOST_RECORDS] for at in range(0, len(of_batch), MOST_RECORDS)]
        for number, part in enumerate(parts):
            name = own_id or f"file-{content}-{len(batches)}"
            batches.append(_batch(path.name, name if number == 0 else f"{name}.{number}", part))
    return batches


_Row = tuple[int, tuple[str, str, int, float], str, dict[str, Any]]
"""Line, heading, id, observation."""


def _rows(source: str, rows: csv.DictReader[str]) -> Iterable[_Row]:
    try:
        there = rows.fieldnames or ()
        for name in COLUMNS:
            if name not in there:
                raise FormatError(source, name, "a column of this name", line_number=1)
        for row in rows:
            line = rows.line_num
            if None in row or None in row.values():
                raise FormatError(source, "the row", f"{len(there)} fields", line_number=line)

            def value(
                name: str, of: Callable[[str], T], expected: str, row: Any = row, line: int = line
            ) -> T:
                try:
                    return of(row[name])
                except ValueError:
                    raise FormatError(source, name, expected, actual=row[name], line_number=line) from None

            heading = (
                row["vehicle"],
                row["datum"],
                value("map_version", _integer, "an integer"),
                value("epoch_year", _number, "a year"),
            )
            observation: dict[str, Any] = {name: value(name, _integer, "an integer") for name in _INTEGERS}
            observation |= {name: value(name, _number, "a number") for name in _NUMBERS}
            for name, words in _WORDS.items():
                observation[name] = value(name, words.index, f"one of {', '.join(words)}")
            yield line, heading, row.get("id") or "", observation
    except csv.Error as error:
        raise FormatError(source, "the row", f"CSV ({error})", line_number=rows.line_num) from None


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


def _batch(source: str, batch_id: str, rows: Sequence[_Row]) -> UploadBatch:
    line, (vehicle, datum, map_version, epoch_year), _, _ = rows[0]
    columns: dict[str, Any] = {}
    for name in (*_INTEGERS, *_WORDS, *_NUMBERS):
        kind = "|u1" if name in _WORDS else "<i8" if name in _INTEGERS else "<f8"
        columns[name] = np.array([observation[name] for *_, observation in rows], kind)
    times_ns = columns.pop("time_ns")
    try:
        return UploadBatch(
            time_ns=int(times_ns[-1]),
            vehicle=vehicle,
            batch_id=batch_id,
            datum=datum,
            epoch_year=epoch_year,
            map_version=map_version,
            positioning_time_ns=times_ns,
            **columns,
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or "the row"
        found = "" if isinstance(first["input"], np.ndarray | dict) else f" is {str(first['input'])[:40]!r}"
        raise FormatError(source, field + found, first["msg"], line_number=line) from None

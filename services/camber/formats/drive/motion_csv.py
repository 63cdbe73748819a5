"""What a vehicle's own sensors said, as CSV: one row a sample, an empty field where a sensor gave nothing.

    motion      time_ns,wheel_speed_m_s,yaw_rate_rad_s,steering_angle_rad[,pitch_rad,roll_rad]
    suspension  time_ns,stroke_height_m,stroke_sigma_m
    ranging     time_ns,distance_m,beam_angle_rad,distance_sigma_m

Signs and frames are those of `camber.schemas.motion`; times are GPS time. Rows are handed on in the file's order:
repeated and late ones are for the services to meet. Pitch and roll are of vehicles that measure them: both
columns stand there, or neither does.
"""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.schemas.base import Message
from camber.schemas.motion import Motion, Ranging, Suspension

M = TypeVar("M", bound=Message)

MOTION_COLUMNS = ("time_ns", "wheel_speed_m_s", "yaw_rate_rad_s", "steering_angle_rad")
ATTITUDE_COLUMNS = ("pitch_rad", "roll_rad")
"""Those that may follow, both of them."""
SUSPENSION_COLUMNS = ("time_ns", "stroke_height_m", "stroke_sigma_m")
RANGING_COLUMNS = ("time_ns", "distance_m", "beam_angle_rad", "distance_sigma_m")


def read_motion(path: Path) -> list[Motion]:
    """All samples of a file. Raises FormatError for the first bad row, OSError if it cannot be read."""
    return _read(path, Motion, MOTION_COLUMNS, ATTITUDE_COLUMNS)


def read_suspension(path: Path) -> list[Suspension]:
    """As `read_motion`, for stroke heights."""
    return _read(path, Suspension, SUSPENSION_COLUMNS)


def read_ranging(path: Path) -> list[Ranging]:
    """As `read_motion`, for distances to the road."""
    return _read(path, Ranging, RANGING_COLUMNS)


def write_motion(path: Path, samples: Iterable[Motion]) -> None:
    """Write a file that `read_motion` reads to 1e-9 of a unit; the same samples give the same bytes.

    With columns for pitch and roll if any sample has one of them.
    """
    rows = list(samples)
    tilted = any(sample.pitch_rad is not None or sample.roll_rad is not None for sample in rows)
    _write(path, rows, MOTION_COLUMNS + ATTITUDE_COLUMNS if tilted else MOTION_COLUMNS)


def write_suspension(path: Path, samples: Iterable[Suspension]) -> None:
    """As `write_motion`, for stroke heights."""
    _write(path, samples, SUSPENSION_COLUMNS)


def write_ranging(path: Path, samples: Iterable[Ranging]) -> None:
    """As `write_motion`, for distances to the road."""
    _write(path, samples, RANGING_COLUMNS)


def _write(path: Path, samples: Iterable[Message], columns: tuple[str, ...]) -> None:
    lines = [",".join(columns)]
    for sample in samples:
        values = (getattr(sample, name) for name in columns[1:])
        lines.append(
            ",".join((str(sample.time_ns), *("" if value is None else f"{value:.9f}" for value in values)))
        )
    path.write_bytes(("\n".join(lines) + "\n").encode("ascii"))


def _read(path: Path, cls: type[M], columns: tuple[str, ...], more: tuple[str, ...] = ()) -> list[M]:
    """`more`: columns that may follow, all of them or none."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.reader(file)
        header = tuple(name.strip() for name in next(rows, []))
        if header not in (columns, columns + more):
            expected = ",".join(columns) + (f", or that and {','.join(more)}" if more else "")
            raise FormatError(path.name, "header", expected, actual=",".join(header), line_number=1)
        return [
            _sample(path.name, number, cls, header, row) for number, row in enumerate(rows, start=2) if row
        ]


def _sample(source_name: str, line_number: int, cls: type[M], columns: tuple[str, ...], row: list[str]) -> M:
    if len(row) != len(columns):
        expected = f"{len(columns)} fields, as the header names"
        raise FormatError(
            source_name, "columns", expected, actual=f"{len(row)} fields", line_number=line_number
        )
    values: dict[str, Any] = {}
    for name, text in zip(columns, row, strict=True):
        if not text.strip():
            continue
        try:
            values[name] = int(text) if name == "time_ns" else float(text)
        except ValueError:
            raise FormatError(source_name, name, "a number", actual=text, line_number=line_number) from None
    try:
        return cls(**values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = str(first["loc"][0])
        found = row[columns.index(name)]
        raise FormatError(source_name, name, first["msg"], actual=found, line_number=line_number) from None

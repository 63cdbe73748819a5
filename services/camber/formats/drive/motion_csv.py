"""Samples of a vehicle's motion sensors as CSV: one row per sample, an empty field where a sensor reported nothing.

    motion      time_ns,wheel_speed_m_s,yaw_rate_rad_s,steering_angle_rad[,pitch_rad,roll_rad]
    imu         time_ns,angular_rate_x_rad_s,angular_rate_y_rad_s,angular_rate_z_rad_s,
                specific_force_x_m_s2,specific_force_y_m_s2,specific_force_z_m_s2[,temperature_c]
    suspension  time_ns,stroke_height_m,stroke_sigma_m
    ranging     time_ns,distance_m,beam_angle_rad,distance_sigma_m

Signs and frames are those of `camber.schemas.motion`; times are GPS time. Rows keep the file's order: repeated and late
ones are handled by the services. Pitch and roll, of vehicles that measure them, are both present or both absent.
"""

import csv
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.schemas.base import Message
from camber.schemas.motion import Imu, Motion, Ranging, Suspension

M = TypeVar("M", bound=Message)

MOTION_COLUMNS = ("time_ns", "wheel_speed_m_s", "yaw_rate_rad_s", "steering_angle_rad")
_VECTORS = {
    "angular_rate_rad_s": ("angular_rate_x_rad_s", "angular_rate_y_rad_s", "angular_rate_z_rad_s"),
    "specific_force_m_s2": ("specific_force_x_m_s2", "specific_force_y_m_s2", "specific_force_z_m_s2"),
}
"""Fields with three components, and the columns of these."""
_COMPONENTS = {
    column: (field, index) for field, columns in _VECTORS.items() for index, column in enumerate(columns)
}
IMU_COLUMNS = ("time_ns", *_COMPONENTS)
_COLUMNS: dict[type[Message], tuple[str, ...]] = {
    Motion: MOTION_COLUMNS,
    Imu: IMU_COLUMNS,
    Suspension: ("time_ns", "stroke_height_m", "stroke_sigma_m"),
    Ranging: ("time_ns", "distance_m", "beam_angle_rad", "distance_sigma_m"),
}
_OPTIONAL: dict[type[Message], tuple[str, ...]] = {
    Motion: ("pitch_rad", "roll_rad"),
    Imu: ("temperature_c",),
}
"""After these, all or none."""


def read_samples(path: Path, kind: type[M]) -> list[M]:
    """Read all samples. Raises FormatError for the first bad row, OSError if the file cannot be read."""
    columns, optional = _COLUMNS[kind], _OPTIONAL.get(kind, ())
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.reader(file)
        header = tuple(name.strip() for name in next(rows, []))
        if header not in (columns, columns + optional):
            expected = ",".join(columns) + (f", or that and {','.join(optional)}" if optional else "")
            raise FormatError(path.name, "header", expected, actual=",".join(header), line_number=1)
        return [
            _sample(kind, header, row, (path.name, line)) for line, row in enumerate(rows, start=2) if row
        ]


def write_samples(path: Path, kind: type[M], samples: Iterable[M]) -> None:
    """Write samples to 1e-9 of a unit, with the optional columns if any sample has one; deterministic."""
    rows, columns, optional = list(samples), _COLUMNS[kind], _OPTIONAL.get(kind, ())
    if any(getattr(sample, name) is not None for sample in rows for name in optional):
        columns += optional
    lines = [sample_header(columns), *(sample_line(sample, columns) for sample in rows)]
    path.write_bytes("".join(lines).encode("ascii"))


def sample_header(columns: tuple[str, ...]) -> str:
    """Return the first line of a table with these columns."""
    return ",".join(columns) + "\n"


def sample_line(sample: Message, columns: tuple[str, ...]) -> str:
    """Return a sample as a line of a table, to 1e-9 of a unit."""
    values = (_value(sample, name) for name in columns[1:])
    texts = ("" if value is None else f"{value:.9f}" for value in values)
    return ",".join((str(sample.time_ns), *texts)) + "\n"


def _value(sample: Message, column: str) -> float | None:
    field, index = _COMPONENTS.get(column, (column, None))
    value = getattr(sample, field)
    component: float | None = value if index is None else value[index]
    return component


def _sample(cls: type[M], header: tuple[str, ...], row: list[str], line: tuple[str, int]) -> M:
    fault = partial(FormatError, line[0], line_number=line[1])
    if len(row) != len(header):
        raise fault("columns", f"{len(header)} fields, as the header names", actual=f"{len(row)} fields")
    values: dict[str, Any] = {}
    for name, text in zip(header, row, strict=True):
        try:
            # A vector has all its components; any other quantity may be missing.
            if text.strip() or name in _COMPONENTS:
                values[name] = int(text) if name == "time_ns" else float(text)
        except ValueError:
            raise fault(name, "a number", actual=text) from None
    values |= {
        field: tuple(values.pop(name) for name in columns)
        for field, columns in _VECTORS.items()
        if field in cls.model_fields
    }
    try:
        return cls(**values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field, *index = first["loc"]
        name = _VECTORS[str(field)][int(index[0])] if index else str(field)
        raise fault(name, first["msg"], actual=row[header.index(name)]) from None

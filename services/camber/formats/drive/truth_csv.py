"""Where an antenna really was: Camber's own `truth.csv`, and the layout of the Nagoya reference.

    camber  time_ns,latitude_deg,longitude_deg,height_m,roll_deg,pitch_deg,heading_deg,
            velocity_east_m_s,velocity_north_m_s,velocity_up_m_s,fix_wrong[,more …]
    nagoya  GPS TOW (s),GPS Week,Latitude (deg),…, as MatRTKLIB's example has it

Positions are of the antenna, heights ellipsoidal, headings clockwise from north, pitch
positive with the nose down (Nagoya: up). `fix_wrong` is 1 where a simulator made
the receiver's fix wrong, 0 where it made it right, empty where it gave none; no recording has it.
A simulator adds columns of numbers, named with their unit and empty where there is nothing to say.
"""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from camber.formats.errors import FormatError
from camber.geodesy.angles import wrap_pi_array, wrap_two_pi
from camber.geodesy.gps_time import gps_ns_from_week_tow, nanoseconds_from_decimal

Array = npt.NDArray[np.float64]
WRONG_M = 0.5
"""A fix farther than this from the truth, in three dimensions, is wrong: in `fix_wrong` and in every summary."""
FixState = Literal["right", "wrong", "none"]
FIX_STATES: tuple[FixState, ...] = ("right", "wrong", "none")

_CAMBER = (
    "time_ns", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg",
    "velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s", "fix_wrong",
)  # fmt: skip
_NAGOYA = (
    "GPS TOW (s)", "GPS Week", "Latitude (deg)", "Longitude (deg)", "Ellipsoid Height (m)", "ECEF X (m)", "ECEF Y (m)",
    "ECEF Z (m)", "Roll (deg)", "Pitch (deg)", "Heading (deg)", "East Velocity (m/s)", "North Velocity (m/s)",
    "Up Velocity (m/s)",
)  # fmt: skip
_TEXT_OF_STATE: dict[FixState, str] = {"right": "0", "wrong": "1", "none": ""}
_STATE_OF_TEXT = {text: FIX_STATES.index(state) for state, text in _TEXT_OF_STATE.items()}
_NAGOYA_FLOATS = (2, 3, 4, 8, 9, 10, 11, 12, 13)
_CAMBER_FLOATS = tuple(range(1, 10))
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True, slots=True)
class TruthTable:
    """Truth of n epochs, times strictly ascending.

    Attitude as in `camber.geodesy.se3`: `yaw_rad` counter-clockwise from east, in (−π, π], `pitch_rad` positive
    with the nose down, `roll_rad` with the left side up. `fix_state`, where a simulator says it, indexes
    FIX_STATES. `more` are further columns (n,) by name, NaN where there is nothing to say.
    """

    time_ns: npt.NDArray[np.int64]
    latitude_rad: Array
    longitude_rad: Array
    height_m: Array
    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array
    velocity_enu_m_s: Array
    fix_state: npt.NDArray[np.int8] | None = None
    more: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_ns)

    def rows(self, selection: npt.NDArray[np.bool_] | npt.NDArray[np.intp] | slice) -> "TruthTable":
        """The epochs of a mask, of indices or of a slice."""
        return TruthTable(
            self.time_ns[selection],
            self.latitude_rad[selection],
            self.longitude_rad[selection],
            self.height_m[selection],
            self.roll_rad[selection],
            self.pitch_rad[selection],
            self.yaw_rad[selection],
            self.velocity_enu_m_s[selection],
            None if self.fix_state is None else self.fix_state[selection],
            {name: column[selection] for name, column in self.more.items()},
        )


def read_truth(path: Path, layout: Literal["camber", "nagoya"]) -> TruthTable:
    """Read a whole file. Raises FormatError for its first fault, OSError if it cannot be read."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.reader(file)
        header = tuple(name.strip() for name in next(rows, []))
        columns: tuple[str, ...] = _CAMBER if layout == "camber" else _NAGOYA
        if layout == "camber" and header[: len(columns)] == columns and _are_more(header[len(columns) :]):
            columns = header
        if header != columns:
            raise FormatError(path.name, "header", ",".join(columns), actual=",".join(header), line_number=1)
        numbered = [(number, row) for number, row in enumerate(rows, start=2) if row]
    for number, row in numbered:
        if len(row) != len(columns):
            raise FormatError(
                path.name,
                "columns",
                f"{len(columns)} fields",
                actual=f"{len(row)} fields",
                line_number=number,
            )
    values = _floats(path.name, numbered, columns, _CAMBER_FLOATS if layout == "camber" else _NAGOYA_FLOATS)
    more = range(len(_CAMBER), len(columns)) if layout == "camber" else range(0)
    further = _floats(path.name, numbered, columns, more, may_be_empty=True)
    time_ns = np.array([_time(path.name, number, row, layout) for number, row in numbered], dtype=np.int64)
    late = np.flatnonzero(np.diff(time_ns) <= 0)
    if len(late):
        raise FormatError(
            path.name, "time", "later than in the row before", line_number=numbered[late[0] + 1][0]
        )
    states = None
    if layout == "camber":
        states = [_state(path.name, number, row[len(_CAMBER) - 1]) for number, row in numbered]
    # The Nagoya reference gives pitch with the nose up positive: it rises with the grade.
    pitch_sign = 1.0 if layout == "camber" else -1.0
    return TruthTable(
        time_ns,
        np.deg2rad(values[:, 0]),
        np.deg2rad(values[:, 1]),
        values[:, 2],
        np.deg2rad(values[:, 3]),
        pitch_sign * np.deg2rad(values[:, 4]),
        wrap_pi_array(0.5 * np.pi - np.deg2rad(values[:, 5])),
        values[:, 6:9],
        None if states is None else np.array(states, dtype=np.int8),
        {columns[column]: further[:, place] for place, column in enumerate(more)},
    )


def write_truth(path: Path, truth: TruthTable) -> None:
    """Write Camber's layout: positions to 0.1 mm, angles to 1e-7 degrees; the same truth gives the same bytes."""
    lines = [",".join((*_CAMBER, *truth.more))]
    if not _are_more(tuple(truth.more)):
        raise ValueError(f"further columns are {', '.join(truth.more)}, expected new names, each once")
    for i in range(len(truth)):
        heading_deg = np.rad2deg(wrap_two_pi(0.5 * np.pi - float(truth.yaw_rad[i])))
        velocity = ",".join(f"{component:.5f}" for component in truth.velocity_enu_m_s[i])
        state: FixState = "none" if truth.fix_state is None else FIX_STATES[truth.fix_state[i]]
        lines.append(
            f"{truth.time_ns[i]},{np.rad2deg(truth.latitude_rad[i]):.10f},{np.rad2deg(truth.longitude_rad[i]):.10f},"
            f"{truth.height_m[i]:.5f},{np.rad2deg(truth.roll_rad[i]) + 0.0:.7f},"
            f"{np.rad2deg(truth.pitch_rad[i]) + 0.0:.7f},"
            f"{heading_deg:.7f},{velocity},{_TEXT_OF_STATE[state]}"
            + "".join(f",{_number(column[i])}" for column in truth.more.values())
        )
    path.write_bytes(("\n".join(lines) + "\n").encode("ascii"))


def _are_more(names: tuple[str, ...]) -> bool:
    return len({*_CAMBER, *names}) == len(_CAMBER) + len(names) and all(map(_NAME.fullmatch, names))


def _number(value: float) -> str:
    """To a micrometre and the like; whole numbers as such, nothing for NaN."""
    if math.isnan(value):
        return ""
    return str(int(value)) if value == int(value) else f"{value:.6f}"


def _floats(
    source_name: str,
    numbered: Sequence[tuple[int, list[str]]],
    columns: Sequence[str],
    wanted: Sequence[int],
    *,
    may_be_empty: bool = False,
) -> Array:
    """Columns of finite numbers; NaN where a field is empty and may be."""
    values = np.empty((len(numbered), len(wanted)))
    left_out = np.zeros(values.shape, bool)
    for row_index, (number, row) in enumerate(numbered):
        for column_index, column in enumerate(wanted):
            if may_be_empty and not row[column].strip():
                left_out[row_index, column_index] = True
                continue
            try:
                values[row_index, column_index] = float(row[column])
            except ValueError:
                raise FormatError(
                    source_name, columns[column], "a number", actual=row[column], line_number=number
                ) from None
    values[left_out] = math.nan
    bad = np.argwhere(~np.isfinite(values) & ~left_out)
    if len(bad):
        number, row = numbered[bad[0, 0]]
        column = wanted[bad[0, 1]]
        raise FormatError(
            source_name, columns[column], "a finite number", actual=row[column], line_number=number
        )
    return values


def _time(source_name: str, line_number: int, row: list[str], layout: str) -> int:
    try:
        if layout == "camber":
            return int(row[0])
        return gps_ns_from_week_tow(int(row[1]), nanoseconds_from_decimal(row[0].strip()))
    except ValueError:
        expected = "nanoseconds of GPS time" if layout == "camber" else "seconds of week and GPS week"
        raise FormatError(source_name, "time", expected, actual=row[0], line_number=line_number) from None


def _state(source_name: str, line_number: int, text: str) -> int:
    state = _STATE_OF_TEXT.get(text.strip())
    if state is None:
        raise FormatError(source_name, "fix_wrong", "0, 1 or nothing", actual=text, line_number=line_number)
    return state

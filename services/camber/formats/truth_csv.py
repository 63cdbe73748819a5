"""Where an antenna really was: Camber's own `truth.csv`, and the layout of the Nagoya reference.

    camber  time_ns,latitude_deg,longitude_deg,height_m,roll_deg,pitch_deg,heading_deg,
            velocity_east_m_s,velocity_north_m_s,velocity_up_m_s,fix_wrong
    nagoya  GPS TOW (s),GPS Week,Latitude (deg),…, as MatRTKLIB's example has it

Positions are of the antenna, heights ellipsoidal, headings clockwise from north, pitch
positive with the nose down (Nagoya: up). `fix_wrong` is 1 where a simulator made
the receiver's fix wrong, 0 where it made it right, empty where it gave none; no recording has it.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from camber.formats.errors import FormatError
from camber.geodesy.angles import wrap_pi_array, wrap_two_pi
from camber.geodesy.gps_time import gps_ns_from_week_tow, nanoseconds_from_decimal

Array = npt.NDArray[np.float64]
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


@dataclass(frozen=True, slots=True)
class TruthTable:
    """Truth of n epochs, times strictly ascending.

    Attitude as in `camber.geodesy.se3`: `yaw_rad` counter-clockwise from east, in (−π, π], `pitch_rad` positive
    with the nose down, `roll_rad` with the left side up. `fix_state`, where a simulator says it, indexes
    FIX_STATES.
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
        )


def read_truth(path: Path, layout: Literal["camber", "nagoya"]) -> TruthTable:
    """Read a whole file. Raises FormatError for its first fault, OSError if it cannot be read."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.reader(file)
        header = tuple(name.strip() for name in next(rows, []))
        columns = _CAMBER if layout == "camber" else _NAGOYA
        if header != columns:
            raise FormatError(path.name, "header", ",".join(columns), found=",".join(header), line_number=1)
        numbered = [(number, row) for number, row in enumerate(rows, start=2) if row]
    for number, row in numbered:
        if len(row) != len(columns):
            raise FormatError(
                path.name, "columns", f"{len(columns)} fields", found=f"{len(row)} fields", line_number=number
            )
    values = _floats(path.name, numbered, columns, _CAMBER_FLOATS if layout == "camber" else _NAGOYA_FLOATS)
    time_ns = np.array([_time(path.name, number, row, layout) for number, row in numbered], dtype=np.int64)
    late = np.flatnonzero(np.diff(time_ns) <= 0)
    if len(late):
        raise FormatError(
            path.name, "time", "later than in the row before", line_number=numbered[late[0] + 1][0]
        )
    states = [_state(path.name, number, row[-1]) for number, row in numbered] if layout == "camber" else None
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
    )


def write_truth(path: Path, truth: TruthTable) -> None:
    """Write Camber's layout: positions to 0.1 mm, angles to 1e-7 degrees; the same truth gives the same bytes."""
    lines = [",".join(_CAMBER)]
    for i in range(len(truth)):
        heading_deg = np.rad2deg(wrap_two_pi(0.5 * np.pi - float(truth.yaw_rad[i])))
        velocity = ",".join(f"{component:.5f}" for component in truth.velocity_enu_m_s[i])
        state: FixState = "none" if truth.fix_state is None else FIX_STATES[truth.fix_state[i]]
        lines.append(
            f"{truth.time_ns[i]},{np.rad2deg(truth.latitude_rad[i]):.10f},{np.rad2deg(truth.longitude_rad[i]):.10f},"
            f"{truth.height_m[i]:.5f},{np.rad2deg(truth.roll_rad[i]) + 0.0:.7f},"
            f"{np.rad2deg(truth.pitch_rad[i]) + 0.0:.7f},"
            f"{heading_deg:.7f},{velocity},{_TEXT_OF_STATE[state]}"
        )
    path.write_bytes(("\n".join(lines) + "\n").encode("ascii"))


def _floats(
    source_name: str, numbered: Sequence[tuple[int, list[str]]], columns: Sequence[str], wanted: Sequence[int]
) -> Array:
    values = np.empty((len(numbered), len(wanted)))
    for row_index, (number, row) in enumerate(numbered):
        for column_index, column in enumerate(wanted):
            try:
                values[row_index, column_index] = float(row[column])
            except ValueError:
                raise FormatError(
                    source_name, columns[column], "a number", found=row[column], line_number=number
                ) from None
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        number, row = numbered[bad[0, 0]]
        column = wanted[bad[0, 1]]
        raise FormatError(
            source_name, columns[column], "a finite number", found=row[column], line_number=number
        )
    return values


def _time(source_name: str, line_number: int, row: list[str], layout: str) -> int:
    try:
        if layout == "camber":
            return int(row[0])
        return gps_ns_from_week_tow(int(row[1]), nanoseconds_from_decimal(row[0].strip()))
    except ValueError:
        expected = "nanoseconds of GPS time" if layout == "camber" else "seconds of week and GPS week"
        raise FormatError(source_name, "time", expected, found=row[0], line_number=line_number) from None


def _state(source_name: str, line_number: int, text: str) -> int:
    state = _STATE_OF_TEXT.get(text.strip())
    if state is None:
        raise FormatError(source_name, "fix_wrong", "0, 1 or nothing", found=text, line_number=line_number)
    return state

"""True antenna positions: Camber's own `truth.csv`, and the layout of the Nagoya reference.

    camber  time_ns,latitude_deg,longitude_deg,height_m,roll_deg,pitch_deg,heading_deg,
            velocity_east_m_s,velocity_north_m_s,velocity_up_m_s,fix_wrong[,more …]
    nagoya  GPS TOW (s),GPS Week,Latitude (deg),…, as MatRTKLIB's example has it

Positions are of the antenna, heights ellipsoidal, headings clockwise from north, pitch positive with the nose down
(Nagoya: up). `fix_wrong` is 1 where a simulator made the receiver's fix wrong, 0 where it made it right, empty where
there is no fix; absent in recordings. A simulator adds columns of numbers, named with their unit, empty where unknown.
"""

import csv
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, Literal

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
_TEXTS_OF_STATES = ("0", "1", "")
"""In the order of FIX_STATES."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthTable:
    """Truth of n epochs, times strictly ascending.

    Attitude as in `camber.geodesy.se3`: `yaw_rad` counter-clockwise from east, in (−π, π], `pitch_rad` positive
    with the nose down, `roll_rad` with the left side up. `fix_state`, of a simulator, indexes FIX_STATES. `more` are
    further columns (n,) by name, NaN where unknown.
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
        """Return the epochs of a mask, of indices or of a slice."""
        columns: dict[str, Any] = {column.name: getattr(self, column.name) for column in fields(self)}
        more = {name: column[selection] for name, column in columns.pop("more").items()}
        chosen: dict[str, Any] = {
            name: None if column is None else column[selection] for name, column in columns.items()
        }
        return TruthTable(**chosen, more=more)


def read_truth(path: Path, layout: Literal["camber", "nagoya"]) -> TruthTable:
    """Read a whole file. Raises FormatError for its first error, OSError if it cannot be read."""
    fault = partial(FormatError, path.name)
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = csv.reader(file)
        header = tuple(name.strip() for name in next(rows, []))
        is_camber = layout == "camber"
        layout_columns = _CAMBER if is_camber else _NAGOYA
        more = header[len(layout_columns) :] if is_camber else ()
        if header != layout_columns + more or not _are_more(more):
            raise fault("header", ",".join(layout_columns), actual=",".join(header), line_number=1)
        numbered = [(number, row) for number, row in enumerate(rows, start=2) if row]
    for number, row in numbered:
        if len(row) != len(header):
            raise fault("columns", f"{len(header)} fields", actual=f"{len(row)} fields", line_number=number)

    def column(name: str, parse: Callable[[str], Any], wanted: str = "a number") -> list[Any]:
        values, index = [], header.index(name)
        for number, row in numbered:
            try:
                values.append(parse(row[index]))
            except (ValueError, OverflowError) as error:
                expected = "a finite number" if isinstance(error, OverflowError) else wanted
                raise fault(name, expected, actual=row[index], line_number=number) from None
        return values

    names = _CAMBER[1:10] if is_camber else _NAGOYA[2:5] + _NAGOYA[8:]
    values = np.array([column(name, _finite) for name in names]).reshape(9, -1)
    further = {name: np.array(column(name, _finite_or_empty), np.float64) for name in more}
    if is_camber:
        times = column("time_ns", int, "nanoseconds of GPS time")
        states = np.array(column("fix_wrong", _state, "0, 1 or nothing"), np.int8)
    else:
        weeks = column("GPS Week", int, "a GPS week")
        of_week = column(
            "GPS TOW (s)", lambda text: nanoseconds_from_decimal(text.strip()), "seconds of week"
        )
        times, states = list(map(gps_ns_from_week_tow, weeks, of_week)), None
    time_ns = np.array(times, dtype=np.int64)
    late = np.flatnonzero(np.diff(time_ns) <= 0)
    if len(late):
        raise fault("time", "later than in the row before", line_number=numbered[late[0] + 1][0])
    angles = np.deg2rad(values[[0, 1, 3, 4, 5]])
    return TruthTable(
        time_ns=time_ns,
        latitude_rad=angles[0],
        longitude_rad=angles[1],
        height_m=values[2],
        roll_rad=angles[2],
        # The Nagoya reference gives pitch with the nose up positive: it rises with the grade.
        pitch_rad=angles[3] if is_camber else -angles[3],
        yaw_rad=wrap_pi_array(0.5 * np.pi - angles[4]),
        velocity_enu_m_s=values[6:9].T,
        fix_state=states,
        more=further,
    )


def write_truth(path: Path, truth: TruthTable) -> None:
    """Write Camber's layout: positions to 0.1 mm, angles to 1e-7 degrees; the same truth gives the same bytes."""
    lines = [",".join((*_CAMBER, *truth.more))]
    if not _are_more(tuple(truth.more)):
        raise ValueError(f"further columns are {', '.join(truth.more)}, expected new names, each once")
    for i in range(len(truth)):
        heading_deg = np.rad2deg(wrap_two_pi(0.5 * np.pi - float(truth.yaw_rad[i])))
        velocity = ",".join(f"{component:.5f}" for component in truth.velocity_enu_m_s[i])
        state = 2 if truth.fix_state is None else truth.fix_state[i]
        lines.append(
            f"{truth.time_ns[i]},{np.rad2deg(truth.latitude_rad[i]):.10f},{np.rad2deg(truth.longitude_rad[i]):.10f},"
            f"{truth.height_m[i]:.5f},{np.rad2deg(truth.roll_rad[i]) + 0.0:.7f},"
            f"{np.rad2deg(truth.pitch_rad[i]) + 0.0:.7f},"
            f"{heading_deg:.7f},{velocity},{_TEXTS_OF_STATES[state]}"
            + "".join(f",{_number(column[i])}" for column in truth.more.values())
        )
    path.write_bytes(("\n".join(lines) + "\n").encode("ascii"))


def _are_more(names: tuple[str, ...]) -> bool:
    return len({*_CAMBER, *names}) == len(_CAMBER) + len(names) and all(map(_NAME.fullmatch, names))


def _number(value: float) -> str:
    """Return six decimals, a whole number without, nothing for NaN."""
    if math.isnan(value):
        return ""
    return str(int(value)) if value == int(value) else f"{value:.6f}"


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise OverflowError(text)
    return value


def _finite_or_empty(text: str) -> float:
    return _finite(text) if text.strip() else math.nan


def _state(text: str) -> int:
    return _TEXTS_OF_STATES.index(text.strip())

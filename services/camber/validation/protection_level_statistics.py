"""Statistics of published positions: availability, errors, coverage of error ellipses, protection levels.

Source: Kikuchi (TUMSAT), reliability index (ellipse, HPL, Stanford chart).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from camber.formats.drive.recording import Recorded
from camber.schemas.base import Float64, Int64
from camber.schemas.integrity import Position
from camber.validation.fix_statistics import Flags
from camber.validation.reference_trajectory import ReferenceTrajectory

# The published ellipse holds 99.9 %; C = −2 ln(1 − P) scales its axes' squares to 99 % (exactly 2/3).
_SQUARE_AT_99 = math.log(0.01) / math.log(0.001)
_SMALLEST_AXIS_M = 1e-9
"""In place of zero as a divisor: far below any published axis."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Positions:
    """The last published position of each epoch, in the order of time: arrays (n,), NaN where not given.

    `error_enu_m` (n, 3) is NaN also where the truth is unknown.
    """

    time_ns: Int64
    source: npt.NDArray[np.str_]
    latitude_rad: Float64
    longitude_rad: Float64
    height_m: Float64
    semi_major_999_m: Float64
    semi_minor_999_m: Float64
    orientation_rad: Float64
    hpl_m: Float64
    vpl_m: Float64
    alert_limit_m: Float64
    error_enu_m: Float64
    vertical_alert_limit_m: Float64
    semi_major_99_m: Float64
    semi_minor_99_m: Float64
    usable: Flags

    @property
    def horizontal_error_m(self) -> Float64:
        """Horizontal error (n,)."""
        return np.hypot(self.error_enu_m[:, 0], self.error_enu_m[:, 1])

    def square_in_ellipse(self) -> Float64:
        """Squared distance (n,) of the truth in units of the 99.9 % ellipse: at most 1 inside."""
        return self._square_in(self.semi_major_999_m, self.semi_minor_999_m)

    def square_in_ellipse_99(self) -> Float64:
        """Squared distance (n,) in units of the 99 % ellipse: the published one, else the 99.9 % one scaled."""
        scaled = self.square_in_ellipse() / _SQUARE_AT_99
        published = self._square_in(self.semi_major_99_m, self.semi_minor_99_m)
        return np.where(np.isnan(self.semi_major_99_m), scaled, published)

    def _square_in(self, major_m: Float64, minor_m: Float64) -> Float64:
        c, s = np.cos(self.orientation_rad), np.sin(self.orientation_rad)
        east, north = self.error_enu_m[:, 0], self.error_enu_m[:, 1]
        along = (c * east + s * north) / np.maximum(major_m, _SMALLEST_AXIS_M)
        across = (c * north - s * east) / np.maximum(minor_m, _SMALLEST_AXIS_M)
        return along**2 + across**2


_COLUMNS = (
    "latitude_rad", "longitude_rad", "height_m", "semi_major_999_m", "semi_minor_999_m", "orientation_rad",
    "alert_limit_m", "vertical_alert_limit_m", "semi_major_99_m", "semi_minor_99_m",
)  # fmt: skip


def positions_by_epoch(
    recorded: Sequence[Recorded[Position]],
    truth: ReferenceTrajectory | None,
    offset_enu_m: tuple[float, float, float],
    alert_limit_m: float | None,
) -> Positions:
    """Columns of the last position of each epoch; `alert_limit_m` overrides that of the positions."""
    last = {item.message.time_ns: item.message for item in recorded}
    messages = [last[time_ns] for time_ns in sorted(last)]

    def column(name: str) -> Float64:
        return np.array([getattr(message, name) for message in messages], np.float64)

    time_ns = np.array([message.time_ns for message in messages], dtype=np.int64)
    columns = {name: column(name) for name in _COLUMNS}
    if alert_limit_m is not None:
        columns["alert_limit_m"] = np.full(len(messages), alert_limit_m)
    error_m = np.full((len(messages), 3), np.nan)
    if truth is not None:
        place = (columns["latitude_rad"], columns["longitude_rad"], columns["height_m"])
        error_m = truth.error_enu_m(time_ns, *place, offset_enu_m=offset_enu_m)
    return Positions(
        time_ns=time_ns,
        source=np.array([message.source for message in messages], dtype=np.str_),
        hpl_m=column("horizontal_protection_level_m"),
        vpl_m=column("vertical_protection_level_m"),
        error_enu_m=error_m,
        usable=np.array([message.usable for message in messages], np.bool_),
        **columns,
    )


def percentiles(values: Float64, names: dict[str, float]) -> dict[str, float | None]:
    """Quantiles of the finite values that are values themselves (inverted CDF); None without a finite value."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return dict.fromkeys(names)
    return {name: float(np.quantile(finite, q, method="inverted_cdf")) for name, q in names.items()}


def availability(positions: Positions, epoch_time_ns: Int64) -> float | None:
    """Share of the epochs whose 99.9 % horizontal radius is below the alert limit; None without epochs."""
    if not len(epoch_time_ns):
        return None
    if not len(positions.time_ns):
        return 0.0
    row, exists = last_row_of_epochs(positions.time_ns, epoch_time_ns)
    small = positions.semi_major_999_m < positions.alert_limit_m
    return float((small[row] & exists).mean())


def usable_share(positions: Positions, epoch_time_ns: Int64) -> float | None:
    """Share of the epochs whose position says that it is usable; None without epochs."""
    if not len(epoch_time_ns):
        return None
    if not len(positions.time_ns):
        return 0.0
    row, exists = last_row_of_epochs(positions.time_ns, epoch_time_ns)
    return float((positions.usable[row] & exists).mean())


def last_row_of_epochs(time_ns: Int64, epoch_ns: Int64) -> tuple[Int64, Flags]:
    """The last row within half a step of each epoch (n,), and whether one exists; both times ascend.

    Sensors and receivers have separate clocks, so a position's time is near its epoch's, not equal; and a position that
    was published before the epoch's fix arrived is superseded.
    """
    if not len(time_ns) or not len(epoch_ns):
        return np.zeros(len(epoch_ns), np.int64), np.zeros(len(epoch_ns), bool)
    half_step_ns = int(np.median(np.diff(epoch_ns))) // 2 if len(epoch_ns) > 1 else 0
    row = (np.searchsorted(time_ns, epoch_ns + half_step_ns, side="right") - 1).clip(0)
    return row, np.abs(time_ns[row] - epoch_ns) <= half_step_ns


def coverage(positions: Positions) -> dict[str, Any]:
    """By source: epochs with ellipse and truth, and the shares with the truth inside 99 % and 99.9 %."""
    square, square_99 = positions.square_in_ellipse(), positions.square_in_ellipse_99()
    known = np.isfinite(square)
    sources = [*sorted(set(positions.source[known].tolist())), "all"]
    result: dict[str, Any] = {}
    for source in sources:
        rows = known & ((positions.source == source) | (source == "all"))
        chosen = square[rows]
        share = len(chosen) > 0
        result[source] = {
            "epochs": len(chosen),
            "inside_99": float((square_99[rows] <= 1.0).mean()) if share else None,
            "inside_999": float((chosen <= 1.0).mean()) if share else None,
        }
    return result

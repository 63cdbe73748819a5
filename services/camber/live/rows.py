"""RowWriter of the history from messages: numbers only, terms as their place in a list, NaN for what is not known."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, Protocol, get_args

import numpy as np

from camber.geodesy.covariance import eigenvalues_m2
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.history import TableLayout
from camber.live.snapshots import match_points_as_bytes, satellites_as_json
from camber.schemas.gnss import Fix, Quality, SatellitesInView
from camber.schemas.integrity import (
    Cause,
    Evidence,
    HorizontalReference,
    Position,
    PositionSource,
    Verdict,
    VerdictValue,
)
from camber.schemas.integrity import Reason as JudgeReason
from camber.schemas.pose import HorizontalBasis, Pose, PoseMode, RoadReason, ScanMatchPoints
from camber.validation.reference_trajectory import ReferenceTrajectory

NAN = math.nan
_FIXES = 256
"""Fixes whose verdict may still come. Chosen: ten seconds of the fastest receiver."""
TERMS: dict[str, tuple[str, ...]] = {
    "verdict": get_args(VerdictValue),
    "reason": get_args(JudgeReason),
    "evidence": get_args(Evidence),
    "cause": get_args(Cause),
    "source": get_args(PositionSource),
    "horizontal_reference": get_args(HorizontalReference),
    "quality": get_args(Quality),
    "mode": get_args(PoseMode),
    "basis": get_args(HorizontalBasis),
    "road_reason": get_args(RoadReason),
}
"""The terms that a column's numbers stand for; `evidence` is a sum of 2 to the power of the place."""
_PLACES = {name: {term: place for place, term in enumerate(terms)} for name, terms in TERMS.items()}
INPUTS = ("fix", "velocity", "pose", "scan_match", "antenna_height", "motion")
"""Channels whose age is shown at each position."""
CHANNELS = (
    "motion", "fix", "velocity", "satellites", "pose", "scan_match", "scan_match_points",
    "antenna_height", "verdict", "position",
)  # fmt: skip
"""What the page reads, in the order in which it is made."""

LAYOUTS = (
    TableLayout(
        name="fix",
        exact=("t", "lat", "lon", "fix_id"),
        rest=("h", "sigma_m", "sigma_up_m", "satellites", "ratio", "quality", "corrections_s"),
    ),
    TableLayout(
        name="verdict",
        exact=("t", "lat", "lon", "fix_id"),
        rest=(
            "verdict", "reason", "cause", "evidence", "difference_m", "tolerance_m", "east_m", "north_m",
            "joint", "joint_limit", "correction_m", "error_m",
        ),
    ),
    TableLayout(
        name="position",
        exact=("t", "lat", "lon"),
        rest=(
            "h", "source", "usable", "reason", "horizontal_reference", "hpl_m", "vpl_m", "alert_m",
            "vertical_alert_m", "major_m", "minor_m", "orientation_rad", "yaw_rad", "error_m", "error_up_m",
            *(f"age_{name}_s" for name in INPUTS),
        ),
    ),
    TableLayout(
        name="pose",
        exact=("t", "lat", "lon"),
        rest=("yaw_rad", "speed_m_s", "mode", "basis", "ee", "en", "nn", "road_sigma_m", "road_reason"),
    ),
)  # fmt: skip


class SnapshotSink(Protocol):
    """What keeps bytes by kind and time, as `Snapshots` does."""

    def add(self, kind: str, time_s: float, data: bytes) -> None:
        """Keep the bytes of a time."""


class RowSink(Protocol):
    """What keeps rows, as `History` does."""

    @property
    def snapshots(self) -> SnapshotSink:
        """Where snapshots go."""

    def append(self, table: str, exact: Sequence[float], rest: Sequence[float], text: str = "") -> None:
        """Append a row to a table."""


class RowWriter:
    """Appends the rows of messages to a sink. `truth` gives errors, where there is one."""

    def __init__(
        self,
        history: RowSink,
        truth: ReferenceTrajectory | None = None,
        offset_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._history = history
        self._truth = truth
        self._offset_enu_m = offset_enu_m
        self._last_s: dict[str, float] = {}
        self._fixes: OrderedDict[int, Fix] = OrderedDict()

    def add(self, channel: str, message: Any) -> None:
        """Append what a message of one of CHANNELS says."""
        time_s = unix_ns_from_gps_ns(message.time_ns) / 1e9
        self._last_s[channel] = time_s
        if isinstance(message, Fix):
            self._fix(time_s, message)
        elif isinstance(message, Verdict):
            self._verdict(time_s, message)
        elif isinstance(message, Position):
            self._position(time_s, message)
        elif isinstance(message, Pose):
            self._pose(time_s, message)
        elif isinstance(message, SatellitesInView):
            self._history.snapshots.add("satellites", time_s, satellites_as_json(message, time_s))
        elif isinstance(message, ScanMatchPoints):
            self._history.snapshots.add("scan_match_points", time_s, match_points_as_bytes(message, time_s))

    def _fix(self, time_s: float, fix: Fix) -> None:
        self._fixes[fix.fix_id] = fix
        if len(self._fixes) > _FIXES:
            self._fixes.popitem(last=False)
        horizontal_m = up_m = NAN
        if (c := fix.covariance_enu_m2) is not None:
            horizontal_m, up_m = math.sqrt(max(eigenvalues_m2((c[0], c[1], c[3])))), math.sqrt(c[5])
        self._history.append(
            "fix",
            (time_s, math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad), fix.fix_id),
            (
                fix.height_m,
                horizontal_m,
                up_m,
                _number(fix.satellites),
                _number(fix.ratio),
                _PLACES["quality"][fix.quality],
                _number(fix.age_of_corrections_s),
            ),
        )

    def _verdict(self, time_s: float, verdict: Verdict) -> None:
        fix = None if verdict.fix_id is None else self._fixes.get(verdict.fix_id)
        # The place of the fix, also where it was refused: that is what the map shows.
        place: Fix | Verdict = verdict if fix is None else fix
        east_m, north_m = verdict.position_difference_m or (NAN, NAN)
        error_m = NAN if fix is None else float(np.linalg.norm(self._error_enu_m(fix)))
        self._history.append(
            "verdict",
            (time_s, _degrees(place.latitude_rad), _degrees(place.longitude_rad), _number(verdict.fix_id)),
            (
                _PLACES["verdict"][verdict.verdict],
                _PLACES["reason"][verdict.reason],
                _PLACES["cause"][verdict.cause],
                sum(1 << _PLACES["evidence"][term] for term in set(verdict.evidence)),
                _number(verdict.height_difference_m),
                _number(verdict.tolerance_m),
                east_m,
                north_m,
                _number(verdict.joint_distance2),
                _number(verdict.joint_limit),
                verdict.correction_m,
                error_m,
            ),
            verdict.detail,
        )

    def _position(self, time_s: float, position: Position) -> None:
        error = self._error_enu_m(position)
        ages = (time_s - self._last_s.get(name, NAN) for name in INPUTS)
        self._history.append(
            "position",
            (time_s, _degrees(position.latitude_rad), _degrees(position.longitude_rad)),
            (
                _number(position.height_m),
                _PLACES["source"][position.source],
                float(position.usable),
                _PLACES["reason"][position.reason],
                _PLACES["horizontal_reference"][position.horizontal_reference],
                _number(position.horizontal_protection_level_m),
                _number(position.vertical_protection_level_m),
                position.alert_limit_m,
                _number(position.vertical_alert_limit_m),
                _number(position.semi_major_99_m),
                _number(position.semi_minor_99_m),
                _number(position.orientation_rad),
                _number(position.yaw_rad),
                math.hypot(error[0], error[1]),
                error[2],
                *ages,
            ),
        )

    def _pose(self, time_s: float, pose: Pose) -> None:
        covariance = pose.covariance_east_north_yaw or (NAN,) * 6
        self._history.append(
            "pose",
            (time_s, _degrees(pose.latitude_rad), _degrees(pose.longitude_rad)),
            (
                _number(pose.yaw_rad),
                _number(pose.speed_m_s),
                _PLACES["mode"][pose.mode],
                _PLACES["basis"][pose.horizontal_basis],
                covariance[0],
                covariance[1],
                covariance[3],
                _number(pose.road.sigma_m),
                _PLACES["road_reason"][pose.road.reason],
            ),
        )

    def _error_enu_m(self, at: Fix | Position) -> tuple[float, float, float]:
        """Error of a place against the truth: east, north, up; NaN where one of them is not known."""
        if self._truth is None or at.latitude_rad is None or at.longitude_rad is None or at.height_m is None:
            return NAN, NAN, NAN
        values = (np.array([value]) for value in (at.latitude_rad, at.longitude_rad, at.height_m))
        error = self._truth.error_enu_m(np.array([at.time_ns]), *values, offset_enu_m=self._offset_enu_m)
        return float(error[0, 0]), float(error[0, 1]), float(error[0, 2])


def _number(value: float | None) -> float:
    return NAN if value is None else float(value)


def _degrees(angle_rad: float | None) -> float:
    return NAN if angle_rad is None else math.degrees(angle_rad)

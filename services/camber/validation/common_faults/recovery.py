"""After wrong fixes: how long a captured pose makes right ones *erroneous*, and until one is confirmed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.replay.single_process_replay import DriveOutput
from camber.schemas.base import Float64, Int64
from camber.schemas.integrity import CONFIRMED_VERDICTS, Verdict
from camber.schemas.pose import Pose
from camber.validation.common_faults.drive import FaultDrive
from camber.validation.common_faults.wrong_episodes import WrongEpisodes
from camber.validation.protection_level_statistics import availability, positions_by_epoch
from camber.validation.reference_trajectory import truth_of

CAPTURED_M = 0.5
"""A pose farther off than a fix may be, after a wrong fix was confirmed."""


def recovery(drive: FaultDrive, output: DriveOutput, episodes: WrongEpisodes) -> dict[str, Any]:
    """Figures of the episodes that end before the drive does; times in seconds from the first right fix on."""
    verdicts = {
        i.message.time_ns: i.message for i in output.recorded["verdict"] if i.message.fix_id is not None
    }
    poses = [item.message for item in output.recorded["pose"] if item.message.latitude_rad is not None]
    pose_ns, pose_error_m = _pose_errors(drive, poses)
    time_ns, wrong = drive.fixes.time_ns, drive.fixes.wrong
    start_ns = int(time_ns[0])
    to_unknown, to_confirmed, captured = [], [], 0
    for begin_s, end_s in zip(episodes.begin_s.tolist(), episodes.end_s.tolist(), strict=True):
        inside = _rows(
            time_ns, start_ns + round(begin_s * NS_PER_SECOND), start_ns + round(end_s * NS_PER_SECOND)
        )
        after = np.flatnonzero((time_ns >= start_ns + round(end_s * NS_PER_SECOND)) & ~wrong)
        if not len(inside) or not len(after):
            continue
        first_ns = int(time_ns[after[0]])
        passed = any(_is(verdicts, t, CONFIRMED_VERDICTS) for t in time_ns[inside[wrong[inside]]].tolist())
        k = int(np.searchsorted(pose_ns, first_ns, side="right")) - 1
        if not (passed and k >= 0 and pose_error_m[k] > CAPTURED_M):
            continue
        captured += 1
        times = time_ns[after].tolist()
        to_unknown.append(_first(verdicts, times, (*CONFIRMED_VERDICTS, "unknown"), first_ns))
        to_confirmed.append(_first(verdicts, times, CONFIRMED_VERDICTS, first_ns))
    recorded = output.recorded["position"]
    positions = positions_by_epoch(recorded, truth_of(drive.truth), (0.0, 0.0, 0.0), None)
    return {
        "episodes": len(episodes.begin_s),
        "captured": captured,
        "to_unknown_s": to_unknown,
        "to_confirmed_s": to_confirmed,
        "availability": availability(positions, time_ns),
    }


def _pose_errors(drive: FaultDrive, poses: Sequence[Pose]) -> tuple[Int64, Float64]:
    time_ns = np.array([pose.time_ns for pose in poses], np.int64)
    latitude, longitude = (
        np.array([getattr(pose, name) for pose in poses], np.float64)
        for name in ("latitude_rad", "longitude_rad")
    )
    error = truth_of(drive.truth).error_enu_m(
        time_ns, latitude, longitude, np.zeros(len(poses)), offset_enu_m=(0.0, 0.0, 0.0)
    )
    return time_ns, np.hypot(error[:, 0], error[:, 1])


def _rows(time_ns: Int64, begin_ns: int, end_ns: int) -> Int64:
    return np.flatnonzero((time_ns >= begin_ns) & (time_ns < end_ns))


def _is(verdicts: dict[int, Verdict], time_ns: int, names: Sequence[str]) -> bool:
    return time_ns in verdicts and verdicts[time_ns].verdict in names


def _first(
    verdicts: dict[int, Verdict], times_ns: Sequence[int], names: Sequence[str], first_ns: int
) -> float | None:
    """Seconds to the first of these verdicts; None: never."""
    return next(((t - first_ns) / NS_PER_SECOND for t in times_ns if _is(verdicts, t, names)), None)

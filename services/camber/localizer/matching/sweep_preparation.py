"""Preparation of a sweep for matching: deskewed, in the vehicle frame of its end, thinned.

Problems of a sweep are stated in `problem`; nothing raises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.arrays import Floats
from camber.localizer.filter.track import RelativeTrack, TrackPoint
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.deskewing import SECTORS, SweepOptions, SweepTimes, deskew, sweep_motions
from camber.schemas.lidar import Sweep

SweepProblem: TypeAlias = Literal[
    "empty",
    "too_few_points",
    "repeated",
    "from_the_future",
    "too_old",
    "no_motion",
    "bad_offsets",
    "half_sweep",
    "no_offsets",
]
"""The first that applies. *repeated*: not newer than the last one; *no_motion*: the track does not cover it, its
points are as measured; *bad_offsets*: times of some points are of no part of this sweep, they are left out;
*no_offsets*: all points have the same time, so that nothing could be deskewed."""

_DEFAULT_OPTIONS: Final = SweepOptions()
_USABLE: Final = (None, "bad_offsets", "half_sweep", "no_offsets")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorMount:
    """Position and attitude of a sensor in the vehicle frame (`Rz(yaw) Ry(pitch) Rx(roll)`)."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def vehicle_from_sensor(self) -> Floats:
        """The mounting as a 4 × 4 matrix."""
        return map_from_vehicle(
            self.x_m,
            self.y_m,
            self.z_m,
            roll_rad=self.roll_rad,
            pitch_rad=self.pitch_rad,
            yaw_rad=self.yaw_rad,
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PreparedSweep:
    """Points (m, 3) in the vehicle frame at `time_ns`, the sweep's end; none where the sweep is not usable.

    `at`: the track's point at the end.
    """

    time_ns: int
    points_m: Floats
    problem: SweepProblem | None
    at: TrackPoint | None = None

    @property
    def usable(self) -> bool:
        """Whether it can be overlaid and matched."""
        return self.problem in _USABLE


def prepare_sweep(
    sweep: Sweep,
    mount: SensorMount,
    track: RelativeTrack,
    *,
    now_ns: int | None = None,
    last_time_ns: int | None = None,
    options: SweepOptions = _DEFAULT_OPTIONS,
) -> PreparedSweep:
    """Prepare a sweep: points (n, 3) in the sensor's frame, offsets (n,) ≤ 0 against its end at `time_ns`.

    `now_ns` identifies sweeps of the future and old ones, `last_time_ns` (of the sweep before) repeated ones; each
    test is left out where it is None.
    """
    time_ns, points_m, offset_ns = sweep.time_ns, sweep.points_m, sweep.offset_ns
    if points_m.ndim != 2 or points_m.shape[1] != 3 or offset_ns.shape != points_m.shape[:1]:
        raise ValueError(
            f"points_m, offset_ns have shapes {points_m.shape}, {offset_ns.shape}, expected (n, 3), (n,)"
        )
    wrong_time = _wrong_time(time_ns, now_ns, last_time_ns, options)
    if wrong_time is not None or not len(points_m):
        return PreparedSweep(time_ns=time_ns, points_m=np.zeros((0, 3)), problem=wrong_time or "empty")
    longest_ns = round(options.longest_s * 1e9)
    of_sweep = (offset_ns <= 0) & (offset_ns >= -longest_ns)
    span_ns = -int(offset_ns[of_sweep].min(initial=0))
    motions, at = sweep_motions(track, time_ns, span_ns)
    kept, seen = deskew(
        np.ascontiguousarray(points_m, np.float32),
        SweepTimes(np.ascontiguousarray(offset_ns, np.int32), longest_ns, span_ns),
        motions @ mount.vehicle_from_sensor,
        options,
    )
    bad_offsets = len(points_m) - int(of_sweep.sum())
    coverage = float(_SECTOR_SHARE[seen].sum())
    same_time = bad_offsets == 0 and len(points_m) > 1 and int(offset_ns.min()) == int(offset_ns.max())
    problem: SweepProblem | None = None
    if not len(kept):
        problem = "empty"
    elif len(kept) < options.min_points:
        problem = "too_few_points"
    elif at is None:
        problem = "no_motion"
    elif bad_offsets > options.max_bad_share * len(points_m):
        problem = "bad_offsets"
    elif coverage < options.min_coverage:
        problem = "half_sweep"
    elif same_time:
        problem = "no_offsets"
    return PreparedSweep(time_ns=time_ns, points_m=voxel_means(kept, options.voxel_m), problem=problem, at=at)


def _wrong_time(
    time_ns: int, now_ns: int | None, last_time_ns: int | None, options: SweepOptions
) -> SweepProblem | None:
    if last_time_ns is not None and time_ns <= last_time_ns:
        return "repeated"
    if now_ns is not None and time_ns - now_ns > options.ahead_s * 1e9:
        return "from_the_future"
    if now_ns is not None and now_ns - time_ns > options.too_old_s * 1e9:
        return "too_old"
    return None


def _sector_share() -> Floats:
    """Return the share of the full turn of each sector, even in y / (|x| + |y|) and not in the azimuth."""
    edge = np.linspace(0.0, 4.0, SECTORS + 1)
    quarter, rest = np.divmod(edge[:-1], 1.0)
    begin = quarter * 0.5 * math.pi + np.arctan2(rest, 1.0 - rest)
    return np.diff(np.append(begin, 2.0 * math.pi)) / (2.0 * math.pi)


_SECTOR_SHARE: Final = _sector_share()

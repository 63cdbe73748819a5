"""Local map (JP2016-109650A, step 4): the latest sweeps overlaid in the vehicle frame of the newest.

The motion between sweeps is `[R_z(Δψ) T_x(Δs)]`. Where roll and pitch against gravity are known for each sweep it
is rotated by them, and the path rises and falls with the road; otherwise the road is taken for a plane that moves
with the vehicle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.localizer.arrays import Floats, Integers
from camber.localizer.filter.track import OverlayLag, TrackPoint
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.sweep_preparation import PreparedSweep

Tilt: TypeAlias = tuple[float, float]
"""Roll and pitch [rad], pitch positive with the nose down."""

LEVEL: Final[Tilt] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalCloud:
    """Points (n, 3) in the vehicle frame of the newest sweep, and its lag from the mean of all sweeps.

    The match observes where the sweeps were; the motion since is dead reckoning's.
    """

    points_m: Floats
    lag: OverlayLag


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _PlacedSweep:
    """A sweep with its position in a level frame that does not turn, and its attitude."""

    sweep: PreparedSweep
    at: TrackPoint
    position_m: Floats
    attitude: Tilt | None
    grade_rad: float

    @property
    def level_from_vehicle(self) -> Floats:
        roll_rad, pitch_rad = self.attitude or LEVEL
        return rotation_from_roll_pitch_yaw(roll_rad, pitch_rad, self.at.yaw_rad)


class LocalMap:
    """The latest `sweeps` sweeps. It restarts after a gap in time or a jump of the track."""

    def __init__(
        self,
        sweeps: int = 10,
        *,
        voxel_m: float = 0.3,
        reach_m: float = 60.0,
        max_gap_s: float = 1.0,
        max_step_m: float = 25.0,
    ) -> None:
        self._placed: deque[_PlacedSweep] = deque(maxlen=sweeps)
        self._voxel_m, self._reach_m = voxel_m, reach_m
        self._max_gap_ns, self._max_step_m = round(max_gap_s * 1e9), max_step_m

    def __len__(self) -> int:
        return len(self._placed)

    def reset(self) -> None:
        """Clear all sweeps: the motion since them is not known well enough."""
        self._placed.clear()

    def add(
        self, sweep: PreparedSweep, at: TrackPoint, attitude: Tilt | None = None, *, road_tilt: Tilt = LEVEL
    ) -> None:
        """Add a usable sweep, the track's point at its end, and roll and pitch against gravity where known.

        `road_tilt` is that of the body against the road: the path follows the road, not the body. Sweeps before a
        gap, a jump of the track or a change from known to unknown attitude are cleared.
        """
        last = self._placed[-1] if self._placed else None
        if last is not None and self._is_discontinuous(last, sweep, at, attitude=attitude):
            self._placed.clear()
            last = None
        grade = 0.0 if attitude is None else attitude[1] - road_tilt[1]
        position = np.zeros(3) if last is None else last.position_m + _step(last, at, grade)
        self._placed.append(
            _PlacedSweep(sweep=sweep, at=at, position_m=position, attitude=attitude, grade_rad=grade)
        )

    def overlay(self) -> LocalCloud | None:
        """Return all sweeps in the vehicle frame of the newest, thinned; None without any."""
        if not self._placed:
            return None
        newest = self._placed[-1]
        newest_first = list(reversed(self._placed))  # the newest determines the voxels
        newest_from_level = newest.level_from_vehicle.T
        motions = np.empty((len(newest_first), 3, 4))
        for motion, placed in zip(motions, newest_first, strict=True):
            motion[:, :3] = newest_from_level @ placed.level_from_vehicle
            motion[:, 3] = newest_from_level @ (placed.position_m - newest.position_m)
        points = np.concatenate([placed.sweep.points_m for placed in newest_first])
        ends = np.cumsum([len(placed.sweep.points_m) for placed in newest_first])
        points_m = voxel_means(_moved(points, ends, motions, self._reach_m), self._voxel_m)
        at, n = newest.at, len(self._placed)
        lag = OverlayLag(
            path_m=sum(at.path_m - placed.at.path_m for placed in self._placed) / n,
            wheel_m=sum(at.wheel_m - placed.at.wheel_m for placed in self._placed) / n,
            wheel_change_m_s=sum(at.wheel_m_s - placed.at.wheel_m_s for placed in self._placed) / n,
            duration_s=1e-9 * sum(newest.sweep.time_ns - placed.sweep.time_ns for placed in self._placed) / n,
        )
        return LocalCloud(points_m=points_m, lag=lag)

    def _is_discontinuous(
        self, last: _PlacedSweep, sweep: PreparedSweep, at: TrackPoint, *, attitude: Tilt | None
    ) -> bool:
        gap_ns = sweep.time_ns - last.sweep.time_ns
        step_m = at.path_m - last.at.path_m
        return (
            not 0 < gap_ns <= self._max_gap_ns
            or not 0.0 <= step_m <= self._max_step_m
            or (attitude is None) != (last.attitude is None)
        )


def _step(last: _PlacedSweep, at: TrackPoint, grade_rad: float) -> Floats:
    """Return the displacement between sweeps in the level frame; the track counts metres of road, not of map."""
    east, north = at.east_m - last.at.east_m, at.north_m - last.at.north_m
    yaw = 0.5 * (last.at.yaw_rad + at.yaw_rad)
    mean_grade = 0.5 * (last.grade_rad + grade_rad)
    ahead = east * math.cos(yaw) + north * math.sin(yaw)
    shortened = ahead * (math.cos(mean_grade) - 1.0)
    return np.array(
        [east + shortened * math.cos(yaw), north + shortened * math.sin(yaw), -ahead * math.sin(mean_grade)]
    )


@compiled_without_gil
def _moved(points_m: Floats, ends: Integers, motions: Floats, reach_m: float) -> Floats:
    """Return points (n, 3) of several clouds, each by its motion (clouds, 3, 4), without those beyond the reach."""
    moved = np.empty(points_m.shape)
    at = 0
    cloud = 0
    for i in range(len(points_m)):
        while i >= ends[cloud]:
            cloud += 1
        m = motions[cloud]
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        if px * px + py * py > reach_m * reach_m:
            continue
        moved[at, 0], moved[at, 1] = px, py
        moved[at, 2] = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        at += 1
    return moved[:at].copy()

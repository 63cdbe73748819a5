"""The observed local map: the latest sweeps overlaid in the vehicle frame of the newest.

Step 4 of layered matching (spec/layered-matching.md): the motion between sweeps is `[R_z(Δψ) T_x(Δs)]`. Where roll and
pitch against gravity are known for each sweep it is turned by them, and the way leads up and down with the road; where
they are not, the road is taken for a plane that stands still under the wheels.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.localizer.filter.dead_reckoning import OverlayLag, TrackPoint
from camber.localizer.map_clouds.voxel_grid import Floats, voxel_means
from camber.localizer.matching.sweep_preparation import PreparedSweep

Integers = NDArray[np.int64]
Tilt = tuple[float, float]
"""Roll and pitch (rad), pitch positive with the nose down."""

LEVEL: Final[Tilt] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LocalCloud:
    """Points (n, 3) in the vehicle frame at `time_ns`; `sweeps` of them were overlaid, driven over `path_m`.

    `behind`: the sweeps' mean. What is matched is where they were; the rest of the way is dead reckoning's.
    """

    time_ns: int
    points_m: Floats
    sweeps: int
    path_m: float
    behind: OverlayLag


@dataclass(frozen=True, slots=True, eq=False)
class _Stand:
    """Where a sweep was taken: place in a frame that is level and turns with nothing, yaw, and attitude."""

    sweep: PreparedSweep
    at: TrackPoint
    place_m: Floats
    attitude: Tilt | None
    grade_rad: float


class LocalMap:
    """The latest `sweeps` sweeps. It begins anew after a gap in time or a jump of the track."""

    def __init__(
        self,
        sweeps: int = 10,
        *,
        voxel_m: float = 0.3,
        reach_m: float = 60.0,
        most_gap_s: float = 1.0,
        most_step_m: float = 25.0,
    ) -> None:
        self._stands: deque[_Stand] = deque(maxlen=sweeps)
        self._voxel_m, self._reach_m = voxel_m, reach_m
        self._most_gap_ns, self._most_step_m = round(most_gap_s * 1e9), most_step_m

    def __len__(self) -> int:
        return len(self._stands)

    def reset(self) -> None:
        """Forget all sweeps: the track has been broken, or the way since them is not known well enough."""
        self._stands.clear()

    def add(
        self,
        sweep: PreparedSweep,
        at: TrackPoint,
        attitude: Tilt | None = None,
        *,
        road_tilt: Tilt = LEVEL,
    ) -> None:
        """Take a usable sweep, the track's point at its end, and roll and pitch against gravity where known.

        `road_tilt` is that of the body against the road, where known: the way leads along the road, not the body.
        Sweeps before a gap, a jump of the track or a change from known to unknown attitude are forgotten.
        """
        last = self._stands[-1] if self._stands else None
        if last is not None and self._breaks(last, sweep, at, attitude):
            self._stands.clear()
            last = None
        grade = 0.0 if attitude is None else attitude[1] - road_tilt[1]
        place = np.zeros(3) if last is None else last.place_m + _step(last, at, grade)
        self._stands.append(_Stand(sweep, at, place, attitude, grade))

    def overlay(self) -> LocalCloud | None:
        """All sweeps in the vehicle frame of the newest, thinned; None without any."""
        if not self._stands:
            return None
        newest = self._stands[-1]
        newest_from_level = _level_from_vehicle(newest).T
        motions = np.empty((len(self._stands), 3, 4))
        for motion, stand in zip(motions, self._stands, strict=True):
            motion[:, :3] = newest_from_level @ _level_from_vehicle(stand)
            motion[:, 3] = newest_from_level @ (stand.place_m - newest.place_m)
        # The newest first: of its points the cells are begun.
        points = np.concatenate([stand.sweep.points_m for stand in reversed(self._stands)])
        ends = np.cumsum([len(stand.sweep.points_m) for stand in reversed(self._stands)])
        moved = _moved(points, ends, motions[::-1].copy(), self._reach_m)
        return LocalCloud(
            time_ns=newest.sweep.time_ns,
            points_m=voxel_means(moved, self._voxel_m),
            sweeps=len(self._stands),
            path_m=newest.at.path_m - self._stands[0].at.path_m,
            behind=self._behind(),
        )

    def _behind(self) -> OverlayLag:
        newest, n = self._stands[-1].at, len(self._stands)
        return OverlayLag(
            sum(newest.path_m - stand.at.path_m for stand in self._stands) / n,
            sum(newest.wheel_m - stand.at.wheel_m for stand in self._stands) / n,
            sum(newest.wheel_m_s - stand.at.wheel_m_s for stand in self._stands) / n,
        )

    def _breaks(self, last: _Stand, sweep: PreparedSweep, at: TrackPoint, attitude: Tilt | None) -> bool:
        gap_ns = sweep.time_ns - last.sweep.time_ns
        step_m = at.path_m - last.at.path_m
        return (
            not 0 < gap_ns <= self._most_gap_ns
            or not 0.0 <= step_m <= self._most_step_m
            or (attitude is None) != (last.attitude is None)
        )


def _step(last: _Stand, at: TrackPoint, grade_rad: float) -> Floats:
    """The way from one sweep to the next in the level frame; the track counts metres of road, not of map."""
    east, north = at.east_m - last.at.east_m, at.north_m - last.at.north_m
    yaw = 0.5 * (last.at.yaw_rad + at.yaw_rad)
    mean_grade = 0.5 * (last.grade_rad + grade_rad)
    ahead = east * math.cos(yaw) + north * math.sin(yaw)
    shortened = ahead * (math.cos(mean_grade) - 1.0)
    return np.array(
        [
            east + shortened * math.cos(yaw),
            north + shortened * math.sin(yaw),
            -ahead * math.sin(mean_grade),
        ]
    )


def _level_from_vehicle(stand: _Stand) -> Floats:
    roll_rad, pitch_rad = stand.attitude or LEVEL
    return rotation_from_roll_pitch_yaw(roll_rad, pitch_rad, stand.at.yaw_rad)


@compiled_without_gil
def _moved(points_m: Floats, ends: Integers, motions: Floats, reach_m: float) -> Floats:
    """Points (n, 3) of several clouds, each by its own motion (clouds, 3, 4); those beyond the reach left out."""
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

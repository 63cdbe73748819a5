"""Where a point of the vehicle's body was, and how it was turned, at any time between a trajectory's samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.vehicle.attitude import rotations, turned
from camber.simulator.vehicle.body import Point, VehicleBody


@dataclass(frozen=True, slots=True, eq=False)
class PoseTrack:
    """Position (n, 3) [m] of a point fixed to the body and `angles_rad` (n, 3): roll, pitch, yaw, unwrapped.

    Between samples both change evenly: at 100 Hz and 3 m/s² that is right to 0.04 mm.
    """

    time_ns: Integers
    position_m: Floats
    angles_rad: Floats

    @classmethod
    def of(cls, trajectory: Trajectory, body: VehicleBody, point: Point) -> Self:
        """Of a point in the vehicle frame, by its lever arm from the antenna: heave and all are in that."""
        t = trajectory
        lever = (point[0] - body.antenna[0], point[1] - body.antenna[1], point[2] - body.antenna[2])
        rotation = rotations(t.roll_rad, t.pitch_rad, t.yaw_rad)
        angles = np.column_stack((t.roll_rad, t.pitch_rad, np.unwrap(t.yaw_rad)))
        return cls(t.time_ns, t.antenna_m + turned(rotation, lever), angles)

    def at(self, time_ns: Integers) -> tuple[Floats, Floats]:
        """Position (m, 3) and world-from-body rotation (m, 3, 3) at times (m,), clipped to the track's."""
        start = self.time_ns[0]
        known, asked = (self.time_ns - start).astype(np.float64), (time_ns - start).astype(np.float64)
        columns = [np.interp(asked, known, c) for c in (*self.position_m.T, *self.angles_rad.T)]
        return np.column_stack(columns[:3]), rotations(*columns[3:])


def points_in_world(
    track: PoseTrack, points_m: Floats, offset_ns: Integers, end_ns: int, step_ns: int = 500_000
) -> Floats:
    """Points (n, 3) measured in the body's axes about the track's point, each at `end_ns` + its offset, in the world.

    Poses are taken every `step_ns`; between them the rotation's elements change evenly, which at 1 rad/s is right to
    1e-7 rad.
    """
    if not len(points_m):
        return np.zeros((0, 3))
    first_ns = int(offset_ns.min())
    count = max(2, -(-(int(offset_ns.max()) - first_ns) // step_ns) + 1)
    position, rotation = track.at(end_ns + first_ns + step_ns * np.arange(count, dtype=np.int64))
    share = (offset_ns.astype(np.float64) - first_ns) / step_ns
    return _placed(np.asarray(points_m, np.float64), share, position, np.ascontiguousarray(rotation))


def undo_motion(track: PoseTrack, points_m: Floats, offset_ns: Integers, end_ns: int) -> Floats:
    """The points (n, 3) as the sensor would have measured them had it stood where it was at `end_ns` all the time."""
    position, rotation = track.at(np.array([end_ns]))
    still: Floats = (points_in_world(track, points_m, offset_ns, end_ns) - position) @ rotation[0]
    return still


@compiled_without_gil
def _placed(points: Floats, share: Floats, position: Floats, rotation: Floats) -> Floats:
    placed = np.empty_like(points)
    for i in range(len(points)):
        k = min(int(share[i]), len(position) - 2)
        b = share[i] - k
        for row in range(3):
            value = position[k, row] + b * (position[k + 1, row] - position[k, row])
            for column in range(3):
                r0, r1 = rotation[k, row, column], rotation[k + 1, row, column]
                value += (r0 + b * (r1 - r0)) * points[i, column]
            placed[i, row] = value
    return placed

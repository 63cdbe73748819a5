"""Vehicles that move around the simulated one: boxes that the LiDAR's rays may meet before anything fixed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.simulator.scene import Floats, Hits, Integers, Material, Path
from camber.simulator.vehicle.driven_path import DrivenPath

_STEP_NS = 100_000_000  # chosen: a turn of a LiDAR
_VEHICLE = int(Material.VEHICLE)
_SENSOR_MOVES_M = 10.0  # chosen: more than the sensor moves within the time asked for


Boxes = tuple[Floats, Floats, Floats]
"""Poses (k, 4) at two times, and `half_m`, as in `Traffic`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """A box that goes along a path at an even speed, from `start_m` on, `left_m` to its left; at its end it stops."""

    path: Path
    start_m: float
    speed_m_s: float
    left_m: float = 0.0
    length_m: float = 4.4
    width_m: float = 1.8
    height_m: float = 1.5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Traffic:
    """k upright boxes at times (m,): `pose` (m, k, 4) east, north of the centre, up of the base, yaw (unwrapped);
    `half_m` (k, 3) half length, half width, height. Between the times they move evenly."""

    time_ns: Integers
    pose: Floats
    half_m: Floats

    @classmethod
    def of(cls, users: Sequence[RoadUser], start_ns: int, end_ns: int) -> Self:
        """All of them over a time, ten poses a second."""
        time_ns = start_ns + _STEP_NS * np.arange((end_ns - start_ns) // _STEP_NS + 2, dtype=np.int64)
        passed_s = (time_ns - start_ns) / 1e9
        pose = np.empty((len(time_ns), len(users), 4))
        paths = {id(user.path): user.path for user in users}
        driven_paths = {key: DrivenPath.along(path) for key, path in paths.items()}
        for k, user in enumerate(users):
            driven = driven_paths[id(user.path)]
            s = user.start_m + user.speed_m_s * passed_s
            middle, _, _ = driven.curve.at(s)
            yaw, _ = driven.yaw_and_turn(np.clip(s, 0.0, driven.distance_m[-1]))
            east, north = middle[:, 0] - user.left_m * np.sin(yaw), middle[:, 1] + user.left_m * np.cos(yaw)
            pose[:, k] = np.column_stack((east, north, driven.road_m(east, north, s), yaw))
        half = np.array([(0.5 * u.length_m, 0.5 * u.width_m, u.height_m) for u in users]).reshape(-1, 3)
        return cls(time_ns=time_ns, pose=pose, half_m=half)

    def between(self, first_ns: int, last_ns: int) -> tuple[Floats, Floats]:
        """Poses (k, 4) at two times, clipped to those known."""
        both = np.clip(np.array([first_ns, last_ns]), self.time_ns[0], self.time_ns[-1])
        after = np.clip(np.searchsorted(self.time_ns, both, side="right"), 1, len(self.time_ns) - 1)
        span = self.time_ns[after] - self.time_ns[after - 1]
        share = ((both - self.time_ns[after - 1]) / span)[:, None, None]
        poses = self.pose[after - 1] + share * (self.pose[after] - self.pose[after - 1])
        return poses[0], poses[1]

    def near(self, first_ns: int, last_ns: int, place_m: Floats, range_m: float) -> Boxes:
        """`between`, and the boxes' sizes, of those only that come within a range of a place (3,), or nearly so."""
        first, last = self.between(first_ns, last_ns)
        reach = range_m + np.linalg.norm(self.half_m, axis=1) + np.hypot(*(last - first)[:, :2].T)
        chosen = np.hypot(first[:, 0] - place_m[0], first[:, 1] - place_m[1]) < reach + _SENSOR_MOVES_M
        return first[chosen], last[chosen], self.half_m[chosen]


@compiled_without_gil
def hit_traffic(rays: tuple[Floats, Floats], share: Floats, boxes: Boxes, hits: Hits) -> None:
    """Where a box is nearer than the hits of the rays (n,), write it there.

    `share` (n,): when each ray leaves, 0 at the boxes' first poses, 1 at the last. Boxes by slabs (Kay & Kajiya 1986);
    rays that begin inside a box do not see it.
    """
    origin, direction = rays
    first, last, half = boxes
    distance, material, normal = hits
    for k in range(len(half)):
        length, width, height = half[k, 0], half[k, 1], half[k, 2]
        radius2 = length * length + width * width + 0.25 * height * height
        for i in range(len(share)):
            f = share[i]
            x = origin[i, 0] - (first[k, 0] + f * (last[k, 0] - first[k, 0]))
            y = origin[i, 1] - (first[k, 1] + f * (last[k, 1] - first[k, 1]))
            z = origin[i, 2] - (first[k, 2] + f * (last[k, 2] - first[k, 2])) - 0.5 * height
            dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
            along = x * dx + y * dy + z * dz
            if x * x + y * y + z * z - along * along > radius2 or along > 0.0:
                continue
            yaw = first[k, 3] + f * (last[k, 3] - first[k, 3])
            cos, sin = math.cos(yaw), math.sin(yaw)
            a = (cos * x + sin * y, cos * y - sin * x, z)
            d = (cos * dx + sin * dy, cos * dy - sin * dx, dz)
            size = (length, width, 0.5 * height)
            enter, leave, axis = -math.inf, math.inf, 0
            for j in range(3):
                if d[j] == 0.0:
                    if abs(a[j]) > size[j]:
                        leave = -math.inf
                    continue
                near, far = (-size[j] - a[j]) / d[j], (size[j] - a[j]) / d[j]
                if near > far:
                    near, far = far, near
                if near > enter:
                    enter, axis = near, j
                leave = min(leave, far)
            if 0.0 < enter < leave and enter < distance[i]:
                distance[i] = enter
                material[i] = _VEHICLE
                side = -1.0 if d[axis] > 0.0 else 1.0
                normal[i, 0] = side * cos if axis == 0 else (-side * sin if axis == 1 else 0.0)
                normal[i, 1] = side * sin if axis == 0 else (side * cos if axis == 1 else 0.0)
                normal[i, 2] = side if axis == 2 else 0.0

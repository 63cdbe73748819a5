"""A path as a smooth curve with the road around it: where a vehicle is after so many metres, and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from camber.simulator.scene import Floats, Integers, Path
from camber.simulator.vehicle.attitude import rotations
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.cubic_curve import CubicCurve

_CONTACT_STEPS = 3  # each shrinks the error by about grade × unevenness


@dataclass(frozen=True, slots=True, eq=False)
class DrivenPath:
    """`curve`: east, north, up of the rear axle's middle over the distance driven (in space, not in the plane)."""

    path: Path
    curve: CubicCurve

    @classmethod
    def along(cls, path: Path) -> Self:
        """Raises ValueError for a path of fewer than four samples, or one that stands still."""
        points = np.column_stack((path.east_m, path.north_m, path.up_m))
        chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
        half_turn = 0.5 * np.diff(path.yaw_rad)
        distance_m = np.append(0.0, np.cumsum(chord / np.sinc(half_turn / np.pi)))
        return cls(path, CubicCurve.through(distance_m, points))

    @property
    def distance_m(self) -> Floats:
        """Of each sample of the path (n,)."""
        return self.curve.distance_m

    def sample_at(self, distance_m: Floats) -> Integers:
        """The nearest sample of the path (m,)."""
        s = self.distance_m
        return np.searchsorted(0.5 * (s[1:] + s[:-1]), distance_m).astype(np.int64)

    def yaw_and_turn(self, distance_m: Floats) -> tuple[Floats, Floats]:
        """Yaw of the curve [rad], unwrapped as the path's, and its derivative by distance [rad/m] (m,)."""
        _, first, second = self.curve.at(distance_m)
        near = self.path.yaw_rad[self.sample_at(distance_m)]
        across = np.cos(near) * first[:, 1] - np.sin(near) * first[:, 0]
        ahead = np.cos(near) * first[:, 0] + np.sin(near) * first[:, 1]
        turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        return near + np.arctan2(across, ahead), turn / (first[:, 0] ** 2 + first[:, 1] ** 2)

    def road_m(self, east_m: Floats, north_m: Floats, distance_m: Floats) -> Floats:
        """Height of the road's surface (m,) at points near the path after `distance_m`.

        That of `Path.surface_m` at the path's level there; where it knows none, the plane of the path's nearest sample
        by its grade and crossfall.
        """
        path, k = self.path, self.sample_at(distance_m)
        east, north = east_m - path.east_m[k], north_m - path.north_m[k]
        cos, sin = np.cos(path.yaw_rad[k]), np.sin(path.yaw_rad[k])
        along, left = cos * east + sin * north, cos * north - sin * east
        plane = path.up_m[k] + path.grade[k] * along + path.crossfall[k] * left
        surface = np.asarray(path.surface_m(east_m, north_m, path.level[k]), np.float64)
        return np.where(np.isfinite(surface), surface, plane)


def contact_curve(driven: DrivenPath, body: VehicleBody) -> CubicCurve:
    """What the four wheels rest on after each distance, four columns: the heights of the rear axle's middle and of the
    middle between the axles (both of the road), pitch and roll of the plane.

    From the road under the wheels' contact points, where the tilted vehicle has them.
    """
    path, s = driven.path, driven.distance_m
    length, half = body.wheelbase_m, 0.5 * body.track_m
    wheels = np.array([[0.0, half, 0.0], [0.0, -half, 0.0], [length, half, 0.0], [length, -half, 0.0]])
    yaw, _ = driven.yaw_and_turn(s)
    pitch = -np.arctan(path.grade)
    roll = np.arctan(path.crossfall * np.cos(pitch))
    rear = front = np.zeros(len(s))
    for _ in range(_CONTACT_STEPS):
        at = rotations(roll, pitch, yaw) @ wheels.T
        east, north = path.east_m[:, None] + at[:, 0], path.north_m[:, None] + at[:, 1]
        height = [driven.road_m(east[:, w], north[:, w], s + wheels[w, 0]) for w in range(4)]
        rear, front = 0.5 * (height[0] + height[1]), 0.5 * (height[2] + height[3])
        across = 0.5 * (height[0] - height[1] + height[2] - height[3])
        pitch = np.arcsin(np.clip((rear - front) / length, -0.9, 0.9))
        roll = np.arcsin(np.clip(across / (2.0 * half * np.cos(pitch)), -0.9, 0.9))
    return CubicCurve.through(s, np.column_stack((rear, 0.5 * (rear + front), pitch, roll)))

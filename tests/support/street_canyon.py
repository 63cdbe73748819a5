"""A street canyon as shapes and walls, and a drive through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.random_streams import stream
from camber.simulator.satellites.propagation import Surroundings
from camber.simulator.satellites.track import AntennaTrack
from camber.simulator.scene import Shapes, Walls
from camber.simulator.world.ray_tracing import ShapeTracer

STREET_M = 20.0
BLOCK_M = 30.0
HEIGHT_M = 50.0
HEIGHT_SIGMA_M = 15.0
GAPS = 0.1
OFF_MIDDLE_M = 3.0
SPEED_M_S = 8.0
DEPTH_M = 20.0
GROUND_M = 40.0
ANTENNA_M = 2.0
BEYOND_M = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class Canyon:
    """Houses on both sides of a straight street through the origin."""

    shapes: Shapes
    walls: Walls
    yaw_rad: float
    length_m: float

    def surroundings(self) -> Surroundings:
        return Surroundings(ShapeTracer(self.shapes), self.walls)


def street_canyon(seed: int, yaw_rad: float, length_m: float) -> Canyon:
    rng = stream(seed, "street canyon")
    along = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    across = np.array([-along[1], along[0]])
    count = int(np.ceil((length_m + 2.0 * BEYOND_M) / BLOCK_M))
    boxes: list[tuple[float, ...]] = []
    foot, direction, length, height, normal = [], [], [], [], []

    def wall(
        corner: NDArray[np.float64], run: NDArray[np.float64], m: float, up: float, out: NDArray[np.float64]
    ) -> None:
        foot.append([*corner, GROUND_M])
        direction.append(run)
        length.append(m)
        height.append(up)
        normal.append(out)

    for side in (1.0, -1.0):
        gap = rng.random(count) < GAPS
        heights = np.maximum(rng.normal(HEIGHT_M, HEIGHT_SIGMA_M, count), 5.0)
        for k in range(count):
            if gap[k]:
                continue
            start = -0.5 * length_m - BEYOND_M + k * BLOCK_M
            up = float(heights[k])
            front = along * start + across * side * 0.5 * STREET_M
            middle = along * (start + 0.5 * BLOCK_M) + across * side * 0.5 * (STREET_M + DEPTH_M)
            boxes.append((middle[0], middle[1], GROUND_M, 0.5 * BLOCK_M, 0.5 * DEPTH_M, up, yaw_rad))
            wall(front, along, BLOCK_M, up, -side * across)
            wall(front, side * across, DEPTH_M, up, -along)
            wall(front + along * BLOCK_M, side * across, DEPTH_M, up, along)
    walls = Walls(
        foot_m=np.array(foot),
        along=np.array(direction),
        length_m=np.array(length),
        height_m=np.array(height),
        normal=np.array(normal),
    )
    return Canyon(Shapes.of(boxes=boxes), walls, yaw_rad, length_m)


def drive_through(canyon: Canyon, begin_ns: int, duration_s: float, rate_hz: int) -> AntennaTrack:
    n = round(duration_s * rate_hz)
    s = np.arange(n) / rate_hz
    c, d = np.cos(canyon.yaw_rad), np.sin(canyon.yaw_rad)
    along_m = SPEED_M_S * (s - 0.5 * duration_s)
    east, north = along_m * c + OFF_MIDDLE_M * d, along_m * d - OFF_MIDDLE_M * c
    position = np.column_stack((east, north, np.full(n, GROUND_M + ANTENNA_M)))
    time_ns = begin_ns + np.arange(n, dtype=np.int64) * (NS_PER_SECOND // rate_hz)
    velocity = np.tile([SPEED_M_S * c, SPEED_M_S * d, 0.0], (n, 1))
    return AntennaTrack(time_ns=time_ns, antenna_m=position, antenna_velocity_m_s=velocity)

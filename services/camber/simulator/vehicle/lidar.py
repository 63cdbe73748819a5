"""Sweeps of a rotating LiDAR on a moving vehicle, as measured: motion, noise, drop-outs and other traffic in them.

Every ray leaves from where the sensor truly is at its own time. What a surface sends back falls with the angle of
incidence (Lambert) and the square of the range, σ = ρ cos α (100 m / r)²; a return is noticed with probability
1 − exp(−σ / σ₀), and a small share is lost regardless: panes and puddles. Crowns of trees let rays in by some
decimetres. Random numbers are drawn for each sweep from a stream of its own, so sweeps may be made in any order.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.schemas.lidar import Sweep
from camber.simulator.injected_faults import BlockedLidar, Fault, SymmetricScene
from camber.simulator.random_streams import stream
from camber.simulator.scene import Booleans, Floats, Hits, Integers, Material
from camber.simulator.vehicle.beam_pattern import BeamPattern
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.traffic import Traffic, hit_traffic
from camber.simulator.world.ray_tracing import ShapeTracer

_REFLECTIVITY = {
    Material.ROAD: 0.17,
    Material.GROUND: 0.25,
    Material.BUILDING: 0.45,
    Material.POLE: 0.55,
    Material.TREE: 0.35,
    Material.VEHICLE: 0.50,
    Material.TUNNEL: 0.30,
}
"""Of near infrared: common values for asphalt, soil, plaster, galvanised steel, leaves, paint, concrete."""
_LOST_SHARE = {Material.BUILDING: 0.06, Material.VEHICLE: 0.12}  # chosen: panes send back nothing
_LOST_ELSEWHERE = 0.005  # chosen: puddles and the like
_NOTICED = 0.05  # σ₀, chosen: asphalt is seen to some 45 m by a sensor 2 m above it
_INTO_CROWN_M = 0.25  # chosen: mean depth between leaves
_FULL_INTENSITY = 255.0  # a byte, as in common sensors


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scan:
    """A sweep as the sensor gives it, with the truth: of what each point is (points,)."""

    sweep: Sweep
    material: NDArray[np.int8]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedLidar:
    """A sensor on a vehicle in a place. `track` is that of the sensor's origin."""

    pattern: BeamPattern
    track: PoseTrack
    tracer: ShapeTracer
    seed: int
    traffic: Traffic | None = None
    faults: Sequence[Fault] = ()

    def scans(self, threads: int = 2, every: int = 1) -> Iterator[Scan]:
        """One scan every so many turns while the track lasts, in order; as many at a time as there are threads."""
        start_ns = int(self.track.time_ns[0])
        turns = (int(self.track.time_ns[-1]) - start_ns) // self.pattern.turn_ns
        beams = _Beams.of(self.pattern)
        waiting: deque[Future[Scan]] = deque()
        with ThreadPoolExecutor(threads) as pool:
            try:
                for turn in range(0, turns, every):
                    waiting.append(pool.submit(self._scan, beams, start_ns, turn))
                    if len(waiting) > threads:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()

    def _scan(self, beams: _Beams, start_ns: int, turn: int) -> Scan:
        pattern = self.pattern
        begin_ns = start_ns + turn * pattern.turn_ns
        end_ns = begin_ns + pattern.turn_ns
        columns = pattern.columns
        ticks = np.rint(np.arange(columns + 1) * (pattern.turn_ns / columns)).astype(np.int64)
        position, rotation = self.track.at(begin_ns + ticks)
        rays = _rays(beams, columns, position, np.ascontiguousarray(rotation))
        hits = self.tracer.first_hits(*rays, pattern.most_range_m)
        if self.traffic is not None:
            boxes = self.traffic.near(begin_ns, end_ns, rays[0][0], pattern.most_range_m)
            hit_traffic(rays, beams.share, boxes, hits)
        passed_s = (begin_ns - start_ns) / 1e9
        for fault in self.faults:
            if fault.acts(np.array([passed_s]))[0]:
                hits.distance_m[_unseen(fault, beams.in_sensor, hits.material)] = np.inf
        rng = stream(self.seed, f"{pattern.name} sweep {turn}")
        chance = rng.random((2, pattern.rays), np.float32)
        noise = rng.standard_normal(pattern.rays, np.float32)
        limits = pattern.least_range_m, pattern.most_range_m, pattern.range_sigma_m, pattern.range_step_m
        points, intensity, offset, kind = _measured(
            beams, rays[1], hits, draws=(chance, noise), limits=limits
        )
        sweep = Sweep(
            time_ns=end_ns, sensor=pattern.name, points_m=points, intensity=intensity, offset_ns=offset
        )
        return Scan(sweep=sweep, material=kind)


class _Beams(NamedTuple):
    """What is the same in every turn: directions in the sensor (rays, 3), offsets and shares of the turn (rays,)."""

    in_sensor: Floats
    offset_ns: NDArray[np.int32]
    share: Floats
    up_m: Floats

    @classmethod
    def of(cls, pattern: BeamPattern) -> _Beams:
        offset = pattern.offsets_ns()
        share = 1.0 + offset / pattern.turn_ns
        return cls(pattern.directions(), offset.astype(np.int32), share, pattern.rises_m())


def _unseen(fault: Fault, in_sensor: Floats, material: Integers) -> Booleans:
    """Rays (n,) that see nothing: of the directions from straight ahead to both sides, or off road and ground."""
    if isinstance(fault, SymmetricScene):
        return np.asarray((material != Material.ROAD) & (material != Material.GROUND))
    share = fault.share if isinstance(fault, BlockedLidar) else 0.0
    return np.abs(np.arctan2(in_sensor[:, 1], in_sensor[:, 0])) < share * np.pi


_SURFACES = np.array([(_REFLECTIVITY[m], _LOST_SHARE.get(m, _LOST_ELSEWHERE)) for m in Material])


@compiled_without_gil
def _rays(beams: _Beams, columns: int, position: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """Each ray from the pose between the columns' (columns + 1,), elements changing evenly within 56 µs."""
    in_sensor, column_share, up_m = beams.in_sensor, beams.share * columns, beams.up_m
    origin, direction = np.empty_like(in_sensor), np.empty_like(in_sensor)
    for i in range(len(in_sensor)):
        k = min(int(column_share[i]), len(position) - 2)
        b = column_share[i] - k
        for row in range(3):
            origin[i, row] = position[k, row] + b * (position[k + 1, row] - position[k, row])
            origin[i, row] += rotation[k, row, 2] * up_m[i]
            value = 0.0
            for column in range(3):
                r0, r1 = rotation[k, row, column], rotation[k + 1, row, column]
                value += (r0 + b * (r1 - r0)) * in_sensor[i, column]
            direction[i, row] = value
    return origin, direction


@compiled_without_gil
def _measured(
    beams: _Beams,
    direction: Floats,
    hits: Hits,
    draws: tuple[NDArray[np.float32], NDArray[np.float32]],
    limits: tuple[float, float, float, float],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32], NDArray[np.int8]]:
    """What comes back and is noticed: points (m, 3) in the sensor, intensity, offsets, materials (m,).

    `draws`: chances (2, rays) and noise (rays,); `limits`: least and most range, σ and step of the range.
    """
    distance, material, normal = hits
    chance, noise = draws
    least, most, sigma, step = limits
    n = len(distance)
    points = np.empty((n, 3), np.float32)
    intensity = np.empty(n, np.float32)
    offset = np.empty(n, np.int32)
    kind = np.empty(n, np.int8)
    m = 0
    for i in range(n):
        r = distance[i]
        if not least <= r <= most:
            continue
        facing = 0.0
        for j in range(3):
            facing += normal[i, j] * direction[i, j]
        reflectivity, lost = _SURFACES[material[i], 0], _SURFACES[material[i], 1]
        returned = reflectivity * abs(facing)
        signal = returned * (100.0 / r) ** 2
        if chance[0, i] >= (1.0 - lost) * (1.0 - math.exp(-signal / _NOTICED)):
            continue
        if material[i] == _TREE:
            r -= _INTO_CROWN_M * abs(facing) * math.log(1.0 - chance[1, i])  # no further than it is thick
        r = step * round((r + sigma * noise[i]) / step)
        for j in range(3):
            points[m, j] = r * beams.in_sensor[i, j]
        points[m, 2] += beams.up_m[i]
        brightness = returned * (0.95 + 0.1 * chance[1, i])
        intensity[m] = math.floor(_FULL_INTENSITY * min(brightness, 1.0))
        offset[m] = beams.offset_ns[i]
        kind[m] = material[i]
        m += 1
    return points[:m].copy(), intensity[:m].copy(), offset[:m].copy(), kind[:m].copy()


_TREE = int(Material.TREE)

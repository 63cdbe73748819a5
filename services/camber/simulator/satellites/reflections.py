"""Signals that come by a wall: mirror geometry.

The satellite's direction s, mirrored in a wall of normal n, is s′ = s − 2 (s·n) n; an antenna at distance d in front of
the wall meets the wall along s′ after d / (s·n), and the path by the wall is longer by 2 d (s·n).
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Booleans, Floats, Integers, Walls
from camber.simulator.world.ray_tracing import ShapeTracer

CANDIDATES = 3  # chosen: a fourth wall hardly ever reflects where three nearer ones are hidden
_OFF_WALL_M = 0.05  # chosen: against rounding


def reflections(
    antenna_m: Floats, direction: Floats, walls: Walls, tracer: ShapeTracer, reach_m: float, sky_m: float
) -> tuple[Floats, Floats]:
    """The shortest free path by one wall: antenna (n, 3), directions to satellites (n, m, 3), in the world frame.

    By how much it is longer (n, m), NaN where there is none, and how that grows with the antenna's motion (n, m, 3).
    Walls further than `reach_m` away from the antenna are left out; `sky_m` is how far what blocks may stand.
    """
    n, m = direction.shape[:2]
    best = np.full((n, m), np.nan)
    slope = np.zeros((n, m, 3))
    if not len(walls.length_m) or not n or not m:
        return best, slope
    antenna, towards = np.ascontiguousarray(antenna_m), np.ascontiguousarray(direction)
    excess, distance, wall = _mirrored(antenna, towards, walls, reach_m)
    for k in range(CANDIDATES):
        epoch, satellite = np.nonzero((wall[..., k] >= 0) & np.isnan(best))
        if not len(epoch):
            continue
        s = direction[epoch, satellite]
        normal = np.zeros_like(s)
        normal[:, :2] = walls.normal[wall[epoch, satellite, k]]
        mirrored = s - 2.0 * np.sum(s * normal, axis=1)[:, None] * normal
        far = distance[epoch, satellite, k]
        at_wall = antenna_m[epoch] + far[:, None] * mirrored + _OFF_WALL_M * normal
        # From the wall back to the antenna, then on to the satellite: both must be free.
        back = antenna_m[epoch] - at_wall
        length = np.sqrt(np.sum(back**2, axis=1))
        back /= length[:, None]
        free = ~_blocked_within(tracer, at_wall, back, length - _OFF_WALL_M)
        free[free] = ~tracer.blocked(at_wall[free], s[free], sky_m)
        best[epoch[free], satellite[free]] = excess[epoch[free], satellite[free], k]
        grows = 2.0 * np.sum(s * normal, axis=1)[:, None] * normal
        slope[epoch[free], satellite[free]] = grows[free]
    return best, slope


def _blocked_within(tracer: ShapeTracer, origin_m: Floats, direction: Floats, length_m: Floats) -> Booleans:
    """Rays of their own lengths: what is blocked within the longest is looked at again by its distance."""
    if not len(length_m):
        return np.zeros(0, np.bool_)
    blocked = tracer.blocked(origin_m, direction, float(np.max(length_m))).copy()
    again = np.nonzero(blocked)[0]
    if len(again):
        hits = tracer.first_hits(origin_m[again], direction[again], float(np.max(length_m)))
        blocked[again] = hits.distance_m < length_m[again]
    return blocked


@compiled
def _mirrored(
    antenna: Floats, direction: Floats, walls: Walls, reach: float
) -> tuple[Floats, Floats, Integers]:
    foot, along, length, height, normal = walls
    n, m = direction.shape[0], direction.shape[1]
    excess = np.full((n, m, CANDIDATES), np.inf)
    distance = np.full((n, m, CANDIDATES), np.inf)
    wall = np.full((n, m, CANDIDATES), -1, np.int64)
    near = np.empty(len(length), np.int64)
    for i in range(n):
        count = 0
        for w in range(len(length)):
            x, y = antenna[i, 0] - foot[w, 0], antenna[i, 1] - foot[w, 1]
            d = x * normal[w, 0] + y * normal[w, 1]
            t = x * along[w, 0] + y * along[w, 1]
            if 0.05 < d < reach and -reach < t < length[w] + reach:
                near[count] = w
                count += 1
        for j in range(m):
            for q in range(count):
                w = near[q]
                c = direction[i, j, 0] * normal[w, 0] + direction[i, j, 1] * normal[w, 1]
                if c < 0.02:
                    continue
                x, y = antenna[i, 0] - foot[w, 0], antenna[i, 1] - foot[w, 1]
                d = x * normal[w, 0] + y * normal[w, 1]
                far = d / c
                sideways = direction[i, j, 0] * along[w, 0] + direction[i, j, 1] * along[w, 1]
                side = x * along[w, 0] + y * along[w, 1] + far * sideways
                up = antenna[i, 2] - foot[w, 2] + far * direction[i, j, 2]
                if side < 0.0 or side > length[w] or up < 0.0 or up > height[w]:
                    continue
                value = 2.0 * d * c
                k = CANDIDATES - 1
                if value >= excess[i, j, k]:
                    continue
                while k > 0 and value < excess[i, j, k - 1]:
                    excess[i, j, k] = excess[i, j, k - 1]
                    distance[i, j, k] = distance[i, j, k - 1]
                    wall[i, j, k] = wall[i, j, k - 1]
                    k -= 1
                excess[i, j, k], distance[i, j, k], wall[i, j, k] = value, far, w
    return excess, distance, wall

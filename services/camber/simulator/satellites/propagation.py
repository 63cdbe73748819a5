"""How signals come to the antenna: directly, over an edge, by a wall, through crowns of trees, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from camber.simulator.satellites.parameters import SignalParameters
from camber.simulator.satellites.reflections import reflections
from camber.simulator.scene import Booleans, Floats, Material, Shapes, Walls
from camber.simulator.world.ray_tracing import ShapeTracer

# Chosen: beyond any house of a district; thinner than the first Fresnel zone; to 0.2°; a few metres of a street.
_SKY_M = 1000.0
_THIN_M = 0.3
_BISECTIONS = 5
_ENCLOSURE_EVERY_M = 4.0


def what_blocks(shapes: Shapes) -> Shapes:
    """Without posts and trunks: what is much thinner than the first Fresnel zone casts no shadow. And without what
    hangs and stands in tunnels, where no signal comes.

    A strip of width w at distance d leaves 1 − ν (1 − j) / 2 of the field, ν = w √(2 / λd) (ITU-R P.526-15, 4.1): of a
    post of 0.2 m at 3 m 1.6 dB are lost and 7 mm are gained, for a tenth of a second while driving by.
    """
    thick = shapes.cylinders_m[:, 3] > _THIN_M
    outside = shapes.boxes_material != Material.TUNNEL
    return replace(
        shapes,
        boxes_m=shapes.boxes_m[outside],
        boxes_material=shapes.boxes_material[outside],
        cylinders_m=shapes.cylinders_m[thick],
        cylinders_material=shapes.cylinders_material[thick],
    )


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What stands around: the shapes that rays are traced through, and the walls that reflect."""

    tracer: ShapeTracer
    walls: Walls


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Propagation:
    """Per epoch and satellite (n, m).

    `direct`: nothing but crowns in between. `bent_rad`: how far below an edge the satellite stands, where the signal
    comes over it, else NaN; `edge_m` how far away that edge is. `crown_m`: metres of crowns on the straight line.
    `excess_m`: how much longer the shortest path by a wall is, NaN where there is none, and
    `excess_per_m` (n, m, 3) what it grows by with the antenna's motion. `enclosure` (n,): the share of
    the sky between 10° and 60° that is built up.
    """

    direct: Booleans
    bent_rad: Floats
    edge_m: Floats
    crown_m: Floats
    excess_m: Floats
    excess_per_m: Floats
    enclosure: Floats


def open_sky(n: int, m: int) -> Propagation:
    """Nothing around."""
    bent, edge, excess = np.full((3, n, m), np.nan)
    return Propagation(
        direct=np.ones((n, m), np.bool_),
        bent_rad=bent,
        edge_m=edge,
        crown_m=np.zeros((n, m)),
        excess_m=excess,
        excess_per_m=np.zeros((n, m, 3)),
        enclosure=np.zeros(n),
    )


def propagation(
    antenna_m: Floats,
    direction: Floats,
    elevation_rad: Floats,
    around: Surroundings,
    parameters: SignalParameters,
) -> Propagation:
    """Of antenna positions (n, 3) and directions to satellites (n, m, 3), both in the world frame.

    Satellites below the lowest elevation are not looked at: not direct and without any other path.
    """
    tracer, lowest_rad = around.tracer, np.deg2rad(parameters.lowest_elevation_deg)
    paths = open_sky(*direction.shape[:2])
    epoch, satellite = np.nonzero(elevation_rad >= lowest_rad)
    origin, towards = antenna_m[epoch], direction[epoch, satellite]
    blocked = tracer.blocked(origin, towards, _SKY_M)
    paths.direct[:] = False
    paths.direct[epoch, satellite] = ~blocked
    e, s = epoch[blocked], satellite[blocked]
    reach_rad = np.deg2rad(parameters.diffraction_reach_deg)
    paths.bent_rad[e, s], paths.edge_m[e, s] = _over_an_edge(
        origin[blocked], towards[blocked], tracer, reach_rad
    )
    comes = ~blocked
    comes[blocked] = np.isfinite(paths.bent_rad[e, s])
    through_m = tracer.through_crowns_m(origin[comes], towards[comes], _SKY_M)
    paths.crown_m[epoch[comes], satellite[comes]] = through_m
    reach_m = parameters.reflection_reach_m
    excess, per_m = reflections(antenna_m, direction, around.walls, tracer, reach_m=reach_m, sky_m=_SKY_M)
    excess[elevation_rad < lowest_rad] = np.nan
    return replace(paths, excess_m=excess, excess_per_m=per_m, enclosure=_enclosure(antenna_m, tracer))


def _over_an_edge(
    origin_m: Floats, direction: Floats, tracer: ShapeTracer, reach_rad: float
) -> tuple[Floats, Floats]:
    """How far the direction must be raised to be free, NaN where more than the reach; and the edge's distance."""
    count = len(origin_m)
    bent, edge = np.full(count, np.nan), np.full(count, np.nan)
    if not count:
        return bent, edge
    near = np.nonzero(~tracer.blocked(origin_m, _raised(direction, np.full(count, reach_rad)), _SKY_M))[0]
    low, high = np.zeros(len(near)), np.full(len(near), reach_rad)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        hidden = tracer.blocked(origin_m[near], _raised(direction[near], middle), _SKY_M)
        low, high = np.where(hidden, middle, low), np.where(hidden, high, middle)
    bent[near] = high
    hits = tracer.first_hits(origin_m[near], _raised(direction[near], low), _SKY_M)
    edge[near] = np.where(np.isfinite(hits.distance_m), hits.distance_m, _SKY_M)
    return bent, edge


def _raised(direction: Floats, by_rad: Floats) -> Floats:
    """Directions (n, 3) with elevations higher by (n,), not beyond the zenith."""
    across = np.hypot(direction[:, 0], direction[:, 1])
    elevation = np.minimum(np.arctan2(direction[:, 2], across) + by_rad, 0.5 * np.pi - 1e-6)
    scale = np.cos(elevation) / np.maximum(across, 1e-12)
    return np.column_stack((direction[:, 0] * scale, direction[:, 1] * scale, np.sin(elevation)))


def _enclosure(antenna_m: Floats, tracer: ShapeTracer) -> Floats:
    """The share of 72 directions that is blocked, every few metres driven, in between by interpolation."""
    step = np.sqrt(np.sum(np.diff(antenna_m, axis=0) ** 2, axis=1))
    driven_m = np.concatenate(([0.0], np.cumsum(step)))
    cells = np.floor(driven_m / _ENCLOSURE_EVERY_M).astype(np.int64)
    chosen = np.unique(np.concatenate((np.nonzero(np.diff(cells, prepend=-1))[0], [len(cells) - 1])))
    azimuth, elevation = np.meshgrid(np.arange(0.0, 360.0, 20.0), np.array([10.0, 25.0, 40.0, 55.0]))
    az, el = np.deg2rad(azimuth.ravel()), np.deg2rad(elevation.ravel())
    rays = np.column_stack((np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)))
    origins = np.repeat(antenna_m[chosen], len(rays), axis=0)
    blocked = tracer.blocked(origins, np.tile(rays, (len(chosen), 1)), _SKY_M)
    share = np.mean(blocked.reshape(len(chosen), len(rays)), axis=1)
    return np.interp(driven_m, driven_m[chosen], share)

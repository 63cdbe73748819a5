"""Paths of signals among walls, traced by another tracer."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.simulator.satellites.parameters import ROVER
from camber.simulator.satellites.propagation import Surroundings, propagation, what_blocks
from camber.simulator.satellites.reflections import reflections
from camber.simulator.scene import Hits, Shapes, Walls
from camber.simulator.world.ray_tracing import ShapeTracer

FAR_M = 1.0e9


class WallTracer(ShapeTracer):
    """Rays against upright rectangles, by their planes."""

    def __init__(self, walls: Walls, crown_m: float = 0.0) -> None:
        self.walls = walls
        self.crown_m = crown_m

    def distances(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        w = self.walls
        against = direction[:, :2] @ w.normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.sum((w.foot_m[None, :, :2] - origin[:, None, :2]) * w.normal, axis=-1) / against
            at = origin[:, None] + t[..., None] * direction[:, None]
            side = np.sum((at[..., :2] - w.foot_m[:, :2]) * w.along, axis=-1)
            up = at[..., 2] - w.foot_m[:, 2]
            on = (t > 1e-9) & (side >= 0) & (side <= w.length_m) & (up >= 0) & (up <= w.height_m)
        return np.where(on, t, np.inf)

    def first_hits(self, origin_m, direction, max_range_m):
        t = self.distances(origin_m, direction)
        nearest = t.min(axis=1, initial=np.inf)
        nearest = np.where(nearest <= max_range_m, nearest, np.inf)
        hit = np.isfinite(nearest)
        normal = np.zeros_like(direction)
        if t.shape[1]:
            normal[:, :2] = self.walls.normal[np.argmin(t, axis=1)]
        return Hits(nearest, np.where(hit, 2, -1), np.where(hit[:, None], normal, 0.0))

    def blocked(self, origin_m, direction, max_range_m):
        return np.isfinite(self.first_hits(origin_m, direction, max_range_m).distance_m)

    def through_crowns_m(self, origin_m, direction, max_range_m):
        return np.full(len(origin_m), self.crown_m)


def wall(foot, along, length, height, normal) -> Walls:
    columns = {"foot_m": foot, "along": along, "length_m": length, "height_m": height, "normal": normal}
    return Walls(**{name: np.array([value], float) for name, value in columns.items()})


def joined(*walls: Walls) -> Walls:
    return Walls(**{k: np.concatenate([getattr(w, k) for w in walls]) for k in Walls._fields})


def towards(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    az, el = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    return np.array([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])


# A long wall 20 m east of the origin that faces west.
EAST = wall([20.0, -500.0, 0.0], [0.0, 1.0], 1000.0, 60.0, [-1.0, 0.0])
ORIGIN = np.array([[0.0, 0.0, 2.0]])


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.floats(200.0, 340.0), st.floats(5.0, 60.0), st.floats(-40.0, 18.0))
def test_the_path_by_a_wall_is_that_to_the_mirrored_antenna(azimuth_deg, elevation_deg, east_m):
    antenna = np.array([[east_m, 0.0, 2.0]])
    s = towards(azimuth_deg, elevation_deg)
    by_wall = reflections(antenna, s[None, None], EAST, WallTracer(EAST), 100.0, 1000.0)
    excess_m = by_wall.excess_m[0, 0]
    satellite = FAR_M * s
    image = np.array([2 * 20.0 - east_m, 0.0, 2.0])
    expected = np.linalg.norm(satellite - image) - np.linalg.norm(satellite - antenna[0])
    reached_up = 2.0 + (20.0 - east_m) / -s[0] * s[2]
    if reached_up <= 60.0:
        assert excess_m == pytest.approx(expected, abs=1e-3)
        step = 1e-3 * np.array([0.7, -0.5, 0.2])
        moved = excess_at(antenna + step, s, EAST)
        assert by_wall.excess_per_m[0, 0] @ step == pytest.approx(moved - excess_m, abs=1e-9)
    else:
        assert np.isnan(excess_m)


def excess_at(antenna, direction, walls, reach_m=100.0):
    by_wall = reflections(antenna, direction[None, None], walls, WallTracer(walls), reach_m, 1000.0)
    return by_wall.excess_m[0, 0]


def test_a_wall_does_not_reflect_from_its_back_nor_beyond_its_ends_nor_too_far_away():
    east, west = towards(90.0, 30.0), towards(270.0, 30.0)
    assert np.isnan(excess_at(ORIGIN, east, EAST))
    assert np.isfinite(excess_at(ORIGIN, west, EAST))
    assert np.isnan(excess_at(ORIGIN, west, EAST, reach_m=10.0))
    short = wall([20.0, 5.0, 0.0], [0.0, 1.0], 10.0, 60.0, [-1.0, 0.0])
    assert np.isnan(excess_at(ORIGIN, west, short))


def test_a_house_across_the_street_takes_the_reflection_away():
    across = wall([-15.0, -500.0, 0.0], [0.0, 1.0], 1000.0, 60.0, [1.0, 0.0])
    both = joined(EAST, across)
    assert np.isnan(excess_at(ORIGIN, towards(270.0, 30.0), both))
    assert np.isfinite(excess_at(ORIGIN, towards(270.0, 65.0), both))


def test_signals_below_a_roof_line_are_bent_as_deep_as_they_stand_below_it():
    roof_deg = np.rad2deg(np.arctan2(58.0, 20.0))
    elevations = roof_deg + np.array([1.0, -2.0, -5.0, -8.0])
    directions = np.array([towards(90.0, e) for e in elevations])[None]
    around = Surroundings(WallTracer(EAST), EAST)
    paths = propagation(ORIGIN, directions, np.deg2rad(elevations)[None], around, ROVER)
    assert paths.direct[0].tolist() == [True, False, False, False]
    assert np.rad2deg(paths.bent_rad[0, 1:3]) == pytest.approx([2.0, 5.0], abs=0.2)
    assert np.isnan(paths.bent_rad[0, 3])
    assert paths.edge_m[0, 1] == pytest.approx(np.hypot(58.0, 20.0), rel=0.02)


def test_crowns_and_enclosure_along_the_path():
    antenna = np.array([[0.0, 0.0, 2.0], [0.0, 10.0, 2.0]])
    direction = np.tile(towards(270.0, 40.0), (2, 1, 1))
    elevation = np.full((2, 1), np.deg2rad(40.0))
    around = Surroundings(WallTracer(EAST, crown_m=4.0), EAST)
    paths = propagation(antenna, direction, elevation, around, ROVER)
    assert paths.crown_m.tolist() == [[4.0], [4.0]]
    # One long high wall on one side hides nearly half of the sky up to 60°.
    assert np.all((paths.enclosure > 0.35) & (paths.enclosure < 0.5))
    low = replace(ROVER, lowest_elevation_deg=45.0)
    assert not propagation(antenna, direction, elevation, around, low).direct.any()


def test_a_post_does_not_block_a_signal_and_a_house_does():
    ahead = np.array([[1.0, 0.0, 0.0]])
    post, tower = (3.0, 0.0, 0.0, 0.1, 8.0), (3.0, 0.0, 0.0, 2.0, 8.0)
    house = (9.0, 0.0, 0.0, 2.0, 5.0, 8.0, 0.0)
    crown = (3.0, 0.0, 2.0, 2.0, 2.0)

    def blocked(shapes):
        return bool(ShapeTracer(what_blocks(shapes)).blocked(np.array([[0.0, 0.0, 2.0]]), ahead, 100.0)[0])

    assert not blocked(Shapes.of(cylinders=[post]))
    assert blocked(Shapes.of(cylinders=[post, tower]))
    assert blocked(Shapes.of(cylinders=[post], boxes=[house]))
    assert len(what_blocks(Shapes.of(cylinders=[post], crowns=[crown])).crowns_m) == 1

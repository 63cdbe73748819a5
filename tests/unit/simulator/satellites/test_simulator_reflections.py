"""Paths of signals among walls, by closed forms of mirrored antennas and edges."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.simulator.satellites.parameters import ROVER
from camber.simulator.satellites.propagation import Surroundings, propagation, what_blocks
from camber.simulator.satellites.reflections import reflections
from camber.simulator.scene import Shapes, Walls
from camber.simulator.world.ray_tracing import ShapeTracer

FAR_M = 1.0e9


def wall(foot, along, length, height, normal) -> Walls:
    columns = {"foot_m": foot, "along": along, "length_m": length, "height_m": height, "normal": normal}
    return Walls(**{name: np.array([value], float) for name, value in columns.items()})


def tracer(walls: Walls, **more: Any) -> ShapeTracer:
    """Of blocks a metre deep, whose fronts are the walls."""
    middle = walls.foot_m[:, :2] + 0.5 * walls.length_m[:, None] * walls.along - 0.5 * walls.normal
    turn, half = np.arctan2(walls.along[:, 1], walls.along[:, 0]), np.full(len(middle), 0.5)
    boxes = (middle, walls.foot_m[:, 2], 0.5 * walls.length_m, half, walls.height_m, turn)
    return ShapeTracer(Shapes.of(boxes=np.column_stack(boxes).tolist(), **more))


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
    by_wall = reflections(antenna, s[None, None], EAST, tracer(EAST), 100.0, 1000.0)
    excess_m, per_m = (column[0, 0] for column in by_wall)
    satellite = FAR_M * s
    image = np.array([2 * 20.0 - east_m, 0.0, 2.0])
    expected = np.linalg.norm(satellite - image) - np.linalg.norm(satellite - antenna[0])
    reached_up = 2.0 + (20.0 - east_m) / -s[0] * s[2]
    if reached_up <= 60.0:
        assert excess_m == pytest.approx(expected, abs=1e-3)
        step = 1e-3 * np.array([0.7, -0.5, 0.2])
        moved = excess_at(antenna + step, s, EAST)
        assert per_m @ step == pytest.approx(moved - excess_m, abs=1e-9)
    else:
        assert np.isnan(excess_m)


def excess_at(antenna, direction, walls, reach_m=100.0):
    return reflections(antenna, direction[None, None], walls, tracer(walls), reach_m, 1000.0)[0][0, 0]


def test_a_wall_does_not_reflect_from_its_back_nor_beyond_its_ends_nor_too_far_away():
    east, west = towards(90.0, 30.0), towards(270.0, 30.0)
    assert np.isnan(excess_at(ORIGIN, east, EAST))
    assert np.isfinite(excess_at(ORIGIN, west, EAST))
    assert np.isnan(excess_at(ORIGIN, west, EAST, reach_m=10.0))
    short = wall([20.0, 5.0, 0.0], [0.0, 1.0], 10.0, 60.0, [-1.0, 0.0])
    assert np.isnan(excess_at(ORIGIN, west, short))


def test_a_house_across_the_street_takes_the_reflection_away():
    across = wall([-15.0, -500.0, 0.0], [0.0, 1.0], 1000.0, 60.0, [1.0, 0.0])
    both = Walls._make(map(np.concatenate, zip(EAST, across, strict=True)))
    assert np.isnan(excess_at(ORIGIN, towards(270.0, 30.0), both))
    assert np.isfinite(excess_at(ORIGIN, towards(270.0, 65.0), both))


def test_signals_below_a_roof_line_are_bent_as_deep_as_they_stand_below_it():
    roof_deg = np.rad2deg(np.arctan2(58.0, 20.0))
    elevations = roof_deg + np.array([1.0, -2.0, -5.0, -8.0])
    directions = np.array([towards(90.0, e) for e in elevations])[None]
    around = Surroundings(tracer(EAST), EAST)
    paths = propagation(ORIGIN, directions, np.deg2rad(elevations)[None], around, ROVER)
    assert paths.direct[0].tolist() == [True, False, False, False]
    assert np.rad2deg(paths.bent_rad[0, 1:3]) == pytest.approx([2.0, 5.0], abs=0.2)
    assert np.isnan(paths.bent_rad[0, 3])
    assert paths.edge_m[0, 1] == pytest.approx(np.hypot(58.0, 20.0), rel=0.02)


def test_crowns_and_enclosure_along_the_path():
    antenna = np.array([[0.0, 0.0, 2.0], [0.0, 10.0, 2.0]])
    direction = np.tile(towards(270.0, 40.0), (2, 1, 1))
    elevation = np.full((2, 1), np.deg2rad(40.0))
    crowns = [(*(place + 10.0 * direction[0, 0]).tolist(), 2.0, 2.0) for place in antenna]
    around = Surroundings(tracer(EAST, crowns=crowns), EAST)
    paths = propagation(antenna, direction, elevation, around, ROVER)
    np.testing.assert_allclose(paths.crown_m, [[4.0], [4.0]], atol=1e-9)
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

"""Roads in closed form: places along and across links, one height everywhere, no seams."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.simulator.world.district import KINDS, Kind, make_district
from camber.simulator.world.road_building import LinkKind, RoadBuilder
from camber.simulator.world.roads import HALF_WIDTH, Roads
from camber.simulator.world.routes import Leg, route_path
from camber.simulator.world.terrain import Terrain, rolling_terrain

FLAT = Terrain(40.0, np.zeros((0, 4)), np.zeros((0, 5)))


@lru_cache
def roads(kind: Kind) -> Roads:
    return make_district(kind, 3).roads("drive")


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.sampled_from(KINDS), st.integers(0, 10_000), st.floats(0.001, 0.999), st.floats(-1.0, 1.0))
def test_place_undoes_going_along_and_across_a_link(
    kind: Kind, link: int, share: float, across: float
) -> None:
    link %= len(roads(kind).link_id)
    s = share * float(roads(kind).length_m[link])
    y = across * float(roads(kind).shape[link, HALF_WIDTH])
    east, north, yaw = roads(kind).centre_line(link, np.array([s]))
    at = roads(kind).place(np.array([link]), east - y * np.sin(yaw), north + y * np.cos(yaw))
    np.testing.assert_allclose(np.concatenate(at), (s, y), atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_surface_has_no_seams_and_no_steps(kind: Kind) -> None:
    rng = np.random.default_rng(1)
    made = roads(kind)
    for level in np.unique(made.level).tolist():
        on = np.flatnonzero(made.level == level)
        link = rng.choice(on, 40_000)
        s = rng.random(len(link)) * made.length_m[link]
        y = rng.uniform(-1.0, 1.0, len(link)) * made.shape[link, HALF_WIDTH]
        east, north = np.empty(len(link)), np.empty(len(link))
        for one in on.tolist():
            rows = link == one
            e, n, yaw = made.centre_line(one, s[rows])
            east[rows], north[rows] = e - y[rows] * np.sin(yaw), n + y[rows] * np.cos(yaw)
        up = made.surface_m(east, north, np.array(level))
        assert np.isfinite(up).all()
        angle = rng.uniform(0.0, 2.0 * math.pi, len(link))
        near = made.surface_m(east + 0.01 * np.cos(angle), north + 0.01 * np.sin(angle), np.array(level))
        both = np.isfinite(near)
        assert both.mean() > 0.99
        assert np.abs(near - up)[both].max() < 0.01 * 0.15  # a slope, not a step


def test_off_a_road_there_is_none_and_above_it_another_level() -> None:
    made = roads("city")
    east, north = np.array([100.0, 100.0, 590.0, 590.0]), np.array([180.0, 195.0, 180.0, 180.0])
    up = made.surface_m(east, north, np.array([0, 0, 0, 1]))
    assert np.isfinite(up).tolist() == [True, False, True, True]
    assert up[3] - up[2] > 5.0
    assert np.isnan(made.surface_m(np.array([590.0]), np.array([180.0]), np.array([7])))


def test_lift_and_crossfall_are_the_closed_form() -> None:
    b = RoadBuilder()
    b.node("a", 0.0, 0.0, radius_m=0.0)
    b.node("b", 200.0, 0.0, radius_m=0.0, lift_m=5.0)
    b.straight("a", "b", LinkKind(crossfall=0.02, lift_m=(0.0, 5.0), rise_m=(50.0, 150.0)))
    made = b.roads(FLAT)
    s, y = np.array([10.0, 75.0, 100.0, 180.0]), np.array([0.0, 2.0, -3.0, 0.0])
    x = np.clip((s - 50.0) / 100.0, 0.0, 1.0)
    expected = 40.0 + 5.0 * (10 * x**3 - 15 * x**4 + 6 * x**5) + 0.02 * y
    np.testing.assert_allclose(made.surface_m(s, y, np.zeros(4, np.int64)), expected, atol=1e-12)
    raised = made.resurfaced(np.array([0.07]))
    np.testing.assert_allclose(raised.surface_m(s[1:3], y[1:3], np.zeros(2, np.int64)), expected[1:3] + 0.07)


def test_a_left_turn_is_tighter_than_a_right_turn_and_both_keep_left() -> None:
    b = RoadBuilder()
    for name, east, north in (("w", -100.0, 0.0), ("c", 0.0, 0.0), ("n", 0.0, 100.0), ("s", 0.0, -100.0)):
        b.node(name, east, north)
    for other in "wns":
        b.straight(other, "c", LinkKind())
    made = b.roads(FLAT)
    for out, radius in ((1, 9.0), (2, 13.0)):
        path = route_path(made, [Leg(0, True), Leg(out, False)], {}, start_m=10.0, end_m=10.0)
        tightest = 1.0 / np.abs(np.gradient(path.yaw_rad, 0.1)).max()
        assert tightest == pytest.approx(radius, abs=0.3)
        np.testing.assert_allclose(path.link_offset_m[[0, -1]], 1.75, atol=1e-9)
        assert path.yaw_rad[-1] - path.yaw_rad[0] == pytest.approx(math.pi / 2 if out == 1 else -math.pi / 2)


def test_links_that_do_not_fit_are_refused() -> None:
    b = RoadBuilder()
    b.node("a", 0.0, 0.0)
    b.node("b", 100.0, 0.0)
    b.node("c", 100.0, 12.0)
    with pytest.raises(ValueError, match=r"ends 10\.000 m off its node"):
        b.chain("a b", 0.0, [(90.0, 0.0)], LinkKind())
    b = RoadBuilder()
    for name, east, north in (("a", 0.0, 0.0), ("b", 100.0, 0.0), ("c", 100.0, 12.0), ("d", 200.0, 12.0)):
        b.node(name, east, north)
    for start, end in ("ab", "bc", "cd"):
        b.straight(start, end, LinkKind())
    made = b.roads(FLAT)
    with pytest.raises(ValueError, match="does not begin where"):
        route_path(made, [Leg(0, True), Leg(2, True)], {})
    with pytest.raises(ValueError, match="too short for the turns"):
        route_path(made, [Leg(0, True), Leg(1, True), Leg(2, True)], {})


def test_the_terrain_is_no_steeper_than_asked_for() -> None:
    for seed in range(5):
        ground = rolling_terrain(seed, base_m=40.0, slope=0.03)
        e, n = np.meshgrid(np.linspace(-1000, 1000, 201), np.linspace(-1000, 1000, 201))
        slope = np.hypot(*(np.gradient(ground.height_m(e, n), 10.0)))
        assert 0.01 < slope.max() <= 0.03

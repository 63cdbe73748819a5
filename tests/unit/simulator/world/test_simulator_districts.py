"""A district is consistent: routes lie on roads, rays meet the same roads, days differ where they are meant to."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from camber.simulator.scene import Floats, Material, Path
from camber.simulator.world.district import KINDS, District, Kind, make_district
from camber.simulator.world.ray_tracing import ShapeTracer

ROUTES = [(kind, name) for kind in KINDS for name in sorted(make_district(kind, 1).layout.routes)]


@lru_cache
def district(kind: Kind) -> District:
    return make_district(kind, 7, heading_rad=0.6)


@lru_cache
def path_of(kind: Kind, name: str = "default") -> Path:
    return district(kind).path(name)


@lru_cache
def tracer(kind: Kind) -> ShapeTracer:
    return ShapeTracer(district(kind).shapes("drive"))


def above(path: Path, height_m: float, every: int = 7) -> Floats:
    return np.column_stack((path.east_m, path.north_m, path.up_m + height_m))[::every]


@pytest.mark.parametrize(("kind", "name"), ROUTES)
def test_a_path_is_even_smooth_and_on_the_road(kind: Kind, name: str) -> None:
    path = path_of(kind, name)
    step = np.hypot(np.diff(path.east_m), np.diff(path.north_m))
    np.testing.assert_allclose(step, path.step_m, atol=1e-5)
    curvature = np.gradient(path.yaw_rad, path.step_m)
    assert np.abs(curvature).max() < 1.0 / 6.0
    assert np.abs(np.diff(curvature)).max() < 0.01  # 1/m within 10 cm: steering turns, it does not jump
    direction = np.arctan2(np.diff(path.north_m), np.diff(path.east_m))
    turned = direction - 0.5 * (path.yaw_rad[1:] + path.yaw_rad[:-1])
    assert np.abs((turned + np.pi) % (2 * np.pi) - np.pi).max() < 1e-3
    assert np.isfinite(path.up_m).all()
    np.testing.assert_array_equal(path.up_m, path.surface_m(path.east_m, path.north_m, path.level))
    assert np.abs(path.grade).max() < 0.105
    assert np.abs(path.crossfall).max() < 0.08


@pytest.mark.parametrize(("kind", "name"), ROUTES)
def test_grade_and_crossfall_are_those_of_the_surface(kind: Kind, name: str) -> None:
    path = path_of(kind, name)
    # The integral of the grade is the height. At creases, where an arc begins on a slope, the grade steps.
    climbed = np.concatenate(([0.0], np.cumsum(0.5 * (path.grade[1:] + path.grade[:-1])))) * path.step_m
    np.testing.assert_allclose(climbed, path.up_m - path.up_m[0], atol=5e-3)
    left_e, left_n = -np.sin(path.yaw_rad), np.cos(path.yaw_rad)
    for side in (-0.5, 0.5):
        left = path.surface_m(path.east_m + side * left_e, path.north_m + side * left_n, path.level)
        np.testing.assert_allclose(left, path.up_m + side * path.crossfall, atol=4e-3)


@pytest.mark.parametrize(("kind", "name"), ROUTES)
def test_all_wheels_of_a_vehicle_stand_on_the_road_of_its_level(kind: Kind, name: str) -> None:
    path = path_of(kind, name)
    c, s = np.cos(path.yaw_rad), np.sin(path.yaw_rad)
    whole = slice(0, -35)  # the front wheels of the last samples are beyond the path's end
    for ahead, left in ((0.0, 0.85), (0.0, -0.85), (2.9, 0.85), (2.9, -0.85)):
        east = path.east_m + ahead * c - left * s
        north = path.north_m + ahead * s + left * c
        up = path.surface_m(east[whole], north[whole], path.level[whole])
        flat = path.up_m[whole] + (ahead * path.grade + left * path.crossfall)[whole]
        np.testing.assert_allclose(up, flat, atol=0.08)


@pytest.mark.parametrize("kind", KINDS)
def test_rays_meet_the_road_of_the_path(kind: Kind) -> None:
    origin = above(path_of(kind), 2.0)
    down = np.tile((0.0, 0.0, -1.0), (len(origin), 1))
    hits = tracer(kind).first_hits(origin, down, 30.0)
    np.testing.assert_allclose(hits.distance_m, 2.0, atol=0.02)
    assert np.percentile(np.abs(hits.distance_m - 2.0), 95) < 0.004
    assert (hits.material == Material.ROAD).mean() > 0.99


@pytest.mark.parametrize(("kind", "name"), ROUTES)
def test_nothing_stands_on_the_path(kind: Kind, name: str) -> None:
    path = path_of(kind, name)
    c, s = np.cos(path.yaw_rad), np.sin(path.yaw_rad)
    for left in (-1.0, 0.0, 1.0):
        at = np.column_stack((path.east_m - left * s, path.north_m + left * c, path.up_m + 1.2))
        step = at[30:] - at[:-30]
        long = np.linalg.norm(step, axis=1)
        hits = tracer(kind).first_hits(at[:-30], step / long[:, None], 2.5)
        assert np.isinf(hits.distance_m).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_tunnel_is_where_the_sky_is_covered(kind: Kind) -> None:
    path = path_of(kind, "tunnel" if kind == "city" else "default")
    origin = above(path, 1.5)
    up = np.tile((0.0, 0.0, 1.0), (len(origin), 1))
    covered = tracer(kind).blocked(origin, up, 500.0)
    under_bridge = covered & (path.level[::7] == 0)
    np.testing.assert_array_equal(covered & ~under_bridge, path.tunnel[::7])
    if kind in ("city", "tunnel"):
        # In a tunnel no direction leads to the sky, but along the road near its ends.
        inside = origin[path.tunnel[::7]]
        middle = inside[len(inside) // 3 : 2 * len(inside) // 3 : 10]
        azimuth = np.linspace(0.0, 2 * np.pi, 36, endpoint=False)
        for elevation in (0.2, 0.5, 1.0):
            plan = np.cos(elevation) * np.column_stack((np.cos(azimuth), np.sin(azimuth)))
            sky = np.column_stack((plan, np.full(36, np.sin(elevation))))
            seen = tracer(kind).blocked(np.repeat(middle, 36, axis=0), np.tile(sky, (len(middle), 1)), 800.0)
            assert seen.all()


def test_a_tunnel_holds_a_vehicle_for_950_seconds() -> None:
    path = path_of("tunnel")
    assert (path.step_m / path.speed_limit_m_s)[path.tunnel].sum() > 950.0


def test_the_overpass_lies_above_the_street() -> None:
    path = path_of("overpass")
    street = (path.level == 0) & (np.hypot(path.east_m - 590.0, path.north_m - 180.0) < 3.0)
    deck = (path.level == 1) & (np.hypot(path.east_m - 590.0, path.north_m - 180.0) < 3.0)
    assert 5.0 < path.up_m[deck].mean() - path.up_m[street].mean() < 6.0


def test_the_canyon_is_that_of_the_trial() -> None:
    walls = make_district("canyon", 3, length_m=8000.0).walls()
    # Sides that face the street: normals across it (the street runs north).
    facing = np.abs(walls.normal[:, 0]) > 0.99
    facing &= walls.foot_m[:, 0] * walls.normal[:, 0] < 0.0
    assert np.abs(np.abs(walls.foot_m[facing, 0]) - 10.0).max() < 1e-6
    assert abs(walls.height_m[facing].mean() - 52.0) < 3.0  # 2 m of it below the ground
    assert abs(walls.height_m[facing].std() - 15.0) < 2.5
    assert 0.86 < walls.length_m[facing].sum() / 2.0 / 7970.0 < 0.94


def test_heading_is_clockwise_from_north() -> None:
    path = make_district("canyon", 1, heading_rad=0.3).path()
    np.testing.assert_allclose(path.yaw_rad, np.pi / 2 - 0.3, atol=1e-9)
    np.testing.assert_allclose(path.link_offset_m, 3.0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_walls_are_the_sides_of_what_rays_hit(kind: Kind) -> None:
    walls = district(kind).walls()
    middle = walls.foot_m.copy()
    middle[:, :2] += 0.5 * walls.length_m[:, None] * walls.along
    middle[:, 2] += 0.9 * walls.height_m
    out = np.column_stack((walls.normal, np.zeros(len(middle))))
    np.testing.assert_allclose(np.sum(walls.along * walls.normal, axis=1), 0.0, atol=1e-12)
    hits = tracer(kind).first_hits(middle + 0.02 * out, -out, 1.0)
    np.testing.assert_allclose(hits.distance_m, 0.02, atol=1e-9)
    np.testing.assert_allclose(hits.normal, out, atol=1e-9)


def test_a_changed_road_is_higher_by_its_offset_and_nothing_else_is() -> None:
    base = make_district("city", 5, changed_roads={})
    one, other = np.unique(base.path().link_id)[[1, 2]].tolist()
    changed = make_district("city", 5, changed_roads={one: 0.12, other: -0.30})
    before, after = base.path("all"), changed.path("all")
    raised = after.up_m - before.up_m
    for link, by_m in ((one, 0.12), (other, -0.30)):
        on = raised[before.link_id == link]
        assert len(on) > 0
        assert np.median(on) == pytest.approx(by_m, abs=1e-9)
    np.testing.assert_array_equal(raised[~np.isin(before.link_id, (one, other))], 0.0)
    np.testing.assert_array_equal(changed.path("all", "survey").up_m, before.up_m)
    assert {one, other} == set(changed.changed_roads)


def test_between_the_days_vehicles_and_objects_move_and_trees_grow_but_houses_stay() -> None:
    survey, drive = district("city").shapes("survey"), district("city").shapes("drive")
    houses = [shapes.boxes_m[shapes.boxes_material == Material.BUILDING] for shapes in (survey, drive)]
    np.testing.assert_array_equal(*houses)
    parked = [
        {tuple(row) for row in shapes.boxes_m[shapes.boxes_material == Material.VEHICLE][:, :2].tolist()}
        for shapes in (survey, drive)
    ]
    assert len(parked[0] & parked[1]) < 0.1 * len(parked[0])
    grown = drive.crowns_m[:, 3] / survey.crowns_m[:, 3]
    assert (grown > 1.02).all()
    assert (grown < 1.11).all()
    poles = [shapes.cylinders_m[shapes.cylinders_material == Material.POLE] for shapes in (survey, drive)]
    assert len(poles[1]) < len(poles[0])


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_same_bytes_and_another_seed_other_ones(kind: Kind) -> None:
    def everything(seed: int) -> bytes:
        made = make_district(kind, seed)
        path, shapes = made.path(), made.shapes("drive")
        columns = (path.up_m, path.stop_s, shapes.boxes_m, shapes.cylinders_m, shapes.triangles_m)
        return b"".join(column.tobytes() for column in columns)

    assert everything(1) == everything(1)
    assert everything(1) != everything(2)

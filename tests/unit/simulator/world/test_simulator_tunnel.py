"""A tunnel has what real ones have: at its walls and ceiling, off the lanes, and without effect on signals."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from camber.simulator.satellites.propagation import what_blocks
from camber.simulator.scene import Floats, Integers, Material
from camber.simulator.world.district import District, make_district
from camber.simulator.world.road_mesh import CEILING_M
from camber.simulator.world.roads import HALF_WIDTH
from camber.simulator.world.tunnel_fittings import BARE_M, FITTINGS, tunnel_fittings


@lru_cache
def district() -> District:
    return make_district("tunnel", 3)


@lru_cache
def placed() -> tuple[Floats, Floats, Integers, Floats, Floats]:
    """Boxes, but those where tubes join, and of each the distances s and y, its link's row, its base above the road."""
    roads = district().roads("drive")
    boxes = tunnel_fittings(roads, 3)
    links = np.flatnonzero(roads.covered_m[:, 1] > roads.covered_m[:, 0])
    s, y = roads.place(links[:, None], boxes[:, 0], boxes[:, 1])
    inside = (s > roads.covered_m[links, :1]) & (s < roads.covered_m[links, 1:]) & (np.abs(y) < 4.6)
    assert inside.any(axis=0).all()
    alone = inside.sum(axis=0) == 1
    assert alone.mean() > 0.9
    boxes, s, y, inside = boxes[alone], s[:, alone], y[:, alone], inside[:, alone]
    row = links[inside.argmax(axis=0)]
    at, left = (np.take_along_axis(v, inside.argmax(axis=0)[None], axis=0)[0] for v in (s, y))
    return boxes, at, row, left, boxes[:, 2] - roads.link_height_m(row, boxes[:, 0], boxes[:, 1])


def test_every_sort_is_there_as_often_as_its_spacing_allows() -> None:
    boxes, _, _, _, _ = placed()
    roads = district().roads("drive")
    long_m = float(np.diff(roads.covered_m, axis=1).sum())
    expected = sum(len(f.sides) * long_m / np.mean(f.every_m) for f in FITTINGS.values())
    assert 0.6 * expected < len(boxes) < expected


def test_nothing_stands_on_the_lanes_and_all_is_within_the_tube() -> None:
    boxes, _, row, y, up = placed()
    half = district().roads("drive").shape[row, HALF_WIDTH]
    low = up < 3.9
    assert (np.abs(y)[low] - boxes[low, 4] > 3.7).all()  # a vehicle's side is at 1.75 + 0.9 m
    assert (np.abs(y) - boxes[:, 4] < half + 0.05).all()  # seen from within
    assert (up + boxes[:, 5] < CEILING_M + 0.01).all()


def test_the_middle_of_a_long_tunnel_is_bare_and_the_rest_is_not() -> None:
    boxes, s, row, _, _ = placed()
    roads = district().roads("drive")
    for link in np.unique(row).tolist():
        begin, end = roads.covered_m[link]
        away = np.abs(s[row == link] - 0.5 * (begin + end)) - boxes[row == link, 3]
        if end - begin >= 300.0:
            assert 0.5 * BARE_M <= away.min() < 0.5 * BARE_M + 18.0
        assert np.median(np.diff(np.sort(s[row == link]))) < 8.0


def test_fittings_stay_where_they_are_between_the_days() -> None:
    days = [district().shapes(day) for day in ("survey", "drive")]
    boxes = [shapes.boxes_m[shapes.boxes_material == Material.TUNNEL] for shapes in days]
    assert len(boxes[0]) > 300
    np.testing.assert_array_equal(*boxes)


def test_they_do_not_affect_satellites_signals() -> None:
    shapes = district().shapes("drive")
    blocking = what_blocks(shapes)
    assert not (blocking.boxes_material == Material.TUNNEL).any()
    assert (blocking.triangles_material == Material.TUNNEL).any()
    assert len(blocking.boxes_m) == (shapes.boxes_material != Material.TUNNEL).sum()


def test_where_there_is_no_tunnel_there_are_no_fittings() -> None:
    assert len(tunnel_fittings(make_district("open-sky", 3).roads("drive"), 3)) == 0

"""Lanes become rectangles and levels: curves, tapers, steps, stacks of roads, a helix, and what the map says itself."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.road_map.release import read_release
from camber.tools.maps.importers.lane_levels import cuts_and_levels
from camber.tools.maps.importers.lane_map import LaneSurvey, road_map
from camber.tools.maps.importers.lane_pieces import LanePiece, pieces_of
from camber.tools.maps.importers.lanes import Lane
from support.built_maps import build_map
from support.lanelet_maps import FRAME, lanelet2_bytes, town

Floats = NDArray[np.float64]

WIDTH_M = 4.0
SURVEY = LaneSurvey(sigma_m=0.02, link_sigma_m=0.5, seen_ns=0)


def lane(
    name: str, centre_m: Floats, height_m: Floats, *, width_m: float | Floats = WIDTH_M, **more: object
) -> Lane:
    """A lane level across along a line (n, 2)."""
    yaw = np.unwrap(np.arctan2(*np.gradient(centre_m, axis=0).T[::-1]))
    across = np.column_stack((-np.sin(yaw), np.cos(yaw))) * np.broadcast_to(0.5 * width_m, len(yaw))[:, None]
    sides = [np.column_stack((centre_m + sign * across, height_m)) for sign in (-1.0, 1.0)]
    values = {
        "plan": "",
        "link_id": 1,
        "nodes": (name + "a", name + "b"),
        "borders": (name + "r", name + "l"),
    }
    return Lane(name=name, sections=np.stack(sides, axis=1), **values | more)  # type: ignore[arg-type]


def along(begin: tuple[float, float], end: tuple[float, float]) -> Floats:
    return np.linspace(begin, end, 41)


def straight(
    name: str, begin: tuple[float, float], end: tuple[float, float], height_m: float, **more: object
) -> Lane:
    return lane(name, along(begin, end), np.full(41, height_m), **more)


def corners(piece: LanePiece, points_m: Floats) -> Floats:
    """Points in the axes of a piece, in units of its half sizes."""
    c, s = math.cos(piece.yaw_rad), math.sin(piece.yaw_rad)
    half_m = (piece.half_length_m, piece.half_width_m)
    return (points_m - piece.centre_m) @ np.array([[c, -s], [s, c]]) / half_m


def levels_of(*lanes: Lane) -> list[list[int]]:
    return cuts_and_levels(lanes, [pieces_of(curve, "map") for curve in lanes], "map")[1]


@pytest.mark.parametrize("radius_m", [6.0, 15.0, 60.0, 400.0])
def test_rectangles_hold_all_of_a_curve_and_reach_little_beyond(radius_m: float) -> None:
    turn = np.linspace(0.0, 1.5, 200)
    line = radius_m * np.column_stack((np.sin(turn), 1.0 - np.cos(turn)))
    curve = lane("curve", line, np.zeros(200))
    pieces = pieces_of(curve, "map")
    in_units = np.array([[corners(piece, curve.sections[:, k, :2]) for k in (0, 1)] for piece in pieces])
    assert (np.abs(in_units) < 1.0 + 1e-9).all(axis=-1).any(axis=0).all()
    assert max(2.0 * piece.half_width_m for piece in pieces) < WIDTH_M + 0.3
    assert max(2.0 * piece.half_length_m for piece in pieces) < 23.0


def test_a_lane_that_opens_from_nothing_is_followed() -> None:
    line = along((0.0, 0.0), (60.0, 0.0))
    curve = lane("taper", line, 0.03 * line[:, 0], width_m=np.linspace(0.0, 3.5, 41))
    pieces = pieces_of(curve, "map")
    assert max(piece.off_m for piece in pieces) < 1e-3
    assert all(np.abs(np.diff(piece.heights_m, axis=1)).max() < 1e-6 for piece in pieces)
    assert pieces[0].half_width_m < 0.3


def test_where_heights_make_a_step_the_surface_is_as_unsure_as_that_and_the_lane_is_named() -> None:
    line = along((0.0, 0.0), (60.0, 0.0))
    stepped = np.insert(line, 21, line[20] + (0.01, 0.0), axis=0)
    height_m = np.where(np.arange(42) > 20, 0.4, 0.0) + 0.02 * stepped[:, 0]
    curve = lane("kerb", stepped, height_m)
    surfaces, _, remarks = road_map([curve], FRAME, SURVEY, "map")
    assert remarks == ["map: kerb: heights make a step, σ of a surface is up to 0.20 m"]
    assert (surfaces.sigma_m > 0.1).sum() == 1
    assert np.isclose(np.sort(surfaces.sigma_m)[:-1], 0.02, atol=1e-3).all()


def test_a_lane_steeper_than_any_road_is_refused() -> None:
    line = along((0.0, 0.0), (60.0, 0.0))
    with pytest.raises(FormatError, match=r"map: heights is 'wall, 3\.0 steep', expected a road"):
        pieces_of(lane("wall", line, 3.0 * line[:, 0]), "map")


def test_a_lane_with_a_point_somewhere_else_on_earth_is_refused() -> None:
    line = along((0.0, 0.0), (60.0, 0.0))
    line[-1] += (300_000.0, 0.0)
    with pytest.raises(FormatError, match=r"map: far is '300\.1 km, 4 m', expected a lane of at most 20 km"):
        pieces_of(lane("far", line, np.zeros(41)), "map")
    wide = lane("wide", along((0.0, 0.0), (60.0, 0.0)), np.zeros(41), width_m=np.linspace(3.0, 5e6, 41))
    with pytest.raises(FormatError, match="at most 100 m wide"):
        pieces_of(wide, "map")


def test_roads_over_one_another_are_on_different_levels() -> None:
    low = straight("low", (-50.0, 0.0), (50.0, 0.0), 0.0)
    middle = straight("middle", (0.0, -50.0), (0.0, 50.0), 6.0)
    high = straight("high", (-40.0, -40.0), (40.0, 40.0), 12.0)
    neighbour = straight("beside", (-50.0, 30.0), (-20.0, 50.0), 12.0)
    assert levels_of(high, low, middle, neighbour) == [[2], [0], [1], [0]]


def test_roads_that_cross_at_one_height_are_on_one_level() -> None:
    first, second = (
        straight(name, (-50.0, y), (50.0, -y), 0.05 * y) for name, y in (("a", 20.0), ("b", -20.0))
    )
    assert levels_of(first, second) == [[0], [0]]


def test_lanes_that_share_a_border_are_on_one_level() -> None:
    street = straight("street", (0.0, -50.0), (0.0, 50.0), 0.0)
    over = straight("over", (-30.0, 0.0), (30.0, 0.0), 6.0, borders=("x", "shared"))
    neighbour = straight("beside", (10.0, 4.0), (30.0, 4.0), 6.0, borders=("shared", "y"))
    assert levels_of(street, over, neighbour) == [[0], [1], [1]]


def test_what_the_map_says_stays_and_the_rest_fits_in() -> None:
    low = straight("low", (-50.0, 0.0), (50.0, 0.0), 0.0)
    high = straight("high", (0.0, -50.0), (0.0, 50.0), 6.0)
    assert levels_of(replace(low, level=3), high) == [[3], [4]]
    assert levels_of(low, replace(high, level=0)) == [[-1], [0]]
    with pytest.raises(FormatError, match="levels is 'low at 1, high over it at 1', expected a higher one"):
        levels_of(replace(low, level=1), replace(high, level=1))


def test_a_helix_becomes_several_links_on_rising_levels() -> None:
    turn = np.linspace(0.0, 6.0 * math.pi, 400)
    line = 15.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    helix = lane("helix", line, 5.0 * turn / (2.0 * math.pi), link_id=77)
    surfaces, links, _ = road_map([helix], FRAME, SURVEY, "map")
    assert links.level.tolist() == sorted(links.level.tolist())
    # Where a part has gone all the way round it is over its own beginning: three turns are four parts.
    assert set(links.level.tolist()) == {0, 1, 2, 3}
    assert (links.start_node[1:] == links.end_node[:-1]).all()
    assert set(surfaces.link_id.tolist()) == set(links.link_id.tolist())
    length_m = 3.0 * 2.0 * math.pi * 15.0
    steps = [np.diff(line, axis=0) for line in links.vertices]
    drawn_m = sum(
        6.37e6 * np.hypot(step[:, 0], step[:, 1] * math.cos(FRAME.latitude_rad)).sum() for step in steps
    )
    assert drawn_m == pytest.approx(length_m, rel=0.01)


def test_levels_that_lie_over_one_another_in_a_ring_are_refused() -> None:
    lanes = []
    for k in range(3):  # each begins low and ends high over the next one's beginning
        begin, end = (2.0 * math.pi * (k + step) / 3.0 for step in (-0.1, 1.1))
        line = 30.0 * np.column_stack([f(np.linspace(begin, end, 60)) for f in (np.cos, np.sin)])
        lanes.append(lane(f"ring {k}", line, np.linspace(0.0, 8.0, 60)))
    with pytest.raises(FormatError, match="expected at most 20 levels, none above itself"):
        levels_of(*lanes)


def test_a_release_goes_only_into_a_folder_of_its_predecessor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "town.osm").write_bytes(lanelet2_bytes(town()))
    options = (tmp_path / "town.osm", "--vertical-datum", "ellipsoidal", "--sigma-m", "0.02")
    out, previous = tmp_path / "map", ("--previous", tmp_path / "map")
    assert build_map("lanelet2", out, *options) == 0
    assert build_map("lanelet2", out, *options) == 2
    assert "expected one without a release, or --previous" in capsys.readouterr().err
    assert build_map("lanelet2", out, *options, *previous, "--surveyed", "2024-09-01") == 0
    assert read_release(out).root.map_version == 2
    assert build_map("lanelet2", out, *options, *previous, "--map-version", "2") == 2
    assert build_map("lanelet2", tmp_path / "new", *options, "--signing-key", tmp_path / "none.pem") == 2
    assert not (tmp_path / "new").exists()

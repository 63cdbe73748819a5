"""The road under a point is the one that links and levels say, with the height of its grid; else it is unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from camber.geodesy.local_frame import LocalFrame
from camber.map_server.batch_road_selection import SelectedRoads
from camber.map_server.elevation_queries import REASONS, ElevationMap
from camber.road_map.road_tiles import link_tiles, surface_tiles
from camber.road_map.tile_grid import tile_corners_rad
from camber.schemas.pose import Road
from support.small_map import FRAME, TILE, at, link, links, surface, surfaces

Rows = Sequence[dict[str, Any]]


def map_of(surface_rows: Rows, link_rows: Rows = ()) -> ElevationMap:
    by_tile = {(tile.x, tile.y): tile for tile in surface_tiles(surfaces(surface_rows))}
    links_by_tile = {(tile.x, tile.y): tile for tile in link_tiles(links(link_rows))}
    return ElevationMap(
        lambda x, y: by_tile.get((x, y)), lambda x, y: links_by_tile.get((x, y)), datum="WGS84", map_version=7
    )


def road(rows: Rows, east_m: float, north_m: float, link_rows: Rows = (), **topology: Any) -> Road:
    return map_of(rows, link_rows).road(*at(east_m, north_m), **topology)


# A ground road to the east, a bridge over it to the north, and a ramp from one to the other.
GROUND, BRIDGE, RAMP, FAR = 1, 2, 3, 4
LINKS = [
    link(GROUND, (1, 2), [(-100.0, 0.0), (100.0, 0.0)]),
    link(BRIDGE, (3, 4), [(0.0, -100.0), (0.0, 100.0)], level=1),
    link(RAMP, (2, 3), [(100.0, 0.0), (60.0, -60.0), (0.0, -100.0)], level=1),
    link(FAR, (8, 9), [(-200.0, 200.0), (200.0, 200.0)]),
]
OVERPASS = [
    surface(10, link_id=GROUND, heights_m=50.0),
    surface(20, link_id=BRIDGE, level=1, yaw_rad=math.pi / 2, heights_m=56.0),
    surface(11, 60.0, link_id=GROUND, heights_m=50.0),
    surface(21, 0.0, 60.0, link_id=BRIDGE, level=1, yaw_rad=math.pi / 2, heights_m=56.0),
    surface(30, 60.0, -60.0, link_id=RAMP, level=1, heights_m=53.0),
    surface(40, 0.0, 200.0, link_id=FAR, heights_m=49.0),
]


def test_a_plane_gives_its_height_slope_and_names() -> None:
    # 1 m higher in front than behind over 20 m: 5 % along a yaw of 90°, that is to the north.
    result = road(
        [surface(5, yaw_rad=math.pi / 2, level=2, heights_m=[[50.0, 50.0], [51.0, 51.0]])], 1.0, 2.0
    )
    assert result.status == "known"
    assert (result.surface_id, result.level, result.datum, result.map_version) == (5, 2, "WGS84", 7)
    assert result.elevation_m == pytest.approx(50.6, abs=1e-4)
    assert result.sigma_m == pytest.approx(0.03)
    assert result.slope_north == pytest.approx(0.05, abs=1e-5)
    assert result.slope_east == pytest.approx(0.0, abs=1e-5)


def test_the_extent_of_a_plane_is_smaller_on_a_curved_grid() -> None:
    plane = road([surface(5, heights_m=[[50.0, 50.0], [51.0, 51.0]])], 0.0, 0.0)
    curved = road([surface(5, heights_m=[[50.0, 50.0], [50.0, 50.0], [51.0, 51.0]])], -5.0, 0.0)
    assert plane.extent_m == pytest.approx(math.hypot(10.0, 2.0))
    assert curved.extent_m == pytest.approx(0.3, rel=1e-3)  # σ 0.03 m against a change of slope of 10 %


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 2**32), st.floats(-1.3, 1.3), st.floats(-math.pi, math.pi))
def test_heights_are_those_of_an_independent_interpolation(
    seed: int, latitude_rad: float, longitude_rad: float
) -> None:
    """Brute force over all surfaces with scipy, anywhere on earth, for points on, next to and between surfaces."""
    rng = np.random.default_rng(seed)
    frame = LocalFrame(latitude_rad, longitude_rad, 0.0)
    rows = [
        surface(
            i,
            *rng.uniform(-40.0, 40.0, 2),
            yaw_rad=rng.uniform(-math.pi, math.pi),
            half_length_m=rng.uniform(3.0, 30.0),
            half_width_m=rng.uniform(1.5, 6.0),
            sigma_m=100.0,  # overlapping surfaces agree, so that the nearest centre line decides
            heights_m=rng.uniform(-0.2, 0.2) + rng.normal(20.0, 0.02, rng.integers(2, 5, 2)),
            frame=frame,
        )
        for i in range(12)
    ]
    points_m = rng.uniform(-60.0, 60.0, (40, 2))
    the_map = map_of(rows)
    for point_m in points_m:
        want = _brute_force(rows, point_m, frame)
        if want == "too close to call":
            continue
        result = the_map.road(*at(*point_m, frame))
        if want is None:
            assert result.reason == "no_surface"
        else:
            assert (result.status, result.surface_id) == ("known", want[0])
            assert result.elevation_m == pytest.approx(want[1], abs=2e-4)
            assert (result.slope_east, result.slope_north) == pytest.approx(want[2:], abs=1e-3)


def _brute_force(rows: Rows, point_m: np.ndarray, frame: LocalFrame) -> Any:
    """Surface, height and slopes (east, north) by central differences; None where no surface contains the point."""
    best = None
    for row in rows:
        here = LocalFrame(row["latitude_rad"], row["longitude_rad"], 0.0)
        east_m, north_m = here.east_north_from_geodetic(*at(*point_m, frame), 0.0)
        yaw, half = row["yaw_rad"], np.array([row["half_length_m"], row["half_width_m"]])
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        uv = turn @ (east_m, north_m)
        if (np.abs(np.abs(uv) - half) < 0.52).any() and (np.abs(uv) < half + 0.52).all():
            return "too close to call"  # to an edge: the tolerance has tests of its own
        if (np.abs(uv) > half).any():
            continue
        axes = [np.linspace(-h, h, n) for h, n in zip(half, row["heights_m"].shape, strict=True)]
        step_m = [np.abs(axis - x).min() for axis, x in zip(axes, uv, strict=True)]
        if min(step_m) < 2e-4:
            return "too close to call"  # to a crease of the grid, where the slope jumps
        surface_at = RegularGridInterpolator(axes, row["heights_m"])
        d = 1e-4
        slopes = [
            float(np.diff(surface_at([uv - turn @ step, uv + turn @ step]))[0] / (2.0 * d))
            for step in (np.array([d, 0.0]), np.array([0.0, d]))
        ]
        candidate = (abs(uv[1]), row["surface_id"], float(surface_at([uv])[0]), *slopes)
        if best is not None and abs(best[0] - candidate[0]) < 1e-4:
            return "too close to call"
        best = candidate if best is None else min(best, candidate)
    return None if best is None else best[1:]


def test_where_there_is_no_surface_nothing_is_known() -> None:
    nothing = Road(status="unknown", reason="no_surface")
    assert road([surface(5)], 30.0, 0.0) == nothing
    assert road([surface(5)], 5000.0, 0.0) == nothing
    assert road([], 0.0, 0.0) == nothing
    assert map_of([surface(5)]).road(math.pi / 2, 0.0) == nothing


@pytest.mark.parametrize(
    ("east_m", "north_m", "status"),
    [
        (10.499, 0.0, "known"),
        (10.501, 0.0, "unknown"),
        (0.0, 2.499, "known"),
        (0.0, -2.501, "unknown"),
        (10.35, 2.35, "known"),
        (10.45, 2.45, "unknown"),  # beyond a corner the distance counts, not each side
    ],
)
def test_a_surface_reaches_half_a_metre_beyond_its_edge_and_no_farther(
    east_m: float, north_m: float, status: str
) -> None:
    assert road([surface(5)], east_m, north_m).status == status


def test_beyond_its_edge_a_surface_is_extrapolated_with_its_slope() -> None:
    rows = [surface(5, heights_m=[[50.0, 50.0], [50.0, 50.0], [51.0, 51.0]])]
    assert road(rows, 10.4, 0.0).elevation_m == pytest.approx(51.04, abs=1e-4)
    assert road(rows, -10.4, 0.0).elevation_m == pytest.approx(50.0, abs=1e-4)


@pytest.mark.parametrize("share", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (1.0, 1.0), (1.0, 0.5)])
def test_a_point_on_the_border_of_tiles_is_answered_as_any_other(share: tuple[float, float]) -> None:
    south, west, north, east = tile_corners_rad(*TILE)
    latitude = south + share[0] * (north - south)
    longitude = west + share[1] * (east - west)
    centre_m = FRAME.east_north_from_geodetic(latitude, longitude, 0.0)
    grid = [[50.0, 50.1], [50.4, 50.5]]
    rows = [surface(5, *centre_m, yaw_rad=0.7, heights_m=grid), surface(6, 9e3, 9e3, heights_m=999.0)]
    the_map = map_of(rows)
    step = 1e-12  # 6 µm: to either side of the border
    answers = [
        the_map.road(latitude + i * step, longitude + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]
    assert {answer.surface_id for answer in answers} == {5}
    assert np.ptp([answer.elevation_m for answer in answers]) < 1e-4
    assert answers[4].elevation_m == pytest.approx(50.25, abs=1e-4)


def test_a_tile_is_read_on_first_use_and_errors_are_passed_on() -> None:
    asked: list[tuple[int, int]] = []

    def broken(x: int, y: int) -> None:
        asked.append((x, y))
        raise OSError("gone")

    the_map = ElevationMap(broken, broken, datum="WGS84", map_version=1)
    assert asked == []
    for _ in range(2):
        with pytest.raises(OSError, match="gone"):
            the_map.road(*at(0.0, 0.0))
    assert len(asked) == 2  # a failure is not kept


AMBIGUOUS = "levels_ambiguous"
BOTH = [GROUND, BRIDGE]


@pytest.mark.parametrize(
    ("point_m", "link_ids", "last_surface_id", "expected"),
    [
        ((0.0, 0.0), [], None, AMBIGUOUS),
        # A candidate link gives the level; candidates on both levels do not.
        ((0.0, 0.0), [GROUND], None, 10),
        ((0.0, 0.0), [BRIDGE], None, 20),
        ((0.0, 0.0), BOTH, None, AMBIGUOUS),
        # So does the last surface by its link, also between candidates; candidates go before it.
        ((0.0, 0.0), [], 11, 10),
        ((0.0, 0.0), [], 21, 20),
        ((0.0, 0.0), BOTH, 11, 10),
        ((0.0, 0.0), [BRIDGE], 11, 20),
        # The ramp shares a node with the ground road and one with the bridge.
        ((0.0, 0.0), [], 30, AMBIGUOUS),
        # Without connection, or unknown.
        ((0.0, 0.0), [], 40, AMBIGUOUS),
        ((0.0, 0.0), [], 999, AMBIGUOUS),
        # Candidates without a surface here leave two levels ambiguous, and the only level known,
        ((0.0, 0.0), [FAR], None, AMBIGUOUS),
        ((0.0, 0.0), [FAR], 11, AMBIGUOUS),
        ((60.0, 0.0), [FAR], None, 11),
        # unless the vehicle is on a level that has no surface here: the ground below the bridge is not its road.
        ((60.0, 0.0), [BRIDGE], None, AMBIGUOUS),
        ((60.0, 0.0), [FAR, BRIDGE], None, AMBIGUOUS),
        ((60.0, 0.0), [], 21, AMBIGUOUS),
        # A bridge within the tolerance counts.
        ((2.4, 0.0), [], None, AMBIGUOUS),
        ((2.6, 0.0), [], None, 10),
    ],
)
def test_links_and_last_surface_select_the_level(
    point_m: tuple[float, float], link_ids: list[int], last_surface_id: int | None, expected: int | str
) -> None:
    result = road(OVERPASS, *point_m, LINKS, link_ids=link_ids, last_surface_id=last_surface_id)
    if expected == AMBIGUOUS:
        assert result == Road(status="unknown", reason="levels_ambiguous")
    else:
        assert result.surface_id == expected
        assert result.elevation_m == pytest.approx(56.0 if expected == 20 else 50.0)


def test_of_surfaces_on_one_level_that_agree_the_nearest_centre_line_decides() -> None:
    lanes = [surface(5), surface(6, 0.0, 3.0), surface(7, 0.0, 1.5)]
    assert road(lanes, 0.0, 1.7).surface_id == 7
    assert road(lanes, 0.0, 0.5).surface_id == 5
    # Equally near: the smaller id.
    assert road([surface(9, 0.0, -1.0), surface(8, 0.0, 1.0)], 0.0, 0.0).surface_id == 8
    # One that contains the point goes before one within the tolerance.
    rows = [surface(5, heights_m=50.0), surface(6, 0.0, 2.9, half_width_m=0.5, heights_m=50.5)]
    assert road(rows, 0.0, 1.95).surface_id == 5


@pytest.mark.parametrize(("other_m", "reason"), [(50.05, "none"), (50.07, AMBIGUOUS)])
def test_surfaces_of_one_level_must_agree_within_their_sigma(other_m: float, reason: str) -> None:
    rows = [surface(5, heights_m=50.0), surface(6, 0.0, 1.0, heights_m=other_m)]
    assert road(rows, 0.0, 0.2).reason == reason


def test_heights_do_not_decide_on_a_level() -> None:
    for bridge_m in (50.0, 50.01, 56.0, 900.0):
        rows = [OVERPASS[0], OVERPASS[1] | {"heights_m": np.full((2, 2), bridge_m)}]
        assert road(rows, 0.0, 0.0, LINKS).reason == "levels_ambiguous"
        assert road(rows, 0.0, 0.0, LINKS, link_ids=[GROUND]).elevation_m == pytest.approx(50.0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32), st.lists(st.integers(0, 5), max_size=3), st.one_of(st.none(), st.integers(0, 30))
)
def test_what_is_known_never_contradicts_the_topology(
    seed: int, link_ids: list[int], last_surface_id: int | None
) -> None:
    rows, link_rows = _tangle(seed)
    the_map = map_of(rows, link_rows)
    level_of = {row["link_id"]: row["level"] for row in link_rows}
    by_id = {row["surface_id"]: row for row in rows}
    for point in np.random.default_rng(seed).uniform(-40.0, 40.0, (20, 2)):
        result = the_map.road(*at(*point), link_ids, last_surface_id)
        plain = the_map.road(*at(*point))
        assert (result.reason == "no_surface") == (plain.reason == "no_surface")
        if result.status == "known" and link_ids:
            assert result.surface_id is not None
            on_candidate = by_id[result.surface_id]["link_id"] in link_ids
            assert on_candidate or {level_of[i] for i in link_ids if i in level_of} <= {result.level}


def around(rows: Rows, radius_m: float, east_m: float = 0.0, north_m: float = 0.0, **topology: Any) -> Road:
    return map_of(rows, LINKS).road_around(*at(east_m, north_m), radius_m, **topology)


def test_a_patch_samples_the_road_within_the_radius() -> None:
    rows = [surface(5, yaw_rad=0.3, heights_m=[[50.0, 50.2], [51.0, 51.2]])]
    result = around(rows, 5.0)
    assert result.patch is not None
    assert np.hypot(result.patch.east_m, result.patch.north_m).max() <= 5.0 + 1e-9
    assert result.patch.reach_m == pytest.approx(1.25)
    plane = (result.elevation_m, result.slope_east, result.slope_north)
    plane_m = np.dot(plane, [np.ones(len(result.patch.east_m)), result.patch.east_m, result.patch.north_m])
    assert np.allclose(result.patch.elevation_m, plane_m, atol=1e-3)


def test_without_a_radius_there_is_no_patch() -> None:
    assert around([surface(5)], 0.0) == road([surface(5)], 0.0, 0.0)


def test_next_to_the_road_the_nearest_plane_continues() -> None:
    result = around([surface(5, heights_m=[[50.0, 50.4], [50.0, 50.4]])], 5.0, 0.0, 4.0)
    assert (result.status, result.surface_id, result.extent_m) == ("known", 5, 0.0)
    assert result.elevation_m == pytest.approx(50.6, abs=1e-3)
    assert around([surface(5)], 5.0, 0.0, 20.0).reason == "no_surface"


@pytest.mark.parametrize(
    ("radius_m", "east_m", "topology", "reason"),
    [
        (1.0, 6.0, {}, "none"),
        (6.0, 6.0, {}, AMBIGUOUS),
        (6.0, 6.0, {"link_ids": BOTH}, AMBIGUOUS),
        # Only levels without candidates are near.
        (6.0, 60.0, {"link_ids": [BRIDGE]}, AMBIGUOUS),
        (6.0, 60.0, {"last_surface_id": 21}, AMBIGUOUS),
    ],
)
def test_another_level_within_the_radius_leaves_the_road_ambiguous(
    radius_m: float, east_m: float, topology: dict[str, Any], reason: str
) -> None:
    assert around(OVERPASS, radius_m, east_m, 0.0, **topology).reason == reason


@pytest.mark.parametrize("east_m", [6.0, 0.0])
def test_the_patch_omits_a_level_without_candidates(east_m: float) -> None:
    result = around(OVERPASS, 6.0, east_m, 0.0, link_ids=[GROUND])
    assert result.patch is not None
    assert set(result.patch.surface_id.tolist()) == {10}
    assert result.elevation_m == pytest.approx(50.0)


def test_a_point_on_a_level_without_candidates_is_next_to_the_road() -> None:
    assert road(OVERPASS, 0.0, 4.0, LINKS, link_ids=[GROUND]).reason == AMBIGUOUS
    result = around(OVERPASS, 6.0, 0.0, 4.0, link_ids=[GROUND])
    assert (result.status, result.surface_id, result.level, result.extent_m) == ("known", 10, 0, 0.0)


def _tangle(seed: int, frame: LocalFrame = FRAME) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Surfaces all over one another on two levels, partly agreeing."""
    rng = np.random.default_rng(seed)
    rows = [
        surface(
            i,
            *rng.uniform(-40.0, 40.0, 2),
            link_id=i % 5,
            level=i % 5 // 3,
            yaw_rad=rng.uniform(-3.0, 3.0),
            half_length_m=rng.uniform(3.0, 25.0),
            sigma_m=0.05,
            heights_m=rng.normal(50.0, 0.05) + rng.normal(0.0, 0.01, rng.integers(2, 4, 2)),
            frame=frame,
        )
        for i in range(30)
    ]
    ends = [[at(*end, frame) for end in rng.uniform(-40.0, 40.0, (2, 2))] for _ in range(5)]
    lines = [link(i, (i, i + 1), [], level=i // 3) | {"vertices": ends[i]} for i in range(5)]
    return rows, lines


CORNER = LocalFrame(*tile_corners_rad(57686, 25920)[:2], 0.0)
"""Where four tiles meet."""


def _points(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Most of them among the surfaces of a tangle, some far from it, one where there are no tiles."""
    points_m = np.random.default_rng(seed + 100).uniform(-300.0, 300.0, (1000, 2))
    points_m[:900] *= 0.15
    latitude, longitude, _ = CORNER.geodetic_from_east_north_array(points_m, np.zeros(len(points_m)))
    latitude[-1] = 1.55
    return latitude, longitude


def _assert_each_as_if_alone(columns: SelectedRoads, alone: list[Road]) -> None:
    assert [REASONS[code] for code in columns.reason] == [one.reason for one in alone]
    assert columns.known.tolist() == [i for i, one in enumerate(alone) if one.status == "known"]
    assert not (columns.elsewhere & ~columns.ambiguous).any()
    known = [alone[i] for i in columns.known]
    assert len(known) > 100
    assert columns.surface_id.tolist() == [one.surface_id for one in known]
    assert columns.level.tolist() == [one.level for one in known]
    for name in ("elevation_m", "sigma_m", "slope_east", "slope_north", "extent_m"):
        want = np.array([getattr(one, name) for one in known])
        assert np.abs(getattr(columns, name) - want).max() < 1e-9, name


@pytest.mark.parametrize("seed", range(8))
def test_many_points_are_each_as_if_alone(seed: int) -> None:
    the_map = map_of(*_tangle(seed, CORNER))
    latitude, longitude = _points(seed)
    rng = np.random.default_rng(seed + 200)
    # Of 5 links and 30 surfaces, with an unknown one, and none.
    links, last = rng.integers(-1, 7, (len(latitude), 3)), rng.integers(-1, 32, len(latitude))
    links[rng.random(links.shape) < 0.5] = -1
    each = zip(latitude.tolist(), longitude.tolist(), links.tolist(), last.tolist(), strict=True)
    alone = [
        the_map.road(*point, [i for i in of_point if i >= 0], None if surface_id < 0 else surface_id)
        for *point, of_point, surface_id in each
    ]
    _assert_each_as_if_alone(the_map.roads_each(latitude, longitude, links, last), alone)
    for link_ids, last_surface_id in (((), None), ((1,), None), ((0, 4), None), ((), 6)):
        columns = (
            np.tile(np.array(link_ids, int), (len(latitude), 1)),
            np.full(len(latitude), last_surface_id or -1),
        )
        each = the_map.roads_each(latitude, longitude, *columns)
        together = the_map.roads(latitude, longitude, link_ids, last_surface_id)
        assert all(np.array_equal(a, b) for a, b in zip(together, each, strict=True))


def test_points_of_a_wrong_shape_are_refused_and_none_have_no_roads() -> None:
    assert len(map_of([surface(5)]).roads([], []).known) == 0
    with pytest.raises(ValueError, match=r"expected \(n,\), got \(2,\), \(1,\)"):
        map_of([surface(5)]).roads([0.0, 0.0], [0.0])
    with pytest.raises(ValueError, match=r"expected \(1, c\), \(1,\), got \(1,\), \(1,\)"):
        map_of([surface(5)]).roads_each([0.0], [0.0], [1], [1])

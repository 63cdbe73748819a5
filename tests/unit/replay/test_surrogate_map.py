"""Roads made from a track: one height a place and level, noise as stated, links that are coarse and joined."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.local_frame import LocalFrame
from camber.replay.coarse_links import thinned
from camber.replay.road_lines import road_lines
from camber.replay.short_drive import short_drive_truth
from camber.replay.surrogate_map import make_map
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.map_error_model import MAP_ERRORS
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.drive import Surrogates

Array = npt.NDArray[np.float64]
FRAME = LocalFrame(math.radians(35.0), math.radians(137.0), 0.0)
ANTENNA_M = 1.6


def drive_along(corners_m: list[tuple[float, float, float]], stand: int = 0) -> TruthTable:
    """A drive from corner to corner (east, north, road height), standing a while at each."""
    points: list[Array] = []
    for a, b in pairwise(corners_m):
        n = max(1, round(math.dist(a[:2], b[:2])))
        points += [np.tile(a, (stand, 1)), np.linspace(a, b, n + 1)[:-1]]
    track = np.vstack((*points, corners_m[-1]))
    n = len(track)
    latitude, longitude, height = FRAME.geodetic_from_east_north_array(track[:, :2], track[:, 2] + ANTENNA_M)
    zero = np.zeros(n)
    time_ns = 1_400_000_000 * 10**9 + np.arange(n) * 200_000_000
    return TruthTable(
        time_ns=time_ns,
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
        roll_rad=zero,
        pitch_rad=zero,
        yaw_rad=zero,
        velocity_enu_m_s=np.zeros((n, 3)),
    )


def plane(truth: TruthTable) -> Array:
    return FRAME.east_north_from_geodetic_array(truth.latitude_rad, truth.longitude_rad, truth.height_m)


def heights_at(surfaces: RoadSurfaces, point_m: Array) -> list[tuple[int, float]]:
    """Level and height of every surface that holds a point."""
    n = len(surfaces)
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(np.tile(point_m, (n, 1)), np.zeros(n))
    height_m, outside_m = SurfaceHeights(surfaces).heights_m(np.arange(n), latitude, longitude)
    return [(int(surfaces.level[i]), float(height_m[i])) for i in np.flatnonzero(outside_m == 0.0)]


def link_lines(links: RoadLinks) -> list[Array]:
    return [FRAME.east_north_from_geodetic_array(v[:, 0], v[:, 1], np.zeros(len(v))) for v in links.vertices]


def dense(line_m: Array, step_m: float = 0.25) -> Array:
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line_m, axis=0).T)))
    at = np.arange(0.0, along[-1] + step_m, step_m)
    return np.column_stack([np.interp(at, along, column) for column in line_m.T])


def furthest(points_m: Array, line_m: Array) -> float:
    """The largest distance of points from a dense line."""
    return max(float(np.hypot(*(line_m - p).T).min()) for p in points_m)


def made(truth: TruthTable, seed: int = 1, **errors: Any) -> tuple[RoadSurfaces, RoadLinks]:
    surrogates = Surrogates(seed=seed, inputs=("links", "road_surfaces"), **errors)
    return make_map(truth, surrogates, ANTENNA_M)


SQUARE = [(0.0, 0.0, 10.0), (300.0, 0.0, 13.0), (300.0, 200.0, 16.0), (0.0, 200.0, 12.0), (0.0, 3.0, 10.0)]


def test_every_epoch_of_a_drive_has_a_road_beneath_it() -> None:
    for truth in (drive_along(SQUARE), short_drive_truth()):
        surfaces, _ = made(truth)
        assert all(heights_at(surfaces, point) for point in plane(truth))


def test_surfaces_say_their_sigma_and_have_ids_links_and_sizes() -> None:
    surfaces, links = made(drive_along(SQUARE), map_sigma_m=0.08)
    assert (surfaces.sigma_m == 0.08).all()
    assert surfaces.surface_id.tolist() == list(range(1, len(surfaces) + 1))
    assert set(surfaces.link_id.tolist()) <= set(links.link_id.tolist())
    assert (surfaces.half_width_m == 4.0).all()
    assert np.median(surfaces.half_length_m) == pytest.approx(6.5, abs=0.3)
    assert (surfaces.level == 0).all()


def test_height_errors_over_seeds_have_the_covariance_of_the_model() -> None:
    truth = drive_along([(0.0, 0.0, 10.0), (400.0, 0.0, 22.0)])
    at_m = np.arange(0.0, 401.0, 20.0)
    drawn, drives = [], 150
    for seed in range(drives):
        surfaces, _ = made(truth, seed)
        heights_m = [heights_at(surfaces, np.array([x, 0.0]))[0][1] for x in at_m]
        drawn.append(np.array(heights_m) - (10.0 + 0.03 * at_m))
    z = np.array(drawn)
    offset_m2 = MAP_ERRORS.common_offset_sigma_m**2
    expected = MAP_ERRORS.covariance_m2(at_m[:, None], np.full(len(at_m), 0.05)) + offset_m2
    # σ of an element of a sample covariance is at most √(2 / n) times the variance; five of them for 231 elements.
    largest_m2 = 5.0 * math.sqrt(2.0 / drives) * (0.05**2 + offset_m2)
    np.testing.assert_allclose(z.T @ z / drives, expected, rtol=0.0, atol=largest_m2)
    assert np.std(z.mean(axis=1)) > 0.05, (
        "a common offset, and long correlation: along one drive errors are alike"
    )


def test_the_road_has_no_crossfall() -> None:
    surfaces, _ = made(drive_along([(0.0, 0.0, 10.0), (100.0, 0.0, 15.0)]))
    assert max(float(np.ptp(grid, axis=1).max()) for grid in surfaces.heights_m) < 1e-9


@pytest.mark.parametrize("away_m", [0.0, 2.0, 3.4])
def test_a_second_pass_gets_the_surface_of_the_first(away_m: float) -> None:
    # There, round a block, and along the same street again; its heights say 5 cm more the second time.
    block = [(100.0, 0.0, 10.0), (100.0, 60.0, 10.0), (0.0, 60.0, 10.0), (0.0, away_m, 10.05)]
    once = drive_along([(0.0, 0.0, 10.0), *block[:-1]])
    twice = drive_along([(0.0, 0.0, 10.0), *block, (100.0, away_m, 10.05)])
    first, _ = made(once)
    both, links = made(twice)
    for x in np.arange(20.0, 90.0, 5.0):
        place = np.array([x, away_m])
        before, after = heights_at(first, place), heights_at(both, place)
        assert np.ptp([height for _, height in after]) < 0.01
        assert after[0][1] == pytest.approx(before[0][1], abs=0.01)
    assert sum(len(dense(line)) for line in link_lines(links)) * 0.25 < 345.0


def test_a_street_that_crosses_at_grade_has_one_height_and_one_node_there() -> None:
    corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 60.0), (50.0, 60.0), (50.0, -60.0)]
    loop = [(east, north, 10.0) for east, north in corners]
    surfaces, links = made(drive_along(loop))
    heights = [height for _, height in heights_at(surfaces, np.array([50.0, 0.0]))]
    assert heights
    assert np.ptp(heights) < 0.01
    nodes = np.concatenate((links.start_node, links.end_node)).tolist()
    assert sorted(nodes.count(node) for node in set(nodes))[-1] == 4


def test_a_bridge_over_the_same_street_is_another_level() -> None:
    truth = short_drive_truth()
    surfaces, links = made(truth)
    there = sorted(heights_at(surfaces, np.array([100.0, 0.0])))
    levels = [level for level, _ in there]
    assert (min(levels), max(levels)) == (0, 1)
    heights = {level: [h for at, h in there if at == level] for level in (0, 1)}
    assert min(heights[1]) - max(heights[0]) > 4.0
    assert all(np.ptp(of_level) < 0.01 for of_level in heights.values())
    centre = FRAME.east_north_from_geodetic_array(
        surfaces.latitude_rad, surfaces.longitude_rad, np.zeros(len(surfaces))
    )
    near = np.hypot(*(centre - (100.0, 0.0)).T) <= 12.0
    under, over = (set(surfaces.link_id[near & (surfaces.level == level)].tolist()) for level in (0, 1))
    assert under
    assert over
    assert not under & over
    assert set(links.level[np.isin(links.link_id, list(over))].tolist()) == {1}


def test_a_link_and_all_its_surfaces_are_on_one_level() -> None:
    for truth in (drive_along(SQUARE), short_drive_truth()):
        surfaces, links = made(truth)
        level_of = dict(zip(links.link_id.tolist(), links.level.tolist(), strict=True))
        assert [level_of[link] for link in surfaces.link_id.tolist()] == surfaces.level.tolist()


def test_reversing_and_standing_add_no_roads() -> None:
    forward = drive_along([(0.0, 0.0, 10.0), (60.0, 0.0, 10.0)])
    back = drive_along([(0.0, 0.0, 10.0), (60.0, 0.0, 10.0), (30.0, 0.0, 10.0)], stand=100)
    once, links_once = made(forward)
    again, links_again = made(back)
    assert len(again) <= len(once) + 1  # where it turns, samples of both ways may miss one another
    assert len(links_once) == len(links_again) == 1


@pytest.mark.parametrize("seed", range(8))
def test_links_are_within_the_deviation_of_the_track_everywhere_and_come_near_to_it(seed: int) -> None:
    for truth in (drive_along(SQUARE), short_drive_truth()):
        track = dense(plane(truth)[np.append(True, np.hypot(*np.diff(plane(truth), axis=0).T) > 1e-6)])
        _, links = made(truth, seed)
        lines = [dense(line) for line in link_lines(links)]
        furthest_m = max(furthest(line[::4], track) for line in lines)
        assert 1.2 < furthest_m <= 3.1  # 0.1 m for how densely the lines are sampled
        assert furthest(track[::8], np.vstack(lines)) <= 3.6


# The last street meets the first, whose parts are 900 m and 700 m long.
LONG_STREET = [
    (0.0, 0.0, 10.0),
    (1600.0, 0.0, 10.0),
    (1600.0, 200.0, 10.0),
    (900.0, 200.0, 10.0),
    (900.0, 3.0, 10.0),
]


@pytest.mark.parametrize("corners_m", [SQUARE, LONG_STREET], ids=["square", "long street"])
def test_links_meet_at_their_nodes_and_are_100_to_300_m_long(
    corners_m: list[tuple[float, float, float]],
) -> None:
    _, links = made(drive_along(corners_m))
    lines = link_lines(links)
    nodes: dict[int, Array] = {}
    for start, end, line in zip(links.start_node.tolist(), links.end_node.tolist(), lines, strict=True):
        for node, place in ((start, line[0]), (end, line[-1])):
            np.testing.assert_allclose(nodes.setdefault(node, place), place, atol=1e-6)
    lengths = [np.hypot(*np.diff(line, axis=0).T).sum() for line in lines]
    assert 100.0 < min(lengths) <= max(lengths) < 310.0
    assert links.end_node[-1] in links.start_node  # the last street ends at the first


def test_ids_do_not_depend_on_the_seed_and_equal_seeds_give_equal_maps() -> None:
    truth = short_drive_truth()
    (s1, l1), (s2, l2), (s3, l3) = (made(truth, seed) for seed in (1, 1, 2))
    assert all((a == b).all() for a, b in zip(s1.heights_m, s2.heights_m, strict=True))
    assert all((a == b).all() for a, b in zip(l1.vertices, l2.vertices, strict=True))
    assert (s1.link_id == s3.link_id).all()
    assert (l1.start_node == l3.start_node).all()
    assert any((a != b).any() for a, b in zip(s1.heights_m, s3.heights_m, strict=True))


def test_map_sigma_does_not_shift_the_links() -> None:
    truth = drive_along(SQUARE)
    _, fine = made(truth)
    _, coarse = made(truth, map_sigma_m=0.2)
    assert all((a == b).all() for a, b in zip(fine.vertices, coarse.vertices, strict=True))


def test_a_track_that_does_not_move_is_refused() -> None:
    still = np.zeros((50, 2))
    with pytest.raises(ValueError, match=r"0\.0 m long"):
        road_lines(still, np.zeros(50))


def test_thinning_keeps_the_ends_and_leaves_nothing_further_off_than_the_tolerance() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        line = np.cumsum(rng.normal(size=(40, 2)), axis=0)
        kept = thinned(line, 0.8)
        assert kept[0] == 0
        assert kept[-1] == 39
        assert furthest(line, dense(line[kept], 0.01)) <= 0.81

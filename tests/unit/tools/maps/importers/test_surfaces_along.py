from __future__ import annotations

import math

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.road_tiles import surface_tiles, surfaces_from_tiles
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from support.nearest_surface import nearest_heights
from support.small_map import link, links

FRAME = LocalFrame(math.radians(35.1), math.radians(137.0), 0.0)
SEEN_NS = 1_400_000_000 * 10**9


def roads(*lines_m: Floats, half_width_m: float = 2.0) -> RoadCentreLines:
    places = (FRAME.geodetic_from_east_north_array(line, 0.0)[:2] for line in lines_m)
    vertices = [{"vertices": np.column_stack(place)} for place in places]
    rows = [link(k, (2 * k, 2 * k + 1), []) | line for k, line in enumerate(vertices)]
    return RoadCentreLines(links(rows), np.full(len(rows), half_width_m))


def hill(east_m: Floats, north_m: Floats) -> Floats:
    height: Floats = 50.0 + 0.05 * east_m - 0.02 * north_m + 0.0005 * east_m**2
    return height


class HillWithHole:
    """Known but for a disc; σ is 2 cm."""

    def __init__(self, centre_m: tuple[float, float] = (0.0, 0.0), radius_m: float = 0.0) -> None:
        self.centre_m, self.radius_m = centre_m, radius_m

    def __call__(self, latitude: Floats, longitude: Floats, _: Integers) -> tuple[Floats, Floats]:
        plane = FRAME.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
        known = np.hypot(*(plane - self.centre_m).T) >= self.radius_m
        return np.where(known, hill(*plane.T), np.nan), np.where(known, 0.02, np.nan)


def covering(surfaces: RoadSurfaces, places_m: Floats) -> tuple[Floats, Floats]:
    """Height (n,) of the nearest surface at places, and how far off it is."""
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(places_m, 0.0)
    return nearest_heights(surfaces, latitude, longitude)


BEND = np.column_stack(
    (60.0 * np.sin(np.linspace(0, 1.5, 200)), 60.0 * (1 - np.cos(np.linspace(0, 1.5, 200))))
)


def test_along_a_bend_the_whole_road_has_its_height_through_a_release_s_tiles_too() -> None:
    surfaces = surfaces_along(roads(BEND), HillWithHole(), spacing_m=0.5, seen_ns=SEEN_NS)
    surfaces = surfaces_from_tiles(surface_tiles(surfaces))
    middle = 0.5 * (BEND[1:] + BEND[:-1])
    step = np.diff(BEND, axis=0)
    across = np.column_stack((-step[:, 1], step[:, 0])) / np.hypot(*step.T)[:, None]
    for side_m in (-1.7, 0.0, 1.7):
        places = middle + side_m * across
        height_m, outside_m = covering(surfaces, places)
        assert outside_m.max() < 0.01
        assert np.abs(height_m - hill(*places.T)).max() < 0.001
    assert (surfaces.half_length_m <= 10.6).all()
    assert surfaces.sigma_m == pytest.approx(0.02, abs=1e-4)
    assert (surfaces.last_seen_ns == SEEN_NS).all()


def test_a_grid_too_wide_for_the_ground_says_so_in_its_sigma() -> None:
    def waves(latitude: Floats, longitude: Floats, _: Integers) -> tuple[Floats, Floats]:
        east = FRAME.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)[:, 0]
        return 0.1 * np.sin(2.0 * math.pi * east / 3.0), np.full(len(east), 0.01)

    line = np.array([[0.0, 0.0], [100.0, 0.0]])
    fine, coarse = (
        surfaces_along(roads(line), waves, spacing_m=spacing_m, seen_ns=SEEN_NS) for spacing_m in (0.1, 3.1)
    )
    assert fine.sigma_m.max() < 0.0101
    assert coarse.sigma_m.min() > 0.03


def test_where_the_ground_is_not_known_there_is_no_surface_and_all_around_there_is() -> None:
    line = np.array([[0.0, 0.0], [60.0, 0.0]])
    hole = HillWithHole((33.0, 0.5), 2.5)
    surfaces = surfaces_along(roads(line), hole, spacing_m=0.5, seen_ns=SEEN_NS)
    along = np.column_stack((np.arange(0.0, 60.0, 0.1), np.zeros(600)))
    height_m, outside_m = covering(surfaces, along)
    off = np.abs(along[:, 0] - 33.0)
    assert outside_m[off < 2.0].min() > 0.0
    assert outside_m[off > 3.6].max() < 0.01
    covered = outside_m == 0.0
    assert np.abs(height_m - hill(*along.T))[covered].max() < 0.001


def test_a_road_known_to_one_side_only_has_surfaces_as_wide_as_is_known() -> None:
    line = np.array([[0.0, 0.0], [40.0, 0.0]])
    next_to = HillWithHole((20.0, 101.0), 100.0)  # from some 1 m to the left on nothing is known
    surfaces = surfaces_along(roads(line, half_width_m=3.0), next_to, spacing_m=0.5, seen_ns=SEEN_NS)
    places = np.array([[20.0, -2.0], [20.0, 0.0], [20.0, 2.0]])
    _, outside_m = covering(surfaces, places)
    assert outside_m[:2].max() == 0.0
    assert outside_m[2] > 0.5


def test_what_rises_like_a_wall_is_no_road() -> None:
    def walled(latitude: Floats, longitude: Floats, _: Integers) -> tuple[Floats, Floats]:
        east, north = FRAME.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude).T
        return hill(east, north) + np.where(north > 1.1, 3.0, 0.0), np.full(len(east), 0.02)

    line = np.array([[0.0, 0.0], [40.0, 0.0]])
    surfaces = surfaces_along(roads(line), walled, spacing_m=0.5, seen_ns=SEEN_NS)
    height_m, outside_m = covering(surfaces, np.array([[20.0, 0.0], [20.0, 1.6]]))
    assert outside_m[0] == 0.0
    assert abs(height_m[0] - hill(np.array(20.0), np.array(0.0))) < 0.001
    assert outside_m[1] > 0.4


def test_where_nothing_is_known_there_is_nothing() -> None:
    hole = HillWithHole((0.0, 0.0), 1e6)
    line = np.array([[0.0, 0.0], [60.0, 0.0]])
    assert len(surfaces_along(roads(line), hole, spacing_m=0.5, seen_ns=SEEN_NS)) == 0


def test_the_same_line_gives_the_same_ids_whatever_is_known_of_the_others() -> None:
    lines = (np.array([[0.0, 0.0], [60.0, 0.0]]), np.array([[0.0, 50.0], [60.0, 50.0]]))
    whole = surfaces_along(roads(*lines), HillWithHole(), spacing_m=1.0, seen_ns=SEEN_NS)
    holed = surfaces_along(roads(*lines), HillWithHole((5.0, 0.0), 30.0), spacing_m=1.0, seen_ns=SEEN_NS)
    assert len(whole) == 6
    left = set(holed.surface_id.tolist())
    assert len(left & set(whole.surface_id.tolist())) == 4  # but for the two that reach into the hole
    assert len(left) == 5
    moved = surfaces_along(roads(lines[0] + 0.01, lines[1]), HillWithHole(), spacing_m=1.0, seen_ns=SEEN_NS)
    assert (
        len(set(moved.surface_id.tolist()) & set(whole.surface_id.tolist())) == 3
    )  # another line, other ids

"""Which surfaces border on which, and which street and region each is of."""

from __future__ import annotations

import math

import numpy as np

from camber.map_update.fusion.surface_neighbours import SurfaceNeighbourhood, build_neighbourhood
from support.small_map import surface, surfaces


def made(*rows: dict[str, object]) -> SurfaceNeighbourhood:
    return build_neighbourhood(surfaces(rows), street_m=300.0, region_m=1000.0)


def neighbours(result: SurfaceNeighbourhood, surface_id: int) -> set[int]:
    (row,) = result.rows_of(np.array([surface_id])).tolist()
    rows = result.neighbour[result.neighbour_begins[row] : result.neighbour_begins[row + 1]]
    return set(result.surface_id[rows].tolist())


def test_surfaces_that_abut_or_overlap_are_neighbours_and_others_not() -> None:
    result = made(
        surface(5),
        surface(3, 20.3),  # ahead, with a gap of 0.3 m
        surface(9, 0.0, 4.0),  # the lane beside
        surface(1, 0.0, 9.0),  # one lane further
        surface(2, 20.8, 12.0),  # far from all
        surface(8, -12.0, 0.0, yaw_rad=math.pi / 2),  # across the rear end
    )
    assert neighbours(result, 5) == {3, 9, 8}
    assert neighbours(result, 3) == {5, 9}
    assert neighbours(result, 1) == {8}
    assert neighbours(result, 2) == set()
    assert neighbours(result, 8) == {5, 9, 1}


def test_a_road_over_another_is_not_its_neighbour() -> None:
    result = made(surface(1), surface(2, level=1, heights_m=55.0), surface(3, yaw_rad=1.0))
    assert neighbours(result, 1) == {3}
    assert neighbours(result, 2) == set()


def test_a_road_continues_where_its_level_changes() -> None:
    ramp = np.array([[50.0, 50.0], [52.0, 52.0]])  # rises ahead, to where the bridge begins
    bridge = surface(2, 20.2, level=1, heights_m=52.0)
    assert neighbours(made(surface(1, heights_m=ramp), bridge), 1) == {2}
    # A street that ends beneath it.
    assert neighbours(made(surface(1, heights_m=ramp[::-1]), bridge), 1) == set()


def test_rectangles_in_a_bend_meet_by_their_sides() -> None:
    """Both rectangles' circles overlap; turned by 45° they meet only at the nearer distance."""
    for place_m, expected in ((13.5, 6.0), {2}), ((8.0, 14.0), set()):
        assert neighbours(made(surface(1), surface(2, *place_m, yaw_rad=math.pi / 4)), 1) == expected


def test_streets_and_regions_are_squares() -> None:
    result = made(*(surface(k, 100.0 * k) for k in range(30)))
    _, in_block = np.unique(result.block, return_counts=True)
    _, in_region = np.unique(result.region, return_counts=True)
    assert 10 <= len(in_block) <= 11
    assert 3 <= len(in_region) <= 4
    assert in_block.max() == 3
    assert (np.diff(result.block) >= 0).all() or (np.diff(result.block) <= 0).all()


def test_rows_by_id_and_an_empty_neighbourhood() -> None:
    result = made(surface(5), surface(3, 40.0))
    assert result.rows_of(np.array([3, 4, 5, 99])).tolist() == [0, -1, 1, -1]
    assert made().rows_of(np.array([1])).tolist() == [-1]

"""How sure a match is along its worst direction, by what shifts along it leave open."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.localizer.matching.shift_profile import REACH_M, OccupancyRaster, shift_profile

EAST = np.array([1.0, 0.0])


def street(posts_m: list[float], noise_m: float = 0.0, seed: int = 1) -> np.ndarray:
    """Two walls along east, 60 m long, and posts beside the road: points (n, 2)."""
    rng = np.random.default_rng(seed)
    along = np.arange(-30.0, 30.0, 0.2)
    walls = [np.column_stack((along, np.full(len(along), y))) for y in (-8.0, 8.0)]
    rings = np.array([(0.15 * math.cos(a), 0.15 * math.sin(a)) for a in np.linspace(0.0, 6.0, 12)])
    posts = [rings + np.array([x, y]) for x in posts_m for y in (-5.0, 5.0)]
    points = np.concatenate((*walls, *posts))
    return points + rng.normal(0.0, noise_m, points.shape)


POSTS = [-27.3, -21.0, -16.9, -9.2, -4.4, 3.1, 9.7, 12.8, 19.5, 26.0]


def seen(posts_m: list[float], seed: int) -> np.ndarray:
    """What a local map has of it: not its ends."""
    points = street(posts_m, 0.02, seed=seed)
    return points[np.abs(points[:, 0]) < 20.0]


def test_posts_determine_the_position_along_a_street() -> None:
    profile = shift_profile(seen(POSTS, 2), OccupancyRaster.of(street(POSTS)), EAST)
    assert abs(profile.mean_m) < 0.1
    assert profile.sigma_m < 0.15


def test_walls_alone_do_not() -> None:
    profile = shift_profile(seen([], 2), OccupancyRaster.of(street([])), EAST)
    assert profile.sigma_m > 0.5


@pytest.mark.parametrize("off_m", [-1.2, 0.8, 2.0])
def test_a_match_in_the_wrong_minimum_is_detected(off_m: float) -> None:
    profile = shift_profile(seen(POSTS, 3) + np.array([off_m, 0.0]), OccupancyRaster.of(street(POSTS)), EAST)
    assert profile.mean_m == pytest.approx(-off_m, abs=0.15)
    assert profile.variance_m2 > 0.8 * off_m**2


def test_a_row_of_equal_posts_leaves_every_one_of_them_open() -> None:
    even = [-27.0 + 2.0 * n for n in range(28)]
    profile = shift_profile(seen(even, 6), OccupancyRaster.of(street(even)), EAST)
    assert profile.sigma_m > 1.0


def test_many_points_on_one_post_say_no_more_than_some() -> None:
    above = OccupancyRaster.of(street(POSTS))
    once = shift_profile(seen(POSTS, 4), above, EAST)
    again = shift_profile(np.concatenate([seen(POSTS, 4)] * 20), above, EAST)
    assert again.sigma_m == pytest.approx(once.sigma_m, rel=0.02)


def test_the_direction_is_the_one_asked_for() -> None:
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    above = OccupancyRaster.of(street(POSTS) @ turn.T)
    profile = shift_profile((seen(POSTS, 5) + np.array([0.8, 0.0])) @ turn.T, above, turn @ EAST)
    assert profile.mean_m == pytest.approx(-0.8, abs=0.15)


def test_where_nothing_stands_nothing_is_known() -> None:
    nothing = OccupancyRaster.of(np.zeros((0, 3)))
    assert shift_profile(seen(POSTS, 7), nothing, EAST).sigma_m > 0.5 * REACH_M
    assert shift_profile(np.zeros((0, 3)), OccupancyRaster.of(street(POSTS)), EAST).sigma_m == REACH_M

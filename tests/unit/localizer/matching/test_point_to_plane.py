"""Fitting to planes: three degrees of freedom move, and no direction that the planes leave open."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.localizer.matching.icp import (
    DEGENERATE_RATIO,
    Freedom,
    IcpOptions,
    find_correspondences,
    icp_point_to_plane,
    moved,
    normal_equations,
)
from camber.localizer.matching.registration import LayerTarget
from support.plain_layers import (
    CORRIDOR,
    LOCAL_DENSITY,
    MAP_DENSITY,
    YARD,
    error,
    pose,
    road,
    seen_from,
    surfaces,
)

TRUTH = pose(3.0, -2.0, 30.0)


def options(free: Freedom, max_distance_m: float, first_scale_m: float) -> IcpOptions:
    return IcpOptions(free=free, max_distance_m=max_distance_m, first_scale_m=first_scale_m)


@pytest.fixture(scope="module")
def yard() -> LayerTarget:
    return LayerTarget.of(surfaces(YARD, MAP_DENSITY, np.random.default_rng(1)))


@pytest.fixture(scope="module")
def corridor() -> LayerTarget:
    return LayerTarget.of(surfaces(CORRIDOR, MAP_DENSITY, np.random.default_rng(1)))


def test_east_north_and_yaw_are_right_from_a_metre_and_five_degrees_off(yard: LayerTarget) -> None:
    source = seen_from(TRUTH, surfaces(YARD, LOCAL_DENSITY, np.random.default_rng(2)))
    fit = icp_point_to_plane(
        [(yard, source)],
        moved(TRUTH, np.array([0.8, -0.6, math.radians(5.0)]), "planar"),
        options("planar", 3.0, 1.0),
    )
    off_m, off_rad = error(fit.transform, TRUTH)
    assert fit.converged
    assert off_m < 0.005
    assert off_rad < 0.0005


def test_a_planar_fit_leaves_height_roll_and_pitch_and_a_vertical_fit_the_rest(yard: LayerTarget) -> None:
    guess = pose(3.2, -2.1, 31.0, 0.1, 0.5, -0.5)
    source = seen_from(TRUTH, surfaces(YARD, LOCAL_DENSITY, np.random.default_rng(2)))
    planar = icp_point_to_plane([(yard, source)], guess, options("planar", 1.0, 0.3)).transform
    assert planar[2, 3] == guess[2, 3]
    np.testing.assert_allclose(planar[2, :3], guess[2, :3], atol=1e-12)
    ground = LayerTarget.of(road(MAP_DENSITY, np.random.default_rng(1)))
    seen = seen_from(TRUTH, road(LOCAL_DENSITY, np.random.default_rng(2), 8.0))
    vertical = icp_point_to_plane([(ground, seen)], guess, options("vertical", 0.6, 0.3)).transform
    np.testing.assert_array_equal(vertical[:2, 3], guess[:2, 3])
    roll, pitch, _ = roll_pitch_yaw_from_rotation(vertical)
    assert abs(vertical[2, 3]) < 0.005
    assert abs(roll) < 0.001
    assert abs(pitch) < 0.001


@pytest.mark.parametrize("along_m", [-2.0, 0.0, 0.7])
def test_in_a_corridor_nothing_moves_along_it(corridor: LayerTarget, along_m: float) -> None:
    """The walls' ends are beyond what is seen; the guess along them stays, across and yaw are found."""
    walls = [((-30.0, y), (30.0, y)) for y in (-4.0, 4.0)]
    source = surfaces(walls, LOCAL_DENSITY, np.random.default_rng(2))
    guess = pose(along_m, 0.3, 1.0)
    fit = icp_point_to_plane([(corridor, source)], guess, options("planar", 1.0, 0.3))
    assert fit.converged
    assert abs(fit.transform[0, 3] - along_m) < 0.02
    assert abs(fit.transform[1, 3]) < 0.005
    rows = normal_equations(
        corridor, source, fit.transform, find_correspondences(corridor, source, fit.transform), free="planar"
    )
    ratios, directions, _ = rows.observability()
    assert ratios[0] < DEGENERATE_RATIO < ratios[1]
    along = directions[:, 0] / np.linalg.norm(directions[:, 0])
    assert abs(along[0]) > 0.99
    information = rows.information()
    assert information[0, 0] < 1e-3 * information[1, 1]


def test_a_few_posts_make_a_corridor_s_length_seen() -> None:
    posts = [((x, s * 3.8), (x, s * 3.5)) for x in range(-25, 30, 10) for s in (-1, 1)]
    target = LayerTarget.of(surfaces(CORRIDOR + posts, MAP_DENSITY, np.random.default_rng(1)))
    source = surfaces(CORRIDOR + posts, LOCAL_DENSITY, np.random.default_rng(2))
    fit = icp_point_to_plane([(target, source)], pose(0.3, 0.2, 0.5), options("planar", 1.0, 0.3))
    assert error(fit.transform, pose(0.0, 0.0, 0.0))[0] < 0.02


@pytest.mark.parametrize("free", ["planar", "vertical"])
def test_the_gradient_is_that_of_the_sum_of_squares(yard: LayerTarget, free: Freedom) -> None:
    """By differences: with a wide scale no point is an outlier, and the pairs are kept."""
    source = seen_from(TRUTH, surfaces(YARD, 1.0, np.random.default_rng(2)))
    at = moved(TRUTH, np.array([0.02, 0.01, 0.001]), "planar")
    pairs = find_correspondences(yard, source, at)

    def sums(step: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        points = source @ moved(at, step, free)[:3, :3].T + moved(at, step, free)[:3, 3]
        residual = np.sum(yard.normals[pairs[0]] * (yard.points_m[pairs[0]] - points), axis=1)
        variance = yard.thickness_m[pairs[0]] ** 2 + 0.03**2 + 100.0**2
        return float(np.sum(residual**2 / variance))

    rows = normal_equations(yard, source, at, pairs, free=free, max_distance_m=10.0, scale_m=100.0)
    for k in range(3):
        h = np.zeros(3)
        h[k] = 1e-4
        slope = (sums(h) - sums(-h)) / 2e-4
        curve = (sums(h) - 2.0 * sums(np.zeros(3)) + sums(-h)) / 1e-8
        assert rows.gradient[k] == pytest.approx(-0.5 * slope, rel=1e-3, abs=1e-9)
        assert rows.normal_matrix[k, k] == pytest.approx(0.5 * curve, rel=0.05)


def test_what_has_moved_does_not_pull_in_the_end(yard: LayerTarget) -> None:
    """A third of the yard's points is 0.4 m off, all the same way."""
    points = surfaces(YARD, LOCAL_DENSITY, np.random.default_rng(2))
    points[points[:, 0] < -8.0] += np.array([0.0, 0.4, 0.0])
    fit = icp_point_to_plane([(yard, seen_from(TRUTH, points))], TRUTH, options("planar", 1.0, 0.3))
    assert error(fit.transform, TRUTH)[0] < 0.02


def test_nothing_near_does_not_converge(yard: LayerTarget) -> None:
    source = seen_from(TRUTH, surfaces(YARD, 1.0, np.random.default_rng(2)))
    fit = icp_point_to_plane([(yard, source)], pose(500.0, 0.0, 0.0), options("planar", 1.0, 0.3))
    assert not fit.converged
    np.testing.assert_array_equal(fit.transform, pose(500.0, 0.0, 0.0))

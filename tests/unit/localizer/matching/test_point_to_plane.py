"""Fitting to planes: three degrees of freedom move, and no direction that the planes leave open."""

from __future__ import annotations

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
    TRUTH,
    YARD,
    YARD_M,
    YARD_SEEN_M,
    error,
    pose,
    road,
    seen_from,
    surfaces,
)


def options(free: Freedom, max_distance_m: float, first_scale_m: float) -> IcpOptions:
    return IcpOptions(free=free, max_distance_m=max_distance_m, first_scale_m=first_scale_m)


YARD_MAP, CORRIDOR_MAP = LayerTarget.of(YARD_M), LayerTarget.of(surfaces(CORRIDOR, MAP_DENSITY, 1))


def test_a_planar_fit_leaves_height_roll_and_pitch_and_a_vertical_fit_the_rest() -> None:
    guess = pose(3.2, -2.1, 31.0, 0.1, 0.5, -0.5)
    source = YARD_SEEN_M
    planar = icp_point_to_plane([(YARD_MAP, source)], guess, options("planar", 1.0, 0.3)).transform
    assert planar[2, 3] == guess[2, 3]
    np.testing.assert_allclose(planar[2, :3], guess[2, :3], atol=1e-12)
    ground = LayerTarget.of(road(MAP_DENSITY, 1))
    seen = seen_from(TRUTH, road(LOCAL_DENSITY, 2, 8.0))
    vertical = icp_point_to_plane([(ground, seen)], guess, options("vertical", 0.6, 0.3)).transform
    np.testing.assert_array_equal(vertical[:2, 3], guess[:2, 3])
    roll, pitch, _ = roll_pitch_yaw_from_rotation(vertical)
    assert abs(vertical[2, 3]) < 0.005
    assert abs(roll) < 0.001
    assert abs(pitch) < 0.001


@pytest.mark.parametrize("along_m", [-2.0, 0.0, 0.7])
def test_in_a_corridor_nothing_moves_along_it(along_m: float) -> None:
    """The walls' ends are beyond what is seen; the guess along them stays, across and yaw are found."""
    walls = [((-30.0, y), (30.0, y)) for y in (-4.0, 4.0)]
    source = surfaces(walls, LOCAL_DENSITY, 2)
    guess = pose(along_m, 0.3, 1.0)
    fit = icp_point_to_plane([(CORRIDOR_MAP, source)], guess, options("planar", 1.0, 0.3))
    assert fit.converged
    assert abs(fit.transform[0, 3] - along_m) < 0.02
    assert abs(fit.transform[1, 3]) < 0.005
    rows = normal_equations(
        CORRIDOR_MAP,
        source,
        fit.transform,
        find_correspondences(CORRIDOR_MAP, source, fit.transform),
        free="planar",
    )
    ratios, directions, _ = rows.observability()
    assert ratios[0] < DEGENERATE_RATIO < ratios[1]
    along = directions[:, 0] / np.linalg.norm(directions[:, 0])
    assert abs(along[0]) > 0.99
    information = rows.information()
    assert information[0, 0] < 1e-3 * information[1, 1]


@pytest.mark.parametrize("free", ["planar", "vertical"])
def test_the_gradient_is_that_of_the_sum_of_squares(free: Freedom) -> None:
    """By differences: with a wide scale no point is an outlier, and the pairs are kept."""
    source = seen_from(TRUTH, surfaces(YARD, 1.0, 2))
    at = moved(TRUTH, np.array([0.02, 0.01, 0.001]), "planar")
    pairs = find_correspondences(YARD_MAP, source, at)

    def sums(step: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        points = source @ moved(at, step, free)[:3, :3].T + moved(at, step, free)[:3, 3]
        residual = np.sum(YARD_MAP.normals[pairs[0]] * (YARD_MAP.points_m[pairs[0]] - points), axis=1)
        variance = YARD_MAP.thickness_m[pairs[0]] ** 2 + 0.03**2 + 100.0**2
        return float(np.sum(residual**2 / variance))

    rows = normal_equations(YARD_MAP, source, at, pairs, free=free, max_distance_m=10.0, scale_m=100.0)
    for k in range(3):
        h = np.zeros(3)
        h[k] = 1e-4
        slope = (sums(h) - sums(-h)) / 2e-4
        curve = (sums(h) - 2.0 * sums(np.zeros(3)) + sums(-h)) / 1e-8
        assert rows.gradient[k] == pytest.approx(-0.5 * slope, rel=1e-3, abs=1e-9)
        assert rows.normal_matrix[k, k] == pytest.approx(0.5 * curve, rel=0.05)


def test_what_has_moved_does_not_pull_in_the_end() -> None:
    """A third of the yard's points is 0.4 m off, all the same way."""
    points = surfaces(YARD, LOCAL_DENSITY, 2)
    points[points[:, 0] < -8.0] += np.array([0.0, 0.4, 0.0])
    fit = icp_point_to_plane([(YARD_MAP, seen_from(TRUTH, points))], TRUTH, options("planar", 1.0, 0.3))
    assert error(fit.transform, TRUTH)[0] < 0.02


def test_nothing_near_does_not_converge() -> None:
    source = seen_from(TRUTH, surfaces(YARD, 1.0, 2))
    fit = icp_point_to_plane([(YARD_MAP, source)], pose(500.0, 0.0, 0.0), options("planar", 1.0, 0.3))
    assert not fit.converged
    np.testing.assert_array_equal(fit.transform, pose(500.0, 0.0, 0.0))

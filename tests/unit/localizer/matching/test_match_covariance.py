"""The covariance of a match: what is seen, what is not, and that many points on one wall are not many witnesses."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.arrays import Floats
from camber.localizer.matching.icp import (
    IcpOptions,
    find_correspondences,
    icp_point_to_plane,
    normal_equations,
)
from camber.localizer.matching.match_covariance import (
    FLOOR_M,
    UNSEEN_M,
    is_degenerate,
    planar_covariance,
)
from camber.localizer.matching.registration import LayerTarget
from support.plain_layers import CORRIDOR, MAP_DENSITY, YARD, pose, surfaces

AT = pose(0.0, 0.0, 0.0)


def covariance_at(target: LayerTarget, source: Floats, at: Floats) -> Floats:
    pairs = find_correspondences(target, source, at)
    return planar_covariance(normal_equations(target, source, at, pairs, free="planar"), source)


def covariance(walls: list[tuple[tuple[float, float], tuple[float, float]]], density: float) -> Floats:
    target = LayerTarget.of(surfaces(walls, MAP_DENSITY, 1))
    return covariance_at(target, surfaces(walls, density, 2), AT)


def test_in_a_yard_everything_is_seen_and_no_better_than_the_floor() -> None:
    sigma = np.sqrt(np.diag(covariance(YARD, 10.0)))
    assert (sigma[:2] >= FLOOR_M).all()
    assert (sigma[:2] < 0.02).all()
    assert not is_degenerate(covariance(YARD, 10.0))


def test_twice_as_many_points_on_the_same_walls_add_hardly_any_information() -> None:
    few, many = covariance(YARD, 10.0), covariance(YARD, 40.0)
    assert np.diag(many)[:2] == pytest.approx(np.diag(few)[:2], rel=0.2)


def test_without_any_pair_nothing_is_known() -> None:
    target = LayerTarget.of(surfaces(CORRIDOR, 5.0, 1))
    source = surfaces(YARD, 1.0, 2) + 500.0
    assert np.sqrt(np.diag(covariance_at(target, source, AT)))[:2] == pytest.approx(UNSEEN_M, rel=1e-3)


def test_errors_are_no_larger_than_the_covariance_says() -> None:
    """Yards whose walls stand otherwise than the map says, each by 2 cm: what neighbouring points share."""
    random = np.random.default_rng(5)
    squares = []
    for seed in range(25):
        moved_walls = [
            tuple(tuple(np.array(end) + shift) for end in wall)
            for wall, shift in zip(YARD, random.normal(0.0, 0.02, (len(YARD), 2)), strict=True)
        ]
        target = LayerTarget.of(surfaces(YARD, 12.0, (seed, 1)))
        source = surfaces(moved_walls, 4.0, (seed, 2))  # type: ignore[arg-type]
        fit = icp_point_to_plane(
            [(target, source)], AT, IcpOptions(free="planar", max_distance_m=1.0, first_scale_m=0.15)
        )
        t = fit.transform
        error = np.array([t[0, 3], t[1, 3], np.arctan2(t[1, 0], t[0, 0])])
        squares.append(float(error @ np.linalg.solve(covariance_at(target, source, t), error)))
    assert np.mean(squares) < 3.0 * 1.5

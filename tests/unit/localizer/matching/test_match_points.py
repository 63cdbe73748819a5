"""Points of a match for viewers: where the match has put them, before or beyond the map, and not too many."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput, MatchOptions
from camber.localizer.matching.match_candidate import MatchCandidate
from camber.localizer.matching.match_points import MOST_POINTS, match_points
from camber.localizer.matching.registration import LayerTarget
from camber.schemas.pose import ScanMatchPoints

OPTIONS = MatchOptions(layer_bounds_m=((0.0, 1.0), (1.0, 2.0)), max_distance_m=1.0)
MAP_FROM_LOCAL = map_from_vehicle(10.0, 5.0, 0.0, 0.0, 0.0, math.pi / 2)
TIME_NS = 1_400_000_000 * 1_000_000_000


def walls() -> LayerTarget:
    """Walls in the planes north = 8 m and north = 2 m: to both sides of the vehicle."""
    east, up = np.meshgrid(np.arange(0.0, 20.0, 0.2), np.arange(0.1, 3.0, 0.2))
    both = [
        np.column_stack((east.ravel(), np.full(east.size, north_m), up.ravel())) for north_m in (2.0, 8.0)
    ]
    return LayerTarget.of(np.concatenate(both))


def points_of(local_m: np.ndarray, **changed: Any) -> ScanMatchPoints | None:
    match = LayeredMatch(
        **{
            "status": "converged",
            "reason": "agreed",
            "map_from_local": MAP_FROM_LOCAL,
            "covariance": np.eye(3),
        }
        | changed,
        layers=(),
    )
    targets = walls(), LayerTarget.of(np.zeros((0, 3)))
    scan = MatchInput(points_m=local_m, heights_m=local_m[:, 2], targets=targets, guess=np.eye(4))
    place = SimpleNamespace(
        block=SimpleNamespace(geodetic=lambda east_m, north_m: (east_m / 1e3, north_m / 1e3))
    )
    candidate = SimpleNamespace(time_ns=TIME_NS, match=match, scan=scan, place=place)
    return match_points(cast(MatchCandidate, candidate), OPTIONS)


def test_points_are_about_the_vehicle_and_beyond_the_map_is_positive_on_both_sides() -> None:
    points = points_of(np.array([(3.2, 0.1, 0.5), (2.9, 0.1, 0.5), (-3.2, 0.1, 0.5), (-2.9, 0.1, 0.5)]))
    assert points is not None
    assert (points.time_ns, points.status) == (TIME_NS, "converged")
    assert (points.latitude_rad, points.longitude_rad) == pytest.approx((0.01, 0.005))
    assert points.north_m == pytest.approx([3.2, 2.9, -3.2, -2.9], abs=1e-6)
    assert points.east_m == pytest.approx([-0.1] * 4, abs=1e-6)
    assert points.residual_m == pytest.approx([0.2, -0.1, 0.2, -0.1], abs=1e-6)
    assert points.paired.tolist() == [1] * 4


def test_a_point_without_a_partner_says_so_and_one_in_no_layer_is_left_out() -> None:
    points = points_of(np.array([(0.5, 0.0, 0.5), (3.0, 0.0, 1.5), (3.0, 0.0, 2.5), (3.0, 0.0, -0.1)]))
    assert points is not None
    assert points.north_m == pytest.approx([0.5, 3.0], abs=1e-6)
    assert points.paired.tolist() == [0, 0]


def test_points_are_thinned_and_a_lost_match_has_none() -> None:
    many = np.random.default_rng(3).uniform((-20.0, -20.0, 0.0), (20.0, 20.0, 2.0), (50_000, 3))
    points = points_of(many)
    assert points is not None
    assert 0.3 * MOST_POINTS < len(points.east_m) <= MOST_POINTS
    assert points_of(many, status="lost") is None

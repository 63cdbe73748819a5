"""What a picture of a match is made of: points where the match has put them, and how far the map's planes are."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput, MatchOptions
from camber.localizer.matching.match_view import MatchView, match_view
from camber.localizer.matching.registration import LayerTarget

OPTIONS = MatchOptions(layer_bounds_m=((0.0, 1.0), (1.0, 2.0)), max_distance_m=1.0)
MAP_FROM_LOCAL = map_from_vehicle(10.0, 5.0, 0.0, 0.0, 0.0, math.pi / 2)


class WallBlock:
    """A wall in the plane north = 8 m, 3 m high; the upper layer has no map."""

    def __init__(self) -> None:
        east, up = np.meshgrid(np.arange(0.0, 20.0, 0.2), np.arange(0.1, 3.0, 0.2))
        self.environment_m = np.column_stack((east.ravel(), np.full(east.size, 8.0), up.ravel()))
        self.height_above_road_m = self.environment_m[:, 2]
        self.frame, self.base_height_m = LocalFrame(0.6, 2.4, 0.0), 40.0

    def layers(self, bounds: Any) -> tuple[LayerTarget, ...]:
        assert bounds == OPTIONS.bounds_m
        return LayerTarget.of(self.environment_m), LayerTarget.of(np.zeros((0, 3)))


def view(local_m: list[tuple[float, float, float]]) -> MatchView:
    points_m = np.array(local_m)
    match = LayeredMatch(
        status="converged", reason="agreed", map_from_local=MAP_FROM_LOCAL, covariance=np.eye(3), layers=()
    )
    block = cast(MapBlock, WallBlock())
    scan = MatchInput(points_m=points_m, heights_m=points_m[:, 2], targets=(), guess=np.eye(4))
    return match_view(7, scan, block, match, options=OPTIONS)


def test_points_stand_where_the_match_has_put_them() -> None:
    seen = view([(3.0, 0.0, 0.5), (0.0, 2.0, 0.5)])
    assert seen.points_m == pytest.approx(np.array([(10.0, 8.0, 0.5), (8.0, 5.0, 0.5)]))
    assert seen.heights_m.tolist() == [0.5, 0.5]
    assert (seen.time_ns, seen.base_height_m) == (7, 40.0)


def test_residuals_are_distances_from_the_wall_whatever_lies_between_its_points() -> None:
    seen = view([(3.0, 0.07, 0.53), (3.25, 0.0, 0.5), (2.6, 0.0, 0.5)])
    assert seen.residual_m == pytest.approx([0.0, 0.25, 0.4], abs=1e-9)


def test_a_point_that_is_too_far_from_the_map_or_in_no_layer_has_none() -> None:
    seen = view([(0.5, 0.0, 0.5), (3.0, 0.0, 1.5), (3.0, 0.0, 2.5), (3.0, 0.0, -0.1)])
    assert seen.layer.tolist() == [0, 1, -1, -1]
    assert np.isnan(seen.residual_m).all()

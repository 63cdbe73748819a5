"""The matcher on a real street, to a pseudo truth of about 2 cm. Tables: `support.street_lidar_tables`."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.matching.coarse_search import search
from camber.localizer.matching.layered_matching import MatchOptions
from support import street_lidar
from support.moved_objects import Change
from support.street_lidar_tables import run, scan_of

pytestmark = pytest.mark.skipif(street_lidar.folder() is None, reason="CAMBER_DATA/street-lidar is not there")


def test_from_half_a_metre_and_two_degrees_off_the_error_is_small_and_the_covariance_holds_it() -> None:
    result = run(street_lidar.queries(0.5, 2.0, 1), MatchOptions())
    assert result.status["converged"] == len(result.error)
    assert result.centimetres(50) < 2.0
    assert result.centimetres(95) < 5.0
    assert result.square.mean() < 3.0


def test_from_a_metre_and_five_degrees_off_it_is_right() -> None:
    result = run(street_lidar.queries(1.0, 5.0, 2), MatchOptions())
    assert (result.distance_m < 0.2).all()


@pytest.mark.parametrize("change", ["shifted", "shifted_together", "replaced"])
def test_objects_that_moved_since_the_map_was_made_do_not_move_the_pose(change: Change) -> None:
    result = run(street_lidar.queries(0.5, 2.0, 1, change), MatchOptions())
    assert result.centimetres(95) < 5.0


def test_the_document_s_icp_is_drawn_along_with_the_whole_cloud_and_less_by_the_best_layer() -> None:
    asked = street_lidar.queries(0.5, 2.0, 1, "shifted_together")[::3]
    whole = run(asked, MatchOptions(method="point_to_point", choice="whole"))
    best = run(asked, MatchOptions(method="point_to_point", choice="best"))
    assert best.centimetres(95) < 5.0 < whole.centimetres(95)


def test_the_coarse_search_finds_the_street_from_four_metres_and_twelve_degrees_off() -> None:
    for query in street_lidar.queries(4.0, 12.0, 1)[::4]:
        result = search(scan_of(query, MatchOptions()), MatchOptions())
        assert result.unique
        assert result.match.status == "converged"
        assert np.hypot(*query.error(result.match.map_from_local)[:2]) < 0.05

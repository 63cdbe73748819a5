"""The matcher on a real street, to a pseudo truth of about 2 cm. The tables: `python -m support.street_lidar`."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.matching.coarse_search import search
from camber.localizer.matching.layered_matching import MatchOptions
from support import street_lidar
from support.moved_objects import Change
from support.street_lidar_tables import run

pytestmark = pytest.mark.skipif(street_lidar.folder() is None, reason="CAMBER_DATA/street-lidar is not there")


def test_from_half_a_metre_and_two_degrees_off_the_error_is_small_and_the_covariance_holds_it() -> None:
    found = run(street_lidar.queries(0.5, 2.0, 1), MatchOptions())
    assert found.status["converged"] == len(found.error)
    assert found.centimetres(50) < 2.0
    assert found.centimetres(95) < 5.0
    assert found.square.mean() < 3.0


def test_from_a_metre_and_five_degrees_off_it_is_right() -> None:
    found = run(street_lidar.queries(1.0, 5.0, 2), MatchOptions())
    assert (found.distance_m < 0.2).all()


@pytest.mark.parametrize("change", ["shifted", "shifted_together", "replaced"])
def test_objects_that_moved_since_the_map_was_made_do_not_move_the_pose(change: Change) -> None:
    found = run(street_lidar.queries(0.5, 2.0, 1, change), MatchOptions())
    assert found.centimetres(95) < 5.0


def test_the_document_s_icp_is_drawn_along_with_the_whole_cloud_and_less_by_the_best_layer() -> None:
    asked = street_lidar.queries(0.5, 2.0, 1, "shifted_together")[::3]
    whole = run(asked, MatchOptions(method="point_to_point", choice="whole"))
    best = run(asked, MatchOptions(method="point_to_point", choice="best"))
    assert best.centimetres(95) < 5.0 < whole.centimetres(95)


def test_the_coarse_search_finds_the_street_from_four_metres_and_twelve_degrees_off() -> None:
    for query in street_lidar.queries(4.0, 12.0, 1)[::4]:
        targets = street_lidar.targets(MatchOptions().bounds_m)
        found = search(query.points_m, query.heights_m, targets, query.guess)
        assert found.unique
        assert found.match.status == "converged"
        assert np.hypot(*query.error(found.match.map_from_local)[:2]) < 0.05

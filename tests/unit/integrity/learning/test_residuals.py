"""Stretches of road: the fixes on one surface and twenty metres are one observation, by their medians."""

import math
from dataclasses import replace

import pytest

from camber.integrity.learning.residuals import MOST_FIXES, CellCollector, cell_of
from support.residual_drives import KEY, residual


def cells(residuals, length_m=20.0):
    collector = CellCollector(length_m)
    return [cell for one in residuals if (cell := collector.add(one)) is not None]


def test_a_stretch_ends_after_its_length_or_with_its_surface_map_antenna_or_base():
    ended = cells(residual(epoch) for epoch in range(111))
    # 50 m of a surface are two stretches of 20 m and one of 10 m.
    assert [cell.fixes for cell in ended] == [20, 20, 10] * 2
    assert [cell.surface_id for cell in ended] == [0, 0, 0, 1, 1, 1]
    keys = [KEY, replace(KEY, map_version=4)]
    assert [cell.key for cell in cells(residual(k, key=keys[k // 5]) for k in range(10))] == [keys[0]]


def test_a_wrong_fix_or_two_do_not_move_it():
    result = cell_of([residual(k, up_m=5.0 if k < 2 else 0.01 * k, east_m=0.1 * k) for k in range(9)])
    assert result.up_m == pytest.approx(0.06)
    assert result.horizontal_m == (pytest.approx(0.4), 0.0, 0.1)
    assert (result.fix_sigma_m, result.map_sigma_m) == (0.05, 0.05)
    assert (result.begin_ns, result.end_ns) == (residual(0).time_ns, residual(8).time_ns)


def test_it_knows_its_link_and_the_newest_fix_that_one_of_its_poses_leans_on():
    assert cell_of([residual(0), residual(1)]).anchored_ns is None
    result = cell_of([residual(k, anchored_ns=at) for k, at in enumerate([3, None, 7, 5])])
    assert (result.link_id, result.anchored_ns) == (0, 7)


def test_how_many_were_verified_against_the_height_is_known():
    verdicts = ["confirmed", "confirmed_after_verification", "erroneous", "confirmed_after_verification"]
    assert cell_of([residual(k, verdict=verdict) for k, verdict in enumerate(verdicts)]).verified == 2


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_what_is_not_known_is_not_counted(value):
    result = cell_of([residual(0, up_m=value, east_m=value), residual(1, up_m=0.2, horizontal_sigma_m=0.0)])
    assert (result.up_m, result.horizontal_m) == (0.2, None)
    nothing = cell_of([residual(0, up_m=value, north_m=value)])
    assert (nothing.up_m, nothing.horizontal_m, nothing.fix_sigma_m, nothing.map_sigma_m) == (
        None,
        None,
        0.0,
        0.0,
    )
    assert cell_of([residual(0, horizontal_sigma_m=None)]).horizontal_m is None


def test_standing_still_neither_ends_a_stretch_nor_makes_it_heavier():
    collector = CellCollector(20.0)
    assert all(collector.add(residual(0)) is None for _ in range(2 * MOST_FIXES))
    ended = collector.add(residual(20))
    assert ended.fixes == MOST_FIXES


def test_what_is_no_place_is_left_out():
    assert (
        cells([residual(0, longitude_rad=math.nan), residual(1), residual(60, latitude_rad=math.inf)]) == []
    )


def test_confirmed_is_what_a_consumer_may_use():
    verdicts = ["confirmed", "confirmed_after_verification", "erroneous", "unknown"]
    assert [residual(verdict=verdict).confirmed for verdict in verdicts] == [True, True, False, False]

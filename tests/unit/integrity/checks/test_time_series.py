"""A fix that has moved as the vehicle and risen as the road since the last right one continues it."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.checks.time_series import ChainedFix, SeriesRules, continues_chain, next_in_chain

RULES = SeriesRules(longest_gap_s=1.0, longest_chain=3, horizontal_m=0.15, vertical_m=0.12)
LAST = ChainedFix(
    time_ns=10**18, latitude_rad=0.6, longitude_rad=2.4, height_m=41.8, slope_east=0.05, slope_north=0.0
)


def says(last=LAST, *, after_s=0.2, east_m=2.0, north_m=0.0, drift_m=0.0, up_m=0.1):
    return continues_chain(
        last,
        RULES,
        time_ns=LAST.time_ns + round(after_s * 1e9),
        moved_east_m=east_m,
        moved_north_m=north_m,
        drift_m=drift_m,
        height_m=LAST.height_m + up_m,
    )


def test_a_fix_that_moved_with_vehicle_and_road_continues():
    assert says()
    assert says(after_s=1.0), "a second is not too long"


@pytest.mark.parametrize(
    "changes",
    [
        {"last": None},
        {"after_s": 1.01},
        {"after_s": 0.0},
        {"after_s": -0.2},
        {"drift_m": 0.16},
        {"up_m": 0.23},
        {"up_m": -0.03},
        {"up_m": math.nan},
        {"east_m": math.nan},
        {"drift_m": math.nan},
        {"drift_m": math.inf},
    ],
    ids=str,
)
def test_any_other_does_not(changes):
    assert not says(**changes)


def test_a_road_that_climbs_explains_the_rise():
    assert says(up_m=0.1)
    flat = replace(LAST, slope_east=0.0)
    assert not says(flat, up_m=0.13)
    assert says(flat, up_m=0.11)
    to_the_north = replace(flat, slope_north=0.1)
    assert says(to_the_north, east_m=0.0, north_m=2.0, up_m=0.2)
    assert not says(to_the_north, east_m=0.0, north_m=2.0, up_m=0.0)


@given(jump_m=st.floats(0.0, 10.0), more_m=st.floats(0.0, 10.0))
def test_a_larger_jump_never_continues_where_a_smaller_does_not(jump_m, more_m):
    assert says(up_m=0.1 + jump_m) or not says(up_m=0.1 + jump_m + more_m)
    assert says(drift_m=jump_m) or not says(drift_m=jump_m + more_m)


def test_a_chain_of_verified_fixes_ends():
    link = LAST
    for length in (1, 2, 3):
        assert says(link)
        link = next_in_chain(LAST, link, verified=True)
        assert link.chain_length == length
    assert not says(link)


def test_a_confirmed_fix_begins_a_new_chain():
    long = next_in_chain(LAST, next_in_chain(LAST, None, verified=True), verified=True)
    assert long.chain_length == 2
    assert next_in_chain(LAST, long, verified=False).chain_length == 0

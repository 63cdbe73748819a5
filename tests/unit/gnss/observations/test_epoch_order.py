"""Late epochs, repeated epochs, and a clock that was set back."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.gnss.observations.epoch_order import EpochOrder

S = 1_000_000_000


def orders(*times_s: float) -> list[str]:
    order = EpochOrder()
    return [order.admit(round(t * S)) for t in times_s]


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        ((0, 1, 2), "next next next"),
        ((0, 1, 1, 2), "next next late next"),
        ((0, 2, 1, 3), "next next late next"),
        ((100, 101, 1, 2, 3, 4), "next next late late restarted next"),
        ((604_800, 1, 2, 3, 4), "next late late restarted next"),  # a time tag of next week
        ((5, 6, 3, 2, 1), "next next late late late"),  # backwards throughout
        ((5, 6, 1, 7, 2, 8, 3, 9), "next next late next late next late next"),
        ((5, 6, 1, 1, 1, 1), "next next late late late late"),
    ],
)
def test_missing_ephemerides_at_a_time(times_s, expected):
    assert " ".join(orders(*times_s)) == expected


@given(st.lists(st.integers(0, 50), max_size=60))
@settings(derandomize=True, max_examples=200)
def test_admitted_times_go_on_from_each_other_but_where_they_begin_anew(times):
    order, last = EpochOrder(), -1
    for t in times:
        expected = order.admit(t)
        if expected == "next":
            assert t > last
        else:
            assert t <= last
        if expected != "late":
            last = t

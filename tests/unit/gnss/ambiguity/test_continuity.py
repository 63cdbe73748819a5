"""Integers of one fix against those of the next, whatever their references."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.gnss.ambiguity.continuity import FIXED_INTEGER, ContinuityTracker, FixedIntegers, compare
from camber.gnss.observations.signal_pairs import GROUPS

L1, L2 = 4, 8


def fix(*rows: tuple[int, int, int, int], base_arc: int = 1) -> FixedIntegers:
    """Rows of satellite, group, integer and the rover's arc."""
    return np.array([(*row, base_arc) for row in rows], FIXED_INTEGER)


FIVE = [(s, L1, 100 * s, s) for s in range(1, 6)]


def against(fixed: FixedIntegers, reference: int) -> FixedIntegers:
    """The same with another satellite as the reference of each group."""
    moved = fixed.copy()
    for g in np.unique(fixed["group"]):
        of_group = fixed["group"] == g
        at = np.flatnonzero(of_group & (fixed["satellite"] == reference))
        moved["integer"][of_group] -= fixed["integer"][at[0]]
    return moved


@pytest.mark.parametrize("before", range(1, 6))
@pytest.mark.parametrize("after", range(1, 6))
def test_a_change_of_the_reference_is_no_change(before, after):
    assert compare(against(fix(*FIVE), before), against(fix(*FIVE), after), 3) == "continuous"


def test_one_integer_that_differs_on_unbroken_arcs_is_a_break():
    other = [*FIVE[:2], (3, L1, 301, 3), *FIVE[3:]]
    assert compare(fix(*FIVE), fix(*other), 3) == "broken"
    assert compare(against(fix(*FIVE), 3), against(fix(*other), 1), 3) == "broken"


def test_one_integer_that_differs_on_a_new_arc_is_none():
    other = [*FIVE[:2], (3, L1, 777, 33), *FIVE[3:]]
    assert compare(fix(*FIVE), fix(*other), 3) == "continuous"
    assert compare(fix(*FIVE), fix(*other), 4) == "no_evidence"


def test_new_arcs_of_the_base_are_new_arcs():
    assert compare(fix(*FIVE), fix(*FIVE, base_arc=2), 3) == "no_evidence"


def test_rows_without_an_arc_prove_nothing():
    without = [(s, g, n, 0) for s, g, n, _ in FIVE]
    assert compare(fix(*without), fix(*without), 1) == "no_evidence"


def test_groups_are_compared_by_themselves():
    """All integers of a band may move together: its reference changed."""
    both = FIVE + [(s, L2, 10 * s, 20 + s) for s in range(1, 4)]
    moved = FIVE + [(s, L2, 10 * s + 7, 20 + s) for s in range(1, 4)]
    assert compare(fix(*both), fix(*moved), 6) == "continuous"
    assert compare(fix(*both), fix(*moved), 7) == "no_evidence"


def test_satellites_that_rise_and_set_count_for_nothing():
    later = [*FIVE[1:], (9, L1, 5, 9)]
    assert compare(fix(*FIVE), fix(*later), 3) == "continuous"
    assert compare(fix(*FIVE), fix(*later), 4) == "no_evidence"
    assert compare(fix(*FIVE), fix((8, L1, 1, 8), (9, L1, 5, 9)), 1) == "no_evidence"


def test_a_chain_begins_with_its_first_fix_and_anew_after_a_break():
    tracker = ContinuityTracker()
    assert tracker.update(10, fix(*FIVE)) == ("no_evidence", 10)
    assert tracker.update(20, fix(*FIVE)) == ("continuous", 10)
    assert tracker.update(50, against(fix(*FIVE), 2)) == ("continuous", 10)
    wrong = fix(*[(s, g, n + (s == 2), arc) for s, g, n, arc in FIVE])
    assert tracker.update(60, wrong) == ("broken", 60)
    assert tracker.update(70, wrong) == ("continuous", 60)
    tracker.reset()
    assert tracker.update(80, wrong) == ("no_evidence", 80)


@given(
    st.lists(
        st.tuples(st.integers(1, 9), st.integers(0, GROUPS - 1), st.integers(-5, 5), st.integers(0, 3)),
        max_size=20,
    )
)
@settings(derandomize=True, max_examples=200)
def test_a_fix_never_breaks_with_itself_and_a_group_moved_as_one_is_the_same(rows):
    rows = list({(s, g): (s, g, n, arc) for s, g, n, arc in rows}.values())
    one = fix(*rows)
    moved = one.copy()
    moved["integer"] += 3 * one["group"]
    assert compare(one, one, 3) != "broken"
    assert compare(one, moved, 3) == compare(one, one, 3)

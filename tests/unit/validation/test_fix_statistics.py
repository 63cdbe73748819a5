"""Wrong, right, kept, episodes: by hand, and as properties."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.validation.fix_statistics import CandidateFixes, FixDecisions, decision_statistics, episodes_of

UNKNOWN = math.nan
Fix = tuple[float, float, bool]
"""Time [s], error [m], whether it was confirmed."""


def judge(fixes: list[Fix]) -> tuple[CandidateFixes, FixDecisions]:
    """Confirmed fixes keep their position; the others are erroneous."""
    fixes = sorted(fixes, key=lambda fix: fix[0])
    time_ns = np.array([round(t * 1e9) for t, _, _ in fixes], dtype=np.int64)
    error_m = np.array([error for _, error, _ in fixes], dtype=np.float64)
    confirmed = np.array([c for _, _, c in fixes], dtype=bool)
    return CandidateFixes(time_ns, error_m), decisions(confirmed, time_ns[confirmed], error_m[confirmed])


def decisions(confirmed: np.ndarray, time_ns: np.ndarray, error_m: np.ndarray) -> FixDecisions:
    return FixDecisions(
        confirmed=confirmed,
        erroneous=~confirmed,
        unknown=np.zeros(len(confirmed), bool),
        unknown_count=0,
        confirmed_time_ns=time_ns,
        confirmed_error_m=error_m,
    )


def spans(fixes: list[Fix], gap_s: float = 1.0) -> list[tuple[float, float, bool]]:
    return [(e.start_ns / 1e9, e.end_ns / 1e9, e.missed) for e in episodes_of(*judge(fixes), gap_s)]


def test_wrong_is_more_than_half_a_metre_and_right_up_to_a_fifth() -> None:
    fixes = [(0.0, 0.2, True), (1.0, 0.2001, True), (2.0, 0.5, True), (3.0, 0.5001, True)]
    f = decision_statistics(*judge(fixes), truth=True)
    assert f["confirmed"] == {"count": 4, "wrong": 1, "truth_unknown": 0}
    assert f["right"] == {"count": 1, "kept": 1.0, "erroneous": 0}


def test_a_small_drive_by_hand() -> None:
    # right fixes at 0, 0.2, 0.4, 5 (three of four confirmed); wrong at 1.0, 1.2 (one episode, caught),
    # at 3.0, 3.2, 3.8 (one episode, missed at 3.2), at 20 (one of its own, caught).
    fixes = [
        (0.0, 0.01, True), (0.2, 0.10, True), (0.4, 0.20, False), (5.0, 0.05, True),
        (1.0, 3.00, False), (1.2, 9.00, False),
        (3.0, 0.70, False), (3.2, 0.60, True), (3.8, 4.00, False),
        (20.0, 50.0, False),
    ]  # fmt: skip
    assert spans(fixes) == [(1.0, 1.2, False), (3.0, 3.8, True), (20.0, 20.0, False)]
    f = decision_statistics(*judge(fixes), truth=True)
    assert f["confirmed"] == {"count": 4, "wrong": 1, "truth_unknown": 0}
    assert f["right"] == {"count": 4, "kept": 0.75, "erroneous": 1}
    assert f["erroneous"] == {"count": 6}
    # With gaps of 10 s: 1.0 to 3.8 are one; the right fix at 5.0 and 15 s separate 20 from them.
    assert f["episodes"] == {
        "wrong": 3, "missed": 1, "n": 3, "bound": None, "longest_s": 0.8,
        "cautious": {"gap_s": 10.0, "wrong": 2, "missed": 1, "n": 2, "bound": None},
    }  # fmt: skip


def test_a_right_fix_between_two_wrong_ones_separates_episodes_and_one_that_is_neither_does_not() -> None:
    assert len(spans([(0.0, 2.0, False), (0.2, 0.1, False), (0.4, 2.0, False)])) == 2
    assert len(spans([(0.0, 2.0, False), (0.2, 0.3, False), (0.4, 2.0, False)])) == 1


def test_only_more_than_the_gap_separates_episodes() -> None:
    assert len(spans([(0.0, 2.0, False), (1.0, 2.0, False)])) == 1
    assert len(spans([(0.0, 2.0, False), (1.2, 2.0, False)])) == 2
    assert len(spans([(0.0, 2.0, False), (1.2, 2.0, False)], gap_s=10.0)) == 1


@pytest.mark.parametrize(
    ("fix_error_m", "confirmed_error_m", "wrong", "missed"), [(0.05, 3.0, 1, 1), (4.0, 0.04, 0, 0)]
)
def test_a_re_estimated_position_counts_by_its_error_and_not_the_fix_s(
    fix_error_m: float, confirmed_error_m: float, wrong: int, missed: int
) -> None:
    time_ns = np.array([5], np.int64)
    confirmed = decisions(np.array([True]), time_ns, np.array([confirmed_error_m]))
    f = decision_statistics(CandidateFixes(time_ns, np.array([fix_error_m])), confirmed, truth=True)
    assert (f["confirmed"]["wrong"], f["episodes"]["wrong"], f["episodes"]["missed"]) == (wrong, 1, missed)


def test_none_missed_of_n_bounds_the_rate_by_three_over_n() -> None:
    def bound(n: int) -> float | None:
        fixes = [(100.0 * i, 2.0, False) for i in range(n)]
        value: float | None = decision_statistics(*judge(fixes), truth=True)["episodes"]["bound"]
        return value

    assert bound(0) is None
    assert bound(2) == 1.0
    assert bound(30) == 0.1


def test_a_truth_that_covers_no_fix_is_no_truth() -> None:
    f = decision_statistics(*judge([(0.0, UNKNOWN, True)]), truth=True)
    assert f["confirmed"]["wrong"] is None
    assert f["right"]["kept"] is None
    assert f["episodes"]["missed"] is None


def test_fixes_without_truth_are_neither_right_nor_wrong() -> None:
    f = decision_statistics(*judge([(0.0, UNKNOWN, True), (1.0, 0.1, True), (9.0, 4.0, False)]), truth=True)
    assert f["confirmed"] == {"count": 2, "wrong": 0, "truth_unknown": 1}
    assert (f["right"]["count"], f["episodes"]["wrong"]) == (1, 1)


times = st.integers(0, 200).map(lambda tenths: tenths / 10)
errors = st.sampled_from([0.05, 0.2, 0.35, 0.6, 5.0, UNKNOWN])
drives = st.lists(st.tuples(times, errors, st.booleans()), max_size=40, unique_by=lambda fix: fix[0])


@given(drives, times)
def test_one_more_confirmed_wrong_fix_never_improves_the_statistics(drive: list[Fix], at: float) -> None:
    drive = [fix for fix in drive if fix[0] != at]
    before = decision_statistics(*judge(drive), truth=True)
    after = decision_statistics(*judge([*drive, (at, 2.0, True)]), truth=True)
    assert after["confirmed"]["wrong"] == (before["confirmed"]["wrong"] or 0) + 1
    assert after["episodes"]["missed"] >= 1
    assert after["episodes"]["bound"] is None
    # It may join two episodes into one. Nothing else lowers the number of those missed.
    joined = (before["episodes"]["wrong"] or 0) + 1 - after["episodes"]["wrong"]
    assert 0 <= joined <= 2
    assert after["episodes"]["missed"] >= (before["episodes"]["missed"] or 0) - max(0, joined - 1)


@given(drives, times)
def test_confirming_a_wrong_fix_never_lowers_the_episodes_missed(drive: list[Fix], at: float) -> None:
    drive = [fix for fix in drive if fix[0] != at]
    caught = decision_statistics(*judge([*drive, (at, 2.0, False)]), truth=True)["episodes"]
    missed = decision_statistics(*judge([*drive, (at, 2.0, True)]), truth=True)["episodes"]
    assert missed["wrong"] == caught["wrong"]
    assert missed["missed"] >= max(1, caught["missed"])


@given(drives)
def test_every_wrong_fix_is_in_exactly_one_episode(drive: list[Fix]) -> None:
    fixes, decided = judge(drive)
    rows = [row for episode in episodes_of(fixes, decided) for row in episode.fixes]
    assert sorted(rows) == np.flatnonzero(fixes.wrong).tolist()

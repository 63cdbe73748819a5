"""Slots: a bounded number of votes for each surface and period, that neither recency nor volume nor a name can fill."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camber.map_update.fusion.vote_slots import SlotLimits, thin_votes
from camber.map_update.fusion.votes import VOTE, Votes, merge_votes

SECRET = b"sixteen bytes at least"
SLOTS = SlotLimits(period_days=7, periods=4, voters=20, sessions=2)
TODAY = 7 * 1000 + 6


def cast(voters: np.ndarray, sessions: np.ndarray, surface: int = 1) -> Votes:
    result = np.zeros(len(voters), VOTE)
    result["surface_id"], result["voter"], result["session"] = surface, voters, sessions
    for k in range(5):
        result[f"rank_{k}"] = 2**31 - 1
    result["rank_0"] = 1
    return merge_votes(result)


def crowd(seed: int, n: int, days: range = range(TODAY - 20, TODAY + 1)) -> Votes:
    rng = np.random.default_rng(seed)
    names = rng.integers(0, 2**62, n)
    return cast(np.repeat(names, 3), rng.integers(days.start, days.stop, 3 * n))


def keep(votes: Votes, secret: bytes = SECRET, slots: SlotLimits = SLOTS) -> Votes:
    return thin_votes(votes, secret, slots, newest_session=TODAY)


@pytest.mark.parametrize("seed", range(5))
def test_thinning_as_votes_arrive_keeps_the_same_votes_as_at_the_end(seed: int) -> None:
    parts = [crowd(10 * seed + k, 40) for k in range(5)]
    at_the_end = keep(merge_votes(*parts))
    as_they_come = keep(parts[3])
    for k in (0, 4, 1, 3, 2):
        as_they_come = keep(merge_votes(as_they_come, parts[k]))
    assert as_they_come.tobytes() == at_the_end.tobytes()


def test_slots_of_each_period_are_bounded() -> None:
    result = keep(merge_votes(*(crowd(k, 200) for k in range(3))))
    period = result["session"] // 7
    for one in np.unique(period):
        names, each = np.unique(result["voter"][period == one], return_counts=True)
        assert len(names) == 20
        assert each.max() <= 2
    assert len(np.unique(period)) == 3


def test_old_periods_are_dropped_and_so_is_the_future() -> None:
    result = keep(cast(np.array([1, 1, 1, 1]), np.array([TODAY - 28, TODAY - 27, TODAY, TODAY + 1])))
    assert result["session"].tolist() == [TODAY - 27, TODAY]


def test_daily_vehicles_get_no_larger_share_of_slots() -> None:
    """A tenth of the vehicles, with seven votes each, get a tenth of the slots: expected 200 of 2,000, σ 13."""
    share = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        names = rng.integers(0, 2**62, 200)
        once = cast(names[20:], rng.integers(TODAY - 6, TODAY + 1, 180))
        daily = cast(np.repeat(names[:20], 7), np.tile(np.arange(TODAY - 6, TODAY + 1), 20))
        share += len(np.intersect1d(keep(merge_votes(once, daily))["voter"], names[:20]))
    assert 150 <= share <= 250


def test_later_votes_do_not_displace_earlier_ones() -> None:
    early = crowd(1, 40, range(TODAY - 6, TODAY - 3))
    late = crowd(2, 40, range(TODAY - 1, TODAY + 1))
    names = keep(merge_votes(early, late))["voter"]
    assert 4 <= len(np.intersect1d(names, early["voter"])) <= 16


def test_the_voters_kept_depend_on_the_secret_and_on_the_street() -> None:
    votes = crowd(3, 100, range(TODAY - 6, TODAY + 1))
    elsewhere = votes.copy()
    elsewhere["surface_id"] = 2
    names = [
        set(keep(one, secret)["voter"].tolist())
        for one, secret in ((votes, SECRET), (votes, b"another secret of bytes"), (elsewhere, SECRET))
    ]
    for k in range(3):
        assert len(names[k] & names[k - 1]) <= 12


def test_with_enough_slots_all_votes_are_kept() -> None:
    votes = crowd(4, 15)
    assert keep(votes, slots=replace(SLOTS, sessions=7)).tobytes() == votes.tobytes()
    assert len(keep(np.zeros(0, VOTE))) == 0

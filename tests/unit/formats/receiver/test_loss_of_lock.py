"""Loss of lock derived from lock times."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.receiver.loss_of_lock import LossOfLockDetector

SECOND_NS = 1_000_000_000


def run(*epochs, most_more_s=0.001):
    """Which of (time s, lock s or None without a phase, state) have lost lock."""
    locks, lost = LossOfLockDetector(), []
    for time_s, lock_s, state in epochs:
        has = np.array([lock_s is not None])
        least = np.array([lock_s or 0.0])
        detected = locks.detect(
            round(time_s * SECOND_NS),
            np.array([7]),
            has_phase=has,
            min_lock_s=least,
            max_lock_s=least + most_more_s,
            state=np.array([state]),
        )
        lost.append(bool(detected[0]))
    return lost


@pytest.mark.parametrize(
    ("epochs", "lost"),
    [
        ([(0, 5.0, 0), (1, 6.0, 0), (2, 7.0, 0)], [False, False, False]),
        ([(0, 5.0, 0), (1, 0.5, 0), (2, 1.5, 0)], [False, True, False]),
        # Longer than before, and yet not as long as the time since.
        ([(0, 0.1, 0), (1, 0.7, 0)], [False, True]),
        ([(0, 0.0, 0), (1, 1.0, 0)], [False, False]),
        # Away for longer than the lock: it may have been broken meanwhile, and locked anew.
        ([(0, 64.5, 0), (100, 64.5, 0)], [False, True]),
        ([(0, 64.5, 0), (60, 64.5, 0)], [False, False]),
        ([(0, 5.0, 0), (1, None, 0), (2, 7.0, 0)], [False, False, False]),
        ([(0, 5.0, 0), (1, None, 0), (2, 1.2, 0)], [False, False, True]),
        # Half a cycle is subtracted from now on.
        ([(0, 5.0, 0), (1, 6.0, 8), (2, 7.0, 8)], [False, True, False]),
        # Time stands still or goes back.
        ([(5, 5.0, 0), (5, 5.0, 0)], [False, True]),
        ([(5, 5.0, 0), (3, 9.0, 0)], [False, True]),
    ],
)
def test_loss_of_lock_since_the_last_phase(epochs, lost):
    assert run(*epochs) == lost


def test_lock_time_class_is_lost_only_when_certain():
    # Between 4 and 8 s: six seconds since the last phase may be in it.
    assert run((0, 4.0, 0), (6, 4.0, 0), most_more_s=4.0) == [False, False]
    assert run((0, 4.0, 0), (8, 4.0, 0), most_more_s=4.0) == [False, True]


@given(st.integers(0, 2**32))
@settings(derandomize=True, max_examples=50)
def test_signals_are_independent(seed):
    rng = np.random.default_rng(seed)
    locks, locked_at, last = LossOfLockDetector(), {}, {}
    for epoch in range(1, 30):
        keys = rng.choice(20, rng.integers(1, 20), replace=False)
        for key in range(20):
            if key not in locked_at or rng.random() < 0.1:
                locked_at[key] = epoch - float(rng.choice([0.0, 0.5, 0.9]))
        lock_s = np.array([epoch - locked_at[key] for key in keys.tolist()])
        has = rng.random(keys.size) < 0.9
        lost = locks.detect(
            epoch * SECOND_NS, keys, has_phase=has, min_lock_s=lock_s, max_lock_s=lock_s + 1e-3
        )
        for row, key in enumerate(keys.tolist()):
            expected = has[row] and key in last and locked_at[key] > last[key]
            assert lost[row] == expected
            if has[row]:
                last[key] = epoch

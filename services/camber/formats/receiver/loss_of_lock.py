"""Loss of lock of carrier phases, derived from the lock times that the receiver reports.

RTCM has classes of lock times (10403.3, DF402 and DF407), UBX ms (RXM-RAWX, `locktime`): in both cases the last loss of
lock was between `max_lock_s` and `min_lock_s` before the epoch.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import count

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.gps_time import NS_PER_SECOND


class LossOfLockDetector:
    """Keeps, for one receiver, the time and the lock time of each signal's last phase."""

    def __init__(self) -> None:
        self._slots: defaultdict[int, int] = defaultdict(count().__next__)  # numbered as they come
        self._keys, self._slots_of_keys = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._last_ns = np.zeros(0, np.int64)
        self._min_lock_s = np.zeros(0)
        self._state = np.zeros(0, np.int64)

    def detect(
        self,
        time_ns: int,
        keys: Integers,
        *,
        has_phase: NDArray[np.bool_],
        min_lock_s: Floats,
        max_lock_s: Floats,
        state: Integers | None = None,
    ) -> NDArray[np.bool_]:
        """Return which phases (n,) lost lock since the signal's last phase; never for a signal's first phase.

        Lock was lost where the lock time decreased, is certainly not longer than the time since, time did not advance,
        or `state`, a number that the receiver reports with each phase, has changed. Keys are unique; rows without a
        phase are ignored.
        """
        slot = self._slots_for(keys)
        current = np.zeros(keys.size, np.int64) if state is None else state
        last_ns = self._last_ns[slot]
        since_s = (time_ns - last_ns) / NS_PER_SECOND
        broken = (min_lock_s < self._min_lock_s[slot]) | (max_lock_s <= since_s) | (since_s <= 0.0)
        broken |= current != self._state[slot]
        lost: NDArray[np.bool_] = has_phase & (last_ns >= 0) & broken
        updated = slot[has_phase]
        self._last_ns[updated] = time_ns
        self._min_lock_s[updated] = min_lock_s[has_phase]
        self._state[updated] = current[has_phase]
        return lost

    def _slots_for(self, keys: Integers) -> Integers:
        """Return the slot of each signal; usually the signals are those of the last epoch."""
        if np.array_equal(keys, self._keys):
            return self._slots_of_keys
        self._keys = keys
        self._slots_of_keys = np.array([*map(self._slots.__getitem__, keys.tolist())], np.int64)
        more = len(self._slots) - self._last_ns.size
        if more:
            self._last_ns = np.append(self._last_ns, np.full(more, -1))
            self._min_lock_s = np.append(self._min_lock_s, np.zeros(more))
            self._state = np.append(self._state, np.zeros(more, np.int64))
        return self._slots_of_keys

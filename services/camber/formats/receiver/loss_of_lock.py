"""Whether a phase is continuous with the signal's last one, by what its receiver says of its lock times.

RTCM tells a lock time in classes (10403.3, DF402 and DF407), UBX in ms (RXM-RAWX, `locktime`): either way the phase was
last broken between `most` and `least` seconds before the epoch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers
from camber.geodesy.gps_time import NS_PER_SECOND


class LossOfLockDetector:
    """One receiver's memory: when each signal last had a phase, and how long it was locked then."""

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}
        self._keys, self._slots_of_keys = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._last_ns = np.zeros(0, np.int64)
        self._least_s = np.zeros(0)
        self._state = np.zeros(0, np.int64)

    def lost(
        self,
        time_ns: int,
        keys: Integers,
        has_phase: NDArray[np.bool_],
        least_s: Floats,
        most_s: Floats,
        state: Integers | None = None,
    ) -> NDArray[np.bool_]:
        """Which phases (n,) are broken since the signal's last one; a signal's first phase is not.

        Broken: the lock is shorter than it was, or certainly not longer than the time since, or time did not go on, or
        `state`, a number the receiver keeps with each phase, has changed. Keys are unique; rows without a phase are
        passed over.
        """
        slot = self._places(keys)
        now = np.zeros(keys.size, np.int64) if state is None else state
        last_ns = self._last_ns[slot]
        since_s = (time_ns - last_ns) / NS_PER_SECOND
        broken = (least_s < self._least_s[slot]) | (most_s <= since_s) | (since_s <= 0.0)
        broken |= now != self._state[slot]
        lost: NDArray[np.bool_] = has_phase & (last_ns >= 0) & broken
        written = slot[has_phase]
        self._last_ns[written] = time_ns
        self._least_s[written] = least_s[has_phase]
        self._state[written] = now[has_phase]
        return lost

    def _places(self, keys: Integers) -> Integers:
        """Where each signal is remembered; mostly the same signals come as in the epoch before."""
        if np.array_equal(keys, self._keys):
            return self._slots_of_keys
        slots = self._slots
        self._keys = keys
        self._slots_of_keys = np.array([slots.setdefault(key, len(slots)) for key in keys.tolist()], np.int64)
        more = len(slots) - self._last_ns.size
        if more:
            self._last_ns = np.append(self._last_ns, np.full(more, -1))
            self._least_s = np.append(self._least_s, np.zeros(more))
            self._state = np.append(self._state, np.zeros(more, np.int64))
        return self._slots_of_keys

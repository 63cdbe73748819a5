"""Arcs of carrier phase: where each signal's phase is one unbroken count, and why it is not where it is not.

One tracker a receiver. A phase is broken by the receiver's own flag, by a lock time that went back, by a change of the
half-cycle state, by a jump of the difference between two bands of one satellite (which holds neither geometry nor
clocks), by phases that do not go with their Doppler, by a gap. Another code of the same band is another signal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers, ObservationEpoch
from camber.gnss.observations.signal_pairs import WAVELENGTH_M, band_of, group_of
from camber.gnss.observations.single_differences import Booleans

REASONS = (
    "continuous", "new", "gap", "receiver_flag", "lock_time", "half_cycle", "geometry_free", "doppler",
)  # fmt: skip
"""By number: what began an arc, in the order in which it is looked for."""
_CONTINUOUS, _NEW, _GAP, _FLAG, _LOCK, _HALF, _FREE, _DOPPLER = range(8)

_SLOTS = 4 * 64 * 10 * 32
_PLACE = np.zeros(128, np.int64)
_PLACE[[ord(letter) for letter in "GJEC"]] = np.arange(4)
_GEOMETRY_FREE_LIMIT_M = 0.05
_LONGEST_FREE_S = 10.0  # beyond, the ionosphere may move the difference as far
# Between two epochs the mean of the Dopplers is the phase's rate but for a change of acceleration.
_DOPPLER_LIMIT_M, _DOPPLER_LIMIT_M_S2 = 0.08, 0.5
_LOCK_ROUNDING_S = 0.002
"""Formats tell the lock time in steps, of half its value at worst: what is longer than twice as told is broken."""


class _State(NamedTuple):
    """By slot: what is known of the signal's phase at its last epoch."""

    time_ns: Integers
    arc: Integers
    phase_cycles: Floats
    doppler_hz: Floats
    lock_s: Floats
    half_cycle: Booleans


class ArcTracker:
    """Gives each phase of one receiver the number of its arc; numbers are never used twice."""

    def __init__(self, *, longest_gap_s: float = 2.1) -> None:
        self._gap_ns = round(longest_gap_s * 1e9)
        self._state = _State(
            np.full(_SLOTS, np.iinfo(np.int64).min, np.int64),
            np.zeros(_SLOTS, np.int64),
            np.full(_SLOTS, np.nan),
            np.full(_SLOTS, np.nan),
            np.full(_SLOTS, np.nan),
            np.zeros(_SLOTS, np.bool_),
        )
        self._last = np.zeros(1, np.int64)
        self.begun = np.zeros(len(REASONS), np.int64)
        """How many arcs each of `REASONS` began."""

    def update(self, epoch: ObservationEpoch) -> Integers:
        """The arc of each row (n,), 0 for rows without a phase. Epochs come in the order of their time."""
        return _update(
            self._state,
            self._last,
            self.begun,
            self._gap_ns,
            epoch.time_ns,
            epoch.satellite,
            epoch.signal,
            epoch.carrier_phase_cycles,
            epoch.doppler_hz,
            epoch.lock_time_s,
            epoch.loss_of_lock,
            epoch.half_cycle,
        )


@compiled
def _slot(satellite: int, signal: int) -> int:
    """A signal's place in the tables; −1 for what is not tracked."""
    group = group_of(satellite, signal)
    number = satellite & 255
    if group < 0 or number > 63:
        return -1
    system = _PLACE[satellite >> 8]
    return int(((system * 64 + number) * 10 + band_of(group)) * 32 + (signal & 31))


@compiled
def _may_go_on(slots: Integers, reason: Integers, row: int) -> bool:
    """Nothing but the difference between bands has said that this phase began anew."""
    return bool(slots[row] >= 0 and (reason[row] == _CONTINUOUS or reason[row] == _FREE))


@compiled
def _update(
    state: _State,
    last: Integers,
    begun: Integers,
    gap_ns: int,
    time_ns: int,
    satellite: Integers,
    signal: Integers,
    phase_cycles: Floats,
    doppler_hz: Floats,
    lock_s: Floats,
    flagged: Booleans,
    half_cycle: Booleans,
) -> Integers:
    n = satellite.size
    slots, reason, metres = np.empty(n, np.int64), np.zeros(n, np.int64), np.full(n, np.nan)
    mismatch, mismatches = np.full(n, np.nan), np.empty(n)
    count = 0
    for i in range(n):
        slot = _slot(satellite[i], signal[i])
        if not abs(phase_cycles[i]) < np.inf:
            slot = -1
        slots[i] = slot
        if slot < 0:
            continue
        wavelength = WAVELENGTH_M[group_of(satellite[i], signal[i])]
        metres[i] = phase_cycles[i] * wavelength
        if state.arc[slot] == 0:
            reason[i] = _NEW
            continue
        since_ns = time_ns - state.time_ns[slot]
        since_s = since_ns * 1e-9
        if since_ns <= 0 or since_ns > gap_ns:
            reason[i] = _GAP
            continue
        if flagged[i]:
            reason[i] = _FLAG
        elif lock_s[i] < state.lock_s[slot] - _LOCK_ROUNDING_S or lock_s[i] < 0.5 * since_s:
            reason[i] = _LOCK
        elif half_cycle[i] != state.half_cycle[slot]:
            reason[i] = _HALF
        moved = -0.5 * (doppler_hz[i] + state.doppler_hz[slot]) * since_s
        mismatch[i] = (phase_cycles[i] - state.phase_cycles[slot] - moved) * wavelength
        if mismatch[i] == mismatch[i]:
            mismatches[count] = mismatch[i]
            count += 1
    # A step of the receiver's clock moves all phases alike and breaks none.
    common = np.median(mismatches[:count]) if count >= 3 else 0.0
    for i in range(n):
        if slots[i] < 0 or reason[i] != _CONTINUOUS:
            continue
        since_s = (time_ns - state.time_ns[slots[i]]) * 1e-9
        if abs(mismatch[i] - common) > _DOPPLER_LIMIT_M + _DOPPLER_LIMIT_M_S2 * since_s * since_s:
            reason[i] = _DOPPLER
    for i in range(n):
        for j in range(i):
            if satellite[j] != satellite[i] or not (
                _may_go_on(slots, reason, i) and _may_go_on(slots, reason, j)
            ):
                continue
            before_ns = state.time_ns[slots[i]]
            if state.time_ns[slots[j]] != before_ns or (time_ns - before_ns) * 1e-9 > _LONGEST_FREE_S:
                continue
            moved = metres[i] - metres[j]
            moved -= state.phase_cycles[slots[i]] * WAVELENGTH_M[group_of(satellite[i], signal[i])]
            moved += state.phase_cycles[slots[j]] * WAVELENGTH_M[group_of(satellite[j], signal[j])]
            if abs(moved) > _GEOMETRY_FREE_LIMIT_M:
                # Which of the two jumped is not known, so both begin anew.
                reason[i] = reason[j] = _FREE
    arcs = np.zeros(n, np.int64)
    for i in range(n):
        slot = slots[i]
        if slot < 0:
            continue
        if reason[i] != _CONTINUOUS:
            last[0] += 1
            state.arc[slot] = last[0]
            begun[reason[i]] += 1
        arcs[i] = state.arc[slot]
        state.time_ns[slot] = time_ns
        state.phase_cycles[slot] = phase_cycles[i]
        state.doppler_hz[slot] = doppler_hz[i]
        state.lock_s[slot] = lock_s[i]
        state.half_cycle[slot] = half_cycle[i]
    return arcs

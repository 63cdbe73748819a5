"""Cycle-slip detection: arcs of continuous carrier phase of one receiver, and what ended each.

A slip is indicated by the receiver's flag of a lost lock, by a lock time that decreased, by a change of the half-cycle
state, by a jump of the geometry-free combination of two bands of one satellite (free of geometry and clocks), by a
mismatch of phase and Doppler. A gap ends an arc too. Another code of the same band is another signal. The channels
of GLONASS' satellites are not known here: the wavelengths of its two bands are as 7 to 9 in every channel, but Doppler
is not tested, as a step of the receiver's clock would be another one in each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers, ObservationEpoch
from camber.gnss.observations.signal_pairs import (
    WAVELENGTH_M,
    SignalColumns,
    band_of,
    columns_of,
    group_of,
    has_integers,
)

REASONS = (
    "continuous", "new", "gap", "receiver_flag", "lock_time", "half_cycle", "geometry_free", "doppler",
)  # fmt: skip
"""Reasons for a new arc by number, in the order of the tests."""
_CONTINUOUS, _NEW, _GAP, _FLAG, _LOCK, _HALF, _FREE, _DOPPLER = range(8)

_SLOTS = 5 * 64 * 10 * 32  # systems, satellites, bands, codes
_PLACE = np.zeros(128, np.int64)
_PLACE[[ord(letter) for letter in "GJECR"]] = np.arange(5)
# Chosen: a quarter of a wavelength; the ionosphere moves the combination by millimetres a second.
_GEOMETRY_FREE_THRESHOLD_M = 0.05
_LONGEST_FREE_S = 10.0  # chosen: at 5 mm/s the ionosphere would move it by the threshold in that time
# The mean of two Dopplers is the phase's rate but for a change of acceleration (2 m/s³ over a second, and noise).
_DOPPLER_THRESHOLD_M, _DOPPLER_THRESHOLD_M_S2 = 0.08, 0.5
_LOCK_ROUNDING_S = 0.002
"""Formats report the lock time in steps, of half its value at worst: below half the interval lock was lost."""


_PHASE_STATE = np.dtype(
    [
        ("time_ns", np.int64),
        ("arc", np.int64),
        ("phase_cycles", np.float64),
        ("doppler_hz", np.float64),
        ("lock_s", np.float64),
        ("half_cycle", np.bool_),
    ],
    align=True,
)
_PhaseStates = NDArray[np.void]
"""The last epoch of each signal, by slot, of `_PHASE_STATE`; its arc is 0 before the first one."""


class CycleSlipDetector:
    """Assigns each phase of one receiver the number of its arc; numbers are never used twice."""

    def __init__(self, *, longest_gap_s: float = 2.1) -> None:
        self._gap_ns = round(longest_gap_s * 1e9)
        self._states: _PhaseStates = np.zeros(_SLOTS, _PHASE_STATE)
        self.begun = np.zeros(len(REASONS), np.int64)
        """Number of new arcs by `REASONS`."""

    def update(self, epoch: ObservationEpoch) -> Integers:
        """The arc of each row (n,), 0 for rows without a phase. Epochs come in the order of their time."""
        return _update(self._states, columns_of(epoch), self.begun, self._gap_ns)


@compiled
def _slot(satellite: int, signal: int) -> int:
    """A signal's index in the tables; −1: not tracked."""
    group = group_of(satellite, signal)
    number = satellite & 255
    if group < 0 or number > 63:
        return -1
    system = _PLACE[satellite >> 8]
    return int(((system * 64 + number) * 10 + band_of(group)) * 32 + (signal & 31))


@compiled
def _is_continuous(slots: Integers, reason: Integers, row: int) -> bool:
    """No test but the geometry-free one has ended this row's arc."""
    return bool(slots[row] >= 0 and (reason[row] == _CONTINUOUS or reason[row] == _FREE))


@compiled
def _update(states: _PhaseStates, phases: SignalColumns, begun: Integers, gap_ns: int) -> Integers:
    """Test all phases for cycle slips; the arc of each row (n,)."""
    n, time_ns = phases.satellite.size, phases.time_ns
    slots, wavelength_m = np.full(n, -1, np.int64), np.full(n, np.nan)
    for i in range(n):
        if abs(phases.carrier_phase_cycles[i]) < np.inf:
            slots[i] = _slot(phases.satellite[i], phases.signal[i])
        if slots[i] >= 0:
            wavelength_m[i] = WAVELENGTH_M[group_of(phases.satellite[i], phases.signal[i])]
    reason = np.zeros(n, np.int64)
    mismatch = _test_signals(states, phases, slots, reason, gap_ns=gap_ns, wavelength_m=wavelength_m)
    _test_doppler(states, slots, reason, mismatch_m=mismatch, time_ns=time_ns)
    _test_geometry_free(states, phases, slots, reason, wavelength_m=wavelength_m)
    arcs = np.zeros(n, np.int64)
    for i in range(n):
        slot = slots[i]
        if slot < 0:
            continue
        if reason[i] != _CONTINUOUS:
            begun[reason[i]] += 1
            states["arc"][slot] = begun.sum()
        arcs[i] = states["arc"][slot]
        states["time_ns"][slot] = time_ns
        states["phase_cycles"][slot] = phases.carrier_phase_cycles[i]
        states["doppler_hz"][slot] = phases.doppler_hz[i]
        states["lock_s"][slot] = phases.lock_time_s[i]
        states["half_cycle"][slot] = phases.half_cycle[i]
    return arcs


@compiled
def _test_signals(
    states: _PhaseStates,
    phases: SignalColumns,
    slots: Integers,
    reason: Integers,
    gap_ns: int,
    wavelength_m: Floats,
) -> Floats:
    """New signals, gaps, flags, lock times and half cycles into `reason`; phase minus Doppler prediction [m] (n,)."""
    mismatch_m = np.full(slots.size, np.nan)
    for i in range(slots.size):
        slot = slots[i]
        if slot < 0:
            continue
        if states["arc"][slot] == 0:
            reason[i] = _NEW
            continue
        since_ns = phases.time_ns - states["time_ns"][slot]
        since_s = since_ns * 1e-9
        if since_ns <= 0 or since_ns > gap_ns:
            reason[i] = _GAP
            continue
        lock_s = phases.lock_time_s[i]
        if phases.loss_of_lock[i]:
            reason[i] = _FLAG
        elif lock_s < states["lock_s"][slot] - _LOCK_ROUNDING_S or lock_s < 0.5 * since_s:
            reason[i] = _LOCK
        elif phases.half_cycle[i] != states["half_cycle"][slot]:
            reason[i] = _HALF
        if not has_integers(group_of(phases.satellite[i], phases.signal[i])):
            continue
        predicted = -0.5 * (phases.doppler_hz[i] + states["doppler_hz"][slot]) * since_s
        mismatch_m[i] = (
            phases.carrier_phase_cycles[i] - states["phase_cycles"][slot] - predicted
        ) * wavelength_m[i]
    return mismatch_m


@compiled
def _test_doppler(
    states: _PhaseStates, slots: Integers, reason: Integers, mismatch_m: Floats, time_ns: int
) -> None:
    """Compare phase and Doppler, after the median of all phases: a step of the receiver's clock is no slip."""
    known = mismatch_m[~np.isnan(mismatch_m)]
    common_m = np.median(known) if known.size >= 3 else 0.0
    for i in range(slots.size):
        if slots[i] < 0 or reason[i] != _CONTINUOUS:
            continue
        since_s = (time_ns - states["time_ns"][slots[i]]) * 1e-9
        if abs(mismatch_m[i] - common_m) > _DOPPLER_THRESHOLD_M + _DOPPLER_THRESHOLD_M_S2 * since_s * since_s:
            reason[i] = _DOPPLER


@compiled
def _test_geometry_free(
    states: _PhaseStates, phases: SignalColumns, slots: Integers, reason: Integers, wavelength_m: Floats
) -> None:
    """Jumps of the geometry-free combination of two bands; which of the two slipped is not known, so both arcs end."""
    cycles = phases.carrier_phase_cycles
    for i in range(slots.size):
        for j in range(i):
            if phases.satellite[j] != phases.satellite[i] or not (
                _is_continuous(slots, reason, i) and _is_continuous(slots, reason, j)
            ):
                continue
            before_ns = states["time_ns"][slots[i]]
            if states["time_ns"][slots[j]] != before_ns:
                continue
            if (phases.time_ns - before_ns) * 1e-9 > _LONGEST_FREE_S:
                continue
            moved_m = cycles[i] * wavelength_m[i] - cycles[j] * wavelength_m[j]
            moved_m -= states["phase_cycles"][slots[i]] * wavelength_m[i]
            moved_m += states["phase_cycles"][slots[j]] * wavelength_m[j]
            if abs(moved_m) > _GEOMETRY_FREE_THRESHOLD_M:
                reason[i] = reason[j] = _FREE

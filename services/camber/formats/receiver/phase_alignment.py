"""Integer cycles removed from carrier phases so that they stay near their pseudoranges, as receivers count them.

RTCM's MSM can represent a phase within 1171 m of the range (10403.3, DF406): the sender initialises the cycle count
accordingly, and reports a loss of lock where it does so again. u-blox receivers initialise `cpMes` in the same manner.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camber.formats.observations import SPEED_OF_LIGHT_M_S, ObservationEpoch
from camber.formats.rtcm.msm_signals import MSM_SIGNALS
from camber.geodesy.gps_time import NS_PER_SECOND

_MAX_DISTANCE_M = 800.0
"""Chosen: a phase further from its pseudorange is aligned anew; 1171 m (DF406) less the spread of pseudoranges."""


class PhaseAlignment:
    """Keeps, for one stream, the integer cycles removed from each signal, and since when.

    The number is constant until loss of lock: `loss_of_lock`, or a lock time shorter than the time since the last
    phase. A phase that drifts from its pseudorange is aligned anew: its lock time starts at zero, and `loss_of_lock` is
    set. A phase without a pseudorange keeps its number; without any number yet it is omitted (NaN).
    """

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}
        self._cycles = np.zeros(0)
        self._last_ns = np.zeros(0, np.int64)
        self._since_ns = np.zeros(0, np.int64)

    def align_to_pseudorange(self, epoch: ObservationEpoch) -> ObservationEpoch:
        """Return the epoch with its phases near the pseudoranges; ValueError for a signal with unknown carrier."""
        row, known = MSM_SIGNALS.rows(epoch.satellite, epoch.signal)
        if not known.all():
            k = int(np.flatnonzero(~known)[0])
            raise ValueError(f"signal {epoch.signal[k]} of {epoch.satellite[k]}: its carrier is not known")
        wavelength_m = SPEED_OF_LIGHT_M_S / MSM_SIGNALS.carriers_hz[row]
        keys = (epoch.satellite << 16) + epoch.signal
        slot = np.array([self._slots.setdefault(key, len(self._slots)) for key in keys.tolist()], np.int64)
        self._grow()
        phase = epoch.carrier_phase_cycles
        has_phase, has_range = ~np.isnan(phase), ~np.isnan(epoch.pseudorange_m)
        last_ns = self._last_ns[slot]
        lock_s = np.where(np.isnan(epoch.lock_time_s), 0.0, epoch.lock_time_s)
        since_last_ns = epoch.time_ns - last_ns
        broken = (last_ns < 0) | epoch.loss_of_lock | (lock_s * NS_PER_SECOND < since_last_ns - 0.5e6)
        aligned_cycles = np.rint(phase - epoch.pseudorange_m / wavelength_m)
        drifted = np.abs(aligned_cycles - self._cycles[slot]) * wavelength_m > _MAX_DISTANCE_M
        realigned = has_phase & has_range & (broken | drifted)
        cycles = np.where(realigned, aligned_cycles, self._cycles[slot])
        # After a loss of lock, a phase without pseudorange cannot be aligned.
        valid = has_phase & (has_range | ~broken)
        since_ns = np.where(realigned & ~broken, epoch.time_ns, np.where(realigned, -1, self._since_ns[slot]))
        self._cycles[slot[valid]] = cycles[valid]
        self._since_ns[slot[valid]] = since_ns[valid]
        self._last_ns[slot[valid]] = epoch.time_ns
        aligned_s = np.where(since_ns >= 0, (epoch.time_ns - since_ns) / NS_PER_SECOND, np.inf)
        return replace(
            epoch,
            carrier_phase_cycles=np.where(valid, phase - cycles, np.nan),
            lock_time_s=np.where(valid, np.fmin(epoch.lock_time_s, aligned_s), epoch.lock_time_s),
            loss_of_lock=epoch.loss_of_lock | realigned & ~broken,
        )

    def _grow(self) -> None:
        more = len(self._slots) - self._cycles.size
        if more:
            self._cycles = np.append(self._cycles, np.zeros(more))
            self._last_ns = np.append(self._last_ns, np.full(more, -1))
            self._since_ns = np.append(self._since_ns, np.full(more, -1))

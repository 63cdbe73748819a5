"""Whole cycles taken off the phase so that it stays near its pseudorange, as receivers count it.

RTCM's MSM has room for a phase within 1171 m of the range (10403.3, DF406): who sends it starts the count of cycles so,
and says that the phase is broken where it starts anew. u-blox receivers start `cpMes` so too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camber.formats.observations import SPEED_OF_LIGHT_M_S, ObservationEpoch
from camber.formats.rtcm.msm_signals import MSM_SIGNALS
from camber.geodesy.gps_time import NS_PER_SECOND

FARTHEST_M = 800.0
"""Further from its pseudorange than this the phase's count starts anew: 1171 m less what lies between pseudoranges."""


class PhaseAlignment:
    """One stream's memory: how many whole cycles each signal is off, and since when.

    The same number is taken off until the phase breaks: `loss_of_lock`, or a lock time shorter than the time since the
    last phase. A phase that runs away from its pseudorange breaks here: its lock time starts at zero, and the flag is
    set. A phase without a pseudorange keeps its count; without any count yet it is left out (NaN).
    """

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}
        self._cycles = np.zeros(0)
        self._last_ns = np.zeros(0, np.int64)
        self._since_ns = np.zeros(0, np.int64)

    def align_to_pseudorange(self, epoch: ObservationEpoch) -> ObservationEpoch:
        """The epoch with its phases near the pseudoranges; ValueError for a signal whose carrier is not known."""
        place, known = MSM_SIGNALS.places(epoch.satellite, epoch.signal)
        if not known.all():
            row = int(np.flatnonzero(~known)[0])
            raise ValueError(
                f"signal {epoch.signal[row]} of {epoch.satellite[row]}: its carrier is not known"
            )
        wavelength_m = SPEED_OF_LIGHT_M_S / MSM_SIGNALS.carriers_hz[place]
        keys = (epoch.satellite << 16) + epoch.signal
        slot = np.array([self._slots.setdefault(key, len(self._slots)) for key in keys.tolist()], np.int64)
        self._grow()
        phase = epoch.carrier_phase_cycles
        has_phase, has_range = ~np.isnan(phase), ~np.isnan(epoch.pseudorange_m)
        last_ns = self._last_ns[slot]
        lock_s = np.where(np.isnan(epoch.lock_time_s), 0.0, epoch.lock_time_s)
        away_ns = epoch.time_ns - last_ns
        broken = (last_ns < 0) | epoch.loss_of_lock | (lock_s * NS_PER_SECOND < away_ns - 0.5e6)
        wanted = np.rint(phase - epoch.pseudorange_m / wavelength_m)
        runs_away = np.abs(wanted - self._cycles[slot]) * wavelength_m > FARTHEST_M
        anew = has_phase & has_range & (broken | runs_away)
        cycles = np.where(anew, wanted, self._cycles[slot])
        # A broken phase that has no pseudorange to count from is not told.
        told = has_phase & (has_range | ~broken)
        since_ns = np.where(anew & ~broken, epoch.time_ns, np.where(anew, -1, self._since_ns[slot]))
        self._cycles[slot[told]] = cycles[told]
        self._since_ns[slot[told]] = since_ns[told]
        self._last_ns[slot[told]] = epoch.time_ns
        here_s = np.where(since_ns >= 0, (epoch.time_ns - since_ns) / NS_PER_SECOND, np.inf)
        return replace(
            epoch,
            carrier_phase_cycles=np.where(told, phase - cycles, np.nan),
            lock_time_s=np.where(told, np.fmin(epoch.lock_time_s, here_s), epoch.lock_time_s),
            loss_of_lock=epoch.loss_of_lock | anew & ~broken,
        )

    def _grow(self) -> None:
        more = len(self._slots) - self._cycles.size
        if more:
            self._cycles = np.append(self._cycles, np.zeros(more))
            self._last_ns = np.append(self._last_ns, np.full(more, -1))
            self._since_ns = np.append(self._since_ns, np.full(more, -1))

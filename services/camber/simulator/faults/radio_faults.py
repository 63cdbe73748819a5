"""What happens to a receiver from outside, each with onset and end: jamming, slow spoofing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.scene import Floats, Integers


@dataclass(frozen=True, slots=True, kw_only=True)
class JammingSignal:
    """C/N0 of all signals falls by `loss_db`, within `ramp_s` at each end."""

    begin_ns: int
    end_ns: int
    loss_db: float
    ramp_s: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SpoofingSignal:
    """All signals are those of an antenna that drifts off the true one, from zero on, and comes back at the end."""

    begin_ns: int
    end_ns: int
    drift_m_s: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RadioFaults:
    """All of a drive; none by default."""

    jamming: tuple[JammingSignal, ...] = ()
    spoofing: tuple[SpoofingSignal, ...] = ()

    def cn0_loss_db(self, time_ns: Integers) -> Floats:
        """(n,)"""
        loss = np.zeros(len(time_ns))
        for j in self.jamming:
            inside = np.minimum(time_ns - j.begin_ns, j.end_ns - time_ns) / NS_PER_SECOND
            loss += j.loss_db * np.clip(inside / max(j.ramp_s, 1e-9), 0.0, 1.0)
        return loss

    def antenna_offset_m(self, time_ns: Integers) -> tuple[Floats, Floats]:
        """How far (n, 3) [m] off the true antenna the signals say it is, and how fast [m/s]."""
        offset, rate = np.zeros((len(time_ns), 3)), np.zeros((len(time_ns), 3))
        for s in self.spoofing:
            on = (time_ns >= s.begin_ns) & (time_ns < s.end_ns)
            since = np.where(on, (time_ns - s.begin_ns) / NS_PER_SECOND, 0.0)
            offset += since[:, None] * np.array(s.drift_m_s)
            rate += on[:, None] * np.array(s.drift_m_s)
        return offset, rate

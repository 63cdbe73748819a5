"""What happens to a receiver from outside, each with onset and end: restarts, jamming, slow spoofing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_SECOND

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Restart:
    """No observations from begin to before end; all locks are new after it."""

    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class Jamming:
    """C/N0 of all signals falls by `loss_db`, within `ramp_s` at either end."""

    begin_ns: int
    end_ns: int
    loss_db: float
    ramp_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Spoofing:
    """All signals are those of an antenna that drifts off the true one, from zero on, and comes back at the end."""

    begin_ns: int
    end_ns: int
    drift_m_s: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RadioFaults:
    """All of a drive; none by default."""

    restarts: tuple[Restart, ...] = ()
    jamming: tuple[Jamming, ...] = ()
    spoofing: tuple[Spoofing, ...] = ()

    def running(self, time_ns: Integers) -> NDArray[np.bool_]:
        """Does the receiver work at these times (n,)?"""
        runs = np.ones(len(time_ns), np.bool_)
        for r in self.restarts:
            runs &= ~((time_ns >= r.begin_ns) & (time_ns < r.end_ns))
        return runs

    def restarted(self, time_ns: Integers) -> Integers:
        """How often it has been restarted by then (n,)."""
        return np.sum([time_ns >= r.end_ns for r in self.restarts], axis=0, dtype=np.int64) + np.zeros(
            len(time_ns), np.int64
        )

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

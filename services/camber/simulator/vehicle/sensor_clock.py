"""The clock of a sensor: its stamps are not quite GPS time, and it samples at even times of this clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers


@dataclass(frozen=True, slots=True)
class DriftingClock:
    """Stamp − GPS time is `offset_ns` at the start, and grows by `drift` (seconds a second)."""

    offset_ns: int = 0
    drift: float = 0.0

    @classmethod
    def drawn(cls, seed: int, sensor: str, offset_sigma_s: float, drift_sigma: float) -> Self:
        """One of a population of clocks."""
        offset, drift = stream(seed, f"{sensor} clock").standard_normal(2)
        return cls(round(float(offset) * offset_sigma_s * 1e9), float(drift) * drift_sigma)

    def stamps(self, time_ns: Integers, start_ns: int) -> Integers:
        """Its readings at true times (n,)."""
        drifted = np.rint(self.drift * (time_ns - start_ns).astype(np.float64)).astype(np.int64)
        return time_ns + self.offset_ns + drifted

    def sampling(self, start_ns: int, end_ns: int, rate_hz: float) -> tuple[Integers, Integers]:
        """True times (n,) from start to end at which this clock makes a step of the rate, and their stamps.

        Its first sample is at the start; the stamps are even, the true times as even as the drift lets them.
        """
        period_ns = 1e9 / rate_hz / (1.0 + self.drift)
        count = int((end_ns - start_ns) / period_ns) + 1
        time_ns = start_ns + np.rint(np.arange(count) * period_ns).astype(np.int64)
        time_ns = time_ns[time_ns <= end_ns]
        return time_ns, self.stamps(time_ns, start_ns)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Readings:
    """Readings of one sensor: columns (n,), NaN in `value` where it has none; `true_time_ns` is truth."""

    time_ns: Integers
    true_time_ns: Integers
    value: Floats


def quantised(value: Floats, step: float) -> Floats:
    """The nearest multiples of a step; as they are where it is zero."""
    return value if step == 0.0 else np.round(value / step) * step

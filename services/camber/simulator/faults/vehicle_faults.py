"""What may go wrong with a vehicle on the way, with a beginning and an end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.simulator.scene import Floats

FaultKind = Literal["tyre_radius", "load", "wheel_slip"]


@dataclass(frozen=True, slots=True)
class VehicleFault:
    """`amount`: metres by which all tyres' radius is greater, kilograms in the boot, or the share by which the wheels
    turn faster than they roll (−1: locked). Seconds count from the trajectory's beginning; it comes and goes over
    `ramp_s`, within onset and end. ValueError where that does not fit."""

    kind: FaultKind
    amount: float
    onset_s: float
    end_s: float = math.inf
    ramp_s: float = 0.5

    def __post_init__(self) -> None:
        if not (math.isfinite(self.amount) and math.isfinite(self.onset_s) and self.ramp_s > 0.0):
            raise ValueError(
                f"{self.kind}: amount, onset_s, ramp_s are not finite, or ramp_s is not positive"
            )
        if not self.end_s - self.onset_s >= 2.0 * self.ramp_s:
            raise ValueError(f"{self.kind}: end_s is {self.end_s}, expected two ramps after {self.onset_s}")


def effect(faults: Sequence[VehicleFault], kind: FaultKind, time_s: Floats) -> tuple[Floats, Floats]:
    """The sum of all faults of a kind at times (n,), and its derivative by time."""
    value, rate = np.zeros(len(time_s)), np.zeros(len(time_s))
    for fault in faults:
        if fault.kind == kind:
            for sign, start_s in ((1.0, fault.onset_s), (-1.0, fault.end_s - fault.ramp_s)):
                share = np.clip((time_s - start_s) / fault.ramp_s, 0.0, 1.0)
                value += sign * fault.amount * share**2 * (3.0 - 2.0 * share)
                rate += sign * fault.amount * 6.0 * share * (1.0 - share) / fault.ramp_s
    return value, rate

"""What may go wrong with a vehicle during a drive, with a beginning and an end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.simulator.scene import Floats

_RAMP_S = 0.5  # chosen: a fault is no jolt

FaultKind = Literal["tyre_radius", "load", "wheel_slip"]


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleFault:
    """`amount`: metres by which all tyres' radius is greater, kilograms in the boot, or the share by which the wheels
    turn faster than they roll (−1: locked). Seconds count from the trajectory's beginning; it comes and goes over
    half a second, within onset and end. ValueError where that does not fit."""

    kind: FaultKind
    amount: float
    onset_s: float
    end_s: float = math.inf

    def __post_init__(self) -> None:
        if not self.end_s - self.onset_s >= 2.0 * _RAMP_S:
            raise ValueError(f"{self.kind}: end_s is {self.end_s}, expected two ramps after {self.onset_s}")


def effect(faults: Sequence[VehicleFault], kind: FaultKind, time_s: Floats) -> tuple[Floats, Floats]:
    """The sum of all faults of a kind at times (n,), and its derivative by time."""
    value, rate = np.zeros(len(time_s)), np.zeros(len(time_s))
    for fault in faults:
        if fault.kind == kind:
            for sign, start_s in ((1.0, fault.onset_s), (-1.0, fault.end_s - _RAMP_S)):
                share = np.clip((time_s - start_s) / _RAMP_S, 0.0, 1.0)
                value += sign * fault.amount * share**2 * (3.0 - 2.0 * share)
                rate += sign * fault.amount * 6.0 * share * (1.0 - share) / _RAMP_S
    return value, rate

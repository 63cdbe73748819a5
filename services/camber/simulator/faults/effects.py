"""What scheduled faults do over time to a receiver's signals and to a vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.faults.schedule import (
    ChangedLoad,
    ChangedTyre,
    Fault,
    Jamming,
    Spoofing,
    WheelSlip,
    of_kind,
)
from camber.simulator.scene import Floats, Integers

LAST_S = 86_400.0  # the latest time of a schedule
_JAMMING_RAMP_S = 2.0  # chosen: a jammer comes nearer and goes away
_RAMP_S = 0.5  # chosen: a fault of the vehicle is no jolt
# By kind: the field that is its amount, and the value that does nothing.
_AMOUNTS = {ChangedTyre: ("radius_change_m", 0.0), ChangedLoad: ("load_kg", 0.0), WheelSlip: ("factor", 1.0)}


def _span_ns(fault: Jamming | Spoofing, time_ns: Integers) -> tuple[int, int]:
    end_s = LAST_S if fault.end_s is None else fault.end_s
    begin_ns, end_ns = (int(time_ns[0]) + round(s * NS_PER_SECOND) for s in (fault.onset_s, end_s))
    return begin_ns, end_ns


def cn0_loss_db(faults: Sequence[Fault], time_ns: Integers) -> Floats:
    """How much jamming takes from C/N0 of all signals (n,), over two seconds at each end.

    Onsets count from the first of the times; a fault without an end lasts beyond the last.
    """
    loss = np.zeros(len(time_ns))
    for fault in of_kind(faults, Jamming):
        begin_ns, end_ns = _span_ns(fault, time_ns)
        inside_s = np.minimum(time_ns - begin_ns, end_ns - time_ns) / NS_PER_SECOND
        loss += fault.loss_db * np.clip(inside_s / _JAMMING_RAMP_S, 0.0, 1.0)
    return loss


def antenna_offset_m(faults: Sequence[Fault], time_ns: Integers) -> tuple[Floats, Floats]:
    """How far (n, 3) [m] off the true antenna spoofed signals put it, and how fast [m/s]; it comes back at the end."""
    offset, rate = np.zeros((2, len(time_ns), 3))
    for fault in of_kind(faults, Spoofing):
        begin_ns, end_ns = _span_ns(fault, time_ns)
        drift_m_s = np.array((fault.east_m_s, fault.north_m_s, fault.up_m_s))
        on = (time_ns >= begin_ns) & (time_ns < end_ns)
        offset += np.where(on, (time_ns - begin_ns) / NS_PER_SECOND, 0.0)[:, None] * drift_m_s
        rate += on[:, None] * drift_m_s
    return offset, rate


def vehicle_effect(
    faults: Sequence[Fault], kind: type[ChangedTyre | ChangedLoad | WheelSlip], time_s: Floats
) -> tuple[Floats, Floats]:
    """The sum of all faults of a kind at times (n,) since the beginning, and its derivative by time.

    Metres by which all tyres' radius is greater, kilograms in the boot, or the share by which the wheels turn faster
    than they roll. Comes and goes over half a second, within onset and end; ValueError where that does not fit.
    """
    field, none = _AMOUNTS[kind]
    value, rate = np.zeros(len(time_s)), np.zeros(len(time_s))
    for fault in of_kind(faults, kind):
        amount, end_s = getattr(fault, field) - none, math.inf if fault.end_s is None else fault.end_s
        if not end_s - fault.onset_s >= 2.0 * _RAMP_S:
            raise ValueError(f"{fault.kind}: end_s is {end_s}, expected two ramps after {fault.onset_s}")
        for sign, start_s in ((1.0, fault.onset_s), (-1.0, end_s - _RAMP_S)):
            share = np.clip((time_s - start_s) / _RAMP_S, 0.0, 1.0)
            value += sign * amount * share**2 * (3.0 - 2.0 * share)
            rate += sign * amount * 6.0 * share * (1.0 - share) / _RAMP_S
    return value, rate

"""Where the phase is continuous: integer ambiguities of each lock, slips, half cycles, lock times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.satellites.parameters import Receiver
from camber.simulator.scene import Booleans, Floats, Integers

_RUNNING_S = 300.0  # chosen: how long a receiver has been on at most when the first epoch is written


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Locks:
    """Per epoch, satellite and frequency (n, m, 2).

    `ambiguity_cycles` are whole numbers, and half ones where half a cycle is off.
    """

    ambiguity_cycles: Floats
    lock_time_s: Floats
    loss_of_lock: Booleans
    half_cycle: Booleans


def locks(
    time_ns: Integers,
    tracked: Booleans,
    cn0_dbhz: Floats,
    *,
    data_only: Booleans,
    direct: Booleans,
    receiver: Receiver,
) -> Locks:
    """Of phases tracked (n, m, 2) with their C/N0.

    `data_only` (m, 2): signals without a pilot, `direct` (n, m): satellites in the line of sight.
    """
    p, rng = receiver.parameters, receiver.stream("locks")
    n = len(time_ns)
    dt = np.diff(time_ns, prepend=time_ns[:1]) / NS_PER_SECOND
    hazard = p.slips_per_s * 10.0 ** np.clip((45.0 - cn0_dbhz) / 10.0, -1.0, 3.0) * dt[:, None, None]
    slip = tracked & (rng.random(tracked.shape) < hazard)
    unseen = slip & (rng.random(tracked.shape) < p.slip_unseen)
    before = np.zeros_like(tracked)
    before[1:] = tracked[:-1]
    unseen &= before
    begins = tracked & (~before | (slip & ~unseen))
    row = np.broadcast_to(np.arange(n)[:, None, None], tracked.shape)
    began = np.maximum.accumulate(np.where(begins, row, 0), axis=0)

    def at_beginning(values: Floats) -> Floats:
        return np.take_along_axis(values, began, axis=0)

    whole = at_beginning(rng.integers(-500, 500, tracked.shape).astype(np.float64))
    jumps = np.where(unseen, rng.choice(np.array([-2.0, -1.0, 1.0, 2.0]), tracked.shape), 0.0)
    whole = whole + np.cumsum(jumps, axis=0)

    since = (time_ns[:, None, None] - time_ns[began]) / NS_PER_SECOND
    already = rng.uniform(5.0, _RUNNING_S, tracked.shape[1:])
    first = began == 0
    lock_time = np.where(first, since + already, since)

    # Of signals whose sign is not known, half are half a cycle off.
    asked = at_beginning((rng.random(tracked.shape) < p.half_cycle_after_lock).astype(np.float64)) > 0.0
    open_sign = ~first & tracked & data_only & asked
    resolved_s = at_beginning(rng.uniform(p.half_cycle_least_s, p.half_cycle_most_s, tracked.shape))
    off = at_beginning((rng.random(tracked.shape) < 0.5).astype(np.float64)) > 0.0
    strength_db = at_beginning(cn0_dbhz) - p.phase_tracked_above_dbhz
    wrong = at_beginning(rng.random(tracked.shape)) < p.half_cycle_wrong_when_weak * 10.0 ** (
        -np.maximum(strength_db, 0.0) / p.half_cycle_wrong_decade_db
    )
    wrong &= at_beginning(np.repeat(np.where(direct, 0.0, 1.0)[..., None], 2, axis=2)) > 0.0
    half_flag = open_sign & (since < resolved_s)
    unresolved = open_sign & (since < resolved_s + np.where(wrong, p.half_cycle_wrong_lasts_s, 0.0))
    # Resolved, the half cycle is taken out: a jump that comes with its own flag of a lock lost.
    settled = np.zeros_like(tracked)
    settled[1:] = unresolved[:-1] & ~unresolved[1:] & off[1:] & tracked[1:] & ~begins[1:]
    loss = (begins & ~first) | settled
    return Locks(
        ambiguity_cycles=whole + np.where(unresolved & off, 0.5, 0.0),
        lock_time_s=lock_time,
        loss_of_lock=loss,
        half_cycle=half_flag,
    )

"""RXM-RAWX payloads decoded to observations.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 3.17.4; u-blox M8 (UBX-13003221), 32.18.7, for version 0.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, ObservationEpoch
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.receiver_epoch import OmittedMeasurements, ReceiverEpoch, first_rows
from camber.formats.ubx.gps_week import checked_time_ns, resolve_week_rollover
from camber.formats.ubx.signal_ids import (
    GEOSTATIONARY_CYCLES,
    MAX_NUMBER_OF_GNSS,
    SIGNAL_OF_IDS,
    SYSTEM_OF_GNSS,
    are_geostationary,
)
from camber.formats.ubx.writer import (
    HALF_CYCLE_SUBTRACTED,
    HALF_CYCLE_VALID,
    MEASUREMENT,
    PHASE_VALID,
    PSEUDORANGE_VALID,
)
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

_HEADER = struct.Struct("<dHbBBB2x")
_CLOCK_RESET = 0b10  # `recStat`
_LOCK_RESOLUTION_S = 1e-3  # of `locktime`


def read_raw_measurements(
    payload: bytes, locks: LossOfLockDetector, near_ns: int | None
) -> tuple[ReceiverEpoch, OmittedMeasurements]:
    """Decode versions 0 and 1; the time is the receiver's, rounded to ns.

    `near_ns` resolves a roll-over of the receiver's week (1024 weeks). A value that the receiver reports as invalid, or
    that is not finite, is NaN; so are a Doppler and a C/N0 of exactly 0, which have no such bit. `half_cycle`: there is
    a phase, and its half cycles are not resolved. `loss_of_lock`: by `LossOfLockDetector`, and where a subtracted half
    cycle changes. Phases of BeiDou's geostationary satellites get half a cycle, see `GEOSTATIONARY_CYCLES`. Of repeated
    signals the first counts.

    Raises ValueError where the message is inconsistent.
    """
    if len(payload) < _HEADER.size:
        raise ValueError(f"{len(payload)} bytes, expected at least {_HEADER.size}")
    of_week_s, week, _, count, status, version = _HEADER.unpack_from(payload)
    if version > 1 or len(payload) != _HEADER.size + count * MEASUREMENT.itemsize:
        raise ValueError(f"version {version}, {len(payload)} bytes for {count} measurements")
    if not (math.isfinite(of_week_s) and 0.0 <= of_week_s * NS_PER_SECOND < NS_PER_WEEK - 0.5):
        raise ValueError(f"time of week {of_week_s} s")
    receiver_ns = week * NS_PER_WEEK + round(of_week_s * NS_PER_SECOND)
    time_ns = checked_time_ns(resolve_week_rollover(receiver_ns, near_ns))
    rows = np.frombuffer(payload, MEASUREMENT, count, _HEADER.size)
    gnss, number = rows["gnssId"].astype(np.int64), rows["svId"].astype(np.int64)
    # Receivers of version 0 have one signal per system; the byte is reserved.
    signal = SIGNAL_OF_IDS[gnss, rows["sigId"] if version else 0]
    supported = SYSTEM_OF_GNSS[gnss] > 0
    known = supported & (signal > 0) & (number > 0) & (number <= MAX_NUMBER_OF_GNSS[gnss])
    satellite = SYSTEM_OF_GNSS[gnss] * 256 + number
    keys = (satellite << 16) + signal
    used, repeated = first_rows(known, keys)
    omitted = OmittedMeasurements(
        other_systems=count - int(np.count_nonzero(supported)),
        unknown_signals=int(np.count_nonzero(supported & ~known)),
        repeated=repeated,
    )
    if used.size < count:
        rows, keys, satellite, signal = rows[used], keys[used], satellite[used], signal[used]
    status_bits = rows["trkStat"]
    phase = _valid(rows["cpMes"], (status_bits & PHASE_VALID) > 0)
    phase += GEOSTATIONARY_CYCLES * are_geostationary(satellite)
    has_phase = ~np.isnan(phase)
    lock_s = rows["locktime"] / 1000.0
    loss_of_lock = locks.detect(
        time_ns,
        keys,
        has_phase=has_phase,
        min_lock_s=lock_s,
        max_lock_s=lock_s + _LOCK_RESOLUTION_S,
        state=(status_bits & HALF_CYCLE_SUBTRACTED).astype(np.int64),
    )
    epoch = ObservationEpoch(
        time_ns=time_ns,
        satellite=satellite,
        signal=signal,
        pseudorange_m=_valid(rows["prMes"], (status_bits & PSEUDORANGE_VALID) > 0),
        carrier_phase_cycles=phase,
        doppler_hz=_valid(rows["doMes"], rows["doMes"] != 0.0),
        cn0_dbhz=_valid(rows["cno"], rows["cno"] > 0),
        lock_time_s=lock_s,
        loss_of_lock=loss_of_lock,
        half_cycle=has_phase & ((status_bits & HALF_CYCLE_VALID) == 0),
    )
    return ReceiverEpoch(epoch, bool(status & _CLOCK_RESET)), omitted


def _valid(values: NDArray[np.generic], valid: NDArray[np.bool_]) -> Floats:
    wide = values.astype(np.float64)
    return np.where(valid & np.isfinite(wide), wide, np.nan)

"""UBX messages as a u-blox receiver of generation 9 sends them: RXM-RAWX, RXM-SFRBX, NAV-PVT, NAV-HPPOSLLH.

Source: u-blox ZED-F9P, interface description (UBX-18010854): 3.2 (frame), 3.4 (checksum), 1.5 (satellites, signals),
3.15.7 (NAV-HPPOSLLH), 3.15.13 (NAV-PVT), 3.17.4 (RXM-RAWX), 3.17.9 (RXM-SFRBX).
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import (
    Floats,
    Integers,
    ObservationEpoch,
    satellite_name,
    signal_name,
)
from camber.formats.ubx.signal_ids import GEOSTATIONARY_CYCLES, GNSS_IDS, are_geostationary, ubx_signal_ids
from camber.formats.ubx.subframe_schedule import Subframe
from camber.geodesy.gps_time import NS_PER_SECOND, gps_minus_utc_s, week_tow_from_gps_ns

MOST_MEASUREMENTS = 255
SYNC = b"\xb5\x62"
MEASUREMENT = np.dtype(
    [
        ("prMes", "<f8"),
        ("cpMes", "<f8"),
        ("doMes", "<f4"),
        ("gnssId", "u1"),
        ("svId", "u1"),
        ("sigId", "u1"),
        ("freqId", "u1"),
        ("locktime", "<u2"),
        ("cno", "u1"),
        ("prStdev", "u1"),
        ("cpStdev", "u1"),
        ("doStdev", "u1"),
        ("trkStat", "u1"),
        ("reserved", "u1"),
    ]
)
_MOST_LOCK_MS = 64_500.0
PSEUDORANGE_VALID, PHASE_VALID, HALF_CYCLE_VALID, HALF_CYCLE_SUBTRACTED = 1, 2, 4, 8
"""Bits of `trkStat`."""


def ubx_frame(message_class: int, message_id: int, payload: bytes) -> bytes:
    """Two synchronisation characters, class, id, length, payload, checksum; ValueError above 65535 bytes."""
    if len(payload) > 0xFFFF:
        raise ValueError(f"payload of {len(payload)} bytes, expected at most 65535")
    body = struct.pack("<BBH", message_class, message_id, len(payload)) + payload
    return SYNC + body + checksum(body)


def checksum(body: bytes) -> bytes:
    """The 8-bit Fletcher checksum of class, id, length and payload: sums, and sums of the sums, modulo 256."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    return bytes((int(values.sum()) & 255, int(values @ np.arange(values.size, 0, -1)) & 255))


def format_raw_measurements(
    epoch: ObservationEpoch,
    *,
    pseudorange_sigma_m: Floats | None = None,
    phase_sigma_cycles: Floats | None = None,
    doppler_sigma_hz: Floats | None = None,
    clock_reset: bool = False,
) -> bytes:
    """RXM-RAWX, version 1, with one measurement a row, in the order of the rows.

    Phase and Doppler have RINEX's signs (`cpMes` grows with the pseudorange, `doMes` is positive when approaching). A
    pseudorange or phase that is NaN is 0 and not valid; for Doppler and C/N0 the message has no such bit, they become
    0. Phases of BeiDou's geostationary satellites are half a cycle less, as receivers tell them. C/N0 is told in whole
    dB-Hz, the lock time in ms up to 64.5 s. Of a half-cycle ambiguity the bit "half cycle valid" is not set.
    `loss_of_lock` has no bit; the lock time tells it. Standard deviations are told as the next step above; where not
    given they are those of a receiver with 0.3 m, 0.004 cycles and 0.1 Hz at 45 dB-Hz and noise that goes with
    10^(−C/N0 / 20).

    Raises ValueError for what has no number at u-blox or comes twice, over 255 measurements, or values out of range.
    """
    count = epoch.satellite.size
    if count > MOST_MEASUREMENTS:
        raise ValueError(f"{count} measurements in one epoch, expected at most {MOST_MEASUREMENTS}")
    week, of_week_ns = week_tow_from_gps_ns(epoch.time_ns)
    measurements = np.zeros(count, MEASUREMENT)
    measurements["prMes"] = np.where(np.isnan(epoch.pseudorange_m), 0.0, epoch.pseudorange_m)
    has_phase = ~np.isnan(epoch.carrier_phase_cycles)
    phase_told = epoch.carrier_phase_cycles - GEOSTATIONARY_CYCLES * are_geostationary(epoch.satellite)
    measurements["cpMes"] = np.where(has_phase, phase_told, 0.0)
    measurements["doMes"] = np.where(np.isnan(epoch.doppler_hz), 0.0, epoch.doppler_hz)
    measurements["gnssId"], measurements["svId"], measurements["sigId"] = _ids(epoch)
    lock_s = np.where(np.isnan(epoch.lock_time_s), 0.0, epoch.lock_time_s)
    cn0 = np.where(np.isnan(epoch.cn0_dbhz), 0.0, epoch.cn0_dbhz)
    _check(epoch, ~(np.abs(measurements["prMes"]) < 1e12), "pseudorange is not finite")
    _check(epoch, ~(np.abs(measurements["cpMes"]) < 1e13), "carrier phase is not finite")
    _check(epoch, ~(np.abs(measurements["doMes"]) < 1e12), "Doppler is not finite")
    _check(epoch, ~(lock_s >= 0.0), "lock time is negative, expected 0 s or more")
    _check(epoch, ~((cn0 >= 0.0) & (cn0 < 255.5)), "C/N0 is out of range, expected 0 to 255 dB-Hz")
    measurements["locktime"] = np.minimum(np.floor(lock_s * 1e3 + 1e-6), _MOST_LOCK_MS)
    measurements["cno"] = np.rint(cn0)
    noise = 10.0 ** ((45.0 - np.where(np.isnan(epoch.cn0_dbhz), 25.0, epoch.cn0_dbhz)) / 20.0)
    code_m = 0.3 * noise if pseudorange_sigma_m is None else pseudorange_sigma_m
    phase = 0.004 * noise if phase_sigma_cycles is None else phase_sigma_cycles
    doppler = 0.1 * noise if doppler_sigma_hz is None else doppler_sigma_hz
    measurements["prStdev"] = _doublings(code_m, 0.01)
    measurements["cpStdev"] = np.clip(np.ceil(phase / 0.004 - 1e-9), 1, 15)
    measurements["doStdev"] = _doublings(doppler, 0.002)
    measurements["trkStat"] = (
        np.where(np.isnan(epoch.pseudorange_m), 0, PSEUDORANGE_VALID)
        + np.where(has_phase, PHASE_VALID, 0)
        + np.where(has_phase & ~epoch.half_cycle, HALF_CYCLE_VALID, 0)
    )
    # The leap seconds are known (bit 0); bit 1 is a clock reset.
    header = struct.pack(
        "<dHbBBB2x",
        of_week_ns / NS_PER_SECOND,
        week,
        gps_minus_utc_s(epoch.time_ns),
        count,
        0b01 | (0b10 if clock_reset else 0),
        1,
    )
    return ubx_frame(0x02, 0x15, header + measurements.tobytes())


def format_subframe(subframe: Subframe, *, channel: int = 0) -> bytes:
    """RXM-SFRBX, version 2, of one subframe or page."""
    system = satellite_name(subframe.satellite)[0]
    words = subframe.words
    header = struct.pack(
        "<8B",
        GNSS_IDS[system],
        subframe.satellite & 255,
        subframe.signal_id,
        0,
        len(words),
        channel,
        2,
        0,
    )
    return ubx_frame(0x02, 0x13, header + struct.pack(f"<{len(words)}I", *words))


def _ids(epoch: ObservationEpoch) -> tuple[Integers, Integers, Integers]:
    system, satellite = epoch.satellite >> 8, epoch.satellite & 255
    gnss_id, signal_id, known = ubx_signal_ids(epoch.satellite, epoch.signal)
    _check(epoch, ~known, "u-blox has no number for this signal")
    named = (system << 16) + (satellite << 8) + signal_id
    again = np.ones(named.size, np.bool_)
    again[np.unique(named, return_index=True)[1]] = False
    _check(epoch, again, "observed twice in one epoch")
    return gnss_id, satellite, signal_id


def _doublings(sigma: Floats, step: float) -> Floats:
    """The exponent n of the least step · 2^n that is not below sigma, 0 to 15."""
    exponent: Floats = np.clip(np.ceil(np.log2(np.maximum(sigma, step) / step) - 1e-9), 0, 15)
    return exponent


def _check(epoch: ObservationEpoch, wrong: NDArray[np.bool_], what: str) -> None:
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise ValueError(
            f"{satellite_name(int(epoch.satellite[row]))} {signal_name(int(epoch.signal[row]))}: {what}"
        )

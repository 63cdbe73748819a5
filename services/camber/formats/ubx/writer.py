"""UBX messages as u-blox receivers of generation 9 send them: RXM-RAWX, RXM-SFRBX.

Source: u-blox ZED-F9P, interface description (UBX-18010854): 3.2 (frame), 3.4 (checksum), 1.5 (satellites, signals),
3.17.4 (RXM-RAWX), 3.17.9 (RXM-SFRBX).
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers, ObservationEpoch, satellite_name, signal_name
from camber.formats.ubx.signal_ids import GEOSTATIONARY_CYCLES, GNSS_IDS, are_geostationary, ubx_signal_ids
from camber.formats.ubx.subframe_schedule import Subframe
from camber.geodesy.gps_time import NS_PER_SECOND, gps_minus_utc_s, week_tow_from_gps_ns

SYNC = b"\xb5\x62"
MEASUREMENT = np.dtype(
    [
        *(("prMes", "<f8"), ("cpMes", "<f8"), ("doMes", "<f4")),
        *((name, "u1") for name in ("gnssId", "svId", "sigId", "freqId")),
        ("locktime", "<u2"),
        *((name, "u1") for name in ("cno", "prStdev", "cpStdev", "doStdev", "trkStat", "reserved")),
    ]
)
PSEUDORANGE_VALID, PHASE_VALID, HALF_CYCLE_VALID, HALF_CYCLE_SUBTRACTED = 1, 2, 4, 8
"""Bits of `trkStat`."""
_MAX_MEASUREMENTS = 255  # `numMeas` is one byte
_MAX_LOCK_MS = 64_500.0  # 3.17.4, `locktime`
# Chosen: σ of code [m], phase [cycles] and Doppler [Hz] at 45 dB-Hz, typical of a ZED-F9P; they vary as 10^(−C/N0/20).
_CODE_SIGMA_M, _PHASE_SIGMA_CYCLES, _DOPPLER_SIGMA_HZ = 0.3, 0.004, 0.1


def ubx_frame(message_class: int, message_id: int, payload: bytes) -> bytes:
    """Return sync characters, class, id, length, payload, checksum; ValueError above 65535 bytes."""
    if len(payload) > 0xFFFF:
        raise ValueError(f"payload of {len(payload)} bytes, expected at most 65535")
    body = struct.pack("<BBH", message_class, message_id, len(payload)) + payload
    return SYNC + body + checksum(body)


def checksum(body: bytes) -> bytes:
    """Return the 8-bit Fletcher checksum of class, id, length and payload."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    return bytes((int(values.sum()) & 255, int(values @ np.arange(values.size, 0, -1)) & 255))


def format_raw_measurements(epoch: ObservationEpoch) -> bytes:
    """Encode RXM-RAWX, version 1, with one measurement per row, in the order of the rows.

    Phase and Doppler have RINEX's signs (`cpMes` grows with the pseudorange, `doMes` is positive when approaching). A
    pseudorange or phase that is NaN is 0 and invalid; Doppler and C/N0, which have no such bit, become 0. Phases of
    BeiDou's geostationary satellites are half a cycle less, as receivers report them. C/N0 is in whole dB-Hz, the lock
    time in ms up to 64.5 s; loss of lock is expressed by the lock time alone. Standard deviations follow from C/N0.

    Raises ValueError for signals without a u-blox number, repeated signals, over 255 measurements, values out of range.
    """
    count = epoch.satellite.size
    if count > _MAX_MEASUREMENTS:
        raise ValueError(f"{count} measurements in one epoch, expected at most {_MAX_MEASUREMENTS}")
    week, of_week_ns = week_tow_from_gps_ns(epoch.time_ns)
    has_code, has_phase = ~np.isnan(epoch.pseudorange_m), ~np.isnan(epoch.carrier_phase_cycles)
    phase = epoch.carrier_phase_cycles - GEOSTATIONARY_CYCLES * are_geostationary(epoch.satellite)
    lock_s = np.where(np.isnan(epoch.lock_time_s), 0.0, epoch.lock_time_s)
    cn0 = np.where(np.isnan(epoch.cn0_dbhz), 0.0, epoch.cn0_dbhz)
    measurements = np.zeros(count, MEASUREMENT)
    measurements["prMes"] = np.where(has_code, epoch.pseudorange_m, 0.0)
    measurements["cpMes"] = np.where(has_phase, phase, 0.0)
    measurements["doMes"] = np.where(np.isnan(epoch.doppler_hz), 0.0, epoch.doppler_hz)
    measurements["gnssId"], measurements["svId"], measurements["sigId"] = _ids(epoch)
    _check(epoch, ~(np.abs(measurements["prMes"]) < 1e12), "pseudorange is not finite")
    _check(epoch, ~(np.abs(measurements["cpMes"]) < 1e13), "carrier phase is not finite")
    _check(epoch, ~(np.abs(measurements["doMes"]) < 1e12), "Doppler is not finite")
    _check(epoch, ~(lock_s >= 0.0), "lock time is negative, expected 0 s or more")
    _check(epoch, ~((cn0 >= 0.0) & (cn0 < 255.5)), "C/N0 is out of range, expected 0 to 255 dB-Hz")
    measurements["locktime"] = np.minimum(np.floor(lock_s * 1e3 + 1e-6), _MAX_LOCK_MS)
    measurements["cno"] = np.rint(cn0)
    noise = 10.0 ** ((45.0 - np.where(np.isnan(epoch.cn0_dbhz), 25.0, epoch.cn0_dbhz)) / 20.0)
    measurements["prStdev"] = _sigma_exponent(_CODE_SIGMA_M * noise, 0.01)
    measurements["cpStdev"] = np.clip(np.ceil(_PHASE_SIGMA_CYCLES * noise / 0.004 - 1e-9), 1, 15)
    measurements["doStdev"] = _sigma_exponent(_DOPPLER_SIGMA_HZ * noise, 0.002)
    measurements["trkStat"] = (
        has_code * PSEUDORANGE_VALID
        + has_phase * PHASE_VALID
        + (has_phase & ~epoch.half_cycle) * HALF_CYCLE_VALID
    )
    leap_s = gps_minus_utc_s(epoch.time_ns)
    # `recStat` bit 0: the leap seconds are known.
    header = struct.pack("<dHbBBB2x", of_week_ns / NS_PER_SECOND, week, leap_s, count, 0b01, 1)
    return ubx_frame(0x02, 0x15, header + measurements.tobytes())


def format_subframe(subframe: Subframe) -> bytes:
    """Encode RXM-SFRBX, version 2, of one subframe or page."""
    gnss_id, words = GNSS_IDS[satellite_name(subframe.satellite)[0]], subframe.words
    header = (gnss_id, subframe.satellite & 255, subframe.signal_id, 0, len(words), 0, 2, 0)
    return ubx_frame(0x02, 0x13, struct.pack(f"<8B{len(words)}I", *header, *words))


def _ids(epoch: ObservationEpoch) -> tuple[Integers, Integers, Integers]:
    system, satellite = epoch.satellite >> 8, epoch.satellite & 255
    gnss_id, signal_id, known = ubx_signal_ids(epoch.satellite, epoch.signal)
    _check(epoch, ~known, "u-blox has no number for this signal")
    keys = (system << 16) + (satellite << 8) + signal_id
    repeated = np.ones(keys.size, np.bool_)
    repeated[np.unique(keys, return_index=True)[1]] = False
    _check(epoch, repeated, "observed twice in one epoch")
    return gnss_id, satellite, signal_id


def _sigma_exponent(sigma: Floats, step: float) -> Floats:
    """Return the exponent n of the least step · 2^n that is not below sigma, 0 to 15."""
    exponent: Floats = np.clip(np.ceil(np.log2(np.maximum(sigma, step) / step) - 1e-9), 0, 15)
    return exponent


def _check(epoch: ObservationEpoch, wrong: NDArray[np.bool_], problem: str) -> None:
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        satellite, signal = satellite_name(int(epoch.satellite[row])), signal_name(int(epoch.signal[row]))
        raise ValueError(f"{satellite} {signal}: {problem}")

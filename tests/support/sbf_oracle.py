"""MeasEpoch by pysbf2's fields and the formulas of the reference guide, a signal at a time: the oracle of our columns.

pysbf2 1.0.7 scales some high parts and not others, and gives the offsets' high parts without their sign.
"""

from __future__ import annotations

import io
import math
from typing import Any, NamedTuple

from pysbf2 import SBFReader

LIGHT_M_S = 299_792_458.0
# mosaic-X5 reference guide, 4.1.10: number, RINEX code, carrier in MHz (GLONASS: of channel 0), without SBAS, NavIC.
SIGNALS = {
    0: ("G", "1C", 1575.42), 1: ("G", "1W", 1575.42), 2: ("G", "2W", 1227.60), 3: ("G", "2L", 1227.60),
    4: ("G", "5Q", 1176.45), 5: ("G", "1L", 1575.42), 6: ("J", "1C", 1575.42), 7: ("J", "2L", 1227.60),
    13: ("C", "1P", 1575.42), 14: ("C", "5P", 1176.45), 17: ("E", "1C", 1575.42), 19: ("E", "6C", 1278.75),
    20: ("E", "5Q", 1176.45), 21: ("E", "7Q", 1207.14), 22: ("E", "8Q", 1191.795), 26: ("J", "5Q", 1176.45),
    28: ("C", "2I", 1561.098), 29: ("C", "7I", 1207.14), 30: ("C", "6I", 1268.52), 32: ("J", "1L", 1575.42),
    34: ("C", "7D", 1207.14), 8: ("R", "1C", 1602.0), 9: ("R", "1P", 1602.0), 10: ("R", "2P", 1246.0),
    11: ("R", "2C", 1246.0), 12: ("R", "3Q", 1202.025),
}  # fmt: skip


class SignalValues(NamedTuple):
    """None where not available."""

    pseudorange_m: float | None
    carrier_phase_cycles: float | None
    doppler_hz: float | None
    cn0_dbhz: float | None
    lock_time_s: int | None
    half_cycle: bool


def parsed(frame: bytes) -> Any:
    """Return pysbf2's message of one frame."""
    (_, message), *others = SBFReader(io.BytesIO(frame), quitonerror=2)
    assert not others
    return message


def satellite_name_of(svid: int) -> str:
    """Return the name of a satellite; empty for systems that are not used."""
    for letter, first, last in (
        ("G", 1, 37),
        ("E", 71, 106),
        ("C", 141, 180),
        ("J", 181, 190),
        ("R", 38, 61),
    ):
        if first <= svid <= last:
            return f"{letter}{svid - first + 1:02d}"
    if 63 <= svid <= 68:
        return f"R{svid - 38:02d}"
    return f"C{svid - 182:02d}" if 223 <= svid <= 245 else ""


def observations_of(frame: bytes) -> dict[tuple[str, str], SignalValues]:
    """Return the main antenna's signals of used systems in one MeasEpoch, by satellite and signal; the first counts."""
    message = parsed(frame)
    values: dict[tuple[str, str], SignalValues] = {}
    for i in range(1, message.N1 + 1):
        one = _Fields(message, f"_{i:02d}")
        first = _first(one)
        _add(values, one.SVID, one, first)
        for j in range(1, one.N2 + 1):
            other = _Fields(message, f"_{i:02d}_{j:02d}")
            _add(values, one.SVID, other, _further(other, first, _signal(one)))
    return values


class _Fields:
    def __init__(self, message: Any, suffix: str) -> None:
        self._message, self._suffix = message, suffix

    def __getattr__(self, name: str) -> Any:
        return getattr(self._message, name + self._suffix)


def _number(fields: Any) -> int:
    return fields.SigIdxHi + 32 if fields.SigIdxLo == 31 else fields.SigIdxLo


def _signal(fields: Any) -> tuple[str, str, float]:
    letter, code, carrier_mhz = SIGNALS.get(_number(fields), ("", "", 1.0))
    if letter == "R" and code[0] in "12":
        # The frequency channel plus 8, from 1 to 21.
        known = 1 <= fields.SigIdxHi <= 21
        step_mhz = {"1": 0.5625, "2": 0.4375}[code[0]]
        carrier_mhz += (fields.SigIdxHi - 8) * step_mhz if known else math.nan
    return letter, code, carrier_mhz


def _add(values: dict[tuple[str, str], SignalValues], svid: int, fields: Any, observed: SignalValues) -> None:
    satellite, (letter, code, _) = satellite_name_of(svid), _signal(fields)
    if satellite and satellite[0] == letter and fields.AntennaID == 0:
        values.setdefault((satellite, code), observed)


def _cn0(fields: Any) -> float | None:
    if fields.CN0 == 255 * 0.25:
        return None
    return fields.CN0 if _number(fields) in (1, 2) else fields.CN0 + 10.0


def _first(one: Any) -> SignalValues:
    code = one.CodeMSB + one.CodeLSB or None
    missing = one.CarrierMSB == -128 * 65.536 and one.CarrierLSB == 0
    cycles = None if code is None else code * _signal(one)[2] * 1e6 / LIGHT_M_S
    phase = None if missing or cycles is None else cycles + one.CarrierMSB + one.CarrierLSB
    doppler = None if one.Doppler == -(2**31) * 1e-4 else one.Doppler
    lock = None if one.LockTime == 65535 else one.LockTime
    return SignalValues(
        code, phase, doppler, _cn0(one), lock, bool(one.HalfCycleAmbiguity and phase is not None)
    )


def _further(other: Any, first: SignalValues, first_signal: tuple[str, str, float]) -> SignalValues:
    carrier_mhz, first_mhz = _signal(other)[2], first_signal[2]
    code_high, doppler_high = round(other.CodeOffsetMSB / 65.536), round(other.DopplerOffsetMSB / 6.5536)
    code_high -= 8 if code_high > 3 else 0
    doppler_high -= 32 if doppler_high > 15 else 0
    code = phase = doppler = None
    if first.pseudorange_m is not None and not (code_high == -4 and other.CodeOffsetLSB == 0):
        code = first.pseudorange_m + code_high * 65.536 + other.CodeOffsetLSB
    if code is not None and not (other.CarrierMSB == -128 and other.CarrierLSB == 0):
        phase = code * carrier_mhz * 1e6 / LIGHT_M_S + other.CarrierMSB * 65.536 + other.CarrierLSB
    # Without the first carrier the ratio of the Dopplers is not known.
    if (
        first.doppler_hz is not None
        and first_signal[0]
        and not (doppler_high == -16 and other.DopplerOffsetLSB == 0)
    ):
        offset_hz = doppler_high * 6.5536 + other.DopplerOffsetLSB
        doppler = first.doppler_hz * carrier_mhz / first_mhz + offset_hz
    lock = None if other.LockTime == 255 else other.LockTime
    half_cycle = bool(other.HalfCycleAmbiguity and phase is not None)
    return SignalValues(code, phase, doppler, _cn0(other), lock, half_cycle)

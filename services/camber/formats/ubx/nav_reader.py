"""NAV messages of a receiver's own position and baseline, and of what it says of both.

Source: u-blox ZED-F9P, interface description (UBX-18010854): 3.15.5 (NAV-COV), 3.15.7 (NAV-HPPOSLLH), 3.15.13
(NAV-PVT), 3.15.14 (NAV-RELPOSNED); ZED-F9R (UBX-20039643), NAV-PL.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from camber.formats.receiver.solution import SolutionQuality
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc

PVT, HPPOSLLH, COV, RELPOSNED, PL, EOE = 0x07, 0x14, 0x36, 0x3C, 0x62, 0x61
"""Ids of the messages of class NAV that are read."""


class _Layout:
    """Integers of a message by the interface description's names; a name stands for each that is not padding."""

    def __init__(self, form: str, names: str) -> None:
        self._struct = struct.Struct("<" + form)
        self._names = names.split()
        self.size = self._struct.size

    def of(self, payload: bytes) -> dict[str, int]:
        return dict(zip(self._names, self._struct.unpack_from(payload), strict=True))


_OLD_PVT_BYTES, _PVT_BYTES = 84, 92
_PVT = _Layout(
    "4xH6B4xi4B4i2I3i18xH",
    "year month day hour min sec valid nano fixType flags flags2 numSV"
    " lon lat height hMSL hAcc vAcc velN velE velD flags3",
)
_HPPOSLLH = _Layout("B2xB4x4i4b2I", "version flags lon lat height hMSL lonHp latHp heightHp hMSLHp hAcc vAcc")
_RELPOSNED = _Layout(
    "2xH4x3i4xi4x3bx3I4xI4xI",
    "refStationId relPosN relPosE relPosD relPosHeading relPosHPN relPosHPE relPosHPD accN accE accD accHeading flags",
)
_OLD_RELPOSNED = _Layout(
    "2xH4x3i3bx3II",
    "refStationId relPosN relPosE relPosD relPosHPN relPosHPE relPosHPD accN accE accD flags",
)
_PL = _Layout("BBb2B11x3I24x", "version tmirCoeff tmirExp plPosValid plPosFrame plPos1 plPos2 plPos3")
_COV = struct.Struct("<4x3B9x12f")
_UNKNOWN_ACCURACY = 0xFFFFFFFF
# By `lastCorrectionAge`: no correction is older than so many seconds; 12 is older than the last.
_AGES_S = (None, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 120.0)
# `fixType`: 3 is in three dimensions, 4 with dead reckoning; 2, in two, has a height that somebody assumed.
_DEAD_RECKONING = 1
_POSITIONS = (_DEAD_RECKONING, 3, 4)
_LOWEST_M, _HIGHEST_M = -20_000.0, 100_000.0
_Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverBaseline:
    """From the reference station to the rover, as the receiver solved it (NAV-RELPOSNED).

    The vector is None where the receiver says only its direction. `heading_rad` is that of the vector, clockwise from
    north, None where the receiver does not vouch for it.
    """

    time_ns: int
    station_id: int
    quality: SolutionQuality
    moving_base: bool
    baseline_enu_m: _Vector | None
    sigma_enu_m: _Vector | None
    heading_rad: float | None
    heading_sigma_rad: float | None


@dataclass(frozen=True, slots=True)
class ProtectionLevels:
    """NAV-PL: horizontal and vertical, and the probability that one is exceeded. None: not valid."""

    levels_m: tuple[float, float] | None
    risk: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionVelocityTime:
    """NAV-PVT, in the units of `ReceiverSolution`. `near_ns` is its UTC to the second, `nanosecond` the fraction.

    `quality` is None where the receiver has no position, none in three dimensions, or does not vouch for it.
    """

    near_ns: int | None
    nanosecond: int | None
    within_masks: bool
    authenticated: bool
    quality: SolutionQuality | None
    satellites: int
    place: NavPosition
    velocity_enu_m_s: _Vector
    age_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class NavPosition:
    """A position, its horizontal accuracy √(σ_e² + σ_n²) and vertical accuracy, None where they are not known."""

    latitude_rad: float
    longitude_rad: float
    height_m: float
    horizontal_m: float | None
    vertical_m: float | None


@dataclass(frozen=True, slots=True)
class Covariances:
    """Of position and velocity, (ee, en, eu, nn, nu, uu); None where they are not valid."""

    position_m2: EnuCovariance | None
    velocity_m2_s2: EnuCovariance | None


def time_of_week_ms(message_id: int, payload: bytes) -> int:
    """The `iTOW` [ms] of one of the messages that are read; ValueError where it is too short to have one."""
    place = {HPPOSLLH: 4, RELPOSNED: 4, PL: 12}.get(message_id, 0)
    if len(payload) < place + 4:
        raise ValueError(f"{len(payload)} bytes, expected at least {place + 4}")
    return int.from_bytes(payload[place : place + 4], "little")


def read_position_velocity_time(payload: bytes) -> PositionVelocityTime:
    """NAV-PVT, also without its last fields, as receivers of generation 7 send it; ValueError where it is malformed."""
    if len(payload) != _OLD_PVT_BYTES and len(payload) < _PVT_BYTES:
        raise ValueError(f"NAV-PVT of {len(payload)} bytes, expected {_OLD_PVT_BYTES} or {_PVT_BYTES}")
    told = _PVT.of(payload)
    flags, more_flags = told["flags"], told["flags3"] if len(payload) >= _PVT_BYTES else 0
    fix_type, within_masks = told["fixType"], bool(flags & 1)
    quality = None
    if fix_type in _POSITIONS and within_masks and not more_flags & 1:
        quality = _quality(flags >> 6, differential=bool(flags & 2))
        if fix_type == _DEAD_RECKONING:
            quality = SolutionQuality.DEAD_RECKONING
    near_ns = None
    # The date and the time are valid.
    if told["valid"] & 0b11 == 0b11:
        # Which second it is does not matter here, but a leap second must not be one that did not happen.
        day = told["year"], told["month"], told["day"]
        near_ns = gps_ns_from_utc(CalendarTime(*day, told["hour"], told["min"], min(told["sec"], 59)))
    age = more_flags >> 1 & 0b1111
    return PositionVelocityTime(
        near_ns=near_ns,
        nanosecond=told["nano"] if told["valid"] & 0b10 else None,
        within_masks=within_masks,
        authenticated=bool(more_flags >> 14 & 1),
        quality=quality,
        satellites=told["numSV"],
        place=_place(
            told["lat"] / 1e7,
            told["lon"] / 1e7,
            told["height"] / 1e3,
            _accuracy_m(told["hAcc"], 1e3),
            _accuracy_m(told["vAcc"], 1e3),
        ),
        velocity_enu_m_s=(told["velE"] / 1e3, told["velN"] / 1e3, -told["velD"] / 1e3),
        age_s=_AGES_S[age] if age < len(_AGES_S) else None,
    )


def read_baseline(payload: bytes, time_ns: int = 0) -> ReceiverBaseline | None:
    """NAV-RELPOSNED, versions 0 and 1; None where there is no baseline. ValueError where it is malformed."""
    version = payload[0] if payload else None
    layout = _OLD_RELPOSNED if version == 0 else _RELPOSNED
    if version not in (0, 1) or len(payload) != layout.size:
        raise ValueError(f"NAV-RELPOSNED, version {version}, of {len(payload)} bytes")
    told = layout.of(payload)
    flags = told["flags"]
    # The position is within the receiver's masks, and the vector is valid.
    if flags & 0b101 != 0b101:
        return None
    # cm and tenths of mm
    north_m, east_m, down_m = (
        (told[f"relPos{axis}"] * 100 + told[f"relPosHP{axis}"]) / 1e4 for axis in "NED"
    )
    normalized, has_heading = bool(flags & 1 << 9), bool(flags & 1 << 8) and version == 1
    return ReceiverBaseline(
        time_ns=time_ns,
        station_id=told["refStationId"],
        quality=_quality(flags >> 3 & 0b11, differential=bool(flags & 2)),
        moving_base=bool(flags & 1 << 5),
        baseline_enu_m=None if normalized else (east_m, north_m, -down_m),
        sigma_enu_m=None if normalized else (told["accE"] / 1e4, told["accN"] / 1e4, told["accD"] / 1e4),
        heading_rad=math.radians(told["relPosHeading"] / 1e5) if has_heading else None,
        heading_sigma_rad=math.radians(told["accHeading"] / 1e5) if has_heading else None,
    )


def read_protection_levels(payload: bytes) -> ProtectionLevels:
    """NAV-PL, version 1; ValueError where it is malformed.

    The horizontal level is a circle's radius: of two levels along two axes √(a² + b²), of an ellipse its longer axis.
    """
    if len(payload) != _PL.size or payload[0] != 1:
        raise ValueError(f"NAV-PL of {len(payload)} bytes, expected {_PL.size} and version 1")
    told = _PL.of(payload)
    # Percent of misleading information per epoch and axis.
    risk = told["tmirCoeff"] * 10.0 ** told["tmirExp"] / 100.0
    if told["plPosValid"] != 1 or told["plPosFrame"] not in (1, 2, 3):
        return ProtectionLevels(None, None)
    first_m, second_m = told["plPos1"] / 1e3, told["plPos2"] / 1e3
    horizontal_m = max(first_m, second_m) if told["plPosFrame"] == 3 else math.hypot(first_m, second_m)
    return ProtectionLevels((horizontal_m, told["plPos3"] / 1e3), risk if 0.0 < risk <= 1.0 else None)


def _quality(carrier: int, *, differential: bool) -> SolutionQuality:
    if carrier == 2:
        return SolutionQuality.FIX
    if carrier == 1:
        return SolutionQuality.FLOAT
    return SolutionQuality.DGPS if differential else SolutionQuality.SINGLE


def _place(
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    horizontal_m: float | None,
    vertical_m: float | None,
) -> NavPosition:
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0 or not _LOWEST_M <= height_m <= _HIGHEST_M:
        raise ValueError(f"position {latitude_deg}°, {longitude_deg}°, {height_m} m")
    return NavPosition(
        latitude_rad=math.radians(latitude_deg),
        longitude_rad=math.radians(longitude_deg),
        height_m=height_m,
        horizontal_m=horizontal_m,
        vertical_m=vertical_m,
    )


def _accuracy_m(value: int, per_m: float) -> float | None:
    """None for all ones and for zero, which no receiver means."""
    return value / per_m if 0 < value < _UNKNOWN_ACCURACY else None


def read_high_precision_position(payload: bytes) -> NavPosition | None:
    """NAV-HPPOSLLH; None where the receiver calls it invalid. ValueError where it is malformed."""
    if len(payload) != _HPPOSLLH.size or payload[0] != 0:
        raise ValueError(f"NAV-HPPOSLLH of {len(payload)} bytes, expected {_HPPOSLLH.size} and version 0")
    told = _HPPOSLLH.of(payload)
    if told["flags"] & 1:
        return None
    return _place(
        (told["lat"] * 100 + told["latHp"]) / 1e9,
        (told["lon"] * 100 + told["lonHp"]) / 1e9,
        (told["height"] * 10 + told["heightHp"]) / 1e4,
        _accuracy_m(told["hAcc"], 1e4),
        _accuracy_m(told["vAcc"], 1e4),
    )


def read_covariances(payload: bytes) -> Covariances:
    """NAV-COV, turned from north, east, down; ValueError where it is malformed or no covariance."""
    if len(payload) != _COV.size or payload[4] != 0:
        raise ValueError(f"NAV-COV of {len(payload)} bytes, expected {_COV.size} and version 0")
    _, position_valid, velocity_valid, *values = _COV.unpack(payload)
    return Covariances(
        _enu_from_ned(values[:6]) if position_valid == 1 else None,
        _enu_from_ned(values[6:]) if velocity_valid == 1 else None,
    )


def _enu_from_ned(covariance: list[float]) -> EnuCovariance | None:
    """None where all is zero; ValueError where it is no covariance, beyond the rounding of the message's floats."""
    nn, ne, nd, ee, ed, dd = covariance
    matrix = np.array([[ee, ne, -ed], [ne, nn, -nd], [-ed, -nd, dd]])
    trace = nn + ee + dd
    if not (np.isfinite(matrix).all() and min(nn, ee, dd) >= 0.0 and trace < 1e18):
        raise ValueError(f"covariance {covariance}")
    if trace == 0.0:
        return None
    if np.linalg.eigvalsh(matrix)[0] < -1e-6 * trace:
        raise ValueError(f"covariance {covariance} is not positive semidefinite")
    return ee, ne, -ed, nn, -nd, dd

"""NAV messages: the receiver's position, velocity, time, baseline, covariances and protection levels.

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
"""Ids of the supported messages of class NAV."""


class _MessageLayout:
    """Integers of a message by the interface description's names; one name for each that is not padding."""

    def __init__(self, form: str, names: str) -> None:
        self._struct = struct.Struct("<" + form)
        self._names = names.split()
        self.size = self._struct.size

    def unpack(self, payload: bytes) -> dict[str, int]:
        return dict(zip(self._names, self._struct.unpack_from(payload), strict=True))


_OLD_PVT_BYTES, _PVT_BYTES = 84, 92
_PVT = _MessageLayout(
    "4xH6B4xi4B4i2I3i18xH",
    "year month day hour min sec valid nano fixType flags flags2 numSV"
    " lon lat height hMSL hAcc vAcc velN velE velD flags3",
)
_HPPOSLLH = _MessageLayout(
    "B2xB4x4i4b2I", "version flags lon lat height hMSL lonHp latHp heightHp hMSLHp hAcc vAcc"
)
_RELPOSNED = _MessageLayout(
    "2xH4x3i4xi4x3bx3I4xI4xI",
    "refStationId relPosN relPosE relPosD relPosHeading relPosHPN relPosHPE relPosHPD accN accE accD accHeading flags",
)
_OLD_RELPOSNED = _MessageLayout(
    "2xH4x3i3bx3II",
    "refStationId relPosN relPosE relPosD relPosHPN relPosHPE relPosHPD accN accE accD flags",
)
_PL = _MessageLayout("BBb2B11x3I24x", "version tmirCoeff tmirExp plPosValid plPosFrame plPos1 plPos2 plPos3")
_COV = struct.Struct("<4x3B9x12f")
UNKNOWN_ACCURACY = 0xFFFFFFFF  # reported by receivers; the interface description does not define it
AGES_S = (math.nan, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 120.0)
"""Greatest age by `lastCorrectionAge`; 0 is "not available", 12 is older than the last."""
# `fixType`: 3 is 3D, 4 GNSS with dead reckoning; 2, 2D, has an assumed height.
_DEAD_RECKONING = 1
_POSITION_TYPES = (_DEAD_RECKONING, 3, 4)
_MIN_HEIGHT_M, _MAX_HEIGHT_M = -20_000.0, 100_000.0
_Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverBaseline:
    """Vector from the base station to the rover, solved by the receiver (NAV-RELPOSNED).

    The vector is None where the receiver reports only its direction. `heading_rad` is that of the vector, clockwise
    from north, None where the receiver reports it as invalid.
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
    """NAV-PL: horizontal and vertical level, and the probability that one is exceeded. None: invalid."""

    levels_m: tuple[float, float] | None
    risk: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class NavPosition:
    """A position, its horizontal accuracy √(σ_e² + σ_n²) and vertical accuracy, None where unknown."""

    latitude_rad: float
    longitude_rad: float
    height_m: float
    horizontal_m: float | None
    vertical_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionVelocityTime:
    """NAV-PVT, in the units of `ReceiverSolution`. `near_ns` is its UTC to the second, `nanosecond` the fraction.

    `quality` is None where the receiver has no valid position in three dimensions.
    """

    near_ns: int | None
    nanosecond: int | None
    within_masks: bool
    authenticated: bool
    quality: SolutionQuality | None
    satellites: int
    position: NavPosition
    velocity_enu_m_s: _Vector
    age_s: float | None


@dataclass(frozen=True, slots=True)
class Covariances:
    """Covariances (ee, en, eu, nn, nu, uu) of position and velocity; None where invalid."""

    position_m2: EnuCovariance | None
    velocity_m2_s2: EnuCovariance | None


def time_of_week_ms(message_id: int, payload: bytes) -> int:
    """Return the `iTOW` [ms] of a supported message; ValueError where it is too short to have one."""
    offset = {HPPOSLLH: 4, RELPOSNED: 4, PL: 12}.get(message_id, 0)
    if len(payload) < offset + 4:
        raise ValueError(f"{len(payload)} bytes, expected at least {offset + 4}")
    return int.from_bytes(payload[offset : offset + 4], "little")


def read_position_velocity_time(payload: bytes) -> PositionVelocityTime:
    """Decode NAV-PVT, also without its last fields (receivers of generation 7); ValueError where malformed."""
    if len(payload) != _OLD_PVT_BYTES and len(payload) < _PVT_BYTES:
        raise ValueError(f"NAV-PVT of {len(payload)} bytes, expected {_OLD_PVT_BYTES} or {_PVT_BYTES}")
    values = _PVT.unpack(payload)
    flags, flags3 = values["flags"], values["flags3"] if len(payload) >= _PVT_BYTES else 0
    fix_type, within_masks = values["fixType"], bool(flags & 1)
    quality = None
    if fix_type in _POSITION_TYPES and within_masks and not flags3 & 1:
        quality = _quality(flags >> 6, differential=bool(flags & 2))
        if fix_type == _DEAD_RECKONING:
            quality = SolutionQuality.DEAD_RECKONING
    near_ns = None
    # The date and the time are valid.
    if values["valid"] & 0b11 == 0b11:
        # The exact second does not matter here, but a leap second that did not exist would raise.
        day = values["year"], values["month"], values["day"]
        near_ns = gps_ns_from_utc(CalendarTime(*day, values["hour"], values["min"], min(values["sec"], 59)))
    age = flags3 >> 1 & 0b1111
    return PositionVelocityTime(
        near_ns=near_ns,
        nanosecond=values["nano"] if values["valid"] & 0b10 else None,
        within_masks=within_masks,
        authenticated=bool(flags3 >> 14 & 1),
        quality=quality,
        satellites=values["numSV"],
        position=_position(
            latitude_deg=values["lat"] / 1e7,
            longitude_deg=values["lon"] / 1e7,
            height_m=values["height"] / 1e3,
            horizontal_m=_accuracy_m(values["hAcc"], 1e3),
            vertical_m=_accuracy_m(values["vAcc"], 1e3),
        ),
        velocity_enu_m_s=(values["velE"] / 1e3, values["velN"] / 1e3, -values["velD"] / 1e3),
        age_s=AGES_S[age] if 0 < age < len(AGES_S) else None,
    )


def read_baseline(payload: bytes) -> ReceiverBaseline | None:
    """Decode NAV-RELPOSNED, versions 0 and 1, with `time_ns` 0; None without a baseline. ValueError where malformed."""
    version = payload[0] if payload else None
    layout = _OLD_RELPOSNED if version == 0 else _RELPOSNED
    if version not in (0, 1) or len(payload) != layout.size:
        raise ValueError(f"NAV-RELPOSNED, version {version}, of {len(payload)} bytes")
    values = layout.unpack(payload)
    flags = values["flags"]
    # The position is within the receiver's masks, and the vector is valid.
    if flags & 0b101 != 0b101:
        return None
    # cm and tenths of mm
    north_m, east_m, down_m = (
        (values[f"relPos{axis}"] * 100 + values[f"relPosHP{axis}"]) / 1e4 for axis in "NED"
    )
    sigma_enu_m = values["accE"] / 1e4, values["accN"] / 1e4, values["accD"] / 1e4
    normalized, has_heading = bool(flags & 1 << 9), bool(flags & 1 << 8) and version == 1
    return ReceiverBaseline(
        time_ns=0,
        station_id=values["refStationId"],
        quality=_quality(flags >> 3 & 0b11, differential=bool(flags & 2)),
        moving_base=bool(flags & 1 << 5),
        baseline_enu_m=None if normalized else (east_m, north_m, -down_m),
        sigma_enu_m=None if normalized else sigma_enu_m,
        heading_rad=math.radians(values["relPosHeading"] / 1e5) if has_heading else None,
        heading_sigma_rad=math.radians(values["accHeading"] / 1e5) if has_heading else None,
    )


def read_protection_levels(payload: bytes) -> ProtectionLevels:
    """Decode NAV-PL, version 1; ValueError where it is malformed.

    The horizontal level is the radius of a circle: √(a² + b²) of levels along two axes, the longer axis of an ellipse.
    """
    if len(payload) != _PL.size or payload[0] != 1:
        raise ValueError(f"NAV-PL of {len(payload)} bytes, expected {_PL.size} and version 1")
    values = _PL.unpack(payload)
    # Percent of misleading information per epoch and axis.
    risk = values["tmirCoeff"] * 10.0 ** values["tmirExp"] / 100.0
    if values["plPosValid"] != 1 or values["plPosFrame"] not in (1, 2, 3):
        return ProtectionLevels(None, None)
    first_m, second_m = values["plPos1"] / 1e3, values["plPos2"] / 1e3
    horizontal_m = max(first_m, second_m) if values["plPosFrame"] == 3 else math.hypot(first_m, second_m)
    return ProtectionLevels((horizontal_m, values["plPos3"] / 1e3), risk if 0.0 < risk <= 1.0 else None)


def read_high_precision_position(payload: bytes) -> NavPosition | None:
    """Decode NAV-HPPOSLLH; None where the receiver reports it as invalid. ValueError where it is malformed."""
    if len(payload) != _HPPOSLLH.size or payload[0] != 0:
        raise ValueError(f"NAV-HPPOSLLH of {len(payload)} bytes, expected {_HPPOSLLH.size} and version 0")
    values = _HPPOSLLH.unpack(payload)
    if values["flags"] & 1:
        return None
    return _position(
        latitude_deg=(values["lat"] * 100 + values["latHp"]) / 1e9,
        longitude_deg=(values["lon"] * 100 + values["lonHp"]) / 1e9,
        height_m=(values["height"] * 10 + values["heightHp"]) / 1e4,
        horizontal_m=_accuracy_m(values["hAcc"], 1e4),
        vertical_m=_accuracy_m(values["vAcc"], 1e4),
    )


def read_covariances(payload: bytes) -> Covariances:
    """Decode NAV-COV, rotated from north, east, down; ValueError where it is malformed or not a covariance."""
    if len(payload) != _COV.size or payload[4] != 0:
        raise ValueError(f"NAV-COV of {len(payload)} bytes, expected {_COV.size} and version 0")
    _, position_valid, velocity_valid, *values = _COV.unpack(payload)
    return Covariances(
        _enu_from_ned(values[:6]) if position_valid == 1 else None,
        _enu_from_ned(values[6:]) if velocity_valid == 1 else None,
    )


def _quality(carrier: int, *, differential: bool) -> SolutionQuality:
    if carrier == 2:
        return SolutionQuality.FIX
    if carrier == 1:
        return SolutionQuality.FLOAT
    return SolutionQuality.DGPS if differential else SolutionQuality.SINGLE


def _position(
    *,
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    horizontal_m: float | None,
    vertical_m: float | None,
) -> NavPosition:
    in_range = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0
    if not (in_range and _MIN_HEIGHT_M <= height_m <= _MAX_HEIGHT_M):
        raise ValueError(f"position {latitude_deg}°, {longitude_deg}°, {height_m} m")
    return NavPosition(
        latitude_rad=math.radians(latitude_deg),
        longitude_rad=math.radians(longitude_deg),
        height_m=height_m,
        horizontal_m=horizontal_m,
        vertical_m=vertical_m,
    )


def _accuracy_m(value: int, per_m: float) -> float | None:
    """Return the accuracy; None for all ones and for zero, which no receiver means."""
    return value / per_m if 0 < value < UNKNOWN_ACCURACY else None


def _enu_from_ned(covariance: list[float]) -> EnuCovariance | None:
    """Rotate; None for all zeros; ValueError for no covariance, beyond the rounding of the message's floats."""
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

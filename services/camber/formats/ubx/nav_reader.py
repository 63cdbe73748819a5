"""NAV messages: the receiver's position, velocity, time, baseline, covariances, protection levels and satellites.

Source: u-blox ZED-F9P, interface description (UBX-18010854): 3.15.5 (NAV-COV), 3.15.7 (NAV-HPPOSLLH), 3.15.13
(NAV-PVT), 3.15.14 (NAV-RELPOSNED); ZED-F9R (UBX-20039643), NAV-PL.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from camber.formats.receiver.reported_covariance import reported_covariance
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import (
    Fields,
    ReceiverSolution,
    SolutionQuality,
    checked_position,
    covariance_from_accuracies,
)
from camber.formats.ubx.gps_week import navigation_time_ns, resolve_week_rollover
from camber.formats.ubx.satellite_reader import NavSatellites, read_satellites
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc

PVT, HPPOSLLH, SAT, COV, RELPOSNED, PL, EOE = 0x07, 0x14, 0x35, 0x36, 0x3C, 0x62, 0x61
"""Ids of the supported messages of class NAV."""


class _MessageLayout:
    """Values of a message by the interface description's names; one name for each that is not padding."""

    def __init__(self, form: str, names: str, version: int = 0) -> None:
        self._struct = struct.Struct("<" + form)
        self._names = names.split()
        self._version = version

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Return the values; ValueError for another length or version."""
        if len(payload) == self._struct.size:
            values = dict(zip(self._names, self._struct.unpack(payload), strict=True))
            if values.get("version", self._version) == self._version:
                return values
        expected = f"{self._struct.size} and version {self._version}"
        raise ValueError(f"message of {len(payload)} bytes, expected {expected}")


_OLD_PVT_BYTES, _PVT_BYTES = 84, 92
_PVT = _MessageLayout(
    "4xH6B4xi4B4i2I3i18xH12x",
    "year month day hour min sec valid nano fixType flags flags2 numSV"
    " lon lat height hMSL hAcc vAcc velN velE velD flags3",
)
_HPPOSLLH = _MessageLayout(
    "B2xB4x4i4b2I", "version flags lon lat height hMSL lonHp latHp heightHp hMSLHp hAcc vAcc"
)
_RELPOSNED = _MessageLayout(
    "BxH4x3i4xi4x3bx3I4xI4xI",
    "version refStationId relPosN relPosE relPosD relPosHeading relPosHPN relPosHPE relPosHPD"
    " accN accE accD accHeading flags",
    version=1,
)
_OLD_RELPOSNED = _MessageLayout(
    "BxH4x3i3bx3II",
    "version refStationId relPosN relPosE relPosD relPosHPN relPosHPE relPosHPD accN accE accD flags",
)
_PL = _MessageLayout(
    "BBb2B11x3I24x", "version tmirCoeff tmirExp plPosValid plPosFrame plPos1 plPos2 plPos3", version=1
)
_COV = _MessageLayout(
    "4x3B9x12f",
    "version posCovValid velCovValid posNN posNE posND posEE posED posDD velNN velNE velND velEE velED velDD",
)
UNKNOWN_ACCURACY = 0xFFFFFFFF  # reported by receivers; the interface description does not define it
AGES_S = (math.nan, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 120.0)
"""Greatest age by `lastCorrectionAge`; 0 is "not available", 12 is older than the last."""
# `fixType`: 3 is 3D, 4 GNSS with dead reckoning; 2, 2D, has an assumed height.
_DEAD_RECKONING = 1
_POSITION_TYPES = (_DEAD_RECKONING, 3, 4)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionVelocityTime:
    """NAV-PVT. `near_ns` is its UTC to the second, `nanosecond` the fraction; `integrity` what it says of the fix.

    `solution` is empty where the receiver has no valid position in three dimensions.
    """

    near_ns: int | None
    nanosecond: int | None
    integrity: Fields
    solution: Fields


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
    values = _PVT.unpack(payload[:_PVT_BYTES].ljust(_PVT_BYTES, b"\0"))
    flags, flags3 = values["flags"], values["flags3"] if len(payload) >= _PVT_BYTES else 0
    fix_type, within_masks = values["fixType"], bool(flags & 1)
    near_ns = None
    # The date and the time are valid.
    if values["valid"] & 0b11 == 0b11:
        # The exact second does not matter here, but a leap second that did not exist would raise.
        day = values["year"], values["month"], values["day"]
        near_ns = gps_ns_from_utc(CalendarTime(*day, values["hour"], values["min"], min(values["sec"], 59)))
    age = flags3 >> 1 & 0b1111
    solution = _position(values, [values[name] for name in ("lat", "lon", "height")], 1e7, 1e3)
    solution |= {
        "quality": _quality(flags >> 6, differential=bool(flags & 2)),
        "satellites": values["numSV"],
        "velocity_enu_m_s": (values["velE"] / 1e3, values["velN"] / 1e3, -values["velD"] / 1e3),
        "age_s": AGES_S[age] if 0 < age < len(AGES_S) else None,
    }
    if fix_type == _DEAD_RECKONING:
        solution["quality"] = SolutionQuality.DEAD_RECKONING
    return PositionVelocityTime(
        near_ns=near_ns,
        nanosecond=values["nano"] if values["valid"] & 0b10 else None,
        # Not authenticated is unknown: receivers that cannot check report the same.
        integrity={
            "fix_within_masks": "yes" if within_masks else "no",
            "authenticated": "yes" if flags3 >> 14 & 1 else "unknown",
        },
        solution=solution if fix_type in _POSITION_TYPES and within_masks and not flags3 & 1 else {},
    )


def read_baseline(payload: bytes) -> ReceiverBaseline | None:
    """Decode NAV-RELPOSNED, versions 0 and 1, with `time_ns` 0; None without a baseline. ValueError where malformed."""
    values = (_OLD_RELPOSNED if payload[:1] == b"\0" else _RELPOSNED).unpack(payload)
    flags = values["flags"]
    # The position is within the receiver's masks, and the vector is valid.
    if flags & 0b101 != 0b101:
        return None
    # cm and tenths of mm
    north_m, east_m, down_m = (
        (values[f"relPos{axis}"] * 100 + values[f"relPosHP{axis}"]) / 1e4 for axis in "NED"
    )
    sigma_enu_m = values["accE"] / 1e4, values["accN"] / 1e4, values["accD"] / 1e4
    normalized, has_heading = bool(flags & 1 << 9), bool(flags & 1 << 8) and values["version"] == 1
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


def read_protection_levels(payload: bytes) -> Fields:
    """Decode NAV-PL, version 1, to fields of `ReceiverIntegrity`; ValueError where it is malformed.

    The horizontal level is the radius of a circle: √(a² + b²) of levels along two axes, the longer axis of an ellipse.
    """
    values = _PL.unpack(payload)
    # Percent of misleading information per epoch and axis.
    risk = values["tmirCoeff"] * 10.0 ** values["tmirExp"] / 100.0
    horizontal_m = vertical_m = None
    if values["plPosValid"] == 1 and values["plPosFrame"] in (1, 2, 3):
        first_m, second_m, vertical_m = (values[f"plPos{axis}"] / 1e3 for axis in (1, 2, 3))
        horizontal_m = max(first_m, second_m) if values["plPosFrame"] == 3 else math.hypot(first_m, second_m)
    return {
        "horizontal_protection_level_m": horizontal_m,
        "vertical_protection_level_m": vertical_m,
        "integrity_risk": risk if horizontal_m is not None and 0.0 < risk <= 1.0 else None,
    }


def read_high_precision_position(payload: bytes) -> Fields:
    """Decode NAV-HPPOSLLH; empty where the receiver reports it as invalid. ValueError where it is malformed."""
    values = _HPPOSLLH.unpack(payload)
    if values["flags"] & 1:
        return {}
    units = (("lat", 100), ("lon", 100), ("height", 10))
    return _position(values, [values[name] * unit + values[f"{name}Hp"] for name, unit in units], 1e9, 1e4)


def read_covariances(payload: bytes) -> Fields:
    """Decode the valid covariances of NAV-COV; ValueError where it is malformed or not a covariance."""
    values = _COV.unpack(payload)
    kinds = (("pos", "covariance_enu_m2"), ("vel", "velocity_covariance_enu_m2_s2"))
    covariances = {
        field: _enu_from_ned([values[kind + axes] for axes in ("NN", "NE", "ND", "EE", "ED", "DD")])
        for kind, field in kinds
        if values[f"{kind}CovValid"] == 1
    }
    return {field: covariance for field, covariance in covariances.items() if covariance is not None}


class NavigationEpoch:
    """The messages received so far with one `iTOW`."""

    def __init__(self, of_week_ms: int) -> None:
        self.of_week_ms = of_week_ms
        self.integrity: dict[str, Fields] = {}
        """What NAV-PVT (`fix`) and NAV-PL (`protection`) say."""
        self.baseline: ReceiverBaseline | None = None
        """Its time is not set yet."""
        self.satellites: NavSatellites | None = None
        self._pvt: PositionVelocityTime | None = None
        self._high_precision: Fields = {}
        self._covariances: Fields = {}

    def take(self, message_id: int, payload: bytes) -> None:
        """Decode one message of this epoch; ValueError where it is malformed."""
        if message_id == PVT:
            self._pvt = read_position_velocity_time(payload)
            self.integrity["fix"] = self._pvt.integrity
        elif message_id == HPPOSLLH:
            self._high_precision = read_high_precision_position(payload)
        elif message_id == COV:
            self._covariances = read_covariances(payload)
        elif message_id == PL:
            self.integrity["protection"] = read_protection_levels(payload)
        elif message_id == SAT:
            self.satellites = read_satellites(payload)
        else:
            self.baseline = read_baseline(payload)

    def time_ns(self, near_ns: int | None, reference_ns: int | None) -> int | None:
        """Return the time to ms, with NAV-PVT to ns; None where the week is unknown. ValueError for impossible times.

        Without a date the week is nearest to `near_ns`; a date may be wrong by whole roll-overs, which `reference_ns`
        resolves.
        """
        if self._pvt is not None and self._pvt.near_ns is not None:
            near_ns = resolve_week_rollover(self._pvt.near_ns, reference_ns)
        if near_ns is None:
            return None
        return navigation_time_ns(self.of_week_ms, near_ns, self._pvt.nanosecond if self._pvt else None)

    @property
    def lacks_position(self) -> bool:
        """Whether the receiver has no valid position, or reports one without NAV-PVT, which contains its quality."""
        return bool(self._high_precision) if self._pvt is None else not self._pvt.solution

    def satellite_report(self, time_ns: int) -> SatelliteReport | None:
        """Return the satellites of NAV-SAT; None without NAV-PVT, which contains whether there is a position."""
        if self._pvt is None or self.satellites is None:
            return None
        quality = self._pvt.solution.get("quality")
        return SatelliteReport(time_ns=time_ns, quality=quality, satellites=self.satellites.satellites)

    def solution(self, time_ns: int) -> ReceiverSolution | None:
        """Return the position of NAV-PVT, with what NAV-HPPOSLLH and then NAV-COV know better."""
        if self._pvt is None or not self._pvt.solution:
            return None
        better = {**self._high_precision, **self._covariances}
        return ReceiverSolution(time_ns=time_ns, **(self._pvt.solution | better))


def _quality(carrier: int, *, differential: bool) -> SolutionQuality:
    if carrier == 2:
        return SolutionQuality.FIX
    if carrier == 1:
        return SolutionQuality.FLOAT
    return SolutionQuality.DGPS if differential else SolutionQuality.SINGLE


def _position(
    values: Mapping[str, int], coordinates: Sequence[int], per_degree: float, per_m: float
) -> Fields:
    """Return latitude, longitude and height, with the covariance that `hAcc` and `vAcc` allow to assume.

    `hAcc` is √(σ_e² + σ_n²) (checked against NAV-COV in recordings). All ones, and zero, which no receiver means,
    are unknown.
    """
    position = checked_position(
        math.radians(coordinates[0] / per_degree),
        math.radians(coordinates[1] / per_degree),
        coordinates[2] / per_m,
    )
    covariance = None
    if all(0 < values[name] < UNKNOWN_ACCURACY for name in ("hAcc", "vAcc")):
        covariance = covariance_from_accuracies(values["hAcc"] / per_m, values["vAcc"] / per_m)
    return {**position, "covariance_enu_m2": covariance}


def _enu_from_ned(covariance: list[float]) -> EnuCovariance | None:
    nn, ne, nd, ee, ed, dd = covariance
    return reported_covariance((ee, ne, -ed, nn, -nd, dd))

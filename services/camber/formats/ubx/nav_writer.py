"""NAV-PVT and NAV-HPPOSLLH: a receiver's position as UBX messages.

Source: u-blox ZED-F9P, interface description (UBX-18010854), 3.15.13 (NAV-PVT), 3.15.7 (NAV-HPPOSLLH).
"""

from __future__ import annotations

import math
import struct

from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ubx.nav_reader import AGES_S, HPPOSLLH, PVT, UNKNOWN_ACCURACY
from camber.formats.ubx.writer import ubx_frame
from camber.geodesy.angles import heading_from_yaw
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import utc_from_gps_ns, week_tow_from_gps_ns

_UNKNOWN_DOP = 9999  # 99.99, as receivers report it
_NS_PER_MS = 1_000_000  # unit
_MAX_HEADING_ACCURACY = 18_000_000  # 180° in units of 1e-5°
_DIFFERENTIAL = (SolutionQuality.FIX, SolutionQuality.FLOAT, SolutionQuality.SBAS, SolutionQuality.DGPS)
_CARRIER = {SolutionQuality.FLOAT: 1, SolutionQuality.FIX: 2}


def format_position_velocity_time(solution: ReceiverSolution, *, geoid_separation_m: float) -> bytes:
    """Encode NAV-PVT: position to 1e-7° and mm, velocity to mm/s.

    `hAcc` is √(σ_e² + σ_n²), `vAcc` σ_u, all ones where unknown; the dilution of precision is unknown, the time
    accuracy 1 ms. ValueError where a number is not finite.
    """
    utc = utc_from_gps_ns(solution.time_ns)
    east, north, up = solution.velocity_enu_m_s or (0.0, 0.0, 0.0)
    speed_accuracy, heading_accuracy = UNKNOWN_ACCURACY, _MAX_HEADING_ACCURACY
    ground_m_s = math.hypot(east, north)
    if solution.velocity_enu_m_s is not None and solution.velocity_covariance_enu_m2_s2 is not None:
        ee, _, _, nn, _, uu = solution.velocity_covariance_enu_m2_s2
        speed_accuracy = _positive(math.sqrt(ee + nn + uu) * 1e3)
        if ground_m_s > 0.0:
            sigma_deg = math.degrees(math.sqrt(ee + nn) / ground_m_s)
            heading_accuracy = round(min(sigma_deg * 1e5, heading_accuracy))  # infinite at a subnormal speed
    heading = 0
    if ground_m_s > 0.0:
        heading = _scaled(math.degrees(heading_from_yaw(math.atan2(north, east))) % 360.0, 1e5)
    dead_reckoning = solution.quality is SolutionQuality.DEAD_RECKONING
    flags = 0b1 | (0b10 if solution.quality in _DIFFERENTIAL else 0) | _CARRIER.get(solution.quality, 0) << 6
    age = 0 if solution.age_s is None else 1 + sum(solution.age_s >= limit for limit in AGES_S[1:-1])
    payload = struct.pack(
        "<IH5BBIiBBBBiiiiIIiiiiiIIHH4xihH",
        _time_of_week_ms(solution.time_ns),
        *(utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second),
        0b0111,  # date and time are valid and fully resolved
        *(_NS_PER_MS, utc.nanosecond, 1 if dead_reckoning else 3, flags),
        0b1110_0000,  # date and time are confirmed
        solution.satellites or 0,
        _scaled(math.degrees(solution.longitude_rad), 1e7),
        _scaled(math.degrees(solution.latitude_rad), 1e7),
        _scaled(solution.height_m, 1e3),
        _scaled(solution.height_m - geoid_separation_m, 1e3),
        *_accuracies(solution.covariance_enu_m2, 1e3),
        *(_scaled(value, 1e3) for value in (north, east, -up, ground_m_s)),
        *(heading, speed_accuracy, heading_accuracy, _UNKNOWN_DOP, age << 1, heading),
        *(0, 0),  # magnetic declination
    )
    return ubx_frame(0x01, PVT, payload)


def format_high_precision_position(solution: ReceiverSolution, *, geoid_separation_m: float) -> bytes:
    """Encode NAV-HPPOSLLH: latitude and longitude to 1e-9°, heights and accuracies to 0.1 mm; else as NAV-PVT."""
    longitude, longitude_hp = divmod(_scaled(math.degrees(solution.longitude_rad), 1e9), 100)
    latitude, latitude_hp = divmod(_scaled(math.degrees(solution.latitude_rad), 1e9), 100)
    height, height_hp = divmod(_scaled(solution.height_m, 1e4), 10)
    altitude, altitude_hp = divmod(_scaled(solution.height_m - geoid_separation_m, 1e4), 10)
    payload = struct.pack(
        "<B3xIiiiibbbbII",
        0,
        _time_of_week_ms(solution.time_ns),
        *(longitude, latitude, height, altitude),
        *(longitude_hp, latitude_hp, height_hp, altitude_hp),
        *_accuracies(solution.covariance_enu_m2, 1e4),
    )
    return ubx_frame(0x01, HPPOSLLH, payload)


def _time_of_week_ms(time_ns: int) -> int:
    return week_tow_from_gps_ns(time_ns)[1] // _NS_PER_MS


def _accuracies(covariance: EnuCovariance | None, per_m: float) -> tuple[int, int]:
    if covariance is None:
        return UNKNOWN_ACCURACY, UNKNOWN_ACCURACY
    ee, _, _, nn, _, uu = covariance
    return _positive(math.sqrt(ee + nn) * per_m), _positive(math.sqrt(uu) * per_m)


def _positive(value: float) -> int:
    return min(max(_scaled(value, 1.0), 1), UNKNOWN_ACCURACY - 1)


def _scaled(value: float, per_unit: float) -> int:
    if not math.isfinite(value):
        raise ValueError(f"value is {value}, expected a finite number")
    return round(value * per_unit)

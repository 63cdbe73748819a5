"""GGA, GST and RMC sentences of a receiver's solution.

Source: NMEA 0183 v4.11, 6.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pynmeagps.nmeahelpers import calc_checksum

from camber.formats.nmea.sentences import QUALITY_FROM_NMEA
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.angles import heading_from_yaw
from camber.geodesy.covariance import error_ellipse, horizontal_from_enu
from camber.geodesy.gps_time import NS_PER_SECOND, decimal_from_nanoseconds, utc_from_gps_ns

_KNOT_M_S = 1852.0 / 3600.0  # exact
_NMEA_FROM_QUALITY = {quality: number for number, quality in QUALITY_FROM_NMEA.items()} | {
    SolutionQuality.SBAS: 2
}
_RMC_MODE = {
    SolutionQuality.FIX: "R",
    SolutionQuality.FLOAT: "F",
    SolutionQuality.SBAS: "D",
    SolutionQuality.DGPS: "D",
    SolutionQuality.SINGLE: "A",
    SolutionQuality.PPP: "P",
    SolutionQuality.DEAD_RECKONING: "E",
}
_MINUTE_DECIMALS = 7  # 1e-7 minutes are 0.2 mm
# Probability of the ellipse whose semi-axes are the standard deviations: C = 1.
_ONE_SIGMA_PROBABILITY = 1.0 - math.exp(-0.5)


def format_gga(solution: ReceiverSolution, *, geoid_separation_m: float) -> bytes:
    """Return GGA with altitude = ellipsoidal height − geoid separation, to 0.1 mm; unknown fields are empty.

    SBAS becomes 2 (DGPS), as NMEA does not distinguish them; there is no field for the ratio. ValueError for numbers
    that are not finite.
    """
    fields = (
        _time(solution.time_ns),
        *_position(solution),
        str(_NMEA_FROM_QUALITY[solution.quality]),
        "" if solution.satellites is None else f"{solution.satellites:02d}",
        "",
        _decimal(solution.height_m - geoid_separation_m, 4),
        "M",
        _decimal(geoid_separation_m, 4),
        "M",
        "" if solution.age_s is None else _decimal(solution.age_s, 2),
        "",
    )
    return _sentence("GNGGA", fields)


def format_gst(solution: ReceiverSolution) -> bytes:
    """Return GST with one-σ error ellipse and deviations; all empty when the covariance is unknown.

    The sentence has no horizontal-vertical terms of the covariance.
    """
    values = [""] * 7
    if solution.covariance_enu_m2 is not None:
        ee, _, _, nn, _, uu = solution.covariance_enu_m2
        ellipse = error_ellipse(horizontal_from_enu(solution.covariance_enu_m2), _ONE_SIGMA_PROBABILITY)
        # An axis has two directions: a heading below 180° is enough.
        orientation_deg = math.degrees(heading_from_yaw(ellipse.orientation_rad)) % 180.0
        numbers = (ellipse.semi_major_m, ellipse.semi_minor_m, orientation_deg)
        deviations = (math.sqrt(nn), math.sqrt(ee), math.sqrt(uu))
        # A known deviation is never printed as zero, which readers take as unknown.
        values = ["", *(_decimal(v, 4) for v in numbers), *(_decimal(max(v, 1e-4), 4) for v in deviations)]
    return _sentence("GNGST", (_time(solution.time_ns), *values))


def format_rmc(solution: ReceiverSolution) -> bytes:
    """Return RMC with the date and, where the velocity is known, speed [knots] and course over ground [deg]."""
    utc = utc_from_gps_ns(solution.time_ns)
    speed = course = ""
    if solution.velocity_enu_m_s is not None:
        east, north, _ = solution.velocity_enu_m_s
        speed = _decimal(math.hypot(east, north) / _KNOT_M_S, 4)
        course = _decimal(math.degrees(heading_from_yaw(math.atan2(north, east))), 2)
    day = f"{utc.day:02d}{utc.month:02d}{utc.year % 100:02d}"
    mode = _RMC_MODE[solution.quality]
    time, position = _time(solution.time_ns), _position(solution)
    return _sentence("GNRMC", (time, "A", *position, speed, course, day, "", "", mode, "V"))


def _sentence(name: str, fields: Sequence[str]) -> bytes:
    content = ",".join((name, *fields))
    return f"${content}*{calc_checksum(content)}\r\n".encode("ascii")


def _time(time_ns: int) -> str:
    utc = utc_from_gps_ns(time_ns)
    seconds = decimal_from_nanoseconds(utc.second * NS_PER_SECOND + utc.nanosecond, 2)
    return f"{utc.hour:02d}{utc.minute:02d}{'0' if utc.second < 10 else ''}{seconds}"


def _position(solution: ReceiverSolution) -> tuple[str, str, str, str]:
    latitude, longitude = solution.latitude_rad, solution.longitude_rad
    return (
        _degrees_minutes(latitude, 2),
        "S" if latitude < 0.0 else "N",
        _degrees_minutes(longitude, 3),
        "W" if longitude < 0.0 else "E",
    )


def _degrees_minutes(angle_rad: float, degree_digits: int) -> str:
    if not math.isfinite(angle_rad):
        raise ValueError(f"angle is {angle_rad}, expected a finite number")
    # Rounded as one integer, so that 59.99999999 minutes become the next degree and not minute 60.
    unit = 10**_MINUTE_DECIMALS
    minutes, fraction = divmod(round(math.degrees(abs(angle_rad)) * 60.0 * unit), unit)
    return f"{minutes // 60:0{degree_digits}d}{minutes % 60:02d}.{fraction:0{_MINUTE_DECIMALS}d}"


def _decimal(value: float, decimals: int) -> str:
    if not math.isfinite(value):
        raise ValueError(f"value is {value}, expected a finite number")
    return f"{value:.{decimals}f}"

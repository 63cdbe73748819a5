"""Fields of GGA, GST, GBS, RMC and ZDA sentences.

Source: NMEA 0183 v4.11, 6.3. Values are parsed from the text itself and not by pynmeagps: it rounds, accepts minutes
above 59, an absent hemisphere or a leap second as they are, and refuses a position because of a station name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date

from camber.formats.errors import FormatError
from camber.formats.nmea.framing import Sentence
from camber.formats.receiver.printed_covariance import covariance_from_printed
from camber.formats.receiver.solution import SolutionQuality
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import NS_PER_SECOND

# 0 is "no position"; 7 (manual input) and 8 (simulator) are positions without satellites and are refused.
# 3 (precise positioning) is PPP as in RTKLIB; 2 is DGPS and SBAS, which NMEA does not distinguish.
QUALITY_FROM_NMEA = {
    1: SolutionQuality.SINGLE,
    2: SolutionQuality.DGPS,
    3: SolutionQuality.PPP,
    4: SolutionQuality.FIX,
    5: SolutionQuality.FLOAT,
    6: SolutionQuality.DEAD_RECKONING,
}

_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{1,9}))?", re.ASCII)
_LATITUDE = re.compile(r"(\d\d)(\d\d(?:\.\d+)?)", re.ASCII)
_LONGITUDE = re.compile(r"(\d{3})(\d\d(?:\.\d+)?)", re.ASCII)
_NUMBER = re.compile(r"[+-]?\d+(?:\.(\d*))?", re.ASCII)
_DATE = re.compile(r"(\d\d)(\d\d)(\d\d)", re.ASCII)

# Chosen: far beyond what receivers report, so that only damaged numbers exceed them.
_MAX_HEIGHT_M = 1.0e5
_MAX_SEPARATION_M = 1000.0
_MAX_DEVIATION_M = 1.0e6
_MAX_AGE_S = 1.0e6
_MAX_BIAS_M = 1.0e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Gga:
    """A position at a UTC time of day; `height_m` is above the ellipsoid (altitude plus geoid separation)."""

    time_of_day_ns: int
    latitude_rad: float
    longitude_rad: float
    height_m: float
    quality: SolutionQuality
    satellites: int | None
    age_s: float | None
    station: str | None
    byte_offset: int


@dataclass(frozen=True, slots=True)
class Gst:
    """Error statistics: the covariance of the position of the same UTC time of day, None if empty."""

    time_of_day_ns: int
    covariance_enu_m2: EnuCovariance | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Gbs:
    """Fault detection (RAIM): expected errors of the position, and the satellite that most likely failed.

    `satellite` is `G05`, or the sentence's number where its system is unknown. None for an empty field.
    """

    time_of_day_ns: int
    expected_error_enu_m: tuple[float, float, float] | None
    satellite: str | None
    missed_detection_probability: float | None
    bias_m: float | None
    bias_sigma_m: float | None


@dataclass(frozen=True, slots=True)
class UtcDate:
    """UTC date at a UTC time of day, from RMC or ZDA."""

    time_of_day_ns: int
    day: date


class SentenceFields:
    """The fields of one sentence, by position (0 is the first after the name), with errors that name them."""

    def __init__(self, source_name: str, sentence: Sentence) -> None:
        self._source_name = source_name
        self._sentence = sentence
        self.byte_offset = sentence.byte_offset
        self.talker = sentence.talker

    def text(self, index: int) -> str:
        """Return the field without surrounding blanks; empty where it is absent."""
        fields = self._sentence.fields
        return fields[index].strip() if index < len(fields) else ""

    def error(self, index: int, name: str, expected: str) -> FormatError:
        """Return an error about this field, with its text and the position of the sentence."""
        field, actual = f"{self._sentence.kind} {name}", self.text(index)
        return FormatError(self._source_name, field, expected, actual=actual, byte_offset=self.byte_offset)

    def time_of_day_ns(self, index: int) -> int:
        """Return the UTC time of day [ns]; 86,400 s and more in a leap second."""
        match = _TIME.fullmatch(self.text(index))
        hour, minute, second = (int(part) for part in match.groups()[:3]) if match else (99, 99, 99)
        # 23:59:60 is valid; whether it exists on this day is checked once the date is known.
        is_time = hour <= 23 and minute <= 59 and (second <= 59 or (hour, minute, second) == (23, 59, 60))
        if match is None or not is_time:
            raise self.error(index, "time", "hhmmss.ss")
        return (hour * 3600 + minute * 60 + second) * NS_PER_SECOND + int((match[4] or "0").ljust(9, "0"))

    def number(self, index: int, name: str, lowest: float, highest: float) -> float:
        """Return a plain decimal number within bounds."""
        text = self.text(index)
        value = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not lowest <= value <= highest:
            raise self.error(index, name, f"a number from {lowest:g} to {highest:g}")
        return value

    def optional_number(self, index: int, name: str, lowest: float, highest: float) -> float | None:
        """Return the number, None for an empty field."""
        return self.number(index, name, lowest, highest) if self.text(index) else None

    def rounding(self, index: int) -> float:
        """Return half a unit of the last printed digit."""
        match = _NUMBER.fullmatch(self.text(index))
        return float(0.5 * 10.0 ** -len((match[1] or "") if match else ""))

    def latitude_rad(self, index: int) -> float:
        """Return the latitude [rad] of this field and the hemisphere in the next."""
        return self._angle_rad(index, _LATITUDE, "latitude", ("ddmm.mmmm", 90.0, "NS"))

    def longitude_rad(self, index: int) -> float:
        """Return the longitude [rad] of this field and the hemisphere in the next."""
        return self._angle_rad(index, _LONGITUDE, "longitude", ("dddmm.mmmm", 180.0, "EW"))

    def _angle_rad(
        self, index: int, pattern: re.Pattern[str], name: str, expected: tuple[str, float, str]
    ) -> float:
        """`expected`: form, greatest angle [deg], letters of the hemispheres."""
        form, limit_deg, signs = expected
        match = pattern.fullmatch(self.text(index))
        minutes = float(match[2]) if match else math.nan
        value_deg = float(match[1]) + minutes / 60.0 if match else math.nan
        if not (minutes < 60.0 and value_deg <= limit_deg):
            raise self.error(index, name, f"{form} up to {limit_deg:g} degrees, minutes below 60")
        sign = self.text(index + 1)
        if sign not in tuple(signs):
            raise self.error(index + 1, f"{name} hemisphere", f"{signs[0]} or {signs[1]}")
        return math.radians(value_deg if sign == signs[0] else -value_deg)


def read_gga(fields: SentenceFields) -> Gga | int:
    """Return the position, or only its time of day [ns] where the receiver has none (quality 0)."""
    time_of_day_ns = fields.time_of_day_ns(0)
    quality_number = int(fields.number(5, "quality", 0, 9)) if fields.text(5).isdigit() else -1
    if quality_number == 0:
        return time_of_day_ns
    if quality_number not in QUALITY_FROM_NMEA:
        raise fields.error(5, "quality", "0 to 6; manual and simulated positions are not read")
    satellites = fields.optional_number(6, "satellites", 0, 255)
    return Gga(
        time_of_day_ns=time_of_day_ns,
        latitude_rad=fields.latitude_rad(1),
        longitude_rad=fields.longitude_rad(3),
        height_m=_ellipsoidal_height_m(fields),
        quality=QUALITY_FROM_NMEA[quality_number],
        satellites=None if satellites is None else int(satellites),
        age_s=fields.optional_number(12, "age of corrections", 0.0, _MAX_AGE_S),
        station=fields.text(13) or None,
        byte_offset=fields.byte_offset,
    )


def _ellipsoidal_height_m(fields: SentenceFields) -> float:
    altitude_m = fields.number(8, "altitude", -_MAX_HEIGHT_M, _MAX_HEIGHT_M)
    if not fields.text(10):
        expected = "a number; geoid separation missing: ellipsoidal height unknown"
        raise fields.error(10, "geoid separation", expected)
    separation_m = fields.number(10, "geoid separation", -_MAX_SEPARATION_M, _MAX_SEPARATION_M)
    for index, name in ((9, "altitude unit"), (11, "geoid separation unit")):
        if fields.text(index) != "M":
            raise fields.error(index, name, "M")
    # Both are printed decimals; their sum has no more digits than they have.
    return round(altitude_m + separation_m, 9)


def read_gst(fields: SentenceFields) -> Gst:
    """Return the standard deviations of latitude, longitude and altitude as a covariance.

    None for fields that are empty or all zero. The east-north term is that of the error ellipse where the receiver
    reports it; the sentence has no horizontal-vertical terms, they are zero.
    """
    time_of_day_ns = fields.time_of_day_ns(0)
    names = ("σ of longitude", "σ of latitude", "σ of altitude")
    indices = (6, 5, 7)
    if not all(fields.text(index) for index in indices):
        return Gst(time_of_day_ns, None)
    east, north, up = (
        fields.number(index, name, 0.0, _MAX_DEVIATION_M) for index, name in zip(indices, names, strict=True)
    )
    root = 0.0
    if all(fields.text(index) for index in (2, 3, 4)):
        major = fields.number(2, "semi-major σ", 0.0, _MAX_DEVIATION_M)
        minor = fields.number(3, "semi-minor σ", 0.0, _MAX_DEVIATION_M)
        heading_rad = math.radians(fields.number(4, "orientation", -360.0, 360.0))
        covariance = (major * major - minor * minor) * math.sin(heading_rad) * math.cos(heading_rad)
        # Ellipse and deviations are redundant and rounded; the ellipse must not exceed the deviations.
        root = math.copysign(math.sqrt(min(abs(covariance), 0.999 * east * north)), covariance)
    rounding = max(fields.rounding(index) for index in indices)
    covariance_enu_m2 = covariance_from_printed((east, north, up), (root, 0.0, 0.0), rounding)
    return Gst(time_of_day_ns, covariance_enu_m2)


# NMEA 0183 v4.11, 6.3: the letter by GNSS system id (from 4.10 on), else by talker; offsets of satellite numbers.
_SYSTEMS = {"1": "G", "2": "R", "3": "E", "4": "C", "5": "J", "6": "I"}
_TALKER_SYSTEMS = {"GP": "G", "GL": "R", "GA": "E", "GB": "C", "BD": "C", "GQ": "J", "GI": "I"}
_OFFSETS = {"R": (64,), "E": (300,), "C": (100, 200, 400), "J": (192,)}


def read_gbs(fields: SentenceFields) -> Gbs:
    """Return the fault detection; the errors are empty where it was impossible or has failed (u-blox, 4.2.3)."""
    time_of_day_ns = fields.time_of_day_ns(0)
    expected_error_enu_m = None
    if all(fields.text(index) for index in (1, 2, 3)):
        names = ("error of longitude", "error of latitude", "error of altitude")
        east, north, up = (
            fields.number(index, name, -_MAX_DEVIATION_M, _MAX_DEVIATION_M)
            for index, name in zip((2, 1, 3), names, strict=True)
        )
        expected_error_enu_m = east, north, up
    number = fields.optional_number(4, "failed satellite", 0, 999)
    return Gbs(
        time_of_day_ns=time_of_day_ns,
        expected_error_enu_m=expected_error_enu_m,
        satellite=None if number is None else _satellite(fields, int(number)),
        missed_detection_probability=fields.optional_number(5, "probability of missed detection", 0.0, 1.0),
        bias_m=fields.optional_number(6, "bias", -_MAX_BIAS_M, _MAX_BIAS_M),
        bias_sigma_m=fields.optional_number(7, "σ of bias", 0.0, _MAX_BIAS_M),
    )


def _satellite(fields: SentenceFields, number: int) -> str:
    system = _SYSTEMS.get(fields.text(8)) or _TALKER_SYSTEMS.get(fields.talker, "")
    if system == "G" and number > 32:
        # SBAS 120 to 151 are 33 to 64, with any talker.
        system, number = ("S", number - 13) if number <= 64 else ("", number)
    for offset in _OFFSETS.get(system, ()):
        if offset < number <= offset + 63:
            number -= offset
    return f"{system}{number:02d}"


def read_rmc(fields: SentenceFields) -> UtcDate | int:
    """Return the date, or only the time of day [ns] where the date is empty or invalid (status V)."""
    time_of_day_ns = fields.time_of_day_ns(0)
    if fields.text(1) != "A" or not fields.text(8):
        return time_of_day_ns
    match = _DATE.fullmatch(fields.text(8))
    try:
        day, month, short_year = (int(part) for part in match.groups()) if match else (0, 0, 0)
        # GPS time began in 1980, so two digits are unique until 2079.
        return UtcDate(time_of_day_ns, date(short_year + (1900 if short_year >= 80 else 2000), month, day))
    except ValueError:
        raise fields.error(8, "date", "ddmmyy") from None


def read_zda(fields: SentenceFields) -> UtcDate | int | None:
    """Return the date or the time of day as `read_rmc`; None where the time is empty, before the receiver knows it."""
    if not fields.text(0):
        return None
    time_of_day_ns = fields.time_of_day_ns(0)
    parts: Sequence[str] = [fields.text(index) for index in (1, 2, 3)]
    if not all(parts):
        return time_of_day_ns
    try:
        if not all(part.isascii() and part.isdigit() and len(part) <= 4 for part in parts):
            raise ValueError(parts)
        day, month, year = (int(part) for part in parts)
        return UtcDate(time_of_day_ns, date(year, month, day))
    except ValueError:
        raise fields.error(1, "date", "dd,mm,yyyy") from None


READERS: dict[str, Callable[[SentenceFields], Gga | Gst | Gbs | UtcDate | int | None]] = {
    "GBS": read_gbs,
    "GGA": read_gga,
    "GST": read_gst,
    "RMC": read_rmc,
    "ZDA": read_zda,
}

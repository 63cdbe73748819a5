"""NMEA 0183 sentences: framing, checksum, and the fields of GGA, GST, GBS, RMC and ZDA.

Source: NMEA 0183 v4.11, 5.3: `$`, printable characters, `*`, two hexadecimal digits of the exclusive or of everything
between `$` and `*`, carriage return, line feed; 6.3. Values are parsed from the text itself and not by pynmeagps: it
rounds, accepts minutes above 59, an absent hemisphere or a leap second as they are, and refuses a position because of a
station name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date

from pynmeagps.nmeahelpers import calc_checksum, get_parts

from camber.formats.errors import FormatError
from camber.formats.nmea.satellite_numbers import SYSTEM_OF_ID, SYSTEM_OF_TALKER, satellite_of
from camber.formats.observations import satellite_name
from camber.formats.receiver.frame_search import MAX_SENTENCE_BYTES
from camber.formats.receiver.printed_covariance import covariance_from_printed
from camber.formats.receiver.solution import Fields, SolutionQuality
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

_WHOLE = re.compile(rb"\$[^*]*\*[0-9A-Fa-f]{2}")
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
class Sentence:
    """A sentence with a correct checksum: `kind` is its formatter (`GGA`), `fields` the texts after it."""

    talker: str
    kind: str
    fields: tuple[str, ...]
    byte_offset: int


def parse_sentence(source_name: str, text: bytes, byte_offset: int) -> Sentence | FormatError:
    """Parse a candidate sentence, from its `$` on without the line end; an error where it is malformed."""
    actual = text
    if len(text) > MAX_SENTENCE_BYTES:
        expected = f"at most {MAX_SENTENCE_BYTES} bytes before its end"
    elif not _WHOLE.fullmatch(text):
        expected = "$…*hh and a line end: cut short or interrupted"
    else:
        content, talker, kind, fields, checksum = get_parts(text)
        if calc_checksum(content) == checksum.upper():
            return Sentence(talker=talker, kind=kind, fields=tuple(fields), byte_offset=byte_offset)
        expected = f"checksum {calc_checksum(content)}"
        actual = text[:6] + b"..." + text[-6:]
    return FormatError(source_name, "sentence", expected, actual=actual, byte_offset=byte_offset)


@dataclass(frozen=True, slots=True, kw_only=True)
class SentenceContent:
    """What a sentence says at a UTC time of day [ns]; 86,400 s and more in a leap second."""

    time_of_day_ns: int
    solution: Fields | None = None
    """GGA: of a `ReceiverSolution`; None where the receiver has no position."""
    covariance_enu_m2: EnuCovariance | None = None
    """GST: of the position of the same time; None where it is empty or all zero."""
    integrity: Fields | None = None
    """GBS: of a `ReceiverIntegrity`, by fault detection (RAIM)."""
    day: date | None = None
    """RMC, ZDA: the UTC date; None where it is empty or invalid."""


class SentenceFields:
    """The fields of one sentence, by position (0 is the first after the name), with errors that name them."""

    def __init__(self, source_name: str, sentence: Sentence) -> None:
        self._source_name = source_name
        self._sentence = sentence
        self.byte_offset = sentence.byte_offset
        self.talker = sentence.talker

    @property
    def count(self) -> int:
        """Number of fields."""
        return len(self._sentence.fields)

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

    def all_or_none(
        self, names: Mapping[int, str], lowest: float, highest: float
    ) -> tuple[float, float, float] | None:
        """Return three numbers, None where a field is empty."""
        if not all(self.text(index) for index in names):
            return None
        a, b, c = (self.number(index, name, lowest, highest) for index, name in names.items())
        return a, b, c

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


def _read_gga(fields: SentenceFields) -> SentenceContent:
    """The height is above the ellipsoid: altitude plus geoid separation."""
    time_of_day_ns = fields.time_of_day_ns(0)
    quality_number = int(fields.number(5, "quality", 0, 9)) if fields.text(5).isdigit() else -1
    if quality_number == 0:
        return SentenceContent(time_of_day_ns=time_of_day_ns)
    if quality_number not in QUALITY_FROM_NMEA:
        raise fields.error(5, "quality", "0 to 6; manual and simulated positions are not read")
    satellites = fields.optional_number(6, "satellites", 0, 255)
    solution = {
        "latitude_rad": fields.latitude_rad(1),
        "longitude_rad": fields.longitude_rad(3),
        "height_m": _ellipsoidal_height_m(fields),
        "quality": QUALITY_FROM_NMEA[quality_number],
        "satellites": None if satellites is None else int(satellites),
        "age_s": fields.optional_number(12, "age of corrections", 0.0, _MAX_AGE_S),
        "station": fields.text(13) or None,
    }
    return SentenceContent(time_of_day_ns=time_of_day_ns, solution=solution)


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


def _read_gst(fields: SentenceFields) -> SentenceContent:
    """Return the standard deviations of latitude, longitude and altitude as a covariance.

    The east-north term is that of the error ellipse where the receiver reports it; the sentence has no
    horizontal-vertical terms, they are zero.
    """
    time_of_day_ns = fields.time_of_day_ns(0)
    names = {6: "σ of longitude", 5: "σ of latitude", 7: "σ of altitude"}
    deviations = fields.all_or_none(names, 0.0, _MAX_DEVIATION_M)
    if deviations is None:
        return SentenceContent(time_of_day_ns=time_of_day_ns)
    east, north, up = deviations
    root = 0.0
    if all(fields.text(index) for index in (2, 3, 4)):
        major = fields.number(2, "semi-major σ", 0.0, _MAX_DEVIATION_M)
        minor = fields.number(3, "semi-minor σ", 0.0, _MAX_DEVIATION_M)
        heading_rad = math.radians(fields.number(4, "orientation", -360.0, 360.0))
        covariance = (major * major - minor * minor) * math.sin(heading_rad) * math.cos(heading_rad)
        # Ellipse and deviations are redundant and rounded; the ellipse must not exceed the deviations.
        root = math.copysign(math.sqrt(min(abs(covariance), 0.999 * east * north)), covariance)
    rounding = max(fields.rounding(index) for index in names)
    covariance_enu_m2 = covariance_from_printed((east, north, up), (root, 0.0, 0.0), rounding)
    return SentenceContent(time_of_day_ns=time_of_day_ns, covariance_enu_m2=covariance_enu_m2)


def _read_gbs(fields: SentenceFields) -> SentenceContent:
    """Failed: with a suspect satellite, used in the position or not. Passed: with expected errors only.

    The errors are empty where fault detection was impossible or has failed (u-blox, 4.2.3).
    """
    time_of_day_ns = fields.time_of_day_ns(0)
    names = {2: "error of longitude", 1: "error of latitude", 3: "error of altitude"}
    expected_error_enu_m = fields.all_or_none(names, -_MAX_DEVIATION_M, _MAX_DEVIATION_M)
    number = fields.optional_number(4, "failed satellite", 0, 999)
    passed = "unknown" if expected_error_enu_m is None else "passed"
    probability = fields.optional_number(5, "probability of missed detection", 0.0, 1.0)
    integrity = {
        "raim": passed if number is None else "failed",
        "expected_error_enu_m": expected_error_enu_m,
        "suspect_satellite": None if number is None else _satellite(fields, int(number)),
        "missed_detection_probability": probability,
        "suspect_bias_m": fields.optional_number(6, "bias", -_MAX_BIAS_M, _MAX_BIAS_M),
        "suspect_bias_sigma_m": fields.optional_number(7, "σ of bias", 0.0, _MAX_BIAS_M),
    }
    return SentenceContent(time_of_day_ns=time_of_day_ns, integrity=integrity)


def _satellite(fields: SentenceFields, number: int) -> str:
    """Return `G05`, or the number alone where its system is unknown."""
    system = SYSTEM_OF_ID.get(fields.text(8)) or SYSTEM_OF_TALKER.get(fields.talker)
    satellite = None if system is None else satellite_of(system, number)
    return f"{number:02d}" if satellite is None else satellite_name(satellite)


def _read_rmc(fields: SentenceFields) -> SentenceContent:
    """Without a date where the status is V, invalid."""
    time_of_day_ns = fields.time_of_day_ns(0)
    if fields.text(1) != "A" or not fields.text(8):
        return SentenceContent(time_of_day_ns=time_of_day_ns)
    match = _DATE.fullmatch(fields.text(8))
    try:
        day, month, short_year = (int(part) for part in match.groups()) if match else (0, 0, 0)
        # GPS time began in 1980, so two digits are unique until 2079.
        year = short_year + (1900 if short_year >= 80 else 2000)
        return SentenceContent(time_of_day_ns=time_of_day_ns, day=date(year, month, day))
    except ValueError:
        raise fields.error(8, "date", "ddmmyy") from None


def _read_zda(fields: SentenceFields) -> SentenceContent:
    time_of_day_ns = fields.time_of_day_ns(0)
    parts = [fields.text(index) for index in (1, 2, 3)]
    if not all(parts):
        return SentenceContent(time_of_day_ns=time_of_day_ns)
    try:
        if not all(part.isascii() and part.isdigit() and len(part) <= 4 for part in parts):
            raise ValueError(parts)
        day, month, year = (int(part) for part in parts)
        return SentenceContent(time_of_day_ns=time_of_day_ns, day=date(year, month, day))
    except ValueError:
        raise fields.error(1, "date", "dd,mm,yyyy") from None


READERS: dict[str, Callable[[SentenceFields], SentenceContent]] = {
    "GBS": _read_gbs,
    "GGA": _read_gga,
    "GST": _read_gst,
    "RMC": _read_rmc,
    "ZDA": _read_zda,
}
"""By kind of sentence; FormatError where a field is malformed. The time must not be empty."""

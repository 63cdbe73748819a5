"""GPS time as integer nanoseconds since 1980-01-06 00:00:00, and its other spellings.

GPS time has no leap seconds; UTC has fallen behind it by 18 s since 2017. Integers lose nothing: a double of
seconds since 1980 resolves only 0.2 µs, and differences of times decide what belongs to one epoch.

Sources: IS-GPS-200, 3.3.4 (GPS time and week); IERS Bulletin C (leap seconds). No leap second is announced
after 2017-01-01; a new one needs a new row in `_LEAP_MONTHS`, and until then later UTC times are read
with 18 s.
"""

from bisect import bisect_right
from datetime import date
from typing import NamedTuple

NS_PER_SECOND = 1_000_000_000  # by definition
NS_PER_DAY = 86_400 * NS_PER_SECOND
NS_PER_WEEK = 7 * NS_PER_DAY

UNIX_OF_GPS_EPOCH_NS = 315_964_800 * NS_PER_SECOND
"""1980-01-06T00:00:00Z on the scale of computers, which counts UTC since 1970 without its leap seconds."""

_GPS_EPOCH_ORDINAL = date(1980, 1, 6).toordinal()

# The first UTC day on which GPS − UTC was one second more than the day before: months of IERS Bulletin C.
_LEAP_MONTHS = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
_LEAP_ORDINALS = tuple(date(year, month, 1).toordinal() for year, month in _LEAP_MONTHS)
# GPS times at which each inserted second 23:59:60 begins: with i leap seconds before it, midnight UTC "would
# have been" at days·86400 + i.
_LEAP_STARTS_NS = tuple(
    (ordinal - _GPS_EPOCH_ORDINAL) * NS_PER_DAY + i * NS_PER_SECOND
    for i, ordinal in enumerate(_LEAP_ORDINALS)
)


class CalendarTime(NamedTuple):
    """A date and time of day without a time system; `second` is 60 only in a leap second of UTC."""

    year: int
    month: int
    day: int
    hour: int
    minute: int
    second: int
    nanosecond: int = 0


def gps_ns_from_week_tow(week: int, time_of_week_ns: int) -> int:
    """GPS time [ns] of a full (not modulo 1024) GPS week and the nanoseconds into it."""
    if week < 0 or not 0 <= time_of_week_ns < NS_PER_WEEK:
        raise ValueError(
            f"GPS week {week}, {time_of_week_ns} ns, expected week ≥ 0 and 0 ≤ ns < {NS_PER_WEEK}"
        )
    return week * NS_PER_WEEK + time_of_week_ns


def week_tow_from_gps_ns(time_ns: int) -> tuple[int, int]:
    """Full GPS week and nanoseconds into it."""
    return divmod(_not_negative(time_ns), NS_PER_WEEK)


def gps_ns_from_gpst(gpst: CalendarTime) -> int:
    """GPS time [ns] of a calendar time in GPS time; ValueError before 1980-01-06 or if there is none such."""
    if gpst.second == 60:
        raise ValueError(f"{text_from_calendar(gpst)} has second 60, GPS time has no leap seconds")
    return _not_negative(_naive_ns(gpst))


def gpst_from_gps_ns(time_ns: int) -> CalendarTime:
    """Calendar time in GPS time."""
    return _calendar(_not_negative(time_ns))


def gps_ns_from_utc(utc: CalendarTime) -> int:
    """GPS time [ns] of a calendar time in UTC.

    Raises ValueError for no such time (second 60 where there was no leap second) or one before 1980-01-06.
    """
    naive_ns = _naive_ns(utc)
    ordinal = date(utc.year, utc.month, utc.day).toordinal()
    if utc.second == 60 and not ((utc.hour, utc.minute) == (23, 59) and ordinal + 1 in _LEAP_ORDINALS):
        raise ValueError(f"{text_from_calendar(utc)} UTC is not a leap second")
    return _not_negative(naive_ns + bisect_right(_LEAP_ORDINALS, ordinal) * NS_PER_SECOND)


def utc_from_gps_ns(time_ns: int) -> CalendarTime:
    """Calendar time in UTC, with second 60 during a leap second."""
    begun = bisect_right(_LEAP_STARTS_NS, _not_negative(time_ns))
    calendar = _calendar(time_ns - begun * NS_PER_SECOND)
    return calendar._replace(second=60) if _in_leap_second(time_ns, begun) else calendar


def gps_minus_utc_s(time_ns: int) -> int:
    """GPS − UTC in whole seconds at a GPS time; a leap second counts from its end."""
    begun = bisect_right(_LEAP_STARTS_NS, _not_negative(time_ns))
    return begun - 1 if _in_leap_second(time_ns, begun) else begun


def gps_ns_from_unix_ns(unix_ns: int) -> int:
    """GPS time [ns] of a computer's UTC; a leap second, which it does not have, falls on the second after it.

    Raises ValueError before 1980-01-06.
    """
    naive_ns = _not_negative(unix_ns - UNIX_OF_GPS_EPOCH_NS)
    leaps = bisect_right(_LEAP_ORDINALS, naive_ns // NS_PER_DAY + _GPS_EPOCH_ORDINAL)
    return naive_ns + leaps * NS_PER_SECOND


def unix_ns_from_gps_ns(time_ns: int) -> int:
    """A computer's UTC [ns since 1970] of a GPS time."""
    return time_ns - gps_minus_utc_s(time_ns) * NS_PER_SECOND + UNIX_OF_GPS_EPOCH_NS


def _in_leap_second(time_ns: int, begun: int) -> bool:
    return begun > 0 and time_ns < _LEAP_STARTS_NS[begun - 1] + NS_PER_SECOND


def calendar_from_text(text: str) -> CalendarTime:
    """Read `2023/07/11 06:04:32.000` (up to nine decimals). Raises ValueError with what was expected."""
    try:
        day_text, time_text = text.split()
        year, month, day = (_digits(part) for part in day_text.split("/"))
        hour, minute, seconds = time_text.split(":")
        second, nanosecond = divmod(nanoseconds_from_decimal(seconds), NS_PER_SECOND)
        calendar = CalendarTime(
            year, month, day, hour=_digits(hour), minute=_digits(minute), second=second, nanosecond=nanosecond
        )
        _naive_ns(calendar)
    except ValueError as error:
        raise ValueError(f"time {text[:40]!r}, expected yyyy/mm/dd hh:mm:ss.sss") from error
    return calendar


def text_from_calendar(calendar: CalendarTime, minimum_decimals: int = 3) -> str:
    """`2023/07/11 06:04:32.000`, with more decimals where they are needed to lose nothing."""
    seconds = decimal_from_nanoseconds(
        calendar.second * NS_PER_SECOND + calendar.nanosecond, minimum_decimals
    )
    return (
        f"{calendar.year:04d}/{calendar.month:02d}/{calendar.day:02d}"
        f" {calendar.hour:02d}:{calendar.minute:02d}:{'0' if calendar.second < 10 else ''}{seconds}"
    )


def nanoseconds_from_decimal(text: str) -> int:
    """Nanoseconds of decimal seconds (`194670.000`); ValueError on signs, exponents, > 9 decimals."""
    whole, point, fraction = text.partition(".")
    if len(fraction) > 9 or (point and not fraction):
        raise ValueError(f"{text[:40]!r}, expected seconds with one to nine decimals")
    return _digits(whole) * NS_PER_SECOND + (_digits(fraction.ljust(9, "0")) if fraction else 0)


def decimal_from_nanoseconds(duration_ns: int, minimum_decimals: int = 3) -> str:
    """Decimal seconds of nanoseconds ≥ 0, exactly, with at least the given number of decimals (0 to 9)."""
    whole, fraction = divmod(_not_negative(duration_ns), NS_PER_SECOND)
    decimals = f"{fraction:09d}".rstrip("0").ljust(minimum_decimals, "0")
    return f"{whole}.{decimals}" if decimals else str(whole)


def _naive_ns(calendar: CalendarTime) -> int:
    """Nanoseconds since 1980-01-06 as if every day had 86,400 s."""
    year, month, day, hour, minute, second, nanosecond = calendar
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second <= 60 and 0 <= nanosecond < NS_PER_SECOND):
        raise ValueError(f"no such time of day: {hour}:{minute}:{second} and {nanosecond} ns")
    try:
        days = date(year, month, day).toordinal() - _GPS_EPOCH_ORDINAL
    except OverflowError:
        # A number that no C integer holds is no ValueError to date().
        raise ValueError(f"no such day: {year}/{month}/{day}") from None
    return ((days * 24 + hour) * 60 + minute) * 60 * NS_PER_SECOND + second * NS_PER_SECOND + nanosecond


def _calendar(naive_ns: int) -> CalendarTime:
    days, of_day_ns = divmod(naive_ns, NS_PER_DAY)
    day = date.fromordinal(_GPS_EPOCH_ORDINAL + days)
    of_day_s, nanosecond = divmod(of_day_ns, NS_PER_SECOND)
    minutes, second = divmod(of_day_s, 60)
    return CalendarTime(
        day.year,
        day.month,
        day.day,
        hour=minutes // 60,
        minute=minutes % 60,
        second=second,
        nanosecond=nanosecond,
    )


def _not_negative(time_ns: int) -> int:
    if time_ns < 0:
        raise ValueError(f"time is {time_ns} ns, expected 0 or more (GPS time begins on 1980-01-06)")
    return time_ns


def _digits(text: str) -> int:
    # int() also takes signs, blanks, underscores and digits of other scripts.
    if not (text.isascii() and text.isdigit() and len(text) <= 12):
        raise ValueError(f"{text[:40]!r}, expected digits")
    return int(text)

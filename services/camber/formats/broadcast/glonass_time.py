"""Time of GLONASS: UTC(SU) and three hours, with its leap seconds.

Source: ICD GLONASS 5.1 (2008), 3.3.3 (time scale), 4.4 (N_T, t_b). Its difference to UTC and that of UTC(SU) to UTC,
below 1 µs each, are part of the receiver's clock against the system.
"""

from __future__ import annotations

from camber.geodesy.gps_time import (
    NS_PER_DAY,
    NS_PER_SECOND,
    NS_PER_WEEK,
    CalendarTime,
    gps_minus_utc_s,
    gps_ns_from_gpst,
)

_GLONASS_MINUS_UTC_NS = 3 * 3600 * NS_PER_SECOND  # 3.3.3
_QUARTER_NS = 900 * NS_PER_SECOND  # 4.4, t_b
# 4.4: N_T counts from 1 January of a leap year; until 2100 each fourth year is one.
_FOUR_YEARS_NS = 1461 * NS_PER_DAY
# 1 January 1996, 00:00 of GLONASS time, counted like GPS time, which has no leap seconds.
_FIRST_FOUR_YEARS_NS = gps_ns_from_gpst(CalendarTime(1996, 1, 1, hour=0, minute=0, second=0))


def gps_ns_of_week_day(day: int | None, of_day_ns: int, near_ns: int) -> int:
    """Return the GPS time nearest to `near_ns` at a time of a day of the week, 0 for Sunday; None for any day."""
    if day is None:
        return _nearest(of_day_ns, NS_PER_DAY, near_ns)
    # Weeks of GPS begin on Sundays, too.
    return _nearest(day * NS_PER_DAY + of_day_ns, NS_PER_WEEK, near_ns)


def gps_ns_of_day_number(day: int, of_day_ns: int, near_ns: int) -> int:
    """Return the GPS time nearest to `near_ns` at a time of day `day` (N_T) of four years; 0: the day is not known."""
    if day == 0:
        return gps_ns_of_week_day(None, of_day_ns, near_ns)
    glonass_ns = _FIRST_FOUR_YEARS_NS + (day - 1) * NS_PER_DAY + of_day_ns
    return _nearest(glonass_ns, _FOUR_YEARS_NS, near_ns)


def quarter_of_day(time_ns: int) -> int:
    """Return t_b as a satellite sends it: quarters of an hour since midnight of GLONASS time."""
    glonass_ns = time_ns - gps_minus_utc_s(time_ns) * NS_PER_SECOND + _GLONASS_MINUS_UTC_NS
    return glonass_ns % NS_PER_DAY // _QUARTER_NS


def _nearest(glonass_ns: int, period_ns: int, near_ns: int) -> int:
    """Return the GPS time nearest to `near_ns` at which GLONASS time is `glonass_ns`, but for periods."""
    near_glonass_ns = near_ns - gps_minus_utc_s(near_ns) * NS_PER_SECOND + _GLONASS_MINUS_UTC_NS
    since_ns = (glonass_ns - near_glonass_ns + period_ns // 2) % period_ns - period_ns // 2
    time_ns = max(near_ns + since_ns, 0)
    # Between the two may be a leap second; the time may be the second before it or the one after it.
    leaps_s = gps_minus_utc_s(time_ns + (NS_PER_SECOND if since_ns >= 0 else 0))
    return max(time_ns + (leaps_s - gps_minus_utc_s(near_ns)) * NS_PER_SECOND, 0)

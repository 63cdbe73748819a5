"""GPS time against weeks, calendars and UTC with its leap seconds."""

from datetime import datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.gps_time import (
    NS_PER_SECOND,
    NS_PER_WEEK,
    CalendarTime,
    calendar_from_text,
    decimal_from_nanoseconds,
    gps_minus_utc_s,
    gps_ns_from_gpst,
    gps_ns_from_utc,
    gps_ns_from_week_tow,
    gpst_from_gps_ns,
    nanoseconds_from_decimal,
    text_from_calendar,
    utc_from_gps_ns,
    week_tow_from_gps_ns,
)

times_ns = st.integers(0, 5000 * NS_PER_WEEK)


def test_week_and_calendar_of_a_recording_agree() -> None:
    # header of a recorded .pos file: 2023/07/11 06:00:19.2 GPST (week2270 194419.2s)
    from_week = gps_ns_from_week_tow(2270, nanoseconds_from_decimal("194419.2"))
    assert from_week == gps_ns_from_gpst(calendar_from_text("2023/07/11 06:00:19.2"))
    assert week_tow_from_gps_ns(from_week) == (2270, 194419_200_000_000)


@given(times_ns)
def test_round_trips(time_ns: int) -> None:
    assert gps_ns_from_week_tow(*week_tow_from_gps_ns(time_ns)) == time_ns
    assert gps_ns_from_gpst(gpst_from_gps_ns(time_ns)) == time_ns
    assert gps_ns_from_utc(utc_from_gps_ns(time_ns)) == time_ns
    assert gps_ns_from_gpst(calendar_from_text(text_from_calendar(gpst_from_gps_ns(time_ns)))) == time_ns


@given(times_ns)
def test_calendar_is_that_of_the_standard_library(time_ns: int) -> None:
    microsecond_ns = time_ns // 1000 * 1000
    expected = datetime(1980, 1, 6) + timedelta(microseconds=microsecond_ns // 1000)
    calendar = gpst_from_gps_ns(microsecond_ns)
    assert datetime(*calendar[:6], calendar.nanosecond // 1000) == expected


@pytest.mark.parametrize(
    ("day", "offset_s"),
    [
        ((1980, 1, 6), 0), ((1981, 7, 1), 1), ((1999, 1, 1), 13), ((2016, 12, 31), 17), ((2017, 1, 1), 18),
        ((2026, 1, 1), 18),
    ],
)  # fmt: skip
def test_leap_seconds(day: tuple[int, int, int], offset_s: int) -> None:
    midnight = CalendarTime(*day, 0, 0, 0)
    time_ns = gps_ns_from_utc(midnight)
    assert time_ns - gps_ns_from_gpst(midnight) == offset_s * NS_PER_SECOND
    assert gps_minus_utc_s(time_ns) == offset_s


def test_the_leap_second_of_2016_is_second_60() -> None:
    midnight_ns = gps_ns_from_utc(CalendarTime(2017, 1, 1, 0, 0, 0))
    inside_ns, inside = midnight_ns - NS_PER_SECOND // 2, CalendarTime(2016, 12, 31, 23, 59, 60, 500_000_000)
    assert (utc_from_gps_ns(inside_ns), gps_ns_from_utc(inside)) == (inside, inside_ns)
    assert gps_minus_utc_s(inside_ns) == 17
    before = CalendarTime(2016, 12, 31, 23, 59, 59)
    assert midnight_ns - gps_ns_from_utc(before) == 2 * NS_PER_SECOND


@pytest.mark.parametrize(
    "bad",
    [
        CalendarTime(2016, 12, 30, 23, 59, 60),
        CalendarTime(2016, 12, 31, 22, 59, 60),
        CalendarTime(2023, 2, 29, 0, 0, 0),
        CalendarTime(2023, 1, 1, 24, 0, 0),
        CalendarTime(1980, 1, 5, 23, 59, 59),
        CalendarTime(20230711000, 1, 1, 0, 0, 0),
        CalendarTime(2023, 1 << 40, 1, 0, 0, 0),
    ],
)
def test_times_that_do_not_exist_are_refused(bad: CalendarTime) -> None:
    with pytest.raises(ValueError, match=r"time|leap|day"):
        gps_ns_from_utc(bad)


def test_gps_time_has_no_leap_seconds() -> None:
    with pytest.raises(ValueError, match="no leap seconds"):
        gps_ns_from_gpst(CalendarTime(2016, 12, 31, 23, 59, 60))


@pytest.mark.parametrize(("week", "time_of_week_ns"), [(-1, 0), (0, -1), (0, NS_PER_WEEK)])
def test_bad_weeks_are_refused(week: int, time_of_week_ns: int) -> None:
    with pytest.raises(ValueError, match="GPS week"):
        gps_ns_from_week_tow(week, time_of_week_ns)


def test_negative_times_are_refused() -> None:
    with pytest.raises(ValueError, match="1980-01-06"):
        utc_from_gps_ns(-1)


@pytest.mark.parametrize(
    ("text", "ns"), [("0", 0), ("1.5", 1_500_000_000), ("194670.000000001", 194670_000_000_001)]
)
def test_decimal_seconds_are_exact(text: str, ns: int) -> None:
    assert nanoseconds_from_decimal(text) == ns
    assert nanoseconds_from_decimal(decimal_from_nanoseconds(ns, 0)) == ns


@given(st.integers(0, 10**15), st.integers(0, 9))
def test_decimal_round_trip(ns: int, decimals: int) -> None:
    assert nanoseconds_from_decimal(decimal_from_nanoseconds(ns, decimals)) == ns


@pytest.mark.parametrize("text", ["", ".", "1.", "-1", "1e3", "1_0", "٣", "nan", "1.0000000001", " 1"])
def test_bad_decimals_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        nanoseconds_from_decimal(text)


@pytest.mark.parametrize(
    "text",
    [
        "", "2023/07/11", "2023-07-11 00:00:00", "2023/13/01 00:00:00", "20230000000/07/11 00:00:00",
        "2023/07/11 00:61:00", "a/b/c d:e:f",
    ],
)  # fmt: skip
def test_bad_calendars_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected yyyy/mm/dd"):
        calendar_from_text(text)


def test_text_has_the_decimals_it_needs() -> None:
    assert text_from_calendar(CalendarTime(2023, 7, 11, 6, 4, 2)) == "2023/07/11 06:04:02.000"
    assert text_from_calendar(CalendarTime(2023, 7, 11, 6, 4, 32, 1)) == "2023/07/11 06:04:32.000000001"
    assert text_from_calendar(CalendarTime(2023, 7, 11, 6, 4, 2), 0) == "2023/07/11 06:04:02"

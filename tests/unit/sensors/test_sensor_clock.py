import pytest

from camber.geodesy.gps_time import (
    UNIX_OF_GPS_EPOCH_NS,
    CalendarTime,
    gps_ns_from_unix_ns,
    gps_ns_from_utc,
    unix_ns_from_gps_ns,
)
from camber.sensors.sensor_clock import SensorClock, TimeScale

S = 1_000_000_000
TIME_NS = gps_ns_from_utc(CalendarTime(2026, 3, 20, 9, 59, 59, 999_000_000))
UTC_NS = unix_ns_from_gps_ns(TIME_NS)
STAMPS: dict[TimeScale, int] = {
    "utc_hour": UTC_NS % (3600 * S),
    "utc": UTC_NS,
    "tai": TIME_NS + UNIX_OF_GPS_EPOCH_NS + 19 * S,
    "gps": TIME_NS + UNIX_OF_GPS_EPOCH_NS,
}
LATE_NS = 2_000_000


def clock(scale: TimeScale, *, offset_s: float = 0.0) -> SensorClock:
    return SensorClock(scale, round(offset_s * S), S // 10)


def test_a_computers_clock_is_gps_time_but_for_the_leap_seconds() -> None:
    assert UTC_NS == 1_774_000_799_999_000_000
    assert gps_ns_from_unix_ns(UTC_NS) == TIME_NS
    assert STAMPS["tai"] - UTC_NS == 37 * S
    for day, leaps in ((CalendarTime(2016, 12, 31, 23, 59, 59), 17), (CalendarTime(2017, 1, 1, 0, 0, 0), 18)):
        time_ns = gps_ns_from_utc(day)
        unix_ns = unix_ns_from_gps_ns(time_ns)
        assert gps_ns_from_unix_ns(unix_ns) == time_ns == unix_ns - UNIX_OF_GPS_EPOCH_NS + leaps * S


@pytest.mark.parametrize("scale", STAMPS)
def test_each_scale_gives_the_same_gps_time(scale: TimeScale) -> None:
    assert clock(scale).time_ns(STAMPS[scale], TIME_NS + LATE_NS) == TIME_NS
    assert clock(scale, offset_s=-0.02).time_ns(STAMPS[scale], TIME_NS + LATE_NS) == TIME_NS - S // 50


def test_the_hour_is_that_in_which_the_packet_is_nearest_to_its_arrival() -> None:
    hours = clock("utc_hour")
    for step_ns in range(0, 3 * S // 1000, 250_000):  # over the full hour
        time_ns = TIME_NS + step_ns
        stamp_ns = unix_ns_from_gps_ns(time_ns) % (3600 * S)
        assert hours.time_ns(stamp_ns, time_ns + LATE_NS) == time_ns
        assert hours.jump == ""
    assert stamp_ns < S


@pytest.mark.parametrize("set_scale", STAMPS)
@pytest.mark.parametrize("scale", STAMPS)
def test_another_scale_than_was_set_is_never_taken(set_scale: TimeScale, scale: TimeScale) -> None:
    one = clock(set_scale)
    time_ns = one.time_ns(STAMPS[scale], TIME_NS + LATE_NS)
    assert (time_ns == TIME_NS) if set_scale == scale else time_ns is None
    if {set_scale, scale} == {"tai", "utc"}:
        assert "37 s: the stamps are TAI (PTP) and were set to be UTC" in one.refusal


@pytest.mark.parametrize("scale", ["utc", "tai", "gps"])
def test_a_clock_that_counts_from_its_start_is_not_one_that_is_set(scale: TimeScale) -> None:
    one = clock(scale)
    assert one.time_ns(90 * S, TIME_NS) is None
    assert one.refusal.startswith("stamps before 1980")


def test_an_hour_counter_that_was_never_set_is_refused() -> None:
    one = clock("utc_hour")
    assert one.time_ns(STAMPS["utc_hour"] - 700 * S, TIME_NS + LATE_NS) is None
    assert one.refusal.startswith("stamps read as utc_hour are -700.002 s from this machine's clock")


def test_a_clock_that_is_set_while_it_runs_is_named() -> None:
    one = clock("tai")
    for k in range(5):
        assert one.time_ns(STAMPS["tai"] + k * S, TIME_NS + LATE_NS + k * S) == TIME_NS + k * S
        assert one.jump == ""
    assert one.time_ns(STAMPS["tai"] + 5 * S + S // 16, TIME_NS + LATE_NS + 5 * S) is not None
    assert one.jump == "the sensor's clock and this machine's have moved apart by +0.062 s"


def test_a_free_running_clock_follows_its_quickest_packets() -> None:
    one = clock("arrival")
    delays_ms = [3.0, 7.0, 1.0, 9.0, 2.0, 30.0, 1.5]
    for k, delay_ms in enumerate(delays_ms):
        sent_ns = TIME_NS + k * S // 10
        time_ns = one.time_ns(77 * S + k * S // 10, sent_ns + round(delay_ms * 1e6))
        assert time_ns is not None
        assert time_ns - sent_ns == round(min(delays_ms[: k + 1]) * 1e6)
        assert not one.jump


def test_what_a_free_running_clock_was_before_a_pause_is_forgotten() -> None:
    """50 ppm over ten minutes without packets: 30 ms."""
    one = clock("arrival")
    for k in range(100):
        one.time_ns(77 * S + k * S // 10, TIME_NS + k * S // 10)
    drifted_ns = round(600 * 50e-6 * S)
    time_ns = one.time_ns(677 * S - drifted_ns, TIME_NS + 600 * S)
    assert time_ns == TIME_NS + 600 * S


@pytest.mark.parametrize("step_ms", [45, -45])
def test_a_small_step_of_the_machines_clock_is_followed_within_seconds(step_ms: int) -> None:
    """Less than what is seen from one packet to the next; the quickest packets show it."""
    one = clock("arrival")
    jumps = []
    for k in range(100):
        step_ns = step_ms * 1_000_000 * (k >= 50)
        time_ns = one.time_ns(77 * S + k * S // 10, TIME_NS + k * S // 10 + step_ns)
        jumps += [one.jump] if one.jump else []
        if k < 50 or k >= 80:
            assert time_ns == TIME_NS + k * S // 10 + step_ns
    text = "the sensor's clock and this machine's have moved apart by -0.045 s"
    assert jumps == ([text] if step_ms > 0 else [])


@pytest.mark.parametrize("scale", ["utc_hour", "arrival"])
@pytest.mark.parametrize("hours", [1, 2])
def test_a_machines_clock_that_is_set_back_by_whole_hours_is_named(scale: TimeScale, hours: int) -> None:
    one = clock(scale)
    back_ns = 3600 * S * hours
    for k in range(-5, 5):
        arrival_ns = TIME_NS + k * S // 10 - back_ns * (k >= 0)
        stamp_ns = (STAMPS["utc_hour"] + k * S // 10) % (3600 * S)
        time_ns = one.time_ns(stamp_ns, arrival_ns)
        assert time_ns is not None
        assert abs(time_ns - arrival_ns) < S // 1000
        assert bool(one.jump) == (k == 0)


def test_an_hours_counter_that_was_never_set_goes_on_over_its_hour() -> None:
    free = clock("arrival")
    last_s = 3599.9
    one_late = (0.0, 0.05, 0.0995, 0.1005, 0.0998, 0.1010, 0.2)
    at_s = [*one_late, *(100.0 * k for k in range(1, 80))]
    for s in at_s:
        arrival_ns = TIME_NS + round(s * S)
        assert free.time_ns(round((last_s + s) * S) % (3600 * S), arrival_ns) == arrival_ns
        assert free.jump == ""


def test_a_free_running_clock_that_starts_again_is_learnt_anew() -> None:
    one = clock("arrival")
    assert one.time_ns(77 * S, TIME_NS) == TIME_NS
    assert one.time_ns(1 * S, TIME_NS + S) == TIME_NS + S
    assert "moved apart by -77.000 s" in one.jump


def test_the_drift_of_a_free_running_clock_is_followed() -> None:
    one = clock("arrival")
    for k in range(2000):  # 50 ppm, for 200 s
        arrival_ns = TIME_NS + k * S // 10
        time_ns = one.time_ns(round(k * S // 10 * (1.0 - 50e-6)), arrival_ns)
        assert time_ns is not None
        assert -1_100_000 < time_ns - arrival_ns <= 0

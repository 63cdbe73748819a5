"""UBX: pyubx2 decodes raw measurements and positions within the resolution."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader
from pyubx2.ubxtypes_decodes import SIGID

from camber.formats.observations import satellite_number, signal_number
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ubx.nav_writer import format_high_precision_position, format_position_velocity_time
from camber.formats.ubx.signal_ids import SIGNAL_IDS
from camber.formats.ubx.writer import checksum, format_raw_measurements, ubx_frame
from camber.geodesy.gps_time import gps_minus_utc_s, utc_from_gps_ns
from support.random_observations import WEEK_NS, random_epoch
from support.random_solutions import DIAGONAL_COVARIANCES, solutions

# What u-blox calls the signals of RINEX, written down from the interface description, 1.5.4.
GNSS_IDS = {"G": 0, "E": 2, "C": 3, "J": 5}
IDS = {
    "G": {"1C": ("L1_C/A", 0), "2L": ("L2_CL", 3), "2S": ("L2_CM", 4), "5Q": ("L5_Q", 7), "5I": ("L5_I", 6)},
    "E": {"1C": ("E1_C", 0), "1B": ("E1_B", 1), "5Q": ("E5_aQ", 4), "7I": ("E5_bI", 5), "7Q": ("E5_bQ", 6)},
    "C": {"2I": ("B1_ID1", 0), "7I": ("B2I_D1", 2), "6I": ("B3I_D1", 4), "5P": ("B2_ap", 7), "1P": ("B1_Cp", 5)},
    "J": {"1C": ("L1_C/A", 0), "2S": ("L2_CM", 4), "2L": ("L2_CL", 5), "5Q": ("L5_Q", 9), "5I": ("L5_I", 8)},
}  # fmt: skip
GEOSTATIONARY = {"2I": ("B1I_D2", 1), "7I": ("B2I_D2", 3), "6I": ("B3I_D2", 10)}

parsed = UBXReader.parse


def test_frames_equal_published_ones():
    # Polls of MON-VER and NAV-PVT, as they stand in many manuals.
    assert ubx_frame(0x0A, 0x04, b"") == bytes.fromhex("B5620A0400000E34")
    assert ubx_frame(0x01, 0x07, b"") == bytes.fromhex("B5620107000008 19".replace(" ", ""))


@given(st.binary(max_size=3000))
@settings(derandomize=True, max_examples=60)
def test_checksum_equals_the_loop_of_the_interface_description(body):
    a = b = 0
    for byte in body:
        a = (a + byte) & 255
        b = (b + a) & 255
    assert checksum(body) == bytes((a, b))


@given(st.integers(1000 * WEEK_NS, 4000 * WEEK_NS))
@settings(derandomize=True, max_examples=40, deadline=None)
def test_header_has_week_time_and_leap_seconds(time_ns):
    """The measurements are compared in `test_rawx_reader`."""
    message = parsed(format_raw_measurements(replace(one_signal(), time_ns=time_ns)))
    assert (message.identity, message.numMeas, message.payload[13]) == ("RXM-RAWX", 1, 1)
    assert (message.week, round(message.rcvTow * 1e9)) == divmod(time_ns, WEEK_NS)
    assert (message.leapSec, message.clkReset) == (1, 0)
    assert message.leapS == gps_minus_utc_s(time_ns)


def test_signal_ids_are_those_of_the_interface_description():
    for system, signals in IDS.items():
        for name, (theirs, signal_id) in signals.items():
            assert (SIGNAL_IDS[system][name], SIGID[GNSS_IDS[system], signal_id]) == (signal_id, theirs)
    for name, (theirs, signal_id) in GEOSTATIONARY.items():
        row = {"satellite": satellite_number("C03"), "signal": signal_number(name)}
        assert parsed(format_raw_measurements(one_signal(**row))).sigId_01 == signal_id
        assert SIGID[GNSS_IDS["C"], signal_id] == theirs


def one_signal(**changes):
    epoch = random_epoch(
        np.random.default_rng(1), 2300 * WEEK_NS, carriers={"G": {"1C": 1575.42e6}}, missing=0.0
    )
    first = {name: getattr(epoch, name)[:1] for name in type(epoch).__slots__ if name != "time_ns"} | {
        name: np.array([value]) for name, value in changes.items()
    }
    return replace(epoch, **first)


def doubled(epoch):
    """Each observation twice."""
    columns = {name: np.tile(getattr(epoch, name), 2) for name in type(epoch).__slots__ if name != "time_ns"}
    return replace(epoch, **columns)


def test_weaker_signal_has_greater_standard_deviations():
    reported = []
    for cn0 in (50.0, 40.0, 30.0, math.nan, 20.0):
        message = parsed(format_raw_measurements(one_signal(cn0_dbhz=cn0)))
        reported.append((message.prStd_01, message.cpStd_01, message.doStd_01))
    assert reported == sorted(reported)
    assert reported[0] < reported[2] < reported[4]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"signal": signal_number("2W")}, "2W: u-blox has no number for this signal"),
        ({"satellite": satellite_number("R01")}, "R01 1C: u-blox has no number"),
        ({"pseudorange_m": math.inf}, "1C: pseudorange is not finite"),
        ({"carrier_phase_cycles": -math.inf}, "1C: carrier phase is not finite"),
        ({"doppler_hz": math.inf}, "1C: Doppler is not finite"),
        ({"cn0_dbhz": 256.0}, "1C: C/N0 is out of range, expected 0 to 255 dB-Hz"),
        ({"cn0_dbhz": -1.0}, "1C: C/N0 is out of range"),
        ({"lock_time_s": -0.1}, "1C: lock time is negative"),
    ],
)
def test_values_out_of_range_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        format_raw_measurements(one_signal(**changes))


def test_data_and_pilot_are_encoded_as_pilot_and_repeats_refused():
    epoch = one_signal(satellite=satellite_number("E07"), signal=signal_number("7X"))
    message = parsed(format_raw_measurements(epoch))
    assert (message.gnssId_01, message.svId_01, message.sigId_01) == (2, 7, 6)
    twice = replace(doubled(epoch), signal=np.array([signal_number("7X"), signal_number("7Q")]))
    with pytest.raises(ValueError, match="E07 7Q: observed twice in one epoch"):
        format_raw_measurements(twice)


def test_more_than_255_measurements_are_refused():
    epoch = random_epoch(np.random.default_rng(5), 2300 * WEEK_NS, satellites=63)
    while epoch.satellite.size <= 255:
        epoch = doubled(epoch)
    with pytest.raises(ValueError, match="measurements in one epoch, expected at most 255"):
        format_raw_measurements(epoch)


SOLUTION = solutions(
    time_ns=st.integers(1500 * WEEK_NS, 3900 * WEEK_NS),
    covariance_enu_m2=st.none() | DIAGONAL_COVARIANCES,
    velocity_covariance_enu_m2_s2=st.none() | st.just((0.01, 0.0, 0.0, 0.01, 0.0, 0.04)),
)


@given(SOLUTION, st.floats(-100.0, 100.0))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_pyubx2_decodes_nav_pvt(solution, separation_m):
    message = parsed(format_position_velocity_time(solution, geoid_separation_m=separation_m))
    assert message.identity == "NAV-PVT"
    assert message.iTOW == solution.time_ns % WEEK_NS // 1_000_000
    utc = utc_from_gps_ns(solution.time_ns)
    names = ("year", "month", "day", "hour", "min", "second", "nano")
    assert tuple(getattr(message, name) for name in names) == tuple(utc)
    assert (message.validDate, message.validTime, message.fullyResolved) == (1, 1, 1)
    assert message.lat == pytest.approx(math.degrees(solution.latitude_rad), abs=0.51e-7)
    assert message.lon == pytest.approx(math.degrees(solution.longitude_rad), abs=0.51e-7)
    assert message.height == pytest.approx(solution.height_m * 1e3, abs=0.51)
    assert message.hMSL == pytest.approx((solution.height_m - separation_m) * 1e3, abs=0.51)
    assert message.carrSoln == {SolutionQuality.FIX: 2, SolutionQuality.FLOAT: 1}.get(solution.quality, 0)
    assert message.diffSoln == (solution.quality.name in ("FIX", "FLOAT", "SBAS", "DGPS"))
    assert message.fixType == (1 if solution.quality is SolutionQuality.DEAD_RECKONING else 3)
    assert message.numSV == (solution.satellites or 0)
    if solution.covariance_enu_m2 is None:
        assert message.hAcc == message.vAcc == 0xFFFFFFFF
    else:
        ee, _, _, nn, _, uu = solution.covariance_enu_m2
        assert message.hAcc == pytest.approx(max(math.sqrt(ee + nn) * 1e3, 1.0), abs=0.51)
        assert message.vAcc == pytest.approx(max(math.sqrt(uu) * 1e3, 1.0), abs=0.51)
    east, north, up = solution.velocity_enu_m_s or (0.0, 0.0, 0.0)
    velocity_mm_s = (east * 1e3, north * 1e3, -up * 1e3)
    assert (message.velE, message.velN, message.velD) == pytest.approx(velocity_mm_s, abs=0.51)
    if math.hypot(east, north) > 0.01:
        heading = math.degrees(math.atan2(east, north))
        assert abs(math.remainder(message.headMot - heading, 360.0)) < 1e-5
    unknown = solution.velocity_enu_m_s is None or solution.velocity_covariance_enu_m2_s2 is None
    assert (message.sAcc == 0xFFFFFFFF) == unknown
    limits = (0, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120)
    if solution.age_s is None:
        assert message.lastCorrectionAge == 0
    else:
        assert limits[message.lastCorrectionAge - 1] <= solution.age_s
        assert message.lastCorrectionAge == 12 or solution.age_s < limits[message.lastCorrectionAge]


@given(SOLUTION, st.floats(-100.0, 100.0))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_pyubx2_decodes_nav_hpposllh(solution, separation_m):
    message = parsed(format_high_precision_position(solution, geoid_separation_m=separation_m))
    assert message.identity == "NAV-HPPOSLLH"
    assert message.iTOW == solution.time_ns % WEEK_NS // 1_000_000
    # pyubx2 adds the parts up: degrees to 1e-9, heights in mm to 0.1.
    assert message.lat == pytest.approx(math.degrees(solution.latitude_rad), abs=0.6e-9)
    assert message.lon == pytest.approx(math.degrees(solution.longitude_rad), abs=0.6e-9)
    assert message.height == pytest.approx(solution.height_m * 1e3, abs=0.051)
    assert message.hMSL == pytest.approx((solution.height_m - separation_m) * 1e3, abs=0.051)


def test_nonfinite_position_is_refused():
    place = {"latitude_rad": math.nan, "longitude_rad": 0.0, "height_m": 0.0}
    solution = ReceiverSolution(time_ns=2300 * WEEK_NS, **place, quality=SolutionQuality.FIX)
    for write in (format_position_velocity_time, format_high_precision_position):
        with pytest.raises(ValueError, match="expected a finite number"):
            write(solution, geoid_separation_m=0.0)

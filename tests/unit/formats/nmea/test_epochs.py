"""NMEA streams: epochs, dates, heights, refused content, and malformed input that must never raise."""

import itertools
import math
import random
import struct
from dataclasses import replace
from datetime import date
from io import BytesIO
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from camber.formats.errors import FormatError
from camber.formats.nmea.epochs import NmeaDecoder, NmeaResult, read_nmea
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.frame_search import MAX_SENTENCE_BYTES
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_utc
from camber.schemas.gnss import ReceiverIntegrity
from support.gnss_files import nmea_sentence as sentence
from support.gnss_files import recording
from support.random_solutions import qualities_without, solutions

Results = list[NmeaResult]

DAY = date(2023, 7, 11)
GGA = "GNGGA,060432.20,3509.9216520,N,13652.8845720,E,4,16,0.7,3.9182,M,37.4900,M,1.2,0000"
GST = "GNGST,060432.20,,0.012,0.008,30.0,0.0113,0.0092,0.021"
RMC = "GNRMC,060432.20,A,3509.92,N,13652.88,E,0.1,12.0,110723,,,R,V"


def decode(data: bytes, *, utc_date: date | None = DAY) -> Results:
    decoder = NmeaDecoder("port", utc_date=utc_date)
    return decoder.feed(data) + decoder.finish()


def solution_of(data: bytes) -> ReceiverSolution:
    (result,) = decode(data)
    assert isinstance(result, ReceiverSolution), str(result)
    return result


def error_of(data: bytes, **options: Any) -> str:
    (result,) = decode(data, **options)
    assert isinstance(result, FormatError)
    assert "\n" not in str(result)
    return str(result)


def at(content: str, time: str) -> bytes:
    return sentence(content.replace("060432.20", time))


def solutions_in(results: Results) -> list[ReceiverSolution]:
    return [result for result in results if isinstance(result, ReceiverSolution)]


def test_gga_gst_and_rmc_make_one_solution() -> None:
    (solution,) = decode(sentence(GGA) + sentence(GST) + sentence(RMC), utc_date=None)
    assert isinstance(solution, ReceiverSolution)
    assert solution.time_ns == gps_ns_from_utc(CalendarTime(2023, 7, 11, 6, 4, 32, 200_000_000))
    assert math.degrees(solution.latitude_rad) == pytest.approx(35.165360867, abs=1e-9)
    assert math.degrees(solution.longitude_rad) == pytest.approx(136.881409533, abs=1e-9)
    assert solution.height_m == 41.4082
    assert (solution.quality, solution.satellites, solution.age_s) == (SolutionQuality.FIX, 16, 1.2)
    assert solution.ratio is None
    assert solution.velocity_enu_m_s is None
    assert solution.covariance_enu_m2 is not None
    ee, en, eu, nn, nu, uu = solution.covariance_enu_m2
    assert (ee, nn, uu) == pytest.approx((0.0092**2, 0.0113**2, 0.021**2))
    # Major axis 30° east of north: east and north errors are correlated; sin 30° · cos 30° = √3/4.
    assert en == pytest.approx((0.012**2 - 0.008**2) * math.sqrt(3.0) / 4.0)
    assert (eu, nu) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("number", "quality"),
    [
        (1, SolutionQuality.SINGLE), (2, SolutionQuality.DGPS), (3, SolutionQuality.PPP),
        (4, SolutionQuality.FIX), (5, SolutionQuality.FLOAT), (6, SolutionQuality.DEAD_RECKONING),
    ],
)  # fmt: skip
def test_gga_quality_is_mapped(number: int, quality: SolutionQuality) -> None:
    assert solution_of(sentence(GGA.replace(",E,4,", f",E,{number},"))).quality is quality


def test_geoid_separation_is_never_assumed() -> None:
    message = error_of(sentence(GGA.replace("37.4900,M", ",M")))
    assert "geoid separation missing: ellipsoidal height unknown" in message


def test_gga_without_position_is_counted_without_error() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    data = sentence("GNGGA,060432.20,,,,,0,00,99.99,,,,,,") + sentence("GNGGA,,,,,,0,,,,,,,,")
    assert decoder.feed(data) + decoder.finish() == []
    assert decoder.epochs_without_position == 2


def test_alphanumeric_station_is_accepted() -> None:
    solution = solution_of(sentence(GGA[:-4] + "VRS1"))
    assert (solution.quality, solution.station) == (SolutionQuality.FIX, "VRS1")
    assert solution_of(sentence(GGA[:-4])).station is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("3509.92", "9909.92", "latitude"),
        ("3509.92", "3560.92", "minutes below 60"),
        ("13652.88", "18152.88", "longitude"),
        (",N,", ",,", "latitude hemisphere is '', expected N or S"),
        (",N,", ",E,", "expected N or S"),
        (",4,16,", ",7,16,", "simulated positions are not read"),
        (",4,16,", ",8,16,", "quality is '8'"),
        (",4,16,", ",,16,", "quality is ''"),
        (",4,16,", ",4,-1,", "satellites"),
        ("3.9182", "nan", "altitude is 'nan', expected a number"),
        ("3.9182", "", "altitude"),
        ("3.9182", "1e3", "altitude"),
        ("3.9182,M", "3.9182,f", "altitude unit is 'f', expected M"),
        ("060432.20", "250432.20", "expected hhmmss.ss"),
        ("060432.20", "060460.20", "expected hhmmss.ss"),
    ],
)
def test_malformed_field_is_named_with_the_expected_form(old: str, new: str, expected: str) -> None:
    message = error_of(sentence(GGA.replace(old, new, 1)))
    assert message.startswith("port at byte 0: GGA ")
    assert expected in message


def test_covariance_is_unknown_without_gst_of_the_same_time() -> None:
    empty, zero = "GNGST,060432.20,,,,,,,", "GNGST,060432.20,,,,,0.0,0.0,0.0"
    for gst in (b"", sentence(empty), sentence(zero), at(GST, "060432.00")):
        assert solution_of(gst + sentence(GGA)).covariance_enu_m2 is None


def test_malformed_gst_is_an_error_and_covariance_stays_unknown() -> None:
    error, solution = decode(sentence(GST.replace("0.0113", "-1")) + sentence(GGA))
    assert isinstance(error, FormatError)
    assert "σ of latitude" in str(error)
    assert isinstance(solution, ReceiverSolution)
    assert solution.covariance_enu_m2 is None


# dates


def test_position_without_date_is_an_error() -> None:
    assert "GGA date, expected an RMC or ZDA sentence" in error_of(sentence(GGA), utc_date=None)
    void = RMC.replace(",A,", ",V,")
    assert "GGA date" in error_of(sentence(GGA) + sentence(void), utc_date=None)


def test_zda_overrides_the_given_date() -> None:
    zda = sentence("GPZDA,060431.00,12,07,2023,00,00")
    (solution,) = decode(zda + sentence(GGA), utc_date=date(2020, 1, 1))
    assert isinstance(solution, ReceiverSolution)
    assert solution.time_ns == gps_ns_from_utc(CalendarTime(2023, 7, 12, 6, 4, 32, 200_000_000))


@pytest.mark.parametrize("content", ["GPZDA,060431.00,31,02,2023,00,00", RMC.replace("110723", "310223")])
def test_impossible_date_is_an_error(content: str) -> None:
    assert "date" in error_of(sentence(content), utc_date=None)


def test_date_advances_at_midnight() -> None:
    stream = b"".join(at(GGA, time) for time in ("235959.80", "235959.90", "000000.00", "000000.10"))
    times = [s.time_ns for s in solutions_in(decode(stream))]
    assert [(b - a) for a, b in itertools.pairwise(times)] == [NS_PER_SECOND // 10] * 3


def test_sentence_from_before_midnight_has_the_previous_date() -> None:
    stream = sentence("GPZDA,000000.00,12,07,2023,00,00") + at(GGA, "235959.90")
    (solution,) = decode(stream)
    assert isinstance(solution, ReceiverSolution)
    assert solution.time_ns == gps_ns_from_utc(CalendarTime(2023, 7, 11, 23, 59, 59, 900_000_000))


def test_leap_second_of_2016_is_one_second_long() -> None:
    stream = b"".join(at(GGA, time) for time in ("235959.00", "235960.00", "000000.00"))
    times = [s.time_ns for s in solutions_in(decode(stream, utc_date=date(2016, 12, 31)))]
    assert [(b - a) for a, b in itertools.pairwise(times)] == [NS_PER_SECOND] * 2
    assert "UTC time that exists" in error_of(at(GGA, "235960.00"))


# when a solution comes out


def epoch(time: str, *contents: str) -> bytes:
    return b"".join(at(content, time) for content in contents)


def delays(stream: list[bytes], decoder: NmeaDecoder) -> list[int]:
    return [len(decoder.feed(part)) for part in stream]


@pytest.mark.parametrize("order", [(GGA, GST), (RMC, GST, GGA), (RMC, GGA, GST), (GST, GGA, RMC)])
def test_last_sentence_is_learnt_and_ends_the_epoch_at_once(order: tuple[str, ...]) -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    stream = [at(content, f"0604{second}.00") for second in (30, 31, 32, 33) for content in order]
    # The first two epochs wait for the next one; when it begins, the second has shown which sentence comes last.
    between = [0] * (len(order) - 2)
    assert delays(stream, decoder) == [0, *between, 0, 1, *between, 0, 1, *between, 1, 0, *between, 1]
    assert decoder.finish() == []


def test_a_missing_last_sentence_delays_until_the_next_epoch_and_not_for_ever() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    learnt = [at(content, f"0604{second}.00") for second in (30, 31, 32) for content in (GGA, GST)]
    assert sum(delays(learnt, decoder)) == 3
    stream = [at(GGA, "060433.00"), at(GGA, "060434.00"), at(GST, "060434.00")]
    assert delays(stream, decoder) == [0, 1, 1]


def test_late_gst_is_counted_and_learnt_from() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    results: Results = []
    for second in (30, 31, 32):
        results += decoder.feed(at(GGA, f"0604{second}.00"))
    for second in (33, 34, 35, 36):
        results += decoder.feed(epoch(f"0604{second}.00", GGA, GST))
    results += decoder.finish()
    known = [s.covariance_enu_m2 is not None for s in solutions_in(results)]
    assert known == [False, False, False, False, True, True, True]
    assert decoder.late_sentences == 1


def test_each_time_is_emitted_once() -> None:
    results = decode(sentence(GGA) + sentence(GGA.replace("GNGGA", "GPGGA")))
    assert [type(result) for result in results] == [FormatError, ReceiverSolution]
    decoder = NmeaDecoder("port", utc_date=DAY)
    decoder.feed(b"".join(at(GGA, f"0604{second}.00") for second in (28, 29, 30)))
    assert len(decoder.feed(sentence(GGA) + sentence(GGA))) == 1
    assert decoder.late_sentences == 1


# framing

UBX = struct.pack("<BBBBH", 0xB5, 0x62, 0x01, 0x07, 8) + b"$GNGG\x00\xffA" + b"\x12\x34"


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (sentence(GGA).replace(b"16", b"17", 1), "expected checksum"),
        (sentence(GGA)[:40] + sentence(GGA), "cut short"),
        (sentence(GGA)[:40] + b"\xb5\x62" + sentence(GGA), "cut short"),
        (sentence(GGA)[:40] + b"\r\n" + sentence(GGA), "cut short"),
        (b"$" + GGA.encode() + b"\r\n" + sentence(GGA), "cut short"),
    ],
)
def test_malformed_sentence_is_an_error_and_the_next_is_decoded(data: bytes, expected: str) -> None:
    error, *solutions = decode(data)
    assert expected in str(error)
    assert str(error).startswith("port at byte 0: sentence")
    assert len(solutions) <= 1
    assert solutions or "checksum" in expected


def test_other_protocols_are_skipped_and_counted() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    assert decoder.feed(UBX.replace(b"GNGG", b"\x00\x01\x02\x03") + sentence(GGA)) == []
    assert decoder.bytes_skipped == len(UBX)
    assert len(decoder.finish()) == 1


def test_endless_sentence_is_dropped_with_bounded_memory() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    results = decoder.feed(b"$GNGGA,")
    for _ in range(100):
        results += decoder.feed(b"1" * 1000)
        assert decoder.bytes_pending <= MAX_SENTENCE_BYTES
    assert [f"at most {MAX_SENTENCE_BYTES}" in str(result) for result in results] == [True]
    decoder.feed(b"\r\n" + sentence(GGA))
    assert len(decoder.finish()) == 1


def test_last_sentence_needs_no_line_end() -> None:
    assert isinstance(decode(sentence(GGA)[:-2])[0], ReceiverSolution)
    assert "cut short" in str(decode(sentence(GGA)[:-3])[0])


SAMPLE = b"".join(epoch(f"0604{second}.00", GGA, GST, RMC) + UBX for second in range(30, 34))


@given(
    st.sampled_from([GGA, GST, RMC]),
    st.integers(0, 14),
    st.text(alphabet=st.characters(codec="ascii"), max_size=9),
)
def test_replaced_field_never_raises_or_gives_nonfinite_numbers(content: str, index: int, value: str) -> None:
    fields = content.split(",")
    fields[min(index, len(fields) - 1)] = value
    for result in solutions_in(decode(sentence(",".join(fields)) + SAMPLE)):
        assert all(map(math.isfinite, (result.latitude_rad, result.longitude_rad, result.height_m)))


@given(st.integers(0, len(SAMPLE) - 1), st.integers(0, 7))
def test_flipped_bit_never_makes_another_solution(byte: int, bit: int) -> None:
    damaged = bytearray(SAMPLE)
    damaged[byte] ^= 1 << bit
    good, decoded = (
        {(s.time_ns, s.latitude_rad, s.height_m) for s in solutions_in(decode(data))}
        for data in (SAMPLE, bytes(damaged))
    )
    assert decoded <= good
    assert len(decoded) >= len(good) - 1


@given(st.integers(0, len(SAMPLE)))
def test_truncation_gives_a_prefix_but_for_the_last_epoch(length: int) -> None:
    part = solutions_in(decode(SAMPLE[:length]))
    assert part[:-1] == solutions_in(decode(SAMPLE))[: max(0, len(part) - 1)]


# writing

covariances = st.builds(
    lambda e, n, u, r: (e * e, r * e * n, 0.0, n * n, 0.0, u * u),
    *[st.floats(0.001, 30.0)] * 3,
    st.floats(-0.95, 0.95),
)


@given(
    solutions(
        time_ns=st.integers(2 * 10**17, 25 * 10**17),
        quality=qualities_without(SolutionQuality.SBAS),
        covariance_enu_m2=st.none() | covariances,
    ),
    st.floats(-100.0, 80.0),
)
def test_written_solutions_are_read_back_and_by_pynmeagps(
    solution: ReceiverSolution, separation: float
) -> None:
    sentences = (
        format_gga(solution, geoid_separation_m=separation),
        format_gst(solution),
        format_rmc(solution),
    )
    (again,) = decode(b"".join(sentences), utc_date=None)
    assert isinstance(again, ReceiverSolution), str(again)
    for name in ("time_ns", "quality", "satellites"):
        assert getattr(again, name) == getattr(solution, name)
    # 1e-7 minutes
    assert again.latitude_rad == pytest.approx(solution.latitude_rad, abs=1.5e-11)
    assert again.longitude_rad == pytest.approx(solution.longitude_rad, abs=1.5e-11)
    assert again.height_m == pytest.approx(solution.height_m, abs=1.1e-4)
    assert (again.age_s is None) == (solution.age_s is None)
    if solution.age_s is not None:
        assert again.age_s == pytest.approx(solution.age_s, abs=0.0051)
    assert (again.covariance_enu_m2 is None) == (solution.covariance_enu_m2 is None)
    if again.covariance_enu_m2 is not None and solution.covariance_enu_m2 is not None:
        largest = math.sqrt(max(solution.covariance_enu_m2))
        for a, b in zip(again.covariance_enu_m2, solution.covariance_enu_m2, strict=True):
            # Also the orientation is printed: 1e-4 degrees of the larger axis.
            assert a == pytest.approx(b, abs=1e-3 * largest + 1e-5 * largest**2)
    gga, gst, rmc = (cast(Any, NMEAReader.parse(sentence)) for sentence in sentences)
    assert gga.identity == "GNGGA"
    assert gga.lat == pytest.approx(math.degrees(solution.latitude_rad), abs=2e-9)
    assert gga.lon == pytest.approx(math.degrees(solution.longitude_rad), abs=2e-9)
    assert gga.alt + gga.sep == pytest.approx(solution.height_m, abs=1.1e-4)
    assert rmc.lat == gga.lat
    if solution.covariance_enu_m2 is not None:
        ee, _, _, nn, _, uu = solution.covariance_enu_m2
        for printed, variance in ((gst.stdLong, ee), (gst.stdLat, nn), (gst.stdAlt, uu)):
            assert printed == pytest.approx(math.sqrt(variance), abs=0.51e-4)
    if solution.velocity_enu_m_s is not None:
        speed_m_s = math.hypot(*solution.velocity_enu_m_s[:2])
        assert rmc.spd * 1852.0 / 3600.0 == pytest.approx(speed_m_s, abs=1e-4)


AT_ORIGIN = ReceiverSolution(
    time_ns=10**18, latitude_rad=0.0, longitude_rad=0.0, height_m=0.0, quality=SolutionQuality.FIX
)


def test_minutes_are_never_rounded_to_sixty() -> None:
    place = {"latitude_rad": math.radians(35.0 - 1e-12), "longitude_rad": math.radians(-137.0 + 1e-12)}
    solution = replace(AT_ORIGIN, **place)
    assert b",3500.0000000,N,13700.0000000,W," in format_gga(solution, geoid_separation_m=0.0)


def test_nonfinite_numbers_are_refused_when_writing() -> None:
    with pytest.raises(ValueError, match="finite"):
        format_gga(replace(AT_ORIGIN, height_m=math.nan), geoid_separation_m=0.0)
    with pytest.raises(ValueError, match="finite"):
        format_rmc(replace(AT_ORIGIN, latitude_rad=math.nan))


def test_recorded_console_has_no_error_and_no_position() -> None:
    path = recording("receiver-logs/ubx-2023-4-17_82912_serial-COM3.ubx")
    data = path.read_bytes()
    decoder = NmeaDecoder(path.name)
    assert decoder.feed(data) + decoder.finish() == []
    oracle = [str(parsed.identity) for _, parsed in NMEAReader(BytesIO(data), nmeaonly=False) if parsed]
    assert decoder.epochs_without_position == sum(identity.endswith("GGA") for identity in oracle) > 50
    assert list(read_nmea(path)) == []


def gbs(content: str, talker: str = "GN") -> bytes:
    return sentence(f"{talker}GBS,120000.00,{content}")


def gbs_report(data: bytes) -> ReceiverIntegrity:
    (decoded,) = decode(data)
    assert isinstance(decoded, ReceiverIntegrity)
    return decoded


def test_gbs_gives_the_raim_result() -> None:
    passed = gbs_report(gbs("1.6,1.4,3.2,,,,,,"))
    assert (passed.raim, passed.suspect_satellite) == ("passed", None)
    assert passed.expected_error_enu_m == (1.4, 1.6, 3.2)
    assert passed.time_ns == gps_ns_from_utc(CalendarTime(DAY.year, DAY.month, DAY.day, 12, 0, 0))
    # The example of u-blox' interface description, and one of Trimble's.
    failed = gbs_report(gbs("1.4,1.3,3.1,03,,-21.4,3.8,1,0", "GP"))
    assert (failed.raim, failed.suspect_satellite) == ("failed", "G03")
    assert (failed.suspect_bias_m, failed.suspect_bias_sigma_m) == (-21.4, 3.8)
    assert failed.missed_detection_probability is None
    other = gbs_report(gbs("-0.031,-0.186,0.219,19,0.000,-0.354,6.972", "GP"))
    assert other.expected_error_enu_m == (-0.186, -0.031, 0.219)
    assert (other.suspect_satellite, other.missed_detection_probability) == ("G19", 0.0)
    # With four satellites there is nothing to check.
    assert gbs_report(gbs(",,,,,,,,")).raim == "unknown"
    assert gbs_report(gbs(",,,07,,,,1,1")).raim == "failed"
    for decoded in (passed, failed, other):
        assert (decoded.jamming, decoded.spoofing, decoded.integrity_risk) == ("unknown", "unknown", None)


@pytest.mark.parametrize(
    ("number", "system_id", "talker", "name"),
    [
        ("03", "1", "GN", "G03"), ("03", "", "GP", "G03"), ("34", "1", "GN", "S21"),
        ("68", "2", "GN", "R04"), ("11", "3", "GN", "E11"), ("311", "3", "GN", "E11"),
        ("11", "", "GA", "E11"), ("33", "4", "GN", "C33"), ("433", "4", "GN", "C33"),
        ("02", "5", "GN", "J02"), ("194", "5", "GQ", "J02"), ("05", "", "GN", "05"),
        ("193", "1", "GN", "193"),
    ],
)  # fmt: skip
def test_gbs_satellite_name_follows_system_and_talker(
    number: str, system_id: str, talker: str, name: str
) -> None:
    assert gbs_report(gbs(f"1.4,1.3,3.1,{number},,-21.4,3.8,{system_id},0", talker)).suspect_satellite == name


def test_gbs_equals_that_of_pynmeagps() -> None:
    rng = random.Random(3)
    for _ in range(200):
        values = [f"{rng.uniform(-50.0, 50.0):.{rng.randrange(4)}f}" for _ in range(4)]
        data = gbs(f"{values[0]},{values[1]},{values[2]},{rng.randrange(1, 33):02d},,{values[3]},3.5,1,0")
        oracle = NMEAReader.parse(data)
        decoded = gbs_report(data)
        assert decoded.expected_error_enu_m == (oracle.errLon, oracle.errLat, oracle.errAlt)
        assert (decoded.suspect_bias_m, decoded.suspect_bias_sigma_m) == (oracle.bias, oracle.stddev)
        assert decoded.suspect_satellite == f"G{oracle.svid:02d}"


def test_gbs_does_not_delay_the_position_of_its_epoch() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    for second in range(5):
        time = f"1200{second:02d}.00"
        decoded = decoder.feed(at(GGA, time))
        after_gbs = decoder.feed(sentence(f"GNGBS,{time},1.6,1.4,3.2,,,,,,"))
        assert [type(result) for result in after_gbs] == [ReceiverIntegrity]
    # Once it is learned that GGA is the last of its epoch, it does not wait for the next.
    assert [type(result) for result in decoded] == [ReceiverSolution]


@pytest.mark.parametrize(
    "content",
    ["1.6,x,3.2,,,,,,", "1.6,1.4,3.2,1e9,,,,,", "1.6,1.4,3.2,03,1.5,,,1,0", "1.6,1.4,3.2,03,,,-1.0,1,0"],
)
def test_gbs_with_malformed_number_is_an_error(content: str) -> None:
    assert "GBS" in error_of(gbs(content))


def test_gbs_without_a_date_is_an_error() -> None:
    assert "GBS date" in error_of(gbs("1.6,1.4,3.2,,,,,,"), utc_date=None)

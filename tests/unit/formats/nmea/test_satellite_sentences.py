"""GSV and GSA: satellites of several systems and signals, what is unknown, and sentences that are missing or wrong."""

from __future__ import annotations

import math
import random
from datetime import date

import pytest
from pynmeagps import NMEAReader

from camber.formats.errors import FormatError
from camber.formats.nmea.epochs import NmeaDecoder, NmeaResult
from camber.formats.nmea.satellite_numbers import satellite_of
from camber.formats.observations import satellite_name
from camber.formats.receiver.satellite_report import ReportedSatellite, SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from support.gnss_files import nmea_sentence as sentence
from support.gnss_files import recording

DAY = date(2023, 7, 11)
START_NS = gps_ns_from_utc(CalendarTime(2023, 7, 11, 6, 4, 32))
# A u-blox M10 outdoors, shortened: groups by signal, the satellites not tracked in a group of signal 0.
SKY = (
    "GNGSA,A,3,10,12,13,,,,,,,,,,1.7,0.9,1.5,1",
    "GNGSA,A,3,65,66,,,,,,,,,,,1.7,0.9,1.5,2",
    "GNGSA,A,3,07,,,,,,,,,,,,1.7,0.9,1.5,3",
    "GNGSA,A,3,,,,,,,,,,,,,1.7,0.9,1.5,4",
    "GPGSV,2,1,05,10,23,294,32,12,41,226,30,13,48,232,28,15,35,189,27,1",
    "GPGSV,2,2,05,17,32,056,16,1",
    "GPGSV,1,1,02,10,23,294,36,12,41,226,28,6",
    "GLGSV,1,1,02,65,58,275,32,66,23,331,33,1",
    "GLGSV,1,1,01,73,12,066,,0",
    "GAGSV,1,1,02,07,46,300,31,08,,,20,7",
    "GBGSV,1,1,00,1",
)


def gga(seconds: int, quality: int = 4) -> bytes:
    place = "3509.9216520,N,13652.8845720,E,{},16,0.7,3.9182,M,37.4900,M,1.2,0000"
    return sentence(f"GNGGA,0604{32 + seconds:02d}.00,{place.format(quality)}")


def sky(*contents: str) -> bytes:
    return b"".join(map(sentence, contents))


def decode(data: bytes) -> tuple[list[NmeaResult], NmeaDecoder]:
    decoder = NmeaDecoder("port", utc_date=DAY)
    return decoder.feed(data) + decoder.finish(), decoder


def report_of(*contents: str) -> SatelliteReport:
    results, _ = decode(gga(0) + sky(*contents))
    (report,) = (result for result in results if isinstance(result, SatelliteReport))
    return report


def by_name(report: SatelliteReport) -> dict[str, ReportedSatellite]:
    return {satellite_name(row.satellite): row for row in report.satellites}


def uses(*contents: str) -> dict[str, str]:
    return {name: row.use for name, row in by_name(report_of(*contents)).items()}


def test_satellites_of_several_systems_and_signals() -> None:
    report = report_of(*SKY)
    assert (report.time_ns, report.quality) == (START_NS, SolutionQuality.FIX)
    rows = by_name(report)
    assert {name: row.use for name, row in rows.items()} == {
        **dict.fromkeys(("G10", "G12", "G13", "R01", "R02", "E07"), "used"),
        **dict.fromkeys(("G15", "G17", "E08"), "reason_not_reported"),
        "R09": "no_pseudorange",
    }
    # Of several signals the strongest.
    assert [rows[name].cn0_dbhz for name in ("G10", "G12", "E08", "R09")] == [36.0, 30.0, 20.0, None]
    assert rows["G10"].direction_rad == (math.radians(294), math.radians(23))
    assert rows["E08"].direction_rad is None


def test_satellites_come_when_the_next_epoch_begins_and_leave_its_position_alone() -> None:
    decoder = NmeaDecoder("port", utc_date=DAY)
    kinds = [
        [type(result) for result in decoder.feed(gga(second)) + decoder.feed(sky(*SKY))]
        for second in range(4)
    ]
    assert kinds[0] == []
    # Once it is learnt that GGA ends an epoch, the position does not wait for GSV.
    assert kinds[3] == [SatelliteReport, ReceiverSolution]
    assert [type(result) for result in decoder.finish()] == [SatelliteReport]


def test_an_epoch_without_gsv_has_no_satellites() -> None:
    results, _ = decode(gga(0) + sky(*SKY) + gga(1) + sky(*SKY[:4]) + gga(2))
    assert [result.time_ns for result in results if isinstance(result, SatelliteReport)] == [START_NS]


def test_without_a_position_the_satellites_have_no_quality() -> None:
    empty = sentence("GNGGA,060432.00,,,,,0,00,99.99,,,,,,")
    results, _ = decode(
        empty + sky("GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1", "GPGSV,1,1,01,05,45,120,40,1")
    )
    (report,) = results
    assert isinstance(report, SatelliteReport)
    assert (report.time_ns, report.quality) == (START_NS, None)


def test_before_the_time_is_known_nothing_is_reported_or_kept() -> None:
    empty = sentence("GNGGA,,,,,,0,00,99.99,,,,,,")
    results, decoder = decode((empty + sky("GPGSV,1,1,01,05,45,120,40,1")) * 3 + gga(0) + sky(*SKY) + gga(1))
    (report,) = (result for result in results if isinstance(result, SatelliteReport))
    assert "G05" not in by_name(report)
    assert decoder.incomplete == 0


def test_without_gga_there_is_no_report() -> None:
    rmc = "GNRMC,060432.00,A,3509.92,N,13652.88,E,0.1,12.0,110723,,,R,V"
    assert decode(sentence(rmc) + sky(*SKY))[0] == []


# ---------------------------------------------------------------------------------------------------------- the use


def test_without_gsa_the_use_is_unknown() -> None:
    assert uses("GPGSV,1,1,02,05,45,120,40,06,20,010,,1") == {
        "G05": "use_not_reported",
        "G06": "no_pseudorange",
    }


FULL = "GNGSA,A,3,01,02,03,04,05,06,07,08,09,10,11,12,1.7,0.9,1.5,1"
VIEW = ("GPGSV,1,1,03,01,45,120,40,13,20,010,30,40,20,010,30,1", "GAGSV,1,1,01,03,45,120,40,7")
GALILEO_USE = "GNGSA,A,3,,,,,,,,,,,,,1.7,0.9,1.5,3"


def test_a_full_gsa_leaves_the_use_of_the_rest_of_its_system_unknown() -> None:
    use = uses(FULL, GALILEO_USE, *VIEW)
    assert [use[name] for name in ("G01", "G13", "S27", "E03")] == [
        "used",
        "use_not_reported",
        "use_not_reported",
        "reason_not_reported",
    ]
    # A further sentence of the system, as some receivers send it, completes the list.
    use = uses(FULL, "GNGSA,A,3,13,,,,,,,,,,,,1.7,0.9,1.5,1", GALILEO_USE, *VIEW)
    assert [use[name] for name in ("G13", "S27")] == ["used", "reason_not_reported"]


def test_a_full_gsa_without_a_system_id_leaves_the_use_of_all_others_unknown() -> None:
    old = FULL.rpartition(",")[0]
    glonass = "GNGSA,A,3,81,,,,,,,,,,,,1.7,0.9,1.5"
    use = uses(old, glonass, "GPGSV,1,1,01,13,45,120,40", "GLGSV,1,1,02,81,45,120,40,82,45,100,40")
    assert [use[name] for name in ("G13", "R17", "R18")] == ["use_not_reported", "used", "use_not_reported"]


def test_a_used_satellite_without_gsv_is_listed_without_a_direction() -> None:
    row = by_name(report_of("GNGSA,A,3,05,06,,,,,,,,,,,1.7,0.9,1.5,1", "GPGSV,1,1,01,05,45,120,40,1"))["G06"]
    assert (row.direction_rad, row.cn0_dbhz, row.use) == (None, None, "used")


# ------------------------------------------------------------------------------------------------------ the numbers


@pytest.mark.parametrize(
    ("talker", "number", "name"),
    [
        ("GP", "32", "G32"), ("GP", "33", "S20"), ("GP", "64", "S51"), ("GP", "131", "S31"),
        ("GP", "193", "J01"), ("GL", "65", "R01"), ("GL", "88", "R24"), ("GA", "36", "E36"),
        ("GA", "301", "E01"), ("GB", "60", "C60"), ("BD", "201", "C01"), ("GQ", "01", "J01"),
        ("GQ", "194", "J02"), ("GI", "07", "I07"), ("GN", "05", "G05"), ("GN", "70", "R06"),
        ("GN", "311", "E11"), ("GN", "433", "C33"), ("GN", "150", "S50"),
        ("GP", "00", None), ("GP", "250", None), ("GL", "", None), ("GL", "50", None), ("GA", "100", None),
        ("GQ", "150", None), ("GN", "999", None),
    ],
)  # fmt: skip
def test_the_satellite_follows_from_talker_and_number(talker: str, number: str, name: str | None) -> None:
    results, decoder = decode(gga(0) + sky(f"{talker}GSV,1,1,01,{number},45,120,40,1"))
    (report,) = (result for result in results if isinstance(result, SatelliteReport))
    assert list(by_name(report)) == ([] if name is None else [name])
    assert decoder.satellites.unknown_satellites == (name is None)


def test_no_number_is_of_two_satellites_and_each_satellite_fits_its_message() -> None:
    for system in ("", *"GRECJI"):
        decoded = [satellite_of(system, number) for number in range(1000)]
        assert all(each is None or satellite_name(each)[1:] > "00" for each in decoded)
        assert len({each for each in decoded if each is not None}) < 448


# ------------------------------------------------------------------------------------------------------- damaged input


@pytest.mark.parametrize(
    ("kept", "incomplete"),
    # Of those that do not end with the last sentence the next group shows it. A stream may begin within a group.
    [((4,), 1), ((5,), 0), ((4, 4, 5), 1), ((4, 5, 5), 1), ((5, 4), 1), ((4, 5), 0)],
)
def test_a_missing_or_repeated_sentence_costs_no_other_satellites(
    kept: tuple[int, ...], incomplete: int
) -> None:
    results, decoder = decode(gga(0) + sky(*(SKY[k] for k in kept)) + gga(1) + sky(*SKY))
    first, second = (result for result in results if isinstance(result, SatelliteReport))
    held = {4: {"G10", "G12", "G13", "G15"}, 5: {"G17"}}
    assert set(by_name(first)) == set().union(*(held[k] for k in kept))
    assert len(second.satellites) == 10
    assert decoder.incomplete == incomplete


def test_empty_fields_at_the_end_are_no_satellites() -> None:
    results, decoder = decode(gga(0) + sky("GPGSV,1,1,01,05,45,120,40,,,,,,,,,,,,"))
    (report,) = (result for result in results if isinstance(result, SatelliteReport))
    assert list(by_name(report)) == ["G05"]
    assert decoder.satellites.unknown_satellites == 0


def test_sentences_without_their_number_are_read() -> None:
    # As some instruments send them.
    results, decoder = decode(
        (gga(0) + sky("GPGSV,2,1,05,8,13,62,35,13,50,277,39", "GPGSV,,2,,7,43,71,39,30,73,107,38")) * 2
    )
    report = next(result for result in results if isinstance(result, SatelliteReport))
    assert list(by_name(report)) == ["G08", "G13", "G07", "G30"]
    assert decoder.incomplete == 0


def test_of_contradictory_sentences_the_last_counts() -> None:
    row = by_name(report_of("GPGSV,1,1,01,05,45,120,40,1", "GPGSV,1,1,01,05,50,130,20,1"))["G05"]
    assert row.direction_rad == (math.radians(130), math.radians(50))
    assert row.cn0_dbhz == 20.0


@pytest.mark.parametrize(
    "content",
    [
        "GPGSV,1,1,01,05,45,120,40,1,1,1", "GPGSV,1", "GPGSV,1,1,01,05,45,120,40,XY",
        "GPGSV,0,1,01,05,45,120,40,1", "GPGSV,1,100,01,05,45,120,40,1", "GPGSV,1,1,01,5e1,45,120,40,1",
        "GPGSV,1,1,01,05,nan,120,40,1", "GPGSV,1,1,01,05,45,1e3,40,1", "GPGSV,1,1,01,05,45,120,-1,1",
        "GPGSV,1,1,01,-5,45,120,40,1", "GPGSV,1,1,01,5.5,45,120,40,1", "GNGSA,A,3,x,,,,,,,,,,,,1.7,0.9,1.5,1",
    ],
)  # fmt: skip
def test_a_malformed_sentence_is_an_error_and_not_used_at_all(content: str) -> None:
    results, _ = decode(gga(0) + sky("GPGSV,1,1,01,06,45,120,40,1", content))
    (error,) = (result for result in results if isinstance(result, FormatError))
    assert content[2:5] in str(error)
    (report,) = (result for result in results if isinstance(result, SatelliteReport))
    assert {name: row.use for name, row in by_name(report).items()} == {"G06": "use_not_reported"}


@pytest.mark.parametrize("direction", ["91,120", "-91,120", "45,361", ",120", "45,", ","])
def test_a_direction_that_is_none_is_unknown(direction: str) -> None:
    row = by_name(report_of(f"GPGSV,1,1,01,05,{direction},40,1"))["G05"]
    assert (row.direction_rad, row.cn0_dbhz) == (None, 40.0)


def test_other_talkers_are_not_read() -> None:
    assert [type(result) for result in decode(gga(0) + sky("XXGSV,x", "XXGSA,x", "PUBX,03"))[0]] == [
        ReceiverSolution
    ]


def test_thousands_of_satellites_keep_memory_bounded() -> None:
    rng = random.Random(4)
    decoder = NmeaDecoder("port", utc_date=DAY)
    decoder.feed(gga(0))
    for _ in range(3000):
        rows = ",".join(f"{rng.randrange(1000)},45,120,40" for _ in range(4))
        decoder.feed(sentence(f"{rng.choice(('GP', 'GL', 'GN'))}GSV,1,1,99,{rows},{rng.randrange(16):X}"))
        decoder.feed(
            sentence(
                f"GNGSA,A,3,{','.join(str(rng.randrange(1000)) for _ in range(12))},1,1,1,{rng.randrange(9)}"
            )
        )
    (report,) = (result for result in decoder.finish() if isinstance(result, SatelliteReport))
    assert 200 < len(report.satellites) == len({row.satellite for row in report.satellites}) < 448


# -------------------------------------------------------------------------------------------------------------- oracle


def test_values_equal_those_of_pynmeagps() -> None:
    rng = random.Random(7)
    for _ in range(100):
        rows = [
            (number, rng.randrange(91), rng.randrange(360), rng.randrange(1, 60))
            for number in rng.sample(range(1, 33), rng.randrange(1, 5))
        ]
        used = rng.sample(range(1, 33), rng.randrange(12))
        view = "GPGSV,1,1,{:02d},{},1".format(
            len(rows), ",".join(f"{n:02d},{e:02d},{a:03d},{c:02d}" for n, e, a, c in rows)
        )
        slots = ",".join([f"{n:02d}" for n in used] + [""] * (12 - len(used)))
        use = f"GNGSA,A,3,{slots},1.7,0.9,1.5,1"
        satellites, active = NMEAReader.parse(sentence(view)), NMEAReader.parse(sentence(use))
        decoded = by_name(report_of(view, use))
        for k in range(1, len(rows) + 1):
            row = decoded[f"G{int(getattr(satellites, f'svid_{k:02d}')):02d}"]
            azimuth_deg, elevation_deg = (
                float(getattr(satellites, f"{what}_{k:02d}")) for what in ("az", "elv")
            )
            assert row.direction_rad == (math.radians(azimuth_deg), math.radians(elevation_deg))
            assert row.cn0_dbhz == getattr(satellites, f"cno_{k:02d}")
        of_oracle = {getattr(active, f"svid_{k:02d}") for k in range(1, 13)} - {""}
        assert {int(name[1:]) for name, row in decoded.items() if row.use == "used"} == {
            int(n) for n in of_oracle
        }


def test_a_recorded_console_without_a_position_has_its_satellites() -> None:
    data = recording("receiver-logs/ubx-2023-4-17_82912_serial-COM3.ubx").read_bytes()
    decoder = NmeaDecoder("port", utc_date=date(2023, 4, 17))
    results = decoder.feed(data) + decoder.finish()
    reports = [result for result in results if isinstance(result, SatelliteReport)]
    assert reports == results
    assert len(reports) > 40
    rows = {name: row for report in reports for name, row in by_name(report).items()}
    assert {"G06", "G25"} <= set(rows)
    assert all(row.direction_rad is None and row.use != "used" for row in rows.values())
    # Of GLONASS a signal without a satellite's number.
    assert decoder.satellites.unknown_satellites > 10

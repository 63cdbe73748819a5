"""Observation files: written and decoded, all variants of the format, and malformed input."""

import gzip
import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rinex.writer import StationHeader
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst, utc_from_gps_ns
from support.gnss_files import fed_in_pieces, observation_text, read_observations, recording
from support.random_observations import random_epoch
from support.simple_rinex import assert_equal_to_simple_reader

NOON_NS = gps_ns_from_gpst(CalendarTime(2024, 2, 29, 12, 0, 0))
STATION = StationHeader(marker="ROVER", position_ecef_m=(-3810975.7625, 3566658.9114, 3653334.735))
COLUMNS = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz")


def line(content: str, label: str) -> str:
    return f"{content:<60}{label}\n"


def header(
    *more: str,
    version: float = 3.04,
    types: Sequence[str] = ("G    4 C1C L1C D1C S1C",),
    time_system: str = "GPS",
) -> str:
    return (
        line(f"{version:9.2f}{'':11}{'OBSERVATION DATA':<20}M", "RINEX VERSION / TYPE")
        + "".join(line(t, "SYS / # / OBS TYPES") for t in types)
        + "".join(more)
        + line(f"  2024     2    29    12     0    0.0000000     {time_system}", "TIME OF FIRST OBS")
        + line("", "END OF HEADER")
    )


def head(count: int, second: float = 0.0, flag: int = 0, rest: str = "") -> str:
    return f"> 2024 02 29 12 00 {second:10.7f}  {flag}{count:3d}{rest}\n"


def cell(value: float, lli: str = " ", level: str = " ") -> str:
    return f"{value:14.3f}{lli}{level}"


def satellite(name: str, base: float = 2.1e7, cn0: float = 45.0) -> str:
    return name + cell(base) + cell(base * 5.2) + cell(-123.456) + cell(cn0).rstrip() + "\n"


def decode(text: str | bytes):
    decoder = RinexDecoder("test.obs")
    data = text.encode("latin-1") if isinstance(text, str) else text
    results = decoder.feed(data) + decoder.finish()
    errors = [r for r in results if isinstance(r, FormatError)]
    assert decoder.problems == len(errors)
    return [r for r in results if isinstance(r, ObservationEpoch)], errors, decoder


def rows_of(epoch: ObservationEpoch):
    """{(satellite, signal): the rest of its row}, NaN as None."""
    values = np.column_stack([getattr(epoch, name) for name in COLUMNS])
    flags = zip(epoch.loss_of_lock.tolist(), epoch.half_cycle.tolist(), strict=True)
    keys = zip(
        map(satellite_name, epoch.satellite.tolist()), map(signal_name, epoch.signal.tolist()), strict=True
    )
    return {
        key: (*(None if np.isnan(v) else v for v in row), *flag)
        for key, row, flag in zip(keys, values.tolist(), flags, strict=True)
    }


def same(a: Sequence[ObservationEpoch], b: Sequence[ObservationEpoch]) -> bool:
    return comparable(a) == comparable(b)


def comparable(results):
    return [str(r) if isinstance(r, FormatError) else (r.time_ns, list(rows_of(r).items())) for r in results]


GOOD = head(3) + satellite("G01") + satellite("G02") + satellite("G03")


def printed(epoch: ObservationEpoch):
    """The epoch as the format represents it: three decimals, zero as not observed, flags for phases only."""
    expected = {}
    for key, (code, phase, doppler, cn0, lost, half) in rows_of(epoch).items():
        values = [
            None if v is None or float(f"{v:.3f}") == 0.0 else float(f"{v:.3f}")
            for v in (code, phase, doppler)
        ]
        strength = None if cn0 is None else float(f"{cn0:.3f}")
        if any(v is not None for v in (*values, strength)):
            expected[key] = (*values, strength, lost and phase is not None, half and phase is not None)
    return expected


@pytest.mark.parametrize("seed", range(40))
def test_written_epochs_are_decoded_exactly(seed):
    rng = np.random.default_rng(seed)
    times = NOON_NS + np.cumsum(rng.integers(1, 10**11, 12)) // 100 * 100
    written = [random_epoch(rng, int(t), satellites=int(rng.integers(0, 15))) for t in times]
    text = observation_text(written, STATION)
    read, errors, decoder = decode(text)
    assert not errors
    assert_equal_to_simple_reader(read, text)
    assert [e.time_ns for e in read] == [e.time_ns for e in written]
    assert [rows_of(e) for e in read] == [printed(e) for e in written]
    assert all(np.isnan(e.lock_time_s).all() for e in read)
    assert decoder.header.position_ecef_m == STATION.position_ecef_m
    assert decoder.header.marker == "ROVER"
    assert decoder.header.leap_seconds == 18


def test_missing_values_are_blank_zero_or_after_the_line_end():
    text = header(types=("G    8 C1C L1C D1C S1C C5Q L5Q D5Q S5Q",)) + head(3)
    text += "G01" + cell(2e7) + " " * 16 + cell(0.0) + cell(40.0) + "\n"
    text += "G02" + " " * 64 + cell(2e7) + "\n"
    text += "G03" + " " * 50 + "\r\n"
    (epoch,), errors, _ = decode(text)
    assert not errors
    assert rows_of(epoch) == {
        ("G01", "1C"): (2e7, None, None, 40.0, False, False),
        ("G02", "5Q"): (2e7, None, None, None, False, False),
    }


def test_signal_strength_digit_is_used_without_dbhz():
    text = header() + head(4)
    text += "G01" + cell(2e7, " ", "4") + cell(1e8, " ", "7") + "\n"
    text += "G02" + cell(2e7, " ", "4") + cell(1e8) + cell(5.0) + cell(33.25, " ", "9") + "\n"
    text += "G03" + cell(2e7, " ", "4") + "\n"
    text += "G04" + cell(2e7, " ", "0") + cell(1e8, " ", " ") + "\n"
    (epoch,), errors, _ = decode(text)
    assert not errors
    np.testing.assert_array_equal(epoch.cn0_dbhz, [45.0, 33.25, 27.0, np.nan])
    (other_order,), _, _ = decode(
        header(types=("G    2 L1C C1C",)) + head(1) + "G01" + cell(1e8, " ", "7") + cell(2e7, " ", "4") + "\n"
    )
    assert other_order.cn0_dbhz[0] == 45.0
    _, _, decoder = decode(header(line("DBMW", "SIGNAL STRENGTH UNIT")))
    assert [t.kind for t in decoder.header.types["G"]] == ["C", "L", "D", ""]


@pytest.mark.parametrize(
    ("flag", "lost", "half"), [(" ", 0, 0), ("0", 0, 0), ("1", 1, 0), ("2", 0, 1), ("3", 1, 1), ("4", 0, 0)]
)
def test_loss_of_lock_indicator_bits(flag, lost, half):
    (epoch,), _, _ = decode(header() + head(1) + "G01" + cell(2e7, "3") + cell(1e8, flag) + "\n")
    assert (epoch.loss_of_lock[0], epoch.half_cycle[0]) == (lost, half)


def test_power_failure_sets_loss_of_lock():
    (epoch,), errors, _ = decode(header() + head(2, flag=1) + satellite("G01") + satellite("G02"))
    assert not errors
    assert epoch.loss_of_lock.all()
    assert not epoch.half_cycle.any()


def test_events_update_the_header_and_slip_records_are_ignored():
    event = f">{'':30}4  3\n"
    text = header() + head(1) + satellite("G01")
    text += event + line("E    1 C1C", "SYS / # / OBS TYPES") + line("comment", "COMMENT")
    text += line("NEW", "MARKER NAME")
    text += head(2, 1.0) + satellite("G01") + "E05" + cell(2.5e7) + "\n"
    position = line("  1.0000        2.0000        3.0000", "APPROX POSITION XYZ")
    text += head(0, 2.0, 2) + head(1, 2.0, 3) + position
    text += head(0, 2.5, 5) + head(1, 3.0, 6) + "G01" + cell(0.0) + cell(7.0) + "\n"
    text += head(0, 3.0)
    epochs, errors, decoder = decode(text)
    assert not errors
    assert [e.time_ns - NOON_NS for e in epochs] == [0, 10**9, 3 * 10**9]
    assert list(rows_of(epochs[1])) == [("G01", "1C"), ("E05", "1C")]
    assert epochs[2].satellite.size == 0
    assert decoder.header.marker == "NEW"
    assert decoder.header.position_ecef_m == (1.0, 2.0, 3.0)
    _, errors, _ = decode(text + event + line("a", "COMMENT") * 2 + line("   x", "INTERVAL") + head(0, 4.0))
    assert [e.field for e in errors] == ["INTERVAL"]
    assert errors[0].line_number == text.count("\n") + 4


def test_an_epoch_line_may_have_a_clock_offset_and_picoseconds():
    offset = f"{'':6}{-0.123456789012:15.12f}"
    (epoch,), errors, _ = decode(header() + head(0, 1.2345678, rest=offset))
    assert not errors
    assert epoch.time_ns == NOON_NS + 1_234_567_800
    for text, more_ns in (("12499", 12), ("12500", 13), ("99999", 100)):
        for before in (offset, " " * 21):
            (epoch,), errors, _ = decode(header(version=4.02) + head(0, 1.2345678, rest=f"{before} {text}"))
            assert not errors
            assert epoch.time_ns == NOON_NS + 1_234_567_800 + more_ns
    epochs, errors, _ = decode(header(version=4.02) + head(0, 1.0, rest=offset + " 123"))
    assert not epochs
    assert len(errors) == 1


@pytest.mark.parametrize(
    ("date", "good"),
    [
        ("2024 02 29 12 00", True), ("2023 02 29 12 00", False), ("2000  2 29 12  0", True),
        ("2100 02 29 12 00", False), ("1979 12 31 23 59", False), ("1980 01 06 00 00", True),
        ("1980 01 05 23 59", False), ("2024 12 31 23 59", True), ("2024 11 31 23 59", False),
        ("2024 13 01 00 00", False), ("2024 00 01 00 00", False), ("2024 01 00 00 00", False),
        ("2024 01 01 24 00", False), ("2024 01 01 00 60", False),
    ],
)  # fmt: skip
def test_calendar_dates_are_checked(date, good):
    epochs, errors, _ = decode(header() + f"> {date} 59.9999999  0  0\n")
    assert len(errors) == (not good)
    if good:
        year, month, day, hour, minute = map(int, date.split())
        assert epochs[0].time_ns == gps_ns_from_gpst(
            CalendarTime(year, month, day, hour, minute, 59, 999_999_900)
        )


def test_scale_factors_divide():
    factors = line("G   10   2 L1C D1C", "SYS / SCALE FACTOR")
    (epoch,), errors, _ = decode(header(factors) + head(1) + satellite("G01", 1e6))
    assert not errors
    assert rows_of(epoch) == {("G01", "1C"): (1e6, 5.2e6 / 10.0, -12.3456, 45.0, False, False)}
    (epoch,), _, _ = decode(header(line("G  100", "SYS / SCALE FACTOR")) + head(1) + satellite("G01", 1e6))
    assert rows_of(epoch) == {("G01", "1C"): (1e4, 5.2e4, -1.23456, 0.45, False, False)}
    _, errors, decoder = decode(
        header(line("G   12   1 L1C", "SYS / SCALE FACTOR")) + head(1) + satellite("G01")
    )
    assert decoder.refused
    assert "1, 10, 100 or 1000" in str(errors[0])


def test_phase_shifts_are_not_applied():
    shift = line("G L1C  0.25000", "SYS / PHASE SHIFT")
    (with_shift,), _, _ = decode(header(shift) + head(1) + satellite("G01"))
    (without,), _, _ = decode(header() + head(1) + satellite("G01"))
    assert same([with_shift], [without])


@pytest.mark.parametrize(
    ("version", "code", "signal"),
    [
        (3.02, "1I", "2I"), (3.02, "1X", "2X"), (3.04, "1I", "2I"), (3.04, "1X", "1X"), (3.05, "1P", "1P"),
        (3.03, "2I", "2I"),
    ],
)  # fmt: skip
def test_beidou_band_1_depends_on_the_version(version, code, signal):
    _, errors, decoder = decode(header(version=version, types=(f"C    2 C{code} L{code}",)))
    assert not errors
    assert decoder.header.signals == {"C": (signal,)}


def test_type_lines_continue_and_pseudo_observables_are_ignored():
    types = (
        "G   14 C1C L1C D1C S1C C2W L2W D2W S2W C5Q L5Q D5Q S5Q C1W",
        f"{'':6} S1W",
        "R    3 C1C X1  C3X",
        "S    1 C1C",
        "J    2 X1  C1C",
    )
    text = header(types=types) + head(4)
    text += "G01" + "".join(cell(1000.0 + k) for k in range(14)) + "\n"
    text += (
        "R01"
        + cell(2e7)
        + cell(3.0)
        + cell(4e7)
        + "\nS20"
        + cell(2e7)
        + "\nJ02"
        + cell(9.0)
        + cell(3.8e7)
        + "\n"
    )
    (epoch,), errors, decoder = decode(text)
    assert not errors
    assert decoder.header.signals == {"G": ("1C", "2W", "5Q", "1W"), "R": ("1C", "3X"), "S": (), "J": ("1C",)}
    assert [rows_of(epoch)["R01", signal][0] for signal in ("1C", "3X")] == [2e7, 4e7]
    assert rows_of(epoch)["G01", "1W"] == (1012.0, None, None, 1013.0, False, False)
    assert rows_of(epoch)["J02", "1C"][0] == 3.8e7
    assert decoder.skipped == {"S": 1}


@pytest.mark.parametrize(
    "types", ["G    5 C1C L1C D1C S1C", "G    3 C1C L1C D1C S1C", "G    x C1C L1C D1C S1C"]
)
def test_system_with_inconsistent_types_is_skipped(types):
    text = header(types=(types, "E    1 C1C")) + head(2) + satellite("G01") + "E05" + cell(2.5e7) + "\n"
    (epoch,), errors, decoder = decode(text)
    assert list(rows_of(epoch)) == [("E05", "1C")]
    assert decoder.skipped == {"G": 1}
    assert [e.field for e in errors] == ["SYS / # / OBS TYPES of G"]


def test_unknown_or_repeated_type_costs_its_column():
    types = "G    5 C1C C9C L1# C1C S1C"
    text = header(types=(types,)) + head(1) + "G01" + "".join(cell(1000.0 + k) for k in range(5)) + "\n"
    (epoch,), errors, _ = decode(text)
    assert len(errors) == 3
    assert rows_of(epoch) == {("G01", "1C"): (1000.0, None, None, 1004.0, False, False)}


@pytest.mark.parametrize(
    ("system", "offset_s"), [("GPS", 0), ("GAL", 0), ("QZS", 0), ("BDT", 14), ("GLO", 18), ("   ", 0)]
)
def test_time_systems_are_converted_to_gps_time(system, offset_s):
    (epoch,), errors, _ = decode(header(time_system=system) + head(0))
    assert not errors
    assert epoch.time_ns == NOON_NS + offset_s * 10**9


def test_times_in_utc_are_continuous_over_a_leap_second_and_none_is_within_it():
    times = ("2016 12 31 23 59 59", "2016 12 31 23 59 60", "2017 01 01 00 00  0")
    epochs, errors, _ = decode(header(time_system="GLO") + "".join(f"> {t}.0000000  0  0\n" for t in times))
    assert [utc_from_gps_ns(e.time_ns)[:6] for e in epochs] == [
        (2016, 12, 31, 23, 59, 59),
        (2017, 1, 1, 0, 0, 0),
    ]
    assert epochs[1].time_ns - epochs[0].time_ns == 2 * NS_PER_SECOND
    assert [e.line_number for e in errors] == [6]


def test_a_file_of_glonass_alone_is_in_utc_unless_it_says_otherwise():
    text = header(types=("R    1 C1C",), time_system="   ").replace(
        f"{'OBSERVATION DATA':<20}M", f"{'OBSERVATION DATA':<20}R"
    )
    (epoch,), errors, decoder = decode(text + head(1) + "R05" + cell(2e7) + "\n")
    assert not errors
    assert decoder.header.time_system == "GLO"
    assert epoch.time_ns == NOON_NS + 18 * NS_PER_SECOND
    (epoch,), errors, _ = decode(text.replace("0.0000000        ", "0.0000000     GPS") + head(0))
    assert epoch.time_ns == NOON_NS


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (header(time_system="UTC"), "test.obs:4: time system is 'UTC', expected one of GPS"),
        (header(version=2.12), "test.obs:1: RINEX version is '2.12', expected 2.0 to 2.11, 3 or 4"),
        (header(version=5.0), "RINEX version is '5.00', expected 2.0 to 2.11, 3 or 4"),
        (header().replace("OBSERVATION DATA", "N: GNSS NAV DATA"), "expected observation data"),
        (header(types=("S    1 C1C",)), "expected one of the systems G, J, E, C, R"),
        (line("3.0", "CRINEX VERS   / TYPE"), "not its Hatanaka compression"),
        ("\x00\xff garbage\n", "expected 'RINEX VERSION / TYPE'"),
        ("x" * 100_000, "expected 'RINEX VERSION / TYPE'"),
        ("", "header, expected END OF HEADER"),
        (header().replace("END OF HEADER", "END OF HEADEX") + GOOD, "END OF HEADER"),
    ],
)
def test_unreadable_files_are_refused_in_one_line(tmp_path, text, says):
    epochs, errors, decoder = decode(text + (head(1) + satellite("G01") if text else ""))
    assert not epochs
    assert len(errors) == 1
    assert says in str(errors[0])
    assert decoder.refused
    assert decoder.feed(head(1).encode()) == []
    path = tmp_path / "test.obs"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FormatError) as raised:
        read_observations(path)
    assert says in str(raised.value)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("G02  21000000.000", "G02  2100000x.000", "G02 C1C"),
        ("G02  21000000.000", "G02  210000000.000", "G02 C1C"),
        ("G02  21000000.000", "G02  2 000000.000", "G02 C1C"),
        ("G02  21000000.000", "G02  2100000.000", "G02 C1C"),
        ("G02  21000000.000", "G02\t 21000000.000", "G02 C1C"),
        ("G02  21000000.000", "G02 --1000000.000", "G02 C1C"),
        ("G02  21000000.000", "G02  21000000,000", "G02 C1C"),
        ("G02  21000000.000", "G0\xff  21000000.000", "satellite"),
        ("G02  21000000.000", "X02  21000000.000", "satellite"),
        ("G02  21000000.000", "G00  21000000.000", "satellite"),
        ("G02  21000000.000  ", "G02  21000000.000x ", "G02 C1C"),
        ("G02  21000000.000  ", "G02  21000000.000 -", "G02 C1C"),
    ],
)
def test_malformed_line_costs_its_satellite(old, new, field):
    assert old in GOOD
    (first, second), errors, _ = decode(header() + GOOD.replace(old, new) + head(1, 1.0) + satellite("G01"))
    assert [k for k, _ in rows_of(first)] == ["G01", "G03"]
    assert len(rows_of(second)) == 1
    (error,) = errors
    assert error.field == field
    assert error.line_number == 7
    assert str(error).startswith("test.obs:7: ")


def test_text_after_the_last_type_is_an_error():
    (epoch,), errors, _ = decode(
        header() + head(2) + satellite("G01") + satellite("G02").rstrip() + "   1.0\n"
    )
    assert list(rows_of(epoch)) == [("G01", "1C")]
    assert "beyond" in str(errors[0])


@pytest.mark.parametrize(
    "bad",
    [
        head(3).replace("2024", "20x4"),
        *(head(3).replace("  0  3", count) for count in ("  7  3", "     3", "  0  x", "  0   ")),
        head(3).replace("12 00  0.", "12 00 61."),
        head(3).replace(" 0.0000000", " 0.000000 "),
        *(head(3)[:20] + "\n", head(4), head(999)),
    ],
)
def test_malformed_epoch_line_costs_its_epoch(bad):
    text = header() + bad + GOOD.split("\n", 1)[1] + head(1, 1.0) + satellite("G05")
    (epoch,), errors, _ = decode(text)
    assert list(rows_of(epoch)) == [("G05", "1C")]
    (error,) = errors
    assert error.line_number == 5


@pytest.mark.parametrize("rest", ["", " " * 9000, " " * 9000 + "x", " " * 9000 + "\r"])
@pytest.mark.parametrize("begun", [satellite("G01")[:-1], head(2)[:-1], "x", ""])
def test_too_long_line_does_not_depend_on_chunks(begun: str, rest: str):
    """Only the beginning of such a line is kept, and trailing blanks there must not hide the rest."""
    good = head(1, 1.0) + satellite("G05")
    text = header() + head(2) + begun + rest + "\n" + satellite("G02") + good
    data, first = text.encode(), len(header() + head(2))
    _, errors, _ = decode(data)
    cuts = [*(first + k for k in (0, 1, 100, 8192, 8193, 8194)), len(data) - len(good)]
    whole = comparable(fed_in_pieces(RinexDecoder("test.obs"), data))
    for cut in cuts:
        assert comparable(fed_in_pieces(RinexDecoder("test.obs"), data, [cut])) == whole
    if rest:
        assert errors


def test_stray_lines_are_one_error_and_blank_lines_none():
    text = header() + head(1) + satellite("G01") * 4 + "\n\r\n" + head(1, 1.0) + satellite("G01")
    epochs, errors, _ = decode(text)
    assert len(epochs) == 2
    assert [e.line_number for e in errors] == [7]


def test_first_line_of_a_repeated_satellite_counts():
    (epoch,), errors, _ = decode(
        header() + head(3) + satellite("G01") + satellite("G 1", 3e7) + satellite("G02")
    )
    assert [(k, v[0]) for (k, _), v in rows_of(epoch).items()] == [("G01", 2.1e7), ("G02", 2.1e7)]
    assert [e.field for e in errors] == ["satellite"]
    assert "each once an epoch" in str(errors[0])


def test_mixture_of_two_epochs_is_discarded():
    """Three lines and the next epoch line are lost: its satellites would be taken as those of the previous epoch."""
    names = [f"G{k:02d}" for k in range(1, 9)]
    first = head(8) + "".join(satellite(n) for n in names)
    second = head(8, 1.0) + "".join(satellite(n, 2.2e7) for n in names)
    cut = (first + second).replace(first[first.index("G05") + 20 :] + second[: second.index("G01") + 10], "")
    epochs, errors, _ = decode(header() + cut + head(1, 2.0) + satellite("G01"))
    assert [e.time_ns - NOON_NS for e in epochs] == [2 * 10**9]
    assert len(errors) == 2


def test_truncated_last_epoch_is_an_error():
    text = header() + GOOD
    whole, errors, _ = decode(text[:-1])
    assert len(whole) == 1
    assert not errors
    for cut in (2, 20, 60, 100):
        epochs, errors, _ = decode(text[:-cut])
        assert sum(len(rows_of(e)) for e in epochs) in (0, 2)
        assert len(errors) == 1


def test_wrong_byte_never_gives_another_value():
    """A letter replaces a byte: the remaining values are unchanged."""
    rng = np.random.default_rng(4)
    epochs = [random_epoch(rng, NOON_NS + k * 10**9, satellites=4) for k in range(3)]
    clean = observation_text(epochs, STATION).encode()
    begin = clean.index(b"END OF HEADER") + 14
    rows = {(e.time_ns, key, row) for e in decode(clean)[0] for key, row in rows_of(e).items()}
    for place in range(begin, len(clean), 7):
        data = clean[:place] + b"x" + clean[place + 1 :]
        read, errors, _ = decode(data)
        decoded = {(e.time_ns, key, row) for e in read for key, row in rows_of(e).items()}
        # A lost newline damages two lines.
        assert 1 <= len(errors) <= 2, data[place - 40 : place + 40]
        assert decoded < rows


@pytest.mark.parametrize(
    ("beginning", "piece", "times"),
    [
        ("", b"x" * 100_000, 1000),
        (header().split("\n")[0] + "\n", b"comment\n" * 12_000, 100),
        (header(), b"x" * 100_000, 1000),
        (header() + head(999), b"\n" * 100_000, 300),
        (header() + head(999), b"G01" + b" " * 9_000 + b"\n", 1200),
        (header(), head(999).encode() + b"\n" * 900, 300),
    ],
)
def test_endless_input_uses_bounded_memory(beginning, piece, times):
    tracemalloc.start()
    decoder = RinexDecoder("test.obs")
    decoder.feed(beginning.encode())
    for _ in range(times):
        decoder.feed(piece)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6
    assert decoder.refused == (beginning.count("\n") == 1)


def test_999_satellite_lines_give_each_satellite_once():
    lines = "".join(satellite(f"G{k % 99 + 1:02d}") for k in range(999))
    (epoch,), errors, _ = decode(header() + head(999) + lines)
    assert len(rows_of(epoch)) == 99
    assert len(errors) == 900


def test_compression_is_recognised_by_content(tmp_path):
    hatanaka = pytest.importorskip("hatanaka")
    rng = np.random.default_rng(6)
    epochs = [random_epoch(rng, NOON_NS + k * 10**9, satellites=6, most_range_m=4e7) for k in range(5)]
    text = observation_text(epochs, STATION).encode()
    plain, _, _ = decode(text)
    compact = hatanaka.rnx2crx(text)
    forms = {
        "plain.crx": text,
        "gzip": gzip.compress(text),
        "compact.obs": compact,
        "both.24d": gzip.compress(compact),
        "unix.Z": hatanaka.compress(text, compression="Z"),
    }
    for name, data in forms.items():
        (tmp_path / name).write_bytes(data)
        read = read_observations(tmp_path / name)
        assert read.problems == [], name
        assert same(read.epochs, plain), name


def test_truncated_gzip_is_one_error_after_all_intact_epochs(tmp_path):
    rng = np.random.default_rng(7)
    epochs = [random_epoch(rng, NOON_NS + k * 10**9, satellites=9, most_range_m=4e7) for k in range(40)]
    data = gzip.compress(observation_text(epochs, STATION).encode())
    path = tmp_path / "cut.gz"
    path.write_bytes(data[: len(data) // 2])
    read = read_observations(path)
    assert 15 <= len(read.epochs) < 25
    assert "gzip compression" in str(read.problems[0])
    assert same(read.epochs, decode(observation_text(epochs, STATION).encode())[0][: len(read.epochs)])
    path.write_bytes(data[:20])
    with pytest.raises(FormatError, match="gzip compression"):
        read_observations(path)


def test_corrupt_hatanaka_compression_is_one_error(tmp_path):
    hatanaka = pytest.importorskip("hatanaka")
    path = tmp_path / "test.crx"
    path.write_bytes(hatanaka.rnx2crx((header() + GOOD).encode())[:150] + b"\xff\x00garbage")
    with pytest.raises(FormatError, match=r"test\.crx"):
        read_observations(path)


def test_missing_hatanaka_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "hatanaka", None)
    path = tmp_path / "test.crx"
    path.write_text(line("3.0                 COMPACT RINEX FORMAT", "CRINEX VERS   / TYPE"))
    with pytest.raises(
        FormatError, match=r"test\.crx: Hatanaka compression, expected the package hatanaka"
    ) as raised:
        read_observations(path)
    assert "\n" not in str(raised.value)


def test_every_problem_is_reported(tmp_path):
    path = tmp_path / "test.obs"
    path.write_text(header() + (head(1) + "G01  x\n") * 3000)
    read = read_observations(path)
    assert len(read.epochs) == 3000
    assert len(read.problems) == 3000


# recordings

FILES = (
    "rooftop-2024-06-24/rover.obs",
    "rooftop-2024-06-24/base.obs",
    "fujisawa-2021-09-22/SEPT265G.21O",
    "fujisawa-2021-09-22/3034265G.21O",
)


@pytest.mark.parametrize("name", FILES)
def test_every_value_of_a_recording_equals_that_of_a_simple_reader(name):
    path = recording(name)
    read = read_observations(path)
    assert read.problems == []
    assert assert_equal_to_simple_reader(read.epochs, path.read_text("latin-1")) > 50_000


@pytest.mark.parametrize("name", FILES)
def test_header_of_a_recording(name):
    header = read_observations(recording(name)).header
    assert header.version == 3.04
    assert header.time_system == "GPS"
    assert header.delta_hen_m == (0.0, 0.0, 0.0)
    assert header.position_ecef_m is not None
    assert np.linalg.norm(header.position_ecef_m) == pytest.approx(6.371e6, rel=2e-3)
    if name == FILES[0]:
        assert header.receiver == "SEPT MOSAIC-X5"
        assert header.interval_s == 1.0
        assert header.leap_seconds == 18
        assert header.signals["C"] == ("2I", "7I", "6I")
        assert header.signals["G"] == ("1C", "2W", "2L", "5Q")
        assert header.signals["R"] == ("1C", "2C")


def test_each_epoch_is_returned_with_its_last_byte():
    data = recording(FILES[0]).read_bytes()
    begin = data.index(b"\n>") + 1
    pieces = [b">" + part for part in data[begin:].split(b">")[1:]]
    decoder = RinexDecoder("rover.obs")
    assert decoder.feed(data[:begin]) == []
    for piece in pieces[:20]:
        assert decoder.feed(piece[:-1]) == []
        assert len(decoder.feed(piece[-1:])) == 1

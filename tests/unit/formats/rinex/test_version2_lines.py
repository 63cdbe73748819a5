"""RINEX 2.11 is read as its content in RINEX 3, and as RTKLIB's `convbin` converts it."""

from __future__ import annotations

import random
import shutil
import subprocess
import tracemalloc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.formats.rinex.navigation_reader import NavigationDecoder
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rinex.version2_lines import full_year
from camber.formats.rinex.writer import navigation_text
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst, gpst_from_gps_ns
from support.gnss_files import comparable, fed_in_pieces, read_observations
from support.random_observations import WEEK_NS, random_ephemeris
from support.rinex2_writer import (
    Cell,
    Epoch2,
    epoch_text_2,
    labelled,
    navigation_text_2,
    observation_text_2,
    types_lines,
)

CONVBIN = shutil.which("convbin")
START_NS = gps_ns_from_gpst(CalendarTime(2005, 4, 2, 0, 0, 0))
TYPES = ("C1", "P1", "L1", "D1", "S1", "C2", "P2", "L2", "D2", "S2", "C5", "L5", "D5", "S5", "C7", "L7")
# As RTKLIB maps them, of the systems that are read.
CODES = {
    "G": {
        "C1": "C1C", "P1": "C1W", "L1": "L1C", "D1": "D1C", "S1": "S1C", "C2": "C2X", "P2": "C2W", "L2": "L2W",
        "D2": "D2W", "S2": "S2W", "C5": "C5X", "L5": "L5X", "D5": "D5X", "S5": "S5X",
    },
    "E": {
        "C1": "C1X", "L1": "L1X", "D1": "D1X", "S1": "S1X", "C5": "C5X", "L5": "L5X", "D5": "D5X", "S5": "S5X",
        "C7": "C7X", "L7": "L7X",
    },
    "J": {
        "C1": "C1C", "L1": "L1C", "D1": "D1C", "S1": "S1C", "C2": "C2X", "L2": "L2X", "D2": "D2X", "S2": "S2X",
        "C5": "C5X", "L5": "L5X", "D5": "D5X", "S5": "S5X",
    },
    "C": {"C2": "C2X", "L2": "L2X", "D2": "D2X", "S2": "S2X", "C7": "C7X", "L7": "L7X"},
    "R": {
        "C1": "C1C", "P1": "C1P", "L1": "L1C", "D1": "D1C", "S1": "S1C", "C2": "C2C", "P2": "C2P", "L2": "L2P",
        "D2": "D2P", "S2": "S2P",
    },
}  # fmt: skip
# Of GPS where P1 or C2 is there and the other code of the band is not.
OTHER_CODES = {
    "G": {"L1": "L1W", "D1": "D1W", "S1": "S1W", "L2": "L2X", "D2": "D2X", "S2": "S2X"},
    "R": {"L1": "L1P", "D1": "D1P", "S1": "S1P", "L2": "L2C", "D2": "D2C", "S2": "S2C"},
}
NAMES = [f"{letter}{number:2d}" for letter in "GRE" for number in (1, 2, 5, 9, 11, 20, 24)]


def decode(text: str | bytes) -> tuple[list[ObservationEpoch], list[FormatError], RinexDecoder]:
    decoder = RinexDecoder("test.05o")
    data = text.encode("latin-1") if isinstance(text, str) else text
    results = decoder.feed(data) + decoder.finish()
    errors = [r for r in results if isinstance(r, FormatError)]
    return [r for r in results if isinstance(r, ObservationEpoch)], errors, decoder


def values(epoch: ObservationEpoch) -> dict[tuple[str, str], tuple[float, bool, bool]]:
    """By satellite and RINEX 3 code: the value, loss of lock and half cycle of phases."""
    columns = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz")
    table = {}
    for row in range(epoch.satellite.size):
        satellite, signal = satellite_name(int(epoch.satellite[row])), signal_name(int(epoch.signal[row]))
        for kind, name in zip("CLDS", columns, strict=True):
            value = float(getattr(epoch, name)[row])
            if not np.isnan(value):
                flags = bool(epoch.loss_of_lock[row]), bool(epoch.half_cycle[row])
                table[satellite, kind + signal] = (value, *(flags if kind == "L" else (False, False)))
    return table


def expected_values(epoch: Epoch2) -> dict[tuple[str, str], tuple[float, bool, bool]]:
    table = {}
    for name, cells in epoch.satellites.items():
        letter = name[0].replace(" ", "G")
        for kind, (value, lli, _) in cells.items():
            code = CODES.get(letter, {}).get(kind)
            if letter in "GR" and kind in OTHER_CODES[letter] and _belongs_to_the_other_code(cells, kind[1]):
                code = OTHER_CODES[letter][kind]
            if code is not None and value != 0.0:
                digit = int(lli.strip() or "0") if code[0] == "L" else 0
                table[f"{letter}{int(name[1:]):02d}", code] = (value, bool(digit & 1), bool(digit & 2))
    return table


def _belongs_to_the_other_code(cells: Mapping[str, Cell], band: str) -> bool:
    preferred, other = ("C1", "P1") if band == "1" else ("P2", "C2")
    return preferred not in cells and other in cells


def random_epochs(rng: random.Random, count: int, names: Sequence[str], types: Sequence[str]) -> list[Epoch2]:
    epochs, time_ns = [], START_NS
    for _ in range(count):
        time_ns += rng.choice((NS_PER_SECOND, 30 * NS_PER_SECOND, 100_000_000))
        chosen = rng.sample(names, rng.randrange(len(names) + 1))
        satellites = {name: {t: _cell(rng, t) for t in types if rng.random() < 0.8} for name in chosen}
        epochs.append(Epoch2(time_ns=time_ns, satellites=satellites))
    return epochs


def _cell(rng: random.Random, kind: str) -> Cell:
    value = {"C": 2.3e7, "P": 2.3e7, "L": 1.2e8, "D": 3e3, "S": 45.0}[kind[0]] * rng.uniform(0.8, 1.0)
    return round(value, 3), rng.choice("  0123") if kind[0] == "L" else " ", " "


@given(st.integers(0, 2**32), st.integers(1, len(TYPES)))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_values_are_those_that_were_written(seed: int, count: int) -> None:
    rng = random.Random(seed)
    types = rng.sample(TYPES, count)
    names = [*NAMES, *(f"{letter}{n:02d}" for letter in "JC" for n in (1, 3)), "S20"]
    written = random_epochs(rng, 6, names, types)
    text = observation_text_2(written, types)
    read, errors, decoder = decode(text)
    assert not errors
    assert [e.time_ns for e in read] == [e.time_ns for e in written]
    assert [values(e) for e in read] == [expected_values(e) for e in written]
    skipped = [name[0] for e in written for name in e.satellites if name[0] == "S"]
    assert {k: n for k, n in decoder.skipped.items() if n} == {k: skipped.count(k) for k in set(skipped)}
    cuts = rng.sample(range(len(text)), 20)
    pieces = fed_in_pieces(RinexDecoder("test.05o"), text.encode(), cuts)
    assert [values(e) for e in pieces] == [values(e) for e in read]


@pytest.mark.skipif(CONVBIN is None, reason="convbin of RTKLIB is not installed")
@pytest.mark.parametrize("seed", range(6))
def test_values_are_those_of_convbin(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    written = random_epochs(rng, 20, NAMES, rng.sample(TYPES, len(TYPES)))
    path, converted = tmp_path / "rover.05o", tmp_path / "rover.obs"
    path.write_text(observation_text_2(written, rng.sample(TYPES, len(TYPES))))
    command = [CONVBIN, "-r", "rinex", "-v", "3.04", "-od", "-os", "-f", "5", "-o", converted, path]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    ours, theirs = ({e.time_ns: values(e) for e in read_observations(p).epochs} for p in (path, converted))
    compared = 0
    for time_ns, table in theirs.items():
        # It leaves out what has no pseudorange.
        with_code = {key for key in ours[time_ns] if (key[0], "C" + key[1][1:]) in ours[time_ns]}
        assert table.keys() == with_code
        for key, (value, lost, half_cycle) in table.items():
            assert (ours[time_ns][key][0], ours[time_ns][key][2]) == (value, half_cycle), key
            # It also marks the first phase of each signal.
            assert lost or not ours[time_ns][key][1]
            compared += 1
    assert compared > 1000


@pytest.mark.parametrize("system", ["GLO", "   "])
def test_times_of_a_file_of_glonass_are_utc(system: str) -> None:
    first = f"  2005     4     2     0     0    0.0000000     {system}"
    written = three_epochs(name="R05")
    read, errors, _ = decode(observation_text_2(written, ["C1"], system="R (GLONASS)", first=first))
    assert not errors
    # 13 leap seconds since 1980
    assert [e.time_ns for e in read] == [e.time_ns + 13 * NS_PER_SECOND for e in written]


@pytest.mark.parametrize(("short", "year"), [(80, 1980), (99, 1999), (0, 2000), (5, 2005), (79, 2079)])
def test_years_have_two_digits(short: int, year: int) -> None:
    assert full_year(short) == year
    time_ns = gps_ns_from_gpst(CalendarTime(year, 2, 7, 3, 4, 5, 123_456_700))
    (epoch,), errors, _ = decode(observation_text_2([one_satellite(time_ns)], ["C1"]))
    assert not errors
    assert epoch.time_ns == time_ns


def one_satellite(time_ns: int, *, name: str = "G05", value: float = 2e7, flag: int = 0) -> Epoch2:
    return Epoch2(time_ns=time_ns, satellites={name: {"C1": (value, " ", " ")}}, flag=flag)


def three_epochs(**changes: Any) -> list[Epoch2]:
    return [one_satellite(START_NS + k * NS_PER_SECOND, **changes) for k in range(3)]


@pytest.mark.parametrize(
    ("system", "letter"),
    [("", "G"), ("G (GPS)", "G"), ("M (MIXED)", "G"), ("E (GALILEO)", "E"), ("R (GLONASS)", "R")],
)
def test_satellites_without_a_letter_are_of_the_system_of_the_file(system: str, letter: str) -> None:
    first = "  2005     4     2     0     0    0.0000000     GPS"
    text = observation_text_2([one_satellite(START_NS, name="  5")], ["C1"], system=system, first=first)
    epochs, errors, _ = decode(text)
    assert not errors
    assert list(values(epochs[0])) == [(f"{letter}05", "C1C" if letter in "GR" else "C1X")]


def test_header_has_the_station_and_the_version() -> None:
    _, _, decoder = decode(observation_text_2(three_epochs(), ["C1", "XX"]))
    header = decoder.header
    assert header is not None
    assert (header.version, header.marker, header.receiver, header.antenna) == (
        2.11,
        "rover",
        "RECEIVER",
        "ANTENNA",
    )
    assert header.position_ecef_m == (-3976219.5082, 3382372.5671, 3652512.9849)
    assert (header.delta_hen_m, header.interval_s, header.time_system) == ((0.1, 0.0, 0.0), 1.0, "GPS")


def test_event_with_header_lines_may_change_the_types() -> None:
    event = Epoch2(
        time_ns=START_NS,
        satellites={},
        flag=4,
        lines=[
            labelled("another", "MARKER NAME"),
            labelled("text", "COMMENT"),
            *types_lines(["L1", "C1", "C2", "P2", "L2", "S1"]),
        ],
    )
    before, after = (
        one_satellite(START_NS),
        Epoch2(
            time_ns=START_NS + NS_PER_SECOND,
            satellites={
                "G05": {"C1": (2e7, " ", " "), "S1": (45.0, " ", " ")},
                "G06": {"S1": (40.0, " ", " ")},
            },
        ),
    )
    text = observation_text_2([before, event], ["C1"]) + epoch_text_2(
        after, ["L1", "C1", "C2", "P2", "L2", "S1"]
    )
    epochs, errors, decoder = decode(text)
    assert not errors
    assert [values(e) for e in epochs] == [expected_values(before), expected_values(after)]
    assert decoder.header is not None
    assert decoder.header.marker == "another"


def test_event_without_a_time_is_read() -> None:
    event = " " * 28 + "4  1\n" + labelled("another", "MARKER NAME")
    text = observation_text_2(three_epochs(), ["C1"])
    at = text.index(" 05  4  2  0  0  1")
    epochs, errors, decoder = decode(text[:at] + event + text[at:])
    assert (len(epochs), errors) == (3, [])
    assert decoder.header is not None
    assert decoder.header.marker == "another"


def test_comments_in_the_body_are_left_out() -> None:
    lines = observation_text_2(three_epochs(), ["C1"]).splitlines(keepends=True)
    begin = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    commented = [
        lines[:begin],
        *([labelled(" 05  4  2 spliced here", "COMMENT"), line] for line in lines[begin:]),
    ]
    epochs, errors, _ = decode("".join(line for part in commented for line in part))
    assert (len(epochs), errors) == (3, [])


def test_power_failure_loses_all_locks_and_cycle_slip_records_are_not_read() -> None:
    cells = {"G05": {"C1": (2e7, " ", " "), "L1": (1e8, " ", " ")}}
    epochs = [Epoch2(time_ns=START_NS + flag, satellites=cells, flag=flag) for flag in (0, 6, 1)]
    read, errors, _ = decode(observation_text_2(epochs, ["C1", "L1"]))
    assert not errors
    assert [e.loss_of_lock.tolist() for e in read] == [[False], [True]]


def test_signal_strength_digit_gives_cn0_without_a_value_of_it() -> None:
    epoch = Epoch2(time_ns=START_NS, satellites={"G05": {"C1": (2e7, " ", "7"), "L1": (1e8, "1", "6")}})
    (read,), _, _ = decode(observation_text_2([epoch], ["C1", "L1"]))
    assert read.cn0_dbhz.tolist() == [39.0]


def test_line_ends_of_windows_and_missing_line_end_are_read() -> None:
    text = observation_text_2(three_epochs(), ["C1"])
    assert len(decode(text.replace("\n", "\r\n"))[0]) == 3
    assert len(decode(text[:-1])[0]) == 3


# ---------------------------------------------------------------------------------------------------------- damage


def test_lost_line_costs_its_epoch_and_is_named_by_its_number() -> None:
    satellites = {f"G{n:2d}": dict.fromkeys(TYPES[:7], (20000000.0 + n, " ", " ")) for n in range(1, 15)}
    epochs = [Epoch2(time_ns=START_NS + k * NS_PER_SECOND, satellites=satellites) for k in range(3)]
    lines = observation_text_2(epochs, TYPES[:7]).splitlines(keepends=True)
    starts = [k for k, line in enumerate(lines) if line.startswith(" 05  4  2")]
    del lines[starts[1] + 7]
    read, errors, _ = decode("".join(lines))
    assert [e.time_ns for e in read] == [START_NS, START_NS + 2 * NS_PER_SECOND]
    assert [e.line_number for e in errors] == [starts[1] + 1]
    assert "as many lines as it announces" in str(errors[0])


def test_damaged_value_costs_its_satellite_and_is_named_by_its_number() -> None:
    satellites = {f"G{n:2d}": dict.fromkeys(TYPES[:7], (20000000.0 + n, " ", " ")) for n in range(1, 4)}
    lines = observation_text_2([Epoch2(time_ns=START_NS, satellites=satellites)], TYPES[:7]).splitlines(
        keepends=True
    )
    start = next(k for k, line in enumerate(lines) if line.startswith(" 05  4  2"))
    lines[start + 3] = lines[start + 3].replace(".", "x", 1)
    (epoch,), (error,), _ = decode("".join(lines))
    assert {name for name, _ in values(epoch)} == {"G01", "G03"}
    assert str(error).startswith(f"test.05o:{start + 4}: G 2 C1 is")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("     2.11", "     2.12"), "RINEX version is '2.12', expected 2.0 to 2.11, 3 or 4"),
        (("# / TYPES OF OBSERV", "# / TYPES OF OBSERX"), "# / TYPES OF OBSERV, expected this line"),
        (("     1     1 ", "     1     2 "), "WAVELENGTH FACT L1/2 is '1     2', expected 1: phases with"),
        (("GPS         TIME", "UTC         TIME"), "time system is 'UTC', expected one of GPS"),
        (("OBSERVATION DATA", "METEOROLOGICAL D"), "file type is 'METEOROLOGICAL D', expected observation"),
    ],
)
def test_file_that_cannot_be_read_is_one_line(change: tuple[str, str], says: str) -> None:
    epochs, errors, _ = decode(observation_text_2(three_epochs(), ["C1"]).replace(*change, 1))
    assert not epochs
    assert len(errors) == 1
    assert says in str(errors[0])


@pytest.mark.parametrize(
    ("types", "says"),
    [("     2    C1", "as many types"), ("     2    C1    Q7", "C, P, L, D, S or T and a band is")],
)
def test_wrong_types_are_one_fault_of_the_header(types: str, says: str) -> None:
    text = observation_text_2(three_epochs(), ["C1"]).replace("     1    C1", types.ljust(12))
    _, errors, _ = decode(text if len(types) == 12 else text.replace(" " * 6 + "# / TY", "# / TY", 1))
    assert len(errors) == 1
    assert "# / TYPES OF OBSERV" in str(errors[0])


def test_endless_lists_of_types_do_not_grow_the_memory() -> None:
    decoder = RinexDecoder("test.05o")
    decoder.feed(observation_text_2(three_epochs(), ["C1"]).encode())
    event = Epoch2(time_ns=START_NS, satellites={}, flag=4, lines=types_lines(["C1"] * 18)[1:] * 900)
    tracemalloc.start()
    for _ in range(20):
        decoder.feed(epoch_text_2(event, []).encode())
    assert tracemalloc.get_traced_memory()[0] < 2_000_000
    tracemalloc.stop()


@given(st.integers(0, 2**32))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_damage_raises_nothing_and_does_not_depend_on_pieces(seed: int) -> None:
    rng = random.Random(seed)
    data = bytearray(observation_text_2(random_epochs(rng, 4, NAMES, TYPES[:7]), TYPES[:7]).encode())
    for _ in range(rng.randrange(1, 8)):
        place = rng.randrange(len(data))
        data[place : place + rng.randrange(4)] = bytes(
            rng.choice(b" 0123456789.\n>GRE-\r\xff") for _ in range(rng.randrange(4))
        )
    whole = fed_in_pieces(RinexDecoder("x"), bytes(data))
    cuts = rng.sample(range(len(data)), 10)
    pieces = fed_in_pieces(RinexDecoder("x"), bytes(data), cuts)
    assert [str(r) if isinstance(r, FormatError) else values(r) for r in pieces] == [
        str(r) if isinstance(r, FormatError) else values(r) for r in whole
    ]


# ------------------------------------------------------------------------------------------------------ navigation


def navigation(text: str) -> tuple[list[object], NavigationDecoder]:
    decoder = NavigationDecoder("test.05n")
    return comparable(decoder.feed(text.encode()) + decoder.finish()), decoder


@pytest.mark.parametrize("seed", range(20))
def test_ephemerides_are_those_of_the_same_in_rinex_3(seed: int) -> None:
    rng = np.random.default_rng(seed)
    toe_ns = (1308 + seed) * WEEK_NS + int(rng.integers(0, 302)) * 2000 * NS_PER_SECOND
    ephemerides = [random_ephemeris(rng, f"G{n:02d}", toe_ns) for n in (1, 5, 32)]
    klobuchar = IonosphereCoefficients(
        system="G",
        alpha=(1.118e-8, 1.49e-8, -5.96e-8, -5.96e-8),
        beta=(88060.0, 16380.0, -196600.0, -131100.0),
    )
    old, decoder = navigation(navigation_text_2(ephemerides, klobuchar))
    new, _ = navigation(navigation_text(ephemerides, [klobuchar]))
    assert repr(old) == repr(new)
    assert len(old) == 4
    assert decoder.klobuchar["G"] == klobuchar
    assert (decoder.version, decoder.leap_seconds) == (2.11, 13)


def test_years_of_navigation_files_have_two_digits() -> None:
    toe_ns = gps_ns_from_gpst(CalendarTime(1999, 8, 20, 2, 0, 0))
    ephemeris = random_ephemeris(np.random.default_rng(1), "G05", toe_ns // 16_000_000_000 * 16_000_000_000)
    (read,), _ = navigation(navigation_text_2([ephemeris]))
    assert gpst_from_gps_ns(read.toe_ns).year == 1999  # type: ignore[attr-defined]


def test_damaged_record_costs_only_itself() -> None:
    rng = np.random.default_rng(1)
    lines = navigation_text_2(
        [random_ephemeris(rng, f"G{n:02d}", 1320 * WEEK_NS) for n in (1, 5, 32)]
    ).splitlines()
    first = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    for damaged in (lines[first + 8].replace("D", "X", 1), "x5" + lines[first + 8][2:]):
        results, decoder = navigation("\n".join([*lines[: first + 8], damaged, *lines[first + 9 :]]) + "\n")
        names = [satellite_name(r.satellite) for r in results if not isinstance(r, str)]  # type: ignore[attr-defined]
        assert names == ["G01", "G32"]
        assert decoder.problems == 1


def test_navigation_file_of_another_system_is_refused_in_one_line() -> None:
    text = navigation_text_2([]).replace("N: GPS NAV DATA     ", "H: GEO NAV MSG DATA ")
    results, _ = navigation(text)
    assert results == ["test.05n:1: file type is 'H: GEO NAV MSG DATA', expected navigation data (N)"]

"""Navigation files: written and decoded, against RTKLIB and a known position, malformed, RINEX 4."""

import shutil
import subprocess
from dataclasses import fields, replace

import numpy as np
import pytest

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import Ephemeris, satellite_name
from camber.formats.rinex.navigation_reader import NavigationDecoder
from camber.formats.rinex.writer import navigation_text
from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst
from camber.simulator.satellites.orbits import OrbitTable, satellite_states
from support.gnss_files import read_navigation, read_observations, recording
from support.random_observations import random_ephemeris

FILES = ("rooftop-2024-06-24/base.nav", "nagoya-2023-07-11/base.nav", "fujisawa-2021-09-22/SEPT2650.21P")
RNX2RTKP = shutil.which("rnx2rtkp")
SECOND_NS = 1_000_000_000


def decode(text: str | bytes):
    decoder = NavigationDecoder("test.nav")
    data = text if isinstance(text, bytes) else text.encode("latin-1")
    results = decoder.feed(data) + decoder.finish()
    errors = [r for r in results if isinstance(r, FormatError)]
    assert decoder.problems == len(errors)
    return [r for r in results if isinstance(r, Ephemeris)], errors, decoder


def printed(value: float) -> float:
    return float(f"{value:.12E}")


def as_represented(e: Ephemeris) -> Ephemeris:
    """The ephemeris as the format represents it."""
    changes = {f.name: printed(v) for f in fields(e) if isinstance(v := getattr(e, f.name), float)}
    other = {name: printed(value) for name, value in e.other.items()}
    if satellite_name(e.satellite)[0] == "J":
        other["fit_interval_h"] = 2.0 if other["fit_interval_h"] <= 2.0 else 3.0
    clock = tuple(printed(v) for v in e.clock)
    return replace(e, **changes, clock=clock, other=other)


def ephemerides(seed: int) -> list[Ephemeris]:
    """Ephemerides around week boundaries, transmitted up to a day before and after."""
    rng = np.random.default_rng(seed)
    decoded = []
    for name in ("G01", "G32", "J07", "E05", "E36", "C01", "C63"):
        week = int(rng.integers(1400, 2600))
        of_week_s = int(rng.choice([0, 14, 600, 604_800 - 7200])) // 240 * 240 + (14 if name[0] == "C" else 0)
        e = random_ephemeris(rng, name, (week * 604_800 + of_week_s) * SECOND_NS)
        decoded.append(replace(e, transmission_ns=e.toe_ns + int(rng.integers(-86_400, 7200)) * SECOND_NS))
    return sorted(decoded, key=lambda e: (e.transmission_ns, e.satellite, e.toe_ns))


@pytest.mark.parametrize("seed", range(30))
def test_written_ephemerides_are_decoded_exactly(seed):
    written = ephemerides(seed)
    coefficients = [
        IonosphereCoefficients(
            system=system, alpha=(1e-8 * k, -2e-8, 3e-8, 0.0), beta=(9e4, 1e5, -2e5, 1e4 * k)
        )
        for k, system in enumerate("GCJ")
    ]
    read, errors, decoder = decode(navigation_text(written, coefficients))
    assert not errors
    assert read == [as_represented(e) for e in written]
    assert list(decoder.klobuchar.values()) == coefficients
    assert decoder.leap_seconds in range(13, 19)


@pytest.mark.parametrize("name", FILES)
def test_rewritten_recording_is_the_same(name):
    navigation = read_navigation(recording(name))
    assert navigation.problems == []
    assert navigation.leap_seconds == 18
    keplerian = [e for e in navigation.ephemerides if isinstance(e, Ephemeris)]
    read, errors, _ = decode(navigation_text(keplerian))
    assert not errors
    order = sorted(keplerian, key=lambda e: (e.transmission_ns, e.satellite, e.toe_ns))
    assert read == order


@pytest.mark.parametrize(
    ("folder", "rover", "base", "nav"),
    [
        ("rooftop-2024-06-24", "rover.obs", "base.obs", "base.nav"),
        ("fujisawa-2021-09-22", "SEPT265G.21O", "3034265G.21O", "SEPT2650.21P"),
    ],
)
def test_rtklib_solution_of_a_rewritten_file_is_the_same(tmp_path, folder, rover, base, nav):
    if RNX2RTKP is None:
        pytest.skip("rnx2rtkp is not installed")
    original = recording(f"{folder}/{nav}")
    navigation = read_navigation(original)
    gps = navigation.klobuchar["G"]
    (tmp_path / "again.nav").write_text(
        navigation_text([e for e in navigation.ephemerides if isinstance(e, Ephemeris)], [gps])
    )
    options = "pos1-navsys=57\npos1-posmode=kinematic\npos2-armode=instantaneous\nant2-postype=rinexhead\n"
    (tmp_path / "options.conf").write_text(options)
    observations = (original.parent / rover, original.parent / base)
    solutions = []
    for which in (original, tmp_path / "again.nav"):
        out = tmp_path / f"{which.stem}.pos"
        command = [RNX2RTKP, "-k", "options.conf", "-ti", "10", "-o", out, *observations, which]
        how = {"check": True, "capture_output": True, "stdin": subprocess.DEVNULL, "timeout": 120}
        subprocess.run(command, cwd=tmp_path, **how)
        solutions.append([line for line in out.read_text().splitlines() if not line.startswith("%")])
    assert len(solutions[0]) > 20
    assert solutions[0] == solutions[1]


def test_satellite_positions_agree_with_recorded_pseudoranges():
    """Per system the receiver's clock is the same from all satellites, up to atmosphere and group delays."""
    folder = recording("rooftop-2024-06-24")
    latitude, longitude, height = map(
        float, (folder / "rover_position.txt").read_text().replace(",", " ").split()
    )
    here = ecef_from_geodetic(np.deg2rad(latitude), np.deg2rad(longitude), height)
    epoch = read_observations(folder / "rover.obs").epochs[100]
    navigation = read_navigation(folder / "base.nav")
    used = 0
    for system, signal in (("G", "1C"), ("E", "1C"), ("C", "2I"), ("J", "1C")):
        clocks = []
        for row in np.flatnonzero(epoch.satellite >> 8 == ord(system)):
            if epoch.signal[row] != ord(signal[0]) * 256 + ord(signal[1]):
                continue
            mine = [e for e in navigation.ephemerides if e.satellite == epoch.satellite[row]]
            best = min(mine, key=lambda e: abs(e.toe_ns - epoch.time_ns), default=None)
            if best is None or abs(best.toe_ns - epoch.time_ns) >= 10_800 * SECOND_NS:
                continue
            if np.isnan(epoch.pseudorange_m[row]):
                continue
            sent_ns = epoch.time_ns - round(epoch.pseudorange_m[row] / 0.299792458)
            states = satellite_states(OrbitTable.of([best]), np.array([sent_ns]), np.zeros((1, 1)))
            place, clock_s = states.position_m[0, 0], states.clock_s[0, 0]
            turned = 7.2921151467e-5 * epoch.pseudorange_m[row] / 299792458.0
            turn = np.array(
                [[np.cos(turned), np.sin(turned), 0], [-np.sin(turned), np.cos(turned), 0], [0, 0, 1]]
            )
            clocks.append(
                epoch.pseudorange_m[row] - np.linalg.norm(turn @ place - here) + clock_s * 299792458.0
            )
        used += len(clocks)
        assert np.ptp(clocks) < 100.0, system
    assert used > 30


def rinex_4(body: str) -> str:
    head = f"{4.02:9.2f}{'':11}{'NAVIGATION DATA':<20}{'M: MIXED':<20}RINEX VERSION / TYPE\n"
    return head + f"{'':60}END OF HEADER\n" + body


def body_of(text: str) -> str:
    return text.split("END OF HEADER\n")[1]


def test_rinex_4_announces_each_record():
    written = ephemerides(1)
    messages = {"G": "LNAV", "J": "LNAV", "E": "INAV", "C": "D1"}
    body = ""
    for e in written:
        name = satellite_name(e.satellite)
        body += f"> EPH {name} {messages[name[0]]}\n" + body_of(navigation_text([e]))
        body += f"> EPH {name} CNAV\n" + body_of(navigation_text([e])) + "    1.000000000000E+00\n"
        body += f"> STO {name} LNAV\n    2024 06 24 00 00 00 GPUT\n     0.000000000000E+00\n"
    a = "".join(f"{v:19.12E}" for v in (1e-8, 2e-8, 3e-8))
    b = "".join(f"{v:19.12E}" for v in (4e-8, 5e4, 6e4, 7e4))
    for satellite, message in (("G01", "LNAV"), ("C01", "D1D2"), ("C19", "CNVX"), ("E01", "IFNV")):
        body += f"> ION {satellite} {message}\n    2024 06 24 00 00 00{a}\n    {b}\n    {8e4:19.12E}{0.0:19.12E}\n"
    read, errors, decoder = decode(rinex_4(body))
    assert not errors
    assert read == [as_represented(e) for e in written]
    assert decoder.skipped == {"G CNAV": 2, "J CNAV": 1, "E CNAV": 2, "C CNAV": 2}
    gps = IonosphereCoefficients(system="G", alpha=(1e-8, 2e-8, 3e-8, 4e-8), beta=(5e4, 6e4, 7e4, 8e4))
    assert decoder.klobuchar == {"G": gps, "C": replace(gps, system="C")}


def test_ionosphere_is_returned_with_its_second_half():
    def half(name: str, first: float, suffix: str = "") -> str:
        return f"{name} " + "".join(f"{first + k:12.4E}" for k in range(4)) + f" {suffix}"

    def quartet(first: float) -> tuple[float, ...]:
        return tuple(first + k for k in range(4))

    a, c = "A 19", "B 20"
    lines = [
        *(half("GAL ", 1.0), half("GPSA", 10.0), half("BDSA", 20.0, a), half("BDSA", 30.0, c)),
        *(half("GPSB", 40.0), half("BDSB", 50.0, a), half("BDSB", 60.0, c), half("QZSB", 70.0)),
    ]
    decoder = NavigationDecoder("test.nav")
    assert decoder.feed(f"{3.04:9.2f}{'':11}{'N':<20}{'M':<20}RINEX VERSION / TYPE\n".encode()) == []
    decoded = [decoder.feed(f"{line:<60}IONOSPHERIC CORR\n".encode()) for line in lines]
    assert decoded == [
        *([[]] * 4),
        [IonosphereCoefficients(system="G", alpha=quartet(10.0), beta=quartet(40.0))],
        [IonosphereCoefficients(system="C", alpha=quartet(20.0), beta=quartet(50.0))],
        [IonosphereCoefficients(system="C", alpha=quartet(30.0), beta=quartet(60.0))],
        [],
    ]
    assert decoder.klobuchar == {"G": decoded[4][0], "C": decoded[6][0]}


def test_exponents_with_d_blank_fields_and_other_writers_weeks():
    other = {"tgd_s": 1e-9, "iodc": 5.0, "fit_interval_h": 4.0}
    sent_ns = 2200 * 604_800 * SECOND_NS
    times_ns = {**dict.fromkeys(("toe_ns", "toc_ns"), sent_ns + 7200 * SECOND_NS), "transmission_ns": sent_ns}
    e = replace(ephemerides(3)[0], satellite=ord("G") * 256 + 5, other=other, **times_ns)
    lines = navigation_text([e]).splitlines()
    week = f"{2200.0:19.12E}"
    (k,) = [k for k, line in enumerate(lines) if week in line]
    for other_week in (2200 % 1024, 2199):
        changed = lines.copy()
        changed[k] = lines[k].replace(week, f"{other_week:19.12E}")
        assert decode("\n".join(changed))[0] == [as_represented(e)]
    changed = lines.copy()
    changed[k] = lines[k].replace(week, f"{2150.0:19.12E}")
    assert "week 2150" in str(decode("\n".join(changed))[1][0])
    with_d = [
        line.replace("E", "D") if "HEADER" not in line and "RINEX" not in line else line for line in lines
    ]
    assert decode("\n".join(with_d))[0] == [as_represented(e)]
    # The last line: time of transmission and fit interval. Both may be missing.
    read, errors, _ = decode("\n".join([*lines[:-1], " " * 4]))
    assert not errors
    assert read[0].transmission_ns == e.toe_ns
    assert read[0].other["fit_interval_h"] == 4.0
    # Counted from the week of transmission instead of toe's.
    sent = f"{604_800.0 - 100.0:19.12E}"
    read, _, _ = decode("\n".join([*lines[:-1], "    " + sent]))
    assert read[0].transmission_ns == 2200 * 604_800 * SECOND_NS - 100 * SECOND_NS


def test_beidou_time_is_14_seconds_less():
    e = next(e for e in ephemerides(2) if satellite_name(e.satellite) == "C01")
    day_ns = gps_ns_from_gpst(CalendarTime(2024, 6, 23, 0, 0, 14))
    e = replace(e, toe_ns=day_ns, toc_ns=day_ns, transmission_ns=day_ns)
    text = navigation_text([e])
    assert "C01 2024 06 23 00 00 00" in text
    assert "9.640000000000E+02" in text
    assert decode(text)[0][0].toe_ns == day_ns


@pytest.mark.parametrize(
    ("line", "column", "text", "says"),
    [
        (0, 5, "x", "time"),
        (0, 9, "13", "month"),
        (1, 10, "?", "iode"),
        (2, 30, "_", "eccentricity"),
        (2, 23, " 1.000000000000E+00", "eccentricity"),
        (3, 4, " 7.000000000000E+05", "toe"),
        (3, 30, "\x00", "cic"),
        (5, 42, "                NAN", "week"),
        (6, 23, "                   ", "health is blank"),
        (6, 23, " 1.500000000000E+00", "health"),
        (4, 0, "G", "lines"),
    ],
)
def test_malformed_record_is_one_error_with_its_line(line, column, text, says):
    written = ephemerides(4)
    lines = navigation_text(written).split("\n")
    begin = next(k for k, content in enumerate(lines) if content.endswith("END OF HEADER")) + 1 + 8
    old = lines[begin + line]
    lines[begin + line] = old[:column] + text + old[column + len(text) :]
    read, errors, _ = decode("\n".join(lines))
    assert read == [as_represented(e) for k, e in enumerate(written) if k != 1]
    assert str(errors[0]).startswith(f"test.nav:{begin + 1}: ")
    assert says in str(errors[0])
    assert len(errors) <= 2


def test_truncated_file_loses_only_its_last_record():
    written = ephemerides(5)
    text = navigation_text(written)
    for cut in (1, 2, 30, 100, 300):
        read, errors, _ = decode(text[:-cut])
        expected = [as_represented(e) for e in written]
        # A missing newline, or a blank less, takes no number away.
        assert read[: len(written) - 1] == expected[:-1]
        assert len(read) + len(errors) == len(written)
        assert read == expected[: len(read)]


@pytest.mark.parametrize(
    ("first", "says"),
    [
        (
            f"{2.12:9.2f}{'':11}{'N: GPS NAV DATA':<40}RINEX VERSION / TYPE",
            "RINEX version is '2.12', expected 2.0 to 2.11, 3 or 4",
        ),
        (f"{5.0:9.2f}{'':11}{'N: GNSS NAV DATA':<40}RINEX VERSION / TYPE", "expected 2.0 to 2.11, 3 or 4"),
        (f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<40}RINEX VERSION / TYPE", "expected navigation data"),
        ("garbage", "expected 'RINEX VERSION / TYPE'"),
    ],
)
def test_other_file_types_are_refused_in_one_line(tmp_path, first, says):
    path = tmp_path / "test.nav"
    path.write_text(first + "\n" + "more\n" * 5)
    with pytest.raises(FormatError, match=says):
        read_navigation(path)


def test_endless_header_and_line_are_refused():
    decoder = NavigationDecoder("test.nav")
    decoder.feed((navigation_text(ephemerides(9)).split("\n")[0] + "\n").encode())
    for _ in range(30):
        decoder.feed(b"COMMENT\n" * 1000)
    assert decoder.refused
    _, errors, _ = decode(b"x" * 5_000_000)
    assert len(errors) == 1

"""`camber gnss inspect` knows formats by their content, counts what they hold, says in one line what it cannot read."""

from __future__ import annotations

import functools
import gzip
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pysbf2 import SBF_MSGIDS
from pyubx2 import UBX_MSGIDS

from camber import cli
from camber.formats.errors import FormatError
from camber.formats.nmea.writer import format_gga, format_rmc
from camber.formats.observations import ObservationEpoch, satellite_name, signal_name
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.rinex.writer import StationHeader, navigation_text
from camber.formats.rtcm.writer import format_ephemeris, format_observations, format_reference_station
from camber.formats.ubx.nav_writer import format_position_velocity_time
from camber.formats.ubx.writer import format_raw_measurements
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst, gps_ns_from_week_tow
from camber.tools.gnss import recording_file
from camber.tools.gnss.inspect import inspect_recording
from camber.tools.gnss.inspect_text import text_of
from support.gnss_files import observation_text, read_observations
from support.random_observations import random_ephemeris, random_epoch
from support.refusals import Refused
from support.sbf_blocks import Tracked, meas_epoch
from support.sbf_drive import position_blocks

Shown = Callable[..., str]
NS = 1_000_000_000
FIRST_NS = gps_ns_from_gpst(CalendarTime(2025, 5, 14, 3, 20, 0))
PLACE_ECEF_M = (-3817680.7270, 3562839.5216, 3650159.2407)
EPOCHS = 60
OF_ALL_FORMATS = {
    "G": {"1C": 1575.42e6, "2L": 1227.6e6},
    "E": {"1C": 1575.42e6, "7Q": 1207.14e6},
    "J": {"1C": 1575.42e6, "2L": 1227.6e6},
    "C": {"2I": 1561.098e6, "7I": 1207.14e6},
}
"""Signals that every format can say."""


def steady_epochs(count: int = EPOCHS, first_ns: int = FIRST_NS) -> list[ObservationEpoch]:
    """The same signals all the time, 1 Hz; phases and Dopplers that belong together."""
    rng = np.random.default_rng(4)
    start = random_epoch(
        rng, first_ns, satellites=6, carriers=OF_ALL_FORMATS, missing=0.0, most_range_m=2.4e7
    )
    n = start.satellite.size
    return [
        replace(
            start,
            time_ns=first_ns + k * NS,
            doppler_hz=np.zeros(n),
            lock_time_s=np.full(n, 10.0 + k),
            loss_of_lock=np.zeros(n, np.bool_),
            half_cycle=np.zeros(n, np.bool_),
            cn0_dbhz=np.round(np.clip(start.cn0_dbhz + rng.normal(0.0, 1.0, n), 20.0, 55.0)),
        )
        for k in range(count)
    ]


def solution(k: int, quality: SolutionQuality = SolutionQuality.FIX) -> ReceiverSolution:
    return ReceiverSolution(
        time_ns=FIRST_NS + k * NS,
        latitude_rad=0.61,
        longitude_rad=2.39,
        height_m=50.0 + 0.01 * k,
        quality=quality,
        satellites=12,
    )


def write(folder: Path, content: bytes | str, name: str = "recording") -> Path:
    path = folder / name
    path.write_bytes(content.encode("latin-1") if isinstance(content, str) else content)
    return path


def rinex(epochs: Sequence[ObservationEpoch]) -> str:
    return observation_text(epochs, StationHeader(marker="roof", position_ecef_m=PLACE_ECEF_M))


def rtcm(epochs: Sequence[ObservationEpoch], *, station: int = 7) -> bytes:
    return b"".join(frame for epoch in epochs for frame in format_observations(epoch, station_id=station))


@pytest.fixture
def shown(capsys: pytest.CaptureFixture[str]) -> Shown:
    def printed(path: Path, *more: str) -> str:
        assert cli.main(["gnss", "inspect", str(path), *more]) == 0
        return capsys.readouterr().out

    return printed


def only(report: dict[str, Any]) -> dict[str, Any]:
    (observed,) = report["observations"]
    return dict(observed)


# what it is


def test_every_format_is_known_by_its_content_whatever_the_file_is_called(tmp_path: Path) -> None:
    epochs = steady_epochs(5)
    ephemeris = random_ephemeris(np.random.default_rng(1), "G05", FIRST_NS)
    positions = [solution(k) for k in range(3)]
    contents: dict[str, bytes | str] = {
        "RINEX observations": rinex(epochs),
        "RINEX navigation": navigation_text([ephemeris]),
        "RTKLIB solutions": format_pos_header() + b"".join(map(format_pos_line, positions)),
    }
    streams = [
        b"".join(map(format_raw_measurements, epochs)),
        b"".join(format_ephemeris(ephemeris)) + rtcm(epochs),
        b"".join(format_rmc(p) + format_gga(p, geoid_separation_m=38.0) for p in positions),
    ]
    for form, content in contents.items():
        assert inspect_recording(write(tmp_path, content))["format"] == form
    for stream in (*streams, b"\x00garbage\xb5\x62" + b"".join(streams)):
        assert inspect_recording(write(tmp_path, stream))["format"] == "receiver stream"
        assert inspect_recording(write(tmp_path, gzip.compress(stream)))["format"] == "receiver stream"


def test_names_of_messages_are_those_of_a_second_implementation() -> None:
    for number, name in recording_file.UBX_NAMES.items():
        assert UBX_MSGIDS[bytes(divmod(number, 256))] == name
    for number, name in recording_file.SBF_NAMES.items():
        assert SBF_MSGIDS[number][0] == name


@pytest.mark.parametrize(
    ("content", "output"),
    [
        (b"", "empty file, expected RINEX 2, 3 or 4, UBX"),
        (np.random.default_rng(3).bytes(20_000), "content is"),
        (b"time_ns,wheel_speed_m_s\n1,2\n", "content is 'time_ns,"),
        (b"$ABC is no sentence\r\n$GPGGA,1*00\r\n", "content is"),
        (f"{2.12:9.2f}{'':11}{'OBSERVATION DATA':<40}RINEX VERSION / TYPE\n", "RINEX version is '2.12', expected 2.0"),
        (b"%  GPST latitude(deg) longitude(deg) height(m) Q ns\n2025/05/14 03:20:00 35 136 50 1 9\n", "recording:"),
        (gzip.compress(rinex(steady_epochs(3)).encode(), mtime=0)[:15], "gzip compression"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_one_clear_line(
    tmp_path: Path, refused: Refused, content: bytes | str, output: str
) -> None:
    line = refused(cli.main, "gnss", "inspect", write(tmp_path, content))
    assert line.startswith("camber gnss inspect: recording:")
    assert output in line


def test_a_file_that_is_not_there_is_one_clear_line(tmp_path: Path, refused: Refused) -> None:
    for path in (tmp_path / "absent", tmp_path):
        assert str(path) in refused(cli.main, "gnss", "inspect", path)


def test_a_truncated_file_is_shown_up_to_its_damage_which_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Of the last million bytes before the damage nothing comes out of the unpacking.
    packed = gzip.compress(rinex(steady_epochs(1200)).encode(), mtime=0)
    assert cli.main(["gnss", "inspect", str(write(tmp_path, packed[: len(packed) * 3 // 4]))]) == 2
    out, err = capsys.readouterr()
    assert "gzip compression, expected it whole" in err
    assert "epochs" in out
    assert "as many lines as it announces" in out


def test_the_service_and_its_other_options_are_not_disturbed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["gnss", "--source", "file:rover.pos", "--protocol", "pos", "--check"])
    assert ended.value.code == 0
    capsys.readouterr()
    assert cli.main(["--help"]) == 0
    of_all = capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        cli.main(["gnss", "--help"])
    assert ended.value.code == 0
    of_gnss = capsys.readouterr().out
    for name in ("inspect", "solve"):
        assert f"\n  gnss {name} " in of_all
        assert f"\n  {name} " in of_gnss


# signals


def test_signals_are_counted_as_row_by_row(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    epochs = [random_epoch(rng, FIRST_NS + k * NS) for k in range(300)]
    path = write(tmp_path, rinex(epochs))
    report = only(inspect_recording(path))
    levels: dict[tuple[str, str], list[float]] = {}
    seen: dict[tuple[str, str], set[str]] = {}
    counts = Counter[tuple[str, str, str]]()
    satellites_of_epochs = []
    for epoch in read_observations(path).epochs:
        in_epoch = set[tuple[str, str]]()
        satellites_of_epochs.append(len(set(epoch.satellite.tolist())))
        for i in range(epoch.satellite.size):
            satellite, signal = satellite_name(int(epoch.satellite[i])), signal_name(int(epoch.signal[i]))
            key = satellite[0], signal
            in_epoch.add(key)
            seen.setdefault(key, set()).add(satellite)
            counts[*key, "rows"] += 1
            counts[*key, "code"] += bool(np.isfinite(epoch.pseudorange_m[i]))
            counts[*key, "phase"] += bool(np.isfinite(epoch.carrier_phase_cycles[i]))
            counts[*key, "doppler"] += bool(np.isfinite(epoch.doppler_hz[i]))
            counts[*key, "half_cycle"] += bool(epoch.half_cycle[i])
            counts[*key, "loss_of_lock"] += bool(epoch.loss_of_lock[i])
            if np.isfinite(epoch.cn0_dbhz[i]):
                levels.setdefault(key, []).append(float(epoch.cn0_dbhz[i]))
        counts.update((*key, "epochs") for key in in_epoch)
    assert {(s["system"], s["signal"]) for s in report["signals"]} == set(seen)
    for s in report["signals"]:
        key = s["system"], s["signal"]
        rows = counts[*key, "rows"]
        assert s["rows"] == rows
        assert s["satellites"] == sorted(seen[key])
        for name in ("epochs", "half_cycle", "loss_of_lock"):
            assert s[name] == counts[*key, name]
        for name in ("code", "phase", "doppler"):
            assert s[f"with_{name}"] == pytest.approx(counts[*key, name] / rows)
        assert s["cn0_mean_dbhz"] == pytest.approx(np.mean(levels[key]), abs=0.006)
        for name, share in (("cn0_p05_dbhz", 0.05), ("cn0_p95_dbhz", 0.95)):
            assert s[name] == pytest.approx(np.quantile(levels[key], share, method="inverted_cdf"), abs=0.051)
    each = report["satellites_an_epoch"]
    assert each["mean"] == pytest.approx(np.mean(satellites_of_epochs))
    assert (each["least"], each["most"]) == (min(satellites_of_epochs), max(satellites_of_epochs))
    assert sum(s["satellites_an_epoch"] for s in report["systems"]) == pytest.approx(each["mean"])


def test_arcs_are_counted_by_what_began_them(tmp_path: Path) -> None:
    epochs = steady_epochs()
    n = epochs[0].satellite.size
    flagged = np.zeros(n, np.bool_)
    flagged[2] = True
    epochs[20] = replace(epochs[20], loss_of_lock=flagged)
    epochs[30] = replace(epochs[30], half_cycle=flagged)
    epochs = epochs[:40] + epochs[45:]
    report = only(inspect_recording(write(tmp_path, rinex(epochs))))
    begun = {reason: count for reason, count in report["arcs_begun"].items() if count}
    # The half cycle comes and goes.
    assert begun == {"new": n, "gap": n, "receiver_flag": 1, "half_cycle": 2}
    assert sum(s["arcs"] for s in report["signals"]) == 2 * n + 3
    (signal,) = [s for s in report["signals"] if s["loss_of_lock"]]
    assert signal["arcs"] == 2 * len(signal["satellites"]) + 3


def test_a_recording_of_one_epoch_in_thirty_seconds_is_not_all_gaps(tmp_path: Path) -> None:
    epochs = [replace(e, time_ns=FIRST_NS + 30 * k * NS) for k, e in enumerate(steady_epochs(20))]
    report = only(inspect_recording(write(tmp_path, rinex(epochs))))
    assert report["time"]["interval_s"] == 30.0
    assert report["time"]["gaps"] == 0
    assert report["arcs_begun"]["gap"] == 0


# times


def test_gaps_repeated_and_late_epochs_are_counted_and_dated(tmp_path: Path, shown: Shown) -> None:
    epochs = steady_epochs()
    shuffled = [*epochs[:10], epochs[9], *epochs[10:20], epochs[12], *epochs[20:30], *epochs[37:]]
    path = write(tmp_path, rinex(shuffled))
    report = only(inspect_recording(path))
    times = report["time"]
    assert times["epochs"] == EPOCHS - 7 + 2
    assert (times["repeated"], times["late"], times["times_it_went_back"]) == (1, 1, 0)
    assert (times["gaps"], times["longest_gap_s"]) == (1, 8.0)
    assert times["first_gaps"] == [{"after": "2025/05/14 03:20:29.000", "length_s": 8.0}]
    assert times["interval_s"] == 1.0
    # What comes late is not counted twice.
    assert max(s["epochs"] for s in report["signals"]) == EPOCHS - 7
    out = shown(path)
    assert "8 s after 2025/05/14 03:20:29.000" in out
    assert "1 repeated, 1 late epochs" in out


def test_a_clock_set_back_is_distinguished_from_stray_epochs(tmp_path: Path) -> None:
    earlier = steady_epochs(20, FIRST_NS - 3600 * NS)
    report = only(inspect_recording(write(tmp_path, rinex([*steady_epochs(20), *earlier]))))["time"]
    assert report["times_it_went_back"] == 1
    assert report["late"] == 2
    assert report["time_went_back"] == ["2025/05/14 02:20:02.000"]


@pytest.mark.parametrize("protocol", ["rinex", "ubx", "sbf", "rtcm"])
def test_the_end_of_a_week_is_no_gap(tmp_path: Path, protocol: str) -> None:
    begin_ns = gps_ns_from_week_tow(2366, 0)
    epochs = steady_epochs(40, begin_ns - 20 * NS)
    content = {
        "rinex": lambda: rinex(epochs).encode(),
        "ubx": lambda: b"".join(map(format_raw_measurements, epochs)),
        "sbf": lambda: b"".join(meas_epoch(e.time_ns, {5: [SIGNAL]}) for e in epochs),
        "rtcm": lambda: rtcm(epochs),
    }[protocol]()
    times = only(inspect_recording(write(tmp_path, content), date(2025, 5, 10)))["time"]
    assert (times["epochs"], times["gaps"], times["late"]) == (40, 0, 0)
    assert (times["first_ns"], times["last_ns"]) == (begin_ns - 20 * NS, begin_ns + 19 * NS)


# streams


SIGNAL = Tracked(signal=0, code_mm=22 * 10**9, phase_mcycles=0, doppler_tmhz=0)


def test_a_stream_of_sbf_has_its_observations_positions_and_blocks(tmp_path: Path) -> None:
    report = inspect_recording(write(tmp_path, whole("sbf")))
    assert report["format"] == "receiver stream"
    assert only(report)["time"]["epochs"] == 5
    assert report["positions"]["by_quality"] == {"fix": 5}
    blocks = ("MeasEpoch", "PVTGeodetic", "EndOfPVT")
    assert report["messages"] == {f"SBF {name}": 5 for name in sorted(blocks)}
    assert report["counters"] == {}


def test_the_week_of_rtcm_comes_from_ephemerides_or_the_caller_and_else_is_a_guess_named_so(
    tmp_path: Path, shown: Shown
) -> None:
    epochs = steady_epochs(5)
    ephemeris = random_ephemeris(np.random.default_rng(5), "G05", FIRST_NS)
    alone, with_ephemeris = rtcm(epochs), b"".join(format_ephemeris(ephemeris)) + rtcm(epochs)

    def dated(content: bytes) -> Path:
        path = write(tmp_path, content)
        other_s = time.mktime((2031, 6, 1, 0, 0, 0, 0, 0, 0))
        os.utime(path, (other_s, other_s))
        return path

    report = inspect_recording(dated(with_ephemeris))
    assert report["week_from"] == "ephemerides"
    assert only(report)["time"]["first_ns"] == FIRST_NS
    report = inspect_recording(dated(alone), date(2025, 5, 13))
    assert report["week_from"] == "caller"
    assert only(report)["time"]["first_ns"] == FIRST_NS
    report = inspect_recording(dated(alone))
    assert report["week_from"] == "file date"
    assert only(report)["time"]["first"][:4] == "2031"
    assert "guessed from the date of the file" in shown(dated(alone))
    assert "guessed" not in shown(dated(with_ephemeris))


def test_the_week_of_corrections_is_that_of_the_receiver_they_are_for(tmp_path: Path) -> None:
    epochs = steady_epochs(5)
    position = format_position_velocity_time(solution(4), geoid_separation_m=38.0)
    for output in (b"".join(map(format_raw_measurements, epochs)), position):
        # The corrections come before anything that has a date.
        path = write(tmp_path, rtcm(epochs) + output)
        os.utime(path, (1_000_000_000, 1_000_000_000))
        report = inspect_recording(path)
        times = {observed["of"]: observed["time"]["first_ns"] for observed in report["observations"]}
        assert times["station 7"] == FIRST_NS
        assert report["week_from"] == "recording"


def test_a_port_with_everything_on_it_is_taken_apart(tmp_path: Path) -> None:
    epochs = steady_epochs(30)
    rng = np.random.default_rng(6)
    parts = []
    for k, epoch in enumerate(epochs):
        # Corrections come before the receiver has sent a date.
        parts.append(rtcm([epoch], station=3))
        parts.append(rng.bytes(40).replace(b"$", b"_"))
        parts.append(format_raw_measurements(epoch))
        parts.append(format_position_velocity_time(solution(k), geoid_separation_m=38.0))
        parts.append(format_rmc(solution(k)) + format_gga(solution(k), geoid_separation_m=38.0))
    parts.append(format_reference_station(PLACE_ECEF_M, station_id=3, antenna_height_m=0.05))
    broken = bytearray(format_raw_measurements(epochs[-1]))
    broken[100] ^= 0xFF
    report = inspect_recording(write(tmp_path, b"".join([*parts, bytes(broken)])))
    epochs_of = {observed["of"]: observed["time"]["epochs"] for observed in report["observations"]}
    assert epochs_of == {"station 3": 30, "receiver": 30}
    assert report["messages"]["UBX RXM-RAWX"] == 30
    assert report["messages"]["NMEA GNGGA"] == 30
    assert report["positions"]["by_quality"] == {"fix": 30}
    assert report["integrity"]["fix_within_masks"] == {"yes": 30}
    assert report["integrity"]["spoofing"] == {"unknown": 30}
    assert report["counters"]["failed_checks"] >= 1
    assert report["counters"]["bytes_skipped"] > 30 * 35
    (station,) = report["reference_stations"]
    assert (station["station"], station["times_said"]) == (3, 1)
    assert station["position_ecef_m"] == pytest.approx(PLACE_ECEF_M, abs=1e-4)
    assert station["antenna_height_m"] == pytest.approx(0.05)


def test_positions_are_counted_by_quality(tmp_path: Path, shown: Shown) -> None:
    qualities = [SolutionQuality.FIX] * 4 + [SolutionQuality.FLOAT] * 3 + [SolutionQuality.SINGLE]
    lines = [format_pos_line(solution(k, quality)) for k, quality in enumerate(qualities)]
    path = write(tmp_path, format_pos_header() + b"".join(lines) + b"2025/05/14 nonsense\n")
    report = inspect_recording(path)
    assert report["positions"]["by_quality"] == {"fix": 4, "float": 3, "single": 1}
    assert report["positions"]["time"]["interval_s"] == 1.0
    assert report["problems"]["count"] == 1
    assert "recording:11:" in report["problems"]["first"][0]
    assert "4 fix, 3 float, 1 single" in shown(path)


def test_ephemerides_are_counted_once_each_with_those_that_no_orbit_can_be(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    good = [random_ephemeris(rng, name, FIRST_NS) for name in ("G05", "G06", "E11", "C20", "J02")]
    realistic = [replace(e, sqrt_a=5153.7, eccentricity=0.01, clock=(1e-4, 0.0, 0.0), health=0) for e in good]
    ill = replace(realistic[0], satellite=realistic[0].satellite + 8, health=1)
    impossible = replace(realistic[1], sqrt_a=1.0)
    report = inspect_recording(write(tmp_path, navigation_text([*realistic, realistic[0], ill, impossible])))[
        "ephemerides"
    ]
    assert {s["system"]: s["ephemerides"] for s in report["systems"]} == {"G": 3, "J": 1, "E": 1, "C": 1}
    assert report["systems"][0]["unhealthy"] == [satellite_name(ill.satellite)]
    assert report["refused"] == {"orbit": 1}


# output


def test_json_holds_all_and_nothing_that_json_has_not(tmp_path: Path, shown: Shown) -> None:
    path = write(tmp_path, rinex(steady_epochs(1)))

    def refuse(text: str) -> float:
        raise AssertionError(text)

    report = json.loads(shown(path, "--json"), parse_constant=refuse)
    assert report == json.loads(json.dumps(inspect_recording(path)))
    # Of one epoch there is no interval: not known is no zero.
    assert report["observations"][0]["time"]["interval_s"] is None


def test_columns_of_the_table_stand_below_each_other(tmp_path: Path, shown: Shown) -> None:
    out = shown(write(tmp_path, rinex(steady_epochs())))
    lines = out.splitlines()
    head = next(k for k, line in enumerate(lines) if line.strip().startswith("signal"))
    rows = lines[head + 1 : lines.index("", head)]
    assert len(rows) > 5
    assert {len(row) for row in rows} == {len(lines[head])}
    assert "signals" not in out
    assert "receiver      CAMBER SIMULATED" in out


@functools.cache
def whole(kind: str) -> bytes:
    positions = [solution(k) for k in range(5)]
    match kind:
        case "ubx":
            output = format_position_velocity_time(positions[3], geoid_separation_m=38.0)
            return b"".join(map(format_raw_measurements, steady_epochs(3))) + output
        case "sbf":
            blocks = (meas_epoch(p.time_ns, {5: [SIGNAL]}) + position_blocks(p) for p in positions)
            return b"".join(blocks)
        case "rtcm":
            return rtcm(steady_epochs(3)) + format_reference_station(PLACE_ECEF_M, station_id=3)
        case "rinex":
            return rinex(steady_epochs(3)).encode()
        case "nav":
            return navigation_text([random_ephemeris(np.random.default_rng(2), "E05", FIRST_NS)]).encode()
        case "pos":
            return format_pos_header() + b"".join(map(format_pos_line, positions))
        case _:
            return b"".join(format_rmc(p) + format_gga(p, geoid_separation_m=38.0) for p in positions)


@settings(derandomize=True, max_examples=150, deadline=None)
@given(
    kind=st.sampled_from(("ubx", "sbf", "rtcm", "rinex", "nav", "pos", "nmea")),
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.binary(max_size=6)), max_size=8),
    cut=st.integers(0, 10**6),
)
def test_damage_is_counted_or_reported_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, kind: str, changes: list[tuple[int, bytes]], cut: int
) -> None:
    content = bytearray(whole(kind))
    for at, new in changes:
        place = at % len(content)
        content[place : place + len(new)] = new
    path = write(tmp_path_factory.getbasetemp(), bytes(content[: len(content) - cut % 200]))
    text, output = "", ""
    try:
        report = inspect_recording(path)
    except FormatError as error:
        output = str(error)
    else:
        json.dumps(report, allow_nan=False)
        text = text_of(report)
    assert output.startswith("recording:") != text.startswith("recording: ")
    assert "\n" not in output


# recordings


def test_rooftop_holds_what_its_readme_says(data: Path) -> None:
    report = inspect_recording(data / "rooftop-2024-06-24" / "rover.obs")
    assert report["header"]["receiver"] == "SEPT MOSAIC-X5"
    observed = only(report)
    assert (observed["time"]["epochs"], observed["time"]["interval_s"]) == (301, 1.0)
    assert [s["system"] for s in observed["systems"]] == ["G", "J", "E", "C", "R"]
    assert all(s["with_doppler"] == 1.0 for s in observed["signals"])
    assert report["counters"] == {}


def test_nagoya_holds_what_its_readme_says(data: Path) -> None:
    report = inspect_recording(data / "nagoya-2023-07-11" / "rover_rtk.pos")
    assert report["positions"]["by_quality"] == {"float": 3596, "fix": 1799}
    assert report["positions"]["time"]["interval_s"] == 0.2


def test_no_receiver_log_is_too_odd(data: Path) -> None:
    logs = sorted((data / "receiver-logs").iterdir())
    assert len(logs) == 9
    reports = {path.name: inspect_recording(path) for path in logs}
    for report in reports.values():
        assert report["messages"]
        json.dumps(report, allow_nan=False)
        text_of(report)
    assert reports["ubx-pygpsdata-BADCK2.log"]["counters"]["failed_checks"] == 2
    assert only(reports["ubx-pygpsdata-RXMRAWX.log"])["time"]["epochs"] == 14
    assert reports["ubx-pygpsdata-MIXED.log"]["positions"]["by_quality"] == {"single": 39}

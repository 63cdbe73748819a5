"""Raw observations are cut into epochs without losing a byte, each at its time, whatever the format."""

from __future__ import annotations

import gzip
import random
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rinex.writer import StationHeader
from camber.formats.rtcm.msm_writer import msm7_payloads
from camber.formats.rtcm.writer import format_observations, format_reference_station, rtcm_frame
from camber.formats.ubx.writer import format_raw_measurements, ubx_frame
from camber.geodesy.gps_time import NS_PER_WEEK
from camber.replay.observation_files import read_observation_file, read_raw_file
from support.gnss_files import observation_text, recording
from support.random_observations import COMMON, random_epoch
from support.rinex2_writer import Epoch2, labelled, observation_text_2
from support.sbf_blocks import END_OF_PVT, GPS_NAV, PVT_GEODETIC, Tracked, meas_epoch, sbf_block, sbf_frame

START_NS = 2410 * NS_PER_WEEK + 259_200_000_000_000
STEP_NS = 100_000_000
TIMES_NS = [START_NS + k * STEP_NS for k in (0, 1, 2, 4, 5)]
ECEF_M = (-3_850_000.0, 3_430_000.0, 3_740_000.0)
CARRIERS = {
    "G": {name: COMMON["G"][name] for name in ("1C", "2L", "5Q")},
    "C": {name: COMMON["C"][name] for name in ("2I", "7I")},
}


def epochs() -> list:
    rng = np.random.default_rng(5)
    return [random_epoch(rng, t, satellites=5, carriers=CARRIERS) for t in TIMES_NS]


def written(folder: Path, data: bytes) -> Path:
    path = folder / "rover.raw"
    path.write_bytes(data)
    return path


def check_cut(path: Path, data: bytes, times_ns: list[int], near_ns: int | None = None) -> list[bytes]:
    _, header, parts = read_observation_file(path, near_ns)
    assert header + b"".join(part.payload for part in parts) == data
    assert [part.time_ns for part in parts] == times_ns
    return [part.payload for part in parts]


def rinex() -> bytes:
    return observation_text(epochs(), StationHeader(marker="rover", position_ecef_m=ECEF_M)).encode("ascii")


def itow(time_ns: int) -> bytes:
    return (time_ns % NS_PER_WEEK // 1_000_000).to_bytes(4, "little")


def ubx_epoch(epoch, *, place: bool) -> list[bytes]:  # type: ignore[no-untyped-def]
    subframe = ubx_frame(0x02, 0x13, bytes(8))
    solution = ubx_frame(0x01, 0x07, itow(epoch.time_ns) + bytes(88))
    precise = ubx_frame(0x01, 0x14, bytes(4) + itow(epoch.time_ns) + bytes(28))
    return [subframe, format_raw_measurements(epoch), *([solution, precise] if place else [])]


def position_of_sbf(time_ns: int) -> bytes:
    return sbf_block(PVT_GEODETIC, time_ns, Mode=4)


def sbf_epoch(time_ns: int, *, place: bool) -> list[bytes]:
    status, ephemeris = sbf_frame(4014, bytes(40)), sbf_block(GPS_NAV, time_ns - 30 * 10**9)
    signals = {5: [Tracked(signal=0, code_mm=10**10, phase_mcycles=0, doppler_tmhz=0)]}
    position = [position_of_sbf(time_ns), sbf_block(END_OF_PVT, time_ns)]
    return [status, ephemeris, meas_epoch(time_ns, signals), *(position if place else [])]


def test_rinex_has_a_header_and_a_block_an_epoch(tmp_path: Path) -> None:
    data = rinex()
    path = written(tmp_path, data)
    protocol, header, _ = read_observation_file(path, None)
    assert protocol == "rinex"
    assert header.splitlines()[-1].rstrip().endswith(b"END OF HEADER")
    assert all(part.startswith(b"> 20") for part in check_cut(path, data, TIMES_NS))


@pytest.mark.parametrize("system", ["GPS", "BDT"])
def test_rinex_2_has_a_block_an_epoch_from_a_line_with_the_date(tmp_path: Path, system: str) -> None:
    satellites = {
        f"G{n:2d}": dict.fromkeys(("C1", "L1", "P2", "L2", "S1", "S2"), (2e7 + n, " ", " "))
        for n in range(1, 15)
    }
    blocks = [Epoch2(time_ns=time_ns, satellites=satellites) for time_ns in TIMES_NS]
    event = Epoch2(time_ns=TIMES_NS[2], satellites={}, flag=4, lines=[labelled("a comment", "COMMENT")])
    first = f"  2026     3    18     0     0    0.0000000     {system}"
    text = observation_text_2(
        [*blocks[:2], event, *blocks[2:]], ("C1", "L1", "P2", "L2", "S1", "S2"), first=first
    )
    path, offset_ns = written(tmp_path, text.encode()), 14_000_000_000 if system == "BDT" else 0
    parts = check_cut(path, text.encode(), [t + offset_ns for t in TIMES_NS])
    assert parts[1].endswith(b"COMMENT\n")
    decoder = RinexDecoder("rover")
    header = read_observation_file(path, None)[1]
    assert not decoder.feed(header)
    results = [decoder.feed(part) for part in parts]
    assert [[e.time_ns for e in epochs] for epochs in results] == [[t + offset_ns] for t in TIMES_NS]


def test_a_packed_file_is_cut_as_it_is_unpacked(tmp_path: Path) -> None:
    data = rinex()
    check_cut(written(tmp_path, gzip.compress(data)), data, TIMES_NS)


def test_rinex_in_the_time_of_beidou_is_14_s_late(tmp_path: Path) -> None:
    data = rinex()
    assert data.count(b"     GPS         TIME OF FIRST OBS") == 1
    data = data.replace(b"     GPS         TIME OF FIRST OBS", b"     BDT         TIME OF FIRST OBS")
    check_cut(written(tmp_path, data), data, [t + 14_000_000_000 for t in TIMES_NS])


def test_events_and_damaged_lines_of_rinex_go_with_the_epoch_before_them(tmp_path: Path) -> None:
    lines = rinex().splitlines(keepends=True)
    begins = [k for k, line in enumerate(lines) if line.startswith(b">")]
    event = [b"> 2026 03 18 00 00  0.1500000  4  1\n", b"a comment".ljust(60) + b"COMMENT\n"]
    lines[begins[3]] = lines[begins[3]].replace(b"> 2026", b"> 20x6")
    data = b"".join([*lines[: begins[2]], *event, *lines[begins[2] :]])
    parts = check_cut(written(tmp_path, data), data, [*TIMES_NS[:3], TIMES_NS[4]])
    assert parts[1].endswith(b"".join(event))
    assert b"> 20x6" in parts[2]


def frames_of(kind: str) -> list[list[bytes]]:
    """The frames of each epoch."""
    if kind == "ubx":
        return [ubx_epoch(epoch, place=k != 2) for k, epoch in enumerate(epochs())]
    if kind == "sbf":
        return [sbf_epoch(epoch.time_ns, place=k != 2) for k, epoch in enumerate(epochs())]
    station = format_reference_station(ECEF_M, station_id=1)
    return [[station, *format_observations(epoch, station_id=1)] for epoch in epochs()]


@pytest.mark.parametrize(
    ("kind", "weeks"), [("ubx", 0.0), ("sbf", 0.0), ("rtcm", -0.49), ("rtcm", 0.0), ("rtcm", 0.49)]
)
def test_frames_are_cut_after_the_last_one_of_an_epoch(tmp_path: Path, kind: str, weeks: float) -> None:
    parts = [b"".join(group) for group in frames_of(kind)]
    data = b"".join(parts)
    path = written(tmp_path, data)
    assert read_raw_file(path)[0] == kind
    near_ns = START_NS + round(weeks * NS_PER_WEEK)
    assert check_cut(path, data, TIMES_NS, near_ns if kind == "rtcm" else None) == parts


def test_ubx_between_sentences_and_with_a_broken_frame_loses_no_byte(tmp_path: Path) -> None:
    groups = [ubx_epoch(epoch, place=True) for epoch in epochs()]
    raw = bytearray(groups[1][1])
    raw[40] ^= 1
    groups[1][1] = bytes(raw)
    data = b"$GNTXT,01\r\n\xb5\x62".join(frame for group in groups for frame in group) + b"\xb5\x62\x01"
    # Of the epoch whose measurements are damaged there are still NAV messages.
    check_cut(written(tmp_path, data), data, TIMES_NS)


def test_messages_of_glonass_are_of_the_epoch_that_they_stand_in(tmp_path: Path) -> None:
    expected: list[bytes] = []
    for epoch in epochs():
        payloads = msm7_payloads(epoch, station_id=1, more_follow=True)
        # As if of GLONASS, whose epoch counts a day of another zone; the last one of its epoch.
        glonass = bytearray(payloads[0])
        glonass[:7] = b"\x43\xf0\x01\xff\xff\xff\xfc"
        expected.append(b"".join(rtcm_frame(payload) for payload in (*payloads, bytes(glonass))))
    data = b"".join(expected)
    assert check_cut(written(tmp_path, data), data, TIMES_NS, START_NS) == expected


def test_rtcm_without_a_date_is_one_line(tmp_path: Path) -> None:
    path = written(tmp_path, b"".join(format_observations(epochs()[0], station_id=1)))
    with pytest.raises(FormatError, match=r"rover\.raw: week, expected another file of the drive that gives"):
        read_observation_file(path, None)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "rover.raw: format is '', expected RINEX 2, 3 or 4, UBX, SBF or RTCM 3"),
        (b"\xb5\x62\xd3\x00", "rover.raw: format is "),
        (ubx_frame(0x01, 0x07, bytes(92)), "rover.raw: epochs, expected at least one RXM-RAWX"),
        (position_of_sbf(START_NS), "rover.raw: epochs, expected at least one MeasEpoch"),
        (format_reference_station(ECEF_M, station_id=1), "rover.raw: epochs, expected at least one MSM"),
        (rinex().replace(b"     3.04", b"     5.00"), "rover.raw: version is"),
        (rinex().replace(b"OBSERVATION DATA", b"NAVIGATION DATA "), "rover.raw: version is"),
        (rinex().replace(b"END OF H", b"ENDS OF "), "rover.raw: header, expected a line END OF HEADER"),
        (rinex().replace(b"GPS         TIME OF", b"GLO         TIME OF"), "rover.raw: time system is"),
        (rinex().partition(b"\n>")[0] + b"\n", "rover.raw: epochs, expected at least one, from a line"),
        (gzip.compress(rinex(), mtime=0)[:-20], "rover.raw: gzip compression, expected"),
    ],
)
def test_what_cannot_be_cut_is_one_line(tmp_path: Path, data: bytes, expected: str) -> None:
    with pytest.raises(FormatError) as caught:
        read_observation_file(written(tmp_path, data), START_NS)
    assert str(caught.value).startswith(expected)


@pytest.mark.parametrize("kind", ["rinex", "ubx", "sbf", "rtcm"])
def test_damage_raises_nothing_but_format_errors_and_loses_no_byte(tmp_path: Path, kind: str) -> None:
    sound = rinex() if kind == "rinex" else b"".join(b"".join(group) for group in frames_of(kind))
    rng = random.Random(11)
    cut = 0
    for _ in range(60):
        data = bytearray(sound)
        for _ in range(rng.choice((1, 5, 50))):
            place = rng.randrange(len(data))
            data[place : place + rng.randrange(3)] = rng.randbytes(rng.randrange(3))
        try:
            _, header, parts = read_observation_file(written(tmp_path, bytes(data)), START_NS)
        except FormatError:
            continue
        cut += 1
        assert header + b"".join(part.payload for part in parts) == bytes(data)
    assert cut > 20


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("rooftop-2024-06-24/rover.obs", 301),
        ("rooftop-2024-06-24/base.obs", 301),
        ("fujisawa-2021-09-22/SEPT265G.21O", 360),
    ],
)
def test_recordings_are_cut_into_their_epochs(name: str, count: int) -> None:
    path = recording(name)
    _, header, parts = read_observation_file(path, None)
    assert header + b"".join(part.payload for part in parts) == path.read_bytes()
    assert len(parts) == count
    steps = np.diff([part.time_ns for part in parts])
    assert set(steps.tolist()) == {1_000_000_000}


def test_a_receivers_log_is_cut_at_its_measurements() -> None:
    path = recording("receiver-logs") / "ubx-pygpsdata-RXMRAWX.log"
    _, _, parts = read_observation_file(path, None)
    data = path.read_bytes()
    assert b"".join(part.payload for part in parts) == data
    assert len(parts) == data.count(b"\xb5\x62\x02\x15")
    assert (np.diff([part.time_ns for part in parts]) > 0).all()

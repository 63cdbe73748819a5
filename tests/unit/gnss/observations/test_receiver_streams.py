"""One reader for all protocols: the same epochs from every format, damage counted, RTCM between UBX is the base's."""

from __future__ import annotations

from itertools import zip_longest
from random import Random
from typing import Any

import numpy as np
import pytest

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.gnss.observations.receiver_streams import StationPosition, StreamReader
from support.raw_drive import RawDrive

NS = 1_000_000_000


def decoded(stream: Any, protocol: Any, data: bytes, near_ns: int) -> list[tuple[str, Any]]:
    reader = StreamReader(stream, protocol, "here", near_ns)
    return [*reader.feed(data), *reader.fell_silent()]


def epochs(stream: str, received: list[tuple[str, Any]]) -> list[ObservationEpoch]:
    return [what for whose, what in received if whose == stream and isinstance(what, ObservationEpoch)]


def table(epoch: ObservationEpoch) -> dict[tuple[int, int], list[float]]:
    """By satellite and band: u-blox names one of the channels of which RINEX has both (`1C`, `1X`)."""
    measured = (epoch.pseudorange_m, epoch.carrier_phase_cycles, epoch.doppler_hz, epoch.cn0_dbhz)
    columns = (column.tolist() for column in (epoch.satellite, epoch.signal >> 8, *measured))
    return {(satellite, band): values for satellite, band, *values in zip(*columns, strict=True)}


def largest_difference(one: list[ObservationEpoch], other: list[ObservationEpoch]) -> np.ndarray:
    """Of pseudorange, parts of cycles, Doppler, C/N0, over all rows; both must have the same ones."""
    worst = np.zeros(4)
    for left, right in zip_longest(one, other):
        assert left.time_ns == right.time_ns
        ours, theirs = table(left), table(right)
        assert ours.keys() == theirs.keys()
        for key, values in ours.items():
            difference = np.subtract(values, theirs[key])
            difference[1] -= np.rint(difference[1])
            assert (np.isnan(values) == np.isnan(theirs[key])).all()
            worst = np.fmax(worst, np.abs(difference))
    return worst


@pytest.mark.parametrize(
    ("stream", "protocol", "days_off", "resolution"),
    [
        # RINEX has three decimals; UBX single precision of the Doppler, whole dB-Hz, and where it counts cycles from.
        ("rover", "ubx", 0, [0.00051, 0.00051, 0.0008, 0.51]),
        # SBF of that UBX: 1 mm, 0.001 cycle, 0.0001 Hz.
        ("rover", "sbf", 200, [0.0011, 0.0016, 0.0009, 0.51]),
        # MSM7: 2^-29 ms (0.6 mm) of pseudorange, 2^-31 ms of phase, 0.0001 m/s of range rate, 2^-4 dB-Hz.
        # Its phase counts whole cycles from where the pseudorange was.
        ("base", "rtcm", 3, [0.0008, 0.0015, 0.0015, 0.04]),
    ],
)
def test_a_binary_stream_and_rinex_have_the_same_epochs_within_their_resolution(
    stream: str, protocol: str, days_off: int, resolution: list[float], raw_drive: RawDrive
) -> None:
    near_ns = raw_drive.times_ns[0]
    data = b"".join(getattr(raw_drive, f"{protocol}_parts"))
    binary = epochs(stream, decoded(stream, protocol, data, near_ns + days_off * 86_400 * NS))
    lines = [getattr(raw_drive, f"{stream}_header"), *getattr(raw_drive, f"{stream}_rinex_parts")]
    rinex = epochs(stream, decoded(stream, "rinex", b"".join(lines), near_ns))
    assert len(binary) == len(raw_drive.times_ns)
    assert (largest_difference(binary, rinex) <= resolution).all()


def test_how_a_stream_is_cut_makes_no_difference(raw_drive: RawDrive) -> None:
    near_ns = raw_drive.times_ns[0]
    streams: dict[Any, bytes] = {
        "ubx": b"".join(raw_drive.ubx_parts[:10]),
        "sbf": b"".join(raw_drive.sbf_parts[:10]),
        "mixed": b"".join(map(b"".join, zip(raw_drive.ubx_parts, raw_drive.rtcm_parts[:5], strict=False))),
        "rtcm": b"".join(raw_drive.rtcm_parts[:10]),
        "rinex": raw_drive.rover_header + b"".join(raw_drive.rover_rinex_parts[:10]),
    }
    for protocol, data in streams.items():
        whole = [repr_of(each) for each in decoded("rover", protocol, data, near_ns)]
        assert whole
        reader, pieces, random = StreamReader("rover", protocol, "here", near_ns), [], Random(3)
        while data:
            size = random.randint(1, 700)
            pieces += [repr_of(each) for each in reader.feed(data[:size])]
            data = data[size:]
        assert pieces == whole, protocol


def repr_of(received: tuple[str, Any]) -> str:
    whose, what = received
    epoch = isinstance(what, ObservationEpoch)
    return f"{whose} {what.time_ns} {table(what)}" if epoch else f"{whose} {what}"


def test_rtcm_in_a_receivers_mixed_stream_is_the_bases(raw_drive: RawDrive) -> None:
    data = b"".join(a + b for a, b in zip(raw_drive.rtcm_parts[:4], raw_drive.ubx_parts[:4], strict=True))
    received = decoded("rover", "mixed", data, raw_drive.times_ns[0])
    assert [epoch.time_ns for epoch in epochs("rover", received)] == raw_drive.times_ns[:4]
    assert [epoch.time_ns for epoch in epochs("base", received)] == raw_drive.times_ns[:4]
    stations = {(whose, what.label) for whose, what in received if isinstance(what, StationPosition)}
    assert stations == {("base", "rtcm-1")}
    # A receiver whose own observations come as RTCM says so with the protocol.
    receiver = decoded("rover", "rtcm", b"".join(raw_drive.rtcm_parts[:4]), raw_drive.times_ns[0])
    assert len(epochs("rover", receiver)) == 4


def test_navigation_files_come_one_after_another_with_the_last_record_and_the_ionosphere(
    raw_drive: RawDrive,
) -> None:
    reader = StreamReader("ephemerides", "rinex", "here", raw_drive.times_ns[0])
    feeds = reader.feed(raw_drive.navigation), reader.feed(raw_drive.navigation), reader.fell_silent()
    assert not [what for items in feeds for _, what in items if isinstance(what, FormatError)]
    first, second, third = (sum(isinstance(what, Ephemeris) for _, what in items) for items in feeds)
    # The last record is whole when another file begins, or nothing follows.
    assert (second, third) == (first + 1, 1)
    coefficients = [what for _, what in feeds[0] if isinstance(what, IonosphereCoefficients)]
    assert coefficients[-1].system == "G"
    assert coefficients[-1].alpha != (0.0, 0.0, 0.0, 0.0)
    assert reader.fell_silent() == []


def test_a_navigation_file_that_goes_on_after_a_silence_is_named(raw_drive: RawDrive) -> None:
    reader = StreamReader("ephemerides", "rinex", "here", raw_drive.times_ns[0])
    half = raw_drive.navigation.rindex(b"\n", 0, 5000) + 1
    reader.feed(raw_drive.navigation[:half])
    reader.fell_silent()
    ((_, error),) = reader.feed(raw_drive.navigation[half:])
    assert isinstance(error, FormatError)


def header(**changed: Any) -> bytes:
    lines = {
        "version": f"{'     3.04           OBSERVATION DATA    M':60}RINEX VERSION / TYPE",
        "position": f"{'  1000000.0000  2000000.0000  6000000.0000':60}APPROX POSITION XYZ",
        "delta": f"{'        1.5000        0.2000        0.1000':60}ANTENNA: DELTA H/E/N",
        "types": f"{'G    1 C1C':60}SYS / # / OBS TYPES",
        "time": f"{'  2026     3    20     1    30    0.0000000     GPS':60}TIME OF FIRST OBS",
        "end": f"{'':60}END OF HEADER",
    } | changed
    return "".join(f"{line}\n" for line in lines.values() if line).encode()


def test_the_antenna_of_a_rinex_file_is_offset_from_its_marker() -> None:
    ((whose, where),) = decoded("base", "rinex", header(), 0)
    assert whose == "base"
    assert isinstance(where, StationPosition)
    marker = np.array([1e6, 2e6, 6e6])
    offset = np.array(where.position_ecef_m) - marker
    latitude = np.arctan2(6e6, np.hypot(1e6, 2e6))  # geocentric: 0.2° off, and so 5 mm of 1.5 m
    up, east = np.array([np.cos(latitude), 0.0, np.sin(latitude)]), np.array([-2.0, 1.0, 0.0]) / np.sqrt(5.0)
    up[:2] = up[0] * np.array([1.0, 2.0]) / np.sqrt(5.0)
    north = np.cross(up, east)
    assert offset == pytest.approx(1.5 * up + 0.2 * east + 0.1 * north, abs=0.01)


def test_a_rinex_file_calls_its_station_by_the_marker() -> None:
    ((_, named),) = decoded("base", "rinex", header(delta=f"{'NAGOYA 1':60}MARKER NAME"), 0)
    ((_, unnamed),) = decoded("base", "rinex", header(), 0)
    assert (named.label, unnamed.label) == ("rinex-NAGOYA 1", "rinex-unnamed")


def test_without_a_delta_the_antenna_is_the_marker_and_without_a_marker_nowhere() -> None:
    ((_, where),) = decoded("base", "rinex", header(delta=""), 0)
    assert where.position_ecef_m == pytest.approx((1e6, 2e6, 6e6), abs=1e-6)
    assert decoded("base", "rinex", header(position=""), 0) == []
    # The earth's centre is how files say that they do not know.
    nowhere = f"{'        0.0000        0.0000        0.0000':60}APPROX POSITION XYZ"
    assert decoded("base", "rinex", header(position=nowhere), 0) == []


def test_damage_is_counted_by_what_was_the_matter(raw_drive: RawDrive) -> None:
    reader = StreamReader("rover", "ubx", "here", raw_drive.times_ns[0])
    reader.feed(raw_drive.ubx_parts[0])
    assert reader.damage() == {}
    damaged = bytearray(raw_drive.ubx_parts[1])
    damaged[100] ^= 1
    reader.feed(b"noise" + bytes(damaged))
    counted = reader.damage()
    assert counted["failed_checks"] == 1
    assert counted["bytes_skipped"] > 5
    rtcm = StreamReader("base", "rtcm", "here", raw_drive.times_ns[0])
    frames = raw_drive.frames(1)
    rtcm.feed(b"".join([*frames[:-1], *raw_drive.frames(2)]))
    assert rtcm.damage() == {"incomplete": 1}


@pytest.mark.parametrize("protocol", ["pos", "nmea", "ubx", "rtcm", "mixed", "rinex"])
@pytest.mark.parametrize("stream", ["rover", "base", "ephemerides"])
def test_no_bytes_raise_anything(stream: Any, protocol: Any, raw_drive: RawDrive) -> None:
    random = Random(17)
    good = raw_drive.ubx_parts[0] + raw_drive.rtcm_parts[0] + raw_drive.rover_header
    good += raw_drive.navigation[:4000]
    for _ in range(10):
        data = bytearray(good)
        for _ in range(40):
            place = random.randrange(len(data))
            data[place : place + random.randrange(4)] = random.randbytes(random.randrange(4))
        reader = StreamReader(stream, protocol, "here", raw_drive.times_ns[0])
        reader.feed(bytes(data))
        reader.fell_silent()
        assert all(count > 0 for count in reader.damage().values())

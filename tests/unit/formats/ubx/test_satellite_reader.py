"""NAV-SAT: the values of pyubx2 for recordings, unknown values, and blocks that are damaged, repeated or late."""

from __future__ import annotations

import io
import math
import struct
from random import Random

import pytest
from pyubx2 import UBXReader

from camber.formats.observations import satellite_name
from camber.formats.receiver.satellite_report import SatelliteReport
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ubx.nav_writer import format_position_velocity_time
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.satellite_reader import read_satellites
from camber.formats.ubx.writer import ubx_frame
from support.gnss_files import recording
from support.random_observations import SECOND_NS, WEEK_NS

TOW_MS = 345_600_000
START_NS = 2300 * WEEK_NS + TOW_MS * 1_000_000
GPS, SBAS, GALILEO, BEIDOU, IMES, QZSS, GLONASS, NAVIC = range(8)
EPHEMERIS, ALMANAC = 1, 2


def flags(*, quality: int = 7, used: bool = True, health: int = 1, orbit: int = EPHEMERIS) -> int:
    return quality | used << 3 | health << 4 | orbit << 8


def block(
    gnss: int = GPS, number: int = 5, cn0: int = 40, elevation: int = 30, azimuth: int = 120, **how: int
) -> bytes:
    return struct.pack("<BBBbhhI", gnss, number, cn0, elevation, azimuth, 7, flags(**how))


def payload(*blocks: bytes, of_week_ms: int = TOW_MS, version: int = 1, count: int | None = None) -> bytes:
    number = len(blocks) if count is None else count
    return struct.pack("<IBB2x", of_week_ms, version, number) + b"".join(blocks)


def sat(*blocks: bytes, seconds: int = 0) -> bytes:
    return ubx_frame(0x01, 0x35, payload(*blocks, of_week_ms=TOW_MS + 1000 * seconds))


def pvt(seconds: int = 0, fix_type: int | None = None) -> bytes:
    solution = ReceiverSolution(
        time_ns=START_NS + seconds * SECOND_NS,
        latitude_rad=0.6,
        longitude_rad=2.4,
        height_m=50.0,
        quality=SolutionQuality.FIX,
    )
    frame = format_position_velocity_time(solution, geoid_separation_m=30.0)
    if fix_type is None:
        return frame
    content = bytearray(frame[6:-2])
    content[20] = fix_type
    return ubx_frame(0x01, 0x07, bytes(content))


def eoe(seconds: int = 0) -> bytes:
    return ubx_frame(0x01, 0x61, struct.pack("<I", TOW_MS + 1000 * seconds))


def reports(*frames: bytes) -> tuple[list[SatelliteReport], UbxDecoder]:
    decoder = UbxDecoder("port", START_NS)
    results = [result for frame in frames for result in decoder.feed(frame)] + decoder.finish()
    return [result for result in results if isinstance(result, SatelliteReport)], decoder


def name_and_use(*blocks: bytes) -> list[tuple[str, str]]:
    return [(satellite_name(row.satellite), row.use) for row in read_satellites(payload(*blocks)).satellites]


def test_values_of_a_satellite() -> None:
    (row,) = read_satellites(payload(block())).satellites
    assert satellite_name(row.satellite) == "G05"
    assert row.direction_rad == (math.radians(120), math.radians(30))
    assert (row.cn0_dbhz, row.use) == (40.0, "used")


@pytest.mark.parametrize(
    ("gnss", "number", "name"),
    [
        (GPS, 32, "G32"), (SBAS, 120, "S20"), (SBAS, 158, "S58"), (GALILEO, 36, "E36"),
        (BEIDOU, 63, "C63"), (QZSS, 1, "J01"), (GLONASS, 24, "R24"), (NAVIC, 14, "I14"),
        (GLONASS, 255, None), (SBAS, 119, None), (IMES, 1, None), (GPS, 0, None), (200, 1, None),
    ],
)  # fmt: skip
def test_satellites_without_a_number_are_left_out_and_counted(
    gnss: int, number: int, name: str | None
) -> None:
    read = read_satellites(payload(block(gnss, number)))
    assert [satellite_name(row.satellite) for row in read.satellites] == ([] if name is None else [name])
    assert (read.unknown, read.repeated) == (name is None, 0)


@pytest.mark.parametrize(
    ("elevation", "azimuth", "known"),
    [(-91, 0, False), (91, 10, False), (-90, 0, True), (90, 360, True), (30, -1, False), (30, 361, False)],
)
def test_a_direction_that_is_none_is_unknown(elevation: int, azimuth: int, known: bool) -> None:
    (row,) = read_satellites(payload(block(elevation=elevation, azimuth=azimuth))).satellites
    assert (row.direction_rad is not None) == known
    assert row.cn0_dbhz == 40.0


def test_a_cn0_of_zero_is_unknown() -> None:
    (row,) = read_satellites(payload(block(cn0=0, quality=1, used=False))).satellites
    assert (row.cn0_dbhz, row.use) == (None, "no_pseudorange")


@pytest.mark.parametrize(
    ("how", "use"),
    [
        ({"used": True, "quality": 0, "health": 2}, "used"),
        ({"used": False, "quality": 3}, "no_pseudorange"),
        ({"used": False, "quality": 4, "health": 2, "orbit": ALMANAC}, "unhealthy"),
        ({"used": False, "health": 0, "orbit": ALMANAC}, "no_ephemeris"),
        ({"used": False, "orbit": 0}, "no_ephemeris"),
        ({"used": False, "health": 0, "orbit": 4}, "reason_not_reported"),
    ],
)
def test_the_use_is_what_the_receiver_reports(how: dict[str, int], use: str) -> None:
    assert name_and_use(block(**how)) == [("G05", use)]


def test_of_repeated_satellites_the_first_counts() -> None:
    read = read_satellites(payload(block(), block(cn0=9, used=False), block(GALILEO)))
    assert [(satellite_name(row.satellite), row.cn0_dbhz) for row in read.satellites] == [
        ("G05", 40.0),
        ("E05", 40.0),
    ]
    assert (read.unknown, read.repeated) == (0, 1)


@pytest.mark.parametrize(
    "content",
    [
        b"", payload()[:7], payload(version=0), payload(block(), version=2), payload(block())[:-1],
        payload(block()) + b"\0", payload(block(), count=2), payload(block(), block(), count=1),
        payload(*300 * [block()], count=300 & 255),
    ],
)  # fmt: skip
def test_a_message_that_contradicts_itself_is_refused_whole(content: bytes) -> None:
    with pytest.raises(ValueError, match="NAV-SAT"):
        read_satellites(content)


def test_255_satellites_are_read() -> None:
    everything = [(gnss, number) for gnss in range(8) for number in range(1, 33)][:255]
    read = read_satellites(payload(*(block(gnss, number) for gnss, number in everything)))
    assert len(read.satellites) + read.unknown == 255
    assert len({row.satellite for row in read.satellites}) == len(read.satellites) > 100


def test_the_satellites_of_an_epoch_have_its_time_and_quality() -> None:
    for frames in ([pvt(), sat(block()), eoe()], [sat(block()), pvt()]):
        (report,), decoder = reports(*frames)
        assert (report.time_ns, report.quality) == (START_NS, SolutionQuality.FIX)
        assert len(report.satellites) == 1
        assert (decoder.messages.malformed, decoder.messages.late) == (0, 0)
    (report,), _ = reports(pvt(fix_type=0), sat(block()), eoe())
    assert report.quality is None


def test_without_nav_pvt_of_the_same_epoch_there_is_no_report() -> None:
    assert reports(sat(block()), eoe())[0] == []
    assert reports(pvt(0), sat(block(), seconds=1), pvt(2))[0] == []


def test_late_satellites_do_not_end_the_epoch_and_are_counted() -> None:
    late = sat(block(), seconds=1)
    plain = UbxDecoder("port", START_NS)
    expected = plain.feed(pvt(1) + eoe(1) + pvt(2) + eoe(2))
    for frames in (
        [pvt(1), eoe(1), late, pvt(2), eoe(2)],
        [pvt(1), eoe(1), pvt(2), late, eoe(2)],
        [pvt(1), eoe(1), pvt(2), eoe(2), late],
    ):
        decoder = UbxDecoder("port", START_NS)
        assert decoder.feed(b"".join(frames)) + decoder.finish() == expected
        assert decoder.messages.late == 1


def test_a_malformed_message_costs_itself_only() -> None:
    damaged = ubx_frame(0x01, 0x35, payload(block(), count=9))
    decoded, decoder = reports(pvt(), damaged, eoe())
    assert decoded == []
    assert decoder.messages.malformed == 1
    decoded, decoder = reports(pvt(), damaged, sat(block(), block()), sat(block(QZSS), block(QZSS)), eoe())
    # Of several messages of one epoch the last counts.
    assert [satellite_name(row.satellite) for report in decoded for row in report.satellites] == ["J05"]
    assert decoder.messages.repeated_signals == 1


def test_random_content_never_raises_and_invents_nothing() -> None:
    random = Random(35)
    for _ in range(300):
        count = random.randrange(40)
        content = payload(*(random.randbytes(12) for _ in range(count)))
        read = read_satellites(content)
        assert len(read.satellites) + read.unknown + read.repeated == count
        for row in read.satellites:
            assert row.direction_rad is None or abs(row.direction_rad[1]) <= math.pi / 2


# ------------------------------------------------------------------------------------------------------- recordings


@pytest.mark.parametrize("name", ["NAV", "NAV-ZED-X20P", "MIXED"])
def test_recorded_satellites_equal_those_of_pyubx2(name: str) -> None:
    data = recording(f"receiver-logs/ubx-pygpsdata-{name}.log").read_bytes()
    decoded, decoder = reports(data)
    parsed = [message for _, message in UBXReader(io.BytesIO(data), protfilter=2, quitonerror=0) if message]
    # By iTOW: the recording of the X20P holds one message twice.
    oracle = {message.payload[:4]: message for message in parsed if message.identity == "NAV-SAT"}
    assert len(decoded) == len(oracle)
    letters = "GSEC?JRI"
    for report, message in zip(decoded, oracle.values(), strict=True):
        assert len(report.satellites) == message.numSvs
        for k, row in enumerate(report.satellites, 1):
            values = {
                key: getattr(message, f"{key}_{k:02d}")
                for key in ("gnssId", "svId", "cno", "elev", "azim", "svUsed", "qualityInd", "health")
            }
            number = values["svId"] - 100 * (values["gnssId"] == SBAS)
            assert satellite_name(row.satellite) == f"{letters[values['gnssId']]}{number:02d}"
            assert row.cn0_dbhz == (values["cno"] or None)
            assert row.direction_rad == (math.radians(values["azim"]), math.radians(values["elev"]))
            assert (row.use == "used") == bool(values["svUsed"])
            assert (row.use == "unhealthy") <= (values["health"] == 2)
            if row.use == "no_pseudorange":
                assert values["qualityInd"] < 4
    assert (decoder.messages.malformed, decoder.messages.late, decoder.messages.repeated_signals) == (0, 0, 0)

"""The fuzzed decoders: a new one is one more entry in DECODERS."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial, reduce
from operator import xor
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
import zstandard

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.drive.message_json import from_json, to_json
from camber.formats.errors import FormatError
from camber.formats.foxglove.point_clouds import cloud_from_sweep, sweep_from_cloud
from camber.formats.lidar_can.candump import CandumpDecoder, CanFrame, candump_text
from camber.formats.lidar_can.dbc import read_dbc
from camber.formats.lidar_can.firings import LidarDecoder
from camber.formats.lidar_can.ouster import OusterDecoder
from camber.formats.lidar_can.ouster_metadata import read_ouster_metadata
from camber.formats.lidar_can.pcap import Datagram, PcapDecoder, pcap_frames, pcap_header
from camber.formats.lidar_can.velodyne import MODELS, VelodyneDecoder
from camber.formats.map_exchange.lanelet2 import lanelet_map
from camber.formats.map_exchange.map_projector import map_projector
from camber.formats.map_exchange.opendrive import opendrive_map
from camber.formats.map_exchange.pcd import PointCloud, cloud_from_pcd, pcd_bytes
from camber.formats.map_exchange.ply import points_from_ply
from camber.formats.map_exchange.pmtiles import PmtilesFile, PmtilesWriter, first_number
from camber.formats.map_exchange.projection import Projection
from camber.formats.map_exchange.vertical_datum import vertical_datum
from camber.formats.nmea.epochs import NmeaDecoder
from camber.formats.nmea.writer import format_gga, format_gst, format_rmc
from camber.formats.receiver.mixed_stream import MixedDecoder
from camber.formats.receiver.rtklib_pos import PosDecoder, format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.rinex.navigation_reader import NavigationDecoder
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rinex.writer import StationHeader, navigation_text, observation_lines
from camber.formats.ros.message_types import message_types
from camber.formats.ros.point_cloud2 import POINT_CLOUD2, point_cloud2, point_layout, sweep_from_point_cloud2
from camber.formats.rtcm.reader import RtcmDecoder
from camber.formats.rtcm.writer import (
    format_ephemeris,
    format_observations,
    format_reference_station,
    rtcm_frame,
)
from camber.formats.sbf.reader import SbfDecoder
from camber.formats.ubx.nav_writer import format_high_precision_position, format_position_velocity_time
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.subframe_schedule import subframes_between
from camber.formats.ubx.writer import format_raw_measurements, format_subframe, ubx_frame
from camber.geodesy.gps_time import NS_PER_DAY, UNIX_OF_GPS_EPOCH_NS, week_tow_from_gps_ns
from camber.map_server.elevation_queries import ElevationMap
from camber.map_update.admission import Refusal
from camber.map_update.queue.queue_messages import (
    QueuedContribution,
    QueueMessageError,
    pack_contributions,
    pack_outcomes,
    unpack_contributions,
    unpack_outcomes,
)
from camber.map_update.stores.store import Outcome
from camber.replay.short_drive import write_short_drive
from camber.road_map.blob_delta import compress_blob, decompress_blob
from camber.road_map.release import read_release
from camber.road_map.release_files import decoded
from camber.road_map.road_columns import ReleaseError
from camber.road_map.road_tiles import surface_tiles
from camber.road_map.tile_checks import tile_defect
from camber.road_map.tile_grid import tile_frame
from camber.schemas.codec import DecodeError, decode, encode, unpack
from camber.schemas.lidar import Sweep
from camber.schemas.road import CloudTile, LinkTile, SurfaceTile
from camber.sensors.imu_reader import ImuReader
from camber.sensors.lidar_reader import LidarReader
from camber.sensors.sensor_clock import SensorClock, TimeScale
from camber.simulator.output.can_frames import DBC
from camber.simulator.output.lidar_packets import PATTERNS, ouster_metadata, ouster_packets, velodyne_packets
from camber.tools.maps.importers.checks.left_out import LeftOutLanes
from camber.tools.maps.importers.lane_map import LaneSurvey, road_map
from camber.tools.maps.importers.lanelets import lanes_of as lanes_of_lanelets
from camber.tools.maps.importers.opendrive_roads import LANE_TYPES
from camber.tools.maps.importers.opendrive_roads import lanes_of as lanes_of_roads
from fuzz.target import Target
from support import lanelet_maps, opendrive_maps
from support.contributions import contribution, random_batch
from support.glonass_messages import (
    glonass_navigation_text,
    glonass_strings,
    message_1020,
    random_glonass_ephemeris,
    string_message,
)
from support.lanelet_maps import lanelet2_bytes
from support.messages import build, message_classes
from support.opendrive_maps import opendrive_bytes
from support.random_msm import any_msm
from support.random_observations import COMMON, WEEK_NS, random_ephemeris, random_epoch
from support.rinex2_writer import Epoch2, labelled, navigation_text_2, observation_text_2, types_lines
from support.ros_bags import LIVOX, MAKERS, livox_bytes, point_cloud2_bytes
from support.sbf_blocks import (
    END_OF_PVT,
    GAL_AUTH_STATUS,
    GPS_ION,
    POS_COV_GEODETIC,
    PVT_GEODETIC,
    Tracked,
    ephemeris_block,
    glonass_block,
    meas_epoch,
    rf_status,
    sbf_block,
    sbf_frame,
)
from support.small_map import surface, surfaces

START_NS = 1_400_000_000 * 1_000_000_000
STEP_NS = 200_000_000
TOE_NS = START_NS // WEEK_NS * WEEK_NS + 7200 * 1_000_000_000
GPS_MINUS_BDT_NS = 14 * 1_000_000_000


def _rtcm(random: Random) -> list[list[bytes]]:
    rng = np.random.default_rng(random.getrandbits(32))
    streams = []
    for _ in range(8):
        station = random.randrange(4096)
        frames = [format_reference_station((-3.8e6, 3.5e6, 3.7e6), station_id=station, antenna_height_m=1.5)]
        for number in range(3):
            epoch = random_epoch(rng, START_NS + number * STEP_NS)
            frames += format_observations(epoch, station_id=station)
            name = random.choice(("G05", "E11", "J02", "C19"))
            toe_ns = TOE_NS + (GPS_MINUS_BDT_NS if name == "C19" else 0)
            frames += format_ephemeris(random_ephemeris(rng, name, toe_ns))
        frames += [any_msm(rng, 1084 + number) for number in range(4)]
        frames += [message_1020(random_glonass_ephemeris(rng, number, START_NS)) for number in (3, 24)]
        streams.append([frame[3:-3] for frame in frames])
    return streams


def _solutions(random: Random) -> list[ReceiverSolution]:
    return [
        ReceiverSolution(
            time_ns=START_NS + number * STEP_NS,
            latitude_rad=random.uniform(-1.5, 1.5),
            longitude_rad=random.uniform(-math.pi, math.pi),
            height_m=random.uniform(-100.0, 4000.0),
            quality=random.choice(list(SolutionQuality)[:5]),
            satellites=random.randrange(40),
            covariance_enu_m2=(4e-4, 1e-5, 0.0, 4e-4, 0.0, 1e-3),
            age_s=random.uniform(0.0, 9.0),
            ratio=random.uniform(1.0, 99.0),
            velocity_enu_m_s=(random.gauss(0.0, 9.0), random.gauss(0.0, 9.0), 0.1),
            velocity_covariance_enu_m2_s2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4),
        )
        for number in range(8)
    ]


def _nmea(random: Random) -> list[list[bytes]]:
    kinds = (format_rmc, partial(format_gga, geoid_separation_m=37.5), format_gst)
    return [
        [
            part
            for one in _solutions(random)
            for part in (*(kind(one)[1:-5] for kind in kinds), *_date_and_raim(one), *_satellites(random))
        ]
        for _ in range(8)
    ]


def _date_and_raim(solution: ReceiverSolution) -> list[bytes]:
    at = format_rmc(solution).split(b",")[1]
    return [b"GPZDA,%b,12,07,2023,00,00" % at, b"GNGBS,%b,1.6,1.4,3.2,03,,-21.4,3.8,1,0" % at]


def _satellites(random: Random) -> list[bytes]:
    """GSA of all systems, of which one may be full, and groups of GSV by talker and signal."""
    numbers = [",".join(str(random.randrange(1, 97)) for _ in range(12)), ",".join(["07", "11", *[""] * 10])]
    contents = [f"GNGSA,A,3,{random.choice(numbers)},1.7,0.9,1.5,{system}" for system in range(1, 6)]
    for talker, signal in (("GP", "1"), ("GP", "6"), ("GL", "0"), ("GA", "7"), ("GB", ""), ("GN", "A")):
        for part in (1, 2):
            rows = ",".join(
                f"{random.randrange(1, 400)},{random.choice(('', '45'))},120,{random.choice(('', '33'))}"
                for _ in range(random.randrange(1, 5))
            )
            contents.append(f"{talker}GSV,2,{part},08,{rows},{signal}")
    return [content.encode() for content in contents]


def _nmea_sentence(content: bytes) -> bytes:
    return b"$%b*%02X\r\n" % (content, reduce(xor, content, 0))


def _ubx(random: Random) -> list[list[bytes]]:
    """Class, id and payload of each message: measurements, subframes, NAV epochs, integrity reports."""
    rng = np.random.default_rng(random.getrandbits(32))
    known = {
        system: {k: v for k, v in COMMON[system].items() if k in "1C 2L 5Q 7Q 2I 7I"} for system in "GEJC"
    }
    streams = []
    for solutions in (_solutions(random) for _ in range(8)):
        frames = []
        for name in ("G05", "E11", "J02", "C19", "C03"):
            toe_ns = TOE_NS + (GPS_MINUS_BDT_NS if name[0] == "C" else 0)
            ephemeris = random_ephemeris(rng, name, toe_ns)
            # As satellites send it: IODC and IODE identify the parts of one issue.
            issue = {"iodc": float(ephemeris.iode)} if name[0] in "GJ" else {}
            ephemeris = replace(ephemeris, other={**ephemeris.other, **issue})
            # Two periods, of which one is complete for any start.
            parts = subframes_between(ephemeris, TOE_NS, TOE_NS + 60_000_000_000)
            frames += [format_subframe(part) for part in parts]
        glonass = random_glonass_ephemeris(rng, 7, START_NS)
        frames += [string_message(string, glonass) for string in glonass_strings(glonass)]
        frames.append(ubx_frame(0x02, 0x15, _glonass_measurements(random)))
        for solution in solutions:
            epoch = random_epoch(rng, solution.time_ns, carriers=known)
            frames += [format_raw_measurements(epoch), *_navigation_epoch(random, solution)]
        streams.append([frame[2:4] + frame[6:-2] for frame in frames])
    return streams


def _glonass_measurements(random: Random) -> bytes:
    """The payload of an RXM-RAWX with GLONASS alone, which the encoder leaves out."""
    week, of_week_ns = week_tow_from_gps_ns(START_NS)
    head = struct.pack("<dHbBBB2x", of_week_ns / 1e9, week, 18, 8, 1, 1)
    rows = (
        struct.pack(
            "<ddfBBBBHBBBBBx",
            2.1e7,
            1.1e8,
            -900.0,
            6,
            number,
            random.choice((0, 2)),
            number,
            5000,
            45,
            5,
            2,
            3,
            7,
        )
        for number in range(1, 9)
    )
    return head + b"".join(rows)


def _navigation_epoch(random: Random, solution: ReceiverSolution) -> list[bytes]:
    of_week = struct.pack("<I", week_tow_from_gps_ns(solution.time_ns)[1] // 1_000_000)
    covariance = struct.pack("<6f", 4e-4, 1e-5, 0.0, 4e-4, 0.0, 1e-3)
    blocks = b"".join(
        bytes([random.randrange(8), random.randrange(1, 40)]) + random.randbytes(10) for _ in range(20)
    )
    levels = struct.pack("<3I", *(random.randrange(60_000) for _ in range(3)))
    return [
        format_position_velocity_time(solution, geoid_separation_m=37.5),
        format_high_precision_position(solution, geoid_separation_m=37.5),
        ubx_frame(0x01, 0x35, of_week + bytes([1, 20, 0, 0]) + blocks),
        ubx_frame(0x01, 0x36, of_week + bytes([0, 1, 1]) + bytes(9) + 2 * covariance),
        ubx_frame(0x01, 0x3C, bytes([1, 0, 7, 0]) + of_week + random.randbytes(52) + b"\x37\x01\x00\x00"),
        ubx_frame(0x01, 0x62, bytes([1, 5, 253, 1, 1, 0, 0, 0, *bytes(4)]) + of_week + levels + bytes(24)),
        ubx_frame(0x27, 0x09, bytes([1, 0, 0, 0, 0b011, 0, 0, 0, 0b0011, 0, 0, 0])),
        ubx_frame(0x0A, 0x38, bytes([0, 2, 0, 0]) + random.randbytes(48)),
        ubx_frame(0x01, 0x61, of_week),
    ]


def _sbf(random: Random) -> list[list[bytes]]:
    """Number and body of each block: measurements, ephemerides, positions, integrity reports."""
    rng = np.random.default_rng(random.getrandbits(32))
    streams = []
    for solutions in (_solutions(random) for _ in range(8)):
        frames = [
            ephemeris_block(
                random_ephemeris(rng, name, TOE_NS + (GPS_MINUS_BDT_NS if name[0] == "C" else 0)), TOE_NS
            )
            for name in ("E11", "C19", "C45")
        ]
        frames.append(glonass_block(random_glonass_ephemeris(rng, 8, TOE_NS), TOE_NS))
        for solution in solutions:
            frames += [
                meas_epoch(solution.time_ns, _tracked_satellites(random)),
                *_pvt_blocks(random, solution),
            ]
        streams.append([frame[4:6] + frame[8:] for frame in frames])
    return streams


def _tracked_satellites(random: Random) -> dict[int, list[Tracked]]:
    """Of several systems, each with up to three signals."""

    def signal(number: int, code_mm: int) -> Tracked:
        phase, doppler = random.randrange(-8_000_000, 8_000_000), random.randrange(-900_000, 900_000)
        return Tracked(signal=number, code_mm=code_mm, phase_mcycles=phase, doppler_tmhz=doppler)

    numbers = {5: (0, 2, 3), 81: (17, 20, 21), 45: (8, 11), 150: (28, 30, 34), 182: (6, 32)}
    return {
        svid: [signal(number, 0 if k else 22_000_000_000) for k, number in enumerate(signals)]
        for svid, signals in numbers.items()
    }


def _pvt_blocks(random: Random, solution: ReceiverSolution) -> list[bytes]:
    time_ns, covariance = solution.time_ns, {"Cov_latlat": 4e-4, "Cov_lonlon": 4e-4, "Cov_hgthgt": 1e-3}
    position = {
        "Latitude": solution.latitude_rad,
        "Longitude": solution.longitude_rad,
        "Height": solution.height_m,
    }
    masks = {"GalActiveMask": random.getrandbits(36), "GalAuthenticMask": random.getrandbits(36)}
    return [
        sbf_block(PVT_GEODETIC, time_ns, Mode=random.choice((1, 4, 5)), NrSV=20, AlertFlag=1, **position),
        sbf_block(POS_COV_GEODETIC, time_ns, Mode=4, **covariance),
        rf_status(time_ns, [(1_575_420_000, 100, random.randrange(16))], flags=random.randrange(4)),
        sbf_block(GAL_AUTH_STATUS, time_ns, OSNMAStatus=6, **masks),
        sbf_block(GPS_ION, time_ns, PRN=5, alpha_0=2.0**-30, beta_0=2.0**11),
        sbf_block(END_OF_PVT, time_ns),
    ]


def _sbf_block(content: bytes) -> bytes:
    number = int.from_bytes(content[:2], "little")
    return sbf_frame(number & 0x1FFF, content[2:], revision=number >> 13)


def _ubx_message(content: bytes) -> bytes:
    if len(content) < 2:
        raise ValueError("no class and id")
    return ubx_frame(content[0], content[1], content[2:])


_SEALS = (_ubx_message, _nmea_sentence, rtcm_frame, _sbf_block)


def _mixed(random: Random) -> list[list[bytes]]:
    """The number of the protocol precedes each content."""
    streams = []
    for several in zip(_ubx(random), _nmea(random), _rtcm(random), _sbf(random), strict=True):
        contents = [bytes([kind]) + part for kind, parts in enumerate(several) for part in parts]
        random.shuffle(contents)
        streams.append(contents)
    return streams


def _mixed_frame(content: bytes) -> bytes:
    return _SEALS[content[0] % len(_SEALS)](content[1:]) if content else b""


def _pos(random: Random) -> list[list[bytes]]:
    return [
        [
            format_pos_header(velocity=velocity),
            *(format_pos_line(solution, velocity=velocity) for solution in _solutions(random)),
        ]
        for velocity in (False, True)
    ]


def _rinex(random: Random) -> list[list[bytes]]:
    """Header, epochs, and an event with header lines, in versions 3 (with times in UTC, too) and 2."""
    rng = np.random.default_rng(random.getrandbits(32))
    station = StationHeader(marker="FUZZ", position_ecef_m=(-3.8e6, 3.5e6, 3.7e6))
    files = []
    for satellites in (2, 4, 12):
        epochs = [random_epoch(rng, START_NS + k * STEP_NS, satellites=satellites) for k in range(4)]
        parts = list(observation_lines(epochs, station))
        parts.insert(3, f">{'':30}4  2\n{'':60}COMMENT\n{'EVENT':<60}MARKER NAME\n")
        files.append([part.encode() for part in parts])
    in_utc = [part.replace(b"GPS         TIME OF", b"GLO         TIME OF") for part in files[0]]
    return [
        *files,
        in_utc,
        *(_rinex_2(random, types) for types in (("C1", "L1"), ("C1", "P1", "L1", "C2", "P2", "L2", "S1"))),
    ]


def _rinex_2(random: Random, types: tuple[str, ...]) -> list[bytes]:
    """A file by line, with an event that names its types again, and comments."""
    satellites = {
        f"{random.choice('GER')}{n:2d}": dict.fromkeys(types, (20000000.0 + n, "1", "5"))
        for n in range(1, 15)
    }
    epochs = [
        Epoch2(time_ns=START_NS + k * STEP_NS, satellites=satellites, flag=flag)
        for k, flag in enumerate((0, 1, 6))
    ]
    event = Epoch2(
        time_ns=START_NS, satellites={}, flag=4, lines=[labelled("", "COMMENT"), *types_lines(types)]
    )
    text = observation_text_2([epochs[0], event, *epochs[1:]], types)
    return [line.encode() for line in text.splitlines(keepends=True)]


def _rinex_navigation(random: Random) -> list[list[bytes]]:
    """As RINEX 3 and 2, line by line, and as RINEX 4, record by record."""
    rng = np.random.default_rng(random.getrandbits(32))
    messages = {"G05": "LNAV", "E11": "INAV", "J02": "LNAV"}
    text = navigation_text(
        [random_ephemeris(rng, name, START_NS // WEEK_NS * WEEK_NS) for name in messages],
        [IonosphereCoefficients(system=system, alpha=(1e-8,) * 4, beta=(1e5,) * 4) for system in "GJC"],
    )
    lines = text.splitlines(keepends=True)
    begin = next(k for k, line in enumerate(lines, 1) if "END OF HEADER" in line)
    head = "".join(lines[:begin]).replace("3.04", "4.02")
    records = ["".join(lines[k : k + 8]) for k in range(begin, len(lines), 8)]
    announced = [f"> EPH {record[:3]} {messages[record[:3]]}\n{record}" for record in records]
    ephemerides = [random_ephemeris(rng, f"G{n:02d}", START_NS // WEEK_NS * WEEK_NS) for n in (1, 32)]
    klobuchar = IonosphereCoefficients(system="G", alpha=(1e-8,) * 4, beta=(1e5,) * 4)
    old = navigation_text_2(ephemerides, klobuchar).splitlines(keepends=True)
    glonass = [random_glonass_ephemeris(rng, number, START_NS) for number in (1, 24)]
    of_glonass = [glonass_navigation_text(glonass, v).splitlines(keepends=True) for v in (2.11, 3.04, 3.05)]
    return [[part.encode() for part in parts] for parts in (lines, (head, *announced), old, *of_glonass)]


def _messages(random: Random) -> list[list[bytes]]:
    return [
        [encode(build(cls, random, filled=filled), source="fuzz", sequence=random.getrandbits(40))]
        for cls in message_classes()
        for filled in (False, True)
    ]


def _read_message(data: bytes) -> None:
    classes = message_classes()
    named = [cls for cls in classes if cls.schema_name().encode() in data[:100]]
    decode(named[0] if named else classes[len(data) % len(classes)], data)


def _recorded(random: Random) -> list[list[bytes]]:
    return [
        [cls.schema_name().encode(), b" ", to_json(unpack(data).fields, cls)]
        for cls in message_classes()
        for data in (encode(build(cls, random, filled=True)),)
    ]


def _read_recorded(data: bytes) -> None:
    name, _, text = data.partition(b" ")
    classes = message_classes()
    named = [cls for cls in classes if cls.schema_name().encode() == name]
    from_json(named[0] if named else classes[len(data) % len(classes)], text)


def _clouds(random: Random) -> list[list[bytes]]:
    return [[cloud_from_sweep(build(Sweep, random, filled=filled))] for filled in (False, True)]


def _random_sweep(random: Random) -> Sweep:
    rng = np.random.default_rng(random.getrandbits(32))
    return Sweep(
        time_ns=1_400_000_000 * 10**9,
        sensor="lidar",
        points_m=rng.normal(0.0, 20.0, (20, 3)).astype(np.float32),
        intensity=rng.random(20, np.float32),
        offset_ns=1000 * np.arange(-19, 1, dtype=np.int32),
    )


def _point_clouds(random: Random) -> list[list[bytes]]:
    sweep = _random_sweep(random)
    return [[point_cloud2_bytes(sweep, maker, big_endian=big)] for maker in MAKERS for big in (False, True)]


def _livox_sweeps(random: Random) -> list[list[bytes]]:
    return [[livox_bytes(_random_sweep(random))]]


def _read_point_cloud(data: bytes, kind: str) -> None:
    try:
        message = message_types().deserialize_cdr(data, kind)
    except Exception as error:  # as `camber.formats.ros.bag_reader`
        raise FormatError("fuzz", "message", f"a {kind}") from error
    cloud = point_cloud2(message, kind)
    sweep_from_point_cloud2(cloud, point_layout(cloud, "fuzz"), "fuzz", "lidar")


def _pcd(random: Random) -> list[list[bytes]]:
    rng = np.random.default_rng(random.getrandbits(32))
    points = rng.normal(0.0, 20.0, (20, 3)).astype(np.float32)
    intensity, offset = rng.random(20, np.float32), -np.arange(20, dtype=np.int32)
    binary = pcd_bytes(PointCloud(points_m=points, intensity=intensity, offset_ns=offset))
    header, body = binary.split(b"DATA binary\n")
    rows = np.frombuffer(body, np.uint8).reshape(20, -1, 4)
    columns = np.swapaxes(rows, 0, 1).tobytes()
    parts = [columns[at : at + 32] for at in range(0, len(columns), 32)]
    literal = b"".join(bytes([len(part) - 1]) + part for part in parts)  # LZF that repeats nothing
    sizes = len(literal).to_bytes(4, "little") + len(columns).to_bytes(4, "little")
    text = "".join(
        f"{x} {y} {z} {i} {t}\n" for (x, y, z), i, t in zip(points, intensity, offset, strict=True)
    )
    return [
        [pcd_bytes(PointCloud(points_m=points))],
        [binary],
        [header + b"DATA binary_compressed\n" + sizes + literal],
        [header + b"DATA ascii\n" + text.encode()],
    ]


def _ply(random: Random) -> list[list[bytes]]:
    rng = np.random.default_rng(random.getrandbits(32))
    points = rng.normal(0.0, 20.0, (20, 3))
    head = (
        "ply\nformat {} 1.0\nelement camera 1\nproperty uchar n\nelement vertex 20\nproperty short s\n"
        + "".join(f"property double {axis}\n" for axis in "xyz")
    )
    rows = [b"1 %f %f %f\n" % tuple(point) for point in points]
    files = [[(head.format("ascii") + "end_header\n").encode(), b"7\n", *rows]]
    for name, sign in (("binary_little_endian", "<"), ("binary_big_endian", ">")):
        rows = np.zeros(20, np.dtype([("s", f"{sign}i2"), ("xyz", f"{sign}f8", 3)]))
        rows["xyz"] = points
        files.append([(head.format(name) + "end_header\n").encode(), b"\7" + rows.tobytes()])
    return files


_TILES = (SurfaceTile, LinkTile, CloudTile)


def _tiles(random: Random) -> list[list[bytes]]:
    with TemporaryDirectory() as folder:
        write_short_drive(Path(folder))
        release = read_release(Path(folder) / "map")
        roads = [
            blob
            for layer in ("surfaces", "links")
            for tile in release.tiles(layer)[:4]
            if (blob := release.blob(layer, *tile)) is not None
        ]
    return [[blob] for blob in roads] + [[encode(build(CloudTile, random, filled=True))]]


def _archives(random: Random) -> list[list[bytes]]:
    seeds = []
    for count in (1, 40):
        stream = io.BytesIO()
        writer = PmtilesWriter(stream)
        for number in sorted(random.sample(range(4**3), count)):
            writer.add(first_number(3) + number, random.randbytes(20))
        writer.finish({"name": "fuzz"}, zooms=(3, 3), bounds_deg=(-180.0, -85.0, 180.0, 85.0))
        seeds.append([stream.getvalue()])
    return seeds


def _read_archive(data: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fuzz.pmtiles"
        path.write_bytes(data)
        file = PmtilesFile(path)
        for x in range(8):
            file.tile(3, x, 7 - x)


def _read_tile(data: bytes) -> None:
    """Check a tile as a release and the map server do, without the hash, which detects any damage."""
    named = [cls for cls in _TILES if cls.schema_name().encode() in data[:100]]
    tile = decoded((named or _TILES)[0], data, "tile")
    wrong = tile_defect(tile)
    if wrong is not None:
        raise ReleaseError("tile", *wrong)
    surfaces, links = (
        (lambda x, y, of=cls: tile if isinstance(tile, of) and (x, y) == (tile.x, tile.y) else None)
        for cls in (SurfaceTile, LinkTile)
    )
    roads = ElevationMap(surfaces, links, datum="WGS84", map_version=1)
    frame = tile_frame(tile.x, tile.y)
    roads.road_around(frame.latitude_rad, frame.longitude_rad, 5.0, (), None)


@cache
def _older_blob() -> bytes:
    rows = [surface(k, 2.0 * k, heights_m=50.0 + np.arange(18).reshape(6, 3) / 100) for k in range(20)]
    return encode(surface_tiles(surfaces(rows))[0])


def _newer_blobs(random: Random) -> list[bytes]:
    """The older tile with other heights and σ of some surfaces: by the same at all nodes, and by node."""
    tile = decode(SurfaceTile, _older_blob()).message
    blobs = []
    for bent in (0, 1):
        grid_m, sigma_m = tile.grid_m.copy(), tile.sigma_m.copy()
        for row in random.sample(range(len(tile.rows)), 4):
            nodes = slice(tile.first_height[row], tile.first_height[row] + tile.rows[row] * tile.columns[row])
            grid_m[nodes] = np.round(grid_m[nodes] + 0.05 + 0.01 * bent * np.arange(18) % 3, 4)
            sigma_m[row] = 0.01
        blobs.append(encode(tile.model_copy(update={"grid_m": grid_m, "sigma_m": sigma_m})))
    return blobs


def _packed(random: Random) -> list[list[bytes]]:
    newer = _newer_blobs(random)
    differences = [compress_blob(blob, _older_blob()) for blob in newer]
    return [[blob] for blob in (*differences, compress_blob(newer[0]), compress_blob(b"other", b"others"))]


def _packed_numbers(random: Random) -> list[list[bytes]]:
    """What is inside a difference of surfaces."""
    small = [compress_blob(blob, _older_blob()) for blob in _newer_blobs(random)]
    return [[zstandard.decompress(each[1:])] for each in small if each[:1] == b"s"]


_KNOWN = LaneSurvey(sigma_m=0.05, link_sigma_m=0.5, seen_ns=START_NS)
_FLAT_EARTH = Projection(lambda x, y: (np.clip(1e-7 * y, -1.4, 1.4), np.clip(1e-7 * x, -3.0, 3.0)), None)


def _lanelets(random: Random) -> list[list[bytes]]:
    """Lanelets of a synthetic town with a few points each, by XML element."""
    town = lanelet_maps.town()
    few = [
        replace(each, left=each.left[::12] + each.left[-1:], right=each.right[::15] + each.right[-1:])
        for each in town.lanelets
    ]
    used = {ref for lanelet in few for ref in lanelet.left + lanelet.right}
    rows = {ref: row for ref, row in town.row_of.items() if ref in used}
    text = lanelet2_bytes(replace(town, row_of=rows, lanelets=random.sample(few, 2)))
    return [text.splitlines(keepends=True)]


def _projectors(random: Random) -> list[list[bytes]]:
    """Projector files of Autoware, by line."""
    origin = "map_origin:\n  latitude: 35.6762 # [deg]\n  longitude: 139.6503\n  altitude: 0.0\n"
    parts = {
        "MGRS": "mgrs_grid: 54SUE\n",
        "LocalCartesianUTM": origin,
        "LocalCartesian": origin,
        "TransverseMercator": f"{origin}scale_factor: {random.uniform(0.99, 1.01)}\n",
    }
    text = "projector_type: {}\nvertical_datum: WGS84\n{}"
    return [text.format(*part).encode().splitlines(keepends=True) for part in parts.items()]


def _read_lanelets(data: bytes) -> None:
    """As `camber map build` does."""
    parsed = lanelet_map(data, "fuzz", strict=False)
    if parsed.lanelets:
        frame, lanes = lanes_of_lanelets(parsed, parsed.height_m)
        road_map(lanes, frame, _KNOWN, "fuzz", left_out=LeftOutLanes(strict=False))


def _drives(random: Random) -> list[list[bytes]]:
    """The shorter roads of a synthetic town, by XML element."""
    town = opendrive_maps.town()
    return [
        opendrive_bytes(replace(town, roads=[road])).splitlines(keepends=True)
        for road in (town.roads[2], town.roads[3])
    ]


def _read_drive(data: bytes) -> None:
    """As `camber map build` does, without the projection of PROJ."""
    drive, left_out = opendrive_map(data, "fuzz", strict=False), LeftOutLanes(strict=False)
    if sum(road.length_m for road in drive.roads) < 2_000.0:  # long roads only take time
        ellipsoidal = vertical_datum("ellipsoidal", "WGS84", "fuzz")
        frame, lanes = lanes_of_roads(
            drive, _FLAT_EARTH, ellipsoidal, types=frozenset(LANE_TYPES), file="fuzz", left_out=left_out
        )
        road_map(lanes, frame, _KNOWN, "fuzz", left_out=left_out)


def _queue(random: Random) -> list[list[bytes]]:
    rng = np.random.default_rng(random.getrandbits(32))
    refusal = Refusal("datum", "datum Tokyo, expected WGS84")
    parcels = [
        QueuedContribution(random_batch("b1", 5, rng), None),
        QueuedContribution(contribution("u1"), refusal),
    ]
    return [[pack_contributions("_INBOX.a.1", parcels)], [pack_contributions("_INBOX.a.2", parcels[:1])]]


def _queue_answers(_: Random) -> list[list[bytes]]:
    outcomes = [Outcome("stored"), Outcome("duplicate"), Outcome("refused", Refusal("datum", "datum Tokyo"))]
    return [[pack_outcomes(outcomes)], [pack_outcomes(outcomes[:1])]]


def _pcap(random: Random) -> list[list[bytes]]:
    def frames(k: int) -> bytes:
        payload = random.randbytes(random.choice((9, 1206, 4000)))
        datagram = Datagram(time_ns=START_NS + k, source="10.0.0.7", port=2368, payload=payload)
        return pcap_frames(datagram, "10.0.0.1", k)

    return [[pcap_header(), *map(frames, range(6))] for _ in range(4)]


def _candump(random: Random) -> list[list[bytes]]:
    def line() -> bytes:
        data, identifier = random.randbytes(random.choice((0, 3, 8, 64))), random.randrange(1 << 11)
        extended = random.random() < 0.5
        return candump_text(
            [CanFrame(time_ns=START_NS, bus="can0", identifier=identifier, extended=extended, data=data)]
        ).encode()

    return [[line() for _ in range(12)] for _ in range(4)]


def _dbc(_: Random) -> list[list[bytes]]:
    return [[line.encode() for line in DBC.splitlines(keepends=True)]]


def _read_dbc(data: bytes) -> None:
    """As `camber sensors` does, and its signals out of a frame."""
    for message in read_dbc(data.decode("cp1252", "replace"), "fuzz").values():
        for signal in message.signals.values():
            signal.raw(bytes(message.length_bytes))
            signal.raw(b"\xff")


@cache
def _sweeps(kind: str) -> tuple[Sweep, ...]:
    """Of few points, in two turns."""
    pattern = PATTERNS[kind]
    rows = np.arange(0, pattern.rays, 997)
    points = (10.0 * pattern.directions()[rows]).astype(np.float32)
    points[:, 2] += pattern.rises_m()[rows]
    return tuple(
        Sweep(
            time_ns=START_NS + turn * pattern.turn_ns,
            sensor="fuzz",
            points_m=points,
            intensity=np.full(len(rows), 7.0, np.float32),
            offset_ns=pattern.offsets_ns()[rows].astype(np.int32),
        )
        for turn in (1, 2)
    )


def _packets(kind: str) -> Callable[[Random], list[list[bytes]]]:
    """Each before it has its length."""

    def made(_: Random) -> list[list[bytes]]:
        packets = velodyne_packets if kind == "velodyne" else ouster_packets
        payloads = [payload for _, payload in packets(_sweeps(kind))]
        return [payloads[k : k + 6] for k in (0, 20, 60)]

    return made


def _imu_packets(random: Random) -> list[list[bytes]]:
    stamp_ns = START_NS + UNIX_OF_GPS_EPOCH_NS + 19 * 1_000_000_000  # TAI
    return [
        [
            struct.pack("<3Q6f", k, stamp_ns + k, stamp_ns + k, *(random.gauss(0.0, 1.0) for _ in range(6)))
            for k in range(6)
        ]
    ]


def _read_imu_packets(data: bytes) -> None:
    reader, payloads = ImuReader(np.eye(3), SensorClock("tai", 0, NS_PER_DAY)), _payloads(data)
    for sample in reader.take(payloads, [START_NS] * len(payloads), ["fuzz"] * len(payloads)):
        encode(sample)


def _with_length(content: bytes) -> bytes:
    return len(content).to_bytes(4, "little") + content


def _payloads(data: bytes) -> list[bytes]:
    payloads = []
    while len(data) >= 4:
        length = int.from_bytes(data[:4], "little")
        payloads.append(data[4 : 4 + length])
        data = data[4 + length :]
    return payloads


@cache
def _lidar_decoder(kind: str) -> LidarDecoder:
    if kind == "velodyne":
        return VelodyneDecoder(MODELS["HDL-32E"])
    return OusterDecoder(read_ouster_metadata(ouster_metadata(), "fuzz"))


def _read_packets(kind: str) -> Callable[[bytes], None]:
    """As `camber sensors` does, all at their time."""
    scale: TimeScale = "utc_hour" if kind == "velodyne" else "tai"

    def read(data: bytes) -> None:
        reader = LidarReader("fuzz", _lidar_decoder(kind), SensorClock(scale, 0, NS_PER_DAY), 0.001)
        payloads = _payloads(data)
        arrivals = [START_NS + k * 1_000_000 for k in range(len(payloads))]
        for sweep in reader.take(payloads, arrivals) + reader.finish():
            encode(sweep)

    return read


def _metadata(_: Random) -> list[list[bytes]]:
    return [[line.encode() for line in ouster_metadata().splitlines(keepends=True)]]


DECODERS: tuple[Target, ...] = (
    Target("rtcm", _rtcm, stream=lambda: RtcmDecoder(START_NS), sealed=rtcm_frame),
    Target("nmea", _nmea, stream=lambda: NmeaDecoder("fuzz"), sealed=_nmea_sentence),
    Target("ubx", _ubx, stream=lambda: UbxDecoder("fuzz", START_NS), sealed=_ubx_message),
    Target("sbf", _sbf, stream=lambda: SbfDecoder("fuzz"), sealed=_sbf_block),
    Target("mixed", _mixed, stream=lambda: MixedDecoder("fuzz", START_NS), sealed=_mixed_frame),
    Target("pos", _pos, stream=lambda: PosDecoder("fuzz")),
    Target("rinex", _rinex, stream=lambda: RinexDecoder("fuzz")),
    Target("rinex_navigation", _rinex_navigation, stream=lambda: NavigationDecoder("fuzz")),
    Target("messages", _messages, read=_read_message, refusal=DecodeError),
    Target("recorded_messages", _recorded, read=_read_recorded, refusal=DecodeError),
    Target("recorded_sweeps", _clouds, read=sweep_from_cloud, refusal=DecodeError),
    Target(
        "point_cloud2",
        _point_clouds,
        read=partial(_read_point_cloud, kind=POINT_CLOUD2),
        refusal=FormatError,
    ),
    Target("livox_custom", _livox_sweeps, read=partial(_read_point_cloud, kind=LIVOX), refusal=FormatError),
    Target("pcd", _pcd, read=lambda data: cloud_from_pcd(data, "fuzz"), refusal=FormatError),
    Target("pmtiles", _archives, read=_read_archive, refusal=FormatError),
    Target("map_projector", _projectors, read=lambda data: map_projector(data, "fuzz"), refusal=FormatError),
    Target("lanelet2", _lanelets, read=_read_lanelets, refusal=FormatError),
    Target("opendrive", _drives, read=_read_drive, refusal=FormatError),
    Target("ply", _ply, read=lambda data: points_from_ply(data, "fuzz"), refusal=FormatError),
    Target("map_tiles", _tiles, read=_read_tile, refusal=ReleaseError),
    Target(
        "map_delta", _packed, read=lambda data: decompress_blob(data, _older_blob()), refusal=ReleaseError
    ),
    Target(
        "map_delta_numbers",
        _packed_numbers,
        read=lambda data: decompress_blob(data, _older_blob()),
        refusal=ReleaseError,
        sealed=lambda data: b"s" + zstandard.compress(data),
    ),
    Target("pcap", _pcap, stream=lambda: PcapDecoder("fuzz")),
    Target("candump", _candump, stream=lambda: CandumpDecoder("fuzz")),
    Target("dbc", _dbc, read=_read_dbc, refusal=FormatError),
    Target("velodyne", _packets("velodyne"), read=_read_packets("velodyne"), sealed=_with_length),
    Target("ouster", _packets("ouster"), read=_read_packets("ouster"), sealed=_with_length),
    Target("ouster_imu", _imu_packets, read=_read_imu_packets, sealed=_with_length),
    Target(
        "ouster_metadata",
        _metadata,
        read=lambda data: read_ouster_metadata(data.decode("utf-8", "replace"), "fuzz"),
        refusal=FormatError,
    ),
    Target("queue", _queue, read=unpack_contributions, refusal=QueueMessageError),
    Target("queue_answers", _queue_answers, read=unpack_outcomes, refusal=QueueMessageError),
)

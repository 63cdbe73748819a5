"""RTCM frames, the base station and ephemerides: published frames byte by byte, others decoded by pyrtcm."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import RTCMReader
from pyrtcm.rtcmtypes_core import RTCM_DATA_FIELDS

from camber.formats.broadcast.bit_fields import crc24q, pack_bits, pack_columns, quantize
from camber.formats.rtcm.ephemeris_messages import EPHEMERIS_MESSAGES
from camber.formats.rtcm.reader import ReferenceStation, RtcmDecoder
from camber.formats.rtcm.writer import format_ephemeris, format_reference_station, rtcm_frame
from support.random_observations import SECOND_NS, WEEK_NS, random_ephemeris, random_toe_ns

# RTCM 10403, 4.2, the example of a frame.
STANDARD_1005 = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")


def crc_bit_by_bit(data: bytes) -> int:
    crc = 0
    for byte in data:
        for place in range(7, -1, -1):
            out = crc >> 23 ^ byte >> place & 1
            crc = (crc << 1 & 0xFFFFFF) ^ (0x864CFB if out & 1 else 0)
    return crc


def test_frame_printed_in_the_standard_is_reproduced():
    frame = format_reference_station(
        (1114104.5999, -4850729.7108, 3975521.4643), station_id=2003, systems="G", single_oscillator=False
    )
    assert frame == STANDARD_1005


def test_crc_of_the_catalogue():
    # The catalogue of parametrised CRCs: polynomial 0x864CFB, start 0: check value of "123456789".
    assert crc24q(b"123456789") == 0xCDE703
    assert crc24q(b"") == 0


@given(st.binary(max_size=1029))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_crc_equals_bitwise_division(data):
    assert crc24q(data) == crc_bit_by_bit(data)


def test_too_long_payload_is_refused():
    assert len(rtcm_frame(b"\x00" * 1023)) == 1029
    with pytest.raises(ValueError, match="1024 bytes, expected at most 1023"):
        rtcm_frame(b"\x00" * 1024)


COORDINATE = st.floats(-13_743_895.0, 13_743_895.0)


@given(COORDINATE, COORDINATE, COORDINATE, st.integers(0, 4095), st.none() | st.floats(0.0, 6.5535))
@settings(derandomize=True, max_examples=100)
def test_reference_station_is_read_back_and_by_pyrtcm(x, y, z, station_id, height):
    frame = format_reference_station((x, y, z), station_id=station_id, antenna_height_m=height)
    message = RTCMReader.parse(frame)
    assert message.identity == ("1005" if height is None else "1006")
    assert station_id == message.DF003
    assert (message.DF022, message.DF023, message.DF024, message.DF141) == (1, 0, 1, 0)
    for decoded, given_ in ((message.DF025, x), (message.DF026, y), (message.DF027, z)):
        assert decoded == pytest.approx(given_, abs=0.5001e-4)
    near_height = None if height is None else pytest.approx(height, abs=0.5001e-4)
    assert height is None or near_height == message.DF028
    assert RtcmDecoder(0).feed(frame) == [
        ReferenceStation(
            station_id=station_id,
            position_ecef_m=pytest.approx((x, y, z), abs=0.5001e-4),
            antenna_height_m=near_height,
        )
    ]


@pytest.mark.parametrize("height", [None, 1.5])
def test_a_virtual_station_is_read_as_one_also_by_pyrtcm(height):
    frame = format_reference_station((1.0, -2.0, 3.0), station_id=7, antenna_height_m=height)
    payload = bytearray(frame[3:-3])
    payload[33 // 8] |= 0x80 >> 33 % 8  # DF141, after message and station number (24), year (6), systems (3)
    virtual = rtcm_frame(bytes(payload))
    assert RTCMReader.parse(virtual).DF141 == 1
    (station,) = RtcmDecoder(0).feed(virtual)
    assert station.is_virtual
    assert station.position_ecef_m == pytest.approx((1.0, -2.0, 3.0))


def test_station_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"reference station y \[m\] is 1.4e\+07, expected -1.37439e\+07"):
        format_reference_station((0.0, 1.4e7, 0.0), station_id=1)
    with pytest.raises(ValueError, match=r"antenna height \[m\] is 7, expected 0 to 6.5535"):
        format_reference_station((0.0, 0.0, 0.0), station_id=1, antenna_height_m=7.0)
    with pytest.raises(ValueError, match="station id is 4096"):
        format_reference_station((0.0, 0.0, 0.0), station_id=4096)
    with pytest.raises(ValueError, match="is nan"):
        format_reference_station((math.nan, 0.0, 0.0), station_id=1)


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(-(2**39), 2**39)), min_size=1, max_size=40))
@settings(derandomize=True, max_examples=100)
def test_packed_columns_equal_packed_fields(fields):
    bits, width = pack_bits([(value, width) for width, value in fields])
    expected = (bits << -width % 8).to_bytes((width + 7) // 8, "big")
    assert pack_columns((), [(np.array([value]), width) for width, value in fields]) == expected


@given(st.floats(allow_nan=True), st.integers(2, 32), st.booleans())
@settings(derandomize=True, max_examples=200)
def test_a_quantised_value_is_within_half_a_step_or_refused(value, width, signed):
    low, high = (-(2 ** (width - 1)), 2 ** (width - 1) - 1) if signed else (0, 2**width - 1)
    # A value that is half a step outside is still rounded in.
    if (low - 0.5) * 0.25 <= value <= (high + 0.5) * 0.25:
        decoded = quantize("x", value, 0.25, width, signed=signed)
        assert abs(decoded * 0.25 - value) <= 0.125
        assert low <= decoded <= high
    else:
        with pytest.raises(ValueError, match="x is "):
            quantize("x", value, 0.25, width, signed=signed)


# The data fields of each message, by the standard's numbers; pyrtcm's own table gives the resolutions.
ORBIT = (
    *("crs_m", "mean_motion_difference_rad_s", "mean_anomaly_rad", "cuc", "eccentricity", "cus", "sqrt_a"),
    *("toe", "cic", "ascending_node_rad", "cis", "inclination_rad", "crc_m", "perigee_rad"),
    "ascending_node_rate_rad_s",
)


def numbers(toc: int, orbit: int, **more: int) -> dict[str, int]:
    """Data fields of a message: toc, af2, af1, af0 in a row, then the orbit."""
    clock = {"toc": toc, "af2": toc + 1, "af1": toc + 2, "af0": toc + 3}
    return clock | {name: orbit + k for k, name in enumerate(ORBIT)} | more


NUMBERS = {
    "1019": numbers(81, 86, inclination_rate_rad_s=79, tgd_s=101, iodc=85, iode=71, health=102),
    "1042": numbers(
        493, 498, inclination_rate_rad_s=491, tgd1_s=513, tgd2_s=514, aodc=497, iode=492, health=515
    ),
    "1044": numbers(430, 435, inclination_rate_rad_s=450, tgd_s=455, iodc=456, iode=434, health=454),
    "1045": numbers(293, 297, inclination_rate_rad_s=292, bgd_e5a_s=312, iode=290),
    "1046": numbers(293, 297, inclination_rate_rad_s=292, bgd_e5a_s=312, bgd_e5b_s=313, iode=290),
}
TIMES = ("toe", "toc")
SATELLITE_AND_WEEK = {"1019": (9, 76), "1042": (488, 489), "1044": (429, 452)}
SATELLITE_AND_WEEK |= {"1045": (252, 289), "1046": (252, 289)}
WEEKS = {
    "1019": (0, 1024),
    "1044": (0, 1024),
    "1042": (1356, 8192),
    "1045": (1024, 4096),
    "1046": (1024, 4096),
}
NAMES = st.sampled_from(
    ["G01", "G32", "G63", "J01", "J07", "J10", "E01", "E36", "E50", "C01", "C19", "C60", "C63"]
)


@given(st.integers(0, 2**32), NAMES, st.integers(1400, 3900))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_pyrtcm_decodes_ephemerides_within_the_resolution(seed, name, week):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, name, random_toe_ns(rng, name, week))
    frames = format_ephemeris(ephemeris)
    expected = {"G": ["1019"], "C": ["1042"], "J": ["1044"], "E": ["1045", "1046"]}[name[0]]
    assert [RTCMReader.parse(frame).identity for frame in frames] == expected
    offset_ns = 14 * SECOND_NS if name[0] == "C" else 0
    values = dict(zip(("af0", "af1", "af2"), ephemeris.clock, strict=True)) | ephemeris.other
    values["toe"] = (ephemeris.toe_ns - offset_ns) % WEEK_NS / SECOND_NS
    values["toc"] = (ephemeris.toc_ns - offset_ns) % WEEK_NS / SECOND_NS
    for frame in frames:
        message = RTCMReader.parse(frame)
        kind = message.identity
        satellite, its_week = (getattr(message, f"DF{number:03d}") for number in SATELLITE_AND_WEEK[kind])
        first, weeks = WEEKS[kind]
        assert satellite == ephemeris.satellite & 255
        assert its_week == ((ephemeris.toe_ns - offset_ns) // WEEK_NS - first) % weeks
        for field, number in NUMBERS[kind].items():
            _, bits, step, _ = RTCM_DATA_FIELDS[f"DF{number:03d}"]
            decoded = getattr(message, f"DF{number:03d}")
            wanted = values.get(field, getattr(ephemeris, field, None))
            step = step or 1
            if field.startswith("tgd") and kind == "1042":
                decoded, step = decoded * 1e-9, 0.1e-9
            if field.endswith(("rad", "rad_s")):
                wanted = wanted / math.pi
                if field in ("ascending_node_rad", "perigee_rad", "mean_anomaly_rad"):
                    wanted = decoded + math.remainder(wanted - decoded, 2.0)
            tolerance = 0.0 if field in TIMES else 0.5 * step * (1.0 + 1e-6)
            assert abs(decoded - wanted) <= tolerance, (kind, field, bits)


def at_week_2300(name: str, seed: int = 1, **changes):
    ephemeris = random_ephemeris(
        np.random.default_rng(seed), name, 2300 * WEEK_NS + 14 * SECOND_NS * (name[0] == "C")
    )
    return replace(ephemeris, **changes)


@pytest.mark.parametrize(
    ("name", "number", "cases"),
    [
        ("G05", 77, ((0.0, 0), (2.0, 0), (2.4, 0), (2.8, 1), (4.0, 2), (6144.0, 14), (7000.0, 15), (math.nan, 15))),
        ("C21", 490, ((2.0, 0), (-1.0, 15))),
        ("J02", 453, ((16.0, 6), (2.5, 1))),
        ("E11", 291, ((0.0, 0), (0.49, 49), (0.5, 50), (1.0, 75), (3.12, 107), (6.0, 125), (6.1, 255), (-1.0, 255))),
    ],
)  # fmt: skip
def test_accuracy_index_never_claims_better_accuracy(name, number, cases):
    for accuracy_m, index in cases:
        message = RTCMReader.parse(format_ephemeris(at_week_2300(name, accuracy_m=accuracy_m))[0])
        assert getattr(message, f"DF{number:03d}") == index


def test_galileo_health_is_unpacked_as_in_rinex():
    # E5b: health 2, data valid; E5a: health 1, invalid; E1-B: health 3, invalid.
    ephemeris = at_week_2300("E05", health=0b10_0_01_1_11_1)
    fnav, inav = (RTCMReader.parse(frame) for frame in format_ephemeris(ephemeris))
    assert (fnav.DF314, fnav.DF315) == (1, 1)
    assert (inav.DF316, inav.DF317, inav.DF287, inav.DF288) == (2, 0, 3, 1)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("G05", {"cuc": 1.0}, r"G05 cuc is 1, expected -6.10352e-05 to 6.10333e-05"),
        ("C05", {"crs_m": 5e3}, "C05 crs_m is 5000, expected -2048 to 2047.98"),
        ("G05", {"iode": 256}, "G05 iode is 256, expected 0 to 255"),
        ("E05", {"health": 512}, "E05: health is 512, expected 0 to 511"),
        ("G05", {"eccentricity": math.nan}, "G05 eccentricity is nan"),
        ("G05", {"mean_anomaly_rad": math.inf}, "G05 mean_anomaly_rad is inf"),
        (
            "G05",
            {"toe_ns": 2300 * WEEK_NS + SECOND_NS},
            "G05: toe_s is 1.0 s of the week, expected a multiple of 16 s",
        ),
        ("E05", {"toc_ns": 2300 * WEEK_NS + 30 * SECOND_NS}, "expected a multiple of 60 s"),
        ("J05", {"other": {"iodc": 1.0}}, "J05: the ephemeris has no tgd_s"),
        ("G05", {"satellite": ord("R") * 256 + 5}, "satellite R05: no broadcast ephemeris"),
        ("G05", {"satellite": ord("J") * 256 + 11}, "satellite J11: no broadcast ephemeris"),
    ],
)
def test_ephemeris_out_of_range_is_refused(name, changes, message):
    with pytest.raises(ValueError, match=message):
        format_ephemeris(at_week_2300(name, 3, **changes))


def test_ephemeris_messages_have_the_standard_length():
    lengths = {1019: 488, 1042: 511, 1044: 485, 1045: 496, 1046: 504}
    for name in ("G05", "C25", "J02", "E07"):
        for frame in format_ephemeris(at_week_2300(name)):
            number = int(RTCMReader.parse(frame).identity)
            assert len(frame) - 6 == -(-lengths.pop(number) // 8)
    assert not lengths
    assert set(EPHEMERIS_MESSAGES) == {1019, 1042, 1044, 1045, 1046}

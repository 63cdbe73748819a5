"""Subframes decoded by independent decoders of the interface specifications, and recorded words of a receiver."""

import math
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader

from camber.formats.broadcast.gps_lnav import add_parity
from camber.formats.ubx.subframe_schedule import subframes_between
from camber.formats.ubx.writer import format_subframe
from camber.geodesy.gps_time import gps_minus_utc_s
from support.random_observations import SECOND_NS, WEEK_NS, random_ephemeris

PI = math.pi
# RXM-SFRBX of a ZED-F9 receiver, G05, 2020: the example in the tests of pyubx2 (BSD).
RECEIVED = (
    *(583028782, 2463198336, 394902765, 2566867280, 1062207503),
    *(675481840, 616371498, 2740700967, 768066377, 3045061856),
)
WEEKS = st.integers(1400, 3900)
SEEDS = st.integers(0, 2**32)


def signed(value: int, width: int) -> int:
    return value - (1 << width) if value >> (width - 1) else value


def joined_bits(words, width, *pieces) -> int:
    """Pieces (first bit from 1 over all words of `width` bits, bits) side by side."""
    everything = 0
    for word in words:
        everything = everything << width | word & (1 << width) - 1
    total = len(words) * width
    value = 0
    for first, bits in pieces:
        value = value << bits | everything >> (total - first + 1 - bits) & (1 << bits) - 1
    return value


# --- GPS, QZSS: IS-GPS-200, 20.3.3 and 20.3.5 -------------------------------------------------------------------------


def lnav_data(words):
    """24 data bits of each word, after undoing the receiver's inversion and checking parity, equation by equation."""
    data, d29, d30 = [], 0, 0
    for word in words:
        as_sent = word ^ 0xFFFFFFFF if d30 else word
        assert as_sent >> 30 == d29 << 1 | d30
        sent = [as_sent >> 29 - k & 1 for k in range(30)]
        # Table 20-XIV: d1 … d24, a zero before them so that indices are the document's.
        d = [0, *(bit ^ d30 for bit in sent[:24])]
        check = (
            sum((d29, *(d[k] for k in (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23)))) % 2,
            sum((d30, *(d[k] for k in (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24)))) % 2,
            sum((d29, *(d[k] for k in (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22)))) % 2,
            sum((d30, *(d[k] for k in (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23)))) % 2,
            sum((d30, *(d[k] for k in (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24)))) % 2,
            sum((d29, *(d[k] for k in (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24)))) % 2,
        )
        assert tuple(sent[24:]) == check
        data.append(sum(bit << 24 - k for k, bit in enumerate(d) if k))
        d29, d30 = sent[28:]
    # The words that are solved for end in zeros: 20.3.5.2.
    assert d29 == d30 == 0
    return data


def test_recorded_words_are_reproduced():
    data = lnav_data(RECEIVED)
    assert data[0] >> 16 == 0x8B
    assert tuple(add_parity(data)) == RECEIVED


@given(st.lists(st.integers(0, 2**24 - 1), min_size=10, max_size=10))
@settings(derandomize=True, max_examples=200)
def test_parity_holds_for_any_data(data):
    decoded = lnav_data(add_parity(data))
    for place in range(10):
        solved = place in (1, 9)
        assert decoded[place] >> 2 * solved == data[place] >> 2 * solved


def lnav_values(data1, data2, data3):
    """Bits counted from 1 over the 240 data bits of a subframe."""

    def u(data, *pieces):
        return joined_bits(data, 24, *((24 * (word - 1) + bit, n) for word, bit, n in pieces))

    def s(data, *pieces):
        return signed(u(data, *pieces), sum(n for *_, n in pieces))

    return {
        "week": u(data1, (3, 1, 10)),
        "codes_on_l2": u(data1, (3, 11, 2)),
        "ura": u(data1, (3, 13, 4)),
        "health": u(data1, (3, 17, 6)),
        "iodc": u(data1, (3, 23, 2), (8, 1, 8)),
        "tgd_s": (s(data1, (7, 17, 8)), 2.0**-31),
        "toc": u(data1, (8, 9, 16)) * 16,
        "af2": (s(data1, (9, 1, 8)), 2.0**-55),
        "af1": (s(data1, (9, 9, 16)), 2.0**-43),
        "af0": (s(data1, (10, 1, 22)), 2.0**-31),
        "iode": u(data2, (3, 1, 8)),
        "crs_m": (s(data2, (3, 9, 16)), 2.0**-5),
        "mean_motion_difference_rad_s": (s(data2, (4, 1, 16)), 2.0**-43 * PI),
        "mean_anomaly_rad": (s(data2, (4, 17, 8), (5, 1, 24)), 2.0**-31 * PI),
        "cuc": (s(data2, (6, 1, 16)), 2.0**-29),
        "eccentricity": (u(data2, (6, 17, 8), (7, 1, 24)), 2.0**-33),
        "cus": (s(data2, (8, 1, 16)), 2.0**-29),
        "sqrt_a": (u(data2, (8, 17, 8), (9, 1, 24)), 2.0**-19),
        "toe": u(data2, (10, 1, 16)) * 16,
        "fit": u(data2, (10, 17, 1)),
        "cic": (s(data3, (3, 1, 16)), 2.0**-29),
        "ascending_node_rad": (s(data3, (3, 17, 8), (4, 1, 24)), 2.0**-31 * PI),
        "cis": (s(data3, (5, 1, 16)), 2.0**-29),
        "inclination_rad": (s(data3, (5, 17, 8), (6, 1, 24)), 2.0**-31 * PI),
        "crc_m": (s(data3, (7, 1, 16)), 2.0**-5),
        "perigee_rad": (s(data3, (7, 17, 8), (8, 1, 24)), 2.0**-31 * PI),
        "ascending_node_rate_rad_s": (s(data3, (9, 1, 24)), 2.0**-43 * PI),
        "iode3": u(data3, (10, 1, 8)),
        "inclination_rate_rad_s": (s(data3, (10, 9, 14)), 2.0**-43 * PI),
    }


def assert_within_resolution(decoded, ephemeris, count):
    """Compare `count` fields, each an integer and its resolution, with those of the ephemeris."""
    af0, af1, af2 = ephemeris.clock
    given_ = {"af0": af0, "af1": af1, "af2": af2, **ephemeris.other}
    scaled = {name: value for name, value in decoded.items() if isinstance(value, tuple)}
    assert len(scaled) == count
    for name, (integer, resolution) in scaled.items():
        wanted = given_.get(name, getattr(ephemeris, name, None))
        difference = integer * resolution - wanted
        if name in ("mean_anomaly_rad", "ascending_node_rad", "perigee_rad"):
            difference = math.remainder(difference, 2.0 * PI)
        assert abs(difference) <= 0.5 * resolution * (1.0 + 1e-6), name


def all_of(ephemeris, from_ns):
    """All messages of 30 s, parsed by pyubx2."""
    messages = []
    for subframe in subframes_between(ephemeris, from_ns, from_ns + 30 * SECOND_NS):
        message = UBXReader.parse(format_subframe(subframe))
        assert message.identity == "RXM-SFRBX"
        assert (message.version, message.chn) == (2, 0)
        assert message.svId == ephemeris.satellite & 255
        words = [getattr(message, f"dwrd_{k + 1:02d}") for k in range(message.numWords)]
        assert words == list(subframe.words)
        messages.append((subframe.end_ns, message, words))
    return messages


@given(SEEDS, st.sampled_from(["G01", "G17", "G32", "J01", "J10"]), WEEKS, st.sampled_from([0, 12, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_lnav_subframes_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    # The reference time is in the next week for the last second of this.
    toe_ns = (week + (second > 600_000)) * WEEK_NS + 7200 * SECOND_NS
    ephemeris = random_ephemeris(rng, name, toe_ns)
    messages = all_of(ephemeris, week * WEEK_NS + second * SECOND_NS)
    assert len(messages) == 3
    data = {}
    for end_ns, message, words in messages:
        assert (message.gnssId, message.sigId) == (0 if name[0] == "G" else 5, 0)
        subframe = lnav_data(words)
        assert subframe[0] >> 16 == 0x8B
        which = subframe[1] >> 2 & 7
        start_ns = end_ns - 6 * SECOND_NS
        assert start_ns % (30 * SECOND_NS) == (which - 1) * 6 * SECOND_NS
        assert subframe[1] >> 7 == end_ns % WEEK_NS // (6 * SECOND_NS)
        data[which] = subframe, start_ns
    decoded = lnav_values(*(data[k][0] for k in (1, 2, 3)))
    assert decoded["week"] == data[1][1] // WEEK_NS % 1024
    assert decoded["toe"] == ephemeris.toe_ns % WEEK_NS // SECOND_NS
    assert decoded["toc"] == ephemeris.toc_ns % WEEK_NS // SECOND_NS
    assert decoded["iode"] == decoded["iode3"] == ephemeris.iode
    assert decoded["iodc"] == ephemeris.other["iodc"]
    assert decoded["health"] == ephemeris.health
    assert decoded["fit"] == (ephemeris.other["fit_interval_h"] > (4.0 if name[0] == "G" else 2.0))
    assert_within_resolution(decoded, ephemeris, 19)


# --- Galileo: OS SIS ICD, 4.3 -----------------------------------------------------------------------------------------


def crc24q(bits: int, width: int) -> int:
    """Division by the generator polynomial of 5.1.9.4, bit by bit."""
    rest = bits << 24
    for place in range(width + 23, 23, -1):
        if rest >> place & 1:
            rest ^= 0x1864CFB << place - 24
    return rest


def inav_word(words):
    """The 128 data bits of a nominal page, its CRC checked."""
    even = joined_bits(words[:4], 32, (1, 120))
    odd = joined_bits(words[4:8], 32, (1, 120))
    assert even >> 118 == 0b00
    assert odd >> 118 == 0b10
    assert even & 63 == odd & 63 == 0
    # Even: 114 bits before the tail; odd: 82 bits, the CRC, eight bits and the tail.
    assert crc24q((even >> 6) << 82 | odd >> 38, 196) == odd >> 14 & 0xFFFFFF
    return (even >> 6 & (1 << 112) - 1) << 16 | odd >> 102 & 0xFFFF


@given(SEEDS, st.sampled_from(["E01", "E24", "E36"]), WEEKS, st.sampled_from([0, 13, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_inav_pages_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, name, week * WEEK_NS + 600 * SECOND_NS)
    pages = {}
    for end_ns, message, words in all_of(ephemeris, week * WEEK_NS + second * SECOND_NS):
        assert (message.gnssId, message.sigId, message.numWords) == (2, 1, 9)
        page = inav_word(words)
        pages[page >> 122] = page, end_ns - 2 * SECOND_NS
    # Table 38: the words of E1-B begin at these seconds of the subframe.
    seconds = {word: start % (30 * SECOND_NS) // SECOND_NS for word, (_, start) in pages.items()}
    assert seconds == {2: 1, 4: 3, 6: 5, 1: 21, 3: 23, 5: 25}

    def u(word, first, bits):
        return pages[word][0] >> 128 - first + 1 - bits & (1 << bits) - 1

    def s(word, first, bits):
        return signed(u(word, first, bits), bits)

    for word in (1, 2, 3, 4):
        assert u(word, 7, 10) == ephemeris.iode
    decoded = {
        "mean_anomaly_rad": (s(1, 31, 32), 2.0**-31 * PI),
        "eccentricity": (u(1, 63, 32), 2.0**-33),
        "sqrt_a": (u(1, 95, 32), 2.0**-19),
        "ascending_node_rad": (s(2, 17, 32), 2.0**-31 * PI),
        "inclination_rad": (s(2, 49, 32), 2.0**-31 * PI),
        "perigee_rad": (s(2, 81, 32), 2.0**-31 * PI),
        "inclination_rate_rad_s": (s(2, 113, 14), 2.0**-43 * PI),
        "ascending_node_rate_rad_s": (s(3, 17, 24), 2.0**-43 * PI),
        "mean_motion_difference_rad_s": (s(3, 41, 16), 2.0**-43 * PI),
        "cuc": (s(3, 57, 16), 2.0**-29),
        "cus": (s(3, 73, 16), 2.0**-29),
        "crc_m": (s(3, 89, 16), 2.0**-5),
        "crs_m": (s(3, 105, 16), 2.0**-5),
        "cic": (s(4, 23, 16), 2.0**-29),
        "cis": (s(4, 39, 16), 2.0**-29),
        "af0": (s(4, 69, 31), 2.0**-34),
        "af1": (s(4, 100, 21), 2.0**-46),
        "af2": (s(4, 121, 6), 2.0**-59),
        "bgd_e5a_s": (s(5, 48, 10), 2.0**-32),
        "bgd_e5b_s": (s(5, 58, 10), 2.0**-32),
    }
    assert_within_resolution(decoded, ephemeris, 20)
    assert u(1, 17, 14) * 60 == ephemeris.toe_ns % WEEK_NS // SECOND_NS
    assert u(4, 55, 14) * 60 == ephemeris.toc_ns % WEEK_NS // SECOND_NS
    assert u(4, 17, 6) == ephemeris.satellite & 255
    health = u(5, 73, 1), u(5, 70, 2), u(5, 72, 1), u(5, 68, 2)
    h = ephemeris.health
    assert health == (h & 1, h >> 1 & 3, h >> 6 & 1, h >> 7 & 3)
    start_ns = pages[5][1]
    assert u(5, 74, 12) == (start_ns // WEEK_NS - 1024) % 4096
    assert u(5, 86, 20) == start_ns % WEEK_NS // SECOND_NS
    # Word 6: A0, A1 are zero, GST is the leap seconds before UTC, now and announced.
    assert u(6, 7, 56) == 0
    assert u(6, 63, 8) == u(6, 98, 8) == gps_minus_utc_s(pages[6][1])
    assert u(6, 106, 20) == pages[6][1] % WEEK_NS // SECOND_NS


# --- BeiDou: BDS-SIS-ICD-B1I, 5.1, 5.2, 5.3 ---------------------------------------------------------------------------


def bch_is_right(code: int) -> bool:
    """A word of the code is a multiple of x⁴ + x + 1: its value at a root in GF(16) is zero."""
    powers = [1]
    for _ in range(14):
        doubled = powers[-1] << 1
        powers.append(doubled ^ 0b10011 if doubled & 16 else doubled)
    value = 0
    for place in range(15):
        if code >> place & 1:
            value ^= powers[place]
    return value == 0


def beidou_words_are_right(words) -> bool:
    assert all(word >> 30 == 0 for word in words)
    right = bch_is_right(words[0] & 0x7FFF)
    for word in words[1:]:
        first, second, checks = word >> 19, word >> 8 & 0x7FF, word & 0xFF
        right = right and bch_is_right(first << 4 | checks >> 4) and bch_is_right(second << 4 | checks & 15)
    return right


def beidou_reader(words):
    """u(...) and s(...) of pieces, bits of the 300 counted from 1 as in the figures of the document."""

    def u(*pieces):
        return joined_bits(words, 30, *pieces)

    def s(*pieces):
        return signed(u(*pieces), sum(n for _, n in pieces))

    return u, s


def assert_head(u, end_ns, length_ns, subframe):
    assert u((1, 11)) == 0b11100010010
    assert u((16, 3)) == subframe
    start_ns = end_ns - length_ns - 14 * SECOND_NS
    assert start_ns % SECOND_NS == 0
    assert u((19, 8), (31, 12)) == start_ns % WEEK_NS // SECOND_NS
    return start_ns


@given(SEEDS, st.sampled_from(["C06", "C27", "C46", "C58"]), WEEKS, st.sampled_from([0, 14, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_d1_subframes_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, name, week * WEEK_NS + (7200 + 14) * SECOND_NS)
    read = {}
    for end_ns, message, words in all_of(ephemeris, week * WEEK_NS + second * SECOND_NS):
        assert (message.gnssId, message.sigId, message.numWords) == (3, 0, 10)
        assert beidou_words_are_right(words)
        assert not beidou_words_are_right([words[0], words[1] ^ 1 << int(rng.integers(0, 30)), *words[2:]])
        u, s = beidou_reader(words)
        which = u((16, 3))
        start_ns = assert_head(u, end_ns, 6 * SECOND_NS, which)
        assert start_ns % (30 * SECOND_NS) == (which - 1) * 6 * SECOND_NS
        read[which] = u, s, start_ns
    (u1, s1, start_ns), (u2, s2, _), (u3, s3, _) = (read[k] for k in (1, 2, 3))
    decoded = {
        "tgd1_s": (s1((99, 10)), 1e-10),
        "tgd2_s": (s1((109, 4), (121, 6)), 1e-10),
        "af2": (s1((215, 11)), 2.0**-66),
        "af0": (s1((226, 7), (241, 17)), 2.0**-33),
        "af1": (s1((258, 5), (271, 17)), 2.0**-50),
        "mean_motion_difference_rad_s": (s2((43, 10), (61, 6)), 2.0**-43 * PI),
        "cuc": (s2((67, 16), (91, 2)), 2.0**-31),
        "mean_anomaly_rad": (s2((93, 20), (121, 12)), 2.0**-31 * PI),
        "eccentricity": (u2((133, 10), (151, 22)), 2.0**-33),
        "cus": (s2((181, 18)), 2.0**-31),
        "crc_m": (s2((199, 4), (211, 14)), 2.0**-6),
        "crs_m": (s2((225, 8), (241, 10)), 2.0**-6),
        "sqrt_a": (u2((251, 12), (271, 20)), 2.0**-19),
        "inclination_rad": (s3((66, 17), (91, 15)), 2.0**-31 * PI),
        "cic": (s3((106, 7), (121, 11)), 2.0**-31),
        "ascending_node_rate_rad_s": (s3((132, 11), (151, 13)), 2.0**-43 * PI),
        "cis": (s3((164, 9), (181, 9)), 2.0**-31),
        "inclination_rate_rad_s": (s3((190, 13), (211, 1)), 2.0**-43 * PI),
        "ascending_node_rad": (s3((212, 21), (241, 11)), 2.0**-31 * PI),
        "perigee_rad": (s3((252, 11), (271, 21)), 2.0**-31 * PI),
    }
    assert_within_resolution(decoded, ephemeris, 20)
    offset_ns = 14 * SECOND_NS
    assert u1((43, 1)) == ephemeris.health
    assert u1((44, 5)) == ephemeris.other["aodc"]
    assert u1((61, 13)) == start_ns // WEEK_NS - 1356
    assert u1((74, 9), (91, 8)) * 8 == (ephemeris.toc_ns - offset_ns) % WEEK_NS // SECOND_NS
    assert u1((288, 5)) == ephemeris.iode
    toe = u2((291, 2)) << 15 | u3((43, 10), (61, 5))
    assert toe * 8 == (ephemeris.toe_ns - offset_ns) % WEEK_NS // SECOND_NS


@given(SEEDS, st.sampled_from(["C01", "C05", "C59", "C63"]), WEEKS, st.sampled_from([0, 14, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_d2_pages_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, name, week * WEEK_NS + (7200 + 14) * SECOND_NS)
    read = {}
    for end_ns, message, words in all_of(ephemeris, week * WEEK_NS + second * SECOND_NS):
        assert (message.gnssId, message.sigId, message.numWords) == (3, 1, 10)
        assert beidou_words_are_right(words)
        u, s = beidou_reader(words)
        start_ns = assert_head(u, end_ns, 600_000_000, 1)
        page = u((43, 4))
        assert start_ns % (30 * SECOND_NS) == (page - 1) * 3 * SECOND_NS
        read[page] = u, s, start_ns
    assert sorted(read) == [1, 3, 4, 5, 6, 7, 8, 9, 10]

    def u(page, *pieces):
        return read[page][0](*pieces)

    def parts(high, low):
        """A signed field over two pages: its value and the pieces of each."""
        (page, pieces), (next_page, rest) = high, low
        bits = sum(n for _, n in rest)
        return read[page][1](*pieces) * 2**bits + u(next_page, *rest)

    decoded = {
        "tgd1_s": (read[1][1]((103, 10)), 1e-10),
        "tgd2_s": (read[1][1]((121, 10)), 1e-10),
        "af0": (read[3][1]((101, 12), (121, 12)), 2.0**-33),
        "af1": (parts((3, [(133, 4)]), (4, [(47, 6), (61, 12)])), 2.0**-50),
        "af2": (read[4][1]((73, 10), (91, 1)), 2.0**-66),
        "mean_motion_difference_rad_s": (read[4][1]((97, 16)), 2.0**-43 * PI),
        "cuc": (parts((4, [(121, 14)]), (5, [(47, 4)])), 2.0**-31),
        "mean_anomaly_rad": (read[5][1]((51, 2), (61, 22), (91, 8)), 2.0**-31 * PI),
        "cus": (read[5][1]((99, 14), (121, 4)), 2.0**-31),
        "eccentricity": ((u(5, (125, 10)) << 22 | u(6, (47, 6), (61, 16))), 2.0**-33),
        "sqrt_a": (u(6, (77, 6), (91, 22), (121, 4)), 2.0**-19),
        "cic": (parts((6, [(125, 10)]), (7, [(47, 6), (61, 2)])), 2.0**-31),
        "cis": (read[7][1]((63, 18)), 2.0**-31),
        "inclination_rad": (parts((7, [(106, 7), (121, 14)]), (8, [(47, 6), (61, 5)])), 2.0**-31 * PI),
        "crc_m": (read[8][1]((66, 17), (91, 1)), 2.0**-6),
        "crs_m": (read[8][1]((92, 18)), 2.0**-6),
        "ascending_node_rate_rad_s": (parts((8, [(110, 3), (121, 16)]), (9, [(47, 5)])), 2.0**-43 * PI),
        "ascending_node_rad": (read[9][1]((52, 1), (61, 22), (91, 9)), 2.0**-31 * PI),
        "perigee_rad": (parts((9, [(100, 13), (121, 14)]), (10, [(47, 5)])), 2.0**-31 * PI),
        "inclination_rate_rad_s": (read[10][1]((52, 1), (61, 13)), 2.0**-43 * PI),
    }
    assert_within_resolution(decoded, ephemeris, 20)
    assert u(1, (47, 1)) == ephemeris.health
    assert u(1, (48, 5)) == ephemeris.other["aodc"]
    assert u(1, (65, 13)) == read[1][2] // WEEK_NS - 1356
    assert u(1, (78, 5), (91, 12)) * 8 == (ephemeris.toc_ns - 14 * SECOND_NS) % WEEK_NS // SECOND_NS
    assert u(4, (92, 5)) == ephemeris.iode
    assert u(7, (81, 2), (91, 15)) * 8 == (ephemeris.toe_ns - 14 * SECOND_NS) % WEEK_NS // SECOND_NS


# --- the schedule -----------------------------------------------------------------------------------------------------


@given(
    SEEDS, st.sampled_from(["G05", "J03", "E11", "C21", "C03"]), st.lists(st.integers(1, 40_000), max_size=6)
)
@settings(derandomize=True, max_examples=40, deadline=None)
def test_adjacent_intervals_contain_each_subframe_once(seed, name, lengths_ms):
    rng = np.random.default_rng(seed)
    start_ns = 2300 * WEEK_NS - 30 * SECOND_NS + int(rng.integers(0, 30_000)) * 1_000_000
    ephemeris = random_ephemeris(rng, name, 2300 * WEEK_NS + (14 if name[0] == "C" else 0) * SECOND_NS)
    edges = [start_ns + ms * 1_000_000 for ms in accumulate(lengths_ms, initial=0)]
    pieces = [subframe for a, b in pairwise(edges) for subframe in subframes_between(ephemeris, a, b)]
    assert pieces == subframes_between(ephemeris, start_ns, edges[-1])
    assert all(start_ns <= subframe.end_ns < edges[-1] for subframe in pieces)


def test_unsupported_system_is_refused():
    ephemeris = random_ephemeris(np.random.default_rng(1), "G05", 2300 * WEEK_NS)
    object.__setattr__(ephemeris, "satellite", ord("R") * 256 + 5)
    with pytest.raises(ValueError, match="R05: expected one of G, J, E, C"):
        subframes_between(ephemeris, 0, SECOND_NS)

"""Subframes decoded by independent decoders of the interface specifications, and recorded words of a receiver."""

import math
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader

from camber.formats.broadcast.gps_lnav import add_parity
from camber.formats.observations import Ephemeris
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


Bits = tuple[int, int]
"""All bits of a subframe, page or word, and how many there are."""
Table = dict[str, list[tuple[int, int, int]]]
"""By field: its pieces side by side, each as number of the subframe, page or word, first bit (from 1), bits."""
UNSIGNED = ("sqrt_a", "eccentricity")
CYCLIC = ("mean_anomaly_rad", "ascending_node_rad", "perigee_rad")


def steps(*, harmonics: float, lengths_m: float, **others: float) -> dict[str, float]:
    """Resolutions of a system's fields; those of the orbit are the same in all."""
    return {
        "sqrt_a": 2.0**-19,
        "eccentricity": 2.0**-33,
        **dict.fromkeys((*CYCLIC, "inclination_rad"), 2.0**-31 * PI),
        **dict.fromkeys(("inclination_rate_rad_s", "ascending_node_rate_rad_s"), 2.0**-43 * PI),
        "mean_motion_difference_rad_s": 2.0**-43 * PI,
        **dict.fromkeys(("cuc", "cus", "cic", "cis"), harmonics),
        **dict.fromkeys(("crc_m", "crs_m"), lengths_m),
        **others,
    }


GPS = steps(harmonics=2.0**-29, lengths_m=2.0**-5, af0=2.0**-31, af1=2.0**-43, af2=2.0**-55, tgd_s=2.0**-31)
GALILEO = steps(
    **{"harmonics": 2.0**-29, "lengths_m": 2.0**-5, "af0": 2.0**-34, "af1": 2.0**-46, "af2": 2.0**-59},
    **dict.fromkeys(("bgd_e5a_s", "bgd_e5b_s"), 2.0**-32),
)
BEIDOU = steps(
    **{"harmonics": 2.0**-31, "lengths_m": 2.0**-6, "af0": 2.0**-33, "af1": 2.0**-50, "af2": 2.0**-66},
    **dict.fromkeys(("tgd1_s", "tgd2_s"), 1e-10),
)


def joined(words, width: int) -> Bits:
    everything = 0
    for word in words:
        everything = everything << width | word & (1 << width) - 1
    return everything, len(words) * width


def piece(bits: Bits, first: int, count: int) -> int:
    everything, total = bits
    return everything >> (total - first + 1 - count) & (1 << count) - 1


def unsigned(parts: dict[int, Bits], pieces) -> int:
    value = 0
    for part, first, count in pieces:
        value = value << count | piece(parts[part], first, count)
    return value


def assert_within_resolution(
    parts: dict[int, Bits], table: Table, resolutions: dict[str, float], ephemeris: Ephemeris
) -> None:
    wanted = dict(zip(("af0", "af1", "af2"), ephemeris.clock, strict=True)) | ephemeris.other
    for name, resolution in resolutions.items():
        integer, bits = unsigned(parts, table[name]), sum(count for *_, count in table[name])
        if name not in UNSIGNED and integer >> (bits - 1):
            integer -= 1 << bits
        difference = integer * resolution - (wanted[name] if name in wanted else getattr(ephemeris, name))
        if name in CYCLIC:
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


# Word, first bit of its data, bits.
_LNAV: dict[int, dict[str, list[tuple[int, int, int]]]] = {
    1: {
        "week": [(3, 1, 10)], "health": [(3, 17, 6)], "iodc": [(3, 23, 2), (8, 1, 8)], "tgd_s": [(7, 17, 8)],
        "toc": [(8, 9, 16)], "af2": [(9, 1, 8)], "af1": [(9, 9, 16)], "af0": [(10, 1, 22)],
    },
    2: {
        "iode": [(3, 1, 8)], "crs_m": [(3, 9, 16)], "mean_motion_difference_rad_s": [(4, 1, 16)],
        "mean_anomaly_rad": [(4, 17, 8), (5, 1, 24)], "cuc": [(6, 1, 16)], "eccentricity": [(6, 17, 8), (7, 1, 24)],
        "cus": [(8, 1, 16)], "sqrt_a": [(8, 17, 8), (9, 1, 24)], "toe": [(10, 1, 16)], "fit": [(10, 17, 1)],
    },
    3: {
        "cic": [(3, 1, 16)], "ascending_node_rad": [(3, 17, 8), (4, 1, 24)], "cis": [(5, 1, 16)],
        "inclination_rad": [(5, 17, 8), (6, 1, 24)], "crc_m": [(7, 1, 16)], "perigee_rad": [(7, 17, 8), (8, 1, 24)],
        "ascending_node_rate_rad_s": [(9, 1, 24)], "iode3": [(10, 1, 8)], "inclination_rate_rad_s": [(10, 9, 14)],
    },
}  # fmt: skip
LNAV: Table = {
    name: [(subframe, 24 * (word - 1) + bit, count) for word, bit, count in pieces]
    for subframe, fields in _LNAV.items()
    for name, pieces in fields.items()
}


@given(SEEDS, st.sampled_from(["G01", "G17", "G32", "J01", "J10"]), WEEKS, st.sampled_from([0, 12, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_lnav_subframes_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    # The reference time is in the next week for the last second of this.
    toe_ns = (week + (second > 600_000)) * WEEK_NS + 7200 * SECOND_NS
    ephemeris = random_ephemeris(rng, name, toe_ns)
    messages = all_of(ephemeris, week * WEEK_NS + second * SECOND_NS)
    assert len(messages) == 3
    parts, starts_ns = {}, {}
    for end_ns, message, words in messages:
        assert (message.gnssId, message.sigId) == (0 if name[0] == "G" else 5, 0)
        data = lnav_data(words)
        assert data[0] >> 16 == 0x8B
        which = data[1] >> 2 & 7
        start_ns = end_ns - 6 * SECOND_NS
        assert start_ns % (30 * SECOND_NS) == (which - 1) * 6 * SECOND_NS
        assert data[1] >> 7 == end_ns % WEEK_NS // (6 * SECOND_NS)
        parts[which], starts_ns[which] = joined(data, 24), start_ns
    decoded = {name: unsigned(parts, pieces) for name, pieces in LNAV.items()}
    assert decoded["week"] == starts_ns[1] // WEEK_NS % 1024
    assert decoded["toe"] * 16 == ephemeris.toe_ns % WEEK_NS // SECOND_NS
    assert decoded["toc"] * 16 == ephemeris.toc_ns % WEEK_NS // SECOND_NS
    assert decoded["iode"] == decoded["iode3"] == ephemeris.iode
    assert decoded["iodc"] == ephemeris.other["iodc"]
    assert decoded["health"] == ephemeris.health
    assert decoded["fit"] == (ephemeris.other["fit_interval_h"] > (4.0 if name[0] == "G" else 2.0))
    assert_within_resolution(parts, LNAV, GPS, ephemeris)


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
    even, odd = (piece(joined(words[k : k + 4], 32), 1, 120) for k in (0, 4))
    assert even >> 118 == 0b00
    assert odd >> 118 == 0b10
    assert even & 63 == odd & 63 == 0
    # Even: 114 bits before the tail; odd: 82 bits, the CRC, eight bits and the tail.
    assert crc24q((even >> 6) << 82 | odd >> 38, 196) == odd >> 14 & 0xFFFFFF
    return (even >> 6 & (1 << 112) - 1) << 16 | odd >> 102 & 0xFFFF


INAV: Table = {
    "mean_anomaly_rad": [(1, 31, 32)], "eccentricity": [(1, 63, 32)], "sqrt_a": [(1, 95, 32)],
    "ascending_node_rad": [(2, 17, 32)], "inclination_rad": [(2, 49, 32)], "perigee_rad": [(2, 81, 32)],
    "inclination_rate_rad_s": [(2, 113, 14)], "ascending_node_rate_rad_s": [(3, 17, 24)],
    "mean_motion_difference_rad_s": [(3, 41, 16)], "cuc": [(3, 57, 16)], "cus": [(3, 73, 16)], "crc_m": [(3, 89, 16)],
    "crs_m": [(3, 105, 16)], "cic": [(4, 23, 16)], "cis": [(4, 39, 16)], "af0": [(4, 69, 31)], "af1": [(4, 100, 21)],
    "af2": [(4, 121, 6)], "bgd_e5a_s": [(5, 48, 10)], "bgd_e5b_s": [(5, 58, 10)],
}  # fmt: skip


@given(SEEDS, st.sampled_from(["E01", "E24", "E36"]), WEEKS, st.sampled_from([0, 13, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_inav_pages_equal_an_independent_decoder(seed, name, week, second):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, name, week * WEEK_NS + 600 * SECOND_NS)
    pages, starts_ns = {}, {}
    for end_ns, message, words in all_of(ephemeris, week * WEEK_NS + second * SECOND_NS):
        assert (message.gnssId, message.sigId, message.numWords) == (2, 1, 9)
        page = inav_word(words)
        pages[page >> 122] = page, 128
        starts_ns[page >> 122] = end_ns - 2 * SECOND_NS
    # Table 38: the words of E1-B begin at these seconds of the subframe.
    seconds = {word: start % (30 * SECOND_NS) // SECOND_NS for word, start in starts_ns.items()}
    assert seconds == {2: 1, 4: 3, 6: 5, 1: 21, 3: 23, 5: 25}

    def u(word, first, bits):
        return piece(pages[word], first, bits)

    for word in (1, 2, 3, 4):
        assert u(word, 7, 10) == ephemeris.iode
    assert_within_resolution(pages, INAV, GALILEO, ephemeris)
    assert u(1, 17, 14) * 60 == ephemeris.toe_ns % WEEK_NS // SECOND_NS
    assert u(4, 55, 14) * 60 == ephemeris.toc_ns % WEEK_NS // SECOND_NS
    assert u(4, 17, 6) == ephemeris.satellite & 255
    health = u(5, 73, 1), u(5, 70, 2), u(5, 72, 1), u(5, 68, 2)
    h = ephemeris.health
    assert health == (h & 1, h >> 1 & 3, h >> 6 & 1, h >> 7 & 3)
    assert u(5, 74, 12) == (starts_ns[5] // WEEK_NS - 1024) % 4096
    assert u(5, 86, 20) == starts_ns[5] % WEEK_NS // SECOND_NS
    # Word 6: A0, A1 are zero, GST is the leap seconds before UTC, now and announced.
    assert u(6, 7, 56) == 0
    assert u(6, 63, 8) == u(6, 98, 8) == gps_minus_utc_s(starts_ns[6])
    assert u(6, 106, 20) == starts_ns[6] % WEEK_NS // SECOND_NS


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


def assert_head(bits: Bits, end_ns: int, length_ns: int) -> tuple[int, int]:
    """Return the number of the subframe and its start, BeiDou time."""
    assert piece(bits, 1, 11) == 0b11100010010
    start_ns = end_ns - length_ns - 14 * SECOND_NS
    assert start_ns % SECOND_NS == 0
    assert unsigned({0: bits}, [(0, 19, 8), (0, 31, 12)]) == start_ns % WEEK_NS // SECOND_NS
    return piece(bits, 16, 3), start_ns


# Bits of the 300 counted from 1 as in the figures of the document.
D1: Table = {
    "health": [(1, 43, 1)], "aodc": [(1, 44, 5)], "week": [(1, 61, 13)], "toc": [(1, 74, 9), (1, 91, 8)],
    "tgd1_s": [(1, 99, 10)], "tgd2_s": [(1, 109, 4), (1, 121, 6)], "af2": [(1, 215, 11)],
    "af0": [(1, 226, 7), (1, 241, 17)], "af1": [(1, 258, 5), (1, 271, 17)], "iode": [(1, 288, 5)],
    "mean_motion_difference_rad_s": [(2, 43, 10), (2, 61, 6)], "cuc": [(2, 67, 16), (2, 91, 2)],
    "mean_anomaly_rad": [(2, 93, 20), (2, 121, 12)], "eccentricity": [(2, 133, 10), (2, 151, 22)],
    "cus": [(2, 181, 18)], "crc_m": [(2, 199, 4), (2, 211, 14)], "crs_m": [(2, 225, 8), (2, 241, 10)],
    "sqrt_a": [(2, 251, 12), (2, 271, 20)], "toe": [(2, 291, 2), (3, 43, 10), (3, 61, 5)],
    "inclination_rad": [(3, 66, 17), (3, 91, 15)], "cic": [(3, 106, 7), (3, 121, 11)],
    "ascending_node_rate_rad_s": [(3, 132, 11), (3, 151, 13)], "cis": [(3, 164, 9), (3, 181, 9)],
    "inclination_rate_rad_s": [(3, 190, 13), (3, 211, 1)], "ascending_node_rad": [(3, 212, 21), (3, 241, 11)],
    "perigee_rad": [(3, 252, 11), (3, 271, 21)],
}  # fmt: skip
D2: Table = {
    "health": [(1, 47, 1)], "aodc": [(1, 48, 5)], "week": [(1, 65, 13)], "toc": [(1, 78, 5), (1, 91, 12)],
    "tgd1_s": [(1, 103, 10)], "tgd2_s": [(1, 121, 10)], "af0": [(3, 101, 12), (3, 121, 12)],
    "af1": [(3, 133, 4), (4, 47, 6), (4, 61, 12)], "af2": [(4, 73, 10), (4, 91, 1)], "iode": [(4, 92, 5)],
    "mean_motion_difference_rad_s": [(4, 97, 16)], "cuc": [(4, 121, 14), (5, 47, 4)],
    "mean_anomaly_rad": [(5, 51, 2), (5, 61, 22), (5, 91, 8)], "cus": [(5, 99, 14), (5, 121, 4)],
    "eccentricity": [(5, 125, 10), (6, 47, 6), (6, 61, 16)], "sqrt_a": [(6, 77, 6), (6, 91, 22), (6, 121, 4)],
    "cic": [(6, 125, 10), (7, 47, 6), (7, 61, 2)], "cis": [(7, 63, 18)], "toe": [(7, 81, 2), (7, 91, 15)],
    "inclination_rad": [(7, 106, 7), (7, 121, 14), (8, 47, 6), (8, 61, 5)], "crc_m": [(8, 66, 17), (8, 91, 1)],
    "crs_m": [(8, 92, 18)], "ascending_node_rate_rad_s": [(8, 110, 3), (8, 121, 16), (9, 47, 5)],
    "ascending_node_rad": [(9, 52, 1), (9, 61, 22), (9, 91, 9)],
    "perigee_rad": [(9, 100, 13), (9, 121, 14), (10, 47, 5)], "inclination_rate_rad_s": [(10, 52, 1), (10, 61, 13)],
}  # fmt: skip


@pytest.mark.parametrize(
    ("table", "names", "signal_id", "length_ns", "period_s"),
    [
        (D1, ("C06", "C27", "C46", "C58"), 0, 6 * SECOND_NS, 6),
        (D2, ("C01", "C05", "C59", "C63"), 1, 600_000_000, 3),
    ],
    ids=["D1", "D2"],
)
@given(SEEDS, st.integers(0, 3), WEEKS, st.sampled_from([0, 14, 604_770]))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_beidou_subframes_equal_an_independent_decoder(
    table, names, signal_id, length_ns, period_s, seed, which, week, second
):
    rng = np.random.default_rng(seed)
    ephemeris = random_ephemeris(rng, names[which], week * WEEK_NS + (7200 + 14) * SECOND_NS)
    parts, starts_ns = {}, {}
    for end_ns, message, words in all_of(ephemeris, week * WEEK_NS + second * SECOND_NS):
        assert (message.gnssId, message.sigId, message.numWords) == (3, signal_id, 10)
        assert beidou_words_are_right(words)
        assert not beidou_words_are_right([words[0], words[1] ^ 1 << int(rng.integers(0, 30)), *words[2:]])
        bits = joined(words, 30)
        number, start_ns = assert_head(bits, end_ns, length_ns)
        if table is D2:
            assert number == 1
            number = piece(bits, 43, 4)
        assert start_ns % (30 * SECOND_NS) == (number - 1) * period_s * SECOND_NS
        parts[number], starts_ns[number] = bits, start_ns
    assert sorted(parts) == sorted({part for pieces in table.values() for part, *_ in pieces})
    assert_within_resolution(parts, table, BEIDOU, ephemeris)
    decoded = {name: unsigned(parts, pieces) for name, pieces in table.items()}
    assert decoded["health"] == ephemeris.health
    assert decoded["aodc"] == ephemeris.other["aodc"]
    assert decoded["week"] == starts_ns[1] // WEEK_NS - 1356
    assert decoded["iode"] == ephemeris.iode
    assert decoded["toc"] * 8 == (ephemeris.toc_ns - 14 * SECOND_NS) % WEEK_NS // SECOND_NS
    assert decoded["toe"] * 8 == (ephemeris.toe_ns - 14 * SECOND_NS) % WEEK_NS // SECOND_NS


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

"""BeiDou D1 subframes 1 to 3 and D2 pages (geostationary satellites) on B1I, as ten words with their check bits.

Source: BDS-SIS-ICD-B1I: 5.1.3 (BCH and interleaving), 5.2.3, 5.2.4 (D1), 5.3.2, 5.3.3 (D2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camber.formats.broadcast.bit_fields import BitLayout, decode_layout, encode_layout, pack_bits
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris, system_week
from camber.formats.broadcast.klobuchar_coefficients import IONOSPHERE_FIELDS
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

# BDS-SIS-ICD-B1I: 5.2.2 and 5.3.2 (durations; a page of D2 is sent with every frame), 5.2.4.1 (preamble).
D1_SUBFRAME_S = 6
D2_FRAME_S = 3
D2_SUBFRAME_NS = 600_000_000
D2_PAGES = (1, 3, 4, 5, 6, 7, 8, 9, 10)
"""Pages of subframe 1 with the ephemeris; page 2 contains the ionosphere."""
_PERIOD_S = 30  # 5.2.2, 5.3.2
_PREAMBLE = 0b11100010010  # 5.2.4.1
_Fields = list[tuple[int, int]]
_D1: dict[int, BitLayout] = {
    1: (
        *("health", "aodc", "accuracy", "week", "toc_s", "tgd1_s", "tgd2_s"),
        *IONOSPHERE_FIELDS,
        *("af2", "af0_s", "af1", "iode"),
    ),
    2: (
        *("mean_motion_difference_rad_s", "cuc", "mean_anomaly_rad", "eccentricity", "cus", "crc_m", "crs_m"),
        *("sqrt_a", "toe_s>15"),
    ),
    3: (
        *("toe_s<15", "inclination_rad", "cic", "ascending_node_rate_rad_s", "cis", "inclination_rate_rad_s"),
        *("ascending_node_rad", "perigee_rad", 1),
    ),
}
_D2: dict[int, BitLayout] = {
    1: ("health", "aodc", "accuracy", "week", "toc_s", "tgd1_s", "tgd2_s", 12),
    3: (38, "af0_s", "af1>18", 6),
    4: ("af1<18", "af2", "iode", "mean_motion_difference_rad_s", "cuc>4", 8),
    5: ("cuc<4", "mean_anomaly_rad", "cus", "eccentricity>22", 8),
    6: ("eccentricity<22", "sqrt_a", "cic>8", 8),
    7: ("cic<8", "cis", "toe_s", "inclination_rad>11", 8),
    8: ("inclination_rad<11", "crc_m", "crs_m", "ascending_node_rate_rad_s>5", 6),
    9: ("ascending_node_rate_rad_s<5", "ascending_node_rad", "perigee_rad>5", 8),
    10: ("perigee_rad<5", "inclination_rate_rad_s", 53),
}
_D2_RESERVED = (0, 5 * 22)  # words 6 to 10 of a page, 5.3.3
FIELDS_AND_IONOSPHERE = FIELDS["C"] | IONOSPHERE_FIELDS
_BITS, _BODY_BITS = 26 + 9 * 22, 26 + 9 * 22 - 38


def is_geostationary(satellite: int) -> bool:
    """Whether a BeiDou satellite is one of those that send D2: C01 to C05, C59 to C63."""
    number = satellite & 255
    return number <= 5 or number >= 59


def encode_d1_subframe(ephemeris: Ephemeris, subframe: int, start_ns: int) -> list[int]:
    """Return ten words of 30 bits of D1 subframe 1, 2 or 3 starting at a GPS time; the ionosphere is zero.

    Words are as after de-interleaving: 22 information bits (26 in the first), then 8 check bits (4). Raises ValueError
    as `integers_from_ephemeris` does, or where this subframe does not start at this time.
    """
    week, second = _second_of_week(start_ns, D1_SUBFRAME_S, subframe)
    integers = (
        dict.fromkeys(IONOSPHERE_FIELDS, 0) | integers_from_ephemeris(ephemeris) | {"week": week % 8192}
    )
    return _words([*_head(subframe, second), *encode_layout(_D1[subframe], FIELDS_AND_IONOSPHERE, integers)])


def encode_d2_page(ephemeris: Ephemeris, page: int, start_ns: int) -> list[int]:
    """Return ten words of page 1 or 3 to 10 of D2 subframe 1 starting at a GPS time; else as `encode_d1_subframe`."""
    week, second = _second_of_week(start_ns, D2_FRAME_S, page)
    integers = integers_from_ephemeris(ephemeris) | {"week": week % 8192}
    body = encode_layout(_D2[page], FIELDS_AND_IONOSPHERE, integers)
    return _words([*_head(1, second), (page, 4), *body, _D2_RESERVED])


@dataclass(frozen=True, slots=True, kw_only=True)
class BeidouPart:
    """A subframe (D1) or page (D2): its number, its start [s of BeiDou's week], the fields in it."""

    number: int
    second: int
    fields: dict[str, int]


def decode_d1_subframe(words: Sequence[int]) -> BeidouPart:
    """Return a D1 subframe; only 1 to 3 contain fields, subframe 1 also the ionosphere.

    Words as in `encode_d1_subframe`; bits above their 30 are ignored. Raises ValueError where check bits, the preamble,
    the time or the number of words is wrong.
    """
    number, second, bits = _decode_words(words)
    fields = decode_layout(bits, _BODY_BITS, _D1.get(number, ()), FIELDS_AND_IONOSPHERE)
    return BeidouPart(number=number, second=second, fields=fields)


def decode_d2_page(words: Sequence[int]) -> BeidouPart | None:
    """Return a page of D2 subframe 1; None for another subframe. Else as `decode_d1_subframe`."""
    subframe, second, bits = _decode_words(words)
    if subframe != 1:
        return None
    page = bits >> _BODY_BITS - 4 & 0b1111
    fields = decode_layout(bits, _BODY_BITS - 4, _D2.get(page, ()), FIELDS_AND_IONOSPHERE)
    return BeidouPart(number=page, second=second, fields=fields)


def _bch_check_bits(information: int) -> int:
    """Return the four check bits of eleven information bits: BCH(15, 11), g(x) = x⁴ + x + 1."""
    rest = information << 4
    for bit in range(14, 3, -1):
        if rest >> bit & 1:
            rest ^= 0b10011 << bit - 4
    return rest


def _decode_words(words: Sequence[int]) -> tuple[int, int, int]:
    """Return subframe number, second of the week and all information bits."""
    if len(words) != 10:
        raise ValueError(f"{len(words)} words, expected 10")
    bits = 0
    for k, word in enumerate(words):
        information = word >> 8 & 0x3FFFFF if k else word >> 4 & 0x3FFFFFF
        expected = _other_word(information) if k else _first_word(information)
        if word & 0x3FFFFFFF != expected:
            raise ValueError(f"check bits of word {word:08x} are wrong")
        bits = bits << (22 if k else 26) | information
    if bits >> _BITS - 11 != _PREAMBLE:
        raise ValueError(f"preamble is {bits >> _BITS - 11:011b}, expected {_PREAMBLE:011b}")
    second = bits >> _BODY_BITS & 0xFFFFF
    if second >= NS_PER_WEEK // NS_PER_SECOND:
        raise ValueError(f"second {second} of the week, expected less than a week's")
    return bits >> _BITS - 18 & 0b111, second, bits


def _second_of_week(start_ns: int, length_s: int, number: int) -> tuple[int, int]:
    week, of_week_ns = system_week("C", start_ns)
    second, rest = divmod(of_week_ns, NS_PER_SECOND)
    if rest or second % _PERIOD_S != length_s * (number - 1):
        raise ValueError(
            f"part {number} at {of_week_ns / NS_PER_SECOND} s of BeiDou's week, expected in its turn"
        )
    return week, second


def _head(subframe: int, second: int) -> _Fields:
    return [(_PREAMBLE, 11), (0, 4), (subframe, 3), (second, 20)]


def _words(fields: _Fields) -> list[int]:
    information, width = pack_bits(fields)
    first = _first_word(information >> width - 26)
    return [first, *(_other_word(information >> width - 26 - 22 * n & 0x3FFFFF) for n in range(1, 10))]


def _first_word(information: int) -> int:
    """Return the word of 26 information bits, of which the last 11 are checked."""
    return information << 4 | _bch_check_bits(information & 0x7FF)


def _other_word(information: int) -> int:
    """Return the word of 22 information bits, which are two code words."""
    return information << 8 | _bch_check_bits(information >> 11) << 4 | _bch_check_bits(information & 0x7FF)

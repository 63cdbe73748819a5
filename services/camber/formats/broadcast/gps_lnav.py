"""GPS and QZSS LNAV subframes as ten words with parity: 1 to 3 written and read, the ionosphere read.

Source: IS-GPS-200, 20.3.3 (subframes), 20.3.3.5.1.7 (ionosphere), table 20-XIV (parity); IS-QZSS-PNT, 4.1 (QZSS,
alike).
"""

from __future__ import annotations

from collections.abc import Sequence

from camber.formats.broadcast.bit_fields import joined
from camber.formats.broadcast.bit_layouts import BitLayout, decode_layout, encode_layout
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris, system_week
from camber.formats.broadcast.klobuchar_coefficients import IONOSPHERE_FIELDS
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND

SUBFRAME_S = 6
_PREAMBLE = 0x8B
_TOW_COUNTS_PER_WEEK = 100_800
# The data bits d1 … d24 that each parity bit sums up, D25 first, and which of D29*, D30* is added.
_PARITY_BITS = (
    (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23),
    (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24),
    (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22),
    (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23),
    (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24),
    (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24),
)
_ADDS_D30 = (False, True, False, True, True, False)
_MASKS = tuple(
    sum(1 << 24 - bit for bit in bits) | (1 << 24 if adds_d30 else 1 << 25)
    for bits, adds_d30 in zip(_PARITY_BITS, _ADDS_D30, strict=True)
)
_BODY_BITS = 240 - 48
BODIES: dict[int, BitLayout] = {
    1: (
        *("week", "codes_on_l2", "accuracy", "health", "iodc>8", "l2_p_data", 23 + 24 + 24 + 16),
        *("tgd_s", "iodc<8", "toc_s", "af2", "af1", "af0_s"),
    ),
    2: (
        *("iode", "crs_m", "mean_motion_difference_rad_s", "mean_anomaly_rad", "cuc", "eccentricity", "cus"),
        *("sqrt_a", "toe_s", "fit"),
    ),
    3: (
        *("cic", "ascending_node_rad", "cis", "inclination_rad", "crc_m", "perigee_rad"),
        *("ascending_node_rate_rad_s", "iode", "inclination_rate_rad_s"),
    ),
}
"""What follows the first two words of each subframe."""
# The age of data offset is not used: 27900 s, binary 11111, says so.
_NO_OFFSET = (0b11111, 5)
# Subframe 4, page 18 (table 20-V: SV id 56), after the data id.
_IONOSPHERE_PAGE = 56


def encode_lnav_subframe(ephemeris: Ephemeris, subframe: int, start_ns: int) -> list[int]:
    """Ten words of 32 bits as a receiver reports them, of subframe 1, 2 or 3 that begins at a GPS time.

    Each word is D29*, D30* of the word before, 24 data bits, 6 parity bits; where D30* is one, all 32 are inverted, so
    that the data bits are as they were meant: so u-blox receivers give them. Raises ValueError as
    `integers_from_ephemeris` does, or where no subframe begins at this time.
    """
    week, of_week_ns = system_week("G", start_ns)
    count, rest = divmod(of_week_ns, SUBFRAME_S * NS_PER_SECOND)
    if rest or count % 5 != subframe - 1 or subframe not in (1, 2, 3):
        raise ValueError(
            f"subframe {subframe} at {of_week_ns / NS_PER_SECOND} s of the week, expected 1 to 3 in turn"
        )
    integers = integers_from_ephemeris(ephemeris) | {"week": week % 1024}
    head = [
        *((_PREAMBLE, 8), (0, 16)),
        # The count is that of the next subframe's start. No alert; anti-spoofing is on.
        *(((count + 1) % _TOW_COUNTS_PER_WEEK, 17), (0b01, 2), (subframe, 3), (0, 2)),
    ]
    body = encode_layout(BODIES[subframe], FIELDS[chr(ephemeris.satellite >> 8)], integers)
    bits, width = joined([*head, *body, *([_NO_OFFSET] if subframe == 2 else []), (0, 2)])
    return add_parity([bits >> width - 24 * (place + 1) & 0xFFFFFF for place in range(10)])


def decode_lnav_subframe(words: Sequence[int]) -> tuple[int, dict[str, int]]:
    """Number and content of a subframe: parts of `FIELDS` of 1 to 3, `IONOSPHERE_FIELDS` of page 18 of 4, else none.

    Words as in `encode_lnav_subframe`; whether the receiver has inverted the parity bits too, and what it puts before
    the data, does not matter. Raises ValueError where a parity, the preamble or the number of words is wrong.
    """
    if len(words) != 10:
        raise ValueError(f"{len(words)} words, expected 10")
    bits, before = 0, 0
    for word in words:
        data = word >> 6 & 0xFFFFFF
        check = parity(data, before)
        if word & 0b111111 not in (check, check ^ 0b111111):
            raise ValueError(f"parity of word {word:08x} is wrong")
        bits, before = bits << 24 | data, check & 0b11
    if bits >> 232 != _PREAMBLE:
        raise ValueError(f"preamble is {bits >> 232:02x}, expected {_PREAMBLE:02x}")
    number = bits >> _BODY_BITS + 2 & 0b111
    if number in BODIES:
        return number, decode_layout(bits, _BODY_BITS, BODIES[number], FIELDS["G"])
    if number == 4 and bits >> _BODY_BITS - 8 & 0b111111 == _IONOSPHERE_PAGE:
        return number, decode_layout(bits, _BODY_BITS - 8, tuple(IONOSPHERE_FIELDS), IONOSPHERE_FIELDS)
    return number, {}


def parity(data: int, before: int) -> int:
    """Six parity bits of 24 data bits (not inverted), `before` being D29* and D30* of the word before."""
    word = before << 24 | data
    value = 0
    for mask in _MASKS:
        value = value << 1 | (word & mask).bit_count() & 1
    return value


def add_parity(data: list[int]) -> list[int]:
    """Ten words as in `encode_lnav_subframe`; bits 23 and 24 of words 2 and 10 are solved for."""
    words, before = list[int](), 0
    for place, meant in enumerate(data):
        if place in (1, 9):
            # Bits 23 and 24 are such that D29 and D30 become zero.
            meant &= ~0b11
            meant = next(meant | two for two in range(4) if parity(meant | two, before) & 0b11 == 0)
        check = parity(meant, before)
        inverted = before & 1
        as_sent = before << 30 | (meant ^ (0xFFFFFF if inverted else 0)) << 6 | check
        words.append(as_sent ^ (0xFFFFFFFF if inverted else 0))
        before = check & 0b11
    return words

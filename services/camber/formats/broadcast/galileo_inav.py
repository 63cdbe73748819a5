"""Galileo I/NAV word types 1 to 6 as nominal pages of E1-B, encoded and decoded.

Source: Galileo OS SIS ICD, 4.3.2 (page layout), 4.3.5 (word types), 5.1.9.4 (CRC).
"""

from __future__ import annotations

from collections.abc import Sequence

from camber.formats.broadcast.bit_fields import (
    BitLayout,
    bits_to_bytes,
    crc24q,
    decode_layout,
    encode_layout,
    pack_bits,
)
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris, system_week
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND, gps_minus_utc_s

PAGE_S = 2  # Galileo OS SIS ICD, 4.3.2
WORD_STARTS_S = {2: 1, 4: 3, 6: 5, 1: 21, 3: 23, 5: 25}
"""Start of each word type's page within a subframe of 30 s on E1-B (table 38)."""
WORDS: dict[int, BitLayout] = {
    1: ("iode", "toe_s", "mean_anomaly_rad", "eccentricity", "sqrt_a"),
    2: ("iode", "ascending_node_rad", "inclination_rad", "perigee_rad", "inclination_rate_rad_s"),
    3: (
        *("iode", "ascending_node_rate_rad_s", "mean_motion_difference_rad_s"),
        *("cuc", "cus", "crc_m", "crs_m", "accuracy"),
    ),
    4: ("iode", "satellite", "cic", "cis", "toc_s", "af0_s", "af1", "af2"),
    5: (
        11 + 11 + 14 + 5,  # the ionosphere
        *("bgd_e5a_s", "bgd_e5b_s", "e5b_health", "e1b_health", "e5b_invalid", "e1b_invalid", "week"),
    ),
}
"""Fields after the six bits of the word type; in word 5 the time of week follows."""
_WORD_BITS = 128  # 4.3.5


def encode_inav_page(ephemeris: Ephemeris, word: int, start_ns: int) -> list[int]:
    """Return nine words of 32 bits as u-blox reports them: the even part of the page (120 bits, padded), the odd part.

    For E1-B receivers report a ninth word, whose content is undocumented and is zero here; for E5b they report eight,
    by which readers (RTKLIB) distinguish the two signals.

    `word` is the word type, 1 to 6; `start_ns` (GPS time) is when the even part begins; words 5 and 6 contain it.
    Word 6 contains the current leap seconds and announces none; some readers wait for it. The ionosphere of word 5, the
    authentication and the search-and-rescue bits are zero. Raises ValueError as `integers_from_ephemeris` does.
    """
    integers = integers_from_ephemeris(ephemeris)
    week, of_week_ns = system_week("E", start_ns)
    time_of_week = (of_week_ns // NS_PER_SECOND, 20)
    if word == 6:
        leap_s = gps_minus_utc_s(start_ns)
        # A0, A1; leap seconds; reference time and week; week, day and leap seconds of the last announcement; now.
        body = [(0, 32 + 24), (leap_s, 8), (0, 8), (week % 256, 8), (week % 256, 8), (1, 3), (leap_s, 8)]
        body.append(time_of_week)
    elif word == 5:
        body = [*encode_layout(WORDS[5], FIELDS["E"], integers | {"week": week % 4096}), time_of_week]
    else:
        body = encode_layout(WORDS[word], FIELDS["E"], integers)
    data, width = pack_bits([(word, 6), *body])
    data <<= _WORD_BITS - width
    even = (0b00 << 112 | data >> 16, 114)
    odd = ((0b10 << 16 | data & 0xFFFF) << 64, 82)
    crc = _crc(even[0], odd[0])
    page = bits_to_bytes(*pack_bits([even, (0, 6 + 8), odd, (crc, 24), (0, 8 + 6 + 8)]))
    return [*(int.from_bytes(page[k : k + 4], "big") for k in range(0, 32, 4)), 0]


def decode_inav_page(words: Sequence[int]) -> tuple[int, dict[str, int]]:
    """Return the word type of a page and, for types 1 to 5, the fields of `FIELDS` in it.

    Words as in `encode_inav_page`, eight or nine. Raises ValueError where the CRC or the number of words is wrong, or
    the page is not a nominal one with its even part first.
    """
    if len(words) not in (8, 9):
        raise ValueError(f"{len(words)} words, expected 8 or 9")
    page = 0
    for word in words[:8]:
        page = page << 32 | word
    even, odd = page >> 256 - 114, page >> 128 - 82 & (1 << 82) - 1
    if even >> 112 != 0b00 or odd >> 80 != 0b10:
        raise ValueError("no nominal page with an even part first")
    if page >> 128 - 82 - 24 & 0xFFFFFF != _crc(even, odd):
        raise ValueError("CRC is wrong")
    data = (even & (1 << 112) - 1) << 16 | odd >> 64 & 0xFFFF
    word_type = data >> _WORD_BITS - 6
    if word_type not in WORDS:
        return word_type, {}
    return word_type, decode_layout(data, _WORD_BITS - 6, WORDS[word_type], FIELDS["E"])


def _crc(even: int, odd: int) -> int:
    """Return the CRC of 114 and 82 bits, padded at the front: leading zeros do not change it."""
    return crc24q((even << 82 | odd).to_bytes(25, "big"))

"""GPS and QZSS LNAV subframes as ten words with parity: 1 to 3 encoded and decoded, the ionosphere decoded.

Source: IS-GPS-200, 20.3.3 (subframes), 20.3.3.5.1.7 (ionosphere), table 20-XIV (parity); IS-QZSS-PNT, 4.1 (QZSS, the
same).
"""

from __future__ import annotations

from collections.abc import Sequence

from camber.formats.broadcast.bit_fields import BitLayout, decode_layout, encode_layout, pack_bits
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris, system_week
from camber.formats.broadcast.klobuchar_coefficients import IONOSPHERE_FIELDS
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND

# IS-GPS-200, 20.3.2 (duration), 20.3.3.1 (preamble), 20.3.3.2 (count of 6 s in a week).
SUBFRAME_S = 6
_PREAMBLE = 0x8B
_TOW_COUNTS_PER_WEEK = 100_800
# Table 20-XIV: the data bits d1 … d24 that each parity bit sums up, D25 first, and which of D29*, D30* is added.
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
_BODY_BITS = 240 - 48  # without the first two words, TLM and HOW
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
"""Fields after the first two words of each subframe (figure 20-1)."""
# 20.3.3.4.4: an age of data offset of 27900 s, binary 11111, means that it is not used.
_NO_OFFSET = (0b11111, 5)
# Subframe 4, page 18 (table 20-V: SV id 56), after the data id.
_IONOSPHERE_PAGE = 56


def encode_lnav_subframe(ephemeris: Ephemeris, subframe: int, start_ns: int) -> list[int]:
    """Return ten words of 32 bits as a u-blox receiver reports them, of subframe 1, 2 or 3 starting at a GPS time.

    Each word is D29*, D30* of the previous word, 24 data bits, 6 parity bits; where D30* is one, all 32 are inverted,
    so that the data bits are the source data. Raises ValueError as `integers_from_ephemeris` does, or where this
    subframe does not start at this time.
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
    bits, width = pack_bits([*head, *body, *([_NO_OFFSET] if subframe == 2 else []), (0, 2)])
    return add_parity([bits >> width - 24 * (k + 1) & 0xFFFFFF for k in range(10)])


def decode_lnav_subframe(words: Sequence[int]) -> tuple[int, dict[str, int]]:
    """Return the number of a subframe and the fields in it.

    Fields are those of `FIELDS` in subframes 1 to 3, of `IONOSPHERE_FIELDS` in page 18 of subframe 4, else none. Words
    as in `encode_lnav_subframe`; inverted parity bits and any bits before the data are accepted. Raises ValueError
    where a parity, the preamble or the number of words is wrong.
    """
    if len(words) != 10:
        raise ValueError(f"{len(words)} words, expected 10")
    bits, previous = 0, 0
    for word in words:
        data = word >> 6 & 0xFFFFFF
        parity = _parity(data, previous)
        if word & 0b111111 not in (parity, parity ^ 0b111111):
            raise ValueError(f"parity of word {word:08x} is wrong")
        bits, previous = bits << 24 | data, parity & 0b11
    if bits >> 232 != _PREAMBLE:
        raise ValueError(f"preamble is {bits >> 232:02x}, expected {_PREAMBLE:02x}")
    number = bits >> _BODY_BITS + 2 & 0b111
    if number in BODIES:
        return number, decode_layout(bits, _BODY_BITS, BODIES[number], FIELDS["G"])
    if number == 4 and bits >> _BODY_BITS - 8 & 0b111111 == _IONOSPHERE_PAGE:
        return number, decode_layout(bits, _BODY_BITS - 8, tuple(IONOSPHERE_FIELDS), IONOSPHERE_FIELDS)
    return number, {}


def add_parity(data: list[int]) -> list[int]:
    """Return ten words as in `encode_lnav_subframe`; bits 23 and 24 of words 2 and 10 are set so that D29 = D30 = 0."""
    words, previous = list[int](), 0
    for k, source in enumerate(data):
        if k in (1, 9):
            source &= ~0b11
            source = next(source | t for t in range(4) if _parity(source | t, previous) & 0b11 == 0)
        parity = _parity(source, previous)
        inverted = previous & 1
        sent = previous << 30 | (source ^ (0xFFFFFF if inverted else 0)) << 6 | parity
        words.append(sent ^ (0xFFFFFFFF if inverted else 0))
        previous = parity & 0b11
    return words


def _parity(data: int, previous: int) -> int:
    """Return the six parity bits of 24 data bits (not inverted), `previous` being D29* and D30*."""
    word = previous << 24 | data
    value = 0
    for mask in _MASKS:
        value = value << 1 | (word & mask).bit_count() & 1
    return value

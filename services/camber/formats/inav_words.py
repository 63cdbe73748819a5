"""Galileo I/NAV word types 1 to 6 as nominal pages of E1-B.

Source: Galileo OS SIS ICD, 4.3.2 (page layout), 4.3.5 (word types), 5.1.9.4 (CRC).
"""

from __future__ import annotations

from camber.formats.bit_fields import bytes_of, crc24q, joined
from camber.formats.ephemeris_fields import FIELDS, broadcast_integers, system_week
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND, gps_minus_utc_s

PAGE_S = 2
WORD_STARTS_S = {2: 1, 4: 3, 6: 5, 1: 21, 3: 23, 5: 25}
"""When in a subframe of 30 s the page of a word type begins on E1-B (table 38)."""
_WORDS: dict[int, tuple[str, ...]] = {
    1: ("iode", "toe_s", "mean_anomaly_rad", "eccentricity", "sqrt_a"),
    2: ("iode", "ascending_node_rad", "inclination_rad", "perigee_rad", "inclination_rate_rad_s"),
    3: (
        *("iode", "ascending_node_rate_rad_s", "mean_motion_difference_rad_s"),
        *("cuc", "cus", "crc_m", "crs_m", "accuracy"),
    ),
    4: ("iode", "satellite", "cic", "cis", "toc_s", "af0_s", "af1", "af2"),
}
_WORD_BITS = 128


def inav_page(ephemeris: Ephemeris, word: int, start_ns: int) -> list[int]:
    """Nine words of 32 bits: the even part of the page (120 bits, filled up), then the odd one, as u-blox gives them.

    Of E1-B receivers send a ninth word, whose content is not documented and is zero here; of E5b they send eight, and
    readers (RTKLIB) tell the two signals apart by that.

    Word type 1 to 6; `start_ns` (GPS time) is when the even part begins, which is said in words 5 and 6. Word 6 says
    that UTC is whole leap seconds behind, with none announced; some readers wait for it. The ionosphere of word 5, the
    authentication and the search-and-rescue bits are zero. Raises ValueError as `broadcast_integers` does.
    """
    integers = broadcast_integers(ephemeris)
    width_of = {name: field.width for name, field in FIELDS["E"].items()}
    week, of_week_ns = system_week("E", start_ns)
    if word == 6:
        leap_s = gps_minus_utc_s(start_ns)
        # A0, A1; leap seconds; reference time and week; week, day and leap seconds of the last announcement; now.
        body = [(0, 32 + 24), (leap_s, 8), (0, 8), (week % 256, 8), (week % 256, 8), (1, 3), (leap_s, 8)]
        body.append((of_week_ns // NS_PER_SECOND, 20))
    elif word == 5:
        body = [
            (0, 11 + 11 + 14 + 5),
            *(
                (integers[name], width_of[name])
                for name in ("bgd_e5a_s", "bgd_e5b_s", "e5b_health", "e1b_health")
            ),
            *((integers[name], width_of[name]) for name in ("e5b_invalid", "e1b_invalid")),
            (week % 4096, 12),
            (of_week_ns // NS_PER_SECOND, 20),
        ]
    else:
        body = [(integers[name], width_of[name]) for name in _WORDS[word]]
    data, width = joined([(word, 6), *body])
    data <<= _WORD_BITS - width
    even = (0b00 << 112 | data >> 16, 114)
    odd = ((0b10 << 16 | data & 0xFFFF) << 64, 82)
    check, _ = joined([(0, 4), even, odd])
    crc = crc24q(check.to_bytes(25, "big"))
    page, width = joined([even, (0, 6 + 8), odd, (crc, 24), (0, 8 + 6 + 8)])
    as_bytes = bytes_of(page, width)
    return [*(int.from_bytes(as_bytes[place : place + 4], "big") for place in range(0, 32, 4)), 0]

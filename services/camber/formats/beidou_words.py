"""BeiDou D1 subframes 1 to 3 and D2 pages (geostationary satellites) on B1I, as ten words with their check bits.

Source: BDS-SIS-ICD-B1I: 5.1.3 (BCH and interleaving), 5.2.3, 5.2.4 (D1), 5.3.2, 5.3.3 (D2).
"""

from __future__ import annotations

from camber.formats.bit_fields import joined
from camber.formats.ephemeris_fields import FIELDS, broadcast_integers, system_week
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND

D1_SUBFRAME_S = 6
D2_FRAME_S = 3
D2_PAGES = (1, 3, 4, 5, 6, 7, 8, 9, 10)
"""Those that hold the ephemeris; page 2 is of the ionosphere."""
_PERIOD_S = 30
_PREAMBLE = 0b11100010010
_Fields = list[tuple[int, int]]
_D1: dict[int, tuple[str | int, ...]] = {
    1: (
        *("health", "aodc", "accuracy", "week", "toc_s", "tgd1_s", "tgd2_s"),
        64,  # the ionosphere: eight coefficients of eight bits
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
_D2: dict[int, tuple[str | int, ...]] = {
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
_D2_RESERVED_BITS = 5 * 22


def is_geostationary(satellite: int) -> bool:
    """Whether a BeiDou satellite is one of those that send D2: C01 to C05, C59 to C63."""
    number = satellite & 255
    return number <= 5 or number >= 59


def d1_subframe(ephemeris: Ephemeris, subframe: int, start_ns: int) -> list[int]:
    """Ten words of 30 bits of D1 subframe 1, 2 or 3 that begins at a GPS time; the ionosphere is zero.

    Words are as after de-interleaving: 22 information bits (26 in the first), then 8 check bits (4). Raises ValueError
    as `broadcast_integers` does, or where no subframe begins at this time.
    """
    week, second = _second_of_week(start_ns, D1_SUBFRAME_S, subframe)
    integers = broadcast_integers(ephemeris) | {"week": week % 8192}
    return _words([*_head(subframe, second), *_body(_D1[subframe], integers)])


def d2_page(ephemeris: Ephemeris, page: int, start_ns: int) -> list[int]:
    """Ten words of page 1 or 3 to 10 of D2 subframe 1, beginning at a GPS time; else as `d1_subframe`."""
    week, second = _second_of_week(start_ns, D2_FRAME_S, page)
    integers = broadcast_integers(ephemeris) | {"week": week % 8192}
    return _words([*_head(1, second), (page, 4), *_body(_D2[page], integers), (0, _D2_RESERVED_BITS)])


def bch_check(information: int) -> int:
    """The four check bits of eleven information bits: BCH(15, 11), g(x) = x⁴ + x + 1."""
    rest = information << 4
    for place in range(14, 3, -1):
        if rest >> place & 1:
            rest ^= 0b10011 << place - 4
    return rest


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


def _body(layout: tuple[str | int, ...], integers: dict[str, int]) -> _Fields:
    """Names are whole fields, `name>n` a field without its last n bits, `name<n` these; numbers are zero bits."""
    fields = FIELDS["C"]
    body: _Fields = []
    for entry in layout:
        if isinstance(entry, int):
            body.append((0, entry))
        elif ">" in entry:
            name, _, bits = entry.partition(">")
            body.append((integers[name] >> int(bits), fields[name].width - int(bits)))
        else:
            name, _, bits = entry.partition("<")
            body.append((integers[name], int(bits) if bits else fields[name].width))
    return body


def _words(fields: _Fields) -> list[int]:
    information, width = joined(fields)
    # 26 bits in the first word, of which the last 11 are checked, 22 in the others, which are two codes.
    first = information >> width - 26
    words = [first << 4 | bch_check(first & 0x7FF)]
    for place in range(1, 10):
        both = information >> width - 26 - 22 * place & 0x3FFFFF
        words.append(both << 8 | bch_check(both >> 11) << 4 | bch_check(both & 0x7FF))
    return words

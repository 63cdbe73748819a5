"""Transmission schedule of the subframes and pages of each satellite, and u-blox' ids of their signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from camber.formats.broadcast.beidou_d1_d2 import (
    D1_SUBFRAME_S,
    D2_FRAME_S,
    D2_PAGES,
    D2_SUBFRAME_NS,
    encode_d1_subframe,
    encode_d2_page,
    is_geostationary,
)
from camber.formats.broadcast.ephemeris_fields import GNSS_TIME_SCALES
from camber.formats.broadcast.galileo_inav import PAGE_S, WORD_STARTS_S, encode_inav_page
from camber.formats.broadcast.gps_lnav import SUBFRAME_S, encode_lnav_subframe
from camber.formats.observations import Ephemeris, satellite_name
from camber.geodesy.gps_time import NS_PER_SECOND

_PERIOD_NS = 30 * NS_PER_SECOND  # of the ephemeris, in all four systems


@dataclass(frozen=True, slots=True, kw_only=True)
class Subframe:
    """A subframe or page whose transmission ends at `end_ns` (GPS time at the satellite), on u-blox' `signal_id`."""

    end_ns: int
    satellite: int
    signal_id: int
    words: tuple[int, ...]


_Encoder = Callable[[Ephemeris, int, int], list[int]]


def subframes_between(ephemeris: Ephemeris, from_ns: int, to_ns: int) -> list[Subframe]:
    """Return all parts of the ephemeris whose transmission ends at `from_ns` or later and before `to_ns`, in order.

    GPS and QZSS: LNAV subframes 1 to 3 of each frame of 30 s. Galileo: I/NAV words 1 to 6 on E1-B. BeiDou: D1 subframes
    1 to 3, geostationary ones D2 pages 1 and 3 to 10, on B1I. No almanacs, no ionosphere. Raises ValueError as
    `integers_from_ephemeris` does.
    """
    system = satellite_name(ephemeris.satellite)[0]
    signal_id, encode, schedule = _schedule(system, ephemeris.satellite)
    offset_ns = GNSS_TIME_SCALES[system].gps_offset_ns
    subframes: list[Subframe] = []
    for part, start_ns, length_ns in schedule:
        # The first end that is not before from_ns, in the system's periods of 30 s.
        end_ns = from_ns + (start_ns + length_ns + offset_ns - from_ns) % _PERIOD_NS
        for end in range(end_ns, to_ns, _PERIOD_NS):
            words = tuple(encode(ephemeris, part, end - length_ns))
            subframes.append(
                Subframe(end_ns=end, satellite=ephemeris.satellite, signal_id=signal_id, words=words)
            )
    return sorted(subframes, key=lambda subframe: subframe.end_ns)


def _schedule(system: str, satellite: int) -> tuple[int, _Encoder, list[tuple[int, int, int]]]:
    """Return u-blox' signal id, the encoder of a part, and (part, start, duration) of each in ns of a period."""
    second = NS_PER_SECOND
    if system in "GJ":
        length = SUBFRAME_S * second
        return 0, encode_lnav_subframe, [(part, (part - 1) * length, length) for part in (1, 2, 3)]
    if system == "E":
        starts = WORD_STARTS_S.items()
        return 1, encode_inav_page, [(word, start * second, PAGE_S * second) for word, start in starts]
    if system == "C" and is_geostationary(satellite):
        frame = D2_FRAME_S * second
        return 1, encode_d2_page, [(page, (page - 1) * frame, D2_SUBFRAME_NS) for page in D2_PAGES]
    if system == "C":
        length = D1_SUBFRAME_S * second
        return 0, encode_d1_subframe, [(part, (part - 1) * length, length) for part in (1, 2, 3)]
    raise ValueError(f"satellite {satellite_name(satellite)}: expected one of G, J, E, C")

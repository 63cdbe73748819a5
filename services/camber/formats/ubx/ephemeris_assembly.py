"""Subframes and pages of RXM-SFRBX put together to ephemerides and coefficients of the ionosphere.

Sources: IS-GPS-200, 20.3.3.4.1 (issues of data), 20.3.3.5.1.7; Galileo OS SIS ICD, 5.1.9.2 (IODnav); BDS-SIS-ICD-B1I,
5.2.4, 5.3.3; u-blox ZED-F9P, integration manual (UBX-18010802), 3.13.1 (words).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from camber.formats.broadcast.beidou_d1_d2 import (
    D1_SUBFRAME_S,
    D2_FRAME_S,
    D2_PAGES,
    BeidouPart,
    decode_d1_subframe,
    decode_d2_page,
)
from camber.formats.broadcast.bit_layouts import combine_parts
from camber.formats.broadcast.ephemeris_fields import FIELDS, ephemeris_from_integers
from camber.formats.broadcast.galileo_inav import WORDS, decode_inav_page
from camber.formats.broadcast.gps_lnav import BODIES, decode_lnav_subframe
from camber.formats.broadcast.klobuchar_coefficients import (
    IONOSPHERE_FIELDS,
    IonosphereCoefficients,
    coefficients_from_integers,
)
from camber.formats.observations import Ephemeris
from camber.formats.ubx.signal_ids import GNSS_IDS, MOST_SATELLITES
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

SubframeResult = Ephemeris | IonosphereCoefficients
# What carries which message: LNAV on L1 C/A, I/NAV on E1-B and E5b, D1 and D2 on B1I, B2I, B3I.
_LNAV_SIGNALS, _INAV_SIGNALS, _D1_SIGNALS, _D2_SIGNALS = (0,), (1, 5), (0, 2, 4), (1, 3, 10)
_SYSTEMS = {gnss_id: letter for letter, gnss_id in GNSS_IDS.items()}
# RINEX 3.04, table A8: I/NAV from E1-B and E5b, with the clock of E5b, E1.
_INAV_SOURCE = 517.0
_SECONDS_PER_WEEK = NS_PER_WEEK // NS_PER_SECOND
# Of an orbit that does not leave the Earth's surface: a satellite that sends zeros.
_LEAST_SQRT_A = 2600.0
_Parts = dict[int, Mapping[str, int]]


class EphemerisAssembler:
    """Remembers, of each satellite and signal, the parts of the ephemeris that is being sent.

    An ephemeris comes out as soon as all its parts have come that belong together, and then again only of new parts:
    once a frame. GPS and QZSS: subframes 1 to 3 with one issue of data. Galileo: words 1 to 4 with one IODnav, and the
    last word 5. BeiDou has no such number in all parts: those of one period of 30 s.
    """

    def __init__(self) -> None:
        self._parts: dict[tuple[int, int], _Parts] = {}
        self._begins: dict[tuple[int, int], int] = {}

    def take(
        self, gnss_id: int, number: int, signal_id: int, words: Sequence[int], near_ns: int
    ) -> list[SubframeResult] | None:
        """What the words complete; `transmission_ns` is `near_ns`. None for systems and messages that are not read.

        Raises ValueError where words fail their own check or contradict themselves.
        """
        system = _SYSTEMS.get(gnss_id, "")
        if not system:
            return None
        if not 1 <= number <= MOST_SATELLITES[system]:
            raise ValueError(f"satellite {number} of {system}")
        key = ord(system) << 8 | number, signal_id
        if system in "GJ" and signal_id in _LNAV_SIGNALS:
            return self._lnav(system, key, words, near_ns)
        if system == "E" and signal_id in _INAV_SIGNALS:
            return self._inav(key, words, near_ns)
        if system == "C" and signal_id in _D1_SIGNALS:
            part = decode_d1_subframe(words)
            return self._beidou(key, part, (1, 2, 3), D1_SUBFRAME_S, near_ns)
        if system == "C" and signal_id in _D2_SIGNALS:
            page = decode_d2_page(words)
            return [] if page is None else self._beidou(key, page, D2_PAGES, D2_FRAME_S, near_ns)
        return None

    def _lnav(
        self, system: str, key: tuple[int, int], words: Sequence[int], near_ns: int
    ) -> list[SubframeResult]:
        number, fields = decode_lnav_subframe(words)
        if number == 4 and fields and system == "G":
            return [coefficients_from_integers("G", combine_parts([fields], IONOSPHERE_FIELDS))]
        if number not in BODIES:
            return []
        parts = self._parts.setdefault(key, {})
        parts[number] = fields
        if len(parts) < len(BODIES) or not parts[1]["iodc"] & 0xFF == parts[2]["iode"] == parts[3]["iode"]:
            return []
        return [self._ephemeris(system, key, near_ns)]

    def _inav(self, key: tuple[int, int], words: Sequence[int], near_ns: int) -> list[SubframeResult]:
        word_type, fields = decode_inav_page(words)
        if word_type not in WORDS:
            return []
        if fields.get("satellite", key[0] & 255) != key[0] & 255:
            raise ValueError(f"word 4 of satellite {fields['satellite']}, expected {key[0] & 255}")
        parts = self._parts.setdefault(key, {})
        parts[word_type] = fields
        if len(parts) < len(WORDS) or len({parts[word]["iode"] for word in (1, 2, 3, 4)}) > 1:
            return []
        ephemeris = self._ephemeris("E", key, near_ns)
        return [replace(ephemeris, other={**ephemeris.other, "data_sources": _INAV_SOURCE})]

    def _beidou(
        self, key: tuple[int, int], part: BeidouPart, numbers: tuple[int, ...], length_s: int, near_ns: int
    ) -> list[SubframeResult]:
        if part.number not in numbers:
            return []
        begin = (part.second - length_s * (part.number - 1)) % _SECONDS_PER_WEEK
        if self._begins.get(key) != begin:
            self._begins[key] = begin
            self._parts[key] = {}
        results = list[SubframeResult]()
        if not part.fields.keys().isdisjoint(IONOSPHERE_FIELDS):
            ionosphere = {name: part.fields[name] for name in IONOSPHERE_FIELDS}
            # Zeros are sent by those who have none.
            if any(ionosphere.values()):
                results.append(
                    coefficients_from_integers("C", combine_parts([ionosphere], IONOSPHERE_FIELDS))
                )
        # After an ephemeris they are forgotten, and parts of the same period may come once more.
        parts = self._parts.setdefault(key, {})
        parts[part.number] = {n: value for n, value in part.fields.items() if n not in IONOSPHERE_FIELDS}
        return [*results, self._ephemeris("C", key, near_ns)] if len(parts) == len(numbers) else results

    def _ephemeris(self, system: str, key: tuple[int, int], near_ns: int) -> Ephemeris:
        """Of all parts of the satellite, which are forgotten with it."""
        fields = FIELDS[system]
        integers = combine_parts(self._parts.pop(key).values(), fields)
        for time in ("toe_s", "toc_s"):
            if integers[time] * fields[time].resolution >= _SECONDS_PER_WEEK:
                raise ValueError(f"{time} is after the end of the week")
        ephemeris = ephemeris_from_integers(system, {**integers, "satellite": key[0] & 255}, near_ns)
        if ephemeris.sqrt_a < _LEAST_SQRT_A:
            raise ValueError(f"square root of the semi-major axis is {ephemeris.sqrt_a}")
        return ephemeris

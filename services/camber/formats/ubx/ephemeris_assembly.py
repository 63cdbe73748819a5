"""Ephemerides and ionosphere coefficients assembled from the subframes and pages of RXM-SFRBX.

Sources: IS-GPS-200, 20.3.3.4.1 (issues of data), 20.3.3.5.1.7; Galileo OS SIS ICD, 5.1.9.2 (IODnav); BDS-SIS-ICD-B1I,
5.2.4, 5.3.3; ICD GLONASS 5.1, 4.3 (frame); u-blox ZED-F9P, integration manual (UBX-18010802), 3.13.1 (words).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from camber.formats.broadcast.beidou_d1_d2 import (
    D1_SUBFRAME_S,
    D2_FRAME_S,
    D2_PAGES,
    BeidouPart,
    decode_d1_subframe,
    decode_d2_page,
)
from camber.formats.broadcast.bit_fields import combine_parts
from camber.formats.broadcast.ephemeris_fields import FIELDS, plausible_ephemeris
from camber.formats.broadcast.galileo_inav import WORDS, decode_inav_page
from camber.formats.broadcast.glonass_strings import (
    STRINGS,
    decode_string,
    glonass_ephemeris_from_integers,
)
from camber.formats.broadcast.gps_lnav import BODIES, decode_lnav_subframe
from camber.formats.broadcast.klobuchar_coefficients import (
    IONOSPHERE_FIELDS,
    IonosphereCoefficients,
    coefficients_from_integers,
)
from camber.formats.observations import MAX_SATELLITE_NUMBER, BroadcastEphemeris, Ephemeris
from camber.formats.ubx.signal_ids import GNSS_IDS
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

SubframeResult = BroadcastEphemeris | IonosphereCoefficients
# Signals by message: LNAV on L1 C/A, I/NAV on E1-B and E5b, D1 and D2 on B1I, B2I, B3I; GLONASS' strings on L1, L2.
_LNAV_SIGNALS, _INAV_SIGNALS, _D1_SIGNALS, _D2_SIGNALS = (0,), (1, 5), (0, 2, 4), (1, 3, 10)
_GLONASS_SIGNALS, _CHANNEL_OFFSET = (0, 2), 7  # UBX-18010854, 3.17.9: freqId is the frequency channel plus 7
_FRAME_NS = 30 * NS_PER_SECOND  # ICD GLONASS 5.1, 4.3.2
_SYSTEMS = {gnss_id: letter for letter, gnss_id in GNSS_IDS.items()}
# RINEX 3.04, table A8: I/NAV from E1-B and E5b, with the clock of E5b, E1.
_INAV_SOURCE = 517.0
_SECONDS_PER_WEEK = NS_PER_WEEK // NS_PER_SECOND


@dataclass(frozen=True, slots=True, kw_only=True)
class SubframeWords:
    """Content of an RXM-SFRBX message, in the numbers of u-blox; `frequency_id` counts for GLONASS alone."""

    gnss_id: int
    satellite: int
    signal_id: int
    words: Sequence[int]
    frequency_id: int = 0


class EphemerisAssembler:
    """Collects, by satellite and signal, the parts of the ephemeris that is being transmitted.

    An ephemeris is returned as soon as all its parts are there and consistent, then again only from new parts: once per
    frame. GPS and QZSS: subframes 1 to 3 with one issue of data. Galileo: words 1 to 4 with one IODnav, and the last
    word 5. BeiDou does not number the issue in all parts: those of one period of 30 s. GLONASS does in none: strings 1
    to 4, one after another.
    """

    def __init__(self) -> None:
        self._parts: dict[tuple[int, int], dict[int, Mapping[str, int]]] = {}
        self._period_starts: dict[tuple[int, int], int] = {}

    def take(self, subframe: SubframeWords, near_ns: int) -> list[SubframeResult] | None:
        """Return the results that a subframe completes, with `near_ns` as transmission time.

        None for systems and messages that are not supported. Raises ValueError where the words fail their parity or
        CRC, or are inconsistent.
        """
        system, number = _SYSTEMS.get(subframe.gnss_id, ""), subframe.satellite
        if not system:
            return None
        if not 1 <= number <= MAX_SATELLITE_NUMBER[system]:
            raise ValueError(f"satellite {number} of {system}")
        key = ord(system) << 8 | number, subframe.signal_id
        if system in "GJ" and subframe.signal_id in _LNAV_SIGNALS:
            return self._lnav(system, key, subframe.words, near_ns)
        if system == "E" and subframe.signal_id in _INAV_SIGNALS:
            return self._inav(key, subframe.words, near_ns)
        if system == "R" and subframe.signal_id in _GLONASS_SIGNALS:
            return self._glonass(key, subframe, near_ns)
        if system == "C" and subframe.signal_id in _D1_SIGNALS:
            part = decode_d1_subframe(subframe.words)
            return self._beidou(key, part, near_ns, numbers=(1, 2, 3), length_s=D1_SUBFRAME_S)
        if system == "C" and subframe.signal_id in _D2_SIGNALS:
            page = decode_d2_page(subframe.words)
            if page is None:
                return []
            return self._beidou(key, page, near_ns, numbers=D2_PAGES, length_s=D2_FRAME_S)
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
        self,
        key: tuple[int, int],
        part: BeidouPart,
        near_ns: int,
        *,
        numbers: tuple[int, ...],
        length_s: int,
    ) -> list[SubframeResult]:
        if part.number not in numbers:
            return []
        period_start = (part.second - length_s * (part.number - 1)) % _SECONDS_PER_WEEK
        if self._period_starts.get(key) != period_start:
            self._period_starts[key] = period_start
            self._parts[key] = {}
        results = list[SubframeResult]()
        if not part.fields.keys().isdisjoint(IONOSPHERE_FIELDS):
            ionosphere = {name: part.fields[name] for name in IONOSPHERE_FIELDS}
            # Satellites without a model send zeros.
            if any(ionosphere.values()):
                coefficients = combine_parts([ionosphere], IONOSPHERE_FIELDS)
                results.append(coefficients_from_integers("C", coefficients))
        # An ephemeris removes its parts, and parts of the same period may be received once more.
        parts = self._parts.setdefault(key, {})
        parts[part.number] = {n: value for n, value in part.fields.items() if n not in IONOSPHERE_FIELDS}
        return [*results, self._ephemeris("C", key, near_ns)] if len(parts) == len(numbers) else results

    def _glonass(self, key: tuple[int, int], subframe: SubframeWords, near_ns: int) -> list[SubframeResult]:
        number, fields = decode_string(subframe.words)
        if number not in STRINGS:
            return []
        if number == 1:
            self._parts[key], self._period_starts[key] = {}, near_ns
        parts = self._parts.get(key, {})
        in_turn = list(parts) == list(range(1, number))
        if not in_turn or abs(near_ns - self._period_starts[key]) > _FRAME_NS:
            self._parts.pop(key, None)
            return []
        parts[number] = fields
        if number < len(STRINGS):
            return []
        integers = {name: value for part in self._parts.pop(key).values() for name, value in part.items()}
        if integers["satellite"] != key[0] & 255:
            raise ValueError(f"string 4 of satellite {integers['satellite']}, expected {key[0] & 255}")
        channel = subframe.frequency_id - _CHANNEL_OFFSET
        return [glonass_ephemeris_from_integers(integers, channel=channel, near_ns=near_ns)]

    def _ephemeris(self, system: str, key: tuple[int, int], near_ns: int) -> Ephemeris:
        """Return the ephemeris of all parts of the satellite, and remove them."""
        integers = combine_parts(self._parts.pop(key).values(), FIELDS[system])
        return plausible_ephemeris(system, {**integers, "satellite": key[0] & 255}, near_ns)

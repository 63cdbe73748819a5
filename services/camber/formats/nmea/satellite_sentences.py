"""GSV and GSA: the satellites in view by system and signal, and which of them the position uses.

Source: NMEA 0183 v4.11, 6.3. A group of GSV sentences lists the satellites of one talker and, from 4.10 on, of one
signal. Each satellite stands for itself: a sentence that is missing costs its own satellites only. GSA has room for
twelve satellites. Some receivers continue in a further sentence of the same system, others leave the rest out: after a
full sentence, whether the position uses the satellites not listed is not known.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from camber.formats.nmea.satellite_numbers import SYSTEM_OF_ID, SYSTEM_OF_TALKER, satellite_of
from camber.formats.nmea.sentences import SentenceFields
from camber.formats.receiver.satellite_report import ReportedSatellite, direction_rad
from camber.schemas.gnss import SatelliteUse

KINDS = ("GSV", "GSA")
_TALKERS = {"GN", *SYSTEM_OF_TALKER}
_SIGNAL = re.compile(r"[0-9A-Fa-f]?")
_HEADER, _ROW = 3, 4  # fields of GSV
_SLOTS = range(2, 14)  # fields of GSA
_SYSTEM_ID = 17  # field of GSA
_MAX_NUMBER = 999  # chosen: no receiver has greater ones
_ID_OF_SYSTEM = {letter: number for number, letter in SYSTEM_OF_ID.items()} | {"S": "1"}
_Direction = tuple[float, float] | None


class SatelliteSentences:
    """The satellites since the last `take_view`; of repeated reports of a satellite and signal the last counts."""

    def __init__(self) -> None:
        self.incomplete = 0
        """Groups of GSV with a missing or repeated sentence."""
        self.unknown_satellites = 0
        """Satellites without a number, or with one that their system does not have."""
        self._due: dict[tuple[str, str], int] = {}
        self._clear()

    def _clear(self) -> None:
        self._has_view = self._has_use = False
        self._view: dict[int, dict[str, tuple[_Direction, float | None]]] = {}
        self._used: dict[int, None] = {}
        self._is_full: dict[str, bool] = {}

    def take(self, kind: str, fields: SentenceFields) -> None:
        """Add one sentence. Raises FormatError where a field is malformed; it is then not used at all."""
        if fields.talker not in _TALKERS:
            return
        if kind == "GSV":
            self._add_view(fields)
        else:
            self._add_use(fields)

    def take_view(self) -> tuple[ReportedSatellite, ...] | None:
        """Return the satellites and begin anew; None without GSV."""
        satellites = tuple(self._satellites()) if self._has_view else None
        self._clear()
        return satellites

    def _satellites(self) -> Iterator[ReportedSatellite]:
        """Used satellites without GSV, too: they have no direction."""
        for satellite in dict.fromkeys([*self._view, *self._used]):
            rows = self._view.get(satellite, {}).values()
            direction = next((direction for direction, _ in rows if direction is not None), None)
            cn0_dbhz = max((level for _, level in rows if level is not None), default=None)
            yield ReportedSatellite(satellite, direction, cn0_dbhz, self._use(satellite, cn0_dbhz))

    def _use(self, satellite: int, cn0_dbhz: float | None) -> SatelliteUse:
        if satellite in self._used:
            return "used"
        if cn0_dbhz is None:
            return "no_pseudorange"
        of_system = _ID_OF_SYSTEM[chr(satellite >> 8)]
        cut_short = any(
            full for key, full in self._is_full.items() if key == of_system or key not in SYSTEM_OF_ID
        )
        return "use_not_reported" if cut_short or not self._has_use else "reason_not_reported"

    def _add_view(self, fields: SentenceFields) -> None:
        rows, rest = divmod(fields.count - _HEADER, _ROW)
        if rows < 0 or rest > 1:
            raise fields.error(0, "fields", "three, four for each satellite, and a signal id")
        signal = fields.text(fields.count - 1) if rest else ""
        if not _SIGNAL.fullmatch(signal):
            raise fields.error(fields.count - 1, "signal id", "one hexadecimal digit")
        parts = fields.optional_number(0, "sentences", 1, 99)
        part = fields.optional_number(1, "sentence", 1, 99)
        starts = range(_HEADER, _HEADER + _ROW * rows, _ROW)
        # Some receivers fill the last sentence up with empty fields.
        read = [self._row(fields, at) for at in starts if any(map(fields.text, range(at, at + _ROW)))]
        self._has_view = True
        self._check_order((fields.talker, signal), part, parts)
        for satellite, values in read:
            if satellite is None:
                self.unknown_satellites += 1
            else:
                self._view.setdefault(satellite, {})[signal] = values

    def _row(self, fields: SentenceFields, at: int) -> tuple[int | None, tuple[_Direction, float | None]]:
        elevation_deg = fields.optional_number(at + 1, "elevation", -99, 99)
        azimuth_deg = fields.optional_number(at + 2, "azimuth", -999, 999)
        cn0_dbhz = fields.optional_number(at + 3, "C/N0", 0, 99)
        return _satellite(fields, at, ""), (direction_rad(azimuth_deg, elevation_deg), cn0_dbhz or None)

    def _check_order(self, group: tuple[str, str], part: float | None, parts: float | None) -> None:
        due = self._due.pop(group, None)
        # Some receivers leave the number of sentences out after the first; a stream may begin within a group.
        if part is None or parts is None or (due is None and part != 1):
            return
        self.incomplete += part != (due or 1)
        self._due[group] = int(part % parts) + 1

    def _add_use(self, fields: SentenceFields) -> None:
        system_id = fields.text(_SYSTEM_ID)
        slots = [at for at in _SLOTS if fields.text(at)]
        satellites = [_satellite(fields, at, system_id) for at in slots]
        self._has_use = True
        known = [satellite for satellite in satellites if satellite is not None]
        self.unknown_satellites += len(satellites) - len(known)
        self._used |= dict.fromkeys(known)
        # Without a system id, of the first satellite's system.
        key = system_id if system_id in SYSTEM_OF_ID else chr(known[0] >> 8) if known else ""
        self._is_full[key] = len(slots) == len(_SLOTS)


def _satellite(fields: SentenceFields, at: int, system_id: str) -> int | None:
    """Return the satellite of a field; None where it is empty or not known."""
    number = fields.optional_number(at, "satellite", 0, _MAX_NUMBER)
    if number is not None and not fields.text(at).isdigit():
        raise fields.error(at, "satellite", f"a whole number from 0 to {_MAX_NUMBER}")
    system = SYSTEM_OF_ID.get(system_id) or SYSTEM_OF_TALKER.get(fields.talker, "")
    # Satellites of other systems stand in sentences of GPS before NMEA 4.10.
    system = "" if system == "G" and not system_id else system
    return None if number is None else satellite_of(system, int(number))

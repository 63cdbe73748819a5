"""The broadcast ephemerides that came, and for each epoch which one of a satellite is in use."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    SPEED_OF_LIGHT_M_S,
    Ephemeris,
    Integers,
    satellite_name,
)
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.gnss.observations.satellite_states import (
    ELEMENTS,
    MOST_BANDS,
    EphemerisTable,
)

Refusal = Literal["system", "not_finite", "orbit", "clock", "times", "unhealthy"]
"""Why an ephemeris is not taken; `unhealthy` ones are kept and not used."""
Lack = Literal["none", "too_old", "unhealthy"]
"""Why a satellite has no row: nothing came, |t − toe| is beyond the limit, or what would be used says unhealthy."""

_HOUR_NS = 3600 * NS_PER_SECOND
OLDEST_NS = {"G": 2 * _HOUR_NS, "J": 2 * _HOUR_NS, "E": 4 * _HOUR_NS, "C": 6 * _HOUR_NS}
"""Greatest |t − toe|: GPS and QZSS half of the nominal fit interval (IS-GPS-200N, 20.3.4.4), Galileo 4 h (Galileo OS
SDD 1.3, C.4.4.1), BeiDou 6 h, longer than its own hour, as receivers do while a satellite is out of their sight."""
_FARTHEST_TRANSMISSION_NS = 12 * _HOUR_NS
_NEVER_NS = 2**63 - 1
_INAV, _FNAV = 0, 1
_SATELLITES = 128 << 8
_HEALTHY, _SYSTEM_IS_GALILEO, _KIND, _LIMIT_NS = range(4)


class _Kept(NamedTuple):
    """An ephemeris and its row."""

    ephemeris: Ephemeris
    elements: tuple[float, ...]
    group_delay_s: tuple[float, ...]


def gravity_m3_s2(system: str) -> float:
    """The earth's gravitational constant in a system's interface document."""
    return 3.9860050e14 if system in "GJ" else 3.986004418e14


def is_healthy(ephemeris: Ephemeris) -> bool:
    """No word of health says otherwise; QZSS's lowest bit is that of LEX (now L1C/B), which is not used here."""
    return ephemeris.health & (~1 if chr(ephemeris.satellite >> 8) == "J" else ~0) == 0


def refusal(ephemeris: Ephemeris) -> Refusal | None:
    """Why an ephemeris cannot be meant as it stands, if so; health apart."""
    e = ephemeris
    known = 0 < e.satellite < _SATELLITES and chr(e.satellite >> 8) in OLDEST_NS
    if not (known and 0 < e.satellite & 255 < 100):
        return "system"
    values = (
        e.sqrt_a, e.eccentricity, e.inclination_rad, e.inclination_rate_rad_s, e.ascending_node_rad,
        e.ascending_node_rate_rad_s, e.perigee_rad, e.mean_anomaly_rad, e.mean_motion_difference_rad_s,
        e.cuc, e.cus, e.crc_m, e.crs_m, e.cic, e.cis, *e.clock,
    )  # fmt: skip
    if not all(map(math.isfinite, values)):
        return "not_finite"
    # From half of a medium orbit's radius to twice a synchronous one's; Galileo's stray satellites have e = 0.17.
    if not (3500.0 < e.sqrt_a < 9200.0 and 0.0 <= e.eccentricity < 0.5):
        return "orbit"
    if not (abs(e.clock[0]) < 0.1 and abs(e.clock[1]) < 1e-6 and abs(e.clock[2]) < 1e-9):
        return "clock"
    sent_ns = e.transmission_ns if e.transmission_ns > 0 else e.toe_ns  # not known: RINEX lets it be absent
    far = max(abs(e.toe_ns - sent_ns), abs(e.toe_ns - e.toc_ns)) > _FARTHEST_TRANSMISSION_NS
    return "times" if far else None


class EphemerisStore:
    """Keeps the last few ephemerides of each satellite as columns; pure, in the order of what comes.

    One kind of Galileo's messages serves all its satellites of an epoch, as clocks of F/NAV and I/NAV differ: the kind
    that more satellites have in use, I/NAV where that is equal. Between sets of one satellite the nearest toe decides;
    one that was sent after the epoch is used where it is there.

    `most_of_satellite` sets of one satellite and kind of message are kept, the last that came: eight are two hours of
    Galileo's, which change every ten minutes, and more than that of others. Who adds a whole day at once sets more.
    """

    def __init__(self, most_of_satellite: int = 8) -> None:
        self._most = most_of_satellite
        self.refused: Counter[Refusal] = Counter()
        """Ephemerides that were refused, and those that came unhealthy, by reason."""
        self.duplicates = 0
        self._sets: dict[tuple[int, int], list[_Kept]] = {}
        self._changed = False
        self._from_ns, self._until_ns = 0, -1
        self._choice = np.full(_SATELLITES, -1, np.int64)
        self._table = _table([])
        self._flags = np.empty((0, 4), np.int64)

    def __len__(self) -> int:
        return sum(map(len, self._sets.values()))

    def add(self, ephemeris: Ephemeris) -> Refusal | None:
        """Take one; None, or why it is not used. The same once more is ignored, a set sent anew replaces the old."""
        reason = refusal(ephemeris)
        if reason is not None:
            self.refused[reason] += 1
            return reason
        sets = self._sets.setdefault((ephemeris.satellite, _kind(ephemeris)), [])
        state: Refusal | None = None if is_healthy(ephemeris) else "unhealthy"
        for place, (other, _, _) in enumerate(sets):
            if (other.toe_ns, other.toc_ns) != (ephemeris.toe_ns, ephemeris.toc_ns):
                continue
            # The numbers of two sources are rounded in their own ways: the issue says whether they are the same.
            if (other.iode, other.health) == (ephemeris.iode, ephemeris.health):
                self.duplicates += 1
                return state
            if 0 < ephemeris.transmission_ns < other.transmission_ns:
                self.duplicates += 1
                return None if is_healthy(other) else "unhealthy"
            sets[place] = _kept(ephemeris)
            break
        else:
            sets.append(_kept(ephemeris))
            del sets[: -self._most]
        self._changed = True
        if state:
            self.refused[state] += 1
        return state

    @property
    def table(self) -> EphemerisTable:
        """The rows that `rows_at` names; another object when something was added."""
        if self._changed:
            self._rebuild()
        return self._table

    def rows_at(self, time_ns: int, satellites: Integers) -> Integers:
        """For satellites (m,) the rows of `table` (m,) to be used at a time, −1 where there is none."""
        table = self.table
        if not self._from_ns <= time_ns < self._until_ns:
            self._from_ns, self._until_ns = _choose(
                table.satellite, table.toe_ns, self._flags, time_ns, self._choice
            )
        return _looked_up(self._choice, satellites)

    def lacks(self, time_ns: int, satellites: Integers) -> dict[str, Lack]:
        """By satellite's name, why it has no row at a time; for health, not for every epoch."""
        rows = self.rows_at(time_ns, satellites)
        return {
            satellite_name(number): self._lack(time_ns, number)
            for number, row in zip(satellites.tolist(), rows.tolist(), strict=True)
            if row < 0
        }

    def _lack(self, time_ns: int, satellite: int) -> Lack:
        sets = [kept.ephemeris for kind in (_INAV, _FNAV) for kept in self._sets.get((satellite, kind), [])]
        if not sets:
            return "none"
        young = [e for e in sets if abs(time_ns - e.toe_ns) <= OLDEST_NS[chr(satellite >> 8)]]
        if not young:
            return "too_old"
        # What is left is of the kind of message that the other satellites do not use.
        return "unhealthy" if not all(map(is_healthy, young)) else "none"

    def _rebuild(self) -> None:
        ordered = [(kept, kind) for (_, kind), sets in sorted(self._sets.items()) for kept in sets]
        self._table = _table([kept for kept, _ in ordered])
        flags = [
            (is_healthy(e), chr(e.satellite >> 8) == "E", kind, OLDEST_NS[chr(e.satellite >> 8)])
            for (e, _, _), kind in ordered
        ]
        self._flags = np.array(flags, np.int64).reshape(-1, 4)
        self._changed = False
        self._from_ns, self._until_ns = 0, -1


def _kind(ephemeris: Ephemeris) -> int:
    """RINEX 3.04, table A8: bit 0 I/NAV of E1-B, bit 1 F/NAV, bit 2 I/NAV of E5b-I. Without it, I/NAV."""
    sources = ephemeris.other.get("data_sources", math.nan)
    return _FNAV if math.isfinite(sources) and int(sources) & 0b111 == 0b010 else _INAV


def _kept(ephemeris: Ephemeris) -> _Kept:
    delays = group_delays_s(ephemeris)
    row = tuple(delays.get(str(band), math.nan) for band in range(MOST_BANDS))
    return _Kept(ephemeris, _elements(ephemeris), row)


def _table(kept: list[_Kept]) -> EphemerisTable:
    return EphemerisTable(
        np.array([e.satellite for e, _, _ in kept], np.int64),
        np.array([e.toe_ns for e, _, _ in kept], np.int64),
        np.array([e.toc_ns for e, _, _ in kept], np.int64),
        np.array([elements for _, elements, _ in kept], np.float64).reshape(-1, ELEMENTS),
        np.array([delays for _, _, delays in kept], np.float64).reshape(-1, MOST_BANDS),
    )


def _elements(e: Ephemeris) -> tuple[float, ...]:
    """In the order of the columns' names in `satellite_states`."""
    system, number = chr(e.satellite >> 8), e.satellite & 255
    gravity = gravity_m3_s2(system)
    a = e.sqrt_a**2
    behind_ns = 14 * NS_PER_SECOND if system == "C" else 0
    return (
        ((e.toe_ns - behind_ns) % NS_PER_WEEK) / NS_PER_SECOND,
        a,
        e.eccentricity,
        math.sqrt(1.0 - e.eccentricity**2),
        math.sqrt(gravity / a**3) + e.mean_motion_difference_rad_s,
        e.mean_anomaly_rad,
        math.sin(e.perigee_rad),
        math.cos(e.perigee_rad),
        e.inclination_rad,
        e.inclination_rate_rad_s,
        e.ascending_node_rad,
        e.ascending_node_rate_rad_s,
        e.cuc, e.cus, e.crc_m, e.crs_m, e.cic, e.cis,
        *e.clock,
        -2.0 * math.sqrt(gravity) / SPEED_OF_LIGHT_M_S**2 * e.eccentricity * e.sqrt_a,
        7.292115e-5 if system == "C" else 7.2921151467e-5,
        1.0 if system == "C" and (number <= 5 or number >= 59) else 0.0,
    )  # fmt: skip


def group_delays_s(ephemeris: Ephemeris) -> dict[str, float]:
    """By band, what code comes late by [s] against the broadcast clock; bands without a known delay are left out.

    GPS, QZSS: γ TGD (IS-GPS-200N, 20.3.3.3.3.2), where γ = (f₁/f)²; between codes of one band (ISC) nothing is known
    from these messages. Galileo: I/NAV's clock is that of E1 and E5b, F/NAV's that of E1 and E5a without ionosphere
    (OS SIS ICD 2.1, 5.1.5): of the first signal BGD, of the second γ BGD, of the third, where both BGD are known, from
    their definition BGD(E1, x) = (τ₁ − τₓ)/(1 − γₓ). BeiDou: B1I TGD1, B2I TGD2, B3I none (BDS-SIS-ICD-B1I,
    5.2.4.10); the other bands are scaled from B1I.
    """
    system, other = chr(ephemeris.satellite >> 8), ephemeris.other
    carriers = CARRIER_OF_BAND_HZ[system]
    first = "2" if system == "C" else "1"
    gamma = {band: (carriers[first] / hz) ** 2 for band, hz in carriers.items()}
    delays: dict[str, float] = {}
    if system in "GJ" and "tgd_s" in other:
        delays = {band: g * other["tgd_s"] for band, g in gamma.items()}
    elif system == "C" and "tgd1_s" in other:
        delays = {band: g * other["tgd1_s"] for band, g in gamma.items()}
        delays["6"] = 0.0
        if "tgd2_s" in other:
            delays["7"] = other["tgd2_s"]
    elif system == "E":
        bgd = {band: other[name] for band, name in (("5", "bgd_e5a_s"), ("7", "bgd_e5b_s")) if name in other}
        of_clock = "5" if _kind(ephemeris) == _FNAV else "7"
        if of_clock in bgd:
            tau = bgd[of_clock]
            delays = {"1": tau} | {band: tau - (1.0 - gamma[band]) * of for band, of in bgd.items()}
    return {band: delay for band, delay in delays.items() if math.isfinite(delay)}


@compiled
def _looked_up(choice: Integers, satellites: Integers) -> Integers:
    rows = np.empty(satellites.size, np.int64)
    for k in range(satellites.size):
        s = satellites[k]
        rows[k] = choice[s] if 0 <= s < choice.size else -1
    return rows


@compiled
def _choose(
    satellite: Integers, toe_ns: Integers, flags: Integers, time_ns: int, choice: Integers
) -> tuple[int, int]:
    """Writes the row of every satellite to `choice`; gives the times between which nothing of it changes.

    An unhealthy set takes the place that its toe gives it, and then there is none: the older healthy one is history.
    """
    from_ns, until_ns = 0, _NEVER_NS
    nearest = np.full((2, choice.size), -1, np.int64)
    for row in range(satellite.size):
        toe, limit = toe_ns[row], flags[row, _LIMIT_NS]
        # Its coming into use and its going out of it; a midpoint between two is looked at below.
        for edge in (toe - limit, toe + limit + 1):
            if edge <= time_ns:
                from_ns = max(from_ns, edge)
            else:
                until_ns = min(until_ns, edge)
        if abs(time_ns - toe) > limit:
            continue
        kind, s = flags[row, _KIND], satellite[row]
        best = nearest[kind, s]
        if best < 0 or abs(time_ns - toe) <= abs(time_ns - toe_ns[best]):
            nearest[kind, s] = row
    for row in range(satellite.size):
        best = nearest[flags[row, _KIND], satellite[row]]
        if best < 0:
            continue
        # One nanosecond to either side costs another choice, not a wrong one.
        middle = toe_ns[row] + (toe_ns[best] - toe_ns[row]) // 2
        if middle < time_ns - 1:
            from_ns = max(from_ns, middle + 2)
        elif middle > time_ns + 1:
            until_ns = min(until_ns, middle - 1)
        elif row != best:
            from_ns, until_ns = time_ns, time_ns + 1
    in_use = np.zeros(2, np.int64)
    for row in range(satellite.size):
        kind, s = flags[row, _KIND], satellite[row]
        if nearest[kind, s] == row and flags[row, _SYSTEM_IS_GALILEO] and flags[row, _HEALTHY]:
            in_use[kind] += 1
    galileo = _FNAV if in_use[_FNAV] > in_use[_INAV] else _INAV
    choice[:] = -1
    for row in range(satellite.size):
        kind, s = flags[row, _KIND], satellite[row]
        of_kind = galileo if flags[row, _SYSTEM_IS_GALILEO] else _INAV
        if kind == of_kind and nearest[kind, s] == row and flags[row, _HEALTHY]:
            choice[s] = row
    return from_ns, until_ns

"""Store of broadcast ephemerides; selects the one of each satellite to be used at an epoch."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    GLONASS_CHANNELS,
    SPEED_OF_LIGHT_M_S,
    BroadcastEphemeris,
    Ephemeris,
    GlonassEphemeris,
    Integers,
    satellite_name,
)
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.gnss.observations.glonass_orbit import STATE
from camber.gnss.observations.satellite_states import AF0_S, AF1, ELEMENTS, EphemerisTable
from camber.gnss.observations.signal_pairs import MOST_BANDS

Refusal = Literal["system", "not_finite", "orbit", "clock", "times", "unhealthy"]
"""Why an ephemeris is refused; `unhealthy` ones are kept and not used."""
MissingReason = Literal["none", "too_old", "unhealthy"]
"""Why a satellite has no row: none received, |t − toe| beyond the limit, or the one to be used says unhealthy."""

_HOUR_NS = 3600 * NS_PER_SECOND
OLDEST_NS = {"G": 2 * _HOUR_NS, "J": 2 * _HOUR_NS, "E": 4 * _HOUR_NS, "C": 6 * _HOUR_NS, "R": _HOUR_NS // 2}
"""Greatest |t − toe|: GPS and QZSS half of the nominal fit interval (IS-GPS-200N, 20.3.4.4), Galileo 4 h (Galileo OS
SDD 1.3, C.4.4.1), BeiDou 6 h, longer than its nominal hour, as receivers do while a satellite is out of view. GLONASS
half an hour: twice the nominal quarter (ICD GLONASS 5.1, A.3.1.2), until the next set has been received."""
_FARTHEST_TRANSMISSION_NS = 12 * _HOUR_NS  # chosen: twice the longest age
_NEVER_NS = 2**63 - 1  # end of int64
_INAV, _FNAV = 0, 1
_SATELLITES = 128 << 8  # numbers: letter × 256 + PRN
_HEALTHY, _SYSTEM_IS_GALILEO, _KIND, _LIMIT_NS = range(4)


class _EphemerisRow(NamedTuple):
    """An ephemeris and its row of the table."""

    ephemeris: BroadcastEphemeris
    elements: tuple[float, ...]
    group_delay_s: tuple[float, ...]
    state: tuple[float, ...]
    channel: int


def gravity_m3_s2(system: str) -> float:
    """The earth's gravitational constant in a system's interface document."""
    return 3.9860050e14 if system in "GJ" else 3.986004418e14


def is_healthy(ephemeris: BroadcastEphemeris) -> bool:
    """Whether the health bits are clear; QZSS's lowest bit is that of LEX (now L1C/B), which is not used here."""
    return ephemeris.health & (~1 if chr(ephemeris.satellite >> 8) == "J" else ~0) == 0


def refusal(ephemeris: BroadcastEphemeris) -> Refusal | None:
    """Why an ephemeris is implausible, if so; health is not considered."""
    e = ephemeris
    known = 0 < e.satellite < _SATELLITES and chr(e.satellite >> 8) in OLDEST_NS
    of_its_system = (chr(e.satellite >> 8) == "R") == isinstance(e, GlonassEphemeris) if known else False
    if not (of_its_system and 0 < e.satellite & 255 < 100):
        return "system"
    if isinstance(e, GlonassEphemeris):
        return _refusal_of_glonass(e)
    values = (
        e.sqrt_a, e.eccentricity, e.inclination_rad, e.inclination_rate_rad_s, e.ascending_node_rad,
        e.ascending_node_rate_rad_s, e.perigee_rad, e.mean_anomaly_rad, e.mean_motion_difference_rad_s,
        e.cuc, e.cus, e.crc_m, e.crs_m, e.cic, e.cis, *e.clock,
    )  # fmt: skip
    if not all(map(math.isfinite, values)):
        return "not_finite"
    # From half of a medium orbit's radius to twice a synchronous one's; Galileo's two in wrong orbits have e = 0.17.
    if not (3500.0 < e.sqrt_a < 9200.0 and 0.0 <= e.eccentricity < 0.5):
        return "orbit"
    if not (abs(e.clock[0]) < 0.1 and abs(e.clock[1]) < 1e-6 and abs(e.clock[2]) < 1e-9):
        return "clock"
    sent_ns = e.transmission_ns if e.transmission_ns > 0 else e.toe_ns  # optional in RINEX
    far = max(abs(e.toe_ns - sent_ns), abs(e.toe_ns - e.toc_ns)) > _FARTHEST_TRANSMISSION_NS
    return "times" if far else None


def _refusal_of_glonass(e: GlonassEphemeris) -> Refusal | None:
    if not all(map(math.isfinite, (*e.position_m, *e.velocity_m_s, *e.acceleration_m_s2, *e.clock))):
        return "not_finite"
    # Circular orbits of 25,500 km, 3.95 km/s, less the earth's rotation; five bits of acceleration.
    radius_m, speed_m_s = math.hypot(*e.position_m), math.hypot(*e.velocity_m_s)
    if not (2.4e7 < radius_m < 2.7e7 and speed_m_s < 6e3 and math.hypot(*e.acceleration_m_s2) < 1e-4):
        return "orbit"
    if e.channel not in GLONASS_CHANNELS or not (abs(e.clock[0]) < 0.1 and abs(e.clock[1]) < 1e-6):
        return "clock"
    sent_ns = e.transmission_ns if e.transmission_ns > 0 else e.toe_ns
    return "times" if abs(e.toe_ns - sent_ns) > _FARTHEST_TRANSMISSION_NS else None


class EphemerisStore:
    """The last ephemerides of each satellite, as columns.

    One kind of Galileo's messages serves all its satellites of an epoch, as clocks of F/NAV and I/NAV differ: the kind
    that more satellites have in use, I/NAV where that is equal. Between sets of one satellite the nearest toe decides,
    even if it was transmitted after the epoch.

    The last `most_of_satellite` sets of one satellite and kind of message are kept: eight are two hours of Galileo's,
    which change every ten minutes, and more than that of others. A whole day at once needs more.
    """

    def __init__(self, most_of_satellite: int = 8) -> None:
        self._most = most_of_satellite
        self.refused: Counter[Refusal] = Counter()
        """Ephemerides that were refused, and those that came unhealthy, by reason."""
        self.duplicates = 0
        self._sets: dict[tuple[int, int], list[_EphemerisRow]] = {}
        self._changed = False
        self._from_ns, self._until_ns = 0, -1
        self._choice = np.full(_SATELLITES, -1, np.int64)
        self._table = _table([])
        self._flags = np.empty((0, 4), np.int64)

    def __len__(self) -> int:
        return sum(map(len, self._sets.values()))

    def add(self, ephemeris: BroadcastEphemeris) -> Refusal | None:
        """Add one; None, or why it is not used. Repetitions are ignored, a newer transmission replaces the old."""
        reason = refusal(ephemeris)
        if reason is not None:
            self.refused[reason] += 1
            return reason
        sets = self._sets.setdefault((ephemeris.satellite, _kind(ephemeris)), [])
        state: Refusal | None = None if is_healthy(ephemeris) else "unhealthy"
        for place, (other, *_) in enumerate(sets):
            if (other.toe_ns, other.toc_ns) != (ephemeris.toe_ns, ephemeris.toc_ns):
                continue
            # Two sources round the numbers differently: the issue of data identifies a set.
            if (other.iode, other.health) == (ephemeris.iode, ephemeris.health):
                self.duplicates += 1
                return state
            if 0 < ephemeris.transmission_ns < other.transmission_ns:
                self.duplicates += 1
                return None if is_healthy(other) else "unhealthy"
            sets[place] = _row(ephemeris)
            break
        else:
            sets.append(_row(ephemeris))
            del sets[: -self._most]
        self._changed = True
        if state:
            self.refused[state] += 1
        return state

    @property
    def table(self) -> EphemerisTable:
        """The table that `rows_at` indexes; a new object when something was added."""
        if self._changed:
            self._rebuild()
        return self._table

    def rows_at(self, time_ns: int, satellites: Integers) -> Integers:
        """Rows of `table` (m,) to be used for satellites (m,) at a time, −1 where there is none."""
        table = self.table
        if not self._from_ns <= time_ns < self._until_ns:
            self._from_ns, self._until_ns = _choose(table, self._flags, time_ns, self._choice)
        return _looked_up(self._choice, satellites)

    def missing(self, time_ns: int, satellites: Integers) -> dict[str, MissingReason]:
        """Satellites without a row at a time, by name, with the reason; for health, not for every epoch."""
        rows = self.rows_at(time_ns, satellites)
        return {
            satellite_name(number): self._missing_reason(time_ns, number)
            for number, row in zip(satellites.tolist(), rows.tolist(), strict=True)
            if row < 0
        }

    def _missing_reason(self, time_ns: int, satellite: int) -> MissingReason:
        sets = [row.ephemeris for kind in (_INAV, _FNAV) for row in self._sets.get((satellite, kind), [])]
        if not sets:
            return "none"
        young = [e for e in sets if abs(time_ns - e.toe_ns) <= OLDEST_NS[chr(satellite >> 8)]]
        if not young:
            return "too_old"
        # The remaining ones are of the kind of message that the other satellites do not use.
        return "unhealthy" if not all(map(is_healthy, young)) else "none"

    def _rebuild(self) -> None:
        ordered = [(row, kind) for (_, kind), sets in sorted(self._sets.items()) for row in sets]
        self._table = _table([row for row, _ in ordered])
        flags = [
            (is_healthy(e), chr(e.satellite >> 8) == "E", kind, OLDEST_NS[chr(e.satellite >> 8)])
            for (e, *_), kind in ordered
        ]
        self._flags = np.array(flags, np.int64).reshape(-1, 4)
        self._changed = False
        self._from_ns, self._until_ns = 0, -1


def _kind(ephemeris: BroadcastEphemeris) -> int:
    """RINEX 3.04, table A8: bit 0 I/NAV of E1-B, bit 1 F/NAV, bit 2 I/NAV of E5b-I. Without it, I/NAV."""
    if isinstance(ephemeris, GlonassEphemeris):
        return _INAV
    sources = ephemeris.other.get("data_sources", math.nan)
    return _FNAV if math.isfinite(sources) and int(sources) & 0b111 == 0b010 else _INAV


def _row(ephemeris: BroadcastEphemeris) -> _EphemerisRow:
    delays = group_delays_s(ephemeris)
    by_band = tuple(delays.get(str(band), math.nan) for band in range(MOST_BANDS))
    if isinstance(ephemeris, GlonassEphemeris):
        state = (*ephemeris.position_m, *ephemeris.velocity_m_s, *ephemeris.acceleration_m_s2)
        elements = _clock_elements(ephemeris)
        return _EphemerisRow(ephemeris, elements, by_band, state=state, channel=ephemeris.channel)
    no_state = (math.nan,) * STATE
    return _EphemerisRow(ephemeris, _elements(ephemeris), by_band, state=no_state, channel=0)


def _table(rows: list[_EphemerisRow]) -> EphemerisTable:
    return EphemerisTable(
        satellite=np.array([row.ephemeris.satellite for row in rows], np.int64),
        toe_ns=np.array([row.ephemeris.toe_ns for row in rows], np.int64),
        toc_ns=np.array([row.ephemeris.toc_ns for row in rows], np.int64),
        elements=np.array([row.elements for row in rows], np.float64).reshape(-1, ELEMENTS),
        group_delay_s=np.array([row.group_delay_s for row in rows], np.float64).reshape(-1, MOST_BANDS),
        state=np.array([row.state for row in rows], np.float64).reshape(-1, STATE),
        channel=np.array([row.channel for row in rows], np.int64),
    )


def _clock_elements(e: GlonassEphemeris) -> tuple[float, ...]:
    """The columns of the clock alone."""
    clock = {AF0_S: e.clock[0], AF1: e.clock[1]}
    return tuple(clock.get(column, math.nan) for column in range(ELEMENTS))


def _elements(e: Ephemeris) -> tuple[float, ...]:
    """In the order of the columns' names in `satellite_states`."""
    system, number = chr(e.satellite >> 8), e.satellite & 255
    gravity = gravity_m3_s2(system)
    a = e.sqrt_a**2
    bdt_lag_ns = 14 * NS_PER_SECOND if system == "C" else 0  # of BeiDou time against GPS time
    return (
        ((e.toe_ns - bdt_lag_ns) % NS_PER_WEEK) / NS_PER_SECOND,
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


def group_delays_s(ephemeris: BroadcastEphemeris) -> dict[str, float]:
    """Group delay of code against the broadcast clock [s] by band; bands without a known delay are omitted.

    GPS, QZSS: γ TGD (IS-GPS-200N, 20.3.3.3.3.2), where γ = (f₁/f)²; inter-signal corrections (ISC) are not
    in these messages. Galileo: I/NAV's clock is that of E1 and E5b, F/NAV's that of E1 and E5a without ionosphere (OS
    SIS ICD 2.1, 5.1.5): of the first signal BGD, of the second γ BGD, of the third, where both BGD are known, from
    their definition BGD(E1, x) = (τ₁ − τₓ)/(1 − γₓ). BeiDou: B1I TGD1, B2I TGD2, B3I none (BDS-SIS-ICD-B1I,
    5.2.4.10); the other bands are scaled from B1I. GLONASS: the clock is that of L1, L2 has Δτ_n (ICD 5.1, 4.4).
    """
    if isinstance(ephemeris, GlonassEphemeris):
        return {"1": 0.0} | ({"2": ephemeris.group_delay_s} if math.isfinite(ephemeris.group_delay_s) else {})
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
def _choose(table: EphemerisTable, flags: Integers, time_ns: int, choice: Integers) -> tuple[int, int]:
    """Write the row of every satellite to `choice`; return the times between which the choice is constant.

    Where the nearest set is unhealthy there is none: an older healthy one is obsolete.
    """
    satellite, toe_ns = table.satellite, table.toe_ns
    from_ns, until_ns = 0, _NEVER_NS
    nearest = np.full((2, choice.size), -1, np.int64)
    for row in range(satellite.size):
        toe, limit = toe_ns[row], flags[row, _LIMIT_NS]
        # Begin and end of its use; midpoints between two sets follow below.
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
        # One nanosecond to either side costs a repeated choice, not a wrong one.
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

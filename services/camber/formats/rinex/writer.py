"""RINEX 3.04 written: observation files of one receiver and mixed navigation files.

Source: IGS/RTCM, "RINEX, The Receiver Independent Exchange Format, Version 3.04" (2018), tables A2, A3 (observations),
A6, A8, A12, A14 (GPS, Galileo, QZSS, BeiDou navigation). Values that were not observed stay blank. The second digit
beside a value is the signal strength min(max(C/N0 / 6, 1), 9); the first, beside phases, bit 0 lock lost, bit 1 half
cycle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, Floats, ObservationEpoch, satellite_name, signal_name
from camber.geodesy.gps_time import (
    NS_PER_SECOND,
    NS_PER_WEEK,
    CalendarTime,
    gps_minus_utc_s,
    gpst_from_gps_ns,
)

_BDT_MINUS_GPS_NS = -14 * NS_PER_SECOND
_BDT_WEEKS = 1356
_BLANK = " " * 16
_BLANK_ROW = _BLANK * 4
_SYSTEM_ORDER = "GJEC"
_IONOSPHERE_NAMES = {"G": "GPS", "J": "QZS", "C": "BDS"}


@dataclass(frozen=True, slots=True, kw_only=True)
class StationHeader:
    """Who observed: names, and the antenna's approximate ECEF position [m]."""

    marker: str
    position_ecef_m: tuple[float, float, float]
    receiver: str = "CAMBER SIMULATED"
    antenna: str = "NONE"
    marker_type: str = "NON_GEODETIC"


def observation_text(epochs: Sequence[ObservationEpoch], station: StationHeader) -> str:
    """An observation file. Raises ValueError without epochs, or where a satellite's signals cannot be told apart."""
    return "".join(observation_lines(epochs, station))


def observation_lines(epochs: Sequence[ObservationEpoch], station: StationHeader) -> Iterator[str]:
    """As `observation_text`, piece by piece: the header, then each epoch."""
    if not epochs:
        raise ValueError("an observation file needs an epoch")
    slots = _slots(epochs)
    yield _observation_header(epochs, station, slots)
    slot_of = {
        (ord(system), signal): k for system, signals in slots.items() for k, signal in enumerate(signals)
    }
    blanks = {ord(system): [_BLANK_ROW] * len(signals) for system, signals in slots.items()}
    for epoch in epochs:
        yield _epoch_text(epoch, slot_of, blanks)


def _slots(epochs: Sequence[ObservationEpoch]) -> dict[str, list[int]]:
    """By system, in the order of the file: the signals that occur, sorted by their names."""
    both = np.unique(np.concatenate([(e.satellite >> 8) * 65536 + e.signal for e in epochs]))
    found: dict[str, list[int]] = {}
    for pair in both.tolist():
        found.setdefault(chr(pair >> 16), []).append(pair & 65535)
    order = {s: k for k, s in enumerate(_SYSTEM_ORDER)}
    return {s: found[s] for s in sorted(found, key=lambda s: (order.get(s, 99), s))}


def _epoch_text(
    epoch: ObservationEpoch, slot_of: dict[tuple[int, int], int], blanks: dict[int, list[str]]
) -> str:
    strength = _strength(epoch.cn0_dbhz)
    flags = (epoch.loss_of_lock + 2 * epoch.half_cycle).tolist()
    rows: dict[int, list[str]] = {}
    columns = zip(
        epoch.satellite.tolist(), epoch.signal.tolist(), epoch.pseudorange_m.tolist(),
        epoch.carrier_phase_cycles.tolist(), epoch.doppler_hz.tolist(), epoch.cn0_dbhz.tolist(),
        flags, strength, strict=True,
    )  # fmt: skip
    for satellite, signal, code, phase, doppler, cn0, flag, level in columns:
        # A value is not NaN where it equals itself.
        text = (
            (f"{code:14.3f} {level}" if code == code else _BLANK)
            + (f"{phase:14.3f}{flag or ' '}{level}" if phase == phase else _BLANK)
            + (f"{doppler:14.3f}  " if doppler == doppler else _BLANK)
            + (f"{cn0:14.3f}  " if cn0 == cn0 else _BLANK)
        )
        row = rows.get(satellite)
        if row is None:
            row = rows[satellite] = blanks[satellite >> 8].copy()
        slot = slot_of[satellite >> 8, signal]
        if row[slot] is not _BLANK_ROW:
            raise ValueError(
                f"{satellite_name(satellite)} has {signal_name(signal)} twice at {epoch.time_ns} ns"
            )
        row[slot] = text
    c = gpst_from_gps_ns(epoch.time_ns)
    head = f"> {c.year:4d} {c.month:02d} {c.day:02d} {c.hour:02d} {c.minute:02d} {_seconds(c, 7)}  0{len(rows):3d}\n"
    body = [f"{satellite_name(s)}{''.join(row).rstrip()}\n" for s, row in rows.items()]
    return head + "".join(body)


def _strength(cn0_dbhz: Floats) -> list[int | str]:
    """The digits that stand for C/N0, a blank where it is not known."""
    levels = np.clip(np.nan_to_num(cn0_dbhz) // 6.0, 1, 9).astype(np.int64).tolist()
    return [level if known else " " for level, known in zip(levels, np.isfinite(cn0_dbhz), strict=True)]


def _seconds(c: CalendarTime, decimals: int) -> str:
    """Seconds in F11.7 or the like, cut, not rounded up to 60: the format's last digit is 100 ns."""
    whole = f"{c.nanosecond:09d}"[:decimals]
    return f"{c.second:2d}.{whole}".rjust(3 + decimals)


def _line(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}".rstrip() + "\n"


def _observation_header(
    epochs: Sequence[ObservationEpoch], station: StationHeader, slots: dict[str, list[int]]
) -> str:
    first, last = gpst_from_gps_ns(epochs[0].time_ns), gpst_from_gps_ns(epochs[-1].time_ns)
    x, y, z = station.position_ecef_m
    lines = [
        _line(f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M':<20}", "RINEX VERSION / TYPE"),
        # The date of the first epoch, not of writing: the same observations give the same bytes.
        _line(f"{'camber':<20}{'camber':<20}{_stamp(first)} GPS ", "PGM / RUN BY / DATE"),
        _line(f"{station.marker:<60}", "MARKER NAME"),
        _line(f"{station.marker:<20}", "MARKER NUMBER"),
        _line(f"{station.marker_type:<20}", "MARKER TYPE"),
        _line(f"{'camber':<20}{'camber':<40}", "OBSERVER / AGENCY"),
        _line(f"{'1':<20}{station.receiver:<20}{'1':<20}", "REC # / TYPE / VERS"),
        _line(f"{'1':<20}{station.antenna:<20}", "ANT # / TYPE"),
        _line(f"{x:14.4f}{y:14.4f}{z:14.4f}", "APPROX POSITION XYZ"),
        _line(f"{0.0:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N"),
    ]
    for system, signals in slots.items():
        types = [kind + signal_name(s) for s in signals for kind in "CLDS"]
        for k in range(0, len(types), 13):
            head = f"{system}  {len(types):3d}" if k == 0 else " " * 6
            lines.append(_line(head + "".join(f" {t}" for t in types[k : k + 13]), "SYS / # / OBS TYPES"))
    lines.append(_line("DBHZ", "SIGNAL STRENGTH UNIT"))
    if len(epochs) > 1:
        times = np.array([e.time_ns for e in epochs], np.int64)
        lines.append(_line(f"{np.median(np.diff(times)) / NS_PER_SECOND:10.3f}", "INTERVAL"))
    lines.append(_line(_header_time(first), "TIME OF FIRST OBS"))
    lines.append(_line(_header_time(last), "TIME OF LAST OBS"))
    for system, signals in slots.items():
        # Phases are given aligned to the system's reference signal: no shift is left (section 9.1).
        lines += [_line(f"{system} L{signal_name(s)}  0.00000", "SYS / PHASE SHIFT") for s in signals]
    lines.append(_line(f"{gps_minus_utc_s(epochs[0].time_ns):6d}", "LEAP SECONDS"))
    lines.append(_line("", "END OF HEADER"))
    return "".join(lines)


def _stamp(c: CalendarTime) -> str:
    return f"{c.year:04d}{c.month:02d}{c.day:02d} {c.hour:02d}{c.minute:02d}{c.second:02d}"


def _header_time(c: CalendarTime) -> str:
    return f"{c.year:6d}{c.month:6d}{c.day:6d}{c.hour:6d}{c.minute:6d}{_seconds(c, 7):>13}     GPS"


def navigation_text(
    ephemerides: Sequence[Ephemeris],
    ionosphere: Iterable[IonosphereCoefficients] = (),
) -> str:
    """A mixed navigation file, sets in the order of their times of transmission.

    Raises ValueError without ephemerides and for systems other than GPS, QZSS, Galileo, BeiDou.
    """
    if not ephemerides:
        raise ValueError("a navigation file needs an ephemeris")
    first = min(e.transmission_ns for e in ephemerides)
    lines = [
        _line(f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':<20}{'M: MIXED':<20}", "RINEX VERSION / TYPE"),
        _line(f"{'camber':<20}{'camber':<20}{_stamp(gpst_from_gps_ns(first))} GPS ", "PGM / RUN BY / DATE"),
    ]
    for coefficients in ionosphere:
        name = _IONOSPHERE_NAMES.get(coefficients.system)
        if name is None:
            raise ValueError(f"ionosphere of system {coefficients.system}, expected one of G, J, C")
        for letter, values in (("A", coefficients.alpha), ("B", coefficients.beta)):
            lines.append(
                _line(f"{name}{letter} " + "".join(f"{v:12.4E}" for v in values), "IONOSPHERIC CORR")
            )
    lines.append(_line(f"{gps_minus_utc_s(first):6d}", "LEAP SECONDS"))
    lines.append(_line("", "END OF HEADER"))
    ordered = sorted(ephemerides, key=lambda e: (e.transmission_ns, e.satellite, e.toe_ns))
    return "".join(lines) + "".join(_ephemeris_text(e) for e in ordered)


def _ephemeris_text(e: Ephemeris) -> str:
    system = chr(e.satellite >> 8)
    shift_ns = _BDT_MINUS_GPS_NS if system == "C" else 0
    c = gpst_from_gps_ns(e.toc_ns + shift_ns)
    week, toe_ns = divmod(e.toe_ns + shift_ns, NS_PER_WEEK)
    week -= _BDT_WEEKS if system == "C" else 0
    # Of transmission, counted from the beginning of toe's week.
    sent_s = (e.transmission_ns - e.toe_ns + toe_ns) / NS_PER_SECOND
    o = e.other
    if system in "GJ":
        fifth = (e.inclination_rate_rad_s, 1.0 if system == "G" else 2.0, float(week), 0.0)
        sixth = (e.accuracy_m, float(e.health), o["tgd_s"], o["iodc"])
        # QZSS gives a flag for more than two hours instead of hours (table A12).
        fit = o["fit_interval_h"]
        seventh: tuple[float, ...] = (sent_s, fit if system == "G" else float(fit > 2.0))
    elif system == "E":
        fifth = (e.inclination_rate_rad_s, o["data_sources"], float(week), 0.0)
        # −1: no accuracy is predicted (table A8).
        accuracy_m = -1.0 if math.isnan(e.accuracy_m) else e.accuracy_m
        sixth = (accuracy_m, float(e.health), o["bgd_e5a_s"], o["bgd_e5b_s"])
        seventh = (sent_s,)
    elif system == "C":
        fifth = (e.inclination_rate_rad_s, 0.0, float(week), 0.0)
        sixth = (e.accuracy_m, float(e.health), o["tgd1_s"], o["tgd2_s"])
        seventh = (sent_s, o["aodc"])
    else:
        raise ValueError(f"{satellite_name(e.satellite)}: no navigation record for this system")
    records = (
        (float(e.iode), e.crs_m, e.mean_motion_difference_rad_s, e.mean_anomaly_rad),
        (e.cuc, e.eccentricity, e.cus, e.sqrt_a),
        (toe_ns / NS_PER_SECOND, e.cic, e.ascending_node_rad, e.cis),
        (e.inclination_rad, e.crc_m, e.perigee_rad, e.ascending_node_rate_rad_s),
        fifth,
        sixth,
        seventh,
    )
    head = (
        f"{satellite_name(e.satellite)} {c.year:4d} {c.month:02d} {c.day:02d} "
        f"{c.hour:02d} {c.minute:02d} {c.second:02d}"
    )
    lines = [head + "".join(map(_number, e.clock))]
    lines += ["    " + "".join(map(_number, record)) for record in records]
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """D19.12, blanks for what is not known; a negative zero would be a difference that is none."""
    if math.isnan(value):
        return " " * 19
    return f"{value + 0.0:19.12E}"

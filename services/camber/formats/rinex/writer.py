"""RINEX 3.04 written: observation files of one receiver and mixed navigation files.

Source: IGS/RTCM, "RINEX, The Receiver Independent Exchange Format, Version 3.04" (2018), tables A2, A3 (observations),
A6, A8, A12, A14 (GPS, Galileo, QZSS, BeiDou navigation). Values that were not observed are blank. The second digit
after a value is the signal strength min(max(C/N0 / 6, 1), 9); the first, after phases, has bit 0 for loss of lock, bit
1 for half cycles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.broadcast.ephemeris_fields import system_week
from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import (
    GPS_MINUS_BDT_NS,
    Ephemeris,
    Floats,
    ObservationEpoch,
    satellite_name,
    signal_name,
)
from camber.formats.rinex.navigation_records import ORBIT, ROWS
from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_minus_utc_s, gpst_from_gps_ns

_BLANK = " " * 16
_BLANK_ROW = _BLANK * 4
_SYSTEM_ORDER = "GJEC"
_IONOSPHERE_NAMES = {"G": "GPS", "J": "QZS", "C": "BDS"}


@dataclass(frozen=True, slots=True, kw_only=True)
class StationHeader:
    """Marker of a receiver's header, and the antenna's approximate ECEF position [m]."""

    marker: str
    position_ecef_m: tuple[float, float, float]
    marker_type: str = "NON_GEODETIC"


def observation_lines(epochs: Sequence[ObservationEpoch], station: StationHeader) -> Iterator[str]:
    """Yield an observation file in parts: the header, then each epoch.

    Raises ValueError without epochs, or for a signal repeated in an epoch.
    """
    if not epochs:
        raise ValueError("an observation file needs an epoch")
    signals = _signals(epochs)
    yield _observation_header(epochs, station, signals)
    slots = {(ord(system), signal): k for system, names in signals.items() for k, signal in enumerate(names)}
    blanks = {ord(system): [_BLANK_ROW] * len(names) for system, names in signals.items()}
    for epoch in epochs:
        yield _epoch_text(epoch, slots, blanks)


def _signals(epochs: Sequence[ObservationEpoch]) -> dict[str, list[int]]:
    """Return the signals of each system, sorted by name, in the file's order of systems."""
    pairs = np.unique(np.concatenate([(e.satellite >> 8) * 65536 + e.signal for e in epochs]))
    signals: dict[str, list[int]] = {}
    for pair in pairs.tolist():
        signals.setdefault(chr(pair >> 16), []).append(pair & 65535)
    order = {s: k for k, s in enumerate(_SYSTEM_ORDER)}
    return {s: signals[s] for s in sorted(signals, key=lambda s: (order.get(s, 99), s))}


def _epoch_text(
    epoch: ObservationEpoch, slots: dict[tuple[int, int], int], blanks: dict[int, list[str]]
) -> str:
    rows: dict[int, list[str]] = {}
    columns = zip(
        *(epoch.satellite.tolist(), epoch.signal.tolist(), epoch.pseudorange_m.tolist()),
        *(epoch.carrier_phase_cycles.tolist(), epoch.doppler_hz.tolist(), epoch.cn0_dbhz.tolist()),
        *((epoch.loss_of_lock + 2 * epoch.half_cycle).tolist(), _strength_digits(epoch.cn0_dbhz)),
        strict=True,
    )
    for satellite, signal, code, phase, doppler, cn0, flag, strength in columns:
        # A value equals itself unless it is NaN.
        text = (
            (f"{code:14.3f} {strength}" if code == code else _BLANK)
            + (f"{phase:14.3f}{flag or ' '}{strength}" if phase == phase else _BLANK)
            + (f"{doppler:14.3f}  " if doppler == doppler else _BLANK)
            + (f"{cn0:14.3f}  " if cn0 == cn0 else _BLANK)
        )
        row = rows.get(satellite)
        if row is None:
            row = rows[satellite] = blanks[satellite >> 8].copy()
        slot = slots[satellite >> 8, signal]
        if row[slot] is not _BLANK_ROW:
            name, signal_text = satellite_name(satellite), signal_name(signal)
            raise ValueError(f"{name} has {signal_text} twice at {epoch.time_ns} ns")
        row[slot] = text
    c = gpst_from_gps_ns(epoch.time_ns)
    head = f"> {c.year:4d} {c.month:02d} {c.day:02d} {c.hour:02d} {c.minute:02d} {_seconds(c)}  0{len(rows):3d}\n"
    body = [f"{satellite_name(s)}{''.join(row).rstrip()}\n" for s, row in rows.items()]
    return head + "".join(body)


def _strength_digits(cn0_dbhz: Floats) -> list[int | str]:
    """Return the digits of C/N0, a blank where it is unknown."""
    digits = np.clip(np.nan_to_num(cn0_dbhz) // 6.0, 1, 9).astype(np.int64).tolist()
    return [digit if known else " " for digit, known in zip(digits, np.isfinite(cn0_dbhz), strict=True)]


def _seconds(c: CalendarTime) -> str:
    """Return seconds with 7 decimals, truncated, so that they are never 60: the format's last digit is 100 ns."""
    return f"{c.second:2d}.{f'{c.nanosecond:09d}'[:7]}"


def _line(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}".rstrip() + "\n"


def _observation_header(
    epochs: Sequence[ObservationEpoch], station: StationHeader, signals: dict[str, list[int]]
) -> str:
    first, last = gpst_from_gps_ns(epochs[0].time_ns), gpst_from_gps_ns(epochs[-1].time_ns)
    x, y, z = station.position_ecef_m
    lines = [
        _line(f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M':<20}", "RINEX VERSION / TYPE"),
        # The date of the first epoch, not of writing: the same observations have the same bytes.
        _line(f"{'camber':<20}{'camber':<20}{_stamp(first)} GPS ", "PGM / RUN BY / DATE"),
        _line(f"{station.marker:<60}", "MARKER NAME"),
        _line(f"{station.marker:<20}", "MARKER NUMBER"),
        _line(f"{station.marker_type:<20}", "MARKER TYPE"),
        _line(f"{'camber':<20}{'camber':<40}", "OBSERVER / AGENCY"),
        _line(f"{'1':<20}{'CAMBER SIMULATED':<20}{'1':<20}", "REC # / TYPE / VERS"),
        _line(f"{'1':<20}{'NONE':<20}", "ANT # / TYPE"),
        _line(f"{x:14.4f}{y:14.4f}{z:14.4f}", "APPROX POSITION XYZ"),
        _line(f"{0.0:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N"),
    ]
    for system, numbers in signals.items():
        types = [kind + signal_name(s) for s in numbers for kind in "CLDS"]
        for k in range(0, len(types), 13):
            head = f"{system}  {len(types):3d}" if k == 0 else " " * 6
            lines.append(_line(head + "".join(f" {t}" for t in types[k : k + 13]), "SYS / # / OBS TYPES"))
    lines.append(_line("DBHZ", "SIGNAL STRENGTH UNIT"))
    if len(epochs) > 1:
        times = np.array([e.time_ns for e in epochs], np.int64)
        lines.append(_line(f"{np.median(np.diff(times)) / NS_PER_SECOND:10.3f}", "INTERVAL"))
    lines.append(_line(_header_time(first), "TIME OF FIRST OBS"))
    lines.append(_line(_header_time(last), "TIME OF LAST OBS"))
    for system, numbers in signals.items():
        # Phases are aligned to the system's reference signal: no shift remains (section 9.1).
        lines += [_line(f"{system} L{signal_name(s)}  0.00000", "SYS / PHASE SHIFT") for s in numbers]
    lines.append(_line(f"{gps_minus_utc_s(epochs[0].time_ns):6d}", "LEAP SECONDS"))
    lines.append(_line("", "END OF HEADER"))
    return "".join(lines)


def _stamp(c: CalendarTime) -> str:
    return f"{c.year:04d}{c.month:02d}{c.day:02d} {c.hour:02d}{c.minute:02d}{c.second:02d}"


def _header_time(c: CalendarTime) -> str:
    return f"{c.year:6d}{c.month:6d}{c.day:6d}{c.hour:6d}{c.minute:6d}{_seconds(c):>13}     GPS"


def navigation_text(
    ephemerides: Sequence[Ephemeris], ionosphere: Iterable[IonosphereCoefficients] = ()
) -> str:
    """Return a mixed navigation file, in the order of the times of transmission.

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
            numbers = "".join(f"{v:12.4E}" for v in values)
            lines.append(_line(f"{name}{letter} {numbers}", "IONOSPHERIC CORR"))
    lines.append(_line(f"{gps_minus_utc_s(first):6d}", "LEAP SECONDS"))
    lines.append(_line("", "END OF HEADER"))
    ordered = sorted(ephemerides, key=lambda e: (e.transmission_ns, e.satellite, e.toe_ns))
    return "".join(lines) + "".join(_ephemeris_text(e) for e in ordered)


def _ephemeris_text(e: Ephemeris) -> str:
    system = chr(e.satellite >> 8)
    if system not in ROWS:
        raise ValueError(f"{satellite_name(e.satellite)}: no navigation record for this system")
    c = gpst_from_gps_ns(e.toc_ns - (GPS_MINUS_BDT_NS if system == "C" else 0))
    # The weeks of Galileo are those of GPS (table A8).
    week, toe_ns = system_week("G" if system == "E" else system, e.toe_ns)
    values = {
        **{name: float(getattr(e, name)) for name in ("iode", "health", *ORBIT)},
        **e.other,
        **{"codes_on_l2": 1.0 if system == "G" else 2.0, "l2_p_data": 0.0, "": 0.0},
        # −1: no accuracy prediction (table A8).
        "accuracy_m": -1.0 if system == "E" and math.isnan(e.accuracy_m) else e.accuracy_m,
        "week": float(week),
        "toe_s": toe_ns / NS_PER_SECOND,
        # Counted from the beginning of toe's week.
        "transmission_s": (e.transmission_ns - e.toe_ns + toe_ns) / NS_PER_SECOND,
    }
    if system in "GJ":
        # QZSS has a flag for more than two hours instead of hours (table A12).
        fit_h = e.other["fit_interval_h"]
        values["fit"] = fit_h if system == "G" else float(fit_h > 2.0)
    rows = (e.clock, *([values[name] for name in row] for row in ROWS[system]))
    date = f"{c.year:4d} {c.month:02d} {c.day:02d} {c.hour:02d} {c.minute:02d} {c.second:02d}"
    heads = (f"{satellite_name(e.satellite)} {date}", *["    "] * 7)
    return "".join(f"{head}{''.join(map(_number, row))}\n" for head, row in zip(heads, rows, strict=True))


def _number(value: float) -> str:
    """Return D19.12, blanks for NaN, and never a negative zero."""
    if math.isnan(value):
        return " " * 19
    return f"{value + 0.0:19.12E}"

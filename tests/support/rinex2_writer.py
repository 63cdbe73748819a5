"""RINEX 2.11 written: W. Gurtner, L. Estey, "RINEX, Version 2.11" (2007), tables A1 to A4."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK, gpst_from_gps_ns

Cell = tuple[float, str, str]
"""A value, its loss-of-lock indicator and signal strength, each a digit or a blank."""


@dataclass(frozen=True, kw_only=True)
class Epoch2:
    """An epoch: by satellite (`G05`, or ` 05` without a letter) its observations by type."""

    time_ns: int
    satellites: Mapping[str, Mapping[str, Cell]]
    flag: int = 0
    lines: Sequence[str] = field(default=())
    """Header lines of an event, flags 2 to 5."""


def labelled(content: str, label: str) -> str:
    """Return a header line."""
    return f"{content:<60}{label}\n"


def types_lines(types: Sequence[str]) -> list[str]:
    """Return the lines of the observation types, nine a line."""
    lines = []
    for start in range(0, max(len(types), 1), 9):
        count = f"{len(types):6d}" if start == 0 else " " * 6
        names = "".join(f"    {name}" for name in types[start : start + 9])
        lines.append(labelled(count + names, "# / TYPES OF OBSERV"))
    return lines


def observation_text_2(
    epochs: Iterable[Epoch2],
    types: Sequence[str],
    *,
    version: float = 2.11,
    system: str = "M (MIXED)",
    first: str = "",
) -> str:
    """Return an observation file; `types` hold until an event's lines change them."""
    head = [
        labelled(f"{version:9.2f}{'':11}{'OBSERVATION DATA':<20}{system}", "RINEX VERSION / TYPE"),
        labelled("rover", "MARKER NAME"),
        labelled(f"{'1':<20}{'RECEIVER':<20}1.0", "REC # / TYPE / VERS"),
        labelled(f"{'1':<20}{'ANTENNA':<20}", "ANT # / TYPE"),
        labelled(f"{-3976219.5082:14.4f}{3382372.5671:14.4f}{3652512.9849:14.4f}", "APPROX POSITION XYZ"),
        labelled(f"{0.1:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N"),
        labelled("     1     1", "WAVELENGTH FACT L1/2"),
        *types_lines(types),
        labelled(f"{1.0:10.3f}", "INTERVAL"),
        labelled(first or "  2005     4     2     0     0    0.0000000     GPS", "TIME OF FIRST OBS"),
        labelled("", "END OF HEADER"),
    ]
    return "".join(head) + "".join(epoch_text_2(epoch, types) for epoch in epochs)


def epoch_text_2(epoch: Epoch2, types: Sequence[str]) -> str:
    """Return the lines of one epoch, five observations and twelve satellites a line."""
    c = gpst_from_gps_ns(epoch.time_ns)
    seconds = c.second + c.nanosecond / NS_PER_SECOND
    names = list(epoch.satellites)
    count = len(epoch.lines) if 2 <= epoch.flag <= 5 else len(names)
    time = f"{c.year % 100:02d} {c.month:2d} {c.day:2d} {c.hour:2d} {c.minute:2d}{seconds:11.7f}"
    head = f" {time}  {epoch.flag}{count:3d}"
    if 2 <= epoch.flag <= 5:
        return head + "\n" + "".join(epoch.lines)
    lines = [head + "".join(names[:12])]
    lines += [" " * 32 + "".join(names[k : k + 12]) for k in range(12, len(names), 12)]
    for values in epoch.satellites.values():
        cells = [_cell(values.get(name)) for name in types]
        lines += ["".join(cells[k : k + 5]).rstrip() for k in range(0, len(cells), 5)]
    return "".join(line + "\n" for line in lines)


def _cell(cell: Cell | None) -> str:
    return " " * 16 if cell is None else f"{cell[0]:14.3f}{cell[1]}{cell[2]}"


def navigation_text_2(
    ephemerides: Iterable[Ephemeris], ionosphere: IonosphereCoefficients | None = None
) -> str:
    """Return a navigation file of GPS satellites."""
    lines = [labelled(f"{2.11:9.2f}{'':11}{'N: GPS NAV DATA':<40}", "RINEX VERSION / TYPE")]
    if ionosphere is not None:
        for label, values in (("ION ALPHA", ionosphere.alpha), ("ION BETA", ionosphere.beta)):
            lines.append(labelled("  " + "".join(_exponent(v, 12, 4) for v in values), label))
    lines += [labelled(f"{13:6d}", "LEAP SECONDS"), labelled("", "END OF HEADER")]
    return "".join(lines) + "".join(map(_record, ephemerides))


def _record(e: Ephemeris) -> str:
    c = gpst_from_gps_ns(e.toc_ns)
    week, toe_ns = divmod(e.toe_ns, NS_PER_WEEK)
    rows = [
        (e.iode, e.crs_m, e.mean_motion_difference_rad_s, e.mean_anomaly_rad),
        (e.cuc, e.eccentricity, e.cus, e.sqrt_a),
        (toe_ns / NS_PER_SECOND, e.cic, e.ascending_node_rad, e.cis),
        (e.inclination_rad, e.crc_m, e.perigee_rad, e.ascending_node_rate_rad_s),
        (e.inclination_rate_rad_s, 1.0, week, 0.0),
        (e.accuracy_m, e.health, e.other["tgd_s"], e.other["iodc"]),
        ((e.transmission_ns - e.toe_ns + toe_ns) / NS_PER_SECOND, e.other["fit_interval_h"]),
    ]
    time = f"{c.year % 100:02d} {c.month:2d} {c.day:2d} {c.hour:2d} {c.minute:2d}{float(c.second):5.1f}"
    head = f"{e.satellite & 255:2d} {time}" + "".join(_exponent(v, 19, 12) for v in e.clock)
    body = ("   " + "".join(_exponent(float(v), 19, 12) for v in row) for row in rows)
    return "".join(line + "\n" for line in (head, *body))


def _exponent(value: float, width: int, decimals: int) -> str:
    if math.isnan(value):
        return " " * width
    return f"{value:{width}.{decimals}E}".replace("E", "D")

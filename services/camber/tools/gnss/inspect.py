"""`camber gnss inspect`: summarize the content of a GNSS recording as a table or as JSON."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import Ephemeris, GlonassEphemeris, ObservationEpoch
from camber.formats.receiver.mixed_stream import MixedDecoder
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution
from camber.formats.rinex.navigation_reader import NavigationDecoder
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rtcm.reader import BaseStationEpoch, ReferenceStation
from camber.formats.ubx.nav_reader import ReceiverBaseline
from camber.geodesy.ellipsoid import geodetic_from_ecef_scalar
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_utc
from camber.schemas.gnss import ReceiverIntegrity
from camber.tools.gnss import recording_summary
from camber.tools.gnss.inspect_text import text_of
from camber.tools.gnss.recording_file import Item, RecordingFile
from camber.tools.options.parsers import tool_parser

_PROG = "camber gnss inspect"
_MOST_PROBLEMS = 5  # chosen: what fits the report; all are counted
_MOST_STATIONS = 16  # chosen: bounds memory for a stream with ever new station numbers
_COUNTERS_OF_UBX = (
    "malformed", "not_read", "without_time", "other_systems", "unknown_signals", "repeated_signals", "bad_subframes",
    "epochs_without_position", "late",
)  # fmt: skip
_COUNTERS_OF_SBF = (
    "malformed", "not_read", "without_time", "other_systems", "other_antennas", "unknown_signals", "repeated_signals",
    "epochs_without_position", "late",
)  # fmt: skip
_COUNTERS_OF_RTCM = ("malformed", "not_read", "unknown_signals", "incomplete")


def main(argv: Sequence[str]) -> int:
    """Print the content of a file; 0 success, 2 it cannot be read completely."""
    parser = tool_parser(_PROG, __doc__)
    formats = "RINEX 2, 3 or 4, UBX, SBF, RTCM 3, NMEA, several of them in one stream, or RTKLIB's .pos"
    parser.add_argument("file", type=Path, metavar="FILE", help=f"{formats}; may be compressed")
    parser.add_argument("--json", action="store_true", help="print the full report as JSON")
    text = "a day within half a week of the recording, for RTCM, which does not contain the week"
    parser.add_argument("--date", type=date.fromisoformat, metavar="YYYY-MM-DD", help=text)
    args = parser.parse_args(argv)
    try:
        report = inspect_recording(args.file, args.date)
    except (FormatError, OSError) as error:
        text = f"{args.file}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
        print(f"{_PROG}: {text}", file=sys.stderr)
        return 2
    text = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) if args.json else text_of(report)
    print(text)
    if report["damage"] is not None:
        print(f"{_PROG}: {report['damage']}", file=sys.stderr)
        return 2
    return 0


def inspect_recording(path: Path, day: date | None = None) -> dict[str, Any]:
    """Return the content of a file as plain values; times are GPS time, None means unknown.

    `day` is near the recording, for protocols that do not say the week. Raises FormatError where nothing of the file
    can be read, OSError where it cannot be opened.
    """
    noon = None if day is None else CalendarTime(*day.timetuple()[:3], hour=12, minute=0, second=0)
    near_ns = None if noon is None else gps_ns_from_utc(noon)
    recording = RecordingFile(path, near_ns, count_messages=True)
    content = _RecordingContent()
    for items in recording.items():
        content.add_items(items)
    decoder = recording.decoder
    refused = isinstance(decoder, RinexDecoder) and decoder.header is None
    refused |= isinstance(decoder, NavigationDecoder) and decoder.version is None
    refused |= isinstance(decoder, PosDecoder) and content.nothing
    if refused and (content.problems or recording.damage):
        raise recording.damage or content.problems[0]
    return {
        "file": path.name,
        "bytes": path.stat().st_size,
        "format": recording.format,
        "week_from": recording.week_from,
        "damage": None if recording.damage is None else str(recording.damage),
        "header": _header(decoder),
        **content.report(),
        "messages": dict(sorted(recording.messages.items())),
        "counters": {name: count for name, count in _counters(decoder) if count},
    }


class _RecordingContent:
    """Collects the decoded items of a recording by type."""

    def __init__(self) -> None:
        self.problems: list[FormatError] = []
        self._problem_count = 0
        self._observed: dict[str, recording_summary.ObservationSummary] = {}
        self._stations: Counter[ReferenceStation] = Counter()
        self._ephemerides = recording_summary.EphemerisSummary()
        self._ionosphere: set[str] = set()
        self._positions = recording_summary.PositionSummary()
        self._statements = recording_summary.StatementSummary()
        self._baselines = 0
        self._left_out = 0

    @property
    def nothing(self) -> bool:
        """No observations and no positions."""
        return not self._observed and self._positions.report() is None

    def add_items(self, items: Iterable[Item]) -> None:
        """Add the items of the next piece."""
        for item in items:
            match item:
                case FormatError():
                    self._problem_count += 1
                    if len(self.problems) < _MOST_PROBLEMS:
                        self.problems.append(item)
                case ObservationEpoch():
                    self._epoch("file", item)
                case ReceiverEpoch():
                    self._epoch("receiver", item.epoch)
                case BaseStationEpoch():
                    self._epoch(f"station {item.station_id}", item.epoch)
                case ReferenceStation():
                    if item in self._stations or len(self._stations) < _MOST_STATIONS:
                        self._stations[item] += 1
                case Ephemeris() | GlonassEphemeris():
                    self._ephemerides.add(item)
                case IonosphereCoefficients():
                    self._ionosphere.add(item.system)
                case ReceiverSolution():
                    self._positions.add(item)
                case ReceiverIntegrity():
                    self._statements.add(item)
                case ReceiverBaseline():
                    self._baselines += 1

    def _epoch(self, source: str, epoch: ObservationEpoch) -> None:
        if source not in self._observed and len(self._observed) == _MOST_STATIONS:
            self._left_out += 1
            return
        self._observed.setdefault(source, recording_summary.ObservationSummary()).add(epoch)

    def report(self) -> dict[str, Any]:
        """Return the parts of the report that are derived from the items."""
        return {
            "observations": [{"of": source, **s.report()} for source, s in self._observed.items()],
            "epochs_of_further_stations": self._left_out,
            "reference_stations": [
                {
                    "station": station.station_id,
                    "times_said": count,
                    "position_ecef_m": station.position_ecef_m,
                    "position": _geodetic(station.position_ecef_m),
                    "antenna_height_m": station.antenna_height_m,
                }
                for station, count in self._stations.items()
            ],
            "ephemerides": self._ephemerides.report(),
            "ionosphere": sorted(self._ionosphere),
            "positions": self._positions.report(),
            "baselines": self._baselines,
            "integrity": self._statements.report(),
            "problems": {"count": self._problem_count, "first": [str(problem) for problem in self.problems]},
        }


def _header(decoder: object) -> dict[str, Any] | None:
    """Return the content of a RINEX header; None where there is none."""
    if isinstance(decoder, NavigationDecoder):
        return {"version": decoder.version, "leap_seconds": decoder.leap_seconds}
    header = decoder.header if isinstance(decoder, RinexDecoder) else None
    if header is None:
        return None
    names = ("version", "marker", "receiver", "antenna", "position_ecef_m")
    return {
        **{name: getattr(header, name) for name in names},
        "position": None if header.position_ecef_m is None else _geodetic(header.position_ecef_m),
        "antenna_height_east_north_m": header.delta_hen_m,
        **{name: getattr(header, name) for name in ("interval_s", "leap_seconds", "time_system")},
    }


def _geodetic(ecef_m: tuple[float, float, float]) -> dict[str, float] | None:
    """Return geodetic coordinates; None where the position is not on Earth."""
    try:
        latitude_rad, longitude_rad, height_m = geodetic_from_ecef_scalar(*ecef_m)
    except ValueError:
        return None
    degrees = {"latitude_deg": math.degrees(latitude_rad), "longitude_deg": math.degrees(longitude_rad)}
    return {**degrees, "height_m": height_m}


def _counters(decoder: object) -> Iterator[tuple[str, int]]:
    """Yield what a decoder skipped, with counts."""
    if isinstance(decoder, RinexDecoder | NavigationDecoder):
        yield from ((f"not_read.{what}", count) for what, count in sorted(decoder.skipped.items()))
    elif isinstance(decoder, PosDecoder):
        yield "rows_refused", decoder.rows_refused
    elif isinstance(decoder, MixedDecoder):
        yield "bytes_skipped", decoder.bytes_skipped
        yield "failed_checks", decoder.failed_checks
        yield "rtcm.without_time", decoder.rtcm_without_time
        yield "nmea.positions_beside_ubx", decoder.positions_not_used
        yield "nmea.epochs_without_position", decoder.nmea.epochs_without_position
        yield "nmea.late_sentences", decoder.nmea.late_sentences
        yield "nmea.satellites_beside_ubx", decoder.satellites_not_used
        yield "nmea.unknown_satellites", decoder.nmea.satellites.unknown_satellites
        yield "nmea.incomplete", decoder.nmea.incomplete
        yield from ((f"ubx.{name}", getattr(decoder.ubx, name)) for name in _COUNTERS_OF_UBX)
        yield from ((f"sbf.{name}", getattr(decoder.sbf, name)) for name in _COUNTERS_OF_SBF)
        if decoder.rtcm is not None:
            yield from ((f"rtcm.{name}", getattr(decoder.rtcm, name)) for name in _COUNTERS_OF_RTCM)

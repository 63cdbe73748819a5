"""Raw observations of a recorded drive: epochs of rover and base, ephemerides, where the base is.

Every file may be of any format with observations that `recording_file` knows; ephemerides are taken from the streams of
observations too.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.observations import (
    BroadcastEphemeris,
    Ephemeris,
    Floats,
    GlonassEphemeris,
    ObservationEpoch,
)
from camber.formats.receiver.receiver_epoch import ReceiverEpoch
from camber.formats.rinex.observation_header import ObservationHeader
from camber.formats.rinex.observation_reader import RinexDecoder
from camber.formats.rtcm.reader import BaseStationEpoch, ReferenceStation
from camber.geodesy.ellipsoid import geodetic_from_ecef_scalar
from camber.geodesy.local_frame import LocalFrame
from camber.tools.gnss.recording_file import RecordingFile

_RECEIVER = -1
"""Key of the receiver's observations; RTCM station numbers are not negative (DF003)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RawRecording:
    """Inputs of the RTK engine. `ionosphere`: GPS's coefficients (8,), alpha and beta; None: not broadcast.

    `base_ecef_m` (3,) is the antenna reference point, None where unknown; `base_position_from` names its source.
    `notes` are lines on problems of the files.
    """

    rover: list[ObservationEpoch]
    base: list[ObservationEpoch]
    ephemerides: list[BroadcastEphemeris]
    base_ecef_m: Floats | None
    base_position_from: str
    ionosphere: Floats | None
    notes: tuple[str, ...]


def load_raw(
    rover_obs: Path,
    base_obs: Path,
    ephemerides: Sequence[Path],
    *,
    base_ecef_m: tuple[float, float, float] | None = None,
) -> RawRecording:
    """Reads the files of rover and base and those of ephemerides.

    The base is at `base_ecef_m`, else where its messages 1005 or 1006 do, else where its RINEX header does. The
    week of RTCM, which does not say it, is that of the drive's other files. Raises FormatError for a file that cannot
    be read or lacks what it is for, OSError where one cannot be opened.
    """
    files, near_ns = list[_File](), None
    for path in ephemerides:
        files.append(_read(path, near_ns))
        near_ns = near_ns or files[-1].first_ns
    rover = _read(rover_obs, near_ns)
    base = _read(base_obs, rover.first_ns or near_ns)
    files += [rover, base]
    notes = [note for file in files for note in file.notes()]
    # One port may carry the receiver's own observations and the corrections that go into it.
    rover_epochs = _observed(rover, receiver_first=True, notes=notes)
    base_epochs = _observed(base, receiver_first=False, notes=notes)
    position, position_from = _base_position(base_ecef_m, base, notes)
    return RawRecording(
        rover=rover_epochs,
        base=base_epochs,
        ephemerides=[ephemeris for file in files for ephemeris in file.ephemerides],
        base_ecef_m=position,
        base_position_from=position_from,
        ionosphere=next((file.ionosphere for file in files if file.ionosphere is not None), None),
        notes=tuple(notes),
    )


@dataclass(slots=True, kw_only=True)
class _File:
    """Content of one file; epochs by station."""

    name: str
    epochs: defaultdict[int, list[ObservationEpoch]] = field(default_factory=lambda: defaultdict(list))
    stations: Counter[tuple[int, tuple[float, float, float]]] = field(default_factory=Counter)
    ephemerides: list[BroadcastEphemeris] = field(default_factory=list)
    ionosphere: Floats | None = None
    header: ObservationHeader | None = None
    problems: list[FormatError] = field(default_factory=list)
    week_guessed: bool = False

    @property
    def first_ns(self) -> int | None:
        """A time of it, where it has one that is no guess."""
        if self.week_guessed:
            return None
        epochs = next(iter(self.epochs.values()), None)
        if epochs:
            return epochs[0].time_ns
        return self.ephemerides[0].toe_ns if self.ephemerides else None

    def notes(self) -> list[str]:
        """Return the problems of the file, a line each."""
        notes = []
        if self.problems:
            more = f" and {len(self.problems) - 1:,} more" if len(self.problems) > 1 else ""
            notes.append(f"{self.problems[0]}{more}")
        if self.week_guessed:
            notes.append(f"{self.name}: the week is unknown, guessed from the date of the file")
        return notes


def _read(path: Path, near_ns: int | None) -> _File:
    recording = RecordingFile(path, near_ns)
    file = _File(name=path.name, week_guessed=recording.week_from == "file date")
    for items in recording.items():
        for item in items:
            match item:
                case ObservationEpoch():
                    file.epochs[_RECEIVER].append(item)
                case ReceiverEpoch():
                    file.epochs[_RECEIVER].append(item.epoch)
                case BaseStationEpoch():
                    file.epochs[item.station_id].append(item.epoch)
                case ReferenceStation():
                    file.stations[item.station_id, item.position_ecef_m] += 1
                case Ephemeris() | GlonassEphemeris():
                    file.ephemerides.append(item)
                case IonosphereCoefficients() if item.system == "G":
                    file.ionosphere = np.array([*item.alpha, *item.beta])
                case FormatError():
                    file.problems.append(item)
    if isinstance(recording.decoder, RinexDecoder):
        file.header = recording.decoder.header
    if recording.damage is not None:
        file.problems.append(recording.damage)
    if not file.epochs and not file.ephemerides and file.problems:
        raise file.problems[-1] if recording.damage else file.problems[0]
    return file


def _observed(file: _File, *, receiver_first: bool, notes: list[str]) -> list[ObservationEpoch]:
    """Return the epochs of the receiver or of the station with most epochs, preferring as asked."""
    stations = sorted(
        (key for key in file.epochs if key != _RECEIVER), key=lambda key: -len(file.epochs[key])
    )
    receiver = [_RECEIVER] if _RECEIVER in file.epochs else []
    order = [*receiver, *stations] if receiver_first else [*stations, *receiver]
    if not order:
        raise FormatError(file.name, "observations", "at least one epoch of them")
    if order[0] != _RECEIVER and len(stations) > 1:
        notes.append(f"{file.name}: {len(stations)} stations, station {order[0]} with most epochs is used")
    return file.epochs[order[0]]


def _base_position(
    given: tuple[float, float, float] | None, base: _File, notes: list[str]
) -> tuple[Floats | None, str]:
    """Return the base's antenna reference point and the source of it."""
    if given is not None:
        return np.array(given), "the caller"
    if base.stations:
        (station, position), _ = base.stations.most_common(1)[0]
        others = [other for _, other in base.stations if other != position]
        if others:
            far_m = max(float(np.linalg.norm(np.subtract(other, position))) for other in others)
            notes.append(
                f"{base.name}: the base sends {len(others) + 1} positions up to {far_m:.3f} m apart, "
                "the most frequent is used"
            )
        return np.array(position), f"RTCM 1005 or 1006 of station {station}"
    header = base.header
    if header is None or header.position_ecef_m is None:
        return None, "nothing"
    up_m, east_m, north_m = header.delta_hen_m or (0.0, 0.0, 0.0)
    try:
        marker = LocalFrame(*geodetic_from_ecef_scalar(*header.position_ecef_m))
    except ValueError:
        notes.append(f"{base.name}: APPROX POSITION XYZ is no place on earth")
        return None, "nothing"
    source = "the header of the base's RINEX file (may be approximate)"
    return np.array(marker.ecef_from_enu(east_m, north_m, up_m)), source

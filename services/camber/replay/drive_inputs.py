"""A drive, ready to be fed to the services: what arrived when, the map, the truth.

Nothing is repaired. Late and repeated epochs arrive where they stand in their file; the time at which something
arrives is what its recorder noted down, or else the running maximum of the times measured; the ticks of a replay are
the distinct times of arrival. What arrives from one stream of a receiver at one tick is one message, byte for byte.
Sweeps are not read before their tick.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from camber.formats.drive.motion_csv import read_samples
from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.formats.errors import FormatError
from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.replay.receiver_file import receive_times
from camber.replay.receiver_streams import read_streams, whole_files
from camber.replay.surrogate_map import make_map
from camber.replay.surrogates import make_initial_pose, make_motion
from camber.replay.sweep_files import SweepFile, SweepReader, sweep_files
from camber.replay.truth_interpolation import interpolate_truth
from camber.road_map.release import write_release
from camber.schemas.base import Message
from camber.schemas.drive import (
    MAP_SURROGATES,
    MOTION_SURROGATES,
    DriveManifest,
    InitialPose,
    ManifestError,
    Surrogates,
)
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.motion import Imu, Motion, Ranging, Suspension

M = TypeVar("M", bound=Message)
_FIELDS = {
    "receiver_bytes": "receiver",
    "motion": "motion",
    "imu": "imu",
    "suspension": "suspension",
    "ranging": "ranging",
    "sweep": "sweeps",
}
"""The vehicle's channels in the order of the table, and the fields that hold what arrives on them."""


@dataclass(frozen=True, slots=True)
class Arrival(Generic[M]):
    """A message and when it arrives; its own `time_ns` is when it was measured."""

    receive_time_ns: int
    message: M


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTick:
    """All that arrives at one time."""

    time_ns: int
    receiver: tuple[ReceiverBytes, ...] = ()
    motion: tuple[Motion, ...] = ()
    imu: tuple[Imu, ...] = ()
    suspension: tuple[Suspension, ...] = ()
    ranging: tuple[Ranging, ...] = ()
    sweeps: tuple[SweepFile, ...] = ()

    def messages(self, reader: SweepReader) -> Iterator[tuple[str, Message]]:
        """Yield what arrives, each message with the name of its channel, in the order of the table."""
        for name, field in _FIELDS.items():
            for message in reader.read(self.sweeps) if field == "sweeps" else getattr(self, field):
                yield name, message


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveInputs:
    """One drive in the order of arrival. `map_release` is a folder; None: the drive has none.

    `greeting` is what a receiver's streams send first to a client that connects later: headers, ephemerides. `notes`
    are lines on what of the drive was left out.
    """

    manifest: DriveManifest
    tick_times_ns: tuple[int, ...]
    receiver: tuple[Arrival[ReceiverBytes], ...]
    greeting: tuple[ReceiverBytes, ...]
    motion: tuple[Arrival[Motion], ...]
    imu: tuple[Arrival[Imu], ...]
    suspension: tuple[Arrival[Suspension], ...]
    ranging: tuple[Arrival[Ranging], ...]
    sweeps: tuple[SweepFile, ...]
    map_release: Path | None
    truth: TruthTable | None
    initial_pose: InitialPose | None
    notes: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """The vehicle's channels on which there is something in this drive."""
        return tuple(name for name, field in _FIELDS.items() if getattr(self, field))

    def greeting_at(self, time_ns: int) -> Iterator[ReceiverBytes]:
        """Yield what the receiver sends first to a `gnss` that connects at this time."""
        for message in self.greeting:
            yield message.model_copy(update={"time_ns": time_ns})

    def ticks(self) -> Iterator[DriveTick]:
        """The drive, tick by tick."""
        columns = {
            field: _by_time((arrival.receive_time_ns, arrival.message) for arrival in getattr(self, field))
            for field in _FIELDS.values()
            if field != "sweeps"
        }
        columns["sweeps"] = _by_time((file.time_ns, file) for file in self.sweeps)
        for time_ns in self.tick_times_ns:
            at_once = {name: tuple(column.get(time_ns, ())) for name, column in columns.items()}
            yield DriveTick(time_ns=time_ns, **at_once)


def prepare_drive(manifest: DriveManifest, work_folder: Path) -> DriveInputs:
    """Read the native files, make the surrogates; a surrogate map is written to `work_folder`/map.

    Raises ManifestError or FormatError, one line each, OSError where a file cannot be read or written.
    """
    truth = None if manifest.truth is None else read_truth(manifest.truth.file, manifest.truth.format)
    if truth is not None and len(truth) == 0:
        raise ManifestError(f"{manifest.name}: truth.file has no epochs, expected at least one")
    sensors: dict[str, Any] = {
        name: [] if source is None else read_samples(source.file, kind)
        for name, source, kind in (
            ("motion", manifest.motion, Motion),
            ("imu", manifest.imu, Imu),
            ("suspension", manifest.suspension, Suspension),
            ("ranging", manifest.ranging, Ranging),
        )
    }
    if truth is not None and MOTION_SURROGATES & set(manifest.surrogates.inputs):
        sensors["motion"] = make_motion(truth, manifest.surrogates)
    sweeps, notes = ([], []) if manifest.sweeps is None else sweep_files(manifest.sweeps.folder)
    # RTCM does not give its week; the first motion, inertial sample or truth does.
    dated = [sample.time_ns for name in ("motion", "imu") for sample in sensors[name][:1]]
    dated += [] if truth is None else truth.time_ns[:1].tolist()
    streams = read_streams(manifest, dated[0] if dated else None)
    columns = {name: _arrivals(messages) for name, messages in sensors.items()}
    first_ns, last_ns = _period(
        manifest,
        [
            # A base station's file may begin and end long before and after the drive.
            *((s.parts[0].time_ns, s.parts[-1].time_ns) for s in streams if s.stream == "rover"),
            *((c[0].receive_time_ns, c[-1].receive_time_ns) for c in columns.values() if c),
            *((sweeps[0].time_ns, sweeps[-1].time_ns) for _ in sweeps[:1]),
        ],
    )
    columns = {
        name: tuple(arrival for arrival in column if first_ns <= arrival.receive_time_ns <= last_ns)
        for name, column in columns.items()
    }
    received = [message for stream in streams for message in stream.messages(first_ns, last_ns)]
    swept = tuple(file for file in sweeps if first_ns <= file.time_ns <= last_ns)
    times = {arrival.receive_time_ns for column in columns.values() for arrival in column}
    times |= {message.time_ns for message in received} | {file.time_ns for file in swept}
    if not times:
        raise ManifestError(
            f"{manifest.name}: nothing lies between start_s and end_s, expected a part of the drive"
        )
    tick_times_ns = tuple(sorted(times))
    start_ns = tick_times_ns[0]
    whole = whole_files(manifest, start_ns)
    receiver = [Arrival(message.time_ns, message) for message in (*whole, *received)]
    return DriveInputs(
        manifest=manifest,
        tick_times_ns=tick_times_ns,
        receiver=tuple(sorted(receiver, key=lambda arrival: arrival.receive_time_ns)),
        greeting=(*whole, *(header for stream in streams for header in stream.greeting(start_ns))),
        **columns,
        sweeps=swept,
        map_release=_map_release(manifest, truth, work_folder),
        truth=truth,
        initial_pose=_initial_pose(manifest, truth, start_ns),
        notes=tuple(notes),
    )


def _arrivals(messages: Sequence[M]) -> tuple[Arrival[M], ...]:
    at_ns = receive_times([message.time_ns for message in messages])
    return tuple(Arrival(t, message) for t, message in zip(at_ns, messages, strict=True))


def _by_time(items: Iterable[tuple[int, Any]]) -> dict[int, list[Any]]:
    column: dict[int, list[Any]] = {}
    for time_ns, item in items:
        column.setdefault(time_ns, []).append(item)
    return column


def _period(manifest: DriveManifest, spans: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """From when to when; `spans` are those of the inputs. Raises ManifestError where all of them are empty."""
    if not spans:
        raise ManifestError(f"{manifest.name}: no input has a sample, expected at least one")
    begin_ns, end_ns = min(begin for begin, _ in spans), max(end for _, end in spans)
    first_ns = begin_ns if manifest.start_s is None else begin_ns + round(manifest.start_s * 1e9)
    last_ns = end_ns if manifest.end_s is None else begin_ns + round(manifest.end_s * 1e9)
    return first_ns, last_ns


def _map_release(manifest: DriveManifest, truth: TruthTable | None, work_folder: Path) -> Path | None:
    if manifest.map is not None:
        return manifest.map.release
    inputs = MAP_SURROGATES & set(manifest.surrogates.inputs)
    if not inputs or truth is None:
        return None
    if inputs != MAP_SURROGATES:
        raise ManifestError(
            f"{manifest.name}: surrogates.inputs has {min(inputs)} alone, expected links, road_surfaces"
        )
    height_m = manifest.surrogates.antenna_height_m
    if height_m is None and manifest.antenna_height is not None:
        height_m = manifest.antenna_height.height_m
    assert height_m is not None  # the manifest was checked for it
    how = _how_made(manifest.surrogates)
    names = {"region": manifest.name, "datum": manifest.datum, "surrogate": how}
    write_map(work_folder / "map", truth, manifest.surrogates, height_m, **names)
    return work_folder / "map"


def write_map(
    folder: Path,
    truth: TruthTable,
    errors: Surrogates,
    antenna_height_m: float,
    *,
    region: str,
    datum: str,
    surrogate: str,
) -> None:
    """Write the release of a map made from where a drive went. Raises FormatError for a truth that does not move."""
    try:
        surfaces, links = make_map(truth, errors, antenna_height_m)
    except ValueError as error:
        raise FormatError(region, "truth", str(error)) from None
    made_ns = int(truth.time_ns[0])
    day = gpst_from_gps_ns(made_ns)
    write_release(
        folder,
        region=region,
        map_version=1,
        datum=datum,
        epoch_year=round(day.year + (day.month - 0.5) / 12.0, 2),
        time_ns=made_ns,
        surfaces=surfaces,
        links=links,
        surrogate=surrogate,
    )


def _how_made(errors: Surrogates) -> str:
    return (
        f"made from the drive's own truth, seed {errors.seed}: heights with {errors.map_sigma_m:g} m of noise "
        f"(correlation {errors.map_short_m:g} m and {errors.map_long_m:g} m, common offset of σ "
        f"{errors.map_common_offset_sigma_m:g} m), links up to {errors.link_deviation_m:g} m off, no crossfall"
    )


def _initial_pose(manifest: DriveManifest, truth: TruthTable | None, first_ns: int) -> InitialPose | None:
    if "initial_pose" not in manifest.surrogates.inputs or truth is None:
        return manifest.initial_pose
    start, _ = interpolate_truth(truth, np.array([first_ns]))
    if len(start) == 0:
        raise ManifestError(f"{manifest.name}: truth has no epoch at the start of the drive, expected one")
    return make_initial_pose(start, manifest.surrogates)

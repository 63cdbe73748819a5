"""A drive, ready to be fed to the services: what arrived when, the map, the truth.

Nothing is repaired. Late and repeated epochs arrive where they stand in their file; the time at which something
arrives is what its recorder noted down, or else the running maximum of the times measured; the ticks of a replay are
the distinct times of arrival. What arrives from one stream of a receiver at one tick is one message, byte for byte.
Sweeps are not read before their tick.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from camber.formats.drive.motion_csv import read_motion, read_ranging, read_suspension
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
from camber.schemas.motion import Motion, Ranging, Suspension

M = TypeVar("M", bound=Message)


@dataclass(frozen=True, slots=True)
class Arrival(Generic[M]):
    """A message and when it arrives; its own `time_ns` is when it was measured."""

    receive_time_ns: int
    message: M


@dataclass(frozen=True, slots=True)
class Tick:
    """All that arrives at one time."""

    time_ns: int
    receiver: tuple[ReceiverBytes, ...]
    motion: tuple[Motion, ...]
    suspension: tuple[Suspension, ...]
    ranging: tuple[Ranging, ...]
    sweeps: tuple[SweepFile, ...] = ()

    def messages(self, reader: SweepReader) -> Iterator[tuple[str, Message]]:
        """Yield what arrives, each message with the name of its channel, in the order of the table."""
        for name, messages in (
            ("receiver_bytes", self.receiver),
            ("motion", self.motion),
            ("suspension", self.suspension),
            ("ranging", self.ranging),
            ("sweep", reader.read(self.sweeps)),
        ):
            for message in messages:
                yield name, message


@dataclass(frozen=True, slots=True)
class DriveInputs:
    """One drive in the order of arrival. `map_release` is a folder; None: the drive has none.

    `greeting` is what a receiver's streams say to whoever connects later: headers, ephemerides. `notes` are lines on
    what of the drive was left out.
    """

    manifest: DriveManifest
    tick_times_ns: tuple[int, ...]
    receiver: tuple[Arrival[ReceiverBytes], ...]
    greeting: tuple[ReceiverBytes, ...]
    motion: tuple[Arrival[Motion], ...]
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
        columns = {
            "receiver_bytes": self.receiver,
            "motion": self.motion,
            "suspension": self.suspension,
            "ranging": self.ranging,
            "sweep": self.sweeps,
        }
        return tuple(name for name, arrivals in columns.items() if arrivals)

    def greeting_at(self, time_ns: int) -> Iterator[ReceiverBytes]:
        """Yield what the receiver sends first to a `gnss` that connects at this time."""
        for message in self.greeting:
            yield message.model_copy(update={"time_ns": time_ns})

    def ticks(self) -> Iterator[Tick]:
        """The drive, tick by tick."""
        receiver, motion = _by_time(self.receiver), _by_time(self.motion)
        suspension, ranging = _by_time(self.suspension), _by_time(self.ranging)
        sweeps: dict[int, list[SweepFile]] = {}
        for file in self.sweeps:
            sweeps.setdefault(file.time_ns, []).append(file)
        for time_ns in self.tick_times_ns:
            yield Tick(
                time_ns,
                tuple(receiver.get(time_ns, ())),
                tuple(motion.get(time_ns, ())),
                tuple(suspension.get(time_ns, ())),
                tuple(ranging.get(time_ns, ())),
                tuple(sweeps.get(time_ns, ())),
            )


def prepare_drive(manifest: DriveManifest, work_folder: Path) -> DriveInputs:
    """Read the native files, make the surrogates; a surrogate map is written to `work_folder`/map.

    Raises ManifestError or FormatError, one line each, OSError where a file cannot be read or written.
    """
    truth = None if manifest.truth is None else read_truth(manifest.truth.file, manifest.truth.format)
    if truth is not None and len(truth) == 0:
        raise ManifestError(f"{manifest.name}: truth.file has no epochs, expected at least one")
    errors = manifest.surrogates
    motion = [] if manifest.motion is None else read_motion(manifest.motion.file)
    if truth is not None and MOTION_SURROGATES & set(errors.inputs):
        motion = make_motion(truth, errors)
    moved = _arrivals(motion)
    suspension = _arrivals([] if manifest.suspension is None else read_suspension(manifest.suspension.file))
    ranging = _arrivals([] if manifest.ranging is None else read_ranging(manifest.ranging.file))
    sweeps, notes = ([], []) if manifest.sweeps is None else sweep_files(manifest.sweeps.folder)
    # RTCM does not say its week; whatever else there is does.
    dated = [
        *(sample.time_ns for sample in motion[:1]),
        *([] if truth is None else truth.time_ns[:1].tolist()),
    ]
    streams = read_streams(manifest, dated[0] if dated else None)
    first_ns, last_ns = _period(
        manifest,
        [
            # A base station's file may begin and end long before and after the drive.
            *((s.parts[0].time_ns, s.parts[-1].time_ns) for s in streams if s.stream == "rover"),
            *((c[0].receive_time_ns, c[-1].receive_time_ns) for c in (moved, suspension, ranging) if c),
            *((sweeps[0].time_ns, sweeps[-1].time_ns) for _ in sweeps[:1]),
        ],
    )
    moved, suspension, ranging = (
        _within(moved, first_ns, last_ns),
        _within(suspension, first_ns, last_ns),
        _within(ranging, first_ns, last_ns),
    )
    receiver = [
        Arrival(message.time_ns, message)
        for stream in streams
        for message in stream.messages(first_ns, last_ns)
    ]
    swept = tuple(file for file in sweeps if first_ns <= file.time_ns <= last_ns)
    times = {a.receive_time_ns for column in (receiver, moved, suspension, ranging) for a in column}
    times |= {file.time_ns for file in swept}
    if not times:
        raise ManifestError(
            f"{manifest.name}: nothing lies between start_s and end_s, expected a part of the drive"
        )
    tick_times_ns = tuple(sorted(times))
    whole = whole_files(manifest, tick_times_ns[0])
    receiver = [Arrival(message.time_ns, message) for message in whole] + receiver
    receiver.sort(key=lambda arrival: arrival.receive_time_ns)
    return DriveInputs(
        manifest,
        tick_times_ns,
        tuple(receiver),
        (*whole, *(said for stream in streams for said in stream.greeting(tick_times_ns[0]))),
        moved,
        suspension,
        ranging,
        swept,
        _map_release(manifest, truth, work_folder),
        truth,
        _initial_pose(manifest, truth, tick_times_ns[0]),
        tuple(notes),
    )


def _arrivals(messages: Sequence[M]) -> tuple[Arrival[M], ...]:
    at_ns = receive_times([message.time_ns for message in messages])
    return tuple(Arrival(t, message) for t, message in zip(at_ns, messages, strict=True))


def _within(arrivals: tuple[Arrival[M], ...], first_ns: int, last_ns: int) -> tuple[Arrival[M], ...]:
    return tuple(arrival for arrival in arrivals if first_ns <= arrival.receive_time_ns <= last_ns)


def _by_time(arrivals: Sequence[Arrival[M]]) -> dict[int, list[M]]:
    column: dict[int, list[M]] = {}
    for arrival in arrivals:
        column.setdefault(arrival.receive_time_ns, []).append(arrival.message)
    return column


def _period(manifest: DriveManifest, spans: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """From when to when; `spans` are those of the inputs."""
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
    height_m = manifest.antenna_height.height_m if height_m is None else height_m
    assert height_m is not None  # the manifest was checked for it
    folder = work_folder / "map"
    how = _how_made(manifest.surrogates)
    write_map(
        folder,
        truth,
        manifest.surrogates,
        height_m,
        region=manifest.name,
        datum=manifest.datum,
        surrogate=how,
    )
    return folder


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
        f"(correlation {errors.map_correlation_m:g} m), links up to {errors.link_deviation_m:g} m off, no crossfall"
    )


def _initial_pose(manifest: DriveManifest, truth: TruthTable | None, first_ns: int) -> InitialPose | None:
    if "initial_pose" not in manifest.surrogates.inputs or truth is None:
        return manifest.initial_pose
    start, _ = interpolate_truth(truth, np.array([first_ns]))
    if len(start) == 0:
        raise ManifestError(f"{manifest.name}: truth has no epoch at the start of the drive, expected one")
    return make_initial_pose(start, manifest.surrogates)

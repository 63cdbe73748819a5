"""`camber feed`: publish a recorded drive in real time, with times shifted to the present, to running services.

Sensor messages keep their content; their times are shifted. The receiver's solutions are rewritten as RTKLIB lines,
because these contain the times. Raw observations cannot be shifted, since their times are tied to the satellites'
orbits: they are fed only where the drive starts in the future, and then at the drive's own times
(`camber simulate --live --starts-in`). With `--loop` the vehicle drives to the end, back in reverse gear, and so on,
because no vehicle jumps from the end to the beginning.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.nmea.epochs import NmeaDecoder
from camber.formats.receiver.rtklib_pos import PosDecoder, format_pos_header, format_pos_line
from camber.formats.receiver.solution import ReceiverSolution
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.sweep_files import SweepFile, SweepReader
from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.session import NobodyThereError, open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.drive import DriveManifest, ManifestError, load_manifest
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion
from camber.tools.options.bus_options import bus_settings
from camber.tools.options.error_report import report_failures
from camber.tools.options.parsers import add_drive, tool_parser
from camber.tools.options.stop_signals import stopped_by_signals

_PROG = "camber feed"
_ROUTER = "tcp/127.0.0.1:7447"
_RETRY_ROUTER_S = 0.5  # chosen: as often as services retry the router
_LONGEST_WAIT_NS = 3600 * NS_PER_SECOND
"""Chosen: a drive that starts later is fed at once, with shifted times."""
_LATE_NS = NS_PER_SECOND // 2  # chosen: consumers would refuse later messages as stale (table of channels)
_AWAY_NS = 60 * NS_PER_SECOND  # chosen: after a longer suspend without motion no localizer holds its pose
_SAMPLED = ("motion", "imu", "suspension", "ranging")  # channels of samples, and fields of a tick


@dataclass(frozen=True, slots=True, kw_only=True)
class FedSweep:
    """A sweep to be read when it is due, at the time of its file plus `moved_ns`; backward: `moved_ns` minus that."""

    file: SweepFile
    moved_ns: int = 0
    backward: bool = False

    def dated(self, sweep: Sweep) -> Sweep:
        """Return the sweep at the time it is fed; backward with its points reversed, starting at its former end."""
        if not self.backward:
            return sweep.model_copy(update={"time_ns": sweep.time_ns + self.moved_ns})
        begin_ns = int(sweep.offset_ns.min(initial=0))
        return sweep.model_copy(
            update={
                "time_ns": self.moved_ns - sweep.time_ns - begin_ns,
                "points_m": sweep.points_m[::-1].copy(),
                "intensity": sweep.intensity[::-1].copy(),
                "offset_ns": begin_ns - sweep.offset_ns[::-1],
            }
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Epoch:
    """All inputs that arrive at one time: receiver solutions, samples of other sensors by channel, sweeps."""

    time_ns: int
    solutions: tuple[ReceiverSolution, ...] = ()
    samples: tuple[tuple[str, Message], ...] = ()
    sweeps: tuple[FedSweep, ...] = ()
    raw: tuple[ReceiverBytes, ...] = ()

    def moved(self, offset_ns: int, *, backward: bool = False) -> Epoch:
        """Return the epoch `offset_ns` later; without raw observations, which cannot be shifted.

        `backward`: driven in reverse gear, at `offset_ns` minus its time.
        """
        if offset_ns == 0 and not backward:
            return self
        sign = -1 if backward else 1
        return Epoch(
            time_ns=sign * self.time_ns + offset_ns,
            solutions=tuple(_moved_solution(item, offset_ns, sign) for item in self.solutions[::sign]),
            samples=tuple(
                (name, _moved_sample(item, offset_ns, sign)) for name, item in self.samples[::sign]
            ),
            sweeps=tuple(
                replace(
                    sweep, moved_ns=sign * sweep.moved_ns + offset_ns, backward=sweep.backward != backward
                )
                for sweep in self.sweeps[::sign]
            ),
        )

    def messages(self, reader: SweepReader) -> Iterator[tuple[str, Message]]:
        """Yield channel and message of all to publish; sweeps are read now."""
        for raw in self.raw:
            yield "receiver_bytes", raw
        if self.solutions:
            data = b"".join(_pos_lines(solution) for solution in self.solutions)
            payload = np.frombuffer(data, np.uint8)
            yield "receiver_bytes", ReceiverBytes(time_ns=self.time_ns, protocol="pos", payload=payload)
        yield from self.samples
        for fed in self.sweeps:
            for sweep in reader.read([fed.file]):
                yield "sweep", fed.dated(sweep)


def epochs_of(inputs: DriveInputs) -> tuple[Epoch, ...]:
    """Return the epochs of a drive with the receiver's bytes decoded; epochs without content are omitted."""
    receiver = inputs.manifest.receiver
    date = None if receiver is None else receiver.utc_date
    decoders: dict[str, PosDecoder | NmeaDecoder] = {
        "pos": PosDecoder("receiver"),
        "nmea": NmeaDecoder("receiver", utc_date=date),
    }
    epochs = []
    for tick in inputs.ticks():
        read = [
            item
            for part in tick.receiver
            if part.protocol in decoders
            for item in decoders[part.protocol].feed(part.payload.tobytes())
        ]
        samples = tuple((name, sample) for name in _SAMPLED for sample in getattr(tick, name))
        solutions = tuple(item for item in read if isinstance(item, ReceiverSolution))
        sweeps = tuple(FedSweep(file=file) for file in tick.sweeps)
        raw = tuple(part for part in tick.receiver if part.protocol not in decoders)
        if solutions or samples or sweeps or raw:
            epochs.append(
                Epoch(time_ns=tick.time_ns, solutions=solutions, samples=samples, sweeps=sweeps, raw=raw)
            )
    return tuple(epochs)


def reversed_drive(epochs: Sequence[Epoch]) -> tuple[Epoch, ...]:
    """Return the same route in reverse gear, from the end to the beginning, in the same period of time.

    A reversed sweep ends when the original one began, which is when the previous sweep ended; the first is omitted,
    since its begin is unknown.
    """
    span_ns = epochs[0].time_ns + epochs[-1].time_ns
    back, later = list[Epoch](), tuple[FedSweep, ...]()
    for epoch in reversed(epochs):
        due = later if epoch.sweeps else ()
        later = epoch.sweeps or later
        back.append(replace(epoch, sweeps=due).moved(span_ns, backward=True))
    return tuple(back)


def passes(epochs: Sequence[Epoch], *, loop: bool) -> Iterator[Sequence[Epoch]]:
    """Yield the drive forward; with `loop` then backward, forward and so on without end."""
    yield epochs
    backward = reversed_drive(epochs) if loop else ()
    while loop:
        yield backward
        yield epochs


def main(argv: Sequence[str]) -> int:
    """Feed one drive; 0 finished or stopped, 2 the drive cannot be used, 3 the bus cannot be joined."""
    parser = tool_parser(_PROG, __doc__)
    add_drive(parser, "manifest of the drive")
    add_bus_arguments(parser)
    loop = "drive forward and back in reverse gear until stopped"
    parser.add_argument("--loop", action="store_true", help=loop)
    args = parser.parse_args(argv)

    def work() -> int:
        manifest = load_manifest(args.drive, args.set)
        # Preparing a drive may build a map, which is not fed: it goes to a temporary folder.
        with stopped_by_signals() as stop, tempfile.TemporaryDirectory(prefix="camber-feed-") as work_folder:
            bus = {"connect": args.connect, "vehicle": args.vehicle}
            feed(manifest, Path(work_folder), stop, **bus, loop=args.loop, prog=_PROG)
        return 0

    return report_failures(_PROG, args.drive, work, bus_code=3)


def feed(
    manifest: DriveManifest,
    work_folder: Path,
    stop: threading.Event,
    *,
    connect: Sequence[str] | None,
    vehicle: str | None,
    loop: bool = False,
    prog: str,
) -> None:
    """Publish a drive on the bus of a vehicle (None: the manifest's) to its end, or until `stop` is set.

    Waits for the router; exits the process where settings of the bus are wrong. Raises ManifestError, FormatError,
    BusError, OSError.
    """
    options = argparse.Namespace(config=None, connect=connect)
    settings = bus_settings(options, prog=prog, vehicle=vehicle or manifest.vehicle)
    inputs = prepare_drive(manifest, work_folder)
    epochs = epochs_of(inputs)
    if not any(epoch.solutions or epoch.samples or epoch.sweeps for epoch in epochs):
        raise ManifestError(f"{manifest.name}: only raw observations, expected something to feed live")
    for note in inputs.notes:
        print(f"{prog}: {note}", file=sys.stderr)
    bus = join_bus(settings, stop, prog)
    if bus is None:
        return
    try:
        feed_passes(passes(epochs, loop=loop), bus, stop, drive=manifest.name, prog=prog)
    finally:
        bus.close()


def join_bus(settings: ServiceSettings, stop: threading.Event, prog: str) -> Bus | None:
    """Wait for the router and return the bus; None where `stop` is set first. Reports once that it waits.

    Raises BusError where waiting cannot help: an invalid endpoint, a certificate.
    """
    reported = False
    while not stop.is_set():
        try:
            session = open_session(settings.zenoh, timeout_s=_RETRY_ROUTER_S)
            return Bus(session, settings, "vehicle", SystemClock())
        except NobodyThereError as error:
            if not reported:
                print(f"{prog}: {error}; waiting", file=sys.stderr, flush=True)
            reported = True
            stop.wait(_RETRY_ROUTER_S)  # some failures come at once
    return None


def feed_passes(
    drive_passes: Iterator[Sequence[Epoch]], bus: Bus, stop: threading.Event, *, drive: str, prog: str = _PROG
) -> None:
    """Publish pass after pass, reporting each on standard error, until none is left or `stop` is set."""

    def report(text: str) -> None:
        print(f"{prog}: {text}", file=sys.stderr, flush=True)

    first = next(drive_passes)
    start_ns = bus.now_ns()
    if 0 < first[0].time_ns - start_ns <= _LONGEST_WAIT_NS:
        start_ns = first[0].time_ns
        report(f"{drive} begins in {(start_ns - bus.now_ns()) / NS_PER_SECOND:.0f} s")
    elif any(epoch.raw for epoch in first):
        report(f"{drive}: times shifted to now, raw observations omitted")
    for number, epochs in enumerate(chain([first], drive_passes), start=1):
        duration_s = (epochs[-1].time_ns - epochs[0].time_ns) / NS_PER_SECOND
        report(f"{drive}, {duration_s:.0f} s, pass {number}")
        reader = SweepReader()
        start_ns, missed = feed_pass(epochs, bus, stop, start_ns=start_ns, reader=reader)
        for note in reader.notes():
            report(note)
        if missed:
            report(f"this machine was too slow: {missed} of {len(epochs)} epochs were not published")
        if stop.is_set():
            return


def feed_pass(
    epochs: Sequence[Epoch], bus: Bus, stop: threading.Event, *, start_ns: int, reader: SweepReader
) -> tuple[int, int]:
    """Publish each epoch when it is due; returns when the next pass may start, and how many epochs were too late.

    Late epochs are dropped: published later, they would show a vehicle that stands still with turning wheels. After a
    suspend of the machine the drive continues where it was.
    """
    # Whole milliseconds: an RTKLIB line has no more decimals of a time.
    offset_ns = (start_ns - epochs[0].time_ns) // 1_000_000 * 1_000_000
    missed = 0
    for epoch in epochs:
        if stop.wait(max(epoch.time_ns + offset_ns - bus.now_ns(), 0) / NS_PER_SECOND):
            break
        late_ns = bus.now_ns() - epoch.time_ns - offset_ns
        if late_ns > _AWAY_NS:
            offset_ns += late_ns // 1_000_000 * 1_000_000
        elif late_ns > _LATE_NS:
            missed += 1
            continue
        for name, message in epoch.moved(offset_ns).messages(reader):
            bus.publish(name, message)
    step_ns = (epochs[-1].time_ns - epochs[0].time_ns) // max(len(epochs) - 1, 1)
    return epochs[-1].time_ns + offset_ns + step_ns, missed


def _pos_lines(solution: ReceiverSolution) -> bytes:
    """Return the solution's line preceded by the header, so that a gnss started later can read it too."""
    velocity = solution.velocity_enu_m_s is not None
    return format_pos_header(velocity=velocity) + format_pos_line(solution, velocity=velocity)


def _moved_solution(solution: ReceiverSolution, offset_ns: int, sign: int) -> ReceiverSolution:
    velocity = solution.velocity_enu_m_s
    turned = None if velocity is None else (sign * velocity[0], sign * velocity[1], sign * velocity[2])
    return replace(solution, time_ns=sign * solution.time_ns + offset_ns, velocity_enu_m_s=turned)


def _moved_sample(message: Message, offset_ns: int, sign: int) -> Message:
    update: dict[str, Any] = {"time_ns": sign * message.time_ns + offset_ns}
    if isinstance(message, Motion):
        readings = {"wheel_speed_m_s": message.wheel_speed_m_s, "yaw_rate_rad_s": message.yaw_rate_rad_s}
        update |= {name: sign * value for name, value in readings.items() if value is not None}
    if isinstance(message, Imu):
        # Back in time rates change their sign; accelerations, as second derivatives, do not.
        update["angular_rate_rad_s"] = tuple(sign * rate for rate in message.angular_rate_rad_s)
    return message.model_copy(update=update)


def add_bus_arguments(parser: argparse._ActionsContainer) -> None:
    """Add `--connect` and `--vehicle`: the bus that a drive is fed to."""
    parser.add_argument("--connect", action="append", metavar="ENDPOINT", help=f"router; default {_ROUTER}")
    parser.add_argument("--vehicle", metavar="V", help="name of the vehicle (default: the manifest's)")

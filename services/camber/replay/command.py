"""`camber replay`: a recorded drive through the real processes, judged, recorded, summed up."""

from __future__ import annotations

import argparse
import math
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from tqdm import tqdm

from camber.formats.drive.recording import Recorder
from camber.gnss.warm_up import warm_up
from camber.localizer.warm_up import warm_up as warm_up_matching
from camber.replay.drive_inputs import DriveInputs, Tick, prepare_drive
from camber.replay.processes import Processes
from camber.replay.run_folder import DriveFacts, RunFacts, RunFolder
from camber.replay.sweep_files import SweepReader
from camber.runtime.feeder import Feeder
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.channels import CHANNELS, SERVICES
from camber.schemas.drive import DriveManifest, load_manifest
from camber.schemas.gnss import ReceiverBytes
from camber.tools.localize.localizer_config import localizer_config
from camber.tools.options.error_report import in_words
from camber.tools.options.number_options import SEED, number_from
from camber.validation.evaluate import evaluate_folder, headline
from camber.validation.truth import offset_of, truth_of

_SUPERVISE_EVERY_S = 0.05
# Longer than the feeder runs ahead, so that the recording's order is that of the times.
_RECORD_LAG_NS = 5_000_000_000
# A killed process closes its links; one that a busy machine keeps waiting is not gone, and nothing may be lost.
_LEASE_S = 20.0


class _Stopped(KeyboardInterrupt):
    """SIGINT or SIGTERM."""


def main(argv: Sequence[str]) -> int:
    """Replay one drive; 0 done, 1 a service got stuck, 2 the drive cannot be used, 130 interrupted."""
    args = _parser().parse_args(argv)
    overrides = [*args.set, *([f"surrogates.seed={args.seed}"] if args.seed is not None else [])]

    def work() -> int:
        return replay(load_manifest(args.drive, overrides), args.out, speed=args.speed, quiet=args.quiet)

    return in_words("camber replay", args.out, work)


def replay(manifest: DriveManifest, out: Path, *, speed: float, quiet: bool = False) -> int:
    """Run the drive at `speed` times real time (infinite: as fast as it goes) and write the run's folder."""
    out.mkdir(parents=True, exist_ok=True)
    inputs = prepare_drive(manifest, out / "work")
    folder = RunFolder(out)
    facts = facts_of(manifest, inputs)
    folder.write_drive(facts, None if inputs.truth is None else truth_of(inputs.truth))
    for left_over in ("state", "logs"):  # what an earlier run has learnt would change this one's verdicts
        shutil.rmtree(out / left_over, ignore_errors=True)
    if manifest.judged_positions == "engine":
        if not quiet:
            print("camber replay: preparing the engine (a minute, the first time)", file=sys.stderr)
        warm_up()
    if manifest.sweeps is not None:
        if not quiet:
            print(
                "camber replay: preparing the matching of sweeps (a minute, the first time)", file=sys.stderr
            )
        warm_up_matching()
    endpoint = _free_endpoint()
    processes = Processes(out, service_configs(manifest, inputs, out, endpoint))
    with Recorder(folder.recording_path) as recorder:
        sweeps = SweepReader()
        wall_s = _run(manifest, inputs, processes, recorder, sweeps, endpoint, speed=speed, quiet=quiet)
        notes = [
            *inputs.notes,
            *sweeps.notes(),
            *processes.notes,
            *([recorder.problem] if recorder.problem else []),
        ]
    driven_s = (inputs.tick_times_ns[-1] - inputs.tick_times_ns[0]) / 1e9
    folder.write_run(RunFacts(speed_factor=driven_s / wall_s, wall_s=wall_s, notes=tuple(notes)))
    evaluation = evaluate_folder(folder)
    for note in notes:
        print(f"camber replay: {note}", file=sys.stderr)
    if not quiet:
        print(headline(evaluation.summary))
        print(f"summary {folder.summary_path}\nreport  {folder.report_path}")
    return 0


def _run(
    manifest: DriveManifest,
    inputs: DriveInputs,
    processes: Processes,
    recorder: Recorder,
    sweeps: SweepReader,
    endpoint: str,
    *,
    speed: float,
    quiet: bool,
) -> float:
    """Feed the drive; returns the seconds it took, starting and ending of the processes apart."""
    # Bulk is not recorded: a sweep of 50,000 points has a megabyte, and stands in the drive's own folder.
    channels = {
        channel.key_for(manifest.vehicle): channel.name for channel in CHANNELS if channel.delivery != "bulk"
    }

    def observe(key: str, data: bytes, encoding: str, arrival_ns: int) -> None:
        name = channels.get(key)
        if name is not None:
            recorder.add(name, data, key=key, arrival_ns=arrival_ns)

    settings = ServiceSettings(
        vehicle=manifest.vehicle,
        clock="replay",
        zenoh=ZenohSettings(connect=[], listen=[endpoint], lease_s=_LEASE_S),
    )
    with _interruptible(), Feeder(settings, inputs.channels, observer=observe) as feeder:
        supervisor = _Supervisor(processes)
        try:
            processes.start()
            supervisor.start()
            feeder.assemble(SERVICES, time_ns=inputs.tick_times_ns[0], meanwhile=processes.complain)
            return _feed(inputs, feeder, recorder, sweeps, processes, speed=speed, quiet=quiet)
        finally:
            supervisor.stop()
            processes.stop()


def _feed(
    inputs: DriveInputs,
    feeder: Feeder,
    recorder: Recorder,
    sweeps: SweepReader,
    processes: Processes,
    *,
    speed: float,
    quiet: bool,
) -> float:
    first_ns, last_ns = inputs.tick_times_ns[0], inputs.tick_times_ns[-1]
    greeting = _Greeting(inputs)
    written_ns = first_ns
    kills = sorted(inputs.manifest.kills, key=lambda kill: kill.at_s, reverse=True)
    began = time.monotonic()
    with tqdm(total=len(inputs.tick_times_ns), unit="epoch", disable=quiet or not sys.stderr.isatty()) as bar:
        for tick in inputs.ticks():
            if math.isfinite(speed):
                due = began + (tick.time_ns - first_ns) / 1e9 / speed
                time.sleep(max(due - time.monotonic(), 0.0))
            while kills and tick.time_ns >= first_ns + round(kills[-1].at_s * 1e9):
                processes.kill(kills.pop().service)
            for message in greeting.now(tick.time_ns, feeder.participants):
                feeder.publish("receiver_bytes", message)
            for name, message in messages_of(tick, sweeps):
                feeder.publish(name, message)
            feeder.tick(tick.time_ns, last=tick.time_ns == last_ns)
            if tick.time_ns - written_ns >= 2 * _RECORD_LAG_NS:
                written_ns = tick.time_ns - _RECORD_LAG_NS
                recorder.tick_done(written_ns)
            bar.update()
    return time.monotonic() - began


class _Greeting:
    """A receiver tells whoever connects the header of its stream: a gnss that returns must hear it again."""

    def __init__(self, inputs: DriveInputs) -> None:
        self._said = inputs.greeting
        self._connected = True

    def now(self, time_ns: int, participants: frozenset[str]) -> Iterator[ReceiverBytes]:
        """What is said before all else where gnss has just come back."""
        was_connected, self._connected = self._connected, "gnss" in participants
        if self._connected and not was_connected:
            for message in self._said:
                yield message.model_copy(update={"time_ns": time_ns})


def messages_of(tick: Tick, sweeps: SweepReader) -> Iterator[tuple[str, Any]]:
    """What arrives at a tick, each with the name of its channel."""
    for name, messages in (
        ("receiver_bytes", tick.receiver),
        ("motion", tick.motion),
        ("suspension", tick.suspension),
        ("ranging", tick.ranging),
        ("sweep", sweeps.read(tick.sweeps)),
    ):
        for message in messages:
            yield name, message


def service_configs(
    manifest: DriveManifest, inputs: DriveInputs, out: Path, endpoint: str
) -> dict[str, Mapping[str, Any]]:
    """Each service's settings for this drive."""

    def config(name: str, **own: Any) -> Mapping[str, Any]:
        return {
            "vehicle": manifest.vehicle,
            "clock": "replay",
            "state_dir": out / "state" / name,
            **own,
            "zenoh": {
                "mode": "peer",
                "connect": [endpoint],
                "listen": ["tcp/127.0.0.1:0"],
                "lease_s": _LEASE_S,
            },
        }

    raw = manifest.observations
    # The files of a day are heard at once.
    engine = {"ephemerides_of_satellite": 150}
    base = {} if raw is None or raw.base_ecef_m is None else {"base_ecef_m": list(raw.base_ecef_m)}
    return {
        "gnss": config(
            "gnss",
            source="bus",
            datum=manifest.datum,
            positions=manifest.judged_positions,
            engine=engine,
            **base,
        ),
        "map_server": config(
            "map_server",
            release=(inputs.map_release or out / "work" / "no-map").resolve(),
            datum=manifest.datum,
        ),
        "localizer": config(
            "localizer",
            match_sweeps=manifest.sweeps is not None,
            **localizer_config(manifest, inputs.initial_pose),
        ),
        "antenna_height": config("antenna_height", **antenna_height_config(manifest)),
        "integrity": config("integrity", alert_limit_m=manifest.alert_limit_m),
        "map_update": config("map_update"),
    }


def antenna_height_config(manifest: DriveManifest) -> dict[str, Any]:
    """All that the vehicle has to know its antenna's height by, so that the ways are compared."""
    height, said = manifest.antenna_height, manifest.lever_arms.said
    there = {
        "antenna": True,
        "suspension": manifest.suspension is not None,
        "ranging": manifest.ranging is not None,
        "lidar": manifest.sweeps is not None,
    }
    known = {
        "fixed_height_m": height.height_m,
        "fixed_sigma_m": height.sigma_m,
        "suspension_to_antenna_m": height.suspension_to_antenna_m,
        "tyre_radius_m": height.tyre_radius_m,
        **{name: said[name].model_dump() for name, is_there in there.items() if is_there and name in said},
    }
    return {
        "way": height.way,
        "beam_azimuth_deg": height.beam_azimuth_deg,
        **{name: value for name, value in known.items() if value is not None},
    }


def facts_of(manifest: DriveManifest, inputs: DriveInputs) -> DriveFacts:
    """What evaluation takes of a drive."""
    return DriveFacts(
        drive=manifest.name,
        surrogates=manifest.surrogate_notes(),
        truth=inputs.truth is not None,
        offset_enu_m=offset_of(manifest),
        alert_limit_m=manifest.alert_limit_m,
    )


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class _Supervisor:
    """Looks after the processes while the feeder waits for them."""

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(_SUPERVISE_EVERY_S):
            self._processes.supervise()


@contextmanager
def _interruptible() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise _Stopped

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_FACTOR = number_from(0.001, 1e6, "or max")


def speed_factor(text: str) -> float:
    """Infinity for `max`, or a number; ArgumentTypeError is argparse's."""
    return math.inf if text == "max" else _FACTOR(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="camber replay", description=__doc__)
    parser.add_argument("drive", type=Path, metavar="drive.toml", help="manifest of the drive")
    parser.add_argument(
        "--speed", type=speed_factor, default=math.inf, help="times real time, or max (default)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/replay"), metavar="DIR", help="where everything goes"
    )
    parser.add_argument("--seed", type=SEED, help="seed of the surrogates")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override the manifest"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no headline")
    return parser

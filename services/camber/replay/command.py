"""`camber replay`: run a recorded drive through the services, record it and evaluate it.

The services run in one process, as fast as possible. With --processes they run as the processes of a vehicle, in lock
step over the bus: slower, but with transport, encoding and process failures. Both publish the same messages.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, ModuleType

from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.run_folder import RunFacts, RunFolder, drive_facts
from camber.replay.run_recorder import RunRecorder
from camber.replay.service_settings import service_settings
from camber.replay.single_process_replay import DriveOutput, replay_in_one_process
from camber.road_map.release import open_release
from camber.road_map.road_columns import ReleaseError
from camber.schemas.drive import DriveManifest, load_manifest
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import SEED, number_from
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.progress_display import ProgressDisplay
from camber.tools.options.shared_warm_up import warm_up_all
from camber.validation.evaluate import evaluate_folder, headline
from camber.validation.reference_trajectory import truth_of
from camber.validation.report.chart_data import CHART_CHANNELS


class StoppedBySignal(KeyboardInterrupt):
    """SIGINT or SIGTERM."""


def main(argv: Sequence[str]) -> int:
    """Replay one drive; 0 done, 1 a service got stuck, 2 the drive cannot be used, 130 interrupted."""
    parser = argument_parser()
    args = parser.parse_args(argv)
    check_speed(parser, args)
    overrides = [*args.set, *([f"surrogates.seed={args.seed}"] if args.seed is not None else [])]

    def work() -> int:
        manifest = load_manifest(args.drive, overrides)
        check_output_folder(args.out, "drive.json", "work")
        return replay(manifest, args.out, processes=args.processes, speed=args.speed, quiet=args.quiet)

    return report_failures("camber replay", args.out, work)


def replay(
    manifest: DriveManifest,
    out: Path,
    *,
    processes: bool = False,
    speed: float = math.inf,
    quiet: bool = False,
) -> int:
    """Run the drive and write the run's folder; `speed` (times real time) paces a replay through processes."""
    out.mkdir(parents=True, exist_ok=True)
    inputs = prepare_drive(manifest, out / "work")
    folder = RunFolder(out)
    folder.write_drive(drive_facts(inputs, out), None if inputs.truth is None else truth_of(inputs.truth))
    _compile(inputs, quiet=quiet)
    tick_times_ns = inputs.tick_times_ns
    recorded = None
    with (
        ProgressDisplay(len(tick_times_ns), "epoch", quiet=quiet) as display,
        RunRecorder(folder, manifest, tick_times_ns[0], settings=service_settings(inputs, out)) as recorder,
        _interruptible(),
    ):
        if inputs.map_release is not None:
            with suppress(ReleaseError):  # the map server reports a map that cannot be read
                recorder.draw_roads(open_release(inputs.map_release).road_links())
        if processes:
            from camber.replay.lock_step.drive import replay_through_processes

            wall_s, notes = replay_through_processes(
                inputs, out, recorder=recorder, speed=speed, progress=display.advance
            )
        else:
            began = time.monotonic()
            output = replay_in_one_process(
                inputs, out, channels=CHART_CHANNELS, recorder=recorder, progress=display.advance
            )
            wall_s, notes = time.monotonic() - began, output.notes
            recorded = None if recorder.notes else output.recorded
            _write_issues(out / "logs", inputs, output)
        notes = (*inputs.notes, *notes, *recorder.notes)
    driven_s = (tick_times_ns[-1] - tick_times_ns[0]) / 1e9
    folder.write_run(RunFacts(speed_factor=driven_s / wall_s, wall_s=wall_s, notes=notes))
    evaluation = evaluate_folder(folder, recorded=recorded)
    for note in notes:
        print(f"camber replay: {note}", file=sys.stderr)
    if not quiet:
        print(headline(evaluation.summary))
        print(f"summary {folder.summary_path}\nreport  {folder.report_path}")
    return 0


def _compile(inputs: DriveInputs, *, quiet: bool) -> None:
    """Compile what the drive needs of the engine, scan matching and the map server before the clock runs."""
    modules: list[ModuleType] = []
    functions = 0
    if inputs.manifest.judged_positions == "engine":
        from camber.gnss import warm_up as engine

        modules.append(engine)
        functions += engine.ENGINE_FUNCTIONS + engine.SUBSET_FUNCTIONS
    if inputs.manifest.sweeps is not None:
        from camber.localizer import warm_up as matching

        modules.append(matching)
        functions += matching.FUNCTIONS
    if inputs.map_release is not None:
        from camber.map_server import warm_up as roads

        modules.append(roads)
        functions += roads.FUNCTIONS
    warm_up_all(modules, functions, quiet=quiet)


def _write_issues(folder: Path, inputs: DriveInputs, output: DriveOutput) -> None:
    """Write the services' issues, one log file each, with the seconds since the start of the drive."""
    folder.mkdir(exist_ok=True)
    for path in folder.glob("*.log"):  # of an earlier run
        path.unlink()
    lines: dict[str, list[str]] = {}
    for issue in output.issues:
        at_s = (issue.time_ns - inputs.tick_times_ns[0]) / 1e9
        when = f"{at_s:.3f} s" if issue.time_ns else "before the drive"
        lines.setdefault(issue.service, []).append(f"{when} {issue.code}: {issue.text}\n")
    for service, of_service in lines.items():
        (folder / f"{service}.log").write_text("".join(of_service), "utf-8")


@contextmanager
def _interruptible() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise StoppedBySignal

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_FACTOR = number_from(0.001, 1e6, "or max")


def speed_factor(text: str) -> float:
    """Return infinity for `max`, or the number; raises argparse's ArgumentTypeError."""
    return math.inf if text == "max" else _FACTOR(text)


def add_speed_options(parser: argparse.ArgumentParser) -> None:
    """Add --processes and --speed."""
    parser.add_argument(
        "--processes", action="store_true", help="run each service as a process, in lock step over the bus"
    )
    parser.add_argument(
        "--speed",
        type=speed_factor,
        default=math.inf,
        help="times real time, or max (default); a number needs --processes",
    )


def check_speed(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Exit with code 2 where a speed is asked for that nobody could watch."""
    if math.isfinite(args.speed) and not args.processes:
        parser.error(f"--speed {args.speed:g} needs --processes: one process always runs at full speed")


def argument_parser() -> argparse.ArgumentParser:
    """Return the parser of `camber replay`."""
    parser = argparse.ArgumentParser(
        prog="camber replay", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("drive", type=Path, metavar="drive.toml", help="manifest of the drive")
    add_speed_options(parser)
    add("--out", type=Path, default=Path("out/replay"), metavar="DIR", help="folder of the run")
    add("--seed", type=SEED, help="seed of the surrogates")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override the manifest")
    add("--quiet", action="store_true", help="no progress bar, no headline")
    return parser

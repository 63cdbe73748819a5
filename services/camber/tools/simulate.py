"""`camber simulate`: simulate a scenario as a recorded drive with truth, in the file formats of a vehicle.

With `--live` the drive is then published on the bus in real time, as by `camber feed`: with times shifted to now or,
with `--starts-in`, at its own times and with raw observations.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from camber.compiled.decorator import require_numba
from camber.geodesy.gps_time import gpst_from_gps_ns
from camber.runtime.clock import SystemClock
from camber.schemas.drive import load_manifest
from camber.simulator.output.drive_folder import parts_of, write_drive
from camber.simulator.output.fleet_folder import write_fleet
from camber.simulator.scenario import Scenario, ScenarioError, load_scenario, shipped
from camber.simulator.simulated_drive import simulate_drive
from camber.tools.options.compilation_bar import compilation_bar
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import SECONDS, SEED
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.progress_display import ProgressDisplay
from camber.tools.options.stop_signals import stopped_by_signals
from camber.tools.record.feed import add_bus_arguments, feed

_PROG = "camber simulate"
SCENARIO_FILE = "scenario.json"
"""In every folder of a simulation."""
_LONG_STOP_S = (
    5.0  # chosen: a longer stop at the end is reported, the route may be too short for the duration
)


def main(argv: Sequence[str]) -> int:
    """Simulate one drive or one fleet; 0 success, 2 failure, 3 the bus cannot be joined, 130 interrupted."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.out is None and not args.live:
        parser.error("expected --out DIR, --live or both")
    if args.starts_in is not None and not args.live:
        parser.error("expected --live with --starts-in")
    # SIGTERM raises KeyboardInterrupt, so that the temporary folder is removed.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return report_failures(_PROG, args.out or Path(args.scenario), lambda: _run(args), bus_code=3)
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(args: argparse.Namespace) -> int:
    overrides = [*args.set, *([f"seed={args.seed}"] if args.seed is not None else [])]
    if args.starts_in is not None:
        start = gpst_from_gps_ns(SystemClock().now_ns() + round(args.starts_in * 1e9))
        overrides.append(f"start={datetime(*start[:6]).isoformat()}")
    scenario = load_scenario(args.scenario, overrides)
    if not args.live:
        simulate(scenario, args.out, quiet=args.quiet)
        return 0
    if scenario.fleet is not None:
        raise ScenarioError(f"{scenario.name}: a fleet, expected one vehicle for --live")
    with _folder(args.out) as out:
        manifest = simulate(scenario, out, quiet=args.quiet)
        bus = {"connect": args.connect, "vehicle": args.vehicle}
        with stopped_by_signals() as stop:
            feed(load_manifest(manifest), manifest.parent, stop, **bus, prog=_PROG)
    return 0


@contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    """Yield the folder requested, or a temporary one."""
    if out is not None:
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="camber-simulate-") as folder:
        yield Path(folder) / "drive"


def simulate(scenario: Scenario, out: Path, *, quiet: bool, functions: int | None = None) -> Path:
    """Run the simulation, with a progress bar on a terminal; returns the manifest's path, or the folder of a fleet.

    An earlier simulation in the folder is replaced. `functions`: how many are compiled for it, if known. Raises
    ScenarioError, FormatError where something else is in the folder, OSError where a file cannot be written, and
    ModuleNotFoundError without numba.
    """
    require_numba()
    check_output_folder(out, SCENARIO_FILE)
    began = time.monotonic()
    with compilation_bar(functions, quiet=quiet):
        made, stops = (
            _fleet(scenario, out, quiet=quiet) if scenario.fleet else _drive(scenario, out, quiet=quiet)
        )
    if not quiet:
        took_s = time.monotonic() - began
        print(f"simulated {scenario.name}, seed {scenario.seed}, in {took_s:.0f} s{stops}: {made}")
    return made


def _fleet(scenario: Scenario, out: Path, *, quiet: bool) -> tuple[Path, str]:
    assert scenario.fleet is not None
    _make_room(out, scenario)
    with ProgressDisplay(scenario.fleet.vehicles, "vehicle", quiet=quiet) as display:
        for _ in write_fleet(out, scenario):
            display.advance()
    return out, ""


def _drive(scenario: Scenario, out: Path, *, quiet: bool) -> tuple[Path, str]:
    """Return the manifest's path, and a note where the vehicle stops early."""
    drive = simulate_drive(scenario)
    stops = ""
    if drive.arrives_s < scenario.duration_s - _LONG_STOP_S:
        stops = f", at the end of its route after {drive.arrives_s:.0f} s"
    _make_room(out, scenario)
    with ProgressDisplay(parts_of(drive), "part", quiet=quiet) as display:
        for part in write_drive(out, drive):
            display.describe(part)
            display.advance()
    return out / "drive.toml", stops


def _make_room(out: Path, scenario: Scenario) -> None:
    if out.is_dir():
        shutil.rmtree(out)
    out.mkdir(parents=True)
    (out / SCENARIO_FILE).write_text(scenario.model_dump_json(indent=1) + "\n", "utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__)
    add = parser.add_argument
    add("scenario", metavar="SCENARIO", help=f"a file, or one of {', '.join(shipped())}")
    add("--out", type=Path, metavar="DIR", help="output folder; optional with --live")
    add("--live", action="store_true", help="then publish the drive on the bus in real time")
    live = parser.add_argument_group("with --live")
    text = "start the drive S seconds from now, with raw observations; simulating it must not take longer"
    live.add_argument("--starts-in", type=SECONDS, metavar="S", help=text)
    add_bus_arguments(live)
    add("--seed", type=SEED, help="random seed")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override the scenario")
    add("--quiet", action="store_true", help="no progress bar, no summary line")
    return parser

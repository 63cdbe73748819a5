"""`camber demo`: simulate two minutes of driving in a city and replay them through all services."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from camber.replay.command import add_speed_options, check_speed, replay
from camber.replay.short_drive import write_short_drive
from camber.schemas.drive import load_manifest
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import SEED
from camber.tools.options.output_check import check_output_folder
from camber.tools.options.parsers import add_with_default

CITY_FUNCTIONS = 20
"""Compiled functions that simulating the city calls from Python."""


def main(argv: Sequence[str]) -> int:
    """Simulate and replay the drive; prints the summary."""
    parser = argparse.ArgumentParser(prog="camber demo", description=__doc__)
    add_with_default(parser, "--out", Path("out/demo"), "output folder", type=Path, metavar="DIR")
    parser.add_argument("--seed", type=SEED, help="seed of the drive")
    add_speed_options(parser)
    text = (
        "use a street with wrong fixes at known times instead of the city: created in a second, without numba"
    )
    parser.add_argument("--short", action="store_true", help=text)
    text = "judge the positions of Camber's RTK engine from the raw observations, and not the receiver's"
    parser.add_argument("--engine", action="store_true", help=text)
    parser.add_argument(
        "--open", action="store_true", help="show it on a live page in the browser at the end"
    )
    args = parser.parse_args(argv)
    check_speed(parser, args)
    if args.short and args.engine:
        parser.error("--engine: the short drive has no raw observations")

    def work() -> int:
        check_output_folder(args.out, "drive.json", "work", "city/scenario.json")
        args.out.mkdir(parents=True, exist_ok=True)
        manifest = load_manifest((_short if args.short else _city)(args.out, args.seed))
        if args.engine:
            manifest = manifest.model_copy(update={"positions": "engine"})
        code = replay(manifest, args.out, processes=args.processes, speed=args.speed)
        if args.open:
            # Imported here: a demo without a page needs no web server.
            from camber.live.command import main as live

            return code or live([str(args.out), "--open"])
        print(f"on a map: {_command()} live {args.out}")
        return code

    return report_failures("camber demo", args.out, work)


def _command() -> str:
    """The command as it was typed: in a checkout it is not on the path."""
    return sys.argv[0] if Path(sys.argv[0]).name == "camber" else "camber"


def _short(out: Path, seed: int | None) -> Path:
    return write_short_drive(out / "drive", 1 if seed is None else seed)


def _city(out: Path, seed: int | None) -> Path:
    # Imported here: the short drive must work where the simulator's extra is not installed.
    from camber.simulator.scenario import load_scenario
    from camber.tools.simulate import simulate

    scenario = load_scenario("city", [] if seed is None else [f"seed={seed}"])
    return simulate(scenario, out / "city", quiet=False, functions=CITY_FUNCTIONS)

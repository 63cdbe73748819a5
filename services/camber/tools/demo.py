"""`camber demo`: a short drive made on the spot, with wrong fixes at known times, through all processes."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from camber.schemas.drive import load_manifest
from camber.simulator.short_drive import write_short_drive
from camber.tools.replay import in_words, replay, speed_factor


def main(argv: Sequence[str]) -> int:
    """Make and replay the drive; the summary goes to standard output."""
    parser = argparse.ArgumentParser(prog="camber demo", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="where everything goes"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the drive")
    parser.add_argument(
        "--speed", type=speed_factor, default=math.inf, help="times real time, or max (default)"
    )
    args = parser.parse_args(argv)

    def work() -> int:
        args.out.mkdir(parents=True, exist_ok=True)
        return replay(
            load_manifest(write_short_drive(args.out / "drive", args.seed)), args.out, speed=args.speed
        )

    return in_words("camber demo", args.out, work)

"""`camber demo`: a short drive made on the spot, with wrong fixes at known times, through all processes."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from camber.schemas.drive import load_manifest
from camber.simulator.short_drive import write_short_drive
from camber.tools.replay import replay


def main(argv: Sequence[str]) -> int:
    """Make and replay the drive; the summary goes to standard output."""
    parser = argparse.ArgumentParser(prog="camber demo", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="where everything goes"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the drive")
    parser.add_argument(
        "--speed", type=float, default=math.inf, help="times real time (default: as fast as it goes)"
    )
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    manifest = load_manifest(write_short_drive(args.out / "drive", args.seed))
    return replay(manifest, args.out, speed=args.speed)

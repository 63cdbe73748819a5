"""Camber's figures beside those of a peer in the same run: `python benchmarks/run.py --out out/bench.json`.

Every file beside this one with a function `figures` is an area. Absolute figures are this machine's under its load of
now; ratios hold better. About twenty minutes.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
import traceback
from dataclasses import asdict
from pathlib import Path

from figure import Figure


def areas() -> list[str]:
    files = sorted(Path(__file__).parent.glob("*.py"))
    return [file.stem for file in files if "\ndef figures(" in file.read_text()]


def table(figures: list[Figure]) -> str:
    width = max(len(figure.name) for figure in figures)
    lines = [f"{'':{width}}  {'ours':>10}  {'peer':>10}  {'':8}  ratio"]
    for f in figures:
        lines.append(
            f"{f.name:{width}}  {f.ours:10.4g}  {f.peer:10.4g}  {f.unit:8}  {f.ratio:.3g}  ({f.peer_name})"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/bench.json"), metavar="FILE")
    parser.add_argument("areas", nargs="*", metavar="AREA", help=f"of {', '.join(areas())}; default: all")
    args = parser.parse_args()
    if unknown := set(args.areas) - set(areas()):
        parser.error(f"no area {min(unknown)}, expected one of {', '.join(areas())}")
    figures: list[Figure] = []
    failed = []
    for area in args.areas or areas():
        began = time.monotonic()
        try:
            figures += importlib.import_module(area).figures()
        except Exception:
            traceback.print_exc()
            failed.append(area)
        print(f"{area}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(
        json.dumps([asdict(figure) for figure in figures], indent=2, ensure_ascii=False) + "\n"
    )
    if figures:
        print(table(figures))
    print(f"load of this machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {args.out}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""`camber common_faults`: faults that all fixes share, on flat and hilly ground, and what the judge makes of them.

Each drive is a job of its own; its figures are kept as one file of JSON in the folder, and the page is made of the
files that are there. `--keep` runs only what is not there yet.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, get_args

from camber.replay.run_folder import write_whole
from camber.simulator.world.countryside import Ground
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import PROCESSES, SEED, number_from
from camber.tools.options.output_check import check_output_folder
from camber.validation.common_faults.drive import Setting
from camber.validation.common_faults.fault_cases import BY_NAME
from camber.validation.common_faults.page import page
from camber.validation.common_faults.run import PARTS, REFERENCES, FaultJob, run_job

_PROG = "camber common_faults"
GROUNDS: tuple[Ground, ...] = get_args(Ground)
FAULT_S, LIDAR_S, LONG_S = 600.0, 110.0, 1800.0
"""Chosen: 7 km after which 0.02 m/s are 7 m; a minute and a half of LiDAR; half an hour."""
_FIRST_LONG_SEED = 101  # chosen: other roads than those of the faults


def main(argv: Sequence[str]) -> int:
    """Run what is asked for and write the page; returns the exit code."""
    args = _parser().parse_args(argv)

    def work() -> int:
        if not args.page_only:
            check_output_folder(args.out, *(f"{part}-*-*.json" for part in PARTS))
            _run(list(_jobs(args)), args.out, workers=args.processes, keep=args.keep)
        figures = [json.loads(path.read_text("utf-8")) for path in sorted(args.out.glob("*.json"))]
        text = page(figures)
        if args.page is None:
            print(text, end="")
        else:
            write_whole(args.page, text.encode("utf-8"))
        return 0

    return report_failures(_PROG, args.out, work)


def _jobs(args: argparse.Namespace) -> Iterator[FaultJob]:
    """Drives of one setting one after the other: they have the roads in common."""
    parts, references = args.only or PARTS, args.references or REFERENCES
    if "faults" in parts:
        names = args.cases or list(BY_NAME)
        for seed in args.seeds:
            for ground in args.grounds or GROUNDS:
                for name in names:
                    if BY_NAME[name].scene == "country":
                        setting = Setting(ground=ground, seed=seed, lasts_s=FAULT_S)
                        for reference in references:
                            yield FaultJob(part="faults", fault=name, setting=setting, reference=reference)
            for name in names if args.lidar else ():
                scene = BY_NAME[name].scene
                if scene != "country":
                    setting = Setting(scene=scene, seed=seed, lasts_s=LIDAR_S)
                    for reference in references:
                        yield FaultJob(part="faults", fault=name, setting=setting, reference=reference)
    drives = {"controls": round(args.hours * 3600.0 / LONG_S), "episodes": args.episode_drives}
    for part in [p for p in PARTS if p in parts and p != "faults"]:
        for k in range(drives[part]):
            for ground in args.grounds or GROUNDS:
                setting = Setting(ground=ground, seed=_FIRST_LONG_SEED + k, lasts_s=LONG_S)
                for reference in references:
                    yield FaultJob(part=part, fault="none", setting=setting, reference=reference)


def _run(jobs: Sequence[FaultJob], out: Path, *, workers: int, keep: bool) -> None:
    out.mkdir(parents=True, exist_ok=True)
    due = [job for job in jobs if not (keep and (out / f"{job.name}.json").exists())]
    began = time.monotonic()
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    if workers == 1:
        results = map(_work, due)
        _keep(due, results, out, began)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        _keep(due, pool.map(_work, due), out, began)


def _keep(due: Sequence[FaultJob], results: Iterator[dict[str, Any]], out: Path, began: float) -> None:
    for done, (job, figures) in enumerate(zip(due, results, strict=True), start=1):
        write_whole(out / f"{job.name}.json", (json.dumps(figures, indent=1) + "\n").encode("utf-8"))
        spent_s = time.monotonic() - began
        print(f"{done} of {len(due)}: {job.name}, {spent_s:.0f} s", file=sys.stderr, flush=True)


def _work(job: FaultJob) -> dict[str, Any]:
    folder = Path(tempfile.mkdtemp(prefix="camber-common-faults-"))
    try:
        began = time.monotonic()
        figures = run_job(job, folder)
        return figures | {"took_s": time.monotonic() - began}
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__)
    add = parser.add_argument
    add("--only", action="append", choices=PARTS, help="this part; may be repeated")
    add("--cases", nargs="+", choices=sorted(BY_NAME), help="these faults; all where not given")
    add("--grounds", nargs="+", choices=GROUNDS, help="flat, hilly or both")
    add("--references", nargs="+", choices=REFERENCES, help="the judge's setting; both where not given")
    add("--seeds", type=SEED, nargs="+", default=[1, 2, 3, 4, 5], metavar="SEED", help="drives of each fault")
    add("--lidar", action="store_true", help="the drives with LiDAR too, minutes each")
    add(
        "--hours",
        type=number_from(0.5, 1000.0, "h"),
        default=10.0,
        help="of drives without fault, each ground",
    )
    add(
        "--episode-drives", type=int, default=10, metavar="N", help="half hours with wrong fixes, each ground"
    )
    add("--out", type=Path, default=Path("out/common-faults"), metavar="DIR", help="where figures go")
    add("--page", type=Path, metavar="FILE", help="write the page there; else it is printed")
    add("--page-only", action="store_true", help="drive nothing: the page of what is there")
    add("--keep", action="store_true", help="run only what has no figures yet")
    add("--processes", type=PROCESSES, default=1, help="drives at a time")
    return parser


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

"""`camber evidence`: recorded and simulated drives through all services, and docs/evidence.md of what came out.

Each drive is a job of its own, two processes at a time; its figures are kept as one file of JSON in the folder, and the
page is made from the files that are there. `--keep` runs only what is not there yet.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.formats.errors import FormatError
from camber.replay.run_folder import write_whole
from camber.tools.options.number_options import PROCESSES, SEED, number_from, whole_from
from camber.tools.options.output_check import check_output_folder
from camber.validation.evidence.faults import run_faults
from camber.validation.evidence.nagoya import REQUIREMENTS, run_seed
from camber.validation.evidence.page import page
from camber.validation.evidence.simulated_drives import WITHOUT, run_drive
from camber.validation.lab.page import page as lab_page

_PROG = "camber evidence"
PARTS = ("faults", "drives", "nagoya")
"""The longest job first."""
NAGOYA = Path("tests/replay/nagoya.toml")
DRIVE_SEEDS = (9301, 9302, 9303)
CANYONS_S = 1800.0
"""Chosen: about as long as the recorded drives that it is compared with."""
LIDAR_S = 60.0
"""Chosen: a minute of sweeps is matched in some minutes."""
_NO_STREAMS = "satellites.streams=false"
_SYSTEMS_OF_R = 'satellites.systems="GJC"'


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One drive: its part, the name of its file, the function that runs it and its arguments."""

    part: str
    name: str
    run: Callable[..., dict[str, Any]]
    arguments: dict[str, Any]


def main(argv: Sequence[str]) -> int:
    """Run what is asked for and write the page.

    0 done, 1 a drive could not be run, 2 the folder has other things in it, 130 interrupted.
    """
    parser = _parser()
    args = parser.parse_args(argv)
    if args.page_only and args.page is None:
        parser.error("--page-only needs --page")
    notes: list[str] = []
    try:
        parts = () if args.page_only else args.only or PARTS
        jobs = [job for part in parts for job in _jobs(part, args, notes)]
        failed: list[str] = []
        if not args.page_only:
            check_output_folder(args.out, "work")
            failed = _run(jobs, args.out, workers=args.processes, keep=args.keep, quiet=args.quiet)
        notes += failed
        if args.page is not None:
            args.page.write_text(_page(args.out, args.lab, notes), "utf-8")
    except FormatError as error:
        print(f"{_PROG}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{_PROG}: {error.filename or args.out}: {error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{_PROG}: interrupted", file=sys.stderr)
        return 130
    for note in notes:
        print(f"{_PROG}: {note}", file=sys.stderr)
    if not args.quiet and args.page is not None:
        print(args.page)
    return 1 if failed else 0


def _jobs(part: str, args: argparse.Namespace, notes: list[str]) -> Iterator[Job]:
    if part == "nagoya":
        if not os.environ.get("CAMBER_DATA"):
            notes.append("Nagoya was skipped: CAMBER_DATA is not set, so there is no recording.")
            return
        for seed in range(args.first_seed, args.first_seed + args.seeds):
            for required in REQUIREMENTS:
                sigma_m = required.map_sigma_m
                arguments = {"manifest": args.nagoya, "seed": seed, "map_sigma_m": sigma_m}
                name = f"sigma-{sigma_m:.2f}-seed-{seed:03d}"
                yield Job(part=part, name=name, run=run_seed, arguments=arguments)
    elif part == "drives":
        canyons = ("canyons", f"duration_s={args.duration_s or CANYONS_S}", _NO_STREAMS, _SYSTEMS_OF_R)
        lidar_s = min(args.duration_s or LIDAR_S, LIDAR_S)
        city = ("city", f"duration_s={lidar_s}", _NO_STREAMS, "lidar.beams=32")
        for scenario, *overrides in (canyons, city):
            for seed in args.drive_seeds:
                arguments = {"scenario": scenario, "seed": seed, "overrides": overrides}
                yield Job(part=part, name=f"{scenario}-seed-{seed}", run=run_drive, arguments=arguments)
        scenario, *overrides = canyons
        seed = args.drive_seeds[0]
        arguments = {"scenario": scenario, "seed": seed, "overrides": overrides, "re_estimation": WITHOUT}
        name = f"{scenario}-seed-{seed}-without-re-estimation"
        yield Job(part=part, name=name, run=run_drive, arguments=arguments)
    else:
        seed = args.drive_seeds[0]
        arguments = {"seed": seed, "overrides": (_NO_STREAMS,), "lidar": not args.no_lidar}
        yield Job(part=part, name=f"faults-seed-{seed}", run=run_faults, arguments=arguments)
        if args.no_lidar:
            notes.append("Faults were driven without a LiDAR, and those that concern it left out.")


def _run(jobs: Sequence[Job], out: Path, *, workers: int, keep: bool, quiet: bool) -> list[str]:
    """Run the jobs; returns a line for each that failed. Their files appear whole or not at all."""
    if not keep:
        for part in {job.part for job in jobs}:
            shutil.rmtree(out / part, ignore_errors=True)
    due = [job for job in jobs if not _file(out, job).exists()]
    failed: list[str] = []
    began = time.monotonic()
    # Small matrices gain nothing from more threads; the children inherit this.
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_without_user_settings) as pool:
        running = {pool.submit(_work, job, out / "work"): job for job in due}
        for done, future in enumerate(as_completed(running), start=1):
            job = running[future]
            error = future.exception()
            if error is not None:
                failed.append(f"{job.part} {job.name} could not be run: {type(error).__name__}: {error}")
            else:
                path = _file(out, job)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_whole(path, (json.dumps(future.result(), indent=1) + "\n").encode("utf-8"))
            if not quiet:
                spent_s = time.monotonic() - began
                progress = f"{done} of {len(due)}: {job.part} {job.name}, {spent_s:.0f} s"
                print(progress, file=sys.stderr, flush=True)
    return failed


def _work(job: Job, work: Path) -> dict[str, Any]:
    folder = work / f"{job.part}-{job.name}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        return job.run(folder=folder, **job.arguments)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _without_user_settings() -> None:
    """The drive's settings alone count: an operator's environment must not change the evidence."""
    for name in [name for name in os.environ if name.startswith("CAMBER_") and name != "CAMBER_DATA"]:
        del os.environ[name]


def _file(out: Path, job: Job) -> Path:
    return out / job.part / f"{job.name}.json"


def _page(out: Path, lab: Path, notes: Sequence[str]) -> str:
    faults, drives, nagoya = (
        [json.loads(path.read_text("utf-8")) for path in sorted((out / part).glob("*.json"))]
        for part in PARTS
    )
    of_lab = lab_page(json.loads(lab.read_text("utf-8"))) if lab.exists() else None
    return page(nagoya, drives, faults, lab=of_lab, notes=notes)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__)
    add = parser.add_argument
    count, duration_s = whole_from(1, 10_000), number_from(1.0, 86_400.0, "s")
    lab = Path("out/lab/lab.json")
    add("--only", action="append", choices=PARTS, help="this part; may be repeated")
    add("--seeds", type=count, default=50, metavar="N", help="drives of the recording for each σ")
    add("--first-seed", type=SEED, default=1, help="the first of their seeds")
    seeds = list(DRIVE_SEEDS)
    add("--drive-seeds", type=SEED, nargs="+", default=seeds, metavar="SEED", help="simulated drives")
    add("--duration-s", type=duration_s, help="of the simulated drives; 1800 where not given")
    add("--nagoya", type=Path, default=NAGOYA, metavar="FILE", help="the recording's manifest")
    add("--lab", type=Path, default=lab, metavar="FILE", help="the lab's result")
    add("--out", type=Path, default=Path("out/evidence"), metavar="DIR", help="where figures go")
    add("--page", type=Path, metavar="FILE", help="write the page there, docs/evidence.md")
    add("--page-only", action="store_true", help="drive nothing: the page of what is there")
    add("--no-lidar", action="store_true", help="faults without a LiDAR, in minutes")
    add("--keep", action="store_true", help="run only what has no figures yet")
    add("--processes", type=PROCESSES, default=2, help="drives at a time")
    add("--quiet", action="store_true", help="no line for each drive")
    return parser


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

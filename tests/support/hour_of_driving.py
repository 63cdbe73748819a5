"""An hour of simulated driving through the localizer: does its memory stay flat, is any tile loaded twice?

    PYTHONPATH=tests python -m support.hour_of_driving [--minutes 60] [--seed 5] [--columns 450] [--every 5]

The drive is made in a process of its own, round after round through all levels of a city; the localizer's memory is
that of this one. Fewer columns and fewer turns of the LiDAR than a real one's make the hour affordable: what is held of
the map is the same.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import multiprocessing
import os
import statistics
import sys
import time
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.localization import GivenPose, Localization, LocalizationOptions
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.runtime.health.memory_release import return_freed_memory
from camber.schemas.road import TileReply, TileRequest
from camber.tools.localize.local_map_queries import LocalMapQueries, release_for

ROUND_S = 345.0
WARM_MINUTES = 10.0  # a whole round and more: all of the map has been seen


class CountedTiles(LocalMapQueries):
    """Counts the loadings of each tile, by its first part."""

    def __init__(self, folder: Path) -> None:
        super().__init__(release_for(folder, "WGS84"))
        self.loaded: Counter[tuple[str, int, int]] = Counter()

    def tile(self, request: TileRequest) -> TileReply:
        if request.part == 0:
            self.loaded[request.layer, request.x, request.y] += 1
        return super().tile(request)


class Tally:
    def __init__(self) -> None:
        self.counted: Counter[str] = Counter()

    def issue(self, code: str, text: str) -> None:
        self.counted[f"issue {code}"] += 1

    def count(self, name: str) -> None:
        self.counted[name] += 1


def make(pipe: Connection, seed: int, minutes: float, columns: int, every: int) -> None:
    """The drive, tick by tick, into a pipe; first where it begins and where its map is."""
    from support import lidar_drives

    lidar_drives.BEAMS_32 = dataclasses.replace(lidar_drives.BEAMS_32, columns=columns)  # type: ignore[misc]
    rounds = math.ceil(60.0 * minutes / ROUND_S) + 1
    drive = lidar_drives.lidar_drive("city", seed, duration_s=60.0 * minutes, route="round", rounds=rounds)
    pipe.send((drive.given_pose(), drive.body, drive.map_folder))
    for tick in drive.ticks(every=every):
        pipe.send((tick.motion, tick.sweep))
    pipe.send(None)


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--columns", type=int, default=450)
    parser.add_argument("--every", type=int, default=5)
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    maker = context.Process(
        target=make, args=(theirs, args.seed, args.minutes, args.columns, args.every), daemon=True
    )
    maker.start()
    theirs.close()
    given, body, folder = ours.recv()
    answers, tally = CountedTiles(folder), Tally()
    localization = Localization(options(given, body), answers, tally)
    begin_ns, minute, cpu_s, sweeps, memory = None, 0, 0.0, 0, list[float]()
    while (tick := ours.recv()) is not None:
        motion, sweep = tick
        began_s = time.process_time()
        if motion is not None:
            localization.on_motion(motion)
            begin_ns = motion.time_ns if begin_ns is None else begin_ns
        if sweep is not None:
            localization.on_sweep(sweep)
            sweeps += 1
        step = localization.advance()
        cpu_s += time.process_time() - began_s
        if step.pose is None or begin_ns is None or step.pose.time_ns - begin_ns < minute * 60_000_000_000:
            continue
        return_freed_memory()  # as the service does every ten seconds
        memory.append(resident_mb())
        print(
            f"{minute:3d} min  {memory[-1]:6.1f} MB  {step.pose.mode:14s} "
            f"{1e3 * cpu_s / max(sweeps, 1):5.1f} ms of CPU a sweep"
        )
        sys.stdout.flush()
        minute += 1
    maker.join()
    warm = memory[int(WARM_MINUTES) :] or memory[-1:]
    first, last = statistics.fmean(warm[:10]), statistics.fmean(warm[-10:])
    print(
        f"ten minutes after {WARM_MINUTES:g} min: {first:.1f} MB, the last ten {last:.1f} MB: {last / first - 1.0:+.1%}"
    )
    print(f"at most {max(warm):.1f} MB: which blocks are held differs from place to place")
    print(
        f"sweeps {sweeps}; loadings of a tile, at most {max(answers.loaded.values())}; {dict(tally.counted)}"
    )
    print(dict(answers.loaded))
    return 0


def options(given: Any, body: Any) -> LocalizationOptions:
    """As a replay would set the localizer up."""
    start = GivenPose(
        latitude_deg=given.latitude_deg,
        longitude_deg=given.longitude_deg,
        yaw_deg=given.yaw_deg,
        horizontal_sigma_m=given.horizontal_sigma_m,
        yaw_sigma_deg=given.yaw_sigma_deg,
    )
    return LocalizationOptions(
        model=PoseModel(antenna_x_m=body.antenna[0], antenna_y_m=body.antenna[1]),
        antenna_z_m=body.antenna[2],
        given=start,
        matching=ScanMatchOptions(mount=SensorMount(x_m=body.lidar[0], y_m=body.lidar[1], z_m=body.lidar[2])),
    )


if __name__ == "__main__":
    raise SystemExit(main())

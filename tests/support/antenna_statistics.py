"""How well each method knows the antenna's height in simulated drives, and how soon a change of the vehicle is noticed.

PYTHONPATH=tests python -m support.antenna_statistics --seeds 8101 8102 8103 [--parts matched] [--attitude measured]

Runs antenna_height in this process. Part *matched*: over drives with a LiDAR that the localizer itself poses
and matches (seven minutes for each seed and core), a street over a hill among them, 10 % up and down; with a ranging
sensor, and with the LiDAR's own returns in its stead. *ways*: over many more without a LiDAR, poses made from the truth
and roads from the simulated survey. *changes*: how soon another tyre or load is noticed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from camber.antenna_height.estimator import AntennaHeightEstimator
from camber.antenna_height.settings import AntennaHeightSettings
from camber.schemas.antenna import AntennaHeight, HeightByMethod
from camber.simulator.injected_faults import ChangedLoad, ChangedTyre, Fault
from support.antenna_drives import AntennaDrive, antenna_drive, matched_drive, settings_of, slope_drive
from support.lidar_drives import HILL

SCENARIOS = ("open-sky", "city", "overpass", "canyon")
MATCHED = {HILL: (3.0, 130.0), "city": (10.0, 40.0), "overpass": (5.0, 40.0)}
"""Seconds of the route at which a drive with a LiDAR begins, and how many it lasts."""
FLAT = 0.03
STEEP = 0.06
PARTS = ("matched", "ways", "changes")
_EVERY_NS = 100_000_000


def run(drive: AntennaDrive, settings: AntennaHeightSettings) -> list[AntennaHeight]:
    """The heights of a drive, ten times a second."""
    messages = drive.messages
    antenna = AntennaHeightEstimator(settings.options())
    handlers = antenna.handlers()
    heights = []
    due_ns = messages[0][1].time_ns + _EVERY_NS
    for name, message in messages:
        while message.time_ns > due_ns:
            heights.append(antenna.height(due_ns).height)
            due_ns += _EVERY_NS
        handlers[name](message)
    return heights


def by_method(height: AntennaHeight) -> Iterable[HeightByMethod]:
    """The height of every method, the chosen one included."""
    if height.way is not None and height.height_m is not None and height.sigma_m is not None:
        yield HeightByMethod(way=height.way, height_m=height.height_m, sigma_m=height.sigma_m)
    yield from height.others


@dataclass(slots=True)
class Errors:
    """Of one method: error, σ and the road's true steepness for each height."""

    error_m: list[float] = field(default_factory=list)
    sigma_m: list[float] = field(default_factory=list)
    steepness: list[float] = field(default_factory=list)

    def figures(self) -> dict[str, float | int]:
        error, sigma = np.abs(self.error_m), np.array(self.sigma_m)
        steep = np.array(self.steepness)
        figures: dict[str, float | int] = {
            "heights": len(error),
            "within_3_sigma": float(np.mean(error <= 3.0 * sigma)),
            "sigma_median_m": float(np.median(sigma)),
            "p95_m": float(np.quantile(error, 0.95)),
        }
        for name, inside in (("flat", steep <= FLAT), ("steep", steep >= STEEP)):
            if inside.any():
                figures[f"{name}_heights"] = int(np.sum(inside))
                figures[f"{name}_p95_m"] = float(np.quantile(error[inside], 0.95))
        return figures


def judged(
    heights: Iterable[AntennaHeight], true_m: Callable[[int], float], steepness: Callable[[int], float]
) -> dict[str, Errors]:
    """Errors by method."""
    by_name: dict[str, Errors] = defaultdict(Errors)
    for height in heights:
        truth_m = true_m(height.time_ns)
        if np.isnan(truth_m):
            continue
        for one in by_method(height):
            errors = by_name[one.way]
            errors.error_m.append(one.height_m - truth_m)
            errors.sigma_m.append(one.sigma_m)
            errors.steepness.append(steepness(height.time_ns))
    return by_name


def status_shares(heights: Sequence[AntennaHeight]) -> dict[str, float]:
    """The share of each status."""
    return {
        status: sum(one.status == status for one in heights) / len(heights)
        for status in ("known", "unknown", "disagreement")
    }


def noticed_after_s(drive: AntennaDrive, heights: Sequence[AntennaHeight], onset_ns: int) -> float | None:
    """Seconds of driving from a fault's onset to the first disagreement; None: never."""
    first = next((one for one in heights if one.time_ns >= onset_ns and one.status == "disagreement"), None)
    return None if first is None else drive.driven_s(onset_ns, first.time_ns)


CHANGES: dict[str, Fault] = {
    "tyre -10 mm": ChangedTyre(kind="changed_tyre", onset_s=60.0, radius_change_m=-0.01),
    "tyre +10 mm": ChangedTyre(kind="changed_tyre", onset_s=60.0, radius_change_m=0.01),
    "tyre -20 mm": ChangedTyre(kind="changed_tyre", onset_s=60.0, radius_change_m=-0.02),
    "load 150 kg": ChangedLoad(kind="changed_load", onset_s=60.0, load_kg=150.0),
    "load 300 kg": ChangedLoad(kind="changed_load", onset_s=60.0, load_kg=300.0),
}


def changes(seeds: Sequence[int], *, attitude: bool, fixed: bool) -> dict[str, list[float | None]]:
    """Seconds of driving after which each change is noticed, by scenario."""
    by_name: dict[str, list[float | None]] = {}
    settings = settings_of(way="stroke", **({} if fixed else {"fixed_height_m": None}))
    for scenario in ("city", "open-sky"):
        for name, fault in CHANGES.items():
            row = by_name.setdefault(f"{scenario}, {name}", [])
            for seed in seeds:
                drive = antenna_drive(scenario, seed, faults=[fault], attitude=attitude)
                onset_ns = int(drive.time_ns[0]) + 60_000_000_000
                row.append(noticed_after_s(drive, run(drive, settings), onset_ns))
    return by_name


def drives(seeds: Sequence[int], *, attitude: bool) -> dict[str, object]:
    """Errors of all methods over all scenarios, and the shares of each status."""
    by_name: dict[str, list[Errors]] = defaultdict(list)
    shares: dict[str, dict[str, float]] = {}
    made = [
        *(
            (f"{name} {seed}", antenna_drive(name, seed, attitude=attitude))
            for name in SCENARIOS
            for seed in seeds
        ),
        *((f"10 % grade {seed}", slope_drive(seed, 0.10, 0.02, attitude=attitude)) for seed in seeds),
    ]
    for name, drive in made:
        heights = run(drive, settings_of(way="stroke"))
        shares[name] = status_shares(heights)
        for method, errors in judged(heights, drive.true_height_m, drive.true_steepness).items():
            by_name[method].append(errors)
    return {
        "ways": {method: _together(parts).figures() for method, parts in by_name.items()},
        "statuses": shares,
    }


@dataclass(frozen=True, slots=True)
class Matched:
    """Of one drive: errors of each method and of what *automatic* passes on, and its switches."""

    methods: dict[str, Errors]
    switches: list[str]


def matched(scenario: str, seed: int, attitude: bool) -> dict[str, Matched]:
    """By what measures the distance to the road."""
    start_s, duration_s = MATCHED[scenario]
    drive = matched_drive(scenario, seed, start_s=start_s, duration_s=duration_s, attitude=attitude)
    by_name = {}
    for name, unset in (("ranging sensor", {}), ("own returns", {"ranging": None, "beam_azimuth_deg": 0.0})):
        heights = run(drive, settings_of(way="automatic", **unset))
        methods = judged(heights, drive.true_height_m, drive.true_steepness)
        passed_on = [one.model_copy(update={"others": ()}) for one in heights]
        chosen = judged(passed_on, drive.true_height_m, drive.true_steepness).values()
        by_name[name] = Matched({**methods, "automatic": _together(chosen)}, switches(heights))
    return by_name


def switches(heights: Sequence[AntennaHeight]) -> list[str]:
    """When another method was passed on than before: seconds since the first height, the method, why."""
    lines = []
    for before, now in pairwise(heights):
        if now.way != before.way:
            lines.append(
                f"{(now.time_ns - heights[0].time_ns) / 1e9:.1f} s {now.way or now.status} {now.reason}".strip()
            )
    return lines


def print_matched(seeds: Sequence[int], *, attitude: bool, processes: int) -> None:
    """The table of all methods by scenario over all seeds, and the switches of *automatic*."""
    asked = [(scenario, seed, attitude) for scenario in MATCHED for seed in seeds]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, max_tasks_per_child=1) as pool:
        results = list(pool.map(matched, *zip(*asked, strict=True)))  # raises where a process is killed
    print(TABLE)
    for scenario in MATCHED:
        of_seeds = {ask[1]: result for ask, result in zip(asked, results, strict=True) if ask[0] == scenario}
        for sensor in results[0]:
            drives_of = {seed: result[sensor] for seed, result in of_seeds.items()}
            for method in dict.fromkeys(method for drive in drives_of.values() for method in drive.methods):
                errors = _together(
                    drive.methods[method] for drive in drives_of.values() if method in drive.methods
                )
                print(row(f"{scenario}, {sensor}", method, errors))
            for seed, drive in drives_of.items():
                print("\n    ".join([f"  switches of seed {seed}: {len(drive.switches)}", *drive.switches]))


TABLE = f"{'':34}{'method':15}{'heights':>8}{'in 3 σ':>8}{'σ p50':>8}{'p95':>8}{'flat p95':>10}{'steep p95 [m]':>14}"


def row(name: str, method: str, errors: Errors) -> str:
    """Of the table; a dash where there are no such heights."""
    if not errors.error_m:
        return f"{name:34}{method:15}{0:8}"
    figures = errors.figures()
    flat, steep = (f"{figures[key]:.4f}" if key in figures else "–" for key in ("flat_p95_m", "steep_p95_m"))
    return (
        f"{name:34}{method:15}{figures['heights']:8}{figures['within_3_sigma']:8.4f}{figures['sigma_median_m']:8.4f}"
        f"{figures['p95_m']:8.4f}{flat:>10}{steep:>14}"
    )


def _together(parts: Iterable[Errors]) -> Errors:
    pooled = Errors()
    for errors in parts:
        for column in ("error_m", "sigma_m", "steepness"):
            getattr(pooled, column).extend(getattr(errors, column))
    return pooled


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--attitude", choices=("measured", "missing", "both"), default="both")
    parser.add_argument("--processes", type=int, default=1, help="of part matched")
    args = parser.parse_args()
    for attitude in {"measured": (True,), "missing": (False,), "both": (True, False)}[args.attitude]:
        print(f"attitude {'measured' if attitude else 'missing'}", flush=True)
        if "matched" in args.parts:
            print_matched(args.seeds, attitude=attitude, processes=args.processes)
        if "ways" in args.parts:
            print(json.dumps(drives(args.seeds, attitude=attitude), indent=1))
        for fixed in (True, False) if "changes" in args.parts else ():
            print(f"changes, a fixed height {'beside' if fixed else 'not measured'}")
            print(json.dumps(changes(args.seeds, attitude=attitude, fixed=fixed), indent=1))


if __name__ == "__main__":
    main()

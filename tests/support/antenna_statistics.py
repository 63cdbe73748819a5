"""How well each way knows the antenna's height in simulated drives, and how soon a change of the vehicle is noticed.

PYTHONPATH=tests python -m support.antenna_statistics --seeds 8101 8102 8103 [--parts matched] [--attitude measured]
PYTHONPATH=tests python -m support.antenna_statistics --drive drive/drive.toml
PYTHONPATH=tests python -m support.antenna_statistics --run out/replay --truth drive/truth.csv

The first runs antenna_height in this process. Part *matched*: over drives with a LiDAR that the localizer itself poses
and matches (seven minutes for each seed and core), a street over a hill among them, 10 % up and down; with a ranging
sensor, and with the LiDAR's own returns in its stead. *ways*: over many more without a LiDAR, poses made from the truth
and roads from the simulated survey. *changes*: how soon another tyre or load is noticed. The second command lets the
localizer pose and match one simulated drive; the third judges what a replay has recorded.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from camber.antenna_height.estimator import AntennaHeightEstimator
from camber.antenna_height.settings import AntennaHeightSettings
from camber.formats.drive.recording import load_recording
from camber.formats.drive.truth_csv import TruthTable, read_truth
from camber.localizer.settings import LocalizerSettings
from camber.replay.drive_inputs import Arrival, prepare_drive
from camber.replay.run_folder import RunFolder
from camber.replay.service_settings import antenna_height_settings
from camber.schemas.antenna import AntennaHeight, HeightByMethod
from camber.schemas.base import Message
from camber.schemas.drive import load_manifest
from camber.simulator.faults.schedule import ChangedLoad, ChangedTyre, Fault
from camber.tools.localize.local_map_queries import LocalMapQueries, release_for
from camber.tools.localize.localizer_config import localizer_config
from camber.tools.localize.localizer_run import localize
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
    """What antenna_height says of a drive."""
    return run_over(drive.messages, settings)


def run_over(messages: Sequence[tuple[str, Message]], settings: AntennaHeightSettings) -> list[AntennaHeight]:
    """What antenna_height says, ten times a second, of (channel, message) in the order of their times."""
    antenna = AntennaHeightEstimator(settings.options())
    handlers = antenna.handlers()
    said = []
    due_ns = messages[0][1].time_ns + _EVERY_NS
    for name, message in messages:
        while message.time_ns > due_ns:
            said.append(antenna.height(due_ns).height)
            due_ns += _EVERY_NS
        handlers[name](message)
    return said


def by_way(height: AntennaHeight) -> Iterable[HeightByMethod]:
    """What every way said, the chosen one included."""
    if height.way is not None and height.height_m is not None and height.sigma_m is not None:
        yield HeightByMethod(way=height.way, height_m=height.height_m, sigma_m=height.sigma_m)
    yield from height.others


@dataclass(slots=True)
class Errors:
    """Of one way: error, σ and the road's true steepness for each height."""

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
    said: Iterable[AntennaHeight], true_m: Callable[[int], float], steepness: Callable[[int], float]
) -> dict[str, Errors]:
    """Errors by way."""
    found: dict[str, Errors] = defaultdict(Errors)
    for height in said:
        truth_m = true_m(height.time_ns)
        if np.isnan(truth_m):
            continue
        for one in by_way(height):
            errors = found[one.way]
            errors.error_m.append(one.height_m - truth_m)
            errors.sigma_m.append(one.sigma_m)
            errors.steepness.append(steepness(height.time_ns))
    return found


def status_shares(said: Sequence[AntennaHeight]) -> dict[str, float]:
    """Which share of the time what was said."""
    return {
        status: sum(one.status == status for one in said) / len(said)
        for status in ("known", "unknown", "disagreement")
    }


def noticed_after_s(drive: AntennaDrive, said: Sequence[AntennaHeight], onset_ns: int) -> float | None:
    """Seconds of driving from a fault's onset to the first disagreement; None: never."""
    first = next((one for one in said if one.time_ns >= onset_ns and one.status == "disagreement"), None)
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
    found: dict[str, list[float | None]] = {}
    settings = settings_of(way="stroke", **({} if fixed else {"fixed_height_m": None}))
    for scenario in ("city", "open-sky"):
        for name, fault in CHANGES.items():
            row = found.setdefault(f"{scenario}, {name}", [])
            for seed in seeds:
                drive = antenna_drive(scenario, seed, faults=[fault], attitude=attitude)
                onset_ns = int(drive.time_ns[0]) + 60_000_000_000
                row.append(noticed_after_s(drive, run(drive, settings), onset_ns))
    return found


def drives(seeds: Sequence[int], *, attitude: bool) -> dict[str, object]:
    """Errors of all ways over all scenarios, and the shares of what was said."""
    found: dict[str, list[Errors]] = defaultdict(list)
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
        said = run(drive, settings_of(way="stroke"))
        shares[name] = status_shares(said)
        for way, errors in judged(said, drive.true_height_m, drive.true_steepness).items():
            found[way].append(errors)
    return {"ways": {way: _together(parts).figures() for way, parts in found.items()}, "said": shares}


@dataclass(frozen=True, slots=True)
class Matched:
    """Of one drive: errors of each way and of what *automatic* passes on, and its switches."""

    ways: dict[str, Errors]
    switches: list[str]


def matched(scenario: str, seed: int, attitude: bool) -> dict[str, Matched]:
    """By what measures the distance to the road."""
    start_s, duration_s = MATCHED[scenario]
    drive = matched_drive(scenario, seed, start_s=start_s, duration_s=duration_s, attitude=attitude)
    found = {}
    for name, unset in (("ranging sensor", {}), ("own returns", {"ranging": None, "beam_azimuth_deg": 0.0})):
        said = run(drive, settings_of(way="automatic", **unset))
        ways = judged(said, drive.true_height_m, drive.true_steepness)
        passed_on = [one.model_copy(update={"others": ()}) for one in said]
        chosen = judged(passed_on, drive.true_height_m, drive.true_steepness).values()
        found[name] = Matched({**ways, "automatic": _together(chosen)}, switches(said))
    return found


def switches(said: Sequence[AntennaHeight]) -> list[str]:
    """When another way was passed on than before: seconds since the first height, the way, why."""
    told = []
    for before, now in pairwise(said):
        if now.way != before.way:
            told.append(
                f"{(now.time_ns - said[0].time_ns) / 1e9:.1f} s {now.way or now.status} {now.reason}".strip()
            )
    return told


def print_matched(seeds: Sequence[int], *, attitude: bool, processes: int) -> None:
    """The table of all ways by scenario over all seeds, and the switches of *automatic*."""
    asked = [(scenario, seed, attitude) for scenario in MATCHED for seed in seeds]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, max_tasks_per_child=1) as pool:
        results = list(pool.map(matched, *zip(*asked, strict=True)))  # raises where a process is killed
    print(TABLE)
    for scenario in MATCHED:
        of_seeds = {ask[1]: found for ask, found in zip(asked, results, strict=True) if ask[0] == scenario}
        for sensor in results[0]:
            drives_of = {seed: found[sensor] for seed, found in of_seeds.items()}
            for way in dict.fromkeys(way for drive in drives_of.values() for way in drive.ways):
                errors = _together(drive.ways[way] for drive in drives_of.values() if way in drive.ways)
                print(row(f"{scenario}, {sensor}", way, errors))
            for seed, drive in drives_of.items():
                print("\n    ".join([f"  switches of seed {seed}: {len(drive.switches)}", *drive.switches]))


TABLE = (
    f"{'':34}{'way':15}{'heights':>8}{'in 3 σ':>8}{'σ p50':>8}{'p95':>8}{'flat p95':>10}{'steep p95 [m]':>14}"
)


def row(name: str, way: str, errors: Errors) -> str:
    """Of the table; a dash where there are no such heights."""
    if not errors.error_m:
        return f"{name:34}{way:15}{0:8}"
    figures = errors.figures()
    flat, steep = (f"{figures[key]:.4f}" if key in figures else "–" for key in ("flat_p95_m", "steep_p95_m"))
    return (
        f"{name:34}{way:15}{figures['heights']:8}{figures['within_3_sigma']:8.4f}{figures['sigma_median_m']:8.4f}"
        f"{figures['p95_m']:8.4f}{flat:>10}{steep:>14}"
    )


def _together(parts: Iterable[Errors]) -> Errors:
    pooled = Errors()
    for errors in parts:
        for column in ("error_m", "sigma_m", "steepness"):
            getattr(pooled, column).extend(getattr(errors, column))
    return pooled


def of_drive(path: Path, ways: Sequence[str]) -> dict[str, object]:
    """Localizer and antenna_height over one drive, without a bus, for each way that is passed on."""
    manifest = load_manifest(path)
    with tempfile.TemporaryDirectory() as folder:
        inputs = prepare_drive(manifest, Path(folder))
        localizer = LocalizerSettings(**localizer_config(manifest, inputs.initial_pose))
        assert inputs.map_release is not None
        assert inputs.truth is not None
        answers = LocalMapQueries(release_for(inputs.map_release, manifest.datum))
        localized = localize(inputs, localizer.options(localizer.initial_pose), answers)
    columns: dict[str, Sequence[Arrival[Any]]] = {
        "motion": inputs.motion,
        "suspension": inputs.suspension,
        "ranging": inputs.ranging,
    }
    heard: list[tuple[str, Message]] = [
        *((name, arrival.message) for name, column in columns.items() for arrival in column),
        *(("pose", pose) for pose in localized.poses),
        *(("scan_match", match) for match in localized.matches),
    ]
    heard.sort(key=lambda item: item[1].time_ns)
    matched = Counter(match.status for match in localized.matches)
    results: dict[str, object] = {"matches": dict(matched)}
    for way in ways:
        settings = AntennaHeightSettings(**{**antenna_height_settings(manifest), "way": way})
        said = run_over(heard, settings)
        words = Counter(f"{one.way}: {one.reason}"[:200] for one in said if one.reason)
        results[way] = against(inputs.truth, said) | {"reasons": dict(words.most_common(5))}
    return results


def of_recording(folder: Path, truth_path: Path) -> dict[str, object]:
    """What a replay recorded against the drive's truth."""
    recorded, _ = load_recording(RunFolder(folder).recording_path, ("antenna_height",))
    return against(read_truth(truth_path, "camber"), [item.message for item in recorded["antenna_height"]])


def against(truth: TruthTable, said: Sequence[AntennaHeight]) -> dict[str, object]:
    """Figures of what was said of one drive; steep is how the vehicle climbs."""
    start_ns = int(truth.time_ns[0])
    at = (truth.time_ns - start_ns).astype(np.float64)
    height_m = truth.more["antenna_height_m"]
    speed = np.hypot(truth.velocity_enu_m_s[:, 0], truth.velocity_enu_m_s[:, 1])
    grade = np.abs(truth.velocity_enu_m_s[:, 2]) / np.maximum(speed, 1.0)
    found = judged(
        said,
        lambda time_ns: float(np.interp(time_ns - start_ns, at, height_m)),
        lambda time_ns: float(np.interp(time_ns - start_ns, at, grade)),
    )
    return {"ways": {way: errors.figures() for way, errors in found.items()}, "said": status_shares(said)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--drive", type=Path, help="manifest of a simulated drive")
    parser.add_argument("--ways", nargs="+", default=["automatic"], help="ways passed on, with --drive")
    parser.add_argument("--run", type=Path, help="folder of a replay")
    parser.add_argument("--truth", type=Path, help="truth.csv of its drive")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--attitude", choices=("measured", "missing", "both"), default="both")
    parser.add_argument("--processes", type=int, default=1, help="of part matched")
    args = parser.parse_args()
    if args.drive is not None:
        print(json.dumps(of_drive(args.drive, args.ways), indent=1))
        return
    if args.run is not None:
        print(json.dumps(of_recording(args.run, args.truth), indent=1))
        return
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

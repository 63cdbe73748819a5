"""RTKLIB over many simulated street canyons, pooled; too long for the tests, which run a few of them.

PYTHONPATH=tests python -m support.canyon_statistics --runs 80 --rate 1
PYTHONPATH=tests python -m support.canyon_statistics --scenario canyon --runs 20

The first draws a street, a heading and a time of day from each seed; the second takes a scenario as it is shipped, with
a heading (where there is one street) and a time of day from each seed, or with --as-shipped none of that. With
CAMBER_DATA set, the shape of the wrong fixes stands beside that of the Nagoya recording.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from camber.geodesy.gps_time import NS_PER_SECOND, CalendarTime, gps_ns_from_gpst
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.random_streams import stream
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.observations import SimulatedSignals, simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER, SignalParameters
from camber.simulator.satellites.track import AntennaTrack, static_track
from camber.simulator.scenario import load_scenario
from camber.simulator.simulated_drive import simulate_drive
from support.rtklib_runs import RNX2RTKP, Solutions, run_rtklib
from support.street_canyon import SPEED_M_S, drive_through, street_canyon
from support.wrong_fix_shapes import comparison, is_wrong, nagoya_fix_errors_m, steepness

FRAME = LocalFrame(np.deg2rad(35.17), np.deg2rad(136.9), 0.0)
BASE_M = (2500.0, 1500.0, 80.0)
FIRST_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 0, 0, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """Epochs of all runs: what RTKLIB gave, columns (n,), and how many epochs there were."""

    epochs: int
    run: NDArray[np.int64]
    quality: NDArray[np.int64]
    satellites: NDArray[np.int64]
    error_enu_m: NDArray[np.float64]

    @classmethod
    def of(cls, parts: list[tuple[int, int, Solutions]]) -> Pooled:
        """From runs: seed, number of epochs, the solutions of RTKLIB."""
        return cls(
            sum(epochs for _, epochs, _ in parts),
            np.concatenate([np.full(len(f.time_ns), seed, np.int64) for seed, _, f in parts]),
            np.concatenate([f.quality for _, _, f in parts]),
            np.concatenate([f.satellites for _, _, f in parts]),
            np.concatenate([f.error_enu_m for _, _, f in parts]),
        )

    @property
    def wrong(self) -> NDArray[np.bool_]:
        return (self.quality == 1) & is_wrong(self.error_enu_m)

    @property
    def steepness_of_wrong(self) -> NDArray[np.float64]:
        return steepness(self.error_enu_m[self.wrong])

    def figures(self) -> dict[str, float | int | list[float] | dict[str, list[int]]]:
        fixed, wrong = self.quality == 1, self.wrong
        horizontal_m = np.hypot(self.error_enu_m[:, 0], self.error_enu_m[:, 1])
        slope = self.steepness_of_wrong
        bins = {"<=5": (0, 5), "6-7": (6, 7), "8-9": (8, 9), ">=10": (10, 99)}
        by_number = {
            name: [int(np.sum(wrong & inside)), int(np.sum(fixed & inside))]
            for name, (low, high) in bins.items()
            for inside in [(self.satellites >= low) & (self.satellites <= high)]
        }
        p95 = float(np.quantile(horizontal_m[fixed], 0.95)) if fixed.any() else float("nan")
        quartiles = np.quantile(slope, [0.25, 0.5, 0.75]).tolist() if len(slope) else []
        return {
            "runs": len(np.unique(self.run)),
            "epochs": self.epochs,
            "fixed_share": float(np.sum(fixed) / self.epochs),
            "fixed": int(np.sum(fixed)),
            "fixed_horizontal_p95_m": p95,
            "wrong": int(np.sum(wrong)),
            "wrong_share_of_fixes": float(np.sum(wrong) / max(np.sum(fixed), 1)),
            "wrong_with_six_or_more": float(np.sum(wrong & (self.satellites >= 6)) / max(np.sum(wrong), 1)),
            "runs_with_wrong": len(np.unique(self.run[wrong])),
            "height_over_horizontal_quartiles": quartiles,
            "wrong_of_fixed_by_satellites": by_number,
        }


def canyon_run(
    seed: int,
    rate_hz: int,
    duration_s: float = 120.0,
    parameters: SignalParameters = ROVER,
    open_sky: bool = False,
) -> tuple[AntennaTrack, SimulatedSignals, SimulatedSignals]:
    """Track, rover and base of one run; heading and time of day are drawn from the seed."""
    rng = stream(seed, "canyon run")
    canyon = street_canyon(seed, float(rng.uniform(0.0, np.pi)), SPEED_M_S * duration_s)
    begin_ns = FIRST_NS + int(rng.integers(0, 86400)) * NS_PER_SECOND
    track = drive_through(canyon, begin_ns, duration_s, rate_hz)
    around = None if open_sky else canyon.surroundings()
    true = true_ephemerides(begin_ns, int(track.time_ns[-1]), seed)
    rover = simulate_signals(track, FRAME, true, parameters, seed, "rover", around)
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, seed, "base")
    return track, rover, base


def canyon_statistics(
    seeds: range,
    rate_hz: int,
    duration_s: float = 120.0,
    parameters: SignalParameters = ROVER,
    quiet: bool = True,
    open_sky: bool = False,
) -> Pooled:
    parts = []
    for seed in tqdm(seeds, disable=quiet):
        track, rover, base = canyon_run(seed, rate_hz, duration_s, parameters, open_sky)
        true = true_ephemerides(int(track.time_ns[0]), int(track.time_ns[-1]), seed)
        with tempfile.TemporaryDirectory() as folder:
            solutions = run_rtklib(
                Path(folder), rover.epochs(), base.epochs(), broadcast_ephemerides(true, seed), FRAME,
                track.time_ns, track.antenna_m, BASE_M,
            )  # fmt: skip
        parts.append((seed, len(track.time_ns), solutions))
    return Pooled.of(parts)


def scenario_run(name: str, seed: int, as_shipped: bool) -> tuple[int, int, Solutions]:
    """A shipped scenario with another seed; heading and time of day are drawn from it, or not."""
    overrides = [f"seed={seed}"]
    if not as_shipped:
        rng = stream(seed, "scenario run")
        second = int(rng.integers(0, 86400))
        overrides.append(f"start=2026-05-02T{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}")
        if load_scenario(name).place.heading_deg is not None:
            overrides.append(f"place.heading_deg={rng.uniform(0.0, 360.0):.1f}")
    drive = simulate_drive(load_scenario(name, overrides))
    epochs = [one.rover for one in drive.outputs if one.rover is not None]
    rover = [epoch for epoch in epochs if len(epoch.satellite)]
    with tempfile.TemporaryDirectory() as folder:
        solutions = run_rtklib(
            Path(folder), rover, drive.base, drive.broadcast, drive.district.frame, drive.epoch_ns,
            drive.trajectory.antenna_m[drive.of_epoch], drive.base_m,
        )  # fmt: skip
    return seed, len(drive.epoch_ns), solutions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=80)
    parser.add_argument("--rate", type=int, default=1, help="epochs per second")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--open-sky", action="store_true", help="the same drives without any houses")
    parser.add_argument("--scenario", help="a shipped scenario instead, at its own rate")
    parser.add_argument("--as-shipped", action="store_true", help="the scenario's own heading and start")
    chosen = parser.parse_args()
    if RNX2RTKP is None:
        raise SystemExit("rnx2rtkp is not installed (Debian: rtklib)")
    began = time.monotonic()
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.runs)
    if chosen.scenario:
        pooled = Pooled.of([scenario_run(chosen.scenario, seed, chosen.as_shipped) for seed in tqdm(seeds)])
    else:
        pooled = canyon_statistics(seeds, chosen.rate, quiet=False, open_sky=chosen.open_sky)
    print(json.dumps({**pooled.figures(), "took_s": round(time.monotonic() - began, 1)}, indent=1))
    recorded = nagoya_fix_errors_m()
    of_recording = None if recorded is None else steepness(recorded[is_wrong(recorded)])
    print(comparison(pooled.steepness_of_wrong, of_recording))


if __name__ == "__main__":
    main()

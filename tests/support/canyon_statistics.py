"""RTKLIB over many simulated street canyons, pooled; too long for the tests, which run a few of them.

PYTHONPATH=tests python -m support.canyon_statistics --runs 80 --rate 1
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
from camber.simulator.satellites.parameters import BASE, ROVER, SignalParameters
from camber.simulator.satellites.signals import SimulatedSignals, simulate_signals
from camber.simulator.satellites.track import AntennaTrack, static_track
from support.rtklib_runs import RNX2RTKP, run_rtklib
from support.street_canyon import SPEED_M_S, drive_through, street_canyon

FRAME = LocalFrame(np.deg2rad(35.17), np.deg2rad(136.9), 0.0)
BASE_M = (2500.0, 1500.0, 80.0)
FIRST_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 0, 0, 0))
WRONG_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """Epochs of all runs: what RTKLIB gave, columns (n,), and how many epochs there were."""

    epochs: int
    run: NDArray[np.int64]
    quality: NDArray[np.int64]
    satellites: NDArray[np.int64]
    horizontal_m: NDArray[np.float64]
    up_m: NDArray[np.float64]

    def figures(self) -> dict[str, float | int | list[float] | dict[str, list[int]]]:
        fixed = self.quality == 1
        wrong = fixed & (self.horizontal_m > WRONG_M)
        slope = np.abs(self.up_m[wrong]) / self.horizontal_m[wrong]
        bins = {"<=5": (0, 5), "6-7": (6, 7), "8-9": (8, 9), ">=10": (10, 99)}
        by_number = {
            name: [int(np.sum(wrong & inside)), int(np.sum(fixed & inside))]
            for name, (low, high) in bins.items()
            for inside in [(self.satellites >= low) & (self.satellites <= high)]
        }
        p95 = float(np.quantile(self.horizontal_m[fixed], 0.95)) if fixed.any() else float("nan")
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
    epochs = 0
    for seed in tqdm(seeds, disable=quiet):
        track, rover, base = canyon_run(seed, rate_hz, duration_s, parameters, open_sky)
        true = true_ephemerides(int(track.time_ns[0]), int(track.time_ns[-1]), seed)
        with tempfile.TemporaryDirectory() as folder:
            found = run_rtklib(
                Path(folder), rover.epochs(), base.epochs(), broadcast_ephemerides(true, seed), FRAME,
                track.time_ns, track.antenna_m, BASE_M,
            )  # fmt: skip
        epochs += len(track.time_ns)
        parts.append((seed, found))
    return Pooled(
        epochs,
        np.concatenate([np.full(len(f.time_ns), seed, np.int64) for seed, f in parts]),
        np.concatenate([f.quality for _, f in parts]),
        np.concatenate([f.satellites for _, f in parts]),
        np.concatenate([f.horizontal_m for _, f in parts]),
        np.concatenate([f.error_enu_m[:, 2] for _, f in parts]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=80)
    parser.add_argument("--rate", type=int, default=1, help="epochs per second")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--open-sky", action="store_true", help="the same drives without any houses")
    chosen = parser.parse_args()
    if RNX2RTKP is None:
        raise SystemExit("rnx2rtkp is not installed (Debian: rtklib)")
    began = time.monotonic()
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.runs)
    pooled = canyon_statistics(seeds, chosen.rate, quiet=False, open_sky=chosen.open_sky)
    print(json.dumps({**pooled.figures(), "took_s": round(time.monotonic() - began, 1)}, indent=1))


if __name__ == "__main__":
    main()

"""Our engine beside RTKLIB over many simulated street canyons, the same observations, the same ratio; pooled.

PYTHONPATH=tests python -m support.engine_statistics --first-seed 1 --runs 20
PYTHONPATH=tests python -m support.engine_statistics --first-seed 1 --runs 20 --open-sky

A fix is wrong that is more than half a metre off. Other estimates of what the engine did not fix are counted as the
judge takes them without knowing a height: at least six integers and at least one other choice of satellites that
agrees, of up to 20 trials.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from camber.gnss.candidates.satellite_subsets import SubsetCandidate, subset_candidates
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.rtk_engine import Engine, Solution
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from support.canyon_statistics import BASE_M, FRAME, canyon_run
from support.rtklib_runs import RNX2RTKP, ecef_of, run_rtklib
from support.wrong_fix_shapes import is_wrong

TRIALS, LEAST_AGREEING, LEAST_FIXED = 20, 1, 6
RATIO = 3.0


@dataclass
class Tally:
    """Right and wrong fixes of one engine, and how far off the right ones are."""

    right: int = 0
    wrong: int = 0
    horizontal_m: list[float] = field(default_factory=list)

    def count(self, error_enu_m: NDArray[np.float64]) -> None:
        if bool(is_wrong(error_enu_m[None])[0]):
            self.wrong += 1
        else:
            self.right += 1
            self.horizontal_m.append(float(np.hypot(error_enu_m[0], error_enu_m[1])))

    def figures(self, epochs: int) -> dict[str, float | int]:
        fixed = self.right + self.wrong
        p95 = float(np.quantile(self.horizontal_m, 0.95)) if self.horizontal_m else float("nan")
        return {
            "fixed_share": round(fixed / max(epochs, 1), 4),
            "right": self.right,
            "wrong": self.wrong,
            "wrong_share_of_fixes": round(self.wrong / max(fixed, 1), 5),
            "right_horizontal_p95_m": round(p95, 4),
        }


@dataclass
class Comparison:
    """Of all runs: RTKLIB, the engine with each epoch by itself and with the Doppler prior, and what trials add."""

    epochs: int = 0
    rtklib: Tally = field(default_factory=Tally)
    alone: Tally = field(default_factory=Tally)
    alone_trials: Tally = field(default_factory=Tally)
    aided: Tally = field(default_factory=Tally)
    aided_trials: Tally = field(default_factory=Tally)

    def figures(self) -> dict[str, object]:
        return {
            "epochs": self.epochs,
            "rtklib": self.rtklib.figures(self.epochs),
            "single epoch": self.alone.figures(self.epochs),
            "single epoch, re-estimation adds": self._added(self.alone_trials, self.alone),
            "with the Doppler prior": self.aided.figures(self.epochs),
            "with the Doppler prior, re-estimation adds": self._added(self.aided_trials, self.aided),
        }

    def _added(self, trials: Tally, to: Tally) -> dict[str, float | int]:
        return {
            "right": trials.right,
            "wrong": trials.wrong,
            "right_raised_by": round(trials.right / max(to.right, 1), 4),
        }


def best_agreed(candidates: list[SubsetCandidate]) -> SubsetCandidate | None:
    """The estimate with most that agree, then the likeliest; None where none may be taken."""
    taken = [e for e in candidates if e.agreeing >= LEAST_AGREEING and e.fixed >= LEAST_FIXED]
    return max(taken, key=lambda e: (e.agreeing, e.success_rate)) if taken else None


def tally_epoch(
    solution: Solution, options: EngineSettings, truth_m: NDArray[np.float64], fixes: Tally, trials: Tally
) -> None:
    rotation = FRAME.enu_from_ecef_rotation()
    if solution.quality == "fixed" and solution.position_ecef_m is not None:
        fixes.count(rotation @ (solution.position_ecef_m - truth_m))
    elif solution.rows is not None and solution.approximate_ecef_m is not None:
        _, candidates = subset_candidates(solution, options.fix_criteria(), "all", most_trials=TRIALS)
        best = best_agreed(candidates)
        if best is not None:
            trials.count(rotation @ (best.position_ecef_m - truth_m))


def compare(
    seeds: range, duration_s: float = 120.0, open_sky: bool = False, quiet: bool = True
) -> Comparison:
    """One run a seed, 1 Hz."""
    total = Comparison()
    base_ecef = ecef_of(FRAME, np.array([BASE_M]))[0]
    for seed in tqdm(seeds, disable=quiet):
        track, rover, base = canyon_run(seed, 1, duration_s, open_sky=open_sky)
        ephemerides = broadcast_ephemerides(
            true_ephemerides(int(track.time_ns[0]), int(track.time_ns[-1]), seed), seed
        )
        rover_epochs, base_epochs = list(rover.epochs()), list(base.epochs())
        total.epochs += len(rover_epochs)
        with tempfile.TemporaryDirectory() as folder:
            theirs = run_rtklib(
                Path(folder), rover_epochs, base_epochs, ephemerides, FRAME, track.time_ns, track.antenna_m, BASE_M
            )  # fmt: skip
        for error in theirs.error_enu_m[theirs.fixed]:
            total.rtklib.count(error)
        truth = ecef_of(FRAME, track.antenna_m)
        for aided, fixes, trials in (
            (False, total.alone, total.alone_trials),
            (True, total.aided, total.aided_trials),
        ):
            options = EngineSettings(least_ratio=RATIO, doppler_aided=aided)
            engine = Engine(options, base_ecef)
            for e in ephemerides:
                engine.add_ephemeris(e)
            for of_rover, of_base, at in zip(rover_epochs, base_epochs, truth, strict=True):
                engine.add_base(of_base)
                tally_epoch(engine.solve(of_rover), options, at, fixes, trials)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--duration", type=float, default=120.0, help="seconds of a run")
    parser.add_argument("--open-sky", action="store_true", help="the same drives without any houses")
    chosen = parser.parse_args()
    if RNX2RTKP is None:
        raise SystemExit("rnx2rtkp is not installed (Debian: rtklib)")
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.runs)
    candidates = compare(seeds, chosen.duration, chosen.open_sky, quiet=False)
    print(json.dumps(candidates.figures(), indent=1))


if __name__ == "__main__":
    main()

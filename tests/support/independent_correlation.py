"""How the errors of the independent position are correlated along the way, on drives without a fault.

`PYTHONPATH=tests python -m support.independent_correlation [--seeds 101 102 …]` prints the table of
docs/theory/integrity.md, a minute or two for each drive. An error is whitened by the position's own covariance, so
that 1 is what the position states.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.integrity.learning.independent_errors import PARTS, SINGLE
from camber.replay.single_process_replay import replay_in_one_process
from camber.simulator.world.countryside import Ground
from camber.validation.common_faults.drive import Setting, fault_drive
from camber.validation.common_faults.fault_cases import BY_NAME
from camber.validation.reference_trajectory import truth_of

Floats = NDArray[np.float64]
LAGS_M = (0, 30, 60, 100, 200, 300, 500, 1000, 2000)
_EVERY = 20  # poses of 10 Hz; chosen: a sample of the judge is two seconds


def whitened_errors(setting: Setting) -> tuple[Floats, Floats]:
    """Way driven (n,) [m] and errors (n, 2) in σ, by the Cholesky factor of the covariance."""
    with tempfile.TemporaryDirectory() as folder:
        drive = fault_drive(setting, BY_NAME["none"], Path(folder) / "drive")
        output = replay_in_one_process(drive.inputs, Path(folder), channels=("pose",))
    poses = [item.message for item in output.recorded["pose"]][::_EVERY]
    there = [(pose.time_ns, pose.independent) for pose in poses if pose.independent is not None]
    time_ns = np.array([t for t, _ in there], np.int64)
    latitude, longitude = (
        np.array([getattr(i, f"{name}_rad") for _, i in there]) for name in ("latitude", "longitude")
    )
    error_m = truth_of(drive.truth).error_enu_m(
        time_ns, latitude, longitude, np.zeros(len(there)), offset_enu_m=(0.0, 0.0, 0.0)
    )
    ee, en, nn = np.array([i.covariance_east_north for _, i in there]).T
    covariance = np.stack([np.stack([ee, en], -1), np.stack([en, nn], -1)], -2)
    root = np.linalg.cholesky(covariance)
    driven_m = np.interp(time_ns, drive.truth.time_ns, drive.truth.more["driven_m"])
    return driven_m, np.linalg.solve(root, error_m[:, :2, None])[:, :, 0]


def correlation(driven_m: Floats, error: Floats, lag_m: float) -> float:
    """Mean product of errors that lie so far apart, within 30 %, over both axes."""
    apart_m = np.abs(driven_m[:, None] - driven_m[None, :])
    rows, columns = np.nonzero(np.abs(apart_m - lag_m) <= 0.3 * lag_m)
    return float((error[rows] * error[columns]).mean())


def modelled(lag_m: float) -> float:
    """What the judge assumes."""
    lasting = sum(share * np.exp(-lag_m / length_m) for share, length_m in PARTS)
    return float((1.0 - SINGLE) * lasting + (SINGLE if lag_m == 0.0 else 0.0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102])
    seeds = parser.parse_args().seeds
    print("| |" + "".join(f" {lag} m |" for lag in LAGS_M))
    print("|---|" + "---|" * len(LAGS_M))
    grounds: tuple[Ground, ...] = ("hilly", "flat")
    for ground in grounds:
        for seed in seeds:
            driven_m, error = whitened_errors(Setting(ground=ground, seed=seed, lasts_s=1800.0))
            values = [correlation(driven_m, error, lag) for lag in LAGS_M]
            print(f"| {ground}, seed {seed} |" + "".join(f" {value:.2f} |" for value in values), flush=True)
    print("| model |" + "".join(f" {modelled(lag):.2f} |" for lag in LAGS_M))


if __name__ == "__main__":
    main()

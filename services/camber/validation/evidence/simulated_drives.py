"""Evidence from simulated drives: errors as R tabulates them, and whether the truth lies in the ellipses, by mode."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.schemas.base import Float64, Int64
from camber.schemas.drive import load_manifest
from camber.simulator.scenario import load_scenario
from camber.tools.simulate import simulate
from camber.validation.evidence.evaluated_drive import evaluate_drive
from camber.validation.fix_statistics import Flags
from camber.validation.protection_level_statistics import Positions, last_row_of_epochs
from camber.validation.stanford_chart import levels_by_source

MODES = ("rtk", "doppler", "sensors", "scan_match")
LIMITS_M = (1.0, 1.5, 2.0)
RE_ESTIMATION, WITHOUT = "agreement", "off"
MORE_CONFIRMED = 1.15
"""Required: right fixes confirmed with re-estimation, by those confirmed without it."""
BLOCK_S = 20.0
"""Chosen: longer than a cause of errors lasts: a stretch without fixes, a wrong fix, a place on the map."""
PUBLISHED_BELOW = (0.918, 0.959, 0.999)
"""Shares of epochs below `LIMITS_M`: Kikuchi (TUMSAT), reliability index: Nagoya, 19,320 epochs, all with positions."""
PUBLISHED_INSIDE_99 = {"rtk": 0.999, "doppler": 0.996, "sensors": 0.981, "all": 0.993}
"""By mode, shares inside the 99 % ellipse; of the same."""
REQUIRED_BELOW = (0.99, 0.999, 1.0)


def run_drive(
    scenario: str, folder: Path, *, seed: int, overrides: Sequence[str], re_estimation: str = RE_ESTIMATION
) -> dict[str, Any]:
    """Simulate a drive, send it through one process, sum up in blocks of `BLOCK_S`."""
    made = load_scenario(scenario, [*overrides, f"seed={seed}"])
    drive = load_manifest(simulate(made, folder / "drive", quiet=True), ['positions="engine"'])
    driven = evaluate_drive(drive, folder, {"integrity": {"re_estimation": re_estimation}})
    positions_of, summary = driven.evaluation.positions, driven.evaluation.summary
    epoch_ns = np.unique([item.message.time_ns for item in driven.output.recorded["motion"]])
    return {
        "scenario": scenario,
        "seed": seed,
        "overrides": list(overrides),
        "positions": "engine",
        "re_estimation": re_estimation,
        "duration_s": summary["duration_s"],
        "epochs": summary["epochs"],
        "fixed": summary["tentative"]["fixed"],
        "wrong": summary["tentative"]["wrong"],
        "confirmed": summary["confirmed"]["count"],
        "confirmed_wrong": summary["confirmed"]["wrong"],
        "right": summary["right"]["count"],
        "right_kept": summary["right"]["kept"],
        "episodes": summary["episodes"],
        "controls": summary["controls"],
        "levels": levels_by_source(positions_of),
        "usable": summary["position"]["usable"],
        **block_counts(positions_of, epoch_ns),
    }


def block_counts(positions: Positions, epoch_ns: Int64) -> dict[str, Any]:
    """Counts by block of the drive's epochs (n,).

    `errors` (b, 5): epochs, those with a position whose error is known, those below each of `LIMITS_M`; `modes`, by
    mode (b, 3): positions with an ellipse and an error, those with the truth inside at 99 and at 99.9 %. The position
    of an epoch is `last_row_of_epochs`.
    """
    row, known = last_row_of_epochs(positions.time_ns, epoch_ns)
    block = ((epoch_ns - epoch_ns[:1]) / 1e9 // BLOCK_S).astype(np.int64)
    n = int(block.max()) + 1 if len(block) else 0

    def at_epochs(values: Float64) -> Float64:
        return np.where(known, values[row], np.nan) if len(values) else np.full(len(epoch_ns), np.nan)

    def counted(*flags: Flags) -> list[list[int]]:
        columns = [np.bincount(block, weights=flag, minlength=n) for flag in flags]
        return np.column_stack(columns).astype(int).tolist() if n else []

    error_m = at_epochs(positions.horizontal_error_m)
    square, square_99 = (
        at_epochs(values) for values in (positions.square_in_ellipse(), positions.square_in_ellipse_99())
    )
    modes = {
        mode: counted(here, here & (square_99 <= 1.0), here & (square <= 1.0))
        for mode in MODES
        for here in [np.isfinite(square) & (at_epochs((positions.source == mode).astype(np.float64)) == 1.0)]
    }
    every = np.ones(len(epoch_ns), bool)
    errors = counted(every, np.isfinite(error_m), *(error_m < limit_m for limit_m in LIMITS_M))
    return {"errors": errors, "modes": modes}


def stacked_blocks(results: Sequence[dict[str, Any]], mode: str | None) -> Float64:
    """The blocks of several drives, one after the other: of the errors (b, 5), or of a mode (b, 3)."""
    width = 5 if mode is None else 3
    tables = [np.array(r["errors"] if mode is None else r["modes"][mode], np.float64) for r in results]
    return np.concatenate([table.reshape(-1, width) for table in tables] or [np.zeros((0, width))])

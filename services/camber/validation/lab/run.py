"""A run of the lab: which blocks, how many of each, and the figures that come of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.integrity.rules import Rules
from camber.simulator.satellites.wrong_fix_shapes import Kind
from camber.validation.lab.baselines import BASELINES
from camber.validation.lab.bound_coverage import DRAWS, LEVEL_PARAMETERS, coverage_block, coverage_figures
from camber.validation.lab.error_model import ASSUMPTIONS, HEADLINE, Scene
from camber.validation.lab.false_alarms import alarms_block, sum_of
from camber.validation.lab.misleading_information import misleading_block, misleading_figures
from camber.validation.lab.missed_detection import EDGES_M, THRESHOLDS_M, MissedDetections, missed_block
from camber.validation.lab.reference_faults import SCENE, FaultCounts, faults_block
from camber.validation.lab.work_blocks import Results, WorkBlock, workers
from camber.validation.statistics import clopper_pearson

SENSITIVITY_SCENES = tuple(
    Scene(pose_sigma_m=pose_m, map_sigma_m=map_m)
    for pose_m, map_m in ((0.03, 0.05), (0.05, 0.03), (0.05, 0.10), (0.10, 0.10), (0.20, 0.05), (0.50, 0.05))
)
"""The last two: dead reckoning after some seconds."""
SCENES = (*HEADLINE, *SENSITIVITY_SCENES)
KINDS: tuple[Kind, ...] = ("search", "cycles")
_SHAPES_OF_SKY: dict[Kind, float] = {"cycles": 9.0, "search": 0.22}
_SKIES_OF_BLOCK: dict[Kind, int] = {"cycles": 50, "search": 400}
_EPISODES_OF_SKY = 25
"""Chosen: episodes of one sky are alike, so that more of them add little."""
_SENSITIVITY_SHARE = 10
"""Chosen: the other scenes get a tenth of the episodes of the headline's; nothing is required of them."""
_DRAWS_OF_TRIAL, _SKIES_OF_ALARMS = 4, 500


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSize:
    """`trials` episodes of wrong fixes of each kind in each of the two headline scenes; the rest follows from it."""

    trials: int
    seed: int

    def blocks(self, kind: Kind) -> tuple[int, int]:
        """How many blocks, and episodes of each wrong fix in them."""
        of_block = _SKIES_OF_BLOCK[kind] * _SHAPES_OF_SKY[kind]
        blocks = max(1, round(self.trials / _EPISODES_OF_SKY / _SKIES_OF_BLOCK["search"]))
        if kind == "cycles":
            blocks = max(1, round(self.trials / (_EPISODES_OF_SKY * of_block)))
        return blocks, max(1, round(self.trials / (blocks * of_block)))


def run(size: RunSize, processes: int, report: Callable[[str], None]) -> dict[str, Any]:
    """The lab's figures, as `lab.json` holds them; `report` gets a line at the start of each part."""
    rules, began = Rules(), time.monotonic()

    def now(text: str) -> None:
        report(f"{time.monotonic() - began:.0f} s: {text}")

    missed: list[dict[str, Any]] = []
    with workers(processes) as results:
        for kind in KINDS:
            now(f"wrong fixes, {kind}")
            missed += _missed(kind, size, results)
        now("right fixes")
        alarms = _alarms(size, results)
        now("faults")
        faults = _faults(size, results)
        now("levels")
        levels, hazard = _levels(size, results)
    now("done")
    return {
        "seed": size.seed,
        "trials": size.trials,
        "rules": asdict(rules.determination),
        "true_sigma": asdict(rules.true_sigma),
        "level_rules": asdict(LEVEL_PARAMETERS),
        "assumptions": asdict(ASSUMPTIONS),
        "missed": missed,
        "alarms": alarms,
        "faults": faults,
        "levels": levels,
        "hazard": hazard,
    }


def _missed(kind: Kind, size: RunSize, results: Results) -> list[dict[str, Any]]:
    blocks, repeats = size.blocks(kind)
    parts = [
        (scenes, WorkBlock(seed=size.seed, number=number, skies=_SKIES_OF_BLOCK[kind], repeats=count))
        for number in range(blocks)
        for scenes, count in (
            (HEADLINE, repeats),
            (SENSITIVITY_SCENES, max(1, repeats // _SENSITIVITY_SHARE)),
        )
    ]
    totals = {scene: MissedDetections() for scene in SCENES}
    tasks = [partial(missed_block, block, kind, scenes) for scenes, block in parts]
    for (scenes, _), of_block in zip(parts, results(tasks), strict=True):
        for scene, counts in zip(scenes, of_block, strict=True):
            totals[scene].add(counts)
    return [{"kind": kind, **asdict(scene), **_missed_figures(counts)} for scene, counts in totals.items()]


def _missed_figures(m: MissedDetections) -> dict[str, Any]:
    return {
        "epochs": m.epochs,
        "thresholds": [
            {
                "beyond_m": threshold_m,
                "harmful_episodes": int(m.harmful[t]),
                "skies": int(m.skies[t]),
                "controls": {name: _baseline(m, c, t) for c, name in enumerate(BASELINES)},
                "time_to_alert": _time_to_alert(m.stretch[t]),
            }
            for t, threshold_m in enumerate(THRESHOLDS_M)
        ],
        "curve": [
            {
                "from_m": float(EDGES_M[b]),
                "to_m": None if np.isinf(EDGES_M[b + 1]) else float(EDGES_M[b + 1]),
                "episodes": int(m.in_bin[b]),
                "confirmed": {name: int(m.confirmed_in_bin[c, b]) for c, name in enumerate(BASELINES)},
            }
            for b in range(len(EDGES_M) - 1)
        ],
    }


def _baseline(m: MissedDetections, c: int, t: int) -> dict[str, Any]:
    """Episodes of one sky are alike: the bound counts Σ misses² / Σ misses of a sky as one."""
    missed, harmful = int(m.missed[c, t]), int(m.harmful[t])
    together = max(float(m.missed_squared[c, t]) / missed, 1.0) if missed else 1.0
    low, high = clopper_pearson(missed / together, harmful / together)
    late_low, late_high = clopper_pearson(int(m.late[c, t]) / together, harmful / together)
    return {
        "missed": missed,
        "rate": missed / harmful if harmful else None,
        "lower_95": low,
        "upper_95": high,
        "of_one_sky": together,
        "late": int(m.late[c, t]),
        "late_lower_95": late_low,
        "late_upper_95": late_high,
    }


def _time_to_alert(stretch: NDArray[np.int64]) -> dict[str, Any]:
    """Of harmful episodes that the judge alerted at some epoch: longest stretch of harmful confirmed positions."""
    total = int(stretch.sum())
    if not total:
        return {"episodes": 0}
    step_s = 1.0 / ASSUMPTIONS.epochs_per_s
    beyond = total - np.cumsum(stretch)
    return {
        "episodes": total,
        "p99_s": float(np.argmax(beyond <= 0.01 * total) * step_s),
        "max_s": float(np.flatnonzero(stretch)[-1] * step_s),
        "beyond_0.2_s": int(beyond[round(0.2 / step_s)]),
        "beyond_1_s": int(beyond[round(1.0 / step_s)]),
    }


def _alarms(size: RunSize, results: Results) -> list[dict[str, Any]]:
    blocks = max(1, round(size.trials / 50 / _SKIES_OF_ALARMS))
    repeats = max(1, round(_DRAWS_OF_TRIAL * size.trials / (blocks * _SKIES_OF_ALARMS)))
    first = WorkBlock(seed=size.seed, number=0, skies=_SKIES_OF_ALARMS, repeats=repeats)
    tasks = [partial(alarms_block, replace(first, number=n), SCENES) for n in range(blocks)]
    by_block = list(results(tasks))
    rows = []
    for k, scene in enumerate(SCENES):
        row: dict[str, Any] = asdict(scene)
        for name in by_block[0][k]:
            rate = sum_of(block[k][name] for block in by_block)
            row[name] = {
                "rate": rate.rate,
                "upper_95": rate.upper,
                "effective_events": rate.effective,
                "draws": rate.draws,
            }
        rows.append(row)
    return rows


def _faults(size: RunSize, results: Results) -> dict[str, Any]:
    blocks = max(1, min(20, size.trials // 10_000))
    repeats = max(1, size.trials // (blocks * 400 * 20))
    tasks = [
        partial(faults_block, WorkBlock(seed=size.seed, number=n, repeats=repeats)) for n in range(blocks)
    ]
    totals: dict[str, FaultCounts] = {}
    for of_block in results(tasks):
        for name, counts in of_block.items():
            totals.setdefault(name, FaultCounts()).add(counts)
    rows = []
    for name, counts in totals.items():
        upper = clopper_pearson(counts.missed, counts.episodes)[1]
        rows.append({"fault": name, **asdict(counts), "missed_upper_95": upper})
    return {**asdict(SCENE), "rows": rows}


def _levels(size: RunSize, results: Results) -> tuple[dict[str, Any], dict[str, Any]]:
    """Twelve blocks of 10,000 draws of each mode, fewer of a small run."""
    draws = min(max(size.trials, 1_000), DRAWS)
    blocks = [
        WorkBlock(seed=size.seed, number=n, repeats=40) for n in range(max(1, min(12, size.trials // 8_000)))
    ]
    levels = results([partial(coverage_block, block, draws) for block in blocks])
    hazard = results([partial(misleading_block, block) for block in blocks])
    return coverage_figures(list(levels)), misleading_figures(list(hazard))

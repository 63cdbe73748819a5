"""A run of the lab: which blocks, how many of each, and the figures that come of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.integrity.rules import Rules
from camber.simulator.satellites.wrong_fix_shapes import Kind
from camber.validation.lab.baselines import BASELINES
from camber.validation.lab.bound_coverage import DRAWS, LEVEL_PARAMETERS, coverage_block, coverage_figures
from camber.validation.lab.error_model import ASSUMPTIONS, Scene
from camber.validation.lab.false_alarms import WeightedRate, alarms_block
from camber.validation.lab.misleading_information import misleading_block, misleading_figures
from camber.validation.lab.missed_detection import EDGES_M, THRESHOLDS_M, MissedDetections, missed_block
from camber.validation.lab.reference_faults import SCENE, FaultCounts, faults_block
from camber.validation.lab.work_blocks import Results, Task, workers
from camber.validation.statistics import clopper_pearson

HEADLINE = (Scene(0.05, 0.05), Scene(0.10, 0.05))
SENSITIVITY_SCENES = (
    Scene(0.03, 0.05), Scene(0.05, 0.03), Scene(0.05, 0.10), Scene(0.10, 0.10), Scene(0.20, 0.05), Scene(0.50, 0.05),
)  # fmt: skip
"""The last two: dead reckoning after some seconds."""
KINDS: tuple[Kind, ...] = ("search", "cycles")
_SHAPES_OF_SKY: dict[Kind, float] = {"cycles": 9.0, "search": 0.22}
_SKIES_OF_BLOCK: dict[Kind, int] = {"cycles": 50, "search": 400}
_EPISODES_OF_SKY = 25
_BESIDE_SHARE = 10
_DRAWS_OF_TRIAL, _SKIES_OF_ALARMS = 4, 500


@dataclass(frozen=True, slots=True)
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


def run(size: RunSize, processes: int, say: Callable[[str], None]) -> dict[str, Any]:
    """The lab's figures, as `lab.json` holds them. `say` is told what is under way."""
    rules = Rules()
    began = time.monotonic()

    def now(text: str) -> None:
        say(f"{time.monotonic() - began:.0f} s: {text}")

    missed: list[dict[str, Any]] = []
    with workers(processes) as results:
        for kind in KINDS:
            now(f"wrong fixes, {kind}")
            missed += _missed(kind, size, rules, results)
        now("right fixes")
        alarms = _alarms(size, rules, results)
        now("faults")
        faults = _faults(size, rules, results)
        now("levels")
        levels, hazard = _levels(size, rules, results)
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


def _missed(kind: Kind, size: RunSize, rules: Rules, results: Results) -> list[dict[str, Any]]:
    blocks, repeats = size.blocks(kind)
    few = max(1, repeats // _BESIDE_SHARE)
    skies = _SKIES_OF_BLOCK[kind]
    tasks = [
        Task(missed_block, (kind, scenes, size.seed, block, skies, count, rules))
        for block in range(blocks)
        for scenes, count in ((HEADLINE, repeats), (SENSITIVITY_SCENES, few))
    ]
    totals = {scene: MissedDetections() for scene in (*HEADLINE, *SENSITIVITY_SCENES)}
    for task, found in zip(tasks, results(tasks), strict=True):
        for scene, counts in zip(task.arguments[1], found, strict=True):
            totals[scene].add(counts)
    return [{"kind": kind, **_named(scene), **_missed_figures(counts)} for scene, counts in totals.items()]


def _named(scene: Scene) -> dict[str, Any]:
    return {"pose_sigma_m": scene.pose_sigma_m, "map_sigma_m": scene.map_sigma_m}


def _missed_figures(m: MissedDetections) -> dict[str, Any]:
    return {
        "epochs": m.epochs,
        "thresholds": [
            {
                "beyond_m": threshold_m,
                "harmful_episodes": int(m.harmful[t]),
                "skies": int(m.skies[t]),
                "controls": {name: _control(m, c, t) for c, name in enumerate(BASELINES)},
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


def _control(m: MissedDetections, c: int, t: int) -> dict[str, Any]:
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


def _alarms(size: RunSize, rules: Rules, results: Results) -> list[dict[str, Any]]:
    scenes = (*HEADLINE, *SENSITIVITY_SCENES)
    skies = max(1, round(size.trials / 50 / _SKIES_OF_ALARMS))
    repeats = max(1, round(_DRAWS_OF_TRIAL * size.trials / (skies * _SKIES_OF_ALARMS)))
    tasks = [
        Task(alarms_block, (scenes, size.seed, block, _SKIES_OF_ALARMS, repeats, rules))
        for block in range(skies)
    ]
    totals = [{name: WeightedRate() for name in ("false_alarm", "held_back", "all")} for _ in scenes]
    for found in results(tasks):
        for total, rates in zip(totals, found, strict=True):
            for name, rate in rates.items():
                total[name].add(rate)
    return [
        _named(scene) | {name: _weighted(rate) for name, rate in total.items()}
        for scene, total in zip(scenes, totals, strict=True)
    ]


def _weighted(rate: WeightedRate) -> dict[str, Any]:
    return {
        "rate": rate.rate,
        "upper_95": rate.upper,
        "effective_events": rate.effective,
        "draws": rate.draws,
    }


def _faults(size: RunSize, rules: Rules, results: Results) -> dict[str, Any]:
    blocks = max(1, min(20, size.trials // 10_000))
    repeats = max(1, size.trials // (blocks * 400 * 20))
    tasks = [Task(faults_block, (size.seed, block, 400, repeats, rules)) for block in range(blocks)]
    totals: dict[str, FaultCounts] = {}
    for found in results(tasks):
        for name, counts in found.items():
            totals.setdefault(name, FaultCounts()).add(counts)
    rows = []
    for name, counts in totals.items():
        upper = clopper_pearson(counts.missed, counts.episodes)[1]
        rows.append({"fault": name, **asdict(counts), "missed_upper_95": upper})
    return {**_named(SCENE), "rows": rows}


def _levels(size: RunSize, rules: Rules, results: Results) -> tuple[dict[str, Any], dict[str, Any]]:
    """Twelve blocks of 10,000 draws of each mode, fewer of a small run."""
    blocks, draws = max(1, min(12, size.trials // 8_000)), min(max(size.trials, 1_000), DRAWS)
    levels = results([Task(coverage_block, (size.seed, block, rules, draws)) for block in range(blocks)])
    hazard = results([Task(misleading_block, (size.seed, block, rules)) for block in range(blocks)])
    return coverage_figures(list(levels)), misleading_figures(list(hazard))

"""Faults of what a fix is judged by, one at a time and together: their effect on right fixes and on wrong ones.

A fault lasts for the whole episode, and nothing claims it. Of right integers single epochs are judged; with a base
coordinate error they are harmful too. Of wrong integers (`search`) episodes of ten seconds are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import JUDGE, BaselineDecisions
from camber.validation.lab.error_episodes import NO_FAULT, Episodes, FaultOffsets, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, HEADLINE
from camber.validation.lab.false_alarms import right_fixes
from camber.validation.lab.missed_detection import THRESHOLDS_M, wrong_fixes
from camber.validation.lab.work_blocks import AddingUp, WorkBlock

Generator = np.random.Generator
Fault = Callable[[FixShapes, Generator], FaultOffsets]

SCENE = HEADLINE[0]
_LENGTH = round(10.0 * ASSUMPTIONS.epochs_per_s)


def _signs(n: int, rng: Generator) -> Floats:
    return np.where(rng.random(n) < 0.5, -1.0, 1.0)


def _road(size_m: float) -> Fault:
    return lambda shapes, rng: FaultOffsets(height_m=size_m * _signs(len(shapes.sky), rng))


def _antenna(size_m: float) -> Fault:
    return lambda shapes, rng: FaultOffsets(height_m=size_m)


def _slides(shapes: FixShapes, rng: Generator) -> FaultOffsets:
    n = len(shapes.sky)
    return FaultOffsets(pose_m=shapes.along * (_signs(n, rng) * rng.uniform(0.5, 3.0, n))[:, None])


def _symmetric(shapes: FixShapes, rng: Generator) -> FaultOffsets:
    n = len(shapes.sky)
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return FaultOffsets(
        pose_m=rng.uniform(2.0, 6.0, n)[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    )


def _base(size_m: float) -> Fault:
    def offsets(shapes: FixShapes, rng: Generator) -> FaultOffsets:
        vector = rng.normal(size=(len(shapes.sky), 3))
        return FaultOffsets(fix_m=vector * (size_m / np.linalg.norm(vector, axis=1, keepdims=True)))

    return offsets


def _both(one: Fault, other: Fault) -> Fault:
    return lambda shapes, rng: one(shapes, rng) + other(shapes, rng)


FAULTS: dict[str, Fault] = {
    "none": lambda shapes, rng: NO_FAULT,
    "map, step of 0.15 m": _road(0.15),
    "map, step of 0.5 m": _road(0.5),
    "level, 5 m": _road(5.0),
    "tyre, 0.05 m lower": _antenna(0.05),
    "LiDAR slides along, 0.5 to 3 m": _slides,
    "LiDAR symmetric, 2 to 6 m off": _symmetric,
    "base, vector of 0.3 m": _base(0.3),
    "base, vector of 1 m": _base(1.0),
    "base, vector of 17.7 m": _base(17.7),
    "map 0.5 m and LiDAR slides": _both(_road(0.5), _slides),
    "tyre and LiDAR slides": _both(_antenna(0.05), _slides),
    "base 1 m and LiDAR slides": _both(_base(1.0), _slides),
    "level 5 m and base 17.7 m": _both(_road(5.0), _base(17.7)),
}


@dataclass(slots=True, kw_only=True)
class FaultCounts(AddingUp):
    """Of right integers: `right` epochs, of them confirmed, contradicted, harmful, and harmful and confirmed.

    Of wrong ones: harmful episodes, and of these missed.
    """

    right: int = 0
    confirmed: int = 0
    contradicted: int = 0
    harmful: int = 0
    harmful_confirmed: int = 0
    episodes: int = 0
    missed: int = 0


def faults_block(block: WorkBlock) -> dict[str, FaultCounts]:
    """Counts for each fault."""
    right, wrong = right_fixes(block, "faults"), wrong_fixes(block, "search")
    judge, by_fault = BaselineDecisions(block.rules, SCENE), {}
    for name, fault in FAULTS.items():
        rng, counts = block.stream(f"faults/{name}"), FaultCounts()
        for _ in range(block.repeats):
            run = episodes(right, SCENE, rng, faults=fault(right, rng), length=1)
            _count_right(counts, run, right, judge)
            if len(wrong.sky):
                run = episodes(wrong, SCENE, rng, faults=fault(wrong, rng), length=_LENGTH)
                _count_wrong(counts, run, wrong, judge)
        by_fault[name] = counts
    return by_fault


def _count_right(counts: FaultCounts, run: Episodes, shapes: FixShapes, judge: BaselineDecisions) -> None:
    s = judge.covariance(shapes.claimed_m2, run.slope)
    confirmed, harmful = judge.agreed(run.difference_m, s), _harmful(run)
    counts.right += len(confirmed)
    counts.confirmed += int(confirmed.sum())
    counts.contradicted += int(judge.contradicted(run.difference_m, s).sum())
    counts.harmful += int(harmful.sum())
    counts.harmful_confirmed += int((harmful & confirmed).sum())


def _count_wrong(counts: FaultCounts, run: Episodes, shapes: FixShapes, judge: BaselineDecisions) -> None:
    s = judge.covariance(shapes.claimed_m2, run.slope)
    confirmed = judge.confirmed(run.difference_m, s, run.episode, shapes.residuals_agree)[JUDGE]
    harmful = _harmful(run)
    counts.episodes += int(np.logical_or.reduceat(harmful, run.first).sum())
    counts.missed += int(np.logical_or.reduceat(harmful & confirmed, run.first).sum())


def _harmful(run: Episodes) -> NDArray[np.bool_]:
    return np.asarray(np.hypot(run.error_m[:, 0], run.error_m[:, 1]) > THRESHOLDS_M[0])

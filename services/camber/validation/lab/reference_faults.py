"""Faults of what a fix is judged by, one at a time and together: what becomes of right fixes and of wrong ones.

A fault is there for the whole episode, and nothing claims it. Of right integers single epochs are judged; with a base
station that is wrong they are harmful too. Of wrong integers (`search`) episodes of ten seconds are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.integrity.rules import Rules
from camber.simulator.random_streams import stream
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import JUDGE, BaselineDecisions
from camber.validation.lab.error_episodes import Episodes, FaultOffsets, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, Scene, innovation_covariance
from camber.validation.lab.false_alarms import right_fixes
from camber.validation.lab.missed_detection import THRESHOLDS_M, wrong_fixes

Floats = NDArray[np.float64]
Generator = np.random.Generator
Fault = Callable[[FixShapes, Generator], FaultOffsets]

SCENE = Scene(0.05, 0.05)
_LENGTH = round(10.0 * ASSUMPTIONS.epochs_per_s)


def _signs(n: int, rng: Generator) -> Floats:
    return np.where(rng.random(n) < 0.5, -1.0, 1.0)


def _pose(pose_m: Floats) -> FaultOffsets:
    n = len(pose_m)
    return FaultOffsets(pose_m, np.zeros(n), np.zeros(n), np.zeros((n, 3)))


def _road(size_m: float) -> Fault:
    def of(shapes: FixShapes, rng: Generator) -> FaultOffsets:
        n = len(shapes.sky)
        return FaultOffsets(np.zeros((n, 2)), size_m * _signs(n, rng), np.zeros(n), np.zeros((n, 3)))

    return of


def _antenna(size_m: float) -> Fault:
    def of(shapes: FixShapes, rng: Generator) -> FaultOffsets:
        n = len(shapes.sky)
        return FaultOffsets(np.zeros((n, 2)), np.zeros(n), np.full(n, size_m), np.zeros((n, 3)))

    return of


def _slides(shapes: FixShapes, rng: Generator) -> FaultOffsets:
    n = len(shapes.sky)
    return _pose(shapes.along * (_signs(n, rng) * rng.uniform(0.5, 3.0, n))[:, None])


def _symmetric(shapes: FixShapes, rng: Generator) -> FaultOffsets:
    n = len(shapes.sky)
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return _pose(rng.uniform(2.0, 6.0, n)[:, None] * np.column_stack((np.cos(angle), np.sin(angle))))


def _base(size_m: float) -> Fault:
    def of(shapes: FixShapes, rng: Generator) -> FaultOffsets:
        n = len(shapes.sky)
        vector = rng.normal(size=(n, 3))
        vector *= size_m / np.linalg.norm(vector, axis=1, keepdims=True)
        return FaultOffsets(np.zeros((n, 2)), np.zeros(n), np.zeros(n), vector)

    return of


def _both(one: Fault, other: Fault) -> Fault:
    def of(shapes: FixShapes, rng: Generator) -> FaultOffsets:
        a, b = one(shapes, rng), other(shapes, rng)
        return FaultOffsets(
            a.pose_m + b.pose_m, a.road_m + b.road_m, a.antenna_m + b.antenna_m, a.fix_m + b.fix_m
        )

    return of


FAULTS: dict[str, Fault] = {
    "none": lambda shapes, rng: FaultOffsets.none(len(shapes.sky)),
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


@dataclass(slots=True)
class FaultCounts:
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

    def add(self, other: FaultCounts) -> None:
        """Take another block's counts in."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


def faults_block(seed: int, block: int, skies: int, repeats: int, rules: Rules) -> dict[str, FaultCounts]:
    """Counts for each fault."""
    right, wrong = right_fixes(seed, block, skies, "faults"), wrong_fixes("search", seed, block, skies)
    controls = BaselineDecisions(rules.determination, SCENE.pose_sigma_m)
    found = {}
    for name, fault in FAULTS.items():
        rng = stream(seed, f"lab/faults/{name}/{block}")
        counts = FaultCounts()
        for _ in range(repeats):
            _right(counts, right, fault, controls, rules, rng)
            if len(wrong.sky):
                _wrong(counts, wrong, fault, controls, rules, rng)
        found[name] = counts
    return found


def _right(
    counts: FaultCounts,
    shapes: FixShapes,
    fault: Fault,
    controls: BaselineDecisions,
    rules: Rules,
    rng: Generator,
) -> None:
    run = episodes(shapes, SCENE, rng, fault(shapes, rng), np.ones(len(shapes.sky), np.int64))
    s = innovation_covariance(shapes.claimed_m2, run.slope, SCENE, rules)
    confirmed, harmful = controls.agreed(run.difference_m, s), _harmful(run)
    counts.right += len(confirmed)
    counts.confirmed += int(confirmed.sum())
    counts.contradicted += int(controls.contradicted(run.difference_m, s).sum())
    counts.harmful += int(harmful.sum())
    counts.harmful_confirmed += int((harmful & confirmed).sum())


def _wrong(
    counts: FaultCounts,
    shapes: FixShapes,
    fault: Fault,
    controls: BaselineDecisions,
    rules: Rules,
    rng: Generator,
) -> None:
    run = episodes(shapes, SCENE, rng, fault(shapes, rng), np.full(len(shapes.sky), _LENGTH))
    s = innovation_covariance(shapes.claimed_m2, run.slope, SCENE, rules)
    confirmed = controls.confirmed(run.difference_m, s, run.episode, shapes.residuals_agree)[JUDGE]
    harmful = _harmful(run)
    counts.episodes += int(np.logical_or.reduceat(harmful, run.first).sum())
    counts.missed += int(np.logical_or.reduceat(harmful & confirmed, run.first).sum())


def _harmful(run: Episodes) -> NDArray[np.bool_]:
    far: NDArray[np.bool_] = np.hypot(run.error_m[:, 0], run.error_m[:, 1]) > THRESHOLDS_M[0]
    return far

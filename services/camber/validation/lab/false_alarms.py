"""Right fixes: how often the judge calls one contradictory, and how often it holds one back.

The difference of a right fix is normal, given its sky and the slope of its road. Rates of 1e-6 are found by importance
sampling: half of the draws come from the distribution itself, half from one three times as wide, and each counts by the
ratio of the densities, at most 2 (defensive mixture: T. Hesterberg, Technometrics 37 (1995)). Epochs are drawn one by
one: the rate is that of an epoch, not of an episode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats
from camber.simulator.satellites.random_skies import random_skies
from camber.simulator.satellites.wrong_fix_shapes import FixShapes, fix_shapes
from camber.validation.lab.baselines import BaselineDecisions
from camber.validation.lab.error_model import ASSUMPTIONS, Scene
from camber.validation.lab.work_blocks import AddingUp, WorkBlock

WIDENED = 3.0
"""Chosen: a sample then lies beyond 5 σ often enough that rates of 1e-6 rest on hundreds of effective events."""


@dataclass(slots=True, kw_only=True)
class WeightedRate(AddingUp):
    """Σ w 1, Σ w² 1 over draws in which something happens, and how many draws there were."""

    total: float = 0.0
    squares: float = 0.0
    draws: int = 0

    @property
    def rate(self) -> float:
        """The estimate."""
        return self.total / self.draws

    @property
    def upper(self) -> float:
        """Upper 95 % bound, normal; without a single event that of 3/n draws of weight 2."""
        if self.total == 0.0:
            return 6.0 / self.draws
        variance = max(self.squares / self.draws - self.rate**2, 0.0)
        return self.rate + 1.645 * math.sqrt(variance / self.draws)

    @property
    def effective(self) -> float:
        """Effective number of events: (Σ w)² / Σ w² of those in which it happens."""
        return self.total**2 / self.squares if self.squares > 0.0 else 0.0


def weighted_draws(covariance_m2: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draws (n, d) for covariances (n, d, d), and their weights (n,): half as they are, half widened."""
    n, d = covariance_m2.shape[:2]
    white = rng.normal(size=(n, d)) * np.where(rng.random(n) < 0.5, 1.0, WIDENED)[:, None]
    square = np.sum(white**2, axis=1)
    wide = np.exp(0.5 * square * (1.0 - WIDENED**-2)) / WIDENED**d
    value = (np.linalg.cholesky(covariance_m2) @ white[:, :, None])[:, :, 0]
    return value, 2.0 / (1.0 + wide)


def weighted_rate(weights: Floats, happens: NDArray[np.bool_] | None = None) -> WeightedRate:
    """Of weighted draws (n,); without `happens` the weights are probabilities."""
    w = weights if happens is None else weights[happens]
    return WeightedRate(total=float(w.sum()), squares=float((w**2).sum()), draws=len(weights))


def sum_of(rates: Iterable[WeightedRate]) -> WeightedRate:
    """The draws of all blocks together."""
    total = WeightedRate()
    for rate in rates:
        total.add(rate)
    return total


def right_fixes(block: WorkBlock, name: str) -> FixShapes:
    """One of each of a block's skies, where it is a fix at all."""
    rng = block.stream(f"right/{name}")
    return fix_shapes(random_skies(block.skies, rng), "right", 1, rng)


def right_covariance(shapes: FixShapes, slope: Floats, scene: Scene) -> Floats:
    """True covariance (n, 3, 3) of right fixes' differences."""
    n = len(shapes.sky)
    fix = shapes.reflected_m2 + ASSUMPTIONS.constant_variance_m2 * np.eye(3)
    j = np.tile(np.eye(3), (n, 1, 1))
    j[:, 2, :2] = -slope
    t: Floats = j @ fix @ j.transpose(0, 2, 1)
    t[:, [0, 1], [0, 1]] += scene.pose_sigma_m**2
    t[:, 2, 2] += scene.map_sigma_m**2 + ASSUMPTIONS.antenna_sigma_m**2
    return t


def alarms_block(block: WorkBlock, scenes: tuple[Scene, ...]) -> list[dict[str, WeightedRate]]:
    """For each scene the rates `false_alarm`, `held_back` (neither confirmed nor contradictory) and, of all
    draws, `all`, which is 1 but for chance."""
    shapes = right_fixes(block, "alarms")
    by_scene, n = [], len(shapes.sky)
    for scene in scenes:
        judge, rng = BaselineDecisions(block.rules, scene), block.stream(f"alarms/{scene.name}")
        rates = {name: WeightedRate() for name in ("false_alarm", "held_back", "all")}
        for _ in range(block.repeats):
            slope = ASSUMPTIONS.slope_sigma * rng.normal(size=(n, 2))
            d, weights = weighted_draws(right_covariance(shapes, slope, scene), rng)
            s = judge.covariance(shapes.claimed_m2, slope)
            contradicted = judge.contradicted(d, s)
            rates["false_alarm"].add(weighted_rate(weights, contradicted))
            rates["held_back"].add(weighted_rate(weights, ~contradicted & ~judge.agreed(d, s)))
            rates["all"].add(weighted_rate(weights))
        by_scene.append(rates)
    return by_scene

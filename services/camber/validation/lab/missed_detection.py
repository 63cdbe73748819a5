"""Episodes of wrong fixes: what each control lets through, how long until it says so, over the error's size.

An epoch is harmful where the fix's horizontal error exceeds a threshold. An episode is *missed* where a harmful
position is confirmed at any of its epochs, and *late* where harmful positions are confirmed for a second on end, or
at all harmful epochs of it. The time to alert is the longest such stretch: an epoch that is not confirmed is an alert.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.integrity.rules import Rules
from camber.simulator.random_streams import stream
from camber.simulator.satellites.random_skies import random_skies
from camber.simulator.satellites.wrong_fix_shapes import FixShapes, Kind, fix_shapes
from camber.validation.lab.baselines import ALL, BASELINES, BaselineDecisions
from camber.validation.lab.error_episodes import Episodes, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, Scene, innovation_covariance

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

THRESHOLDS_M = (0.5, 1.0)
EDGES_M = np.array([0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0, np.inf])
_LONGEST = int(ASSUMPTIONS.longest_s * ASSUMPTIONS.epochs_per_s) + 1
_AT_ONCE = 1000
_TRIES = 20
LATE_EPOCHS = round(ASSUMPTIONS.epochs_per_s)


@dataclass(slots=True)
class MissedDetections:
    """Counts that add up. By threshold: `harmful` episodes (t,), by control and threshold `missed`, `late` (c, t), and
    Σ over skies of their squares `missed_squared`, `harmful_skies` (t,). By control and size: `in_bin` (b,),
    `confirmed_in_bin` (c, b). Stretches of `ALL` in epochs: `stretch` (t, k), of episodes that it did alert.
    """

    harmful: Integers = field(default_factory=lambda: np.zeros(len(THRESHOLDS_M), np.int64))
    skies: Integers = field(default_factory=lambda: np.zeros(len(THRESHOLDS_M), np.int64))
    missed: Integers = field(default_factory=lambda: np.zeros((len(BASELINES), len(THRESHOLDS_M)), np.int64))
    late: Integers = field(default_factory=lambda: np.zeros((len(BASELINES), len(THRESHOLDS_M)), np.int64))
    missed_squared: Integers = field(
        default_factory=lambda: np.zeros((len(BASELINES), len(THRESHOLDS_M)), np.int64)
    )
    in_bin: Integers = field(default_factory=lambda: np.zeros(len(EDGES_M) - 1, np.int64))
    confirmed_in_bin: Integers = field(
        default_factory=lambda: np.zeros((len(BASELINES), len(EDGES_M) - 1), np.int64)
    )
    stretch: Integers = field(default_factory=lambda: np.zeros((len(THRESHOLDS_M), _LONGEST), np.int64))
    epochs: int = 0

    def add(self, other: MissedDetections) -> None:
        """Take another block's counts in."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


def missed_block(
    kind: Kind, scenes: tuple[Scene, ...], seed: int, block: int, skies: int, repeats: int, rules: Rules
) -> list[MissedDetections]:
    """Counts for each scene of the wrong fixes of one block's skies, so many episodes of each."""
    shapes = wrong_fixes(kind, seed, block, skies)
    found = []
    for scene in scenes:
        rng = stream(seed, f"lab/missed/{kind}/{scene.name}/{block}")
        found.append(_counted(shapes, scene, repeats, rules, rng))
    return found


def wrong_fixes(kind: Kind, seed: int, block: int, skies: int) -> FixShapes:
    """Of one block's skies, those that are at least as far off as the first bin."""
    rng = stream(seed, f"lab/skies/{kind}/{block}")
    shapes = fix_shapes(random_skies(skies, rng), kind, _TRIES, rng)
    return shapes.chosen(np.hypot(shapes.shift_m[:, 0], shapes.shift_m[:, 1]) >= EDGES_M[0])


def _counted(
    shapes: FixShapes, scene: Scene, repeats: int, rules: Rules, rng: np.random.Generator
) -> MissedDetections:
    total, controls = MissedDetections(), BaselineDecisions(rules.determination, scene.pose_sigma_m)
    n = len(shapes.sky)
    _, sky = np.unique(shapes.sky, return_inverse=True)
    of_sky = np.zeros((int(sky.max(initial=-1)) + 1, len(BASELINES), len(THRESHOLDS_M)), np.int64)
    harmful_sky = np.zeros((len(of_sky), len(THRESHOLDS_M)), np.bool_)
    for _ in range(repeats):
        for begin in range(0, n, _AT_ONCE):
            part = np.arange(begin, min(begin + _AT_ONCE, n))
            chosen = shapes.chosen(part)
            run = episodes(chosen, scene, rng)
            s = innovation_covariance(chosen.claimed_m2, run.slope, scene, rules)
            confirmed = controls.confirmed(run.difference_m, s, run.episode, chosen.residuals_agree)
            _count(total, run, chosen, confirmed, of_sky, harmful_sky, sky[part])
    total.missed_squared += (of_sky**2).sum(axis=0)
    total.skies += harmful_sky.sum(axis=0)
    return total


def _count(
    total: MissedDetections, run: Episodes, shapes: FixShapes, confirmed: dict[str, Booleans],
    of_sky: Integers, harmful_sky: Booleans, sky: Integers,
) -> None:  # fmt: skip
    horizontal = np.hypot(run.error_m[:, 0], run.error_m[:, 1])
    total.epochs += len(horizontal)
    size = np.hypot(shapes.shift_m[:, 0], shapes.shift_m[:, 1])
    into = np.searchsorted(EDGES_M, size, "right") - 1
    total.in_bin += np.bincount(into, minlength=len(EDGES_M) - 1)
    for c, name in enumerate(BASELINES):
        anywhere = np.logical_or.reduceat(confirmed[name], run.first)
        total.confirmed_in_bin[c] += np.bincount(into[anywhere], minlength=len(EDGES_M) - 1)
    for t, threshold_m in enumerate(THRESHOLDS_M):
        harmful = horizontal > threshold_m
        ever = np.logical_or.reduceat(harmful, run.first)
        total.harmful[t] += int(ever.sum())
        harmful_sky[sky[ever], t] = True
        for c, name in enumerate(BASELINES):
            longest, alerted = longest_confirmed_runs(harmful, confirmed[name], run.first, run.length)
            missed = ever & (longest > 0)
            total.missed[c, t] += int(missed.sum())
            total.late[c, t] += int((ever & ((longest >= LATE_EPOCHS) | ~alerted)).sum())
            np.add.at(of_sky[:, c, t], sky[missed], 1)
            if name == ALL:
                total.stretch[t] += np.bincount(longest[ever & alerted], minlength=_LONGEST)


@compiled
def longest_confirmed_runs(
    harmful: Booleans, confirmed: Booleans, first: Integers, length: Integers
) -> tuple[Integers, Booleans]:
    """Of each episode (n,): the most epochs on end that are harmful and confirmed, and whether any harmful one is
    not confirmed."""
    longest, alerted = np.zeros(first.size, np.int64), np.zeros(first.size, np.bool_)
    for k in range(first.size):
        now = 0
        for row in range(first[k], first[k] + length[k]):
            if harmful[row] and confirmed[row]:
                now += 1
                longest[k] = max(longest[k], now)
            else:
                now = 0
                alerted[k] = alerted[k] or harmful[row]
    return longest, alerted

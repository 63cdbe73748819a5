"""Episodes of wrong fixes: what each baseline confirms, and how long until it alerts, over the error's size.

An epoch is harmful where the fix's horizontal error exceeds a threshold. An episode is *missed* where a harmful
position is confirmed at any of its epochs, and *late* where harmful positions are confirmed for a second on end, or
at all harmful epochs of it. The time to alert is the longest such stretch: an epoch that is not confirmed is an alert.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers
from camber.simulator.satellites.random_skies import random_skies
from camber.simulator.satellites.wrong_fix_shapes import FixShapes, Kind, fix_shapes
from camber.validation.lab.baselines import ALL, BASELINES, BaselineDecisions, Booleans
from camber.validation.lab.error_episodes import Episodes, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, Scene
from camber.validation.lab.work_blocks import AddingUp, WorkBlock

THRESHOLDS_M = (0.5, 1.0)
EDGES_M = np.array([0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0, np.inf])
_LONGEST = int(ASSUMPTIONS.longest_s * ASSUMPTIONS.epochs_per_s) + 1
_AT_ONCE = 1000
"""Episodes at once. Chosen: up to 1200 epochs of each fit into tens of megabytes."""
_TRIES = 20
"""On each sky. Chosen: a search on it succeeds in about one try of ninety (`run.py`)."""
LATE_EPOCHS = round(ASSUMPTIONS.epochs_per_s)


class MissedDetections(AddingUp):
    """Counts that add up. By threshold: `harmful` episodes (t,), by baseline and threshold `missed`, `late` (c, t), and
    Σ over skies of their squares `missed_squared`, `harmful_skies` (t,). By baseline and size: `in_bin` (b,),
    `confirmed_in_bin` (c, b). Stretches of `ALL` in epochs: `stretch` (t, k), of episodes that it did alert.
    """

    __slots__ = (
        "confirmed_in_bin", "epochs", "harmful", "in_bin", "late", "missed", "missed_squared", "skies", "stretch"
    )  # fmt: skip

    def __init__(self) -> None:
        c, t, b = len(BASELINES), len(THRESHOLDS_M), len(EDGES_M) - 1
        self.harmful, self.skies = np.zeros((2, t), np.int64)
        self.missed, self.late, self.missed_squared = np.zeros((3, c, t), np.int64)
        self.in_bin, self.confirmed_in_bin = np.zeros(b, np.int64), np.zeros((c, b), np.int64)
        self.stretch = np.zeros((t, _LONGEST), np.int64)
        self.epochs = 0


def missed_block(block: WorkBlock, kind: Kind, scenes: tuple[Scene, ...]) -> list[MissedDetections]:
    """Counts for each scene of the wrong fixes of one block's skies, so many episodes of each."""
    shapes = wrong_fixes(block, kind)
    return [_counted(shapes, scene, block, block.stream(f"missed/{kind}/{scene.name}")) for scene in scenes]


def wrong_fixes(block: WorkBlock, kind: Kind) -> FixShapes:
    """Of one block's skies, those that are at least as far off as the first bin."""
    rng = block.stream(f"skies/{kind}")
    shapes = fix_shapes(random_skies(block.skies, rng), kind, _TRIES, rng)
    return shapes.chosen(np.hypot(shapes.shift_m[:, 0], shapes.shift_m[:, 1]) >= EDGES_M[0])


def _counted(shapes: FixShapes, scene: Scene, block: WorkBlock, rng: np.random.Generator) -> MissedDetections:
    total, judge = MissedDetections(), BaselineDecisions(block.rules, scene)
    n = len(shapes.sky)
    _, sky = np.unique(shapes.sky, return_inverse=True)
    skies = int(sky.max(initial=-1)) + 1
    of_sky = np.zeros((skies, len(BASELINES), len(THRESHOLDS_M)), np.int64)
    harmful_sky = np.zeros((skies, len(THRESHOLDS_M)), np.bool_)
    for _ in range(block.repeats):
        for begin in range(0, n, _AT_ONCE):
            part = np.arange(begin, min(begin + _AT_ONCE, n))
            chosen = shapes.chosen(part)
            run = episodes(chosen, scene, rng)
            s = judge.covariance(chosen.claimed_m2, run.slope)
            confirmed = judge.confirmed(run.difference_m, s, run.episode, chosen.residuals_agree)
            harmful, missed = _count(total, run, chosen, confirmed)
            np.add.at(of_sky, sky[part], missed)
            np.logical_or.at(harmful_sky, sky[part], harmful)
    total.missed_squared += (of_sky**2).sum(axis=0)
    total.skies += harmful_sky.sum(axis=0)
    return total


def _count(
    total: MissedDetections, run: Episodes, shapes: FixShapes, confirmed: dict[str, Booleans]
) -> tuple[Booleans, Booleans]:
    """Add n episodes; which are harmful (n, t), and which of them each baseline misses (n, c, t)."""
    horizontal = np.hypot(run.error_m[:, 0], run.error_m[:, 1])
    total.epochs += len(horizontal)
    size = np.hypot(shapes.shift_m[:, 0], shapes.shift_m[:, 1])
    into = np.searchsorted(EDGES_M, size, "right") - 1
    total.in_bin += np.bincount(into, minlength=len(EDGES_M) - 1)
    ever = np.zeros((len(size), len(THRESHOLDS_M)), np.bool_)
    missed = np.zeros((len(size), len(BASELINES), len(THRESHOLDS_M)), np.bool_)
    for c, name in enumerate(BASELINES):
        anywhere = np.logical_or.reduceat(confirmed[name], run.first)
        total.confirmed_in_bin[c] += np.bincount(into[anywhere], minlength=len(EDGES_M) - 1)
        for t, threshold_m in enumerate(THRESHOLDS_M):
            harmful = horizontal > threshold_m
            ever[:, t] = np.logical_or.reduceat(harmful, run.first)
            longest, alerted = longest_confirmed_runs(harmful, confirmed[name], run.first, run.length)
            missed[:, c, t] = ever[:, t] & (longest > 0)
            late = ever[:, t] & ((longest >= LATE_EPOCHS) | ~alerted)
            total.late[c, t] += int(late.sum())
            if name == ALL:
                total.stretch[t] += np.bincount(longest[ever[:, t] & alerted], minlength=_LONGEST)
    total.harmful += ever.sum(axis=0)
    total.missed += missed.sum(axis=0)
    return ever, missed


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

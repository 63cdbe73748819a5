"""Hazardously misleading information: a usable position whose error is beyond its level and beyond the alert limit.

Per epoch, in four parts whose shares of all epochs are assumed, by the rules' own priors, that of wrong fixes as the
skies have satellites:

- a pose that is right, with right or wrong integers: the pose's own error would have to reach from the truth to
  within the judge's limit of the fix; bounded by Rayleigh's tail of that;
- right integers and a pose at fault, unseen: their error's tail, bounded by Rayleigh's, whatever the judge says of it;
- wrong integers and a pose at fault, unseen, that happens to lie where the wrong fix does: half of such poses slide
  along the street by up to 5 m, half lie anywhere within 6 m. By importance sampling (A. Owen, Monte Carlo theory,
  methods and examples (2013), 9): the fault is drawn near the fix.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats
from camber.integrity.rules import Rules
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import BaselineDecisions
from camber.validation.lab.bound_coverage import (
    LEVEL_PARAMETERS,
    SCENE,
    bounds,
    confirmed_claims,
    prior_shares,
)
from camber.validation.lab.error_episodes import FaultOffsets, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, inflated_covariance, largest_variance
from camber.validation.lab.false_alarms import WeightedRate, right_fixes, sum_of, weighted_rate
from camber.validation.lab.missed_detection import wrong_fixes
from camber.validation.lab.work_blocks import WorkBlock

ALERT_LIMIT_M = 1.5
"""The default of the service (`integrity.alert_limit_m`)."""
SLIDES_M, WITHIN_M = 5.0, 6.0
_NEAR_M = 0.15
"""Chosen: about the acceptance radius of the position check, within which a fault coincides with the fix."""


def misleading_block(block: WorkBlock) -> dict[str, Any]:
    """Sums of one block: tails of right integers, of wrong ones with a right pose, and weighted coincidences."""
    right = right_fixes(block, "hazard")
    wrong = wrong_fixes(replace(block, number=block.number + 2_000_000), "search")
    rng, rules = block.stream("hazard"), block.rules
    repeats = block.repeats if len(wrong.sky) else 0
    return {
        "prior": weighted_rate(prior_shares(right)),
        "right": weighted_rate(_with_right_pose(right, rules)),
        "right_alone": weighted_rate(_right_tail(right, rules)),
        "wrong": weighted_rate(_with_right_pose(wrong, rules)),
        "coincidence": sum_of(_coincidence(wrong, rules, rng) for _ in range(repeats)),
    }


def misleading_figures(blocks: list[dict[str, Any]]) -> dict[str, Any]:
    """The rate per epoch, its upper bound, and the parts."""
    fault = LEVEL_PARAMETERS.pose_fault_prior
    prior = sum_of(block["prior"] for block in blocks).rate
    parts: list[dict[str, Any]] = []
    for name, share, key in (
        ("right integers, pose right", 1.0 - prior, "right"),
        ("right integers, pose at fault and unseen", (1.0 - prior) * fault, "right_alone"),
        ("wrong integers, pose right", prior, "wrong"),
        ("wrong integers, pose at fault and unseen", prior * fault, "coincidence"),
    ):
        total = sum_of(block[key] for block in blocks)
        figures = {"rate": total.rate, "upper_95": total.upper, "effective": total.effective}
        parts.append({"part": name, "share": share, **figures, "draws": total.draws})
    return {
        "alert_limit_m": ALERT_LIMIT_M,
        **asdict(SCENE),
        "wrong_fix_prior": prior,
        "pose_fault_prior": fault,
        "rate": sum(part["share"] * part["rate"] for part in parts),
        "upper_95": sum(part["share"] * part["upper_95"] for part in parts),
        "parts": parts,
    }


def _rayleigh(length_m: Floats | float, variance_m2: Floats | float) -> Floats:
    """P of a horizontal error longer than this, at most, of the larger variance (n,)."""
    return np.asarray(np.exp(-0.5 * np.maximum(length_m, 0.0) ** 2 / np.maximum(variance_m2, 1e-12)))


def _usable_at_most(shapes: FixShapes, rules: Rules) -> NDArray[np.bool_]:
    """May a level be below the alert limit at all? It is at least that of the larger axis of a right fix, on a line."""
    sigma = np.sqrt(largest_variance(inflated_covariance(shapes.claimed_m2, rules)))
    # Two sides of a line at 1e-7: 5.3 σ; the margin makes it more.
    return np.asarray(5.3 * sigma < ALERT_LIMIT_M)


def _right_tail(shapes: FixShapes, rules: Rules) -> Floats:
    variance = largest_variance(shapes.reflected_m2) + ASSUMPTIONS.constant_variance_m2
    return np.where(_usable_at_most(shapes, rules), _rayleigh(ALERT_LIMIT_M, variance), 0.0)


def _with_right_pose(shapes: FixShapes, rules: Rules) -> Floats:
    s = BaselineDecisions(rules, SCENE).covariance(shapes.claimed_m2, np.zeros((len(shapes.sky), 2)))
    acceptance_radius_m = np.sqrt(rules.determination.limits().position[0] * largest_variance(s))
    tail = _rayleigh(ALERT_LIMIT_M - acceptance_radius_m, SCENE.pose_sigma_m**2)
    return np.where(_usable_at_most(shapes, rules), tail, 0.0)


def _coincidence(shapes: FixShapes, rules: Rules, rng: np.random.Generator) -> WeightedRate:
    """One fault of the pose for each wrong fix, drawn near it, weighted by how likely it is there."""
    n = len(shapes.sky)
    slides = rng.random(n) < 0.5
    near = _NEAR_M * rng.normal(size=(n, 2))
    shift, along = shapes.shift_m[:, :2], shapes.along
    at = np.sum(shift * along, axis=1) + near[:, 0]
    pose = np.where(slides[:, None], at[:, None] * along, shift + near)
    normal = np.exp(-0.5 * (near / _NEAR_M) ** 2) / (_NEAR_M * math.sqrt(2.0 * math.pi))
    line = (np.abs(at) <= SLIDES_M) / (2.0 * SLIDES_M) / normal[:, 0]
    disc = (np.hypot(*pose.T) <= WITHIN_M) / (math.pi * WITHIN_M**2) / (normal[:, 0] * normal[:, 1])
    run = episodes(shapes, SCENE, rng, faults=FaultOffsets(pose_m=pose), length=1)
    agreed, claimed = confirmed_claims(shapes, run, prior_shares(shapes), rules)
    level = np.full(n, np.inf)
    if agreed.any():
        level[agreed] = bounds(claimed).level_m
    error = np.hypot(run.error_m[:, 0], run.error_m[:, 1])
    happens = agreed & (level < ALERT_LIMIT_M) & (error > np.maximum(level, ALERT_LIMIT_M))
    return weighted_rate(np.where(slides, line, disc), happens)

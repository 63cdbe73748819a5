"""Hazardously misleading information: a usable position whose error is beyond its level and beyond the alert limit.

Per epoch, in four parts whose shares of all epochs are assumed, by the rules' own priors, that of wrong fixes as the
skies have satellites:

- a pose that is right, beside right or wrong integers: the pose's own error would have to reach from the truth to
  within the judge's limit of the fix; bounded by Rayleigh's tail of that;
- right integers and a pose at fault, unseen: their error's tail, bounded by Rayleigh's, whatever the judge says of it;
- wrong integers and a pose at fault, unseen, that happens to lie where the wrong fix does: half of such poses slide
  along the street by up to 5 m, half lie anywhere within 6 m. By importance sampling (A. Owen, Monte Carlo theory,
  methods and examples (2013), 9): the fault is drawn near the fix.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.integrity.rules import Rules
from camber.simulator.random_streams import stream
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import BaselineDecisions
from camber.validation.lab.bound_coverage import LEVEL_PARAMETERS, bounds, of_fixes, prior_shares
from camber.validation.lab.error_episodes import FaultOffsets, episodes
from camber.validation.lab.error_model import ASSUMPTIONS, Scene, inflated_covariance, innovation_covariance
from camber.validation.lab.false_alarms import WeightedRate, right_fixes, weighted_rate
from camber.validation.lab.missed_detection import wrong_fixes

Floats = NDArray[np.float64]

ALERT_LIMIT_M = 1.5
SCENE = Scene(0.05, 0.05)
SLIDES_M, WITHIN_M = 5.0, 6.0
_NEAR_M, _SKIES, _REPEATS = 0.15, 400, 40
_TO_LEVEL = math.sqrt(-2.0 * math.log(LEVEL_PARAMETERS.integrity_risk))


def misleading_block(seed: int, block: int, rules: Rules) -> dict[str, Any]:
    """Sums of one block: tails of right integers, of wrong ones beside a right pose, and weighted coincidences."""
    right = right_fixes(seed, block, _SKIES, "hazard")
    wrong = wrong_fixes("search", seed, block + 2_000_000, _SKIES)
    rng = stream(seed, f"lab/hazard/{block}")
    coincidence = WeightedRate()
    for _ in range(_REPEATS if len(wrong.sky) else 0):
        coincidence.add(_coincidence(wrong, rules, rng))
    return {
        "prior": _mean_of(prior_shares(right)),
        "right": _mean_of(_beside_right_pose(right, rules)),
        "right_alone": _mean_of(_right_tail(right, rules)),
        "wrong": _mean_of(_beside_right_pose(wrong, rules)),
        "coincidence": coincidence,
    }


def misleading_figures(blocks: list[dict[str, Any]]) -> dict[str, Any]:
    """The rate per epoch, its upper bound, and the parts."""
    shares, fault = WeightedRate(), LEVEL_PARAMETERS.pose_fault_prior
    for block in blocks:
        shares.add(block["prior"])
    prior = shares.rate
    parts = [
        _part("right integers, pose right", 1.0 - prior, [block["right"] for block in blocks]),
        _part(
            "right integers, pose at fault and unseen",
            (1.0 - prior) * fault,
            [block["right_alone"] for block in blocks],
        ),
        _part("wrong integers, pose right", prior, [block["wrong"] for block in blocks]),
        _part(
            "wrong integers, pose at fault and unseen",
            prior * fault,
            [block["coincidence"] for block in blocks],
        ),
    ]
    return {
        "alert_limit_m": ALERT_LIMIT_M,
        "pose_sigma_m": SCENE.pose_sigma_m,
        "map_sigma_m": SCENE.map_sigma_m,
        "wrong_fix_prior": prior,
        "pose_fault_prior": fault,
        "rate": sum(part["share"] * part["rate"] for part in parts),
        "upper_95": sum(part["share"] * part["upper_95"] for part in parts),
        "parts": parts,
    }


def _part(name: str, share: float, blocks: list[WeightedRate]) -> dict[str, Any]:
    total = WeightedRate()
    for block in blocks:
        total.add(block)
    return {
        "part": name,
        "share": share,
        "rate": total.rate,
        "upper_95": total.upper,
        "effective": total.effective,
        "draws": total.draws,
    }


def _mean_of(probability: Floats) -> WeightedRate:
    """Of the skies that were drawn: a few weak ones make most of it, and others might have been drawn."""
    return WeightedRate(float(probability.sum()), float((probability**2).sum()), len(probability))


def _rayleigh(length_m: Floats, variance_m2: Floats) -> Floats:
    """P of a horizontal error longer than this, at most, of the larger variance (n,)."""
    found: Floats = np.exp(-0.5 * np.maximum(length_m, 0.0) ** 2 / np.maximum(variance_m2, 1e-12))
    return found


def _larger(covariance_m2: Floats) -> Floats:
    ee, en, nn = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    found: Floats = 0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en)
    return found


def _usable_at_most(shapes: FixShapes, rules: Rules) -> NDArray[np.bool_]:
    """May a level be below the alert limit at all? It is at least that of the larger axis of a right fix, on a line."""
    sigma = np.sqrt(_larger(inflated_covariance(shapes.claimed_m2, rules)))
    # Two sides of a line at 1e-7: 5.3 σ; the margin makes it more.
    found: NDArray[np.bool_] = 5.3 * sigma < ALERT_LIMIT_M
    return found


def _right_tail(shapes: FixShapes, rules: Rules) -> Floats:
    variance = _larger(shapes.reflected_m2) + ASSUMPTIONS.constant_variance_m2
    tail = _rayleigh(np.full(len(variance), ALERT_LIMIT_M), variance)
    return np.where(_usable_at_most(shapes, rules), tail, 0.0)


def _beside_right_pose(shapes: FixShapes, rules: Rules) -> Floats:
    slope = np.zeros((len(shapes.sky), 2))
    s = innovation_covariance(shapes.claimed_m2, slope, SCENE, rules)
    reach = np.sqrt(rules.determination.limits().position[0] * _larger(s))
    gap = np.full(len(reach), ALERT_LIMIT_M) - reach
    return np.where(
        _usable_at_most(shapes, rules), _rayleigh(gap, np.full(len(gap), SCENE.pose_sigma_m**2)), 0.0
    )


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
    run = episodes(shapes, SCENE, rng, replace(FaultOffsets.none(n), pose_m=pose), np.ones(n, np.int64))
    s = innovation_covariance(shapes.claimed_m2, run.slope, SCENE, rules)
    agreed = BaselineDecisions(rules.determination, SCENE.pose_sigma_m).agreed(run.difference_m, s)
    level = np.full(n, np.inf)
    if agreed.any():
        fix = inflated_covariance(shapes.claimed_m2[agreed], rules)
        claimed = of_fixes(
            run.error_m[agreed, :2],
            run.difference_m[agreed],
            s[agreed],
            fix,
            SCENE.pose_sigma_m,
            prior_shares(shapes)[agreed],
        )
        level[agreed] = bounds(claimed).level_m
    error = np.hypot(run.error_m[:, 0], run.error_m[:, 1])
    happens = agreed & (level < ALERT_LIMIT_M) & (error > np.maximum(level, ALERT_LIMIT_M))
    return weighted_rate(np.where(slides, line, disc), happens)

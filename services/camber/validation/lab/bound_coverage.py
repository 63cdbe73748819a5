"""Do bounds hold? Positions of each mode with true errors, beside the ellipses and levels that the product would claim.

`rtk`: tentative fixes of which the rules' prior share for their satellites is wrong, judged; those confirmed.
`doppler`: from such a position on the sum of velocities with the errors that their rules assume, for up to 30 s.
`sensors` and `scan_match`: poses that rest on no fix, whose covariances, the localizer's claims, are taken to be true:
what is tested of them is the step from a covariance to a bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.integrity.protection import wrong_fix_probability as wrong_fix
from camber.integrity.protection.doppler_position import DopplerPosition
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent, bounds_of
from camber.integrity.rules import Rules
from camber.schemas.gnss import SatelliteVelocity
from camber.simulator.random_streams import stream
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import BaselineDecisions
from camber.validation.lab.error_episodes import episodes
from camber.validation.lab.error_model import Scene, inflated_covariance, innovation_covariance
from camber.validation.lab.false_alarms import right_fixes
from camber.validation.lab.missed_detection import wrong_fixes
from camber.validation.statistics import clopper_pearson

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

MODES = ("rtk", "doppler", "sensors", "scan_match")
ALERT_LIMITS_M = (0.29, 0.57, 1.0, 1.5, 3.0)
LEVEL_PARAMETERS = LevelRules()
VELOCITY_SIGMA_M_S = 0.03
SCENE = Scene(0.05, 0.05)
CHART_M = np.concatenate(([0.0], np.geomspace(0.01, 30.0, 59), [np.inf]))
_SKIES, DRAWS = 400, 10_000
_LONGEST_S, _STEP_S, _EPOCH_NS = LEVEL_PARAMETERS.doppler.longest_s, 0.1, 1_400_000_000_000_000_000
_IN_CIRCLE = 125


@dataclass(frozen=True, slots=True, eq=False)
class ClaimedPositions:
    """n positions with true horizontal errors (n, 2), and the mixtures (n, k) that their bounds are made from."""

    error_m: Floats
    weight: Floats
    mean_m: Floats
    covariance_m2: Floats
    lost: Floats

    def chosen(self, rows: Integers) -> ClaimedPositions:
        """Some of them."""
        return ClaimedPositions(*(getattr(self, name)[rows] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class ClaimedBounds:
    """Errors in units of the semi-axes of their 99 % and 99.9 % ellipses (n, 2), and horizontal levels (n,)."""

    in_99: Floats
    in_999: Floats
    level_m: Floats


def coverage_block(seed: int, block: int, rules: Rules, draws: int = DRAWS) -> dict[str, dict[str, Any]]:
    """Counts of each mode."""
    found = {}
    for mode in MODES:
        rng = stream(seed, f"lab/levels/{mode}/{block}")
        found[mode] = _counts(_MODES[mode](seed, block, rules, draws, rng))
    return found


def coverage_figures(blocks: list[dict[str, dict[str, Any]]]) -> dict[str, Any]:
    """Of all blocks: coverage with its bounds, tightness, availability, chart and unit circle of each mode."""
    return {
        "risk": LEVEL_PARAMETERS.integrity_risk,
        "alert_limits_m": list(ALERT_LIMITS_M),
        "chart_edges_m": CHART_M[:-1].tolist(),
        "modes": {mode: _figures([block[mode] for block in blocks]) for mode in MODES},
    }


def _rtk(seed: int, block: int, rules: Rules, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """Right and wrong fixes in the proportion of the prior of their satellites, those that the judge confirms."""
    right = right_fixes(seed, block, _SKIES, "levels")
    wrong = wrong_fixes("search", seed, block + 1_000_000, _SKIES)
    row = rng.integers(len(right.sky), size=draws)
    prior, prior_of_wrong = prior_shares(right)[row], prior_shares(wrong)
    is_wrong = rng.random(draws) < prior if len(wrong.sky) else np.zeros(draws, np.bool_)
    parts = [_confirmed(right.chosen(row[~is_wrong]), prior[~is_wrong], rules, rng)]
    for share in np.unique(prior[is_wrong]).tolist():
        # Those of as many satellites; where the search found none, as with many, any of them.
        alike = np.flatnonzero(prior_of_wrong == share)
        pool = alike if len(alike) else np.arange(len(prior_of_wrong))
        count = int((is_wrong & (prior == share)).sum())
        weighted_draws = wrong.chosen(pool[rng.integers(len(pool), size=count)])
        parts.append(_confirmed(weighted_draws, np.full(count, share), rules, rng))
    return ClaimedPositions(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in ClaimedPositions.__slots__)
    )


def prior_shares(shapes: FixShapes) -> Floats:
    """The share (n,) that is wrong of tentative fixes with as many satellites, by the rules."""
    return np.array(
        [LEVEL_PARAMETERS.wrong_fix.prior_of(count) for count in shapes.satellites.tolist()], np.float64
    )


def _confirmed(shapes: FixShapes, prior: Floats, rules: Rules, rng: np.random.Generator) -> ClaimedPositions:
    run = episodes(shapes, SCENE, rng, length=np.ones(len(shapes.sky), np.int64))
    s = innovation_covariance(shapes.claimed_m2, run.slope, SCENE, rules)
    agreed = BaselineDecisions(rules.determination, SCENE.pose_sigma_m).agreed(run.difference_m, s)
    fix = inflated_covariance(shapes.claimed_m2[agreed], rules)
    return of_fixes(
        run.error_m[agreed, :2], run.difference_m[agreed], s[agreed], fix, SCENE.pose_sigma_m, prior[agreed]
    )


def of_fixes(
    error_m: Floats,
    difference_m: Floats,
    covariance_m2: Floats,
    fix_m2: Floats,
    pose_sigma_m: float,
    prior: Floats,
) -> ClaimedPositions:
    """Confirmed fixes as the judge claims them: right, or wrong and then where road and pose say.

    Errors (n, 2), differences (n, 3) with their covariances (n, 3, 3), those of the fixes (n, 3, 3), the share
    `prior` (n,) of such fixes that is wrong. The poses rest on no fix: nothing has pulled them along.
    """
    n = len(error_m)
    prior_log_odds = np.log(prior) - np.log1p(-prior)
    w = wrong_fix.probability(
        wrong_fix.log_odds(difference_m, covariance_m2, LEVEL_PARAMETERS.wrong_fix, prior_log_odds)
    )
    pose = np.broadcast_to(np.eye(2) * pose_sigma_m**2, (n, 2, 2))
    mean = np.stack((np.zeros((n, 2)), difference_m[:, :2]), axis=1)
    covariance = np.stack((fix_m2[:, :2, :2], pose), axis=1)
    return ClaimedPositions(
        error_m, np.column_stack((1.0 - w, w)), mean, covariance, w * LEVEL_PARAMETERS.pose_fault_prior
    )


def _doppler(seed: int, block: int, rules: Rules, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """A confirmed position, and on it the sum by trapezoids of velocities with Gauss-Markov errors."""
    base = _rtk(seed, block, rules, draws, rng)
    base = base.chosen(rng.integers(len(base.lost), size=draws))
    steps, step_s = rng.integers(1, round(_LONGEST_S / _STEP_S) + 1, draws), _STEP_S
    grown_m2, sigma_m_s = claimed_growth()
    memory = math.exp(-step_s / LEVEL_PARAMETERS.doppler.correlation_s)
    velocity = sigma_m_s * rng.normal(size=(draws, 2))
    moved = np.zeros((draws, 2))
    for k in range(1, len(grown_m2)):
        before = velocity
        velocity = memory * before + math.sqrt(1.0 - memory**2) * sigma_m_s * rng.normal(size=(draws, 2))
        moved += np.where((steps >= k)[:, None], 0.5 * step_s * (before + velocity), 0.0)
    added = grown_m2[steps][:, None, None, None] * np.eye(2)
    lost = base.lost + LEVEL_PARAMETERS.pose_fault_prior
    return ClaimedPositions(base.error_m + moved, base.weight, base.mean_m, base.covariance_m2 + added, lost)


def claimed_growth() -> tuple[Floats, float]:
    """Variance an axis that the product's own sum claims after k steps, (k,), and the σ of its velocities."""
    own = DopplerPosition(LEVEL_PARAMETERS.doppler)
    variances = [0.0]
    for k in range(round(_LONGEST_S / _STEP_S) + 1):
        time_ns = _EPOCH_NS + round(k * _STEP_S * 1e9)
        v = VELOCITY_SIGMA_M_S**2
        own.add_velocity(
            SatelliteVelocity(
                time_ns=time_ns,
                velocity_enu_m_s=(0.0, 0.0, 0.0),
                covariance_enu_m2_s2=(v, 0.0, 0.0, v, 0.0, v),
                hdop=1.0,
                satellites=8,
            )
        )
        if k == 0:
            own.begin(time_ns)
            continue
        moved = own.at(time_ns)
        assert moved is not None
        variances.append(float(moved.covariance_m2[0, 0]))
    doppler = LEVEL_PARAMETERS.doppler
    return np.array(variances), math.hypot(doppler.sigma_scale * VELOCITY_SIGMA_M_S, doppler.sigma_floor_m_s)


def _gaussian(covariance_m2: Floats, rng: np.random.Generator) -> ClaimedPositions:
    n = len(covariance_m2)
    error = (np.linalg.cholesky(covariance_m2) @ rng.normal(size=(n, 2, 1)))[:, :, 0]
    lost = np.full(n, LEVEL_PARAMETERS.pose_fault_prior)
    return ClaimedPositions(error, np.ones((n, 1)), np.zeros((n, 1, 2)), covariance_m2[:, None], lost)


def _sensors(seed: int, block: int, rules: Rules, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """After up to 30 s of 2 to 15 m/s: 0.5 % of the way along and 1 % across, from a position of 0.05 m."""
    path = rng.uniform(0.1, 30.0, draws) * rng.uniform(2.0, 15.0, draws)
    turn = rng.uniform(0.0, 2.0 * math.pi, draws)
    axis = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    other = np.stack((-axis[:, 1], axis[:, 0]), axis=1)
    along, across = (0.005 * path) ** 2 + 0.0025, (0.01 * path) ** 2 + 0.0025
    covariance = along[:, None, None] * axis[:, :, None] * axis[:, None, :]
    return _gaussian(covariance + across[:, None, None] * other[:, :, None] * other[:, None, :], rng)


def _scan_match(
    seed: int, block: int, rules: Rules, draws: int, rng: np.random.Generator
) -> ClaimedPositions:
    sigma = rng.uniform(0.05, 0.10, draws)
    return _gaussian(sigma[:, None, None] ** 2 * np.eye(2), rng)


_MODES: dict[str, Callable[[int, int, Rules, int, np.random.Generator], ClaimedPositions]] = {
    "rtk": _rtk, "doppler": _doppler, "sensors": _sensors, "scan_match": _scan_match,
}  # fmt: skip


def bounds(claimed: ClaimedPositions) -> ClaimedBounds:
    """As the product makes them; the height, of which nothing is told here, has a part of 1 m."""
    n, parts = claimed.weight.shape
    mixtures = [
        ErrorMixture(
            tuple(
                MixtureComponent(
                    weight=float(claimed.weight[i, k]),
                    mean_m=(float(claimed.mean_m[i, k, 0]), float(claimed.mean_m[i, k, 1]), 0.0),
                    horizontal_m2=_plane(claimed.covariance_m2[i, k]),
                    up_m2=1.0,
                )
                for k in range(parts)
            ),
            float(claimed.lost[i]),
        )
        for i in range(n)
    ]
    found = bounds_of(mixtures, LEVEL_PARAMETERS)
    turn = np.array([one.orientation_rad for one in found])
    east, north = claimed.error_m.T
    along, across = np.cos(turn) * east + np.sin(turn) * north, np.cos(turn) * north - np.sin(turn) * east

    def within(major_m: list[float], minor_m: list[float]) -> Floats:
        return np.column_stack((along / np.array(major_m), across / np.array(minor_m)))

    return ClaimedBounds(
        within([one.semi_major_99_m for one in found], [one.semi_minor_99_m for one in found]),
        within([one.semi_major_999_m for one in found], [one.semi_minor_999_m for one in found]),
        np.array([one.horizontal_level_m for one in found]),
    )


def _plane(covariance_m2: Floats) -> tuple[float, float, float]:
    return float(covariance_m2[0, 0]), float(covariance_m2[0, 1]), float(covariance_m2[1, 1])


def _counts(claimed: ClaimedPositions) -> dict[str, Any]:
    n, found = len(claimed.error_m), bounds(claimed)
    error, hpl = np.hypot(claimed.error_m[:, 0], claimed.error_m[:, 1]), found.level_m
    chart = np.histogram2d(error, hpl, (CHART_M, CHART_M))[0].astype(np.int64)
    return {
        "draws": n,
        "inside_99": int((np.hypot(*found.in_99.T) <= 1.0).sum()),
        "inside_999": int((np.hypot(*found.in_999.T) <= 1.0).sum()),
        "beyond_level": int((error > hpl).sum()),
        "available": [int((hpl < limit).sum()) for limit in ALERT_LIMITS_M],
        "error_m": error,
        "hpl_m": hpl,
        "chart": chart,
        "circle": found.in_999[:_IN_CIRCLE],
    }


def _figures(counts: list[dict[str, Any]]) -> dict[str, Any]:
    n = sum(c["draws"] for c in counts)
    error, hpl = (np.concatenate([c[name] for c in counts]) for name in ("error_m", "hpl_m"))
    out: dict[str, Any] = {"draws": n}
    for name in ("inside_99", "inside_999"):
        inside = sum(c[name] for c in counts)
        low, high = clopper_pearson(inside, n)
        out[name] = {"share": inside / n, "lower_95": low, "upper_95": high}
    beyond = sum(c["beyond_level"] for c in counts)
    out["beyond_level"] = {"count": beyond, "upper_95": clopper_pearson(beyond, n)[1]}
    out["median_error_m"], out["median_level_m"] = float(np.median(error)), float(np.median(hpl))
    out["p99_level_m"] = float(np.quantile(hpl, 0.99))
    out["level_by_error"] = out["median_level_m"] / out["median_error_m"]
    out["available"] = [sum(c["available"][k] for c in counts) / n for k in range(len(ALERT_LIMITS_M))]
    out["chart"] = np.sum([c["chart"] for c in counts], axis=0).tolist()
    out["circle"] = np.round(np.concatenate([c["circle"] for c in counts])[:1500], 3).tolist()
    return out

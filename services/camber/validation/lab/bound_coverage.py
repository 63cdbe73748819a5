"""Do bounds hold? Positions of each mode with true errors, and the ellipses and levels that the product would claim.

`rtk`: candidate fixes of which the rules' prior share for their satellites is wrong, judged; those confirmed.
`doppler`: from such a position on the sum of velocities with the errors that their rules assume, for up to 30 s.
`sensors` and `scan_match`: poses that rest on no fix, whose covariances, the localizer's claims, are taken to be true:
what is tested of them is the step from a covariance to a bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from camber.formats.observations import Floats, Integers
from camber.integrity.protection import wrong_fix_probability as wrong_fix
from camber.integrity.protection.doppler_position import DopplerPosition
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent, bounds_of
from camber.integrity.rules import Rules
from camber.schemas.gnss import SatelliteVelocity
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.baselines import BaselineDecisions, Booleans
from camber.validation.lab.error_episodes import Episodes, episodes
from camber.validation.lab.error_model import HEADLINE, inflated_covariance
from camber.validation.lab.false_alarms import right_fixes
from camber.validation.lab.missed_detection import wrong_fixes
from camber.validation.lab.work_blocks import WorkBlock
from camber.validation.statistics import clopper_pearson

MODES = ("rtk", "doppler", "sensors", "scan_match")
ALERT_LIMITS_M = (0.29, 0.57, 1.0, 1.5, 3.0)
LEVEL_PARAMETERS = LevelRules()
VELOCITY_SIGMA_M_S = 0.03
"""Chosen: of Doppler by carrier phase under an open sky; the rules' own floor and scale are added to it."""
SCENE = HEADLINE[0]
CHART_M = np.concatenate(([0.0], np.geomspace(0.01, 30.0, 59), [np.inf]))
DRAWS = 10_000
"""Of each mode in a block. Chosen: seconds of work."""
_LONGEST_S, _STEP_S, _EPOCH_NS = LEVEL_PARAMETERS.doppler.longest_s, 0.1, 1_400_000_000_000_000_000
_IN_CIRCLE = 125
"""Points of a block in the chart; twelve blocks give 1500."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClaimedPositions:
    """n positions with true horizontal errors (n, 2), and the mixtures (n, k) that their bounds are made from."""

    error_m: Floats
    weight: Floats
    mean_m: Floats
    covariance_m2: Floats
    lost: Floats

    def chosen(self, rows: Integers) -> ClaimedPositions:
        """Some of them."""
        return ClaimedPositions(**{name: getattr(self, name)[rows] for name in self.__slots__})


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClaimedBounds:
    """Errors in units of the semi-axes of their 99 % and 99.9 % ellipses (n, 2), and horizontal levels (n,)."""

    in_99: Floats
    in_999: Floats
    level_m: Floats


def coverage_block(block: WorkBlock, draws: int = DRAWS) -> dict[str, dict[str, Any]]:
    """Counts of each mode."""
    return {mode: _counts(_MODES[mode](block, draws, block.stream(f"levels/{mode}"))) for mode in MODES}


def coverage_figures(blocks: list[dict[str, dict[str, Any]]]) -> dict[str, Any]:
    """Of all blocks: coverage with its bounds, tightness, availability, chart and unit circle of each mode."""
    return {
        "risk": LEVEL_PARAMETERS.integrity_risk,
        "alert_limits_m": list(ALERT_LIMITS_M),
        "chart_edges_m": CHART_M[:-1].tolist(),
        "modes": {mode: _figures([block[mode] for block in blocks]) for mode in MODES},
    }


def _rtk(block: WorkBlock, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """Right and wrong fixes in the proportion of the prior of their satellites, those that the judge confirms."""
    right = right_fixes(block, "levels")
    wrong = wrong_fixes(replace(block, number=block.number + 1_000_000), "search")
    row = rng.integers(len(right.sky), size=draws)
    prior, prior_of_wrong = prior_shares(right)[row], prior_shares(wrong)
    is_wrong = rng.random(draws) < prior if len(wrong.sky) else np.zeros(draws, np.bool_)
    parts = [_confirmed(right.chosen(row[~is_wrong]), prior[~is_wrong], block.rules, rng)]
    for share in np.unique(prior[is_wrong]).tolist():
        # Those of as many satellites; where the search found none, as with many, any of them.
        alike = np.flatnonzero(prior_of_wrong == share)
        pool = alike if len(alike) else np.arange(len(prior_of_wrong))
        count = int((is_wrong & (prior == share)).sum())
        chosen = wrong.chosen(pool[rng.integers(len(pool), size=count)])
        parts.append(_confirmed(chosen, np.full(count, share), block.rules, rng))
    names = ClaimedPositions.__slots__
    return ClaimedPositions(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def prior_shares(shapes: FixShapes) -> Floats:
    """The share (n,) that is wrong of candidate fixes with as many satellites, by the rules."""
    prior_of = LEVEL_PARAMETERS.wrong_fix.prior_of
    return np.array([prior_of(count) for count in shapes.satellites.tolist()], np.float64)


def _confirmed(shapes: FixShapes, prior: Floats, rules: Rules, rng: np.random.Generator) -> ClaimedPositions:
    return confirmed_claims(shapes, episodes(shapes, SCENE, rng, length=1), prior, rules)[1]


def confirmed_claims(
    shapes: FixShapes, run: Episodes, prior: Floats, rules: Rules
) -> tuple[Booleans, ClaimedPositions]:
    """Which of single epochs (n,) the judge confirms, and what it claims of those: right, or wrong and then where road
    and pose say. `prior` (n,) is the share of such fixes that is wrong; the poses rest on no fix."""
    judge = BaselineDecisions(rules, SCENE)
    s = judge.covariance(shapes.claimed_m2, run.slope)
    agreed = judge.agreed(run.difference_m, s)
    difference_m, prior = run.difference_m[agreed], prior[agreed]
    prior_log_odds = np.log(prior) - np.log1p(-prior)
    w = wrong_fix.probability(
        wrong_fix.log_odds(difference_m, s[agreed], LEVEL_PARAMETERS.wrong_fix, prior_log_odds)
    )
    n = len(prior)
    fix_m2 = inflated_covariance(shapes.claimed_m2[agreed], rules)[:, :2, :2]
    pose_m2 = np.broadcast_to(np.eye(2) * SCENE.pose_sigma_m**2, (n, 2, 2))
    return agreed, ClaimedPositions(
        error_m=run.error_m[agreed, :2],
        weight=np.column_stack((1.0 - w, w)),
        mean_m=np.stack((np.zeros((n, 2)), difference_m[:, :2]), axis=1),
        covariance_m2=np.stack((fix_m2, pose_m2), axis=1),
        lost=w * LEVEL_PARAMETERS.pose_fault_prior,
    )


def _doppler(block: WorkBlock, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """A confirmed position, and on it the sum by trapezoids of velocities with Gauss-Markov errors."""
    base = _rtk(block, draws, rng)
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
    return replace(
        base,
        error_m=base.error_m + moved,
        covariance_m2=base.covariance_m2 + grown_m2[steps][:, None, None, None] * np.eye(2),
        lost=base.lost + LEVEL_PARAMETERS.pose_fault_prior,
    )


def claimed_growth() -> tuple[Floats, float]:
    """Variance an axis that the product's own sum claims after k steps, (k,), and the σ of its velocities."""
    doppler, v = LEVEL_PARAMETERS.doppler, VELOCITY_SIGMA_M_S**2
    position, variances = DopplerPosition(doppler), [0.0]
    for k in range(round(_LONGEST_S / _STEP_S) + 1):
        time_ns = _EPOCH_NS + round(k * _STEP_S * 1e9)
        position.add_velocity(
            SatelliteVelocity(
                time_ns=time_ns, velocity_enu_m_s=(0.0, 0.0, 0.0), covariance_enu_m2_s2=(v, 0.0, 0.0, v, 0.0, v),
                hdop=1.0, satellites=8,
            )
        )  # fmt: skip
        if k == 0:
            position.begin(time_ns)
            continue
        moved = position.at(time_ns)
        assert moved is not None
        variances.append(float(moved.covariance_m2[0, 0]))
    return np.array(variances), math.hypot(doppler.sigma_scale * VELOCITY_SIGMA_M_S, doppler.sigma_floor_m_s)


def _gaussian(covariance_m2: Floats, rng: np.random.Generator) -> ClaimedPositions:
    n = len(covariance_m2)
    return ClaimedPositions(
        error_m=(np.linalg.cholesky(covariance_m2) @ rng.normal(size=(n, 2, 1)))[:, :, 0],
        weight=np.ones((n, 1)),
        mean_m=np.zeros((n, 1, 2)),
        covariance_m2=covariance_m2[:, None],
        lost=np.full(n, LEVEL_PARAMETERS.pose_fault_prior),
    )


def _sensors(block: WorkBlock, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    """After up to 30 s of 2 to 15 m/s: 0.5 % of the way along and 1 % across, from a position of 0.05 m."""
    path = rng.uniform(0.1, 30.0, draws) * rng.uniform(2.0, 15.0, draws)
    turn = rng.uniform(0.0, 2.0 * math.pi, draws)
    axis = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    other = np.stack((-axis[:, 1], axis[:, 0]), axis=1)
    along, across = (0.005 * path) ** 2 + 0.0025, (0.01 * path) ** 2 + 0.0025
    covariance = along[:, None, None] * axis[:, :, None] * axis[:, None, :]
    return _gaussian(covariance + across[:, None, None] * other[:, :, None] * other[:, None, :], rng)


def _scan_match(block: WorkBlock, draws: int, rng: np.random.Generator) -> ClaimedPositions:
    sigma = rng.uniform(0.05, 0.10, draws)
    return _gaussian(sigma[:, None, None] ** 2 * np.eye(2), rng)


_MODES: dict[str, Callable[[WorkBlock, int, np.random.Generator], ClaimedPositions]] = dict(
    zip(MODES, (_rtk, _doppler, _sensors, _scan_match), strict=True)
)


def bounds(claimed: ClaimedPositions) -> ClaimedBounds:
    """As the product makes them; the height, which plays no role here, has a part of 1 m."""
    mixtures = [
        ErrorMixture(
            tuple(
                MixtureComponent(weight=weight, mean_m=(*mean, 0.0), horizontal_m2=(ee, en, nn), up_m2=1.0)
                for weight, mean, ((ee, en), (_, nn)) in zip(*parts, strict=True)
            ),
            lost,
        )
        for *parts, lost in zip(
            claimed.weight.tolist(),
            claimed.mean_m.tolist(),
            claimed.covariance_m2.tolist(),
            claimed.lost.tolist(),
            strict=True,
        )
    ]
    by_product = bounds_of(mixtures, LEVEL_PARAMETERS)
    column = {
        name: np.array([getattr(bound, name) for bound in by_product])
        for name in (
            "orientation_rad", "semi_major_99_m", "semi_minor_99_m", "semi_major_999_m", "semi_minor_999_m",
            "horizontal_level_m",
        )
    }  # fmt: skip
    turn, (east, north) = column["orientation_rad"], claimed.error_m.T
    along, across = np.cos(turn) * east + np.sin(turn) * north, np.cos(turn) * north - np.sin(turn) * east
    in_99, in_999 = (
        np.column_stack((along / column[f"semi_major_{p}_m"], across / column[f"semi_minor_{p}_m"]))
        for p in ("99", "999")
    )
    return ClaimedBounds(in_99=in_99, in_999=in_999, level_m=column["horizontal_level_m"])


def _counts(claimed: ClaimedPositions) -> dict[str, Any]:
    n, claims = len(claimed.error_m), bounds(claimed)
    error, hpl = np.hypot(claimed.error_m[:, 0], claimed.error_m[:, 1]), claims.level_m
    chart = np.histogram2d(error, hpl, (CHART_M, CHART_M))[0].astype(np.int64)
    return {
        "draws": n,
        "inside_99": int((np.hypot(*claims.in_99.T) <= 1.0).sum()),
        "inside_999": int((np.hypot(*claims.in_999.T) <= 1.0).sum()),
        "beyond_level": int((error > hpl).sum()),
        "available": [int((hpl < limit).sum()) for limit in ALERT_LIMITS_M],
        "error_m": error,
        "hpl_m": hpl,
        "chart": chart,
        "circle": claims.in_999[:_IN_CIRCLE],
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

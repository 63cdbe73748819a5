"""The positions that an epoch could have, each with all ways in which it may be off: of a fix, by Doppler, of the pose.

If a confirmed fix is wrong, the truth is where road and pose say: its error is then N(d, covariance of the pose), d
being the difference of fix and model. What it leaves behind is in `latent_fault`, a fix that the pose contradicts in
`pose_dispute`.

A height that is the road's is off where the road has changed since the survey. What fixes show of the road is not
remembered: a level grows with the logarithm of the odds, so to know for certain that a road has changed would raise it
by a fifth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.judgement import FixJudgement
from camber.integrity.pose_provenance import is_provisional, rests_on_fixes
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.doppler_position import Displacement
from camber.integrity.protection.latent_fault import LatentFaultHypothesis, is_same_draw
from camber.integrity.protection.pose_dispute import PoseDispute
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    LevelRules,
    MixtureComponent,
    widened,
)
from camber.integrity.protection.wrong_fix_probability import WrongFixRules, log_odds_of
from camber.integrity.rules import Rules
from camber.schemas.base import Covariance3

Source = Literal["rtk", "doppler", "sensors", "scan_match"]
GeodeticPosition = tuple[float, float, float | None]

_NEGLIGIBLE = 1e-4
"""Of the integrity risk. Chosen: what is less likely has no part of its own, it counts as not bounded."""
UNKNOWN_HEIGHT_M2 = 1e6  # the variance beside a height that is None
_MOST_LOG_ODDS = 30.0  # chosen: odds of 1e13 are certainty in floats, and exp does not overflow


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionCandidate:
    """A position with its mixture; `wrong` is the probability that a wrong fix stands behind it, None: no fix does.

    `up_by_road_m`: mean and variance of its error upwards if only the road says how high it is.
    """

    source: Source
    time_ns: int
    geodetic: GeodeticPosition
    covariance_enu_m2: Covariance3
    yaw_rad: float | None
    mixture: ErrorMixture
    wrong: float | None
    up_by_road_m: tuple[float, float]
    fix_id: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfirmedPosition:
    """A confirmed fix as a position, and the fault hypothesis that it leaves."""

    candidate: PositionCandidate
    latent_fault: LatentFaultHypothesis


def confirmed_fix(
    judgement: FixJudgement, before: LatentFaultHypothesis, rules: LevelRules, sigma: TrueSigma
) -> ConfirmedPosition:
    """The position of a confirmed fix. Raises ValueError for any other: unknown is never trusted."""
    fix = judgement.fix
    if not judgement.confirmed or fix.covariance_enu_m2 is None:
        raise ValueError(f"fix {fix.fix_id} is {judgement.verdict}, not confirmed")
    covariance = inflate_covariance(fix.covariance_enu_m2, sigma)
    odds, wrong = _if_wrong(judgement, covariance, before, rules.wrong_fix)
    same_draw = is_same_draw(fix, before.time_ns)
    remaining_share = before.remaining_share(fix.time_ns, rules.wrong_fix, same_draw=same_draw)
    pulled = remaining_share * before.odds
    total = 1.0 + odds + pulled
    latent = before.components(remaining_share / total, _NEGLIGIBLE * rules.integrity_risk)
    parts = (
        MixtureComponent(weight=1.0 / total, horizontal_m2=_horizontal(covariance), up_m2=covariance[5]),
        *(one for part in wrong for one in road_components(part, part.weight * odds / total, rules)),
        *(widened(part, covariance) for part in latent),
    )
    probability = (odds + pulled) / total
    candidate = PositionCandidate(
        source="rtk",
        time_ns=fix.time_ns,
        geodetic=(fix.latitude_rad, fix.longitude_rad, fix.height_m),
        covariance_enu_m2=covariance,
        yaw_rad=judgement.pose.yaw_rad if judgement.pose is not None else None,
        # If the pose is at fault too, they agree by accident, and nothing says where the vehicle is.
        mixture=ErrorMixture(parts, probability * rules.pose_fault_prior + _left_out(pulled / total, latent)),
        wrong=probability,
        up_by_road_m=(wrong[0].mean_m[2], wrong[0].up_m2),
        fix_id=fix.fix_id,
    )
    after = before.after(fix.time_ns, odds, wrong, rules.wrong_fix, same_draw=same_draw)
    return ConfirmedPosition(candidate=candidate, latent_fault=after)


def of_doppler(
    base: PositionCandidate, moved: Displacement, time_ns: int, rules: LevelRules
) -> PositionCandidate:
    """The confirmed position moved on by satellite velocities, with all that stood behind it."""
    latitude_rad, longitude_rad, height_m = base.geodetic
    assert height_m is not None
    east_m, north_m, up_m = (float(metre) for metre in moved.metres)
    to_latitude_rad = latitude_rad + north_m / (meridian_radius_m(latitude_rad) + height_m)
    middle_rad = 0.5 * (latitude_rad + to_latitude_rad)
    around_m = (prime_vertical_radius_m(middle_rad) + height_m) * math.cos(middle_rad)
    added = moved.covariance_m2[np.triu_indices(3)].tolist()
    ee, en, eu, nn, nu, uu = (one + other for one, other in zip(base.covariance_enu_m2, added, strict=True))
    grown = tuple(widened(part, added) for part in base.mixture.parts)
    return PositionCandidate(
        source="doppler",
        time_ns=time_ns,
        geodetic=(to_latitude_rad, longitude_rad + east_m / around_m, height_m + up_m),
        covariance_enu_m2=(ee, en, eu, nn, nu, uu),
        yaw_rad=moved.yaw_rad,
        mixture=ErrorMixture(grown, base.mixture.lost + rules.pose_fault_prior),
        wrong=base.wrong,
        up_by_road_m=(base.up_by_road_m[0], base.up_by_road_m[1] + uu - base.covariance_enu_m2[5]),
        fix_id=base.fix_id,
    )


def of_pose(
    inputs: EpochInputs,
    correction_m: float,
    latent_fault: LatentFaultHypothesis,
    rules: Rules,
    dispute: PoseDispute | None = None,
) -> PositionCandidate:
    """The pose's antenna on its road. `inputs.missing_pose` has to be None."""
    pose, levels = inputs.known_pose, rules.levels
    assert pose.latitude_rad is not None
    assert pose.longitude_rad is not None
    assert pose.covariance_east_north_yaw is not None
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    height_m, up_m2 = height_on_road(inputs, correction_m, rules)
    alone = MixtureComponent(
        weight=1.0, horizontal_m2=(ee, en, nn), up_m2=up_m2 if height_m is not None else math.inf
    )
    parts: tuple[MixtureComponent, ...] = road_components(alone, 1.0, levels)
    wrong: float | None = None
    lost = levels.pose_fault_prior
    if rests_on_fixes(pose):
        total = 1.0 + latent_fault.odds
        wrong = latent_fault.odds / total
        pulled = latent_fault.components(1.0 / total, _NEGLIGIBLE * levels.integrity_risk)
        lost += _left_out(wrong, pulled)
        parts = (
            *road_components(alone, 1.0 - wrong, levels),
            *(one for part in pulled for one in _with_pose(part, alone, levels)),
        )
    if dispute is not None:
        parts = dispute.with_alternative(parts, alone, dispute.weight(levels))
    return PositionCandidate(
        source="scan_match" if pose.mode == "scan_match" else "sensors",
        time_ns=pose.time_ns,
        geodetic=(pose.latitude_rad, pose.longitude_rad, height_m),
        covariance_enu_m2=(ee, en, 0.0, nn, 0.0, up_m2),
        yaw_rad=pose.yaw_rad,
        mixture=ErrorMixture(parts, lost),
        wrong=wrong,
        up_by_road_m=(0.0, alone.up_m2),
    )


def _left_out(probability: float, latent: tuple[MixtureComponent, ...]) -> float:
    """The probability of latent faults that have no part of their own."""
    return max(probability - sum(part.weight for part in latent), 0.0)


def _with_pose(
    pulled: MixtureComponent, pose: MixtureComponent, rules: LevelRules
) -> tuple[MixtureComponent, MixtureComponent]:
    """A pose that was pulled along, with its own errors; the height is that of the road."""
    (ee, en, nn), (p_ee, p_en, p_nn) = pulled.horizontal_m2, pose.horizontal_m2
    together = ee + p_ee, en + p_en, nn + p_nn
    wider = MixtureComponent(pulled.weight, together, pose.up_m2, *pulled[3:])
    return road_components(wider, pulled.weight, rules)


def height_on_road(inputs: EpochInputs, correction_m: float, rules: Rules) -> tuple[float | None, float]:
    """Height of the antenna on the road below it, and its variance with the slope's share of the pose's error."""
    pose, antenna = inputs.known_pose, inputs.antenna
    assert pose.covariance_east_north_yaw is not None
    road = pose.road
    missing = inputs.missing_road(pose.time_ns, rules) or inputs.missing_antenna(pose.time_ns, rules)
    if missing is not None or road.slope_east is None or road.slope_north is None:
        return None, UNKNOWN_HEIGHT_M2
    assert road.elevation_m is not None
    assert road.sigma_m is not None
    assert antenna is not None
    assert antenna.height_m is not None
    assert antenna.sigma_m is not None
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    se, sn = road.slope_east, road.slope_north
    slope_m2 = se * se * ee + 2.0 * se * sn * en + sn * sn * nn
    height_m = road.elevation_m + antenna.height_m + correction_m
    return height_m, road.sigma_m**2 + antenna.sigma_m**2 + max(slope_m2, 0.0)


def _if_wrong(
    judgement: FixJudgement, covariance: Covariance3, before: LatentFaultHypothesis, rules: WrongFixRules
) -> tuple[float, tuple[MixtureComponent, ...]]:
    """Odds that the fix is wrong, by itself, and how far off it is then, by shares of one."""
    result, pose = judgement.comparison, judgement.pose
    horizontal_m2, vertical_m2 = rules.second_moment_m2
    unknown = tuple(
        MixtureComponent(weight=share, horizontal_m2=(east_m2, 0.0, north_m2), up_m2=vertical_m2)
        for share, (east_m2, north_m2, _) in rules.parts
    )
    prior_log_odds = rules.prior_log_odds(judgement.fix.satellites)
    if result is None or pose is None or pose.covariance_east_north_yaw is None:
        return judgement.trials * math.exp(prior_log_odds), unknown
    east_m, north_m, up_m = result.difference_m.tolist()
    (s_ee, s_en, s_eu), (_, s_nn, s_nu), (_, _, s_uu) = result.covariance_m2.tolist()
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    follows_fixes = is_provisional(pose) or (before.time_ns is None and rests_on_fixes(pose))
    if follows_fixes:  # it says nothing against them
        s_ee, s_nn = s_ee + horizontal_m2, s_nn + horizontal_m2
    model_m2 = s_uu - covariance[5]
    if not (math.isfinite(up_m) and math.isfinite(model_m2)):
        up_m, model_m2 = 0.0, vertical_m2
        s_eu, s_nu, s_uu = 0.0, 0.0, UNKNOWN_HEIGHT_M2
    against = log_odds_of(
        (east_m, north_m, up_m),
        (s_ee, s_en, s_eu, s_nn, s_nu, s_uu),
        rules=rules,
        prior_log_odds=prior_log_odds,
        trials=judgement.trials,
    )
    # Road and antenna may know the height better than the fix does: a fix that is doubted is no surer for it.
    wrong = MixtureComponent(
        weight=1.0,
        mean_m=(east_m, north_m, up_m),
        horizontal_m2=(ee, en, nn),
        up_m2=max(model_m2, covariance[5]),
    )
    odds = math.exp(min(against, _MOST_LOG_ODDS))
    if not follows_fixes:
        return odds, (wrong,)
    pose_m2 = (ee, en, 0.0, nn, 0.0, 0.0)
    return odds, tuple(
        wrong._replace(weight=one.weight, horizontal_m2=widened(one, pose_m2).horizontal_m2)
        for one in unknown
    )


def road_components(
    part: MixtureComponent, weight: float, rules: LevelRules
) -> tuple[MixtureComponent, MixtureComponent]:
    """A part whose height is the road's, once on the road as it was surveyed and once where that has changed."""
    changed, up_m2 = rules.changed_road_prior, part.up_m2 + rules.changed_road_sigma_m**2
    return (
        MixtureComponent((1.0 - changed) * weight, *part[1:]),
        MixtureComponent(changed * weight, part.horizontal_m2, up_m2, *part[3:]),
    )


def _horizontal(covariance: Covariance3) -> tuple[float, float, float]:
    return covariance[0], covariance[1], covariance[3]

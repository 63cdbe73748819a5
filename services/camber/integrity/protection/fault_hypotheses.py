"""The positions that an epoch could have, each with all ways in which it may be off: of a fix, by Doppler, of the pose.

If a confirmed fix is wrong, the truth is where road and pose say: its error is then N(d, covariance of the pose), d
being the difference of fix and model. Confirmed fixes anchor the pose: one that was wrong and has passed has pulled it
along, and agrees with it afterwards. `LatentFaultHypothesis` holds how likely that is and how far off; it fades as
episodes of wrong fixes end, which a pose that has been pulled along would show, and where scan matching agrees
with the pose place after place (`MatchCorroboration`).

A fix whose height agrees and whose place the pose contradicts: either may be wrong (`PoseDispute`). Until
one that agrees, the vehicle may be where the fix was.

A height that is the road's is off where the road has changed since the survey. What fixes show of the road is not
remembered: a level grows with the logarithm of the odds, so to know for certain that a road has changed would raise it
by a fifth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.chi2_test import AGREES
from camber.integrity.checks.consistency import POSITION_CONTRADICTS
from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.doppler_position import Displacement
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent
from camber.integrity.protection.wrong_fix_probability import WrongFixRules, log_odds_of, log_odds_of_share
from camber.integrity.rules import Rules
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.base import Covariance3
from camber.schemas.pose import Pose

Source = Literal["rtk", "doppler", "sensors", "scan_match"]
GeodeticPosition = tuple[float, float, float | None]

UNKNOWN_HEIGHT_M2 = 1e6  # the variance beside a height that is None
_MOST_LOG_ODDS = 30.0  # chosen: odds of 1e13 are certainty in floats, and exp does not overflow
_NOT_OF_THE_POSE = frozenset({"phase_residuals_contradict", "receiver_warns", "common_offset"})
"""It is the fix by its own account, or the base: neither says that the pose is wrong."""
_MATCH_SIGMAS = 4.0  # σ of a match that lie within the offset of the latent fault


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentFaultHypothesis:
    """That what fixes and pose stand on is a wrong fix: odds, and mean squares of the offset (each axis, upwards).

    `time_ns` None: no fix has been confirmed yet.
    """

    time_ns: int | None
    odds: float
    horizontal_m2: float
    up_m2: float

    @classmethod
    def initial(cls, rules: WrongFixRules) -> LatentFaultHypothesis:
        """Of a pose that rests on fixes of which nothing is known here."""
        horizontal_m2, up_m2 = rules.second_moment_m2
        odds = math.exp(log_odds_of_share(rules.prior))
        return cls(time_ns=None, odds=odds, horizontal_m2=horizontal_m2, up_m2=up_m2)

    def remaining_share(self, time_ns: int, rules: WrongFixRules) -> float:
        """The share of it that is left at a later time: episodes of wrong fixes end."""
        if self.time_ns is None:
            return 0.0
        return math.exp(-max(time_ns - self.time_ns, 0) / (rules.episode_s * 1e9))

    def after(
        self, time_ns: int, odds: float, wrong: MixtureComponent, rules: WrongFixRules
    ) -> LatentFaultHypothesis:
        """After a confirmed fix: the episode may have lasted, or another have begun since the fix before.

        `odds` are those of the fix by itself, `wrong` is how far off it is if it is wrong.
        """
        remaining_share = self.remaining_share(time_ns, rules)
        begun = (1.0 - remaining_share) * odds
        total = remaining_share * self.odds + begun
        share = begun / total if total > 0.0 else 0.0
        (east_m, north_m, up_m), (ee, _, nn) = wrong.mean_m, wrong.horizontal_m2
        horizontal_m2, up_m2 = max(east_m * east_m + ee, north_m * north_m + nn), up_m * up_m + wrong.up_m2
        return LatentFaultHypothesis(
            time_ns=time_ns,
            odds=total,
            horizontal_m2=self.horizontal_m2 + share * (horizontal_m2 - self.horizontal_m2),
            up_m2=self.up_m2 + share * (up_m2 - self.up_m2),
        )

    def corroborate(self, before: LatentFaultHypothesis, rules: LevelRules) -> LatentFaultHypothesis:
        """After a scan match has found the pose where it is: what is left of `before` would take a wrong match too."""
        assert self.time_ns is not None
        left = before.remaining_share(self.time_ns, rules.wrong_fix) * before.odds
        return replace(self, odds=self.odds - (1.0 - rules.false_match_prior) * left)

    def part(self, weight: float) -> MixtureComponent:
        """What was pulled along."""
        return MixtureComponent(
            weight=weight, horizontal_m2=(self.horizontal_m2, 0.0, self.horizontal_m2), up_m2=self.up_m2
        )


class MatchCorroboration:
    """Scan matches that agree with the pose, so far apart that what makes one wrong is gone at the next.

    Only a match counts that is newer than the hypothesis, and precise compared with its offset.
    """

    def __init__(self, rules: LevelRules) -> None:
        self._rules = rules
        self._last: tuple[float, float] | None = None
        self._before: LatentFaultHypothesis | None = None

    def update(self, pose: Pose, latent_fault: LatentFaultHypothesis) -> LatentFaultHypothesis:
        """The fault hypothesis after a pose."""
        if pose.mode != "scan_match" or pose.latitude_rad is None or pose.longitude_rad is None:
            return latent_fault
        here = pose.latitude_rad, pose.longitude_rad
        if self._last is None:
            self._last = here
        if self._before is None:
            far = math.hypot(*east_north_between(*self._last, *here)) >= self._rules.matches_apart_m
            if far and latent_fault.time_ns is not None:
                self._before = latent_fault
            return latent_fault
        assert self._before.time_ns is not None
        newer = pose.match_time_ns is not None and pose.match_time_ns > self._before.time_ns
        if not newer or not _MATCH_SIGMAS**2 * _larger_m2(pose) <= latent_fault.horizontal_m2:
            return latent_fault
        before, self._last, self._before = self._before, here, None
        return latent_fault.corroborate(before, self._rules)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDispute:
    """A fix whose height agrees and whose place the pose contradicts: one of both is wrong, and which is not known.

    `east_m`, `north_m` from the pose to the fix, `covariance_enu_m2` of the fix, `begun_ns` the time of the first.
    `matches` newer than that agree with the pose, the last at the place `matched_at`.
    """

    begun_ns: int
    time_ns: int
    east_m: float
    north_m: float
    covariance_enu_m2: Covariance3
    matches: int = 0
    matched_at: tuple[float, float] | None = None

    def weight(self, rules: LevelRules) -> float:
        """How likely it is the pose. It does not fade: a wrong pose stays wrong."""
        return rules.disputed_pose_prior * rules.false_match_prior**self.matches

    def update(self, pose: Pose, rules: LevelRules) -> PoseDispute:
        """Count a match that is newer than the dispute and `matches_apart_m` from the last one."""
        if pose.mode != "scan_match" or pose.latitude_rad is None or pose.longitude_rad is None:
            return self
        here = pose.latitude_rad, pose.longitude_rad
        if pose.match_time_ns is None or not pose.match_time_ns > self.begun_ns:
            return self
        if self.matched_at is not None:
            moved_m = math.hypot(*east_north_between(*self.matched_at, *here))
            if not moved_m >= rules.matches_apart_m:
                return self
        return replace(self, matches=self.matches + 1, matched_at=here)

    def with_alternative(
        self, parts: tuple[MixtureComponent, ...], alone: MixtureComponent, weight: float
    ) -> tuple[MixtureComponent, ...]:
        """The parts of a pose, of which `alone` is the one that is right, and that the vehicle is where the fix is."""
        # The fix's height is the road's, as the pose's is.
        there = replace(alone, weight=weight, mean_m=(self.east_m, self.north_m, 0.0))
        others = [replace(part, weight=(1.0 - weight) * part.weight) for part in parts]
        return (*others, _wider(there, self.covariance_enu_m2))


def updated_dispute(
    judgement: FixJudgement, before: PoseDispute | None, sigma: TrueSigma
) -> PoseDispute | None:
    """What is disputed after a judgement: a fix that agrees with the pose ends it, one that was not compared does not.

    Those that contradict in height too, or by their own account, are wrong by themselves and say nothing of the pose.
    """
    result, fix = judgement.comparison, judgement.fix
    if judgement.confirmed:
        return None
    if result is None or fix.covariance_enu_m2 is None or judgement.reason in _NOT_OF_THE_POSE:
        return before
    if result.position == AGREES:
        return None
    # Where the map knows no road under the fix, its height speaks neither for it nor against it.
    if result.outcome != POSITION_CONTRADICTS and judgement.reason != "position_disagrees":
        return before
    east_m, north_m = result.position_m
    newest = PoseDispute(
        begun_ns=fix.time_ns,
        time_ns=fix.time_ns,
        east_m=east_m,
        north_m=north_m,
        covariance_enu_m2=inflate_covariance(fix.covariance_enu_m2, sigma),
    )
    if before is None:
        return newest
    return replace(newest, begun_ns=before.begun_ns, matches=before.matches, matched_at=before.matched_at)


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
    pulled = before.remaining_share(fix.time_ns, rules.wrong_fix) * before.odds
    total = 1.0 + odds + pulled
    parts = (
        MixtureComponent(weight=1.0 / total, horizontal_m2=_horizontal(covariance), up_m2=covariance[5]),
        *road_components(wrong, odds / total, rules),
        _wider(before.part(pulled / total), covariance),
    )
    probability = (odds + pulled) / total
    candidate = PositionCandidate(
        source="rtk",
        time_ns=fix.time_ns,
        geodetic=(fix.latitude_rad, fix.longitude_rad, fix.height_m),
        covariance_enu_m2=covariance,
        yaw_rad=judgement.pose.yaw_rad if judgement.pose is not None else None,
        # If the pose is at fault too, they agree by accident, and nothing says where the vehicle is.
        mixture=ErrorMixture(parts, probability * rules.pose_fault_prior),
        wrong=probability,
        up_by_road_m=(wrong.mean_m[2], wrong.up_m2),
        fix_id=fix.fix_id,
    )
    after = before.after(fix.time_ns, odds, wrong, rules.wrong_fix)
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
    p = moved.covariance_m2
    added = (p[0, 0], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2])
    ee, en, eu, nn, nu, uu = (
        float(one + other) for one, other in zip(base.covariance_enu_m2, added, strict=True)
    )
    grown = tuple(_wider(part, added) for part in base.mixture.parts)
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
    if rests_on_fixes(pose):
        wrong = latent_fault.odds / (1.0 + latent_fault.odds)
        # The height is that of the road.
        wider = (ee + latent_fault.horizontal_m2, en, nn + latent_fault.horizontal_m2)
        pulled = MixtureComponent(weight=wrong, horizontal_m2=wider, up_m2=alone.up_m2)
        parts = (*road_components(alone, 1.0 - wrong, levels), *road_components(pulled, wrong, levels))
    if dispute is not None:
        parts = dispute.with_alternative(parts, alone, dispute.weight(levels))
    return PositionCandidate(
        source="scan_match" if pose.mode == "scan_match" else "sensors",
        time_ns=pose.time_ns,
        geodetic=(pose.latitude_rad, pose.longitude_rad, height_m),
        covariance_enu_m2=(ee, en, 0.0, nn, 0.0, up_m2),
        yaw_rad=pose.yaw_rad,
        mixture=ErrorMixture(parts, levels.pose_fault_prior),
        wrong=wrong,
        up_by_road_m=(0.0, alone.up_m2),
    )


def is_provisional(pose: Pose) -> bool:
    """Does the pose rest on unconfirmed fixes alone?"""
    return pose.provenance == "fixes" or pose.mode == "provisional"


def rests_on_fixes(pose: Pose) -> bool:
    """Have confirmed positions entered it?"""
    return pose.provenance == "confirmed" or pose.mode == "anchored" or pose.anchor_time_ns is not None


def _larger_m2(pose: Pose) -> float:
    """The larger eigenvalue of the position's covariance; not a number without one."""
    if pose.covariance_east_north_yaw is None:
        return math.nan
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    larger_m2: float = larger_eigenvalue(ee, en, nn)
    return larger_m2


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
) -> tuple[float, MixtureComponent]:
    """Odds that the fix is wrong, by itself, and how far off it is then."""
    result, pose = judgement.comparison, judgement.pose
    horizontal_m2, vertical_m2 = rules.second_moment_m2
    prior_log_odds = rules.prior_log_odds(judgement.fix.satellites)
    if result is None or pose is None or pose.covariance_east_north_yaw is None:
        unknown = MixtureComponent(
            weight=1.0, horizontal_m2=(horizontal_m2, 0.0, horizontal_m2), up_m2=vertical_m2
        )
        return judgement.trials * math.exp(prior_log_odds), unknown
    east_m, north_m, up_m = result.difference_m.tolist()
    (s_ee, s_en, s_eu), (_, s_nn, s_nu), (_, _, s_uu) = result.covariance_m2.tolist()
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    if is_provisional(pose) or (before.time_ns is None and rests_on_fixes(pose)):
        # Such a pose is where the fixes are: it says nothing against them.
        s_ee, s_nn = s_ee + horizontal_m2, s_nn + horizontal_m2
        ee, nn = ee + horizontal_m2, nn + horizontal_m2
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
    return math.exp(min(against, _MOST_LOG_ODDS)), wrong


def road_components(
    part: MixtureComponent, weight: float, rules: LevelRules
) -> tuple[MixtureComponent, MixtureComponent]:
    """A part whose height is the road's, once on the road as it was surveyed and once where that has changed."""
    changed = rules.changed_road_prior
    # Twice for every position: built at once, not by `replace`, which takes twice as long.
    surveyed = MixtureComponent(
        weight=(1.0 - changed) * weight,
        mean_m=part.mean_m,
        horizontal_m2=part.horizontal_m2,
        up_m2=part.up_m2,
    )
    changed_road = MixtureComponent(
        weight=changed * weight,
        mean_m=part.mean_m,
        horizontal_m2=part.horizontal_m2,
        up_m2=part.up_m2 + rules.changed_road_sigma_m**2,
    )
    return surveyed, changed_road


def _horizontal(covariance: Covariance3) -> tuple[float, float, float]:
    return covariance[0], covariance[1], covariance[3]


def _wider(part: MixtureComponent, covariance: Sequence[float]) -> MixtureComponent:
    """With the errors of a covariance added."""
    (ee, en, nn) = part.horizontal_m2
    added = (float(ee + covariance[0]), float(en + covariance[1]), float(nn + covariance[3]))
    return replace(part, horizontal_m2=added, up_m2=float(part.up_m2 + covariance[5]))

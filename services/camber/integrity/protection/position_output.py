"""The position for consumers at every epoch, its bounds and its usability (Kikuchi (TUMSAT), reliability index).

A confirmed fix before satellite velocities since the last one, before the vehicle's sensors, before a scan match; a
lower one is taken where its horizontal protection level is clearly smaller. Without any, its absence has a reason.
Usable is what has both levels below their alert limits: what is not known is not below.
"""

from __future__ import annotations

import math
from dataclasses import replace

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.epoch_inputs import EpochInputs, age_s
from camber.integrity.judgement import FixJudgement
from camber.integrity.pose_provenance import is_provisional as is_provisional
from camber.integrity.protection.common_fault import with_common_fault
from camber.integrity.protection.doppler_position import DopplerPosition
from camber.integrity.protection.latent_fault import LatentFaultHypothesis, MatchCorroboration
from camber.integrity.protection.pose_dispute import (
    PoseAgreement,
    PoseDispute,
    updated_agreement,
    updated_dispute,
)
from camber.integrity.protection.position_bounds import Bounds, bounds_of, is_beyond
from camber.integrity.protection.position_candidates import (
    PositionCandidate,
    confirmed_fix,
    of_doppler,
    of_pose,
)
from camber.integrity.protection.reliability_index import ReliabilityIndex
from camber.integrity.rules import SAME_EPOCH_S, Rules
from camber.schemas.base import Covariance3
from camber.schemas.gnss import SatelliteVelocity
from camber.schemas.integrity import Position, Reason
from camber.schemas.pose import Pose

_CONTRADICTION = 27.6  # squared distance of two positions: χ²(2) at 1e-6
_FLOOR_M2 = 0.01  # each axis, (0.1 m)²; chosen: precise positions do not contradict by centimetres
_AS_SURVEYED = 5.33  # σ that a height may be off at 1e-7
_LARGEST_M = 1e9  # that a message holds


class PositionOutput:
    """Computes the position of an epoch from velocities, wheel speeds and judgements; pure, times are given."""

    def __init__(self, rules: Rules) -> None:
        self._rules, self._levels = rules, rules.levels
        self._doppler = DopplerPosition(rules.levels.doppler)
        self._base: PositionCandidate | None = None
        self._latent_fault = LatentFaultHypothesis.initial(rules.levels.wrong_fix)
        self._matched = MatchCorroboration(rules.levels)
        self._dispute: PoseDispute | None = None
        self._agreement: PoseAgreement | None = None
        self._index = ReliabilityIndex(rules.levels.index)

    def add_velocity(self, velocity: SatelliteVelocity) -> None:
        """A velocity by satellite Doppler."""
        self._doppler.add_velocity(velocity)

    def add_wheel_speed(self, time_ns: int, speed_m_s: float | None) -> None:
        """A wheel speed; None does not overwrite a known one, its age does."""
        if speed_m_s is not None:
            self._doppler.add_wheel_speed(time_ns, speed_m_s)

    def update_dispute(self, judgement: FixJudgement) -> None:
        """Update the dispute by a judgement: a fix that the pose contradicts makes the pose doubtful too."""
        self._dispute = updated_dispute(judgement, self._dispute, self._rules.true_sigma, self._agreement)
        self._agreement = updated_agreement(judgement, self._agreement)

    def forget_future(self, now_ns: int) -> None:
        """Drop what is dated ahead: from a clock that is wrong, or from before ours was set back."""
        limit_ns = now_ns + round(self._rules.future_limit_s * 1e9)
        self._doppler.forget_future(limit_ns)
        self._index.forget_future(limit_ns)
        if self._base is not None and self._base.time_ns > limit_ns:
            self._base = None
        if self._latent_fault.time_ns is not None and self._latent_fault.time_ns > limit_ns:
            self._latent_fault = replace(self._latent_fault, time_ns=limit_ns)
            self._matched = MatchCorroboration(self._levels)
        if self._agreement is not None and self._agreement.time_ns > limit_ns:
            self._agreement = None
        if self._dispute is not None and self._dispute.time_ns > limit_ns:
            self._dispute = replace(self._dispute, begun_ns=limit_ns, time_ns=limit_ns)

    def confirmed(self, judgement: FixJudgement, correction_m: float, inputs: EpochInputs) -> Position:
        """The position of the epoch of a confirmed fix. Raises ValueError for any other: unknown is never trusted."""
        self._update_by_match(inputs)
        result = confirmed_fix(judgement, self._latent_fault, self._levels, self._rules.true_sigma)
        self._latent_fault = result.latent_fault
        if self._base is None or result.candidate.time_ns > self._base.time_ns:
            self._base = result.candidate
            self._doppler.begin(result.candidate.time_ns)
        pose, _ = self._of_pose(result.candidate.time_ns, inputs, correction_m)
        return self._best([result.candidate, pose], inputs)

    def at(self, time_ns: int, inputs: EpochInputs, correction_m: float) -> Position:
        """The position of an epoch without a confirmed fix: what there is of it, or why there is none."""
        self._update_by_match(inputs)
        pose, missing = self._of_pose(time_ns, inputs, correction_m)
        doppler = self._of_doppler(time_ns, pose)
        if doppler is None and missing is not None:
            return unavailable_position(time_ns, missing, self._rules)
        return self._best([doppler, pose], inputs)

    def _update_by_match(self, inputs: EpochInputs) -> None:
        """Update fault hypothesis and dispute by the scan match of this epoch."""
        if inputs.pose is not None:
            self._latent_fault = self._matched.update(inputs.pose, self._latent_fault)
            if self._dispute is not None:
                self._dispute = self._dispute.update(inputs.pose, self._levels)

    def _of_pose(
        self, time_ns: int, inputs: EpochInputs, correction_m: float
    ) -> tuple[PositionCandidate | None, Reason | None]:
        pose = inputs.pose
        missing = inputs.missing_pose(time_ns, self._rules)
        if pose is None or missing is not None:
            return None, missing
        if is_provisional(pose):
            return None, "pose_provisional"
        moved_ns = pose.motion_time_ns if pose.motion_time_ns is not None else pose.time_ns
        old = not abs(age_s(moved_ns, time_ns)) <= self._levels.time_to_alert_s
        if old or not abs(age_s(pose.time_ns, time_ns)) <= SAME_EPOCH_S:
            return None, "pose_stale"
        result = of_pose(inputs, correction_m, self._latent_fault, self._rules, dispute=self._dispute)
        return result, None

    def _of_doppler(self, time_ns: int, pose: PositionCandidate | None) -> PositionCandidate | None:
        """The position by Doppler where it can be checked and agrees; where it does not it ends.

        What has been summed up began with the base: each new one begins it anew.
        """
        moved = self._doppler.at(time_ns)
        if moved is None or self._base is None:
            return None
        result = of_doppler(self._base, moved, time_ns, self._levels)
        if pose is None:
            return result if moved.checked else None
        (latitude_rad, longitude_rad, height_m), there = result.geodetic, pose.geodetic[:2]
        east_m, north_m = east_north_between(*there, latitude_rad, longitude_rad, height_m=height_m or 0.0)
        if _distance2(east_m, north_m, pose.covariance_enu_m2, result.covariance_enu_m2) <= _CONTRADICTION:
            return result
        self._doppler.end()
        return None

    def _best(self, candidates: list[PositionCandidate | None], inputs: EpochInputs) -> Position:
        """The first of them, or a later one whose level is clearly smaller and whose height agrees.

        Where a reference is required each is bounded with the faults that all fixes share too. Without an independent
        position none of them can be: they are compared by the faults of single fixes, and have no horizontal level.
        """
        best, *others = self._with_faults([one for one in candidates if one is not None], inputs)
        bounds = self._bounds(best)
        for other in others:
            limit_m = self._levels.clearly_smaller * bounds.horizontal_level_m
            # One evaluation of the tail mostly shows that the level is larger: its bound is not needed.
            if self._levels.levels == "integrity_risk" and is_beyond(other.mixture, limit_m, self._levels):
                continue
            result = self._bounds(other)
            if result.horizontal_level_m < limit_m and self._height_agrees(best, bounds, other, result):
                best, bounds = other, result
        self._index.keep(best.time_ns, bounds)
        return self._position(best, bounds, inputs)

    def _with_faults(
        self, candidates: list[PositionCandidate], inputs: EpochInputs
    ) -> list[PositionCandidate]:
        if self._rules.horizontal_reference == "assumed":
            return candidates
        pose = self._reference(candidates[0].time_ns, inputs)
        bounded = [with_common_fault(one, pose, self._levels) for one in candidates]
        return [one or before for one, before in zip(bounded, candidates, strict=True)]

    def _reference(self, time_ns: int, inputs: EpochInputs) -> Pose | None:
        """The pose with an independent position that can be moved on to this time, None where there is none."""
        pose = inputs.pose
        if pose is None or pose.independent is None or inputs.missing_pose(time_ns, self._rules) is not None:
            return None
        return pose

    def _height_agrees(
        self, best: PositionCandidate, bounds: Bounds, other: PositionCandidate, result: Bounds
    ) -> bool:
        """Is the height of the other within the vertical level that was found, as far as both are known?

        Where a position is usable, the other has to be on a road as it was surveyed: one that has changed since shows
        as a height that a fix contradicts, and the fix knows it better.
        """
        here_m, there_m = best.geodetic[2], other.geodetic[2]
        if here_m is None or there_m is None:
            return True
        limit_m = result.vertical_level_m
        if self._is_small(bounds):
            limit_m = min(limit_m, _AS_SURVEYED * math.sqrt(other.covariance_enu_m2[5]))
        return abs(there_m - here_m) <= limit_m

    def _is_small(self, bounds: Bounds) -> bool:
        """Are both levels below their alert limits?"""
        return (
            bounds.horizontal_level_m < self._rules.alert_limit_m
            and bounds.vertical_level_m < self._levels.vertical_alert_limit_m
        )

    def _bounds(self, of: PositionCandidate) -> Bounds:
        (result,) = bounds_of([of.mixture], self._levels)
        if self._levels.levels == "integrity_risk":
            return result
        return self._index.bounds(of.source, of.time_ns, result, known=of.geodetic[2] is not None)

    def _position(self, result: PositionCandidate, bounds: Bounds, inputs: EpochInputs) -> Position:
        has_reference = (
            self._rules.horizontal_reference == "assumed"
            or self._reference(result.time_ns, inputs) is not None
        )
        reason = self._too_large(result, bounds, inputs) if has_reference else "no_independent_position"
        by_risk = self._levels.levels == "integrity_risk"
        return Position(
            time_ns=result.time_ns,
            source=result.source,
            usable=reason is None,
            reason=reason or "none",
            horizontal_reference=self._rules.horizontal_reference,
            latitude_rad=result.geodetic[0],
            longitude_rad=result.geodetic[1],
            height_m=result.geodetic[2],
            covariance_enu_m2=result.covariance_enu_m2,
            yaw_rad=result.yaw_rad,
            semi_major_99_m=_known(bounds.semi_major_99_m),
            semi_minor_99_m=_known(bounds.semi_minor_99_m),
            semi_major_999_m=_known(bounds.semi_major_999_m),
            semi_minor_999_m=_known(bounds.semi_minor_999_m),
            orientation_rad=bounds.orientation_rad,
            horizontal_protection_level_m=_known(bounds.horizontal_level_m) if has_reference else None,
            vertical_protection_level_m=_known(bounds.vertical_level_m),
            integrity_risk=self._levels.integrity_risk if by_risk else 1.0 - self._levels.index.probability,
            alert_limit_m=self._rules.alert_limit_m,
            vertical_alert_limit_m=self._levels.vertical_alert_limit_m,
            wrong_fix_probability=result.wrong,
            fix_id=result.fix_id if result.source == "rtk" else None,
        )

    def _too_large(self, result: PositionCandidate, bounds: Bounds, inputs: EpochInputs) -> Reason | None:
        """Why it is not usable."""
        if not bounds.horizontal_level_m < self._rules.alert_limit_m:
            return "position_unverified" if result.source == "rtk" else "pose_too_uncertain"
        if result.geodetic[2] is None:
            return (
                inputs.missing_road(result.time_ns, self._rules)
                or inputs.missing_antenna(result.time_ns, self._rules)
                or "road_unknown"
            )
        return None if bounds.vertical_level_m < self._levels.vertical_alert_limit_m else "height_unverified"


def unavailable_position(time_ns: int, reason: Reason, rules: Rules) -> Position:
    """The message that there is none."""
    return Position(
        time_ns=time_ns,
        source="none",
        usable=False,
        reason=reason,
        horizontal_reference=rules.horizontal_reference,
        alert_limit_m=rules.alert_limit_m,
        vertical_alert_limit_m=rules.levels.vertical_alert_limit_m,
    )


def _distance2(east_m: float, north_m: float, one: Covariance3, other: Covariance3) -> float:
    """Squared Mahalanobis distance of two positions, with a floor."""
    ee, en, nn = one[0] + other[0] + _FLOOR_M2, one[1] + other[1], one[3] + other[3] + _FLOOR_M2
    return (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / (ee * nn - en * en)


def _known(level_m: float) -> float | None:
    return level_m if level_m <= _LARGEST_M else None

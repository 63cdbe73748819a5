"""Settings of the judge."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, cast

from pydantic import Field, model_validator

from camber.integrity.checks.consistency_tests import Test
from camber.integrity.checks.verification import VerificationEvidence
from camber.integrity.learning.height_correction import Mode
from camber.integrity.rules import Rules
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Probability
from camber.schemas.integrity import HorizontalReference

P = TypeVar("P")
Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Length = Annotated[float, Field(gt=0.0, le=100_000.0)]
AtLeastOne = Annotated[float, Field(ge=1.0)]


def _sets(path: str, description: str, **limits: Any) -> Any:
    """A setting that is the parameter of this path in `Rules`, which has its default."""
    default = attrgetter(path)(Rules())
    return Field(default, description=description, json_schema_extra={"sets": path}, **limits)


class IntegritySettings(ServiceSettings):
    """The judge: determination, start, verification, learning, uploads."""

    SERVICE: ClassVar[str] = "integrity"

    horizontal_reference: HorizontalReference = _sets(
        "horizontal_reference",
        "usable only with a position that rests on no fix, or base station and signals are assumed to be honest",
    )
    tests: tuple[Test, ...] = _sets(
        "determination.tests",
        "tests of a fix; continuity and receiver alone are not allowed, since neither confirms a fix",
    )
    tolerance: Literal["from_covariances", "fixed"] = _sets(
        "determination.tolerance",
        "limit of the height difference: from the covariances, or tolerance_m, JP7707657B2 eq. (3)",
    )
    tolerance_m: float = _sets(
        "determination.tolerance_m",
        "largest height difference of a right position, where tolerance is fixed",
        gt=0.0,
        le=1.0,
    )
    height_cap_m: float = _sets(
        "determination.height_cap_m",
        "largest height difference that passes, however large its covariance",
        gt=0.0,
        le=1.0,
    )
    position_cap_m: Positive = _sets(
        "determination.position_cap_m",
        "largest limit of the position test; beyond it the test is not decisive",
    )
    fix_sigma_cap_m: Positive = _sets(
        "determination.fix_sigma_cap_m",
        "largest σ of the fix, each axis, in the limit of the position test",
    )
    false_alarm_rate: Share = _sets(
        "determination.false_alarm_rate",
        "share of right fixes that the height and position tests may reject, all tests together",
    )
    hold_back_rate: Share = _sets(
        "determination.hold_back_rate", "share of right fixes that these tests may leave unverified"
    )
    pose_sigma_limit_m: Positive = _sets(
        "pose_sigma_limit_m", "largest σ of a pose that selects a place on the road"
    )
    fix_sigma_limit_m: Positive = _sets(
        "fix_sigma_limit_m", "largest σ, in any direction, that the receiver may state for a fix"
    )
    alert_limit_m: Positive = _sets(
        "alert_limit_m", "horizontal alert limit: a position with a larger protection level is not usable"
    )
    vertical_alert_limit_m: Positive = _sets(
        "levels.vertical_alert_limit_m", "the same for the vertical axis"
    )
    levels: Literal["integrity_risk", "reliability_index"] = _sets(
        "levels.levels",
        "protection levels at an integrity risk that includes wrong fixes, or the reliability index",
    )
    integrity_risk: float = _sets(
        "levels.integrity_risk",
        "probability, per epoch, that the error exceeds the protection level",
        gt=0.0,
        lt=0.1,
    )
    wrong_fix_prior: Share = _sets(
        "levels.wrong_fix.prior",
        "share of fixes that are wrong before any test, with many satellites",
    )
    wrong_fix_episode_s: Positive = _sets(
        "levels.wrong_fix.episode_s", "mean length of an episode of wrong fixes"
    )
    pose_fault_prior: float = _sets(
        "levels.pose_fault_prior",
        "probability, per epoch, of an undetected fault of pose or Doppler beyond its covariance",
        ge=0.0,
        lt=1.0,
    )
    false_match_prior: Probability = _sets(
        "levels.false_match_prior",
        "probability that scan matching agrees with a pose that a wrong fix displaced by metres",
    )
    matches_apart_m: Positive = _sets(
        "levels.matches_apart_m", "distance beyond which faults of two matches are independent"
    )
    horizontal_margin: AtLeastOne = _sets(
        "levels.horizontal_margin", "factor on horizontal σ in error ellipses and protection levels"
    )
    time_to_alert_s: Positive = _sets(
        "levels.time_to_alert_s", "largest age of velocities and motion that a position may use"
    )
    doppler_sigma_scale: AtLeastOne = _sets(
        "levels.doppler.sigma_scale", "ratio of true to stated σ of a satellite velocity"
    )
    doppler_sigma_floor_m_s: NotNegative = _sets(
        "levels.doppler.sigma_floor_m_s", "σ added to that, each axis"
    )
    doppler_correlation_s: Positive = _sets(
        "levels.doppler.correlation_s", "correlation time of velocity errors"
    )
    doppler_longest_s: Positive = _sets(
        "levels.doppler.longest_s", "longest propagation by Doppler after a confirmed position"
    )
    sigma_scale: AtLeastOne = _sets(
        "true_sigma.scale",
        "ratio of true to stated σ of a right fix: multipath beyond the noise model of the receiver",
    )
    sigma_horizontal_m: Positive = _sets(
        "true_sigma.horizontal_m", "σ added to that, each horizontal axis: reference point and frame"
    )
    sigma_vertical_m: Positive = _sets("true_sigma.vertical_m", "the same for the vertical axis")
    start_fixes: int = _sets(
        "start.fixes", "consecutive fixes that must agree before the first is confirmed", ge=2
    )
    start_duration_s: NotNegative = _sets("start.duration_s", "time these fixes must span")
    start_gap_s: Positive = _sets("start.longest_gap_s", "longest time between two of these fixes")
    start_distance_m: Positive = _sets(
        "start.distance_m",
        "largest difference between the distance of two fixes and wheel odometry, plus 2 %",
    )
    learning: Mode = _sets(
        "learning.mode",
        "per_cause: learn the antenna's share of a height difference; document: all of it, JP7707657B2 eq. (5)",
    )
    learning_gain: Share = _sets("learning.gain", "g of JP7707657B2 eq. (5), where learning is document")
    learning_least_speed_m_s: NotNegative = _sets(
        "learning.least_speed_m_s", "lowest speed at which the correction is learnt"
    )
    learning_cap_m: Positive = _sets("learning.cap_m", "largest correction that is applied")
    learning_rate_m_s: Positive = _sets(
        "learning.rate_m_s", "largest rate of change of the correction, where learning is per_cause"
    )
    map_short_share: Probability = _sets(
        "learning.map_errors.short_share", "share of the short part in the variance of the map's height error"
    )
    map_short_m: Length = _sets(
        "learning.map_errors.short_m", "correlation length of the short part (first-order Gauss–Markov)"
    )
    map_long_m: Length = _sets(
        "learning.map_errors.long_m", "correlation length of the long part (second-order Gauss–Markov)"
    )
    map_common_offset_sigma_m: NotNegative = _sets(
        "learning.map_errors.common_offset_sigma_m",
        "σ of what all heights of a survey have in common, which is learnt with the correction",
    )
    captured_pose_least_odds: Positive = _sets(
        "capture.least_odds",
        "odds from which a run of fixes wins against a pose that others have anchored by their height alone",
    )
    series_gap_s: Positive = _sets("series.longest_gap_s", "longest time between two fixes of a time series")
    series_chain: int = _sets(
        "series.longest_chain", "largest number of fixes verified by time series since a confirmed one", ge=1
    )
    series_horizontal_m: Positive = _sets(
        "series.horizontal_m", "largest horizontal difference between the motion of fixes and of the vehicle"
    )
    series_vertical_m: Positive = _sets(
        "series.vertical_m", "largest difference between the height change of fixes and of the road"
    )
    verified_by: tuple[VerificationEvidence, ...] = _sets(
        "verification.enough",
        "evidence of which one kind suffices to confirm a fix that fails the height test",
    )
    verified_fix_sigma_m: Positive = _sets(
        "verification.fix_sigma_m",
        "largest true σ, in any direction, of a fix that is verified or verifies others",
    )
    continuity_fixes: int = _sets(
        "verification.continuity_fixes",
        "fixes confirmed by height before continuity of their integers verifies others",
        ge=1,
    )
    continuity_s: Positive = _sets("verification.continuity_s", "longest time since the last of these fixes")
    scan_sigma_m: Positive = _sets("verification.scan_sigma_m", "largest σ of a scan match that verifies")
    phase_ambiguities: int = _sets(
        "verification.phase_ambiguities",
        "resolved ambiguities from which consistent phase residuals verify",
        ge=4,
    )
    re_estimation: Literal["agreement", "one_by_one", "off"] = _sets(
        "re_estimation.method",
        "re-estimation of a wrong fix: by agreement of candidates, or one by one as in JP7707657B2",
    )
    most_trials: int = _sets(
        "re_estimation.most_trials", "largest number of candidates for one fix", ge=1, le=1000
    )
    re_estimate_unresolved: bool = _sets(
        "re_estimation.unresolved",
        "re-estimate epochs too whose ambiguities were not resolved with all satellites",
    )
    agreement_m: Positive = _sets(
        "re_estimation.agreement.distance_m",
        "largest distance between candidates that agree",
    )
    agreement_success: tuple[float, ...] = _sets(
        "re_estimation.agreement.success",
        "least success rate of the best of one, two, three… agreeing candidates",
        min_length=1,
    )
    agreement_ambiguities: int = _sets(
        "re_estimation.agreement.least_ambiguities",
        "least number of ambiguities fixed by the candidate on which others agree",
        ge=3,
    )
    link_delay_s: float = Field(
        0.0,
        ge=0.0,
        le=2.0,
        description="longest delay of inputs to a judge in the cloud; each epoch is judged later by it",
    )
    upload: bool = Field(True, description="send judged fixes to the fleet's server; needs state_dir")
    upload_every_s: float = Field(
        5.0, gt=0.0, le=600.0, description="GPS time covered by one batch of uploads"
    )
    outbox_limit_mb: float = Field(256.0, ge=1.0, description="largest disk space of waiting uploads")
    changed_road_prior: Probability = _sets(
        "levels.changed_road_prior", "probability that the road under a pose has changed since its survey"
    )
    changed_road_sigma_m: Positive = _sets(
        "levels.changed_road_sigma_m", "σ of the height change of such a road"
    )
    wrong_fix_prior_of_few: tuple[tuple[int, Share], ...] = _sets(
        "levels.wrong_fix.of_few",
        "least wrong_fix_prior with up to so many satellites; an unknown number counts as the fewest",
    )
    disputed_pose_prior: Probability = _sets(
        "levels.disputed_pose_prior", "probability that a pose contradicted by a fix at road height is wrong"
    )
    base_fault_prior: Probability = _sets(
        "levels.common_fault.base_prior",
        "probability, per epoch, that the base's coordinate puts all fixes off by one vector",
    )
    drift_fault_prior: Probability = _sets(
        "levels.common_fault.drift_prior", "the same, that signals or a filter lead all fixes away"
    )
    captured_pose_prior: Probability = _sets(
        "levels.common_fault.captured_prior",
        "the same, that wrong fixes hold the pose that they are checked by",
    )
    map_shift_prior: Probability = _sets(
        "levels.common_fault.map_shift_prior", "probability that the map is shifted where the vehicle is"
    )
    map_shift_sigma_m: Positive = _sets(
        "levels.common_fault.map_shift_sigma_m", "σ of that shift, each horizontal axis"
    )
    independent_fault_prior: Probability = _sets(
        "levels.common_fault.independent_prior",
        "probability, per epoch, that the independent position is off beyond its covariance, and no test shows it",
    )
    independent_fault_sigma_m: Positive = _sets(
        "levels.common_fault.independent_sigma_m", "σ of that error, each horizontal axis"
    )

    @model_validator(mode="after")
    def _can_be_judged_by(self) -> Self:
        self.rules()
        return self

    def rules(self) -> Rules:
        """The judge's parameters."""
        changes: dict[str, Any] = {}
        for name, info in type(self).model_fields.items():
            if isinstance(info.json_schema_extra, dict):
                *parents, last = str(info.json_schema_extra["sets"]).split(".")
                table = changes
                for parent in parents:
                    table = table.setdefault(parent, {})
                table[last] = getattr(self, name)
        changes["levels"]["doppler"]["longest_pause_s"] = self.time_to_alert_s
        return _changed(Rules(), changes)


def _changed(parameters: P, changes: dict[str, Any]) -> P:
    """A copy of nested parameter sets (dataclasses) with changes, which are nested in the same way."""
    values = {
        name: _changed(getattr(parameters, name), value) if isinstance(value, dict) else value
        for name, value in changes.items()
    }
    result: P = replace(cast(Any, parameters), **values)
    return result

"""Settings of the judge."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import Field, model_validator

from camber.integrity.checks.consistency import Test
from camber.integrity.checks.verification import VerificationEvidence
from camber.integrity.learning.height_correction import Mode
from camber.integrity.rules import Rules
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Probability

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound="DataclassInstance")
Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
AtLeastOne = Annotated[float, Field(ge=1.0)]


def _sets(path: str, description: str, **limits: Any) -> Any:
    """A setting that is the parameter of this path in `Rules`, which has its default."""
    default = attrgetter(path)(Rules())
    return Field(default, description=description, json_schema_extra={"sets": path}, **limits)


class IntegritySettings(ServiceSettings):
    """The judge: determination, start, verification, learning, uploads."""

    SERVICE: ClassVar[str] = "integrity"

    tests: tuple[Test, ...] = _sets(
        "determination.tests", "what a fix is asked; not continuity and receiver alone, which speak for none"
    )
    tolerance: Literal["from_covariances", "fixed"] = _sets(
        "determination.tolerance",
        "of the height: by the uncertainties at hand, or one number, JP7707657B2 eq. (3)",
    )
    tolerance_m: float = _sets(
        "determination.tolerance_m",
        "that number: largest height difference of a right position",
        gt=0.0,
        le=1.0,
    )
    height_cap_m: float = _sets(
        "determination.height_cap_m",
        "no larger height difference agrees, whatever the uncertainties are",
        gt=0.0,
        le=1.0,
    )
    position_cap_m: Positive = _sets(
        "determination.position_cap_m", "agreement with a pose says nothing where it reaches further"
    )
    fix_sigma_cap_m: Positive = _sets(
        "determination.fix_sigma_cap_m",
        "how much of a fix's own σ, each axis, may widen the agreement with the pose",
    )
    false_alarm_rate: Share = _sets(
        "determination.false_alarm_rate",
        "right fixes that height and position may contradict, all tests together",
    )
    hold_back_rate: Share = _sets(
        "determination.hold_back_rate", "right fixes that they may leave unverified"
    )
    pose_sigma_limit_m: Positive = _sets(
        "pose_sigma_limit_m", "beyond this σ the pose names no place on the road"
    )
    fix_sigma_limit_m: Positive = _sets(
        "fix_sigma_limit_m", "a fix that claims a larger σ in any direction is none"
    )
    alert_limit_m: Positive = _sets(
        "alert_limit_m", "a position whose horizontal protection level is larger is not usable"
    )
    vertical_alert_limit_m: Positive = _sets("levels.vertical_alert_limit_m", "the same upwards")
    levels: Literal["integrity_risk", "reliability_index"] = _sets(
        "levels.levels", "protection levels at a risk, wrong fixes included, or the reliability index"
    )
    integrity_risk: float = _sets(
        "levels.integrity_risk", "probability, each epoch, that the error exceeds a level", gt=0.0, lt=0.1
    )
    wrong_fix_prior: Share = _sets(
        "levels.wrong_fix.prior",
        "share of tentative fixes that are wrong, before any test, with many satellites",
    )
    wrong_fix_episode_s: Positive = _sets(
        "levels.wrong_fix.episode_s", "mean length of an episode of wrong fixes"
    )
    pose_fault_prior: float = _sets(
        "levels.pose_fault_prior",
        "pose or Doppler off unnoticed beyond its covariance, each epoch",
        ge=0.0,
        lt=1.0,
    )
    false_match_prior: Probability = _sets(
        "levels.false_match_prior", "scan matching agrees with a pose that a wrong fix pulled metres off"
    )
    matches_apart_m: Positive = _sets(
        "levels.matches_apart_m", "so far apart two matches are not wrong for the same reason"
    )
    horizontal_margin: AtLeastOne = _sets(
        "levels.horizontal_margin", "scales horizontal σ in ellipses and levels"
    )
    time_to_alert_s: Positive = _sets(
        "levels.time_to_alert_s", "no position rests on velocities or motion older than this"
    )
    doppler_sigma_scale: AtLeastOne = _sets(
        "levels.doppler.sigma_scale", "true σ of a satellite velocity by the claimed"
    )
    doppler_sigma_floor_m_s: NotNegative = _sets("levels.doppler.sigma_floor_m_s", "and beside it, each axis")
    doppler_correlation_s: Positive = _sets(
        "levels.doppler.correlation_s", "so long errors of velocities are alike"
    )
    doppler_longest_s: Positive = _sets(
        "levels.doppler.longest_s", "longest time by Doppler after a confirmed position"
    )
    sigma_scale: AtLeastOne = _sets(
        "true_sigma.scale", "true σ of a right fix by the claimed: multipath by a receiver's noise model"
    )
    sigma_horizontal_m: Positive = _sets(
        "true_sigma.horizontal_m", "and beside it, each axis: reference point and frame"
    )
    sigma_vertical_m: Positive = _sets("true_sigma.vertical_m", "the same upwards")
    start_fixes: int = _sets(
        "start.fixes", "fixes in a row that must agree before the first is confirmed", ge=2
    )
    start_duration_s: NotNegative = _sets("start.duration_s", "and the time they must span")
    start_gap_s: Positive = _sets("start.longest_gap_s", "longest time between two of them")
    start_distance_m: Positive = _sets(
        "start.distance_m", "most by which the distance between two may differ from the wheels', and 2 %"
    )
    learning: Mode = _sets(
        "learning.mode",
        "what is learnt: the antenna's part of a difference, or by JP7707657B2 eq. (5) all of it",
    )
    learning_gain: Share = _sets("learning.gain", "g of JP7707657B2 eq. (5), where learning is document")
    learning_least_speed_m_s: NotNegative = _sets(
        "learning.least_speed_m_s", "upper edge of the stop range: slower learns nothing"
    )
    learning_cap_m: Positive = _sets("learning.cap_m", "largest correction that is believed")
    learning_rate_m_s: Positive = _sets(
        "learning.rate_m_s", "most by which the correction changes in a second, where it is per_cause"
    )
    map_correlation_m: Positive = _sets(
        "learning.correlation_m",
        "distance over which the map's error falls to 1/e: so far its errors are alike",
    )
    series_gap_s: Positive = _sets("series.longest_gap_s", "longest time a right fix vouches for the next")
    series_chain: int = _sets(
        "series.longest_chain", "longest chain of verified fixes without a confirmed one", ge=1
    )
    series_horizontal_m: Positive = _sets(
        "series.horizontal_m", "most by which a fix may have moved otherwise than the vehicle"
    )
    series_vertical_m: Positive = _sets(
        "series.vertical_m", "most by which it may have risen otherwise than the road"
    )
    verified_by: tuple[VerificationEvidence, ...] = _sets(
        "verification.enough", "what suffices to confirm a fix that the height is against"
    )
    verified_fix_sigma_m: Positive = _sets(
        "verification.fix_sigma_m",
        "largest true σ, in any direction, of a fix that is verified or vouches for others",
    )
    continuity_fixes: int = _sets(
        "verification.continuity_fixes",
        "fixes the height must have confirmed before their integers carry others",
        ge=1,
    )
    continuity_s: Positive = _sets(
        "verification.continuity_s", "longest time that they carry since the last of them"
    )
    scan_sigma_m: Positive = _sets("verification.scan_sigma_m", "largest σ of a scan match that verifies")
    phase_ambiguities: int = _sets(
        "verification.phase_ambiguities",
        "resolved ambiguities from which consistent phase residuals verify",
        ge=4,
    )
    re_estimation: Literal["agreement", "one_by_one", "off"] = _sets(
        "re_estimation.method",
        "other estimates of a wrong fix: what they agree on, or one after the other as in the document",
    )
    most_trials: int = _sets("re_estimation.most_trials", "other estimates of one fix at most", ge=1, le=1000)
    re_estimate_unresolved: bool = _sets(
        "re_estimation.unresolved", "of epochs too whose integers could not be resolved with all satellites"
    )
    agreement_m: Positive = _sets(
        "re_estimation.agreement.distance_m",
        "estimates that agree are not further than this from one another",
    )
    agreement_success: tuple[float, ...] = _sets(
        "re_estimation.agreement.success",
        "success rate that the surest of one, two, three… agreeing estimates must have",
        min_length=1,
    )
    agreement_ambiguities: int = _sets(
        "re_estimation.agreement.least_ambiguities",
        "ambiguities that the estimate must have fixed on which others agree",
        ge=3,
    )
    link_delay_s: float = Field(
        0.0,
        ge=0.0,
        le=2.0,
        description="longest time that inputs take to a judge in the cloud; it judges so much later",
    )
    upload: bool = Field(True, description="send judged fixes to the fleet's server; needs state_dir")
    upload_every_s: float = Field(
        5.0, gt=0.0, le=600.0, description="one batch of uploads for each such stretch of GPS time"
    )
    outbox_limit_mb: float = Field(256.0, ge=1.0, description="disk the waiting uploads may take")
    changed_road_prior: Probability = _sets(
        "levels.changed_road_prior", "the road under a pose has changed since its survey"
    )
    changed_road_sigma_m: Positive = _sets("levels.changed_road_sigma_m", "σ by which its height is then off")
    wrong_fix_prior_of_few: tuple[tuple[int, Share], ...] = _sets(
        "levels.wrong_fix.of_few",
        "at least that, with up to so many satellites; not known how many: with the fewest",
    )
    disputed_pose_prior: Probability = _sets(
        "levels.disputed_pose_prior", "a pose that a fix with the road's height contradicts is wrong"
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
    """A copy of nested parameter sets with changes, which are nested as they are."""
    return replace(
        parameters,
        **{
            name: _changed(getattr(parameters, name), value) if isinstance(value, dict) else value
            for name, value in changes.items()
        },
    )

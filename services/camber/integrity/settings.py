"""Settings of the judge."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from camber.integrity.checks.consistency import ALL_TESTS, ConsistencyParameters, Test
from camber.integrity.checks.start_rule import StartRules
from camber.integrity.checks.time_series import SeriesRules
from camber.integrity.checks.verification import VerificationEvidence, VerificationRules
from camber.integrity.learning.height_correction import LearningRules, Mode
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.protection.doppler_position import DopplerRules
from camber.integrity.protection.position_bounds import LevelRules
from camber.integrity.protection.wrong_fix_probability import WrongFixRules
from camber.integrity.re_estimation.requests import ReEstimationRules
from camber.integrity.re_estimation.subset_agreement import AgreementRules
from camber.integrity.rules import Rules
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME

Share = Annotated[float, Field(gt=0.0, lt=1.0)]


class IntegritySettings(ServiceSettings):
    """The judge: determination, start, verification, learning, uploads."""

    SERVICE: ClassVar[str] = "integrity"

    tests: tuple[Test, ...] = Field(
        ALL_TESTS, description="what a fix is asked; not continuity and receiver alone, which speak for none"
    )
    tolerance: Literal["from_covariances", "fixed"] = Field(
        "from_covariances",
        description="of the height: by the uncertainties at hand, or one number, JP7707657B2 eq. (3)",
    )
    tolerance_m: float = Field(
        0.2, gt=0.0, le=1.0, description="that number: largest height difference of a right position"
    )
    height_cap_m: float = Field(
        0.3, gt=0.0, le=1.0, description="no larger height difference agrees, whatever the uncertainties are"
    )
    position_cap_m: float = Field(
        1.0, gt=0.0, description="agreement with a pose says nothing where it reaches further"
    )
    fix_sigma_cap_m: float = Field(
        0.06,
        gt=0.0,
        description="how much of a fix's own σ, each axis, may widen the agreement with the pose",
    )
    false_alarm_rate: float = Field(
        1e-6,
        gt=0.0,
        lt=1.0,
        description="right fixes that height and position may contradict, all tests together",
    )
    hold_back_rate: float = Field(
        1e-3, gt=0.0, lt=1.0, description="right fixes that they may leave unverified"
    )
    pose_sigma_limit_m: float = Field(
        15.0, gt=0.0, description="beyond this σ the pose names no place on the road"
    )
    fix_sigma_limit_m: float = Field(
        0.5, gt=0.0, description="a fix that claims a larger σ in any direction is none"
    )
    alert_limit_m: float = Field(
        1.5, gt=0.0, description="a position whose horizontal protection level is larger is not usable"
    )
    vertical_alert_limit_m: float = Field(2.0, gt=0.0, description="the same upwards")
    levels: Literal["integrity_risk", "reliability_index"] = Field(
        "integrity_risk",
        description="protection levels at a risk, wrong fixes included, or the reliability index",
    )
    integrity_risk: float = Field(
        1e-7, gt=0.0, lt=0.1, description="probability, each epoch, that the error exceeds a level"
    )
    wrong_fix_prior: float = Field(
        0.1,
        gt=0.0,
        lt=1.0,
        description="share of tentative fixes that are wrong, before any test, with many satellites",
    )
    wrong_fix_episode_s: float = Field(10.0, gt=0.0, description="mean length of an episode of wrong fixes")
    pose_fault_prior: float = Field(
        1e-8, ge=0.0, lt=1.0, description="pose or Doppler off unnoticed beyond its covariance, each epoch"
    )
    false_match_prior: float = Field(
        1e-3,
        ge=0.0,
        le=1.0,
        description="scan matching agrees with a pose that a wrong fix pulled metres off",
    )
    matches_apart_m: float = Field(
        20.0, gt=0.0, description="so far apart two matches are not wrong for the same reason"
    )
    horizontal_margin: float = Field(1.03, ge=1.0, description="scales horizontal σ in ellipses and levels")
    time_to_alert_s: float = Field(
        0.3, gt=0.0, description="no position rests on velocities or motion older than this"
    )
    doppler_sigma_scale: float = Field(
        1.5, ge=1.0, description="true σ of a satellite velocity by the claimed"
    )
    doppler_sigma_floor_m_s: float = Field(0.02, ge=0.0, description="and beside it, each axis")
    doppler_correlation_s: float = Field(1.0, gt=0.0, description="so long errors of velocities are alike")
    doppler_longest_s: float = Field(
        30.0, gt=0.0, description="longest time by Doppler after a confirmed position"
    )
    sigma_scale: float = Field(
        4.0, ge=1.0, description="true σ of a right fix by the claimed: multipath by a receiver's noise model"
    )
    sigma_horizontal_m: float = Field(
        0.05, gt=0.0, description="and beside it, each axis: reference point and frame"
    )
    sigma_vertical_m: float = Field(0.05, gt=0.0, description="the same upwards")
    start_fixes: int = Field(
        5, ge=2, description="fixes in a row that must agree before the first is confirmed"
    )
    start_duration_s: float = Field(0.8, ge=0.0, description="and the time they must span")
    start_gap_s: float = Field(1.0, gt=0.0, description="longest time between two of them")
    start_distance_m: float = Field(
        0.3, gt=0.0, description="most by which the distance between two may differ from the wheels', and 2 %"
    )
    learning: Mode = Field(
        "per_cause",
        description="what is learnt: the antenna's part of a difference, or by JP7707657B2 eq. (5) all of it",
    )
    learning_gain: float = Field(
        0.01, gt=0.0, lt=1.0, description="g of JP7707657B2 eq. (5), where learning is document"
    )
    learning_least_speed_m_s: float = Field(
        3.0, ge=0.0, description="upper edge of the stop range: slower learns nothing"
    )
    learning_cap_m: float = Field(0.3, gt=0.0, description="largest correction that is believed")
    learning_rate_m_s: float = Field(
        0.003, gt=0.0, description="most by which the correction changes in a second, where it is per_cause"
    )
    map_correlation_m: float = Field(
        20.0,
        gt=0.0,
        description="distance over which the map's error falls to 1/e: so far its errors are alike",
    )
    series_gap_s: float = Field(1.0, gt=0.0, description="longest time a right fix vouches for the next")
    series_chain: int = Field(25, ge=1, description="longest chain of verified fixes without a confirmed one")
    series_horizontal_m: float = Field(
        0.15, gt=0.0, description="most by which a fix may have moved otherwise than the vehicle"
    )
    series_vertical_m: float = Field(
        0.12, gt=0.0, description="most by which it may have risen otherwise than the road"
    )
    verified_by: tuple[VerificationEvidence, ...] = Field(
        VerificationRules().enough, description="what suffices to confirm a fix that the height is against"
    )
    verified_fix_sigma_m: float = Field(
        0.15,
        gt=0.0,
        description="largest true σ, in any direction, of a fix that is verified or vouches for others",
    )
    continuity_fixes: int = Field(
        5, ge=1, description="fixes the height must have confirmed before their integers carry others"
    )
    continuity_s: float = Field(
        30.0, gt=0.0, description="longest time that they carry since the last of them"
    )
    scan_sigma_m: float = Field(0.15, gt=0.0, description="largest σ of a scan match that verifies")
    phase_ambiguities: int = Field(
        10, ge=4, description="resolved ambiguities from which consistent phase residuals verify"
    )
    re_estimation: Literal["agreement", "one_by_one", "off"] = Field(
        "agreement",
        description="other estimates of a wrong fix: what they agree on, or one after the other as in the document",
    )
    most_trials: int = Field(20, ge=1, le=1000, description="other estimates of one fix at most")
    re_estimate_unresolved: bool = Field(
        True, description="of epochs too whose integers could not be resolved with all satellites"
    )
    agreement_m: float = Field(
        0.1, gt=0.0, description="estimates that agree are not further than this from one another"
    )
    agreement_success: tuple[float, ...] = Field(
        AgreementRules().success,
        min_length=1,
        description="success rate that the surest of one, two, three… agreeing estimates must have",
    )
    agreement_ambiguities: int = Field(
        6, ge=3, description="ambiguities that the estimate must have fixed on which others agree"
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
    changed_road_prior: float = Field(
        0.01, ge=0.0, le=1.0, description="the road under a pose has changed since its survey"
    )
    changed_road_sigma_m: float = Field(0.2, gt=0.0, description="σ by which its height is then off")
    wrong_fix_prior_of_few: tuple[tuple[int, Share], ...] = Field(
        WrongFixRules().of_few,
        description="at least that, with up to so many satellites; not known how many: with the fewest",
    )
    disputed_pose_prior: float = Field(
        1e-3, ge=0.0, le=1.0, description="a pose that a fix with the road's height contradicts is wrong"
    )

    @model_validator(mode="after")
    def _can_be_judged_by(self) -> Self:
        self._determination()
        return self

    def _determination(self) -> ConsistencyParameters:
        return ConsistencyParameters(
            tests=self.tests,
            tolerance=self.tolerance,
            tolerance_m=self.tolerance_m,
            height_cap_m=self.height_cap_m,
            position_cap_m=self.position_cap_m,
            false_alarm_rate=self.false_alarm_rate,
            hold_back_rate=self.hold_back_rate,
            fix_sigma_cap_m=self.fix_sigma_cap_m,
        )

    def rules(self) -> Rules:
        """The judge's rules; ages come from the table of channels."""

        def age(name: str) -> float:
            limit = BY_NAME[name].max_age_s
            assert limit is not None
            return limit

        return Rules(
            determination=self._determination(),
            pose_sigma_limit_m=self.pose_sigma_limit_m,
            fix_sigma_limit_m=self.fix_sigma_limit_m,
            pose_max_age_s=age("pose"),
            antenna_max_age_s=age("antenna_height"),
            fix_max_age_s=age("fix"),
            motion_max_age_s=age("motion"),
            receiver_max_age_s=age("receiver_integrity"),
            alert_limit_m=self.alert_limit_m,
            true_sigma=TrueSigma(
                scale=self.sigma_scale, horizontal_m=self.sigma_horizontal_m, vertical_m=self.sigma_vertical_m
            ),
            learning=LearningRules(
                gain=self.learning_gain,
                least_speed_m_s=self.learning_least_speed_m_s,
                cap_m=self.learning_cap_m,
                mode=self.learning,
                rate_m_s=self.learning_rate_m_s,
                correlation_m=self.map_correlation_m,
            ),
            start=StartRules(
                fixes=self.start_fixes,
                duration_s=self.start_duration_s,
                longest_gap_s=self.start_gap_s,
                distance_m=self.start_distance_m,
            ),
            series=SeriesRules(
                longest_gap_s=self.series_gap_s,
                longest_chain=self.series_chain,
                horizontal_m=self.series_horizontal_m,
                vertical_m=self.series_vertical_m,
            ),
            verification=VerificationRules(
                enough=self.verified_by,
                fix_sigma_m=self.verified_fix_sigma_m,
                continuity_fixes=self.continuity_fixes,
                continuity_s=self.continuity_s,
                scan_sigma_m=self.scan_sigma_m,
                phase_ambiguities=self.phase_ambiguities,
            ),
            re_estimation=ReEstimationRules(
                method=self.re_estimation,
                most_trials=self.most_trials,
                unresolved=self.re_estimate_unresolved,
                agreement=AgreementRules(
                    distance_m=self.agreement_m,
                    success=self.agreement_success,
                    least_ambiguities=self.agreement_ambiguities,
                ),
            ),
        )

    def level_rules(self) -> LevelRules:
        """By what positions are bounded."""
        return LevelRules(
            levels=self.levels,
            integrity_risk=self.integrity_risk,
            vertical_alert_limit_m=self.vertical_alert_limit_m,
            pose_fault_prior=self.pose_fault_prior,
            false_match_prior=self.false_match_prior,
            matches_apart_m=self.matches_apart_m,
            changed_road_prior=self.changed_road_prior,
            changed_road_sigma_m=self.changed_road_sigma_m,
            disputed_pose_prior=self.disputed_pose_prior,
            horizontal_margin=self.horizontal_margin,
            time_to_alert_s=self.time_to_alert_s,
            wrong_fix=WrongFixRules(
                prior=self.wrong_fix_prior,
                episode_s=self.wrong_fix_episode_s,
                of_few=self.wrong_fix_prior_of_few,
            ),
            doppler=DopplerRules(
                sigma_scale=self.doppler_sigma_scale,
                sigma_floor_m_s=self.doppler_sigma_floor_m_s,
                correlation_s=self.doppler_correlation_s,
                longest_s=self.doppler_longest_s,
                longest_pause_s=self.time_to_alert_s,
            ),
        )

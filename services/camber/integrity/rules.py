"""All parameters of the judge and of the positions it publishes; `settings.py` sets them."""

from __future__ import annotations

from dataclasses import dataclass, field

from camber.integrity.checks.captured_pose import CaptureRules
from camber.integrity.checks.carried_position import CarriedRules
from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.checks.start_rule import StartRules
from camber.integrity.checks.time_series import SeriesRules
from camber.integrity.checks.verification import VerificationRules
from camber.integrity.learning.height_correction import LearningRules
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.protection.position_bounds import LevelRules
from camber.integrity.re_estimation.requests import ReEstimationRules
from camber.schemas.channels import BY_NAME
from camber.schemas.integrity import HorizontalReference


def _max_age_s(channel: str) -> float:
    limit_s = BY_NAME[channel].max_age_s
    assert limit_s is not None
    return limit_s


SAME_EPOCH_S = 0.02
"""A fix and a pose not further apart than this are of one epoch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """Limits of the determination and of what it rests on.

    The largest ages are those of the table of channels; what is dated further ahead than `future_limit_s` comes from a
    clock that is wrong.

    `horizontal_reference`: *required*: only an independent position is evidence of the position, and without one no
    position is usable. *assumed*: base station and signals are honest, so a pose that fixes anchor is evidence too.
    """

    horizontal_reference: HorizontalReference = "required"
    determination: ConsistencyParameters = field(default_factory=ConsistencyParameters)
    pose_sigma_limit_m: float = 15.0
    fix_sigma_limit_m: float = 0.5
    pose_max_age_s: float = _max_age_s("pose")
    antenna_max_age_s: float = _max_age_s("antenna_height")
    fix_max_age_s: float = _max_age_s("fix")
    motion_max_age_s: float = _max_age_s("motion")
    receiver_max_age_s: float = _max_age_s("receiver_integrity")
    future_limit_s: float = 0.5
    alert_limit_m: float = 1.5
    true_sigma: TrueSigma = field(default_factory=TrueSigma)
    learning: LearningRules = field(default_factory=LearningRules)
    capture: CaptureRules = field(default_factory=CaptureRules)
    carried: CarriedRules = field(default_factory=CarriedRules)
    start: StartRules = field(default_factory=StartRules)
    series: SeriesRules = field(default_factory=SeriesRules)
    verification: VerificationRules = field(default_factory=VerificationRules)
    re_estimation: ReEstimationRules = field(default_factory=ReEstimationRules)
    levels: LevelRules = field(default_factory=LevelRules)

"""By what the judge judges: all limits in one place, as the settings give them."""

from __future__ import annotations

from dataclasses import dataclass, field

from camber.integrity.learning import LearningRules
from camber.integrity.start import StartRules
from camber.integrity.time_series import SeriesRules
from camber.integrity.true_sigma import TrueSigma

SAME_EPOCH_S = 0.02
"""A fix and a pose not further apart than this are of one epoch."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits of the determination and of what it rests on.

    `tolerance_m` is that of H (2), (3). `gate` is the squared Mahalanobis distance beyond which a fix contradicts the
    pose: 18.42 is χ²(2) at 1e-4. The largest ages are those of the table of channels; what is dated further ahead than
    `future_limit_s` comes from a clock that is wrong.
    """

    tolerance_m: float = 0.2
    gate: float = 18.42
    pose_sigma_floor_m: float = 0.10
    pose_sigma_limit_m: float = 15.0
    fix_sigma_limit_m: float = 0.5
    pose_max_age_s: float = 0.3
    antenna_max_age_s: float = 2.0
    fix_max_age_s: float = 0.5
    motion_max_age_s: float = 0.5
    future_limit_s: float = 0.5
    alert_limit_m: float = 1.5
    true_sigma: TrueSigma = field(default_factory=TrueSigma)
    learning: LearningRules = field(default_factory=LearningRules)
    start: StartRules = field(default_factory=StartRules)
    series: SeriesRules = field(default_factory=SeriesRules)

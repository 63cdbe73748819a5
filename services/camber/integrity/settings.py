"""Settings of the judge."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from camber.integrity.learning import LearningRules
from camber.integrity.rules import Rules
from camber.integrity.start import StartRules
from camber.integrity.time_series import SeriesRules
from camber.integrity.true_sigma import TrueSigma
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME


class IntegritySettings(ServiceSettings):
    """The judge: tolerance, gate, start, verification, learning, uploads."""

    SERVICE: ClassVar[str] = "integrity"

    tolerance_m: float = Field(
        0.2, gt=0.0, le=1.0, description="largest height difference of a right position, H (3)"
    )
    gate: float = Field(
        18.42,
        gt=0.0,
        description="largest squared Mahalanobis distance of a fix from the pose; χ²(2) at 1e-4",
    )
    pose_sigma_floor_m: float = Field(
        0.10, ge=0.0, description="added to the σ of pose and fix in the gate, each axis"
    )
    pose_sigma_limit_m: float = Field(
        15.0, gt=0.0, description="beyond this σ the pose names no place on the road"
    )
    fix_sigma_limit_m: float = Field(
        0.5, gt=0.0, description="a fix that claims a larger σ in any direction is none"
    )
    alert_limit_m: float = Field(
        1.5, gt=0.0, description="a position whose 99.9 % radius is larger is not usable"
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
    learning_gain: float = Field(0.01, gt=0.0, lt=1.0, description="g of H (5)")
    learning_least_speed_m_s: float = Field(
        3.0, ge=0.0, description="upper edge of the stop range: slower learns nothing"
    )
    learning_cap_m: float = Field(0.3, gt=0.0, description="largest correction that is believed")
    series_gap_s: float = Field(1.0, gt=0.0, description="longest time a right fix vouches for the next")
    series_chain: int = Field(25, ge=1, description="longest chain of verified fixes without a confirmed one")
    series_horizontal_m: float = Field(
        0.15, gt=0.0, description="most by which a fix may have moved otherwise than the vehicle"
    )
    series_vertical_m: float = Field(
        0.12, gt=0.0, description="most by which it may have risen otherwise than the road"
    )
    upload: bool = Field(True, description="send judged fixes to the fleet's server; needs state_dir")
    upload_every_s: float = Field(
        5.0, gt=0.0, le=600.0, description="one batch of uploads for each such stretch of GPS time"
    )
    outbox_limit_mb: float = Field(256.0, ge=1.0, description="disk the waiting uploads may take")

    def rules(self) -> Rules:
        """The judge's rules; ages come from the table of channels."""

        def age(name: str) -> float:
            limit = BY_NAME[name].max_age_s
            assert limit is not None
            return limit

        return Rules(
            tolerance_m=self.tolerance_m,
            gate=self.gate,
            pose_sigma_floor_m=self.pose_sigma_floor_m,
            pose_sigma_limit_m=self.pose_sigma_limit_m,
            fix_sigma_limit_m=self.fix_sigma_limit_m,
            pose_max_age_s=age("pose"),
            antenna_max_age_s=age("antenna_height"),
            fix_max_age_s=age("fix"),
            motion_max_age_s=age("motion"),
            alert_limit_m=self.alert_limit_m,
            true_sigma=TrueSigma(self.sigma_scale, self.sigma_horizontal_m, self.sigma_vertical_m),
            learning=LearningRules(self.learning_gain, self.learning_least_speed_m_s, self.learning_cap_m),
            start=StartRules(
                self.start_fixes, self.start_duration_s, self.start_gap_s, self.start_distance_m
            ),
            series=SeriesRules(
                self.series_gap_s, self.series_chain, self.series_horizontal_m, self.series_vertical_m
            ),
        )

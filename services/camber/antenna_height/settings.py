"""Settings of antenna_height."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from camber.antenna_height.available_heights import VehicleGeometry
from camber.antenna_height.body_attitude import Arm, TiltRules
from camber.antenna_height.change_detection import ChangeRules
from camber.antenna_height.estimator import AntennaOptions
from camber.antenna_height.method_comparison import ComparisonRules
from camber.antenna_height.method_selection import FlatRules
from camber.antenna_height.suspension_and_ranging_heights import FixedHeight, RangingGeometry, StrokeGeometry
from camber.runtime.settings import ServiceSettings
from camber.schemas.antenna import HeightMethod


class BodyPoint(BaseModel):
    """A point of the vehicle at rest; no coordinate has a default, all must be measured."""

    model_config = ConfigDict(extra="forbid")
    x_m: float = Field(ge=-50.0, le=50.0, description="forward of the rear axle's middle")
    y_m: float = Field(ge=-50.0, le=50.0, description="left of it")
    z_m: float = Field(ge=-10.0, le=100.0, description="above the road")


class AntennaHeightSettings(ServiceSettings):
    """How the antenna's height above the road is known."""

    SERVICE: ClassVar[str] = "antenna_height"

    way: HeightMethod | Literal["automatic"] = Field(
        "fixed", description="method whose height is published; all that the vehicle has are compared"
    )
    fixed_height_m: float | None = Field(
        None, ge=-1.0, le=100.0, description="measured antenna height above the road; None: not measured"
    )
    fixed_sigma_m: float = Field(
        0.01, ge=0.0, le=1.0, description="its σ, with the motion by springs and loads"
    )
    suspension_to_antenna_m: float | None = Field(
        None, ge=-10.0, le=10.0, description="h_ba of JP7707657B2 eq. (1), for way stroke; None: not measured"
    )
    tyre_radius_m: float | None = Field(
        None, gt=0.0, le=5.0, description="h_t of JP7707657B2 eq. (1), for way stroke; None: not measured"
    )
    antenna: BodyPoint | None = Field(None, description="table x_m, y_m, z_m: the antenna's reference point")
    suspension: BodyPoint | None = Field(
        None, description="table: top of the suspension that is measured; None: near the antenna"
    )
    ranging: BodyPoint | None = Field(
        None, description="table: origin of the ranging sensor; None: absent, the LiDAR replaces it"
    )
    lidar: BodyPoint | None = Field(None, description="table: origin of the LiDAR")
    beam_azimuth_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="azimuth of the ranging beam, counter-clockwise from forward"
    )
    beam_sigma_deg: float = Field(
        0.15, ge=0.0, le=10.0, description="σ of the beam's angle below the vehicle's horizontal"
    )
    stored_sigma_m: float = Field(
        0.01, ge=0.0, le=1.0, description="σ of the vehicle's measured dimensions, by method: h_ba, h_t, h_sa"
    )
    plausible_m: float = Field(
        0.5, gt=0.0, le=10.0, description="a height that differs more from antenna.z_m is implausible"
    )
    body_pitch_sigma_deg: float = Field(
        0.4, ge=0.0, le=45.0, description="σ of the body's pitch against the road: braking, load"
    )
    body_roll_sigma_deg: float = Field(
        0.6, ge=0.0, le=45.0, description="σ of its roll against the road: curves, load"
    )
    attitude_sigma_deg: float = Field(
        0.25, gt=0.0, le=45.0, description="σ of pitch and roll in motion, constant errors included"
    )
    matched_attitude_sigma_deg: float = Field(
        0.15, gt=0.0, le=45.0, description="σ of pitch and roll of a scan match"
    )
    slope_sigma: float = Field(
        0.004,
        ge=0.0,
        le=1.0,
        description="σ of the road's slope below the vehicle against the map's, a ratio",
    )
    pose_sigma_limit_m: float = Field(
        3.0, gt=0.0, le=1000.0, description="beyond this σ of the pose the road's slope is not used"
    )
    flat_slope_leave: float = Field(
        0.05, gt=0.0, le=2.0, description="automatic: a steeper road is not flat, a ratio"
    )
    flat_slope_return: float = Field(
        0.04, gt=0.0, le=2.0, description="automatic: flat again below this slope"
    )
    flat_uneven_leave_m: float = Field(
        0.03, gt=0.0, le=2.0, description="automatic: a road farther off its plane below the beam is not flat"
    )
    flat_uneven_return_m: float = Field(0.02, gt=0.0, le=2.0, description="automatic: flat again below this")
    flat_dwell_s: float = Field(
        2.0, ge=0.0, le=600.0, description="automatic: least time between two changes of flat and not flat"
    )
    disagree_sigmas: float = Field(
        4.0, gt=0.0, le=20.0, description="two methods disagree beyond so many σ of their difference"
    )
    disagree_after_s: float = Field(
        1.0, ge=0.0, le=60.0, description="and for so long, or at once beyond twice that"
    )
    disagree_kept_s: float = Field(
        60.0, ge=0.0, le=3600.0, description="how long a disagreement lasts that cannot be tested any more"
    )
    change_least_m: float = Field(
        0.006, gt=0.0, le=1.0, description="smallest change of the difference of two methods"
    )
    change_sigmas: float = Field(4.0, gt=0.0, le=20.0, description="a change exceeds so many of its own σ")
    publish_period_s: float = Field(0.2, gt=0.0, le=1.0, description="period of publication")

    @model_validator(mode="after")
    def _is_measured(self) -> Self:
        if self.way == "stroke" and (self.suspension_to_antenna_m is None or self.tyre_radius_m is None):
            raise ValueError("way stroke needs suspension_to_antenna_m and tyre_radius_m")
        sensors = {"scan_matching": ("lidar",)}.get(self.way, ("ranging", "lidar"))
        if self.way not in ("fixed", "stroke"):
            has_sensor = any(getattr(self, name) is not None for name in sensors)
            if self.antenna is None or not has_sensor:
                raise ValueError(f"way {self.way} needs antenna and {' or '.join(sensors)}")
        for high, low in (
            ("flat_slope_leave", "flat_slope_return"),
            ("flat_uneven_leave_m", "flat_uneven_return_m"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low} is above {high}, expected at most that")
        return self

    def options(self) -> AntennaOptions:
        """Return the estimator's parameters."""
        return AntennaOptions(
            vehicle=self._vehicle(),
            method=self.way,
            comparison=ComparisonRules(
                sigmas=self.disagree_sigmas,
                after_s=self.disagree_after_s,
                kept_s=self.disagree_kept_s,
                change=ChangeRules(self.change_least_m, self.change_sigmas),
            ),
            flat=FlatRules(
                **{field.name: getattr(self, f"flat_{field.name}") for field in fields(FlatRules)}
            ),
        )

    def _vehicle(self) -> VehicleGeometry:
        fixed = None if self.fixed_height_m is None else FixedHeight(self.fixed_height_m, self.fixed_sigma_m)
        stroke = ranging = None
        if self.suspension_to_antenna_m is not None and self.tyre_radius_m is not None:
            stroke = StrokeGeometry(
                suspension_to_antenna_m=self.suspension_to_antenna_m,
                tyre_radius_m=self.tyre_radius_m,
                suspension=_arm(self.suspension),
            )
        sensor = _arm(self.ranging)
        if sensor is not None:
            ranging = RangingGeometry(
                sensor=sensor,
                beam_azimuth_rad=math.radians(self.beam_azimuth_deg),
                beam_sigma_rad=math.radians(self.beam_sigma_deg),
            )
        return VehicleGeometry(
            tilt=TiltRules(
                body_pitch_sigma_rad=math.radians(self.body_pitch_sigma_deg),
                body_roll_sigma_rad=math.radians(self.body_roll_sigma_deg),
                attitude_sigma_rad=math.radians(self.attitude_sigma_deg),
                slope_sigma=self.slope_sigma,
            ),
            fixed=fixed,
            stroke=stroke,
            ranging=ranging,
            antenna=_arm(self.antenna),
            lidar=_arm(self.lidar),
            stored_sigma_m=self.stored_sigma_m,
            plausible_m=self.plausible_m,
            matched_attitude_sigma_rad=math.radians(self.matched_attitude_sigma_deg),
            pose_sigma_limit_m=self.pose_sigma_limit_m,
        )


def _arm(point: BodyPoint | None) -> Arm | None:
    return None if point is None else Arm(point.x_m, point.y_m, point.z_m)

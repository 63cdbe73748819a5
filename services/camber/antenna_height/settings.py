"""Settings of antenna_height."""

from __future__ import annotations

import math
from typing import ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from camber.antenna_height.available_heights import FixedWay, RangingWay, StrokeWay, Vehicle
from camber.antenna_height.body_attitude import Arm, TiltRules
from camber.antenna_height.change_detection import ChangeRules
from camber.antenna_height.estimator import AntennaOptions
from camber.antenna_height.flatness import FlatRules
from camber.antenna_height.method_comparison import ComparisonRules
from camber.runtime.settings import ServiceSettings


class Place(BaseModel):
    """A point of the vehicle at rest. All three must be said: there is no default for what nobody has measured."""

    model_config = ConfigDict(extra="forbid")
    x_m: float = Field(ge=-50.0, le=50.0, description="forward of the rear axle's middle")
    y_m: float = Field(ge=-50.0, le=50.0, description="left of it")
    z_m: float = Field(ge=-10.0, le=100.0, description="above the road")

    def arm(self) -> Arm:
        """As a point of the vehicle frame."""
        return Arm(self.x_m, self.y_m, self.z_m)


class AntennaHeightSettings(ServiceSettings):
    """How the antenna's height above the road is known."""

    SERVICE: ClassVar[str] = "antenna_height"

    way: Literal["fixed", "stroke", "ranging", "scan_matching", "automatic"] = Field(
        "fixed", description="the way whose height is passed on; all that the vehicle has are compared"
    )
    fixed_height_m: float | None = Field(
        None,
        ge=-1.0,
        le=100.0,
        description="measured height of the antenna above the road; None: not measured",
    )
    fixed_sigma_m: float = Field(
        0.01,
        ge=0.0,
        le=1.0,
        description="σ of that, by which springs and loads may move the antenna included",
    )
    suspension_to_antenna_m: float | None = Field(
        None, ge=-10.0, le=10.0, description="h_ba of H (1), for way stroke; None: not measured"
    )
    tyre_radius_m: float | None = Field(
        None, gt=0.0, le=5.0, description="h_t of H (1), for way stroke; None: not measured"
    )
    antenna: Place | None = Field(None, description="table x_m, y_m, z_m: the antenna's reference point")
    suspension: Place | None = Field(
        None, description="table: top of the suspension of which the stroke is; None: near the antenna"
    )
    ranging: Place | None = Field(
        None, description="table: origin of the ranging sensor; None: there is none, the LiDAR stands in"
    )
    lidar: Place | None = Field(None, description="table: origin of the surround sensor")
    beam_azimuth_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="where the ranging beam points, counter-clockwise from forward"
    )
    beam_sigma_deg: float = Field(
        0.15, ge=0.0, le=10.0, description="σ of the beam's angle below the vehicle's horizontal"
    )
    stored_sigma_m: float = Field(
        0.01,
        ge=0.0,
        le=1.0,
        description="σ of what was measured of the vehicle, for each way: h_ba, h_t, h_sa",
    )
    plausible_m: float = Field(
        0.5, gt=0.0, le=10.0, description="further than this from antenna.z_m no height is believed"
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
        3.0, gt=0.0, le=1000.0, description="of a pose less certain the road's slope is not used"
    )
    flat_slope_leave: float = Field(
        0.05, gt=0.0, le=2.0, description="automatic: steeper than this a road is not flat, a ratio"
    )
    flat_slope_return: float = Field(
        0.04, gt=0.0, le=2.0, description="automatic: flat again below this slope, a ratio"
    )
    flat_uneven_leave_m: float = Field(
        0.03, gt=0.0, le=2.0, description="automatic: nor further off its plane than this below the beam"
    )
    flat_uneven_return_m: float = Field(0.02, gt=0.0, le=2.0, description="automatic: flat again below this")
    flat_dwell_s: float = Field(
        2.0, ge=0.0, le=600.0, description="automatic: a road stays flat, or not, for so long at least"
    )
    disagree_sigmas: float = Field(
        4.0, gt=0.0, le=20.0, description="two ways disagree beyond so many σ of their difference"
    )
    disagree_after_s: float = Field(
        1.0, ge=0.0, le=60.0, description="and for so long, or at once beyond twice that"
    )
    disagree_kept_s: float = Field(
        60.0, ge=0.0, le=3600.0, description="a disagreement stands so long when it can be tested no more"
    )
    change_least_m: float = Field(
        0.006, gt=0.0, le=1.0, description="a smaller change of the difference of two ways is none"
    )
    change_sigmas: float = Field(
        4.0, gt=0.0, le=20.0, description="nor one that is less than so many of its own σ"
    )
    publish_period_s: float = Field(0.2, gt=0.0, le=1.0, description="a height is repeated this often")

    @model_validator(mode="after")
    def _is_measured(self) -> Self:
        if self.way == "stroke" and (self.suspension_to_antenna_m is None or self.tyre_radius_m is None):
            raise ValueError("way stroke needs suspension_to_antenna_m and tyre_radius_m")
        sensors = {
            "ranging": ("ranging", "lidar"),
            "scan_matching": ("lidar",),
            "automatic": ("ranging", "lidar"),
        }
        if self.way in sensors:
            has_sensor = any(getattr(self, name) is not None for name in sensors[self.way])
            if self.antenna is None or not has_sensor:
                raise ValueError(f"way {self.way} needs antenna and {' or '.join(sensors[self.way])}")
        for name in ("flat_slope", "flat_uneven"):
            unit = "" if name == "flat_slope" else "_m"
            if getattr(self, f"{name}_return{unit}") > getattr(self, f"{name}_leave{unit}"):
                raise ValueError(f"{name}_return{unit} is above {name}_leave{unit}, expected at most that")
        return self

    def options(self) -> AntennaOptions:
        """As the pure modules take them."""
        return AntennaOptions(
            self._vehicle(),
            self.way,
            ComparisonRules(
                self.disagree_sigmas,
                self.disagree_after_s,
                self.disagree_kept_s,
                ChangeRules(self.change_least_m, self.change_sigmas),
            ),
            FlatRules(
                self.flat_slope_leave,
                self.flat_slope_return,
                self.flat_uneven_leave_m,
                self.flat_uneven_return_m,
                self.flat_dwell_s,
            ),
        )

    def _vehicle(self) -> Vehicle:
        fixed = None if self.fixed_height_m is None else FixedWay(self.fixed_height_m, self.fixed_sigma_m)
        stroke = ranging = None
        if self.suspension_to_antenna_m is not None and self.tyre_radius_m is not None:
            stroke = StrokeWay(self.suspension_to_antenna_m, self.tyre_radius_m, _arm(self.suspension))
        if self.ranging is not None:
            ranging = RangingWay(
                self.ranging.arm(), math.radians(self.beam_azimuth_deg), math.radians(self.beam_sigma_deg)
            )
        return Vehicle(
            tilt=TiltRules(
                math.radians(self.body_pitch_sigma_deg),
                math.radians(self.body_roll_sigma_deg),
                math.radians(self.attitude_sigma_deg),
                self.slope_sigma,
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


def _arm(place: Place | None) -> Arm | None:
    return None if place is None else place.arm()

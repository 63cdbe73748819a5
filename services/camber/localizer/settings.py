"""Settings of the localizer."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from camber.localizer.dead_reckoning import MotionModel
from camber.localizer.pose_filter import PoseModel
from camber.runtime.settings import ServiceSettings


class GivenPose(BaseModel):
    """Where the antenna is at the start, known without satellites: a parking place, an operator."""

    model_config = ConfigDict(extra="forbid")
    latitude_deg: float = Field(ge=-90.0, le=90.0, description="latitude of the antenna")
    longitude_deg: float = Field(ge=-180.0, le=180.0, description="longitude of the antenna")
    yaw_deg: float = Field(
        ge=-360.0, le=360.0, description="direction of the vehicle's x, counter-clockwise from east"
    )
    horizontal_sigma_m: float = Field(gt=0.0, le=1000.0, description="σ in east and in north")
    yaw_sigma_deg: float = Field(gt=0.0, le=180.0, description="σ of yaw_deg")


class LocalizerSettings(ServiceSettings):
    """Vehicle, sensors, links."""

    SERVICE: ClassVar[str] = "localizer"

    antenna_x_m: float = Field(
        0.0, ge=-50.0, le=50.0, description="antenna forward of the rear axle's middle"
    )
    antenna_y_m: float = Field(0.0, ge=-50.0, le=50.0, description="antenna left of it")
    wheelbase_m: float = Field(2.7, gt=0.1, le=20.0, description="for the bicycle model of the steering")
    a_rate_sensor: Literal["yaw_rate", "steering"] = Field(
        "yaw_rate", description="sensor that turns the motion of system A; the other one serves system B"
    )
    couple_links: bool = Field(True, description="couple dead reckoning to the map's links")
    links_radius_m: float = Field(600.0, ge=100.0, le=2000.0, description="links are fetched this far around")
    road_sigma_limit_m: float = Field(
        15.0, gt=0.0, le=27.0, description="beyond this σ no road is named under the pose"
    )
    initial_pose: GivenPose | None = Field(None, description="a given pose at the start, believed once")

    def model(self) -> PoseModel:
        """The filter's model."""
        motion = MotionModel(wheelbase_m=self.wheelbase_m, a_rate_sensor=self.a_rate_sensor)
        return PoseModel(
            motion=motion,
            antenna_x_m=self.antenna_x_m,
            antenna_y_m=self.antenna_y_m,
            couple_links=self.couple_links,
        )

"""Settings of the localizer."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from camber.localizer.filter.dead_reckoning import MotionModel
from camber.localizer.filter.pose_filter import PoseModel
from camber.localizer.localization import GivenStart, LocalizationOptions
from camber.localizer.matching.layered_matching import MatchOptions
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
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

    def start(self) -> GivenStart:
        """In radians."""
        return GivenStart(
            math.radians(self.latitude_deg),
            math.radians(self.longitude_deg),
            math.radians(self.yaw_deg),
            self.horizontal_sigma_m,
            math.radians(self.yaw_sigma_deg),
        )


class LocalizerSettings(ServiceSettings):
    """Vehicle, sensors, links."""

    SERVICE: ClassVar[str] = "localizer"

    antenna_x_m: float = Field(
        0.0, ge=-50.0, le=50.0, description="antenna forward of the rear axle's middle"
    )
    antenna_y_m: float = Field(0.0, ge=-50.0, le=50.0, description="antenna left of it")
    antenna_z_m: float = Field(
        0.0,
        ge=-50.0,
        le=50.0,
        description="antenna above the road at rest: on a grade it leans with the vehicle",
    )
    lidar_x_m: float = Field(0.0, ge=-50.0, le=50.0, description="LiDAR forward of the rear axle's middle")
    lidar_y_m: float = Field(0.0, ge=-50.0, le=50.0, description="LiDAR left of it")
    lidar_z_m: float = Field(1.8, ge=-10.0, le=100.0, description="LiDAR above the road at rest")
    lidar_roll_deg: float = Field(
        0.0, ge=-180.0, le=180.0, description="LiDAR's left side up against the vehicle"
    )
    lidar_pitch_deg: float = Field(
        0.0, ge=-90.0, le=90.0, description="LiDAR's nose down against the vehicle"
    )
    lidar_yaw_deg: float = Field(0.0, ge=-180.0, le=180.0, description="LiDAR counter-clockwise against it")
    wheelbase_m: float = Field(2.7, gt=0.1, le=20.0, description="for the bicycle model of the steering")
    a_rate_sensor: Literal["yaw_rate", "steering"] = Field(
        "yaw_rate", description="sensor that turns the motion of system A; the other one serves system B"
    )
    couple_links: bool = Field(True, description="couple dead reckoning to the map's links")
    match_sweeps: bool = Field(True, description="match sweeps to the map's clouds, where there are some")
    layer_bounds_m: tuple[float, ...] = Field(
        (0.3, 1.0, 2.0, 3.0),
        min_length=2,
        max_length=17,
        description="heights above the road at which the layers of a match begin and end, from the lowest up",
    )
    match_method: Literal["point_to_point", "point_to_plane", "plane_to_plane", "vgicp"] = Field(
        "point_to_plane", description="how a layer is fitted: the document's ICP is point_to_point"
    )
    layer_choice: Literal["voted", "best", "mean", "weighted", "whole"] = Field(
        "voted", description="how one answer is made of the layers'; whole: without layers"
    )
    match_distance_m: float = Field(
        1.0, gt=0.0, le=10.0, description="points farther apart are no pair (d_max of the document)"
    )
    sweeps_overlaid: int = Field(10, ge=1, le=50, description="sweeps in the local map (m of the document)")
    road_by: Literal["surface", "line"] = Field(
        "surface",
        description="height and tilt of a local map: by the ground it sees, or by the document's line through the road",
    )
    links_radius_m: float = Field(600.0, ge=100.0, le=2000.0, description="links are fetched this far around")
    road_sigma_limit_m: float = Field(
        15.0, gt=0.0, le=27.0, description="beyond this σ no road is named under the pose"
    )
    initial_pose: GivenPose | None = Field(None, description="a given pose at the start, believed once")

    def options(self, given: GivenPose | None) -> LocalizationOptions:
        """All of it for the localizer, with the given pose where it is to be believed."""
        mount = SensorMount(
            self.lidar_x_m,
            self.lidar_y_m,
            self.lidar_z_m,
            math.radians(self.lidar_roll_deg),
            math.radians(self.lidar_pitch_deg),
            math.radians(self.lidar_yaw_deg),
        )
        return LocalizationOptions(
            model=self.model(),
            antenna_z_m=self.antenna_z_m,
            links_radius_m=self.links_radius_m,
            road_sigma_limit_m=self.road_sigma_limit_m,
            given=None if given is None else given.start(),
            matching=self._matching(mount) if self.match_sweeps else None,
        )

    @field_validator("layer_bounds_m")
    @classmethod
    def _bounds_rise(cls, bounds: tuple[float, ...]) -> tuple[float, ...]:
        if any(high - low < 0.1 for low, high in pairwise(bounds)) or bounds[0] < 0.0 or bounds[-1] > 8.0:
            raise ValueError("expected heights from 0 to 8 m, each at least 0.1 m above the one before")
        return bounds

    def _matching(self, mount: SensorMount) -> ScanMatchOptions:
        match = MatchOptions(
            layer_bounds_m=tuple(pairwise(self.layer_bounds_m)),
            method=self.match_method,
            choice=self.layer_choice,
            max_distance_m=self.match_distance_m,
        )
        return ScanMatchOptions(mount=mount, match=match, sweeps=self.sweeps_overlaid, road_by=self.road_by)

    def model(self) -> PoseModel:
        """The filter's model."""
        motion = MotionModel(wheelbase_m=self.wheelbase_m, a_rate_sensor=self.a_rate_sensor)
        return PoseModel(
            motion=motion,
            antenna_x_m=self.antenna_x_m,
            antenna_y_m=self.antenna_y_m,
            couple_links=self.couple_links,
        )

"""Settings of the localizer."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, ClassVar

from pydantic import Field, field_validator

from camber.localizer.filter.odometry import MotionModel, RateSensor
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.given_pose import GivenPose
from camber.localizer.inertial.imu_motion import ImuOptions
from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.localizer.localization import LocalizationOptions
from camber.localizer.matching.ground_alignment import RoadBy
from camber.localizer.matching.layered_matching import LayerChoice, MatchOptions
from camber.localizer.matching.registration import Method
from camber.localizer.matching.scan_matcher import ScanMatchOptions
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.runtime.settings import ServiceSettings
from camber.schemas.motion import ImuClass

# The defaults below are those of the parameter sets: each number stands once.
_LOCALIZATION, _SCAN_MATCHING = LocalizationOptions(), ScanMatchOptions()
_MODEL, _MATCHING = _LOCALIZATION.model, _SCAN_MATCHING.match

_Offset = Annotated[float, Field(ge=-50.0, le=50.0)]
_Turn = Annotated[float, Field(ge=-180.0, le=180.0)]


class LocalizerSettings(ServiceSettings):
    """Vehicle, sensors, matching and links."""

    SERVICE: ClassVar[str] = "localizer"

    antenna_x_m: _Offset = Field(_MODEL.antenna_x_m, description="antenna forward of the rear axle's middle")
    antenna_y_m: _Offset = Field(_MODEL.antenna_y_m, description="antenna left of it")
    antenna_z_m: _Offset = Field(
        _LOCALIZATION.antenna_z_m,
        description="antenna above the road at rest; on a grade it tilts with the vehicle",
    )
    lidar_x_m: _Offset = Field(0.0, description="LiDAR forward of the rear axle's middle")
    lidar_y_m: _Offset = Field(0.0, description="LiDAR left of it")
    lidar_z_m: float = Field(1.8, ge=-10.0, le=100.0, description="LiDAR above the road at rest")
    lidar_roll_deg: _Turn = Field(0.0, description="LiDAR against the vehicle, left side up")
    lidar_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0, description="LiDAR against the vehicle, nose down")
    lidar_yaw_deg: _Turn = Field(0.0, description="LiDAR against the vehicle, counter-clockwise")
    imu_class: ImuClass | None = Field(
        None,
        description="noise of the inertial unit, whose samples then drive the pose: of a phone (BMI160), an industrial"
        " MEMS (ADIS16465) or a tactical one (STIM300); unset: there is none",
    )
    imu_x_m: _Offset = Field(0.0, description="inertial unit forward of the rear axle's middle")
    imu_y_m: _Offset = Field(0.0, description="inertial unit left of it")
    imu_z_m: _Offset = Field(0.0, description="inertial unit above the road at rest")
    imu_roll_deg: _Turn = Field(0.0, description="inertial unit against the vehicle, left side up")
    imu_pitch_deg: float = Field(
        0.0, ge=-90.0, le=90.0, description="inertial unit against the vehicle, nose down"
    )
    imu_yaw_deg: _Turn = Field(0.0, description="inertial unit against the vehicle, counter-clockwise")
    wheelbase_m: float = Field(
        _MODEL.motion.wheelbase_m, gt=0.1, le=20.0, description="for the bicycle model of the steering"
    )
    a_rate_sensor: RateSensor = Field(
        _MODEL.motion.a_rate_sensor,
        description="rotation sensor of system A (dead reckoning); the other one is system B's",
    )
    couple_links: bool = Field(_MODEL.couple_links, description="couple dead reckoning to the map's links")
    match_sweeps: bool = Field(True, description="match sweeps to the map's clouds, where there are some")
    use_relief: bool = Field(
        True, description="determine the independent position by heights of fixes over the map's relief"
    )
    layer_bounds_m: tuple[float, ...] = Field(
        (_MATCHING.layer_bounds_m[0][0], *(high for _, high in _MATCHING.layer_bounds_m)),
        min_length=2,
        max_length=17,
        description="bounds of the layers, heights above the road from the lowest up",
    )
    match_method: Method = Field(
        _MATCHING.method, description="registration of a layer; point_to_point is the ICP of JP2016-109650A"
    )
    layer_choice: LayerChoice = Field(
        _MATCHING.choice, description="selection of one result from the layers'; whole: without layers"
    )
    match_distance_m: float = Field(
        _MATCHING.max_distance_m,
        gt=0.0,
        le=10.0,
        description="largest distance of a correspondence (d_max of JP2016-109650A)",
    )
    sweeps_overlaid: int = Field(
        _SCAN_MATCHING.sweeps, ge=1, le=50, description="sweeps in the local map (m of JP2016-109650A)"
    )
    road_by: RoadBy = Field(
        _SCAN_MATCHING.road_by,
        description="ground alignment: by the ground in the sweeps, or by JP2016-109650A's line through the map's road",
    )
    links_radius_m: float = Field(
        _LOCALIZATION.links_radius_m, ge=100.0, le=2000.0, description="radius within which links are fetched"
    )
    road_sigma_limit_m: float = Field(
        _LOCALIZATION.road_sigma_limit_m, gt=0.0, le=27.0, description="beyond this σ the pose gets no road"
    )
    initial_pose: GivenPose | None = Field(None, description="given pose at the start, used once")

    @field_validator("layer_bounds_m")
    @classmethod
    def _bounds_rise(cls, bounds: tuple[float, ...]) -> tuple[float, ...]:
        if any(high - low < 0.1 for low, high in pairwise(bounds)) or bounds[0] < 0.0 or bounds[-1] > 8.0:
            raise ValueError("expected heights from 0 to 8 m, each at least 0.1 m above the one before")
        return bounds

    def options(self, given: GivenPose | None) -> LocalizationOptions:
        """Return the localizer's parameters, with the given pose where it is to be used."""
        return LocalizationOptions(
            model=PoseModel(
                motion=MotionModel(wheelbase_m=self.wheelbase_m, a_rate_sensor=self.a_rate_sensor),
                antenna_x_m=self.antenna_x_m,
                antenna_y_m=self.antenna_y_m,
                couple_links=self.couple_links,
            ),
            antenna_z_m=self.antenna_z_m,
            links_radius_m=self.links_radius_m,
            road_sigma_limit_m=self.road_sigma_limit_m,
            given=given,
            imu=self._imu(),
            matching=self._matching() if self.match_sweeps else None,
            relief=HeightErrorModel() if self.use_relief else None,
        )

    def _imu(self) -> ImuOptions | None:
        if self.imu_class is None:
            return None
        mount = _mount(
            (self.imu_x_m, self.imu_y_m, self.imu_z_m),
            roll_pitch_yaw_deg=(self.imu_roll_deg, self.imu_pitch_deg, self.imu_yaw_deg),
        )
        return ImuOptions(noise=IMU_NOISE[self.imu_class], mount=mount)

    def _matching(self) -> ScanMatchOptions:
        mount = _mount(
            (self.lidar_x_m, self.lidar_y_m, self.lidar_z_m),
            roll_pitch_yaw_deg=(self.lidar_roll_deg, self.lidar_pitch_deg, self.lidar_yaw_deg),
        )
        match = MatchOptions(
            layer_bounds_m=tuple(pairwise(self.layer_bounds_m)),
            method=self.match_method,
            choice=self.layer_choice,
            max_distance_m=self.match_distance_m,
        )
        return ScanMatchOptions(mount=mount, match=match, sweeps=self.sweeps_overlaid, road_by=self.road_by)


def _mount(
    position_m: tuple[float, float, float], *, roll_pitch_yaw_deg: tuple[float, float, float]
) -> SensorMount:
    roll, pitch, yaw = map(math.radians, roll_pitch_yaw_deg)
    x_m, y_m, z_m = position_m
    return SensorMount(x_m=x_m, y_m=y_m, z_m=z_m, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)

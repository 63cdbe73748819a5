"""Settings of the node in a ROS 2 graph."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from camber.geodesy.local_frame import LocalFrame
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Name
from camber.schemas.motion import LeverArm

_NAME = r"[A-Za-z_][A-Za-z0-9_]*"
TopicName = Annotated[str, Field(pattern=rf"^(/{_NAME})+$", max_length=200)]
OptionalTopicName = Annotated[str, Field(pattern=rf"^((/{_NAME})+)?$", max_length=200)]


class RosInputs(BaseModel):
    """Topics that are read; empty: none."""

    model_config = ConfigDict(extra="forbid")

    lidar: OptionalTopicName = Field("/points", description="a point cloud, published as sweeps; empty: none")
    lidar_type: Literal["sensor_msgs/msg/PointCloud2", "livox_ros_driver2/msg/CustomMsg"] = Field(
        "sensor_msgs/msg/PointCloud2", description="type of `lidar`"
    )
    lidar_name: Name = Field("lidar", description="the sensor's name in its sweeps")
    motion: OptionalTopicName = Field("/odom", description="speed and yaw rate of the vehicle; empty: none")
    motion_type: Literal[
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/TwistStamped",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
    ] = Field("nav_msgs/msg/Odometry", description="type of `motion`")
    imu: OptionalTopicName = Field("/imu/data", description="Imu, published in its axes; empty: none")
    receiver: OptionalTopicName = Field(
        "",
        description="positions of a receiver for a gnss with source `bus`; empty: none",
    )
    receiver_type: Literal["sensor_msgs/msg/NavSatFix", "gps_msgs/msg/GPSFix"] = Field(
        "sensor_msgs/msg/NavSatFix", description="type of `receiver`"
    )
    silence_s: float = Field(
        2.0, gt=0.0, le=3600.0, description="a topic with a publisher that is silent for so long is reported"
    )


class MapOrigin(BaseModel):
    """Where `map` has its origin: an east, north, up frame tangent to the ellipsoid."""

    model_config = ConfigDict(extra="forbid")

    latitude_deg: float = Field(ge=-90.0, le=90.0)
    longitude_deg: float = Field(ge=-180.0, le=180.0)
    height_m: float = Field(ge=-20_000.0, le=100_000.0, description="above the ellipsoid")


class RosOutputs(BaseModel):
    """What is published, and in which frames."""

    model_config = ConfigDict(extra="forbid")

    prefix: TopicName = Field("/camber", description="`fix`, `pose`, `odometry` and `verdict` are below it")
    map_frame: str = Field("map", min_length=1, max_length=100, description="frame of poses")
    base_frame: str = Field("base_link", min_length=1, max_length=100, description="frame of the vehicle")
    origin: MapOrigin | None = Field(
        None,
        description="table latitude_deg, longitude_deg, height_m: origin of poses; unset: the first usable position",
    )
    antenna: LeverArm | None = Field(
        None,
        description="table x_m, y_m, z_m: the antenna in `base_frame`; unset: poses are the antenna's, no tf",
    )
    tf: bool = Field(True, description="publish `map_frame` → `base_frame`, unless autoware.enabled")


class AutowareSettings(BaseModel):
    """A stand-in for Autoware's pose_covariance_modifier; limits and topics are Autoware's."""

    model_config = ConfigDict(extra="forbid")

    enabled: bool = Field(False, description="run in place of pose_covariance_modifier")
    gnss: TopicName = Field(
        "/sensing/gnss/pose_with_covariance", description="of gnss_poser, which must read `fix` of this node"
    )
    ndt: TopicName = Field(
        "/localization/pose_estimator/ndt_scan_matcher/pose_with_covariance",
        description="of ndt_scan_matcher",
    )
    output: TopicName = Field(
        "/localization/pose_estimator/pose_with_covariance", description="for ekf_localizer"
    )
    most_yaw_sigma_deg: float = Field(0.3, gt=0.0, description="above it the GNSS pose is not used")
    most_height_sigma_m: float = Field(0.1, gt=0.0, description="above it the GNSS pose is not used")
    gnss_alone_sigma_m: float = Field(
        0.1, gt=0.0, description="horizontal; up to it the NDT pose is not used"
    )
    most_horizontal_sigma_m: float = Field(0.25, gt=0.0, description="above it the GNSS pose is not used")


class Ros2Settings(ServiceSettings):
    """Joins a ROS 2 graph that uses rmw_zenoh: sensors in, judged positions and verdicts out."""

    SERVICE: ClassVar[str] = "ros2"

    period_s: float = Field(
        0.02, gt=0.0, le=0.2, description="longest time between two rounds of the work loop"
    )
    router: list[str] = Field(["tcp/127.0.0.1:7447"], description="endpoints of the router of the ROS graph")
    mode: Literal["peer", "client"] = Field(
        "peer", description="role in the graph; client where the router is on another machine"
    )
    domain_id: int = Field(0, ge=0, le=232, description="ROS_DOMAIN_ID of the graph")
    distribution: Literal["jazzy", "humble"] = Field(
        "jazzy", description="jazzy: also all later; humble: types without hashes"
    )
    use_sim_time: bool = Field(
        False,
        description="take the time of `/clock`, simulated at the rate of real time, for that of all stamps",
    )
    node: str = Field("camber", pattern=rf"^{_NAME}$", max_length=100, description="name of the node")
    inputs: RosInputs = Field(default_factory=RosInputs, description="what is read")
    outputs: RosOutputs = Field(default_factory=RosOutputs, description="what is published")
    autoware: AutowareSettings = Field(default_factory=AutowareSettings, description="stand-in")

    @model_validator(mode="after")
    def _is_live(self) -> Self:
        if self.clock == "replay":
            raise ValueError("clock: replay, expected system: in a replay no ROS graph is joined")
        return self

    def map_frame(self) -> LocalFrame | None:
        """Return the frame of `outputs.origin`, None where it is unset."""
        origin = self.outputs.origin
        if origin is None:
            return None
        latitude_rad, longitude_rad = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        return LocalFrame(latitude_rad, longitude_rad, origin.height_m)

"""Messages of ROS sensors become Camber's only while they are of now; the rest is refused with its reason."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.errors import FormatError
from camber.formats.receiver.rtklib_pos import PosDecoder
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ros.message_types import header_at, new_message, stamp_unix_ns
from camber.formats.ros.static_frames import StaticFrames
from camber.ros2.sensor_inputs import SensorTopic, StampError, lever_arm_settings
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion

NS = 1_000_000_000
NOW_NS = 1_400_000_000 * NS
FIX = "sensor_msgs/msg/NavSatFix"


def motion_topic() -> SensorTopic:
    return SensorTopic(name="/odom", kind="geometry_msgs/msg/TwistStamped", channel="motion")


def twist(time_ns: int, speed_m_s: float = 5.0, rate_rad_s: float = 0.1) -> Any:
    def vector(x: float, z: float) -> Any:
        return new_message("geometry_msgs/msg/Vector3", x=x, y=0.0, z=z)

    return new_message(
        "geometry_msgs/msg/TwistStamped",
        header=header_at(time_ns, "base_link"),
        twist=new_message(
            "geometry_msgs/msg/Twist", linear=vector(speed_m_s, 0.0), angular=vector(0.0, rate_rad_s)
        ),
    )


def cloud(time_ns: int, *, step: int = 12) -> Any:
    fields = [
        new_message("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate("xyz")
    ]
    data = np.arange(1, 1 + 2 * step // 4, dtype=np.float32).view(np.uint8)
    return new_message(
        "sensor_msgs/msg/PointCloud2",
        header=header_at(time_ns, "os_lidar"),
        height=1,
        width=2,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=2 * step,
        data=data,
        is_dense=True,
    )


def fix(time_ns: int, status: int = 0, latitude: float = 35.0) -> Any:
    return new_message(
        FIX,
        header=header_at(time_ns, "gps"),
        status=new_message("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        latitude=latitude,
        longitude=137.0,
        altitude=50.0,
        position_covariance=np.eye(3).reshape(-1),
        position_covariance_type=2,
    )


def test_motion_has_the_time_of_its_stamp() -> None:
    topic = motion_topic()
    message = topic.message(twist(NOW_NS - NS // 10), NOW_NS, "lidar")
    assert message == Motion(time_ns=NOW_NS - NS // 10, wheel_speed_m_s=5.0, yaw_rate_rad_s=0.1)
    assert topic.frame_id == "base_link"


@given(st.integers(-20, 20))
def test_only_what_is_of_now_is_given(tenths: int) -> None:
    """The table: motion is 0.5 s old at most; 0.5 s in the future are a sender's wrong clock."""
    topic, time_ns = motion_topic(), NOW_NS + tenths * NS // 10
    if -5 <= tenths <= 5:
        assert topic.message(twist(time_ns), NOW_NS, "lidar") is not None
        return
    with pytest.raises(StampError, match=r"/odom: \d"):
        topic.message(twist(time_ns), NOW_NS, "lidar")
    assert topic.counts == {"stale" if tenths < 0 else "future": 1}


def test_a_stamp_of_zero_is_refused() -> None:
    message = twist(NOW_NS)
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    with pytest.raises(FormatError, match=r"header\.stamp"):
        motion_topic().message(message, NOW_NS, "lidar")


def test_motion_of_no_vehicle_is_refused_and_unknown_motion_is_none() -> None:
    topic = motion_topic()
    with pytest.raises(FormatError, match="wheel_speed_m_s"):
        topic.message(twist(NOW_NS, speed_m_s=1e6), NOW_NS, "lidar")
    assert topic.message(twist(NOW_NS, math.nan, math.inf), NOW_NS, "lidar") is None
    assert topic.counts["empty"] == 1


def inertial(time_ns: int, *, yaw_rate_rad_s: float = 0.3, first_covariance: float = 0.0) -> Any:
    covariance = np.array([first_covariance, *[0.0] * 8])
    return new_message(
        "sensor_msgs/msg/Imu",
        header=header_at(time_ns, "imu_link"),
        orientation=new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.array([-1.0, *[0.0] * 8]),
        angular_velocity=new_message("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=yaw_rate_rad_s),
        angular_velocity_covariance=covariance,
        linear_acceleration=new_message("geometry_msgs/msg/Vector3", x=0.5, y=0.25, z=9.75),
        linear_acceleration_covariance=covariance,
    )


def imu_topic() -> SensorTopic:
    return SensorTopic(name="/imu/data", kind="sensor_msgs/msg/Imu", channel="imu")


def test_an_inertial_sample_has_the_axes_of_its_frame() -> None:
    topic = imu_topic()
    assert topic.message(inertial(NOW_NS - 1000), NOW_NS, "lidar") == Imu(
        time_ns=NOW_NS - 1000, angular_rate_rad_s=(0.1, 0.2, 0.3), specific_force_m_s2=(0.5, 0.25, 9.75)
    )
    assert topic.frame_id == "imu_link"
    with pytest.raises(StampError, match="/imu/data"):
        topic.message(inertial(NOW_NS - NS), NOW_NS, "lidar")


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (inertial(NOW_NS, first_covariance=-1.0), "/imu/data: angular_velocity_covariance is '-1'"),
        (inertial(NOW_NS, yaw_rate_rad_s=math.nan), "/imu/data: angular_rate_rad_s.2 is 'nan'"),
        (inertial(NOW_NS, yaw_rate_rad_s=-50.0), "/imu/data: angular_rate_rad_s.2 is '-50.0'"),
    ],
)
def test_an_inertial_sample_that_lacks_something_is_one_line(message: Any, expected: str) -> None:
    with pytest.raises(FormatError) as caught:
        imu_topic().message(message, NOW_NS, "lidar")
    assert str(caught.value).startswith(expected)


def test_a_cloud_without_times_is_a_sweep_and_counted() -> None:
    topic = SensorTopic(name="/points", kind="sensor_msgs/msg/PointCloud2", channel="sweep")
    sweep = topic.message(cloud(NOW_NS), NOW_NS, "roof")
    assert isinstance(sweep, Sweep)
    assert (sweep.sensor, sweep.time_ns, len(sweep.points_m)) == ("roof", NOW_NS, 2)
    assert topic.counts["without_point_times"] == 1
    assert topic.frame_id == "os_lidar"
    broken = cloud(NOW_NS)
    broken.data = broken.data[:-1]
    with pytest.raises(FormatError, match="/points"):
        topic.message(broken, NOW_NS, "roof")


def test_a_receivers_position_is_a_line_that_can_be_read_at_any_time() -> None:
    topic = SensorTopic(name="/fix", kind=FIX, channel="receiver_bytes")
    message = topic.message(fix(NOW_NS, status=2), NOW_NS + NS, "lidar")
    assert isinstance(message, ReceiverBytes)
    (solution,) = PosDecoder("receiver").feed(message.payload.tobytes())
    assert isinstance(solution, ReceiverSolution)
    assert solution.time_ns == NOW_NS
    assert solution.quality is SolutionQuality.DGPS, "GBAS_FIX says nothing of integers"
    assert solution.covariance_enu_m2 == pytest.approx((1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    assert topic.message(fix(NOW_NS, status=-1), NOW_NS, "lidar") is None
    with pytest.raises(FormatError, match="/fix"):
        topic.message(fix(NOW_NS, latitude=math.nan), NOW_NS, "lidar")


def frames(child: str) -> StaticFrames:
    half = math.sqrt(0.5)
    transform = new_message(
        "geometry_msgs/msg/Transform",
        translation=new_message("geometry_msgs/msg/Vector3", x=1.25, y=-0.5, z=1.75),
        rotation=new_message("geometry_msgs/msg/Quaternion", x=0.0, y=half, z=0.0, w=half),
    )
    stamped = new_message(
        "geometry_msgs/msg/TransformStamped",
        header=header_at(NOW_NS, "base_link"),
        child_frame_id=child,
        transform=transform,
    )
    tree = StaticFrames()
    tree.add(new_message("tf2_msgs/msg/TFMessage", transforms=[stamped]))
    return tree


def test_lever_arms_are_settings_of_the_services() -> None:
    lidar = SensorTopic(name="/points", kind="sensor_msgs/msg/PointCloud2", channel="sweep", frame_id="top")
    text = lever_arm_settings(frames("top"), "base_link", lidar)
    assert text is not None
    assert "localizer.toml: lidar_x_m = 1.250; lidar_y_m = -0.500; lidar_z_m = 1.750" in text
    assert "lidar_pitch_deg = 90.00" in text, "nose down"
    imu = imu_topic()
    imu.frame_id = "top"
    text = lever_arm_settings(frames("top"), "base_link", imu)
    assert text is not None
    assert "localizer.toml: imu_x_m = 1.250; imu_y_m = -0.500; imu_z_m = 1.750; imu_roll_deg = " in text
    assert "imu_pitch_deg = 90.00" in text
    antenna = SensorTopic(name="/fix", kind=FIX, channel="receiver_bytes", frame_id="top")
    text = lever_arm_settings(frames("top"), "base_link", antenna)
    assert text is not None
    assert "antenna = { x_m = 1.250, y_m = -0.500, z_m = 1.750 }" in text


def test_without_transforms_there_is_no_lever_arm() -> None:
    lidar = SensorTopic(name="/points", kind="sensor_msgs/msg/PointCloud2", channel="sweep")
    assert lever_arm_settings(frames("top"), "base_link", lidar) is None
    lidar.frame_id = "other"
    assert lever_arm_settings(frames("top"), "base_link", lidar) is None
    motion = motion_topic()
    motion.frame_id = "top"
    assert lever_arm_settings(frames("top"), "base_link", motion) is None


@pytest.mark.parametrize("graph_ns", [0, 1_300_000_000 * NS])
@pytest.mark.parametrize("channel", ["motion", "sweep", "receiver_bytes"])
def test_stamps_of_simulated_time_are_shifted_before_they_are_checked(channel: str, graph_ns: int) -> None:
    kinds = {
        "motion": ("geometry_msgs/msg/TwistStamped", twist),
        "sweep": ("sensor_msgs/msg/PointCloud2", cloud),
        "receiver_bytes": (FIX, fix),
    }
    kind, make = kinds[channel]
    topic = SensorTopic(name="/in", kind=kind, channel=channel)
    content = make(NOW_NS)
    stamp_ns = stamp_unix_ns(content)
    seconds, nanoseconds = divmod(graph_ns, NS)
    stamp = new_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    content = replace(content, header=replace(content.header, stamp=stamp))
    message = topic.message(content, NOW_NS, "lidar", ahead_ns=stamp_ns - graph_ns)
    assert message is not None
    assert message.time_ns == NOW_NS
    if isinstance(message, ReceiverBytes):
        (solution,) = PosDecoder("line").feed(message.payload.tobytes())
        assert isinstance(solution, ReceiverSolution)
        assert solution.time_ns == NOW_NS
    with pytest.raises((StampError, FormatError)):
        topic.message(content, NOW_NS, "lidar")

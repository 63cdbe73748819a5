"""`camber ros2` in a graph with a node that is written here: keys, tokens and attachments literally, by zenoh alone.

The node does what rmw_zenoh does (ros2/rmw_zenoh, docs/design.md; rmw_zenoh_cpp/src/detail/rmw_publisher_data.cpp,
rmw_subscription_data.cpp, attachment_helpers.cpp): a token for itself and for each publisher and subscription, CDR with
33 bytes of attachment, a cache behind the publisher of a transient local topic.
"""

from __future__ import annotations

import json
import math
import struct
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash
import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

from camber.runtime.bus import Bus
from camber.runtime.subscription import Subscription
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.integrity import Position, Verdict
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Imu, Motion
from support.running import (
    CLOCK,
    bus_of,
    camber_started,
    health_of,
    loopback_router,
    settings_file,
    wait_until,
)

pytestmark = [pytest.mark.timed, pytest.mark.slow]

GPS_AHEAD_S = 18  # of UTC
UNIX_OF_GPS_EPOCH_S = 315_964_800
STORE = get_typestore(Stores.ROS2_JAZZY)
ODOM = (
    "42/odom/nav_msgs::msg::dds_::Odometry_/"
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
)
POINTS = (
    "42/lidar/points/sensor_msgs::msg::dds_::PointCloud2_/"
    "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
)
IMU = "42/imu/data/sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
RECEIVER = (
    "42/gps/fix/sensor_msgs::msg::dds_::NavSatFix_/"
    "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404"
)
TF_STATIC = (
    "42/tf_static/tf2_msgs::msg::dds_::TFMessage_/"
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
)
FIX = (
    "42/camber/fix/sensor_msgs::msg::dds_::NavSatFix_/"
    "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404"
)
POSE_TYPE = (
    "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/"
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
)
CAMBER_ODOMETRY = ODOM.replace("42/odom", "42/camber/odometry")
DIAGNOSTICS = (
    "42/diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/"
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
)
TF = TF_STATIC.replace("42/tf_static", "42/tf")
CLOCK_TIME = (
    "42/clock/rosgraph_msgs::msg::dds_::Clock_/"
    "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"
)
GNSS_POSE = f"42/sensing/gnss/pose_with_covariance/{POSE_TYPE}"
NDT_POSE = f"42/localization/pose_estimator/ndt_scan_matcher/pose_with_covariance/{POSE_TYPE}"
SELECTED_POSE = f"42/localization/pose_estimator/pose_with_covariance/{POSE_TYPE}"
GID = bytes(range(16))


def new(kind: str, /, **values: Any) -> Any:
    cls: Any = STORE.types[kind]
    return cls(**values)


def header(unix_ns: int, frame_id: str) -> Any:
    stamp = new("builtin_interfaces/msg/Time", sec=unix_ns // 10**9, nanosec=unix_ns % 10**9)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def unix_ns_of(gps_ns: int) -> int:
    return gps_ns + (UNIX_OF_GPS_EPOCH_S - GPS_AHEAD_S) * 10**9


class Node:
    """A node of the graph; `received` by key: messages with their attachments and times of arrival."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("connect/timeout_ms", "-1")
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("timestamping/enabled", "true")
        self.session = zenoh.open(config)
        self.zid = str(self.session.info.zid())
        self.sequences: defaultdict[str, int] = defaultdict(int)
        self.received: defaultdict[str, list[tuple[Any, bytes, float]]] = defaultdict(list)
        self.entities: list[Any] = []
        self.token(f"@ros2_lv/42/{self.zid}/0/0/NN/%/%/bench")

    def token(self, key: str) -> None:
        self.entities.append(self.session.liveliness().declare_token(key))

    def advertise(self, number: int, key: str, *, kept: bool = False) -> Callable[[Any], None]:
        _, *names, dds_type, type_hash = key.split("/")
        qos = ":1:,1:,:,:,," if kept else "::,10:,:,:,,"
        self.token(
            f"@ros2_lv/42/{self.zid}/0/{number}/MP/%/%/bench/%{'%'.join(names)}/{dds_type}/{type_hash}/{qos}"
        )
        if kept:
            cache = zenoh.ext.CacheConfig(max_samples=1)
            publisher: Any = zenoh.ext.declare_advanced_publisher(
                self.session, key, cache=cache, publisher_detection=True
            )
        else:
            publisher = self.session.declare_publisher(key)
        self.entities.append(publisher)

        def publish(message: Any) -> None:
            self.sequences[key] += 1
            attachment = struct.pack("<qqB16s", self.sequences[key], time.time_ns(), 16, GID)
            data = bytes(STORE.serialize_cdr(message, message.__msgtype__))
            publisher.put(data, attachment=attachment)

        return publish

    def subscribe(self, key: str, kind: str) -> None:
        def arrived(sample: zenoh.Sample) -> None:
            message = STORE.deserialize_cdr(sample.payload.to_bytes(), kind)
            assert sample.attachment is not None
            self.received[key].append((message, sample.attachment.to_bytes(), time.monotonic()))

        self.entities.append(self.session.declare_subscriber(key, arrived))

    def tokens(self) -> set[str]:
        replies: Any = self.session.liveliness().get("@ros2_lv/42/**", timeout=5.0)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    def close(self) -> None:
        for entity in self.entities:
            entity.undeclare()
        self.session.close()  # type: ignore[no-untyped-call]


def odometry(unix_ns: int, speed_m_s: float) -> Any:
    def vector(x: float, z: float) -> Any:
        return new("geometry_msgs/msg/Vector3", x=x, y=0.0, z=z)

    covariance = np.zeros(36)
    point = new("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
    turn = new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pose = new("geometry_msgs/msg/Pose", position=point, orientation=turn)
    twist = new("geometry_msgs/msg/Twist", linear=vector(speed_m_s, 0.0), angular=vector(0.0, 0.125))
    return new(
        "nav_msgs/msg/Odometry",
        header=header(unix_ns, "odom"),
        child_frame_id="base_link",
        pose=new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
        twist=new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance),
    )


def inertial(unix_ns: int) -> Any:
    def vector(x: float, y: float, z: float) -> Any:
        return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    return new(
        "sensor_msgs/msg/Imu",
        header=header(unix_ns, "imu_link"),
        orientation=new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.array([-1.0, *[0.0] * 8]),
        angular_velocity=vector(0.25, -0.5, 0.125),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(1.5, -0.25, 9.75),
        linear_acceleration_covariance=np.zeros(9),
    )


def cloud(unix_ns: int) -> Any:
    """Three points as an Ouster's driver gives them, the last of them not measured."""
    row = np.dtype({"names": ["x", "y", "z", "t"], "formats": ["<f4", "<f4", "<f4", "<u4"], "itemsize": 16})
    points = np.array([(1.0, 2.0, 3.0, 0), (4.0, 5.0, 6.0, 50_000_000), (0.0, 0.0, 0.0, 0)], row)
    kinds = {"x": 7, "y": 7, "z": 7, "t": 6}
    fields = [
        new("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=kind, count=1)
        for i, (name, kind) in enumerate(kinds.items())
    ]
    return new(
        "sensor_msgs/msg/PointCloud2",
        header=header(unix_ns, "os_lidar"),
        height=1,
        width=3,
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=48,
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=False,
    )


def receiver_fix(unix_ns: int) -> Any:
    return new(
        "sensor_msgs/msg/NavSatFix",
        header=header(unix_ns, "gps"),
        status=new("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        latitude=35.0,
        longitude=137.0,
        altitude=52.5,
        position_covariance=np.diag([4.0, 4.0, 9.0]).reshape(-1),
        position_covariance_type=2,
    )


def static_frames() -> Any:
    """The LiDAR 1.1 m ahead, 1.9 m up, turned by 90° to the left."""
    half = math.sqrt(0.5)
    transform = new(
        "geometry_msgs/msg/Transform",
        translation=new("geometry_msgs/msg/Vector3", x=1.1, y=0.0, z=1.9),
        rotation=new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=half, w=half),
    )
    stamped = new(
        "geometry_msgs/msg/TransformStamped",
        header=header(0, "base_link"),
        child_frame_id="os_lidar",
        transform=transform,
    )
    return new("tf2_msgs/msg/TFMessage", transforms=[stamped])


def pose(unix_ns: int, x_m: float, sigma: float) -> Any:
    at = new("geometry_msgs/msg/Point", x=x_m, y=0.0, z=0.0)
    turn = new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return new(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header(unix_ns, "map"),
        pose=new(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=new("geometry_msgs/msg/Pose", position=at, orientation=turn),
            covariance=(np.eye(6) * sigma**2).reshape(-1),
        ),
    )


class Judge:
    """Publishes verdicts and positions of now, as integrity does."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.fix_id = 0

    def judge(self, *, confirmed: bool, usable: bool = True) -> int:
        """A fix of now and its position; returns its GPS time."""
        self.fix_id += 1
        time_ns = CLOCK.now_ns()
        place = {"latitude_rad": math.radians(35.0), "longitude_rad": math.radians(137.0), "height_m": 42.0}
        known: dict[str, Any] = {**place, "covariance_enu_m2": (1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4)}
        self.bus.publish(
            "verdict",
            Verdict(
                time_ns=time_ns,
                fix_id=self.fix_id,
                verdict="confirmed" if confirmed else "erroneous",
                reason="height_agrees" if confirmed else "height_disagrees",
                **(known if confirmed else {}),
            ),
        )
        if confirmed:
            self.bus.publish(
                "position",
                Position(
                    time_ns=time_ns,
                    source="rtk",
                    usable=usable,
                    fix_id=self.fix_id,
                    yaw_rad=math.pi / 2,
                    alert_limit_m=1.5,
                    **known,
                ),
            )
        return time_ns


class Bench:
    """A router, a node, the process, and the bus."""

    def __init__(self, endpoint: str, node: Node, judge: Judge) -> None:
        self.endpoint, self.node, self.judge = endpoint, node, judge
        self.odom = node.advertise(11, ODOM)
        self.points = node.advertise(12, POINTS)
        self.receiver = node.advertise(13, RECEIVER)
        self.gnss = node.advertise(14, GNSS_POSE)
        self.ndt = node.advertise(15, NDT_POSE)
        self.imu = node.advertise(16, IMU)
        self.clock = node.advertise(17, CLOCK_TIME)

    def statuses(self) -> list[int]:
        return [message.status.status for message, _, _ in self.node.received[FIX]]

    def status(self) -> int:
        return self.statuses()[-1]

    def publish_until(self, give: Callable[[], Any], what: Callable[[], Any], why: str) -> Any:
        """Publish again and again until something is so: the first messages may precede the subscription."""

        def once() -> Any:
            give()
            time.sleep(0.05)
            return what()

        return wait_until(once, timeout_s=20.0, why=why)


@contextmanager
def running(folder: Path, *more: str) -> Iterator[Bench]:
    """`camber ros2` with these lines of settings and those below, and a node that was there before."""
    lines = (
        "domain_id = 42",
        'router = ["ENDPOINT"]',
        *more,
        "[inputs]",
        'lidar = "/lidar/points"',
        'receiver = "/gps/fix"',
        "[outputs]",
        "antenna = { x_m = 1.0, y_m = 0.5, z_m = 2.0 }",
        "origin = { latitude_deg = 35.0, longitude_deg = 137.0, height_m = 40.0 }",
    )
    with ExitStack() as stack:
        endpoint = stack.enter_context(loopback_router())
        node = Node(endpoint)
        stack.callback(node.close)
        node.subscribe(FIX, "sensor_msgs/msg/NavSatFix")
        node.subscribe(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray")
        node.subscribe(CAMBER_ODOMETRY, "nav_msgs/msg/Odometry")
        node.subscribe(TF, "tf2_msgs/msg/TFMessage")
        node.subscribe(SELECTED_POSE, "geometry_msgs/msg/PoseWithCovarianceStamped")
        node.advertise(10, TF_STATIC, kept=True)(static_frames())  # before anybody subscribes
        bus = bus_of(endpoint, "integrity")
        bus.announce()
        stack.callback(bus.close)
        config = settings_file(
            folder / "ros2.toml", endpoint, *(line.replace("ENDPOINT", endpoint) for line in lines)
        )
        stack.enter_context(camber_started("ros2", "--config", config, stdout=None, stderr=None))
        yield Bench(endpoint, node, Judge(bus))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with running(tmp_path_factory.mktemp("ros2")) as bench:
        wait_until(lambda: bench.node.received[FIX], timeout_s=60.0, why="no NavSatFix")
        yield bench


def test_a_node_and_its_topics_are_in_the_graph(bench: Bench) -> None:
    tokens = bench.node.tokens()
    (node,) = (token for token in tokens if token.endswith("/NN/%/%/camber"))
    zid = node.split("/")[2]
    assert node == f"@ros2_lv/42/{zid}/0/0/NN/%/%/camber"
    assert zid != bench.node.zid
    topics = {tuple(token.split("/")[5:]) for token in tokens if token.split("/")[2] == zid and token != node}
    described = {(kind, topic.replace("%", "/"), qos) for kind, _, _, _, topic, _, _, qos in topics}
    assert described == {
        ("MP", "/camber/fix", "::,10:,:,:,,"),
        ("MP", "/camber/pose", "::,10:,:,:,,"),
        ("MP", "/camber/odometry", "::,10:,:,:,,"),
        ("MP", "/camber/verdict", "::,10:,:,:,,"),
        ("MP", "/diagnostics", "::,10:,:,:,,"),
        ("MP", "/tf", "::,10:,:,:,,"),
        ("MS", "/lidar/points", "::,1:,:,:,,"),
        ("MS", "/odom", "::,256:,:,:,,"),
        ("MS", "/imu/data", "::,512:,:,:,,"),
        ("MS", "/gps/fix", "::,64:,:,:,,"),
        ("MS", "/tf_static", ":1:,100:,:,:,,"),
    }
    for token in tokens:
        _, _, _, _, number, kind, *_ = token.split("/")
        assert int(number) > 0 or kind == "NN"


def test_attachments_count_and_name_the_publisher_of_the_token(bench: Bench) -> None:
    (token,) = (one for one in bench.node.tokens() if "/MP/%/%/camber/%camber%fix/" in one)
    wait_until(lambda: len(bench.node.received[FIX]) >= 3, timeout_s=10.0, why="no three fixes")
    attachments = [struct.unpack("<qqB16s", attachment) for _, attachment, _ in bench.node.received[FIX]]
    sequences = [sequence for sequence, _, _, _ in attachments]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    for _, unix_ns, length, gid in attachments:
        assert abs(unix_ns - time.time_ns()) < 300 * 10**9
        assert length == 16
        assert gid == xxhash.xxh3_128(token.encode()).intdigest().to_bytes(16, "little")


def test_motion_inertial_samples_and_sweeps_come_onto_the_bus_with_gps_times(bench: Bench) -> None:
    with Subscription("sweep", "motion", "imu", vehicle="car", connect=[bench.endpoint]) as subscription:
        stamps: set[int] = set()
        received: dict[type, Any] = {}

        def give() -> None:
            unix_ns = time.time_ns()
            stamps.add(unix_ns)
            bench.odom(odometry(unix_ns, 7.5))
            bench.imu(inertial(unix_ns))
            bench.points(cloud(unix_ns - 50_000_000))

        def all_three() -> bool:
            while (message := subscription.next(0.0)) is not None:
                received[type(message)] = message
            return len(received) == 3

        bench.publish_until(give, all_three, "no motion, inertial sample and sweep")
    moved: Motion = received[Motion]
    assert (moved.wheel_speed_m_s, moved.yaw_rate_rad_s) == (7.5, 0.125)
    assert unix_ns_of(moved.time_ns) in stamps
    sample: Imu = received[Imu]
    assert (sample.angular_rate_rad_s, sample.specific_force_m_s2) == (
        (0.25, -0.5, 0.125),
        (1.5, -0.25, 9.75),
    )
    assert unix_ns_of(sample.time_ns) in stamps
    sweep: Sweep = received[Sweep]
    assert unix_ns_of(sweep.time_ns) in stamps, "the end of the sweep: its last measured point"
    np.testing.assert_array_equal(sweep.points_m, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(sweep.offset_ns, [-50_000_000, 0])


def test_positions_of_a_receiver_come_as_lines_that_gnss_reads(bench: Bench) -> None:
    with Subscription("receiver_bytes", vehicle="car", connect=[bench.endpoint]) as subscription:
        message = bench.publish_until(
            lambda: bench.receiver(receiver_fix(time.time_ns())),
            lambda: subscription.next(0.0),
            "no bytes of a receiver",
        )
    assert isinstance(message, ReceiverBytes)
    assert message.protocol == "pos"
    line = message.payload.tobytes().decode().splitlines()[-1].split()
    assert [float(text) for text in line[2:5]] == [35.0, 137.0, 52.5]
    assert line[5] == "5", "single"


def test_what_is_not_of_now_is_refused_and_reported(bench: Bench) -> None:
    before = health_of(bench.endpoint, "ros2").counters
    with Subscription("motion", vehicle="car", connect=[bench.endpoint], live=False) as subscription:
        for _ in range(3):
            bench.odom(odometry(time.time_ns() - 10 * 10**9, 1.0))
            bench.odom(odometry(time.time_ns() + 10 * 10**9, 2.0))
        fresh = bench.publish_until(
            lambda: bench.odom(odometry(time.time_ns(), 3.0)), lambda: subscription.next(0.0), "nothing fresh"
        )
        assert fresh.wheel_speed_m_s == 3.0
    health = health_of(bench.endpoint, "ros2")
    counted = {
        name: health.counters[f"ros.motion.{name}"] - before.get(f"ros.motion.{name}", 0)
        for name in ("stale", "future")
    }
    assert counted == {"stale": 3, "future": 3}
    assert "ros_stamp_refused" in {issue.code for issue in health.issues}


def test_messages_without_attachment_and_damaged_ones_are_reported(bench: Bench) -> None:
    session = bench.node.session
    attachment = struct.pack("<qqB16s", 1, time.time_ns(), 16, bytes(16))
    data = bytes(STORE.serialize_cdr(odometry(time.time_ns(), 1.0), "nav_msgs/msg/Odometry"))
    session.put(ODOM, data)
    session.put(ODOM, data[:40], attachment=attachment)
    session.put(POINTS, b"\x00\x01\x00\x00", attachment=attachment)

    def issue() -> Any:
        issues = {one.code: one for one in health_of(bench.endpoint, "ros2").issues}
        return "ros_message_refused" in issues and issues["ros_message_refused"].count >= 2

    wait_until(issue, timeout_s=10.0, why="damage was not reported")
    assert health_of(bench.endpoint, "ros2").status != "failing"


def test_static_frames_that_were_published_before_give_settings(bench: Bench) -> None:
    bench.publish_until(
        lambda: bench.points(cloud(time.time_ns() - 50_000_000)),
        lambda: "lever_arm_sweep" in health_of(bench.endpoint, "ros2").facts,
        "no lever arm",
    )
    text = health_of(bench.endpoint, "ros2").facts["lever_arm_sweep"]
    assert "lidar_x_m = 1.100; lidar_y_m = 0.000; lidar_z_m = 1.900" in text
    assert "lidar_yaw_deg = 90.00" in text


def test_a_fix_is_one_only_while_it_is_confirmed_and_usable(bench: Bench) -> None:
    judged: list[int] = []

    def give(**how: bool) -> Callable[[], None]:
        return lambda: judged.append(unix_ns_of(bench.judge.judge(**how)))

    bench.publish_until(give(confirmed=True), lambda: bench.status() >= 0, "no fix")
    message = next(one for one, _, _ in reversed(bench.node.received[FIX]) if one.status.status >= 0)
    assert message.status.status == 2
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec in judged
    assert (message.latitude, message.longitude, message.altitude) == pytest.approx((35.0, 137.0, 42.0))
    np.testing.assert_allclose(message.position_covariance.reshape(3, 3), np.diag([1e-4, 1e-4, 4e-4]))
    for how in ({"confirmed": True, "usable": False}, {"confirmed": False}):
        n = len(bench.statuses())
        for _ in range(3):
            give(**how)()
        bench.publish_until(give(**how), lambda n=n: len(bench.statuses()) > n + 3, "nothing published")
        assert set(bench.statuses()[n + 1 :]) == {-1}, how
        assert math.isnan(bench.node.received[FIX][-1][0].latitude)


def test_when_positions_cease_no_fix_comes_within_a_second(bench: Bench) -> None:
    ended = threading.Event()

    def drive() -> None:
        while not ended.wait(0.1):
            bench.judge.judge(confirmed=True)

    thread = threading.Thread(target=drive)
    thread.start()
    wait_until(lambda: bench.statuses()[-3:] == [2, 2, 2], timeout_s=20.0, why="no fixes")
    ended.set()
    thread.join()
    ceased_s = time.monotonic()
    wait_until(lambda: bench.status() == -1, timeout_s=5.0, why="still a fix")
    arrived_s = bench.node.received[FIX][-1][2]
    print(f"NO_FIX after {arrived_s - ceased_s:.3f} s")
    assert arrived_s - ceased_s < 1.0
    n = len(bench.statuses())
    time.sleep(1.2)
    assert set(bench.statuses()[n:]) == {-1}


def test_odometry_and_tf_are_of_the_base_in_a_map_with_the_origin_that_was_set(bench: Bench) -> None:
    bench.publish_until(
        lambda: bench.judge.judge(confirmed=True),
        lambda: bench.node.received[CAMBER_ODOMETRY] and bench.node.received[TF],
        "no odometry and tf",
    )
    message = bench.node.received[CAMBER_ODOMETRY][-1][0]
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    at = message.pose.pose.position
    # The vehicle looks north: the antenna, 1 m ahead and 0.5 m to the left, is north and west of the base.
    np.testing.assert_allclose((at.x, at.y, at.z), (0.5, -1.0, 0.0), atol=1e-6)
    assert message.twist.covariance[0] > 1e3
    (transform,) = bench.node.received[TF][-1][0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    moved = transform.transform.translation
    np.testing.assert_allclose((moved.x, moved.y, moved.z), (0.5, -1.0, 0.0), atol=1e-6)


def test_diagnostics_come_each_second_with_services_and_the_last_reason(bench: Bench) -> None:
    def newest() -> dict[str, Any]:
        array = bench.node.received[DIAGNOSTICS][-1][0]
        return {status.name: status for status in array.status}

    bench.publish_until(
        lambda: bench.judge.judge(confirmed=True),
        lambda: newest()["camber: position"].level == 0,
        "position never OK",
    )
    assert newest()["camber: integrity"].level == 0
    assert newest()["camber: gnss"].level == 2
    assert newest()["camber: gnss"].message == "absent"
    wait_until(
        lambda: newest()["camber: position"].level == 2, timeout_s=10.0, why="old position still shown"
    )
    n = len(bench.node.received[DIAGNOSTICS])
    time.sleep(3.3)
    assert 2 <= len(bench.node.received[DIAGNOSTICS]) - n <= 4


def test_with_simulated_time_stamps_are_those_of_the_clock_of_the_graph(tmp_path: Path) -> None:
    """As of `ros2 bag play --clock` with a bag of 2023."""
    ahead_ns = time.time_ns() - 1_700_000_000 * 10**9

    def give() -> None:
        unix_ns = time.time_ns() - ahead_ns
        stamp = new("builtin_interfaces/msg/Time", sec=unix_ns // 10**9, nanosec=unix_ns % 10**9)
        bench.clock(new("rosgraph_msgs/msg/Clock", clock=stamp))
        bench.odom(odometry(unix_ns, 7.5))
        judged.append(unix_ns_of(bench.judge.judge(confirmed=True)))

    def stamps_ns() -> list[int]:
        stamps = [fix.header.stamp for fix, _, _ in bench.node.received[FIX] if fix.status.status >= 0]
        return [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]

    judged: list[int] = []
    with running(tmp_path, "use_sim_time = true") as bench:
        wait_until(
            lambda: any("/%clock/" in token and "/MS/" in token for token in bench.node.tokens()),
            timeout_s=60.0,
            why="no subscription of the clock",
        )
        assert bench.node.received[FIX] == []
        with Subscription("motion", vehicle="car", connect=[bench.endpoint]) as subscription:
            message = bench.publish_until(give, lambda: subscription.next(0.0), "no motion")
        assert abs(unix_ns_of(message.time_ns) - time.time_ns()) < 20 * 10**9
        bench.publish_until(give, stamps_ns, "no fix")
        first_ns = stamps_ns()[0]
        assert min(abs(unix_ns - ahead_ns - first_ns) for unix_ns in judged) < 10**9


def test_autoware_gets_gnss_poses_of_confirmed_fixes_and_ndt_poses_else(tmp_path: Path) -> None:
    """The GNSS pose is at x = 1, the NDT pose at x = 2; gnss_poser keeps the stamp of the NavSatFix."""

    def selected(bench: Bench) -> list[float]:
        return [message.pose.pose.position.x for message, _, _ in bench.node.received[SELECTED_POSE]]

    def give(bench: Bench, **how: bool) -> None:
        unix_ns = unix_ns_of(bench.judge.judge(**how))
        time.sleep(0.1)
        bench.gnss(pose(unix_ns, 1.0, 0.004))
        bench.ndt(pose(time.time_ns(), 2.0, 0.2))

    with running(tmp_path, "autoware.enabled = true") as bench:
        wait_until(lambda: bench.node.received[FIX], timeout_s=60.0, why="no NavSatFix")
        bench.publish_until(
            lambda: give(bench, confirmed=False), lambda: len(selected(bench)) >= 3, "no NDT pose"
        )
        assert set(selected(bench)) == {2.0}
        bench.publish_until(
            lambda: give(bench, confirmed=True), lambda: selected(bench)[-2:] == [1.0, 1.0], "no GNSS pose"
        )
        for how in ({"confirmed": True, "usable": False}, {"confirmed": False}):
            bench.publish_until(
                lambda how=how: give(bench, **how), lambda: selected(bench)[-2:] == [2.0, 2.0], "no NDT pose"
            )
            n = len(selected(bench))
            for _ in range(3):
                give(bench, **how)
            assert set(selected(bench)[n:]) <= {2.0}, how
        assert not bench.node.received[TF]

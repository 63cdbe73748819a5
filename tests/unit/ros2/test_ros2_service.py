"""The process in a ROS graph: who is silent and why, and what settings it refuses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import camber.ros2.service
from camber.formats.ros.judged_messages import FIX_TYPE, POSE_TYPE
from camber.formats.ros.message_types import VERDICT_TYPE, message_types, new_message, stamp_unix_ns
from camber.ros2.rmw_zenoh import Attachment
from camber.ros2.service import Ros2Service
from camber.ros2.settings import Ros2Settings
from camber.runtime.bus import Bus
from camber.runtime.raw_session import AttachedBytes, BoundedSubscription
from camber.runtime.settings import ConfigError, load
from camber.schemas.base import Message
from camber.schemas.channels import inputs_of, outputs_of
from camber.schemas.integrity import Position, Verdict
from support.fake_bus import FakeBus

NS = 1_000_000_000
GRAPH_NS = 12 * NS
"""As a simulator begins, decades before this machine's time."""
DRIVER = "@ros2_lv/0/def/0/9/MP/%/%/driver/%odom/{}/{}/::,5:,:,:,,"
ODOMETRY = "nav_msgs::msg::dds_::Odometry_"
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"


class Session:
    """In place of a RawSession: tokens come by `changed`."""

    session_id = "abc"

    def __init__(self, settings: Any, wake: Callable[[], None]) -> None:
        self.connect = settings.connect
        self.closed = False
        self.published: defaultdict[str, list[bytes]] = defaultdict(list)
        self.subscriptions: dict[str, BoundedSubscription] = {}

    def declare_token(self, key: str) -> None: ...

    def watch_tokens(self, key: str, changed: Callable[[str, bool], None]) -> None:
        self.changed = changed

    def declare_publisher(self, key: str) -> Callable[[bytes, bytes], None]:
        return lambda data, attachment: self.published[topic_of(key)].append(data)

    def subscribe(self, key: str, *, limit: int, history: int = 0) -> BoundedSubscription:
        return self.subscriptions.setdefault(topic_of(key), BoundedSubscription(limit=limit))

    def close(self) -> None:
        self.closed = True


def topic_of(key: str) -> str:
    return "/" + "/".join(key.split("/")[1:-2])


class RosBus(FakeBus):
    log = SimpleNamespace(info=lambda event, **values: None)

    def wake(self) -> None: ...

    def is_alive(self, name: str) -> bool:
        return False

    def publish(self, name: str, message: Message) -> None:
        self.published.append(message)

    def __init__(self) -> None:
        super().__init__()
        self.published: list[Message] = []


class Running:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        self.passed_s = 0.0
        self.bus = RosBus()
        clock = SimpleNamespace(monotonic=lambda: self.passed_s)
        monkeypatch.setattr(camber.ros2.service, "time", clock)
        monkeypatch.setattr(camber.ros2.service, "RawSession", Session)
        self.service = Ros2Service(Ros2Settings(**settings), cast(Bus, self.bus))
        self.session = cast(Session, self.service._session)

    def give(self, topic: str, message: Any) -> None:
        data = bytes(message_types().serialize_cdr(message, message.__msgtype__))
        attachment = Attachment(sequence=1, source_unix_ns=0, gid=bytes(16)).encode()
        self.session.subscriptions[topic].put(AttachedBytes(data=data, attachment=attachment))

    def give_clock(self, graph_ns: int) -> None:
        self.give("/clock", new_message("rosgraph_msgs/msg/Clock", clock=time_at(graph_ns)))

    def stamps_ns(self, topic: str, kind: str) -> list[int]:
        """Stamps of what was published."""
        types = message_types()
        return [stamp_unix_ns(types.deserialize_cdr(data, kind)) for data in self.session.published[topic]]

    def go(self, seconds: float) -> None:
        for _ in range(round(10 * seconds)):
            self.passed_s += 0.1
            self.bus.time_ns += 100_000_000
            self.service.advance(self.bus.time_ns)


def test_a_topic_that_nobody_publishes_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    running = Running(monkeypatch)
    running.go(5.0)
    assert running.service.healthy()
    assert running.bus.issues == []


def test_a_silent_publisher_is_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    running = Running(monkeypatch)
    running.go(10.0)
    running.session.changed(DRIVER.format(ODOMETRY, ODOMETRY_HASH), True)
    running.go(1.5)
    assert running.bus.issues == []
    running.go(5.0)
    assert not running.service.healthy()
    assert running.bus.issues == [("ros_topic_silent", "/odom: nothing usable for 2 s")]
    running.session.changed(DRIVER.format(ODOMETRY, ODOMETRY_HASH), False)
    running.go(1.5)
    assert running.service.healthy()


@pytest.mark.parametrize(
    ("kind", "type_hash"), [("my_msgs::msg::dds_::Speed_", "RIHS01_0"), (ODOMETRY, "TypeHashNotSupported")]
)
def test_a_publisher_of_another_type_or_distribution_is_named(
    monkeypatch: pytest.MonkeyPatch, kind: str, type_hash: str
) -> None:
    running = Running(monkeypatch)
    running.session.changed(DRIVER.format(kind, type_hash), True)
    running.go(5.0)
    assert f"published as {kind} {type_hash}, expected {ODOMETRY} {ODOMETRY_HASH}" in running.bus.text(
        "ros_topic_silent"
    )


def time_at(graph_ns: int) -> Any:
    return new_message("builtin_interfaces/msg/Time", sec=graph_ns // NS, nanosec=graph_ns % NS)


def twist(graph_ns: int) -> Any:
    zero, speed = (new_message("geometry_msgs/msg/Vector3", x=x, y=0.0, z=0.0) for x in (0.0, 7.5))
    return new_message(
        "geometry_msgs/msg/TwistStamped",
        header=new_message("std_msgs/msg/Header", stamp=time_at(graph_ns), frame_id="base_link"),
        twist=new_message("geometry_msgs/msg/Twist", linear=speed, angular=zero),
    )


def simulated(monkeypatch: pytest.MonkeyPatch) -> Running:
    return Running(monkeypatch, use_sim_time=True, inputs={"motion_type": "geometry_msgs/msg/TwistStamped"})


def test_before_simulated_time_begins_nothing_is_taken_or_published_and_that_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    running = simulated(monkeypatch)
    running.give("/odom", twist(GRAPH_NS))
    running.go(5.0)
    assert running.bus.published == []
    assert not any(running.session.published.values())
    assert running.bus.issues == [("ros_topic_silent", "/clock: nothing usable for 2 s")]
    assert not running.service.healthy()


def test_stamps_of_simulated_time_come_in_and_go_out_shifted(monkeypatch: pytest.MonkeyPatch) -> None:
    running = simulated(monkeypatch)
    running.give_clock(GRAPH_NS)
    running.give("/odom", twist(GRAPH_NS - NS // 10))
    running.go(0.1)
    (message,) = running.bus.published
    assert message.time_ns == running.bus.time_ns - NS // 10
    assert running.bus.issues == []
    verdict = Verdict(time_ns=message.time_ns, fix_id=1, verdict="erroneous", reason="none")
    running.service.handlers()["verdict"](verdict)
    assert running.stamps_ns("/camber/verdict", VERDICT_TYPE) == [GRAPH_NS - NS // 10]
    assert running.stamps_ns("/camber/fix", FIX_TYPE)[-1] == GRAPH_NS - NS // 10


def test_a_pose_of_a_confirmed_fix_is_known_by_its_simulated_stamp_and_passed_on_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    running = Running(monkeypatch, use_sim_time=True, autoware={"enabled": True})
    running.give_clock(GRAPH_NS)
    running.go(0.1)
    time_ns = running.bus.time_ns
    place: dict[str, Any] = {
        "latitude_rad": 0.61, "longitude_rad": 2.39, "height_m": 42.0,
        "covariance_enu_m2": (1e-4, 0.0, 0.0, 1e-4, 0.0, 4e-4),
    }  # fmt: skip
    verdict = Verdict(time_ns=time_ns, fix_id=1, verdict="confirmed", reason="height_agrees", **place)
    position = Position(time_ns=time_ns, source="rtk", usable=True, fix_id=1, alert_limit_m=1.5, **place)
    running.service.handlers()["verdict"](verdict)
    running.service.handlers()["position"](position)
    (stamp_ns,) = running.stamps_ns("/camber/fix", FIX_TYPE)[-1:]
    assert stamp_ns == GRAPH_NS
    for graph_ns in (stamp_ns + 1, stamp_ns):  # the first is of no fix
        running.give("/sensing/gnss/pose_with_covariance", exact_pose(graph_ns))
        running.go(0.1)
    output = "/localization/pose_estimator/pose_with_covariance"
    assert running.stamps_ns(output, POSE_TYPE) == [stamp_ns]


def exact_pose(graph_ns: int) -> Any:
    at = new_message("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
    turn = new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pose = new_message("geometry_msgs/msg/Pose", position=at, orientation=turn)
    covariance = np.eye(6).reshape(-1) * 1e-6
    return new_message(
        POSE_TYPE,
        header=new_message("std_msgs/msg/Header", stamp=time_at(graph_ns), frame_id="map"),
        pose=new_message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
    )


def test_a_step_of_simulated_time_is_reported_and_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    running = simulated(monkeypatch)
    for graph_ns in (GRAPH_NS, GRAPH_NS + NS // 10, GRAPH_NS - 60 * NS):
        running.give_clock(graph_ns)
        running.go(0.1)
    assert running.bus.issues == [("ros_clock_stepped", "-60.200 s off the time expected")]
    running.give("/odom", twist(GRAPH_NS - 60 * NS))
    running.go(0.1)
    (message,) = running.bus.published
    assert message.time_ns == running.bus.time_ns - NS // 10


def test_the_graph_is_left_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    running = Running(monkeypatch, router=["tcp/127.0.0.1:9"])
    assert running.session.connect == ["tcp/127.0.0.1:9"]
    running.service.close()
    assert running.session.closed


def test_it_publishes_as_sensors_do_and_receives_as_a_consumer() -> None:
    assert {channel.name for channel in inputs_of("ros2")} == {"verdict", "position"}
    assert {"sweep", "motion", "receiver_bytes"} <= {channel.name for channel in outputs_of("ros2")}


@pytest.mark.parametrize(
    ("argument", "part"),
    [
        ("--inputs.lidar=points", "inputs.lidar"),
        ("--inputs.motion-type=std_msgs/msg/String", "inputs.motion_type"),
        ("--outputs.prefix=", "outputs.prefix"),
        ("--domain-id=233", "domain_id"),
        ("--distribution=foxy", "distribution"),
        ("--clock=replay", "clock"),
        ("--node=my/node", "node"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(argument: str, part: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(Ros2Settings, [argument], prog="camber ros2")
    assert part.replace("_", "-") in str(refused.value).replace("_", "-")
    assert "\n" not in str(refused.value)

"""The process in a ROS graph: who is silent and why, and what settings it refuses."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

import camber.ros2.service
from camber.ros2.service import Ros2Service
from camber.ros2.settings import Ros2Settings
from camber.runtime.bus import Bus
from camber.runtime.raw_session import BoundedSubscription
from camber.runtime.settings import ConfigError, load
from camber.schemas.base import Message
from camber.schemas.channels import inputs_of, outputs_of
from support.fake_bus import FakeBus

DRIVER = "@ros2_lv/0/def/0/9/MP/%/%/driver/%odom/{}/{}/::,5:,:,:,,"
ODOMETRY = "nav_msgs::msg::dds_::Odometry_"
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"


class Session:
    """In place of a RawSession: tokens come by `changed`."""

    session_id = "abc"

    def __init__(self, settings: Any, wake: Callable[[], None]) -> None:
        self.connect = settings.connect
        self.closed = False

    def declare_token(self, key: str) -> None: ...

    def watch_tokens(self, key: str, changed: Callable[[str, bool], None]) -> None:
        self.changed = changed

    def declare_publisher(self, key: str) -> Callable[[bytes, bytes], None]:
        return lambda data, attachment: None

    def subscribe(self, key: str, *, limit: int, history: int = 0) -> BoundedSubscription:
        return BoundedSubscription(limit=limit)

    def close(self) -> None:
        self.closed = True


class RosBus(FakeBus):
    log = SimpleNamespace(info=lambda event, **values: None)

    def wake(self) -> None: ...

    def is_alive(self, name: str) -> bool:
        return False

    def publish(self, name: str, message: Message) -> None:
        raise AssertionError("nothing came")


class Running:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        self.passed_s = 0.0
        self.bus = RosBus()
        clock = SimpleNamespace(monotonic=lambda: self.passed_s)
        monkeypatch.setattr(camber.ros2.service, "time", clock)
        monkeypatch.setattr(camber.ros2.service, "RawSession", Session)
        self.service = Ros2Service(Ros2Settings(**settings), cast(Bus, self.bus))
        self.session = cast(Session, self.service._session)

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

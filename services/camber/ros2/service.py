"""The process in a ROS 2 graph: sensors of ROS go to the bus, verdicts and positions of the bus to ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from camber.formats.errors import FormatError
from camber.formats.ros.judged_messages import (
    DIAGNOSTICS_TYPE,
    FIX_TYPE,
    POSE_TYPE,
    usable_place,
    verdict_message,
)
from camber.formats.ros.message_types import VERDICT_TYPE, stamp_unix_ns
from camber.formats.ros.sensor_messages import IMU_TYPE
from camber.formats.ros.static_frames import StaticFrames
from camber.geodesy.gps_time import NS_PER_SECOND, unix_ns_from_gps_ns
from camber.geodesy.local_frame import LocalFrame
from camber.ros2.graph import RosGraph, RosPublisher, RosSubscription
from camber.ros2.graph_time import GraphTime
from camber.ros2.judged_outputs import (
    FixOutput,
    base_pose,
    child_frame,
    diagnostics,
    odometry_message,
    origin_text,
    transform_message,
    with_stamps_before,
)
from camber.ros2.pose_selection import PoseLimits, PoseSelection
from camber.ros2.rmw_zenoh import GraphNode
from camber.ros2.sensor_inputs import SensorTopic, StampError, lever_arm_settings
from camber.ros2.settings import Ros2Settings
from camber.runtime.bus import Bus
from camber.runtime.raw_session import RawSession
from camber.runtime.service import Service
from camber.runtime.settings import ZenohSettings
from camber.schemas.channels import BY_NAME, SENSORS, VEHICLE_SERVICES
from camber.schemas.integrity import Position, Verdict

_LIMITS = {"sweep": 1, "motion": 256, "imu": 512, "receiver_bytes": 64}
"""Messages that wait. Chosen: of sweeps the newest, as on the bus; of the others half a second and more."""
_POSES = 64  # chosen: as those
_STATIC_FRAMES = 100  # depth with which tf2 subscribes to /tf_static
_NO_FIX_AFTER_NS = NS_PER_SECOND // 2
"""Without a fix. Chosen: five epochs, so that NO_FIX comes well within a second of the last one."""
_DIAGNOSTICS_EVERY_S = 1.0  # as diagnostic_updater publishes
_TF_TYPE = "tf2_msgs/msg/TFMessage"
_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"


class Ros2Service(Service[Ros2Settings]):
    """Joins the graph as one node; what comes from it is refused where its stamp is not of now."""

    NAME = "ros2"
    SETTINGS = Ros2Settings

    def __init__(self, settings: Ros2Settings, bus: Bus) -> None:
        super().__init__(settings, bus)
        bus.log.info("joins_the_graph", router=settings.router)  # a client waits for its router
        zenoh = ZenohSettings(mode=settings.mode, connect=settings.router)
        self._session = RawSession(zenoh, bus.wake)
        node = GraphNode(
            domain_id=settings.domain_id, session_id=self._session.session_id, name=settings.node
        )
        self._graph = RosGraph(self._session, node, hashed=settings.distribution != "humble")
        self._fix = FixOutput(_NO_FIX_AFTER_NS)
        self._frame = settings.map_frame()
        self._frames = StaticFrames()
        self._position: Position | None = None
        self._facts: dict[str, str] = {}
        self._diagnosed_s = -math.inf
        self._silent: frozenset[str] = frozenset()  # topics with a publisher
        self._publishers = self._advertised()
        self._time = GraphTime(simulated=settings.use_sim_time)
        self._clock = self._graph.subscribe(_CLOCK, _CLOCK_TYPE, limit=1) if settings.use_sim_time else None
        self._sensors = self._subscribed()
        self._given_s = {topic.name: time.monotonic() for topic, _ in self._sensors}
        self._given_s[_CLOCK] = time.monotonic()
        self._static = self._graph.subscribe(
            "/tf_static", _TF_TYPE, limit=_STATIC_FRAMES, history=_STATIC_FRAMES
        )
        self._selection, self._poses = self._autoware()

    def _advertised(self) -> dict[str, RosPublisher]:
        outputs = self.settings.outputs
        kinds = {
            "fix": FIX_TYPE,
            "pose": POSE_TYPE,
            "odometry": "nav_msgs/msg/Odometry",
            "verdict": VERDICT_TYPE,
        }
        topics = {name: (f"{outputs.prefix}/{name}", kind) for name, kind in kinds.items()}
        topics["diagnostics"] = ("/diagnostics", DIAGNOSTICS_TYPE)
        # In Autoware ekf_localizer publishes it.
        if outputs.tf and outputs.antenna is not None and not self.settings.autoware.enabled:
            topics["tf"] = ("/tf", _TF_TYPE)
        if self.settings.autoware.enabled:
            topics["autoware"] = (self.settings.autoware.output, POSE_TYPE)
        return {name: self._graph.advertise(*topic) for name, topic in topics.items()}

    def _subscribed(self) -> list[tuple[SensorTopic, RosSubscription]]:
        inputs = self.settings.inputs
        topics = (
            SensorTopic(name=inputs.lidar, kind=inputs.lidar_type, channel="sweep"),
            SensorTopic(name=inputs.motion, kind=inputs.motion_type, channel="motion"),
            SensorTopic(name=inputs.imu, kind=IMU_TYPE, channel="imu"),
            SensorTopic(name=inputs.receiver, kind=inputs.receiver_type, channel="receiver_bytes"),
        )
        return [
            (topic, self._graph.subscribe(topic.name, topic.kind, limit=_LIMITS[topic.channel]))
            for topic in topics
            if topic.name
        ]

    def _autoware(self) -> tuple[PoseSelection, dict[str, RosSubscription]]:
        settings = self.settings.autoware
        limits = PoseLimits(
            most_yaw_rad=math.radians(settings.most_yaw_sigma_deg),
            most_height_m=settings.most_height_sigma_m,
            gnss_alone_m=settings.gnss_alone_sigma_m,
            most_horizontal_m=settings.most_horizontal_sigma_m,
            timeout_s=BY_NAME["position"].max_age_s or 1.0,
        )
        topics = {"gnss": settings.gnss, "ndt": settings.ndt} if settings.enabled else {}
        poses = {
            name: self._graph.subscribe(topic, POSE_TYPE, limit=_POSES) for name, topic in topics.items()
        }
        return PoseSelection(limits), poses

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs from the bus."""
        return {"verdict": self._take_verdict, "position": self._take_position}

    def advance(self, now_ns: int) -> None:
        """Give to the bus what has come from ROS, and to ROS what is due by the clock."""
        self._take_clock(now_ns)
        self._take_static_frames()
        for topic, subscription in self._sensors:
            self._take_sensor(topic, subscription, now_ns)
        self._select_poses(now_ns)
        self._publish("fix", self._fix.due(now_ns))
        if time.monotonic() - self._diagnosed_s >= _DIAGNOSTICS_EVERY_S:
            self._diagnosed_s = time.monotonic()
            self._report_silent()
            self._publish("diagnostics", self._diagnostics(now_ns))

    def healthy(self) -> bool:
        """Does every topic that has a publisher give something?"""
        return not self._silent

    def facts(self) -> dict[str, str]:
        """Origin of `map`, and settings of lever arms by tf_static."""
        return self._facts

    def close(self) -> None:
        """Leave the graph."""
        self._session.close()

    def _take_verdict(self, verdict: Verdict) -> None:
        self._publish("verdict", verdict_message(verdict))
        self._publish("fix", self._fix.of_verdict(verdict, self.bus.now_ns()))

    def _take_position(self, position: Position) -> None:
        self._position = position
        fix, trusted = self._fix.of_position(position, self.bus.now_ns())
        if trusted:
            self._selection.add_trusted(unix_ns_from_gps_ns(position.time_ns))
        self._publish("fix", fix)
        place, outputs = usable_place(position), self.settings.outputs
        if place is None:
            return
        if self._frame is None:
            self._frame = LocalFrame(*place)
        self._note("map_origin", origin_text(self._frame))
        pose = base_pose(position, self._frame, outputs.antenna, outputs.map_frame)
        if pose is None:
            self.bus.count("pose.without_yaw")
            return
        self._publish("pose", pose)
        frame_id = child_frame(outputs.antenna, outputs.base_frame)
        self._publish("odometry", odometry_message(pose, frame_id))
        if "tf" in self._publishers:
            self._publish("tf", transform_message(pose, frame_id))

    def _take_clock(self, now_ns: int) -> None:
        """Take the newest time of `/clock`, where the graph's time is simulated."""
        for message in [] if self._clock is None else self._messages(self._clock):
            self._given_s[_CLOCK] = time.monotonic()
            clock_ns = int(message.clock.sec) * NS_PER_SECOND + int(message.clock.nanosec)
            step_s = self._time.set(clock_ns, unix_ns_from_gps_ns(now_ns))
            if step_s is not None:
                self.bus.issue("ros_clock_stepped", f"{step_s:+.3f} s off the time expected")

    def _take_static_frames(self) -> None:
        for message in self._messages(self._static):
            try:
                self._frames.add(message)
            except ValueError as error:
                self.bus.issue("ros_message_refused", f"/tf_static: {error}")
        for topic, _ in self._sensors:
            text = lever_arm_settings(self._frames, self.settings.outputs.base_frame, topic)
            if text is not None:
                self._note(f"lever_arm_{topic.channel}", text)

    def _take_sensor(self, topic: SensorTopic, subscription: RosSubscription, now_ns: int) -> None:
        ahead_ns = self._time.ahead_ns
        for content in self._messages(subscription):
            if ahead_ns is None:
                continue
            try:
                name = self.settings.inputs.lidar_name
                message = topic.message(content, now_ns, name, ahead_ns=ahead_ns)
            except StampError as error:
                self.bus.issue("ros_stamp_refused", str(error))
            except FormatError as error:
                self.bus.issue("ros_message_refused", str(error))
            else:
                self._given_s[topic.name] = time.monotonic()
                if message is not None:
                    self.bus.publish(topic.channel, message)
        counts = {**topic.counts, "lost": subscription.lost, "dropped": subscription.received.dropped}
        counts["refused"] = subscription.refused
        for what, n in counts.items():
            name = f"ros.{topic.channel}.{what}"
            self.bus.count(name, n - self.bus.counters[name])

    def _select_poses(self, now_ns: int) -> None:
        now_unix_ns = unix_ns_from_gps_ns(now_ns)
        for name, subscription in self._poses.items():
            for pose in self._messages(subscription):
                if name == "gnss":
                    stamp_ns = stamp_unix_ns(pose) + (self._time.ahead_ns or 0)
                    selected = self._selection.gnss(pose, stamp_ns, now_unix_ns)
                else:
                    selected = self._selection.ndt(pose, now_unix_ns)
                self._publish("autoware", selected, stamped=True)

    def _messages(self, subscription: RosSubscription) -> list[Any]:
        refused = subscription.refused
        messages = subscription.take()
        if subscription.refused > refused:
            self.bus.issue("ros_message_refused", subscription.refusal)
        return messages

    def _publish(self, name: str, message: Any | None, *, stamped: bool = False) -> None:
        """Publish a message with the graph's time; `stamped`: it has that already."""
        ahead_ns = self._time.ahead_ns
        if message is not None and ahead_ns is not None:
            graph_message = message if stamped or not ahead_ns else with_stamps_before(message, ahead_ns)
            self._publishers[name].publish(graph_message)

    def _note(self, name: str, text: str) -> None:
        if self._facts.get(name) != text:
            self._facts[name] = text
            self.bus.log.info(name, settings=text)

    def _diagnostics(self, now_ns: int) -> Any:
        limit_ns = (BY_NAME["position"].max_age_s or 0.0) * NS_PER_SECOND
        fresh = self._position is not None and now_ns - self._position.time_ns <= limit_ns
        services = {name: self.bus.is_alive(name) for name in VEHICLE_SERVICES}
        if self.bus.is_alive(SENSORS):
            services[SENSORS] = True
        facts = dict(self._facts)
        if self._poses:
            facts["pose_source"] = self._selection.source(unix_ns_from_gps_ns(now_ns))
        return diagnostics(
            self._position if fresh else None, services, facts, now_ns=now_ns, vehicle=self.settings.vehicle
        )

    def _report_silent(self) -> None:
        now_s, silent = time.monotonic(), set[str]()
        subscriptions = [subscription for _, subscription in self._sensors]
        for subscription in subscriptions if self._clock is None else [self._clock, *subscriptions]:
            name = subscription.topic.name
            publishers = self._graph.publishers_of(name)
            if not publishers and subscription is not self._clock:  # without simulated time nothing works
                self._given_s[name] = now_s
            if now_s - self._given_s[name] <= self.settings.inputs.silence_s:
                continue
            silent.add(name)
            if name in self._silent:
                continue
            expected = subscription.topic.dds_type, subscription.topic.type_hash
            others = {publisher[1:] for publisher in publishers} - {expected}
            text = f"{name}: nothing usable for {self.settings.inputs.silence_s:g} s"
            if others:
                text += f"; published as {' '.join(min(others))}, expected {' '.join(expected)}"
            self.bus.issue("ros_topic_silent", text)
        self._silent = frozenset(silent)


SERVICE = Ros2Service

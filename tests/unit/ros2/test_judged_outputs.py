"""No ROS message claims more than the judge has: FIX only where confirmed and usable, poses only where usable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.formats.ros.judged_messages import fix_message, verdict_message
from camber.formats.ros.message_types import message_types, stamp_unix_ns
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.ros2.judged_outputs import (
    FixOutput,
    base_pose,
    diagnostics,
    odometry_message,
    origin_text,
    transform_message,
    with_stamps_before,
)
from camber.schemas.integrity import Position, Verdict
from camber.schemas.motion import LeverArm

NS = 1_000_000_000
NOW_NS = 1_400_000_000 * NS
PLACE: dict[str, Any] = {
    "latitude_rad": 0.61,
    "longitude_rad": 2.39,
    "height_m": 42.0,
    "covariance_enu_m2": (0.01, 0.0, 0.0, 0.01, 0.0, 0.04),
}
FRAME = LocalFrame(0.61, 2.39, 42.0)
SILENCE_NS = NS // 2


def verdict(value: Any, fix_id: int = 7, time_ns: int = NOW_NS) -> Verdict:
    place = PLACE if value.startswith("confirmed") else {}
    return Verdict(time_ns=time_ns, fix_id=fix_id, verdict=value, reason="none", **place)


def position(**values: Any) -> Position:
    default: dict[str, Any] = {
        "time_ns": NOW_NS,
        "source": "rtk",
        "usable": True,
        "fix_id": 7,
        "alert_limit_m": 1.5,
        **PLACE,
    }
    return Position(**{**default, **values})


@pytest.mark.parametrize("value", ["confirmed", "confirmed_after_verification"])
def test_a_confirmed_and_usable_fix_has_a_position(value: str) -> None:
    output = FixOutput(SILENCE_NS)
    assert output.of_verdict(verdict(value), NOW_NS) is None
    message, trusted = output.of_position(position(), NOW_NS)
    assert trusted
    assert message.status.status == 2
    assert message.latitude == pytest.approx(math.degrees(0.61))


@pytest.mark.parametrize(
    ("values", "published"),
    [
        ({"usable": False}, True),
        ({"covariance_enu_m2": None}, True),
        ({"time_ns": NOW_NS + 1}, True),
        ({"source": "doppler"}, False),
        ({"fix_id": 8}, False),
        ({"source": "none", "usable": False, "fix_id": None}, False),
    ],
)
def test_another_position_makes_no_fix(values: dict[str, Any], published: bool) -> None:
    output = FixOutput(SILENCE_NS)
    output.of_verdict(verdict("confirmed"), NOW_NS)
    message, trusted = output.of_position(position(**values), NOW_NS)
    assert not trusted
    assert (message is not None) == published
    assert message is None or (message.status.status == -1 and math.isnan(message.latitude))


def test_a_position_without_its_verdict_makes_no_fix() -> None:
    output = FixOutput(SILENCE_NS)
    assert output.of_position(position(), NOW_NS) == (None, False)
    output.of_verdict(verdict("confirmed"), NOW_NS)
    output.of_position(position(), NOW_NS)
    assert output.of_position(position(), NOW_NS) == (None, False), "a verdict counts once"
    output.of_verdict(verdict("confirmed", fix_id=8), NOW_NS)
    output.of_verdict(verdict("unknown", fix_id=9), NOW_NS)
    assert output.of_position(position(fix_id=8), NOW_NS) == (None, False)


def test_silence_is_no_fix() -> None:
    output = FixOutput(SILENCE_NS)
    assert output.due(NOW_NS).status.status == -1
    output.of_verdict(verdict("confirmed"), NOW_NS)
    output.of_position(position(), NOW_NS)
    assert output.due(NOW_NS + SILENCE_NS - 1) is None
    message = output.due(NOW_NS + SILENCE_NS)
    assert message.status.status == -1
    assert output.due(NOW_NS + SILENCE_NS + 1) is None
    assert output.due(NOW_NS).status.status == -1, "the clock was set back"


@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("verdict"), st.sampled_from(["confirmed", "erroneous", "unknown"])),
            st.tuples(st.sampled_from(["position", "due"]), st.booleans()),
        ),
        max_size=30,
    )
)
def test_whatever_comes_a_fix_follows_its_verdict_and_its_usable_position(steps: list[Any]) -> None:
    output, now_ns, fix_id, last = FixOutput(SILENCE_NS), NOW_NS, 0, ""
    for step, how in steps:
        now_ns += NS // 10
        message, expected = None, False
        if step == "verdict":
            fix_id += 1
            message, last = output.of_verdict(verdict(how, fix_id, now_ns), now_ns), how
            at_ns = now_ns
        elif step == "position" and fix_id:
            message, _ = output.of_position(position(fix_id=fix_id, usable=how, time_ns=at_ns), now_ns)
            expected, last = last == "confirmed" and how, ""
        elif step == "due":
            message = output.due(now_ns)
        assert (message is not None and message.status.status >= 0) == expected


@given(st.floats(-math.pi, math.pi), *(st.floats(-5.0, 5.0) for _ in range(3)))
def test_the_base_is_where_the_lever_arm_leads(yaw_rad: float, x_m: float, y_m: float, z_m: float) -> None:
    antenna = LeverArm(x_m=x_m, y_m=y_m, z_m=z_m)
    message = base_pose(position(yaw_rad=yaw_rad), FRAME, antenna, "map")
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    rotation = rotation_from_roll_pitch_yaw(0.0, 0.0, 2.0 * math.atan2(turn.z, turn.w))
    np.testing.assert_allclose((at.x, at.y, at.z) + rotation @ (x_m, y_m, z_m), np.zeros(3), atol=1e-6)


def test_no_pose_is_published_of_what_is_not_usable_or_has_no_direction() -> None:
    antenna = LeverArm(x_m=1.0)
    assert base_pose(position(usable=False, yaw_rad=0.0), FRAME, antenna, "map") is None
    assert base_pose(position(), FRAME, antenna, "map") is None
    alone = base_pose(position(), FRAME, None, "world")
    assert alone.header.frame_id == "world"
    assert alone.pose.covariance[35] == pytest.approx(math.pi**2 / 3), "any direction"


def test_odometry_and_tf_have_the_pose_and_no_velocity() -> None:
    pose = base_pose(position(yaw_rad=0.5), FRAME, LeverArm(z_m=1.5), "map")
    odometry = odometry_message(pose, "base_link")
    assert odometry.pose is pose.pose
    assert (np.diag(odometry.twist.covariance.reshape(6, 6)) >= 1e6).all()
    (transform,) = transform_message(pose, "base_link").transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    assert transform.transform.translation.z == pytest.approx(-1.5)


def test_diagnostics_name_what_is_absent() -> None:
    services = {"gnss": True, "localizer": False}
    array = diagnostics(None, services, {"map_origin": "here"}, now_ns=NOW_NS, vehicle="car")
    levels = {status.name: status.level for status in array.status}
    assert levels == {"camber: position": 2, "camber: gnss": 0, "camber: localizer": 2, "camber: ros2": 0}
    assert [(value.key, value.value) for value in array.status[-1].values] == [("map_origin", "here")]
    unusable = position(source="none", usable=False, reason="pose_stale")
    array = diagnostics(unusable, services, {}, now_ns=NOW_NS, vehicle="car")
    assert array.status[0].level == 1
    assert "pose_stale" in array.status[0].message


def test_the_origin_is_written_as_a_setting() -> None:
    text = origin_text(LocalFrame(math.radians(35.123456789), math.radians(-137.5), 40.0))
    assert text == "latitude_deg = 35.123456789, longitude_deg = -137.500000000, height_m = 40.000"


@pytest.mark.parametrize("ahead_ns", [1, 3 * NS // 2, NOW_NS])
def test_stamps_are_shifted_to_the_time_of_the_graph_and_nothing_else(ahead_ns: int) -> None:
    pose = base_pose(position(yaw_rad=0.5), FRAME, LeverArm(x_m=1.0, y_m=0.0, z_m=2.0), "map")
    messages = [
        verdict_message(verdict("confirmed")),
        fix_message(verdict("confirmed")),
        pose,
        odometry_message(pose, "base_link"),
        diagnostics(position(), {}, {}, now_ns=NOW_NS, vehicle="car"),
    ]
    stamps_ns = [stamp_unix_ns(message) for message in messages]
    for message, stamp_ns in zip(messages, stamps_ns, strict=True):
        shifted = with_stamps_before(message, ahead_ns)
        assert stamp_unix_ns(shifted) == stamp_ns - ahead_ns
        assert stamp_unix_ns(message) == stamp_ns
        assert serialized(with_stamps_before(shifted, -ahead_ns)) == serialized(message)
    (transform,) = with_stamps_before(transform_message(pose, "base_link"), ahead_ns).transforms
    assert stamp_unix_ns(transform) == stamp_unix_ns(pose) - ahead_ns


def serialized(message: Any) -> bytes:
    return bytes(message_types().serialize_cdr(message, message.__msgtype__))

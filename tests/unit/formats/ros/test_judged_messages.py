"""What ROS consumers get of a verdict or a position: nothing that may not be used looks as if it may."""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
import pytest

from camber.formats.ros import judged_messages as judged
from camber.formats.ros.message_types import VERDICT_TYPE, message_types, stamp_unix_ns
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.integrity import Position, Verdict, VerdictValue

T = 1_400_000_000_250_000_000
COVARIANCE = (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)
MATRIX = [1.0, 0.1, 0.2, 0.1, 2.0, 0.3, 0.2, 0.3, 3.0]
PLACE: dict[str, Any] = {"latitude_rad": 0.6, "longitude_rad": 2.4, "height_m": 50.0}
FRAME = LocalFrame(0.6, 2.4, 49.0)


def verdict(value: str, **changes: Any) -> Verdict:
    values = {"fix_id": 7, "reason": "height_agrees", **PLACE, "covariance_enu_m2": COVARIANCE} | changes
    return Verdict(time_ns=T, verdict=value, **values)


def position(**changes: Any) -> Position:
    values = {"source": "rtk", "usable": True, "alert_limit_m": 1.5, **PLACE, "covariance_enu_m2": COVARIANCE}
    return Position(time_ns=T, **values | changes)


def through_cdr(message: Any, kind: str) -> Any:
    """As a subscriber gets it."""
    return message_types().deserialize_cdr(message_types().serialize_cdr(message, kind), kind)


@pytest.mark.parametrize("value", get_args(VerdictValue))
def test_a_nav_sat_fix_has_a_status_and_a_position_only_where_the_fix_is_confirmed(value: str) -> None:
    message = through_cdr(judged.fix_message(verdict(value)), judged.FIX_TYPE)
    assert stamp_unix_ns(message) == unix_ns_from_gps_ns(T)
    if value.startswith("confirmed"):
        assert message.status.status == 2
        assert (message.latitude, message.longitude) == (math.degrees(0.6), math.degrees(2.4))
        assert message.position_covariance.tolist() == MATRIX
        assert message.position_covariance_type == 3
    else:
        assert message.status.status == -1
        assert np.isnan([message.latitude, message.longitude, message.altitude]).all()
        assert message.position_covariance_type == 0


@pytest.mark.parametrize("value", get_args(VerdictValue))
def test_a_verdict_keeps_its_value_and_what_it_rests_on(value: str) -> None:
    given = verdict(value, height_difference_m=0.03, evidence=("height", "position"), trials=2)
    message = through_cdr(judged.verdict_message(given), VERDICT_TYPE)
    names = {message.UNKNOWN: "unknown", message.CONFIRMED: "confirmed", message.ERRONEOUS: "erroneous"}
    names[message.CONFIRMED_AFTER_VERIFICATION] = "confirmed_after_verification"
    assert names[message.verdict] == value
    assert (message.has_fix, message.fix_id, message.reason, message.trials) == (True, 7, "height_agrees", 2)
    assert message.evidence == ["height", "position"]
    assert message.height_difference_m == 0.03
    assert math.isnan(message.tolerance_m)
    if value.startswith("confirmed"):
        assert message.covariance_enu_m2.tolist() == MATRIX
        assert (message.latitude_deg, message.height_m) == (math.degrees(0.6), 50.0)
    else:
        assert np.isnan([message.latitude_deg, message.longitude_deg, message.height_m]).all()
        assert np.isnan(message.covariance_enu_m2).all()


def test_a_verdict_on_an_epoch_without_fix_says_so_and_knows_no_position() -> None:
    epoch = Verdict(time_ns=T, fix_id=None, verdict="unknown", reason="gnss_stale")
    message = through_cdr(judged.verdict_message(epoch), VERDICT_TYPE)
    assert (message.has_fix, message.verdict) == (False, message.UNKNOWN)
    assert np.isnan([message.latitude_deg, message.height_m, *message.position_difference_m]).all()
    assert np.isnan(message.covariance_enu_m2).all()


def test_unknown_is_the_value_of_a_message_that_nobody_filled() -> None:
    assert message_types().types[VERDICT_TYPE].UNKNOWN == 0


def test_a_pose_is_in_map_with_the_covariance_of_the_position() -> None:
    given = position(yaw_rad=math.pi / 2.0)
    place = judged.usable_place(given)
    assert place is not None
    message = through_cdr(judged.pose_message(given, place, FRAME), judged.POSE_TYPE)
    assert message.header.frame_id == "map"
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx((0.0, 0.0, 1.0), abs=1e-8)
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    covariance = message.pose.covariance.reshape(6, 6)
    assert covariance[:3, :3].reshape(-1).tolist() == MATRIX
    assert np.diag(covariance)[3:].tolist() == [math.pi**2 / 3.0] * 3


@pytest.mark.parametrize(
    "changes", [{"usable": False}, {"latitude_rad": None}, {"height_m": None}, {"covariance_enu_m2": None}]
)
def test_a_position_that_may_not_be_used_or_is_not_whole_has_no_place(changes: dict[str, Any]) -> None:
    assert judged.usable_place(position(**changes)) is None


def test_diagnostics_are_ok_only_where_the_position_may_be_used() -> None:
    (ok,) = through_cdr(judged.diagnostics_message(position(), "car"), judged.DIAGNOSTICS_TYPE).status
    assert (int(ok.level), ok.name, ok.hardware_id) == (0, "camber: position", "car")
    refused = position(usable=False, source="none", reason="pose_stale")
    (warning,) = through_cdr(judged.diagnostics_message(refused, "car"), judged.DIAGNOSTICS_TYPE).status
    assert (int(warning.level), warning.message) == (1, "not usable: pose_stale")
    assert {pair.key: pair.value for pair in warning.values}["alert_limit_m"] == "1.5"


def test_type_hashes_are_those_of_ros() -> None:
    types = message_types()
    # std_msgs/String as `ros2 topic info -v` prints it; ours changes with its definition, which consumers build.
    assert types.hash_rihs01("std_msgs/msg/String").startswith(
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db128"
    )
    ours = "RIHS01_ff7be3c26539be2b44887d2bbe0a87f76d4c177e9c83e6b0593c9a3465cf3529"
    assert types.hash_rihs01(VERDICT_TYPE) == ours

"""Positions and motion of ROS messages: a fix only where the message says so, and unknown is no zero."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.formats.ros.sensor_messages import GPS_FIXES, NAV_SAT_FIX, imu_of, motion_of, solution_of
from camber.schemas.motion import Imu, Motion

T = 1_400_000_000_000_000_000
COVARIANCE = np.array([4.0, 0.1, 0.2, 0.1, 5.0, 0.3, 0.2, 0.3, 9.0])


def fix(status: int, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "status": SimpleNamespace(status=status, satellites_used=11),
        "latitude": 35.0,
        "longitude": -137.0,
        "altitude": 41.5,
        "position_covariance": COVARIANCE,
        "position_covariance_type": 3,
    }
    return SimpleNamespace(**values | changes)


def solved(kind: str, status: int, **changes: Any) -> ReceiverSolution | None:
    return solution_of(fix(status, **changes), T, kind, "/fix")


@pytest.mark.parametrize(
    ("status", "quality"),
    [(0, SolutionQuality.SINGLE), (1, SolutionQuality.SBAS), (2, SolutionQuality.DGPS)],
)
def test_a_nav_sat_fix_is_never_a_fix_with_resolved_integers(status: int, quality: SolutionQuality) -> None:
    solution = solved(NAV_SAT_FIX, status)
    assert solution == ReceiverSolution(
        time_ns=T,
        latitude_rad=math.radians(35.0),
        longitude_rad=math.radians(-137.0),
        height_m=41.5,
        quality=quality,
        covariance_enu_m2=(4.0, 0.1, 0.2, 5.0, 0.3, 9.0),
    )


@pytest.mark.parametrize("kind", GPS_FIXES)
def test_of_all_statuses_of_a_gps_fix_one_means_resolved_integers(kind: str) -> None:
    qualities = {status: solved(kind, status).quality for status in (0, 1, 2, 18, 19, 20, 33)}
    assert [status for status, quality in qualities.items() if quality is SolutionQuality.FIX] == [19]
    assert qualities[20] is SolutionQuality.FLOAT
    assert solved(kind, 19).satellites == 11


@pytest.mark.parametrize("kind", [NAV_SAT_FIX, *GPS_FIXES])
def test_without_a_position_there_is_no_solution(kind: str) -> None:
    assert solved(kind, -1) is None
    assert solved(kind, -2, latitude=math.nan) is None


@pytest.mark.parametrize(
    ("kind", "status", "changes", "expected"),
    [
        (NAV_SAT_FIX, 19, {}, r"status\.status is '19', expected one of 0, 1, 2, or below zero"),
        (GPS_FIXES[0], 7, {}, r"status\.status is '7', expected one of 0, 1, 2, 18, 19, 20, 33"),
        (NAV_SAT_FIX, 0, {"latitude": math.nan}, "expected a place on the Earth"),
        (NAV_SAT_FIX, 0, {"longitude": 200.0}, "expected a place on the Earth"),
        (NAV_SAT_FIX, 0, {"altitude": math.inf}, "expected a place on the Earth"),
        (NAV_SAT_FIX, 0, {"position_covariance": -COVARIANCE}, "no variance below zero"),
        (NAV_SAT_FIX, 0, {"position_covariance": COVARIANCE * math.nan}, "expected finite numbers"),
    ],
)
def test_what_is_no_position_is_one_line(
    kind: str, status: int, changes: dict[str, Any], expected: str
) -> None:
    with pytest.raises(FormatError, match=expected) as caught:
        solved(kind, status, **changes)
    assert str(caught.value).startswith("/fix: ")


def test_a_covariance_of_unknown_type_or_of_zeros_is_unknown() -> None:
    for changes in ({"position_covariance_type": 0}, {"position_covariance": 0.0 * COVARIANCE}):
        solution = solved(NAV_SAT_FIX, 0, **changes)
        assert solution is not None
        assert solution.covariance_enu_m2 is None


def twist(speed_m_s: float, yaw_rate_rad_s: float) -> Any:
    return SimpleNamespace(linear=SimpleNamespace(x=speed_m_s), angular=SimpleNamespace(z=yaw_rate_rad_s))


@pytest.mark.parametrize("deeper", [False, True])
def test_motion_is_speed_along_x_and_rate_about_z(deeper: bool) -> None:
    message = SimpleNamespace(twist=SimpleNamespace(twist=twist(3.0, -0.1)) if deeper else twist(3.0, -0.1))
    assert motion_of(message, T) == Motion(time_ns=T, wheel_speed_m_s=3.0, yaw_rate_rad_s=-0.1)


def test_what_is_not_finite_is_not_known() -> None:
    assert motion_of(SimpleNamespace(twist=twist(math.nan, 0.2)), T) == Motion(time_ns=T, yaw_rate_rad_s=0.2)
    assert motion_of(SimpleNamespace(twist=twist(math.nan, math.inf)), T) is None
    with pytest.raises(ValidationError):
        motion_of(SimpleNamespace(twist=twist(2000.0, 0.0)), T)


def inertial(**changes: Any) -> Any:
    values: dict[str, Any] = {
        "angular_velocity": SimpleNamespace(x=0.1, y=-0.2, z=0.3),
        "angular_velocity_covariance": np.zeros(9),
        "linear_acceleration": SimpleNamespace(x=1.0, y=-2.0, z=9.8),
        "linear_acceleration_covariance": np.eye(3).ravel(),
        "orientation_covariance": np.array([-1.0, *[0.0] * 8]),
    }
    return SimpleNamespace(**values | changes)


def test_an_imu_gives_rates_and_forces_in_its_axes_and_needs_no_orientation() -> None:
    assert imu_of(inertial(), T, "/imu") == Imu(
        time_ns=T, angular_rate_rad_s=(0.1, -0.2, 0.3), specific_force_m_s2=(1.0, -2.0, 9.8)
    )


@pytest.mark.parametrize("name", ["angular_velocity", "linear_acceleration"])
def test_an_imu_without_rates_or_forces_is_one_line(name: str) -> None:
    """REP 145 and the message: −1 as the first number of a covariance means that there is none."""
    absent = {f"{name}_covariance": np.array([-1.0, *[0.0] * 8])}
    with pytest.raises(FormatError) as caught:
        imu_of(inertial(**absent), T, "/imu")
    assert (
        str(caught.value)
        == f"/imu: {name}_covariance is '-1', expected not -1, which means that there is no {name}"
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, 36.0])
def test_a_rate_that_no_unit_measures_is_refused(value: float) -> None:
    with pytest.raises(ValidationError, match="angular_rate_rad_s"):
        imu_of(inertial(angular_velocity=SimpleNamespace(x=0.0, y=value, z=0.0)), T, "/imu")

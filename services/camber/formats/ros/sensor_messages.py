"""Positions of receivers, motion of the vehicle and inertial samples, from ROS messages.

Sources: sensor_msgs/NavSatFix and NavSatStatus; gps_msgs/GPSFix and GPSStatus; nav_msgs/Odometry;
geometry_msgs/TwistStamped and TwistWithCovarianceStamped (REP 103: metres, radians, x forward, z up);
sensor_msgs/Imu (REP 145: its acceleration is the specific force, +g upwards at rest).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.covariance import EnuCovariance
from camber.schemas.motion import Imu, Motion

NAV_SAT_FIX = "sensor_msgs/msg/NavSatFix"
GPS_FIXES = ("gps_msgs/msg/GPSFix", "gps_common/msg/GPSFix")
RECEIVER_TYPES = (NAV_SAT_FIX, *GPS_FIXES)
MOTION_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
)
IMU_TYPE = "sensor_msgs/msg/Imu"
_IMU_FIELDS = {"angular_rate_rad_s": "angular_velocity", "specific_force_m_s2": "linear_acceleration"}
"""Fields of an Imu of Camber, and of ROS."""
QUALITY_OF_STATUS = {
    0: SolutionQuality.SINGLE,
    1: SolutionQuality.SBAS,
    2: SolutionQuality.DGPS,
    18: SolutionQuality.DGPS,
    19: SolutionQuality.FIX,
    20: SolutionQuality.FLOAT,
    33: SolutionQuality.SBAS,
}
"""By NavSatStatus (0 to 2) and GPSStatus. GBAS_FIX (2) is DGPS: drivers give it for RTK with and without resolved
integers and for code corrections alike, so it says nothing of integers; RTK_FIX (19) does."""
_NAV_SAT_STATUSES = (0, 1, 2)


def solution_of(message: Any, time_ns: int, kind: str, topic: str) -> ReceiverSolution | None:
    """Return the position of a NavSatFix or GPSFix; None where the receiver had none.

    Both have heights above the ellipsoid here: NavSatFix by definition, of GPSFix that is taken for granted. Raises
    FormatError for an unknown status and for numbers that are no position.
    """
    status = int(message.status.status)
    if status < 0:
        return None
    known = _NAV_SAT_STATUSES if kind == NAV_SAT_FIX else tuple(QUALITY_OF_STATUS)
    if status not in known:
        expected = f"one of {', '.join(map(str, known))}, or below zero"
        raise FormatError(topic, "status.status", expected, actual=str(status))
    latitude, longitude, height_m = message.latitude, message.longitude, message.altitude
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(height_m)):
        actual = f"{latitude}, {longitude}, {height_m}"
        raise FormatError(topic, "latitude, longitude, altitude", "a place on the Earth", actual=actual)
    return ReceiverSolution(
        time_ns=time_ns,
        latitude_rad=math.radians(latitude),
        longitude_rad=math.radians(longitude),
        height_m=float(height_m),
        quality=QUALITY_OF_STATUS[status],
        satellites=None if kind == NAV_SAT_FIX else int(message.status.satellites_used),
        covariance_enu_m2=_covariance(message, topic),
    )


def motion_of(message: Any, time_ns: int) -> Motion | None:
    """Return speed along x and yaw rate; what is not finite is not known. None where neither is known.

    Raises pydantic's ValidationError for speeds and rates that no vehicle has.
    """
    twist = message.twist
    twist = getattr(twist, "twist", twist)  # with a covariance, it is a level deeper
    speed_m_s, yaw_rate_rad_s = float(twist.linear.x), float(twist.angular.z)
    values = {"wheel_speed_m_s": speed_m_s, "yaw_rate_rad_s": yaw_rate_rad_s}
    known = {name: value for name, value in values.items() if math.isfinite(value)}
    return Motion(time_ns=time_ns, **known) if known else None


def imu_of(message: Any, time_ns: int, topic: str) -> Imu:
    """Return the sample of an Imu, in the axes of its frame.

    Raises FormatError where rates or forces are absent, which a covariance that begins with −1 means, and pydantic's
    ValidationError for those that no such unit measures.
    """
    vectors: dict[str, Any] = {}
    for field, name in _IMU_FIELDS.items():
        if float(getattr(message, f"{name}_covariance")[0]) == -1.0:
            expected = f"not -1, which means that there is no {name}"
            raise FormatError(topic, f"{name}_covariance", expected, actual="-1")
        vector = getattr(message, name)
        vectors[field] = (float(vector.x), float(vector.y), float(vector.z))
    return Imu(time_ns=time_ns, **vectors)


def _covariance(message: Any, topic: str) -> EnuCovariance | None:
    """Of position; None where the type says "unknown" or all is zero, which drivers write for it."""
    matrix = np.asarray(message.position_covariance, np.float64).reshape(3, 3)
    if int(message.position_covariance_type) == 0 or not matrix.any():
        return None
    if not (np.isfinite(matrix).all() and (np.diag(matrix) >= 0.0).all()):
        raise FormatError(topic, "position_covariance", "finite numbers, no variance below zero")
    ee, en, eu, nn, nu, uu = matrix[np.triu_indices(3)].tolist()
    return ee, en, eu, nn, nu, uu

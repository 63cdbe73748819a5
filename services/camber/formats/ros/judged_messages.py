"""ROS messages of what the judge publishes: verdicts and positions.

A NavSatFix has a position and a status above NO_FIX only where a fix was confirmed, a pose exists only where it may be
used: consumers in ROS do not look for more. Sources: sensor_msgs/NavSatFix, geometry_msgs/PoseWithCovarianceStamped,
diagnostic_msgs/DiagnosticArray; `msg/camber_msgs/msg/Verdict.msg`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from camber.formats.ros.message_types import VERDICT_TYPE, header_at, message_types, new_message
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.base import Covariance3, Float64
from camber.schemas.integrity import CONFIRMED_VERDICTS, Position, Verdict

FIX_TYPE = "sensor_msgs/msg/NavSatFix"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
ANTENNA_FRAME, MAP_FRAME = "gnss_antenna", "map"
_NO_FIX, _GBAS_FIX, _SERVICE_GPS = -1, 2, 1  # NavSatStatus
_COVARIANCE_UNKNOWN, _COVARIANCE_KNOWN = 0, 3  # NavSatFix
_OK, _WARN = 0, 1  # DiagnosticStatus
_UNKNOWN_ANGLE_RAD2 = math.pi**2 / 3.0  # variance of an angle that can be any
_SAME = ("reason", "detail", "cause", "horizontal_reference", "correction_m", "trials")
_NUMBERS = (
    *("height_difference_m", "tolerance_m", "joint_distance2", "joint_limit"),
    "missed_detection_probability",
)
"""Fields of a verdict that the message has by the same names; numbers are NaN where they are not known."""


def verdict_message(verdict: Verdict) -> Any:
    """Return camber_msgs/Verdict; a position stands in it only where the fix is confirmed."""
    latitude_deg, longitude_deg, height_m, covariance = _confirmed_place(verdict)
    return new_message(
        VERDICT_TYPE,
        header=header_at(verdict.time_ns, ANTENNA_FRAME),
        has_fix=verdict.fix_id is not None,
        fix_id=verdict.fix_id or 0,
        verdict=getattr(message_types().types[VERDICT_TYPE], verdict.verdict.upper()),
        evidence=list(verdict.evidence),
        position_difference_m=np.array(verdict.position_difference_m or (math.nan, math.nan)),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        covariance_enu_m2=_matrix(covariance, math.nan).reshape(-1),
        **{name: getattr(verdict, name) for name in _SAME},
        **{name: _number(getattr(verdict, name)) for name in _NUMBERS},
    )


def is_trusted(verdict: Verdict, position: Position) -> bool:
    """Whether a position is the fix that a verdict confirms, and may be used."""
    same = position.fix_id == verdict.fix_id and position.time_ns == verdict.time_ns
    confirmed = verdict.verdict in CONFIRMED_VERDICTS and position.source == "rtk"
    return confirmed and same and usable_place(position) is not None


def no_fix_message(time_ns: int) -> Any:
    """Return NavSatFix without a position."""
    return fix_message(Verdict(time_ns=time_ns, fix_id=None, verdict="unknown", reason="none"))


def fix_message(verdict: Verdict) -> Any:
    """Return NavSatFix: the antenna's position where the fix was confirmed, else NO_FIX and NaN.

    A confirmed one has the status GBAS_FIX, the highest of NavSatStatus.
    """
    latitude_deg, longitude_deg, height_m, covariance = _confirmed_place(verdict)
    status = _GBAS_FIX if verdict.verdict in CONFIRMED_VERDICTS else _NO_FIX
    return new_message(
        FIX_TYPE,
        header=header_at(verdict.time_ns, ANTENNA_FRAME),
        status=new_message("sensor_msgs/msg/NavSatStatus", status=status, service=_SERVICE_GPS),
        latitude=latitude_deg,
        longitude=longitude_deg,
        altitude=height_m,
        position_covariance=_matrix(covariance, 0.0).reshape(-1),
        position_covariance_type=_COVARIANCE_UNKNOWN if covariance is None else _COVARIANCE_KNOWN,
    )


def usable_place(position: Position) -> tuple[float, float, float] | None:
    """Return latitude, longitude [rad] and height [m] of the antenna; None unless they may be used."""
    if not position.usable or position.covariance_enu_m2 is None:
        return None
    if position.latitude_rad is None or position.longitude_rad is None or position.height_m is None:
        return None
    return position.latitude_rad, position.longitude_rad, position.height_m


def pose_message(position: Position, place: tuple[float, float, float], frame: LocalFrame) -> Any:
    """Return the antenna's pose at its `usable_place` in `map`, a frame of east, north, up.

    Angles have the variance of one that can be any: the position contains none, and no pitch and roll.
    """
    east_m, north_m, up_m = frame.enu_from_geodetic(*place)
    half_rad = 0.5 * (position.yaw_rad or 0.0)
    covariance = np.diag([_UNKNOWN_ANGLE_RAD2] * 6)
    covariance[:3, :3] = _matrix(position.covariance_enu_m2, math.nan)
    pose = new_message(
        "geometry_msgs/msg/Pose",
        position=new_message("geometry_msgs/msg/Point", x=east_m, y=north_m, z=up_m),
        orientation=new_message(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half_rad), w=math.cos(half_rad)
        ),
    )
    pose = new_message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.reshape(-1))
    return new_message(POSE_TYPE, header=header_at(position.time_ns, MAP_FRAME), pose=pose)


def diagnostics_message(position: Position, key: str) -> Any:
    """Return a DiagnosticArray of one status: OK where the position may be used, else WARN with the reason."""
    values = {
        name: getattr(position, name)
        for name in (
            *("source", "reason", "horizontal_reference", "horizontal_protection_level_m"),
            *("vertical_protection_level_m", "integrity_risk", "alert_limit_m", "vertical_alert_limit_m"),
        )
    }
    status = new_message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_OK if position.usable else _WARN,
        name="camber: position",
        message=f"usable ({position.source})" if position.usable else f"not usable: {position.reason}",
        hardware_id=key,
        values=[
            new_message("diagnostic_msgs/msg/KeyValue", key=key, value="" if value is None else str(value))
            for key, value in values.items()
        ],
    )
    return new_message(DIAGNOSTICS_TYPE, header=header_at(position.time_ns, ""), status=[status])


def _confirmed_place(verdict: Verdict) -> tuple[float, float, float, Covariance3 | None]:
    """Latitude, longitude [deg], height [m] and covariance; NaN and None where nothing is confirmed."""
    if verdict.verdict not in CONFIRMED_VERDICTS:
        return math.nan, math.nan, math.nan, None
    latitude_rad, longitude_rad = _number(verdict.latitude_rad), _number(verdict.longitude_rad)
    height_m = _number(verdict.height_m)
    return math.degrees(latitude_rad), math.degrees(longitude_rad), height_m, verdict.covariance_enu_m2


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _matrix(covariance: Covariance3 | None, unknown: float) -> Float64:
    """The symmetric matrix (3, 3) of its upper triangle."""
    matrix = np.full((3, 3), unknown)
    if covariance is not None:
        matrix[np.triu_indices(3)] = covariance
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
    return matrix

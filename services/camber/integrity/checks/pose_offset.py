"""Where a fix lies from the approximate pose, and how wide a pose or a position claims to be."""

from __future__ import annotations

import math

from camber.geodesy.covariance import eigenvalues_m2
from camber.geodesy.horizontal_offsets import east_north_between
from camber.schemas.base import Covariance3
from camber.schemas.pose import Pose

_ACCELERATION_M_S2 = (
    2.0  # 1 σ of a car's: by half of it × dt² it is elsewhere than where a steady one would be
)


def can_move_on(pose: Pose) -> bool:
    """Does the pose say how the antenna moves? One that stands needs no direction."""
    return pose.speed_m_s is not None and (pose.yaw_rad is not None or pose.speed_m_s == 0.0)


def offset_from_pose(
    latitude_rad: float, longitude_rad: float, pose: Pose, at_ns: int
) -> tuple[float, float]:
    """East and north metres to a point from the pose's antenna, moved on to `at_ns` where it says how it moves.

    Raises ValueError for a pose without a position.
    """
    if pose.latitude_rad is None or pose.longitude_rad is None:
        raise ValueError("the pose has no position")
    east_m, north_m = east_north_between(pose.latitude_rad, pose.longitude_rad, latitude_rad, longitude_rad)
    moved_east_m, moved_north_m = travelled_m(pose, at_ns)
    return east_m - moved_east_m, north_m - moved_north_m


def travelled_m(pose: Pose, at_ns: int) -> tuple[float, float]:
    """East and north metres that the antenna has moved from the pose's time to `at_ns`; none where it does not say."""
    if pose.speed_m_s is None or pose.yaw_rad is None:
        return 0.0, 0.0
    along_m = pose.speed_m_s * (at_ns - pose.time_ns) / 1e9
    return along_m * math.cos(pose.yaw_rad), along_m * math.sin(pose.yaw_rad)


def unsteady_m2(pose: Pose, at_ns: int) -> float:
    """Variance, each axis, of what a car may have accelerated by between the pose's time and `at_ns`, m²."""
    since_s = (at_ns - pose.time_ns) / 1e9
    return (0.5 * _ACCELERATION_M_S2 * since_s * since_s) ** 2


def pose_sigma_m(pose: Pose) -> float:
    """Largest horizontal σ of the pose's antenna; infinite where the pose gives no covariance, or none that is one."""
    if pose.covariance_east_north_yaw is None:
        return math.inf
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    return _largest_sigma_m(ee, en, nn)


def claimed_sigma_m(covariance_enu_m2: Covariance3) -> float:
    """Largest σ of a position in any horizontal direction or upwards; infinite where this is no covariance."""
    ee, en, _, nn, _, uu = covariance_enu_m2
    return max(_largest_sigma_m(ee, en, nn), math.sqrt(uu)) if uu >= 0.0 else math.inf


def _largest_sigma_m(ee: float, en: float, nn: float) -> float:
    try:
        return math.sqrt(eigenvalues_m2((ee, en, nn))[0])
    except ValueError:
        return math.inf

"""The position for consumers at every epoch, and its error ellipse (R, reliability index).

Confirmed RTK before the approximate pose; without either, nothing. The 99.9 % ellipse has the semi-axes √(13.82 α).
Usable is what is confirmed or stems from something confirmed or given, and whose ellipse is within the alert limit.
"""

from __future__ import annotations

from typing import Literal

from camber.geodesy.covariance import error_ellipse
from camber.integrity.judgement import Judgement
from camber.integrity.rules import Rules
from camber.integrity.situation import Situation
from camber.integrity.true_sigma import with_true_sigma
from camber.schemas.base import Covariance3
from camber.schemas.integrity import Position, Reason
from camber.schemas.pose import Pose

_P999 = 0.999
_UNKNOWN_HEIGHT_M2 = 1e6  # the variance beside a height that is None


def rtk_position(judgement: Judgement, rules: Rules) -> Position:
    """The position of a confirmed fix. Raises ValueError for any other: unknown is never trusted."""
    fix = judgement.fix
    if not judgement.confirmed or fix.covariance_enu_m2 is None:
        raise ValueError(f"fix {fix.fix_id} is {judgement.word}, not confirmed")
    yaw_rad = judgement.pose.yaw_rad if judgement.pose is not None else None
    return _position(
        "rtk",
        fix.time_ns,
        (fix.latitude_rad, fix.longitude_rad, fix.height_m),
        with_true_sigma(fix.covariance_enu_m2, rules.true_sigma),
        yaw_rad,
        rules,
        fix_id=fix.fix_id,
    )


def pose_position(situation: Situation, correction_m: float, rules: Rules) -> Position:
    """The approximate pose as position, at its own time; its height where road and antenna are known.

    Raises ValueError where there is no pose at all. One that is provisional, or of no use, gives no position.
    """
    pose = situation.pose
    if pose is None:
        raise ValueError("there is no pose")
    reason = situation.missing_pose(pose.time_ns, rules)
    if reason is not None:
        return no_position(pose.time_ns, reason, rules)
    if is_provisional(pose):
        return no_position(pose.time_ns, "pose_provisional", rules)
    assert pose.latitude_rad is not None
    assert pose.longitude_rad is not None
    height_m, variance_m2 = _height_on_road(situation, correction_m, rules)
    assert pose.covariance_east_north_yaw is not None
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    return _position(
        "scan_match" if pose.mode == "scan_match" else "sensors",
        pose.time_ns,
        (pose.latitude_rad, pose.longitude_rad, height_m),
        (ee, en, 0.0, nn, 0.0, variance_m2),
        pose.yaw_rad,
        rules,
    )


def is_provisional(pose: Pose) -> bool:
    """Does the pose rest on unconfirmed fixes alone?"""
    return pose.provenance == "fixes" or pose.mode == "provisional"


def no_position(time_ns: int, reason: Reason, rules: Rules) -> Position:
    """The clear word that there is none."""
    return Position(
        time_ns=time_ns, source="none", usable=False, reason=reason, alert_limit_m=rules.alert_limit_m
    )


def _height_on_road(situation: Situation, correction_m: float, rules: Rules) -> tuple[float | None, float]:
    """Height of the antenna on the road below it, and its variance with the slope's share of the pose's error."""
    pose, antenna = situation.pose, situation.antenna
    assert pose is not None
    assert pose.covariance_east_north_yaw is not None
    road = pose.road
    if situation.missing_road() is not None or situation.missing_antenna(pose.time_ns, rules) is not None:
        return None, _UNKNOWN_HEIGHT_M2
    if road.slope_east is None or road.slope_north is None:
        return None, _UNKNOWN_HEIGHT_M2
    assert road.elevation_m is not None
    assert road.sigma_m is not None
    assert antenna is not None
    assert antenna.height_m is not None
    assert antenna.sigma_m is not None
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    se, sn = road.slope_east, road.slope_north
    slope_m2 = se * se * ee + 2.0 * se * sn * en + sn * sn * nn
    height_m = road.elevation_m + antenna.height_m + correction_m
    return height_m, road.sigma_m**2 + antenna.sigma_m**2 + max(slope_m2, 0.0)


def _position(
    source: Literal["rtk", "sensors", "scan_match"],
    time_ns: int,
    place: tuple[float, float, float | None],
    covariance: Covariance3,
    yaw_rad: float | None,
    rules: Rules,
    *,
    fix_id: int | None = None,
) -> Position:
    ellipse = error_ellipse((covariance[0], covariance[1], covariance[3]), _P999)
    usable = ellipse.semi_major_m < rules.alert_limit_m
    return Position(
        time_ns=time_ns,
        source=source,
        usable=usable,
        reason="none" if usable or source == "rtk" else "pose_too_uncertain",
        latitude_rad=place[0],
        longitude_rad=place[1],
        height_m=place[2],
        covariance_enu_m2=covariance,
        yaw_rad=yaw_rad,
        semi_major_999_m=ellipse.semi_major_m,
        semi_minor_999_m=ellipse.semi_minor_m,
        orientation_rad=ellipse.orientation_rad,
        alert_limit_m=rules.alert_limit_m,
        fix_id=fix_id,
    )

"""The position for consumers at every epoch, and its error ellipse (R, reliability index).

Confirmed RTK before the approximate pose; without either, nothing. The 99.9 % ellipse has the semi-axes √(13.82 α).
"""

from __future__ import annotations

from camber.geodesy.covariance import error_ellipse
from camber.integrity.judge import Judgement
from camber.integrity.rules import Rules
from camber.schemas.antenna import AntennaHeight
from camber.schemas.base import Covariance3
from camber.schemas.integrity import Position, Reason
from camber.schemas.pose import Pose

_P999 = 0.999


def with_floor(covariance_enu_m2: Covariance3, floor_m: tuple[float, float]) -> Covariance3:
    """A receiver's covariance with the σ of R added: what it claims leaves out multipath and the reference frame."""
    ee, en, eu, nn, nu, uu = covariance_enu_m2
    horizontal, vertical = floor_m[0] ** 2, floor_m[1] ** 2
    return ee + horizontal, en, eu, nn + horizontal, nu, uu + vertical


def rtk_position(judgement: Judgement, rules: Rules) -> Position:
    """The position of a confirmed fix. Raises ValueError for any other: unknown is never trusted."""
    fix = judgement.fix
    if not judgement.confirmed or fix.covariance_enu_m2 is None:
        raise ValueError(f"fix {fix.fix_id} is {judgement.word}, not confirmed")
    covariance = with_floor(fix.covariance_enu_m2, rules.rtk_sigma_floor_m)
    yaw_rad = judgement.pose.yaw_rad if judgement.pose is not None else None
    return _position(
        "rtk", fix.time_ns, fix.latitude_rad, fix.longitude_rad, fix.height_m, covariance, yaw_rad, rules, fix.fix_id
    )


def pose_position(pose: Pose, antenna: AntennaHeight | None, correction_m: float, rules: Rules) -> Position:
    """The approximate pose as position: height from road and antenna where both are known. Provisional: not usable."""
    if pose.latitude_rad is None or pose.longitude_rad is None or pose.covariance_east_north_yaw is None:
        return no_position(pose.time_ns, "pose_missing", rules)
    if pose.provenance == "fixes":
        return no_position(pose.time_ns, "pose_provisional", rules)
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    road = pose.road
    height_m = None
    vertical_m2 = 0.0
    if road.status == "known" and road.elevation_m is not None and road.sigma_m is not None:
        if antenna is not None and antenna.height_m is not None and antenna.sigma_m is not None:
            height_m = road.elevation_m + antenna.height_m + correction_m
            se, sn = road.slope_east or 0.0, road.slope_north or 0.0
            slope_m2 = se * se * ee + 2.0 * se * sn * en + sn * sn * nn
            vertical_m2 = road.sigma_m**2 + antenna.sigma_m**2 + slope_m2
    covariance = (ee, en, 0.0, nn, 0.0, vertical_m2) if height_m is not None else (ee, en, 0.0, nn, 0.0, 1e6)
    source = "scan_match" if pose.mode == "scan_match" else "sensors"
    return _position(
        source, pose.time_ns, pose.latitude_rad, pose.longitude_rad, height_m, covariance, pose.yaw_rad, rules, None
    )


def no_position(time_ns: int, reason: Reason, rules: Rules) -> Position:
    """The clear word that there is none."""
    return Position(time_ns=time_ns, source="none", usable=False, reason=reason, alert_limit_m=rules.alert_limit_m)


def _position(
    source: str,
    time_ns: int,
    latitude_rad: float,
    longitude_rad: float,
    height_m: float | None,
    covariance: Covariance3,
    yaw_rad: float | None,
    rules: Rules,
    fix_id: int | None,
) -> Position:
    ellipse = error_ellipse((covariance[0], covariance[1], covariance[3]), _P999)
    return Position(
        time_ns=time_ns,
        source=source,
        usable=ellipse.semi_major_m < rules.alert_limit_m,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=height_m,
        covariance_enu_m2=covariance,
        yaw_rad=yaw_rad,
        semi_major_999_m=ellipse.semi_major_m,
        semi_minor_999_m=ellipse.semi_minor_m,
        orientation_rad=ellipse.orientation_rad,
        alert_limit_m=rules.alert_limit_m,
        fix_id=fix_id,
    )

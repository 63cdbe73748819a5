"""The antenna's height by each method for which a vehicle has the sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from camber.antenna_height.body_attitude import Arm, BodyAttitude, Slopes, Tilt, TiltRules
from camber.antenna_height.latest_inputs import HeightInputs
from camber.antenna_height.suspension_and_ranging_heights import (
    FixedHeight,
    ImplausibleError,
    RangingGeometry,
    StrokeGeometry,
    height_from_sensor,
    ranging_height,
    stroke_height,
)
from camber.schemas.antenna import HeightByMethod, HeightMethod
from camber.schemas.motion import Ranging, Suspension
from camber.schemas.pose import Pose, ScanMatch

_UPSET_RAD = math.radians(45.0)  # chosen: a steeper attitude is not that of a vehicle on its wheels


class UnavailableError(Exception):
    """A method gives no height; the text says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleGeometry:
    """Sensors and measured dimensions of a vehicle; None: absent or not measured.

    `plausible_m`: largest difference of a height from that at rest. `matched_attitude_sigma_rad`: of the attitude by a
    scan match. `pose_sigma_limit_m`: of a pose less certain the road's slope is not used.
    """

    tilt: TiltRules
    fixed: FixedHeight | None = None
    stroke: StrokeGeometry | None = None
    ranging: RangingGeometry | None = None
    antenna: Arm | None = None
    lidar: Arm | None = None
    stored_sigma_m: float = 0.01
    plausible_m: float = 0.5
    matched_attitude_sigma_rad: float = math.radians(0.15)
    pose_sigma_limit_m: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Heights:
    """By method a height, or why there is none, at one time. `problems`: what an operator should know."""

    known: dict[HeightMethod, HeightByMethod] = field(default_factory=dict)
    missing: dict[HeightMethod, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def heights_at(now_ns: int, vehicle: VehicleGeometry, inputs: HeightInputs) -> Heights:
    """Return the heights by all methods."""
    motion, match = inputs.motion.at(now_ns), inputs.match.at(now_ns)
    road = road_of(inputs.pose.at(now_ns), vehicle.pose_sigma_limit_m)
    attitude = BodyAttitude.of(
        road, None if motion is None else _tilt(motion.roll_rad, motion.pitch_rad), vehicle.tilt
    )
    matched = _matched_attitude(match, vehicle) or attitude
    methods: dict[HeightMethod, Callable[[], tuple[float, ...]]] = {
        "fixed": lambda: _fixed(vehicle, attitude),
        "stroke": lambda: _stroke(vehicle, attitude, inputs.suspension.at(now_ns)),
        "ranging": lambda: _ranging(vehicle, attitude, inputs.ranging.at(now_ns)),
        "scan_matching": lambda: _scan_matching(vehicle, matched, match),
    }
    if vehicle.ranging is None:
        methods["ranging"] = lambda: _ground(vehicle, matched, match)
    heights = Heights()
    for method, compute in methods.items():
        try:
            heights.known[method] = _plausible(method, compute(), vehicle)
        except UnavailableError as error:
            heights.missing[method] = str(error)
        except ImplausibleError as error:
            heights.missing[method] = f"{method} is implausible: {error}"
            heights.problems.append(f"{method}: {error}")
    return heights


def road_of(pose: Pose | None, sigma_limit_m: float) -> Slopes | None:
    """Return the road's slopes along the heading's axes; None where pose or map do not determine them."""
    if pose is None or pose.yaw_rad is None or pose.covariance_east_north_yaw is None:
        return None
    ee, _, _, nn, _, _ = pose.covariance_east_north_yaw
    if pose.road.slope_east is None or pose.road.slope_north is None or max(ee, nn) > sigma_limit_m**2:
        return None
    return Slopes.along(pose.road.slope_east, pose.road.slope_north, pose.yaw_rad)


def _tilt(roll_rad: float | None, pitch_rad: float | None) -> Tilt | None:
    if roll_rad is None or pitch_rad is None or max(abs(pitch_rad), abs(roll_rad)) > _UPSET_RAD:
        return None
    return Tilt(roll_rad, pitch_rad)


def _matched_attitude(match: ScanMatch | None, vehicle: VehicleGeometry) -> BodyAttitude | None:
    """Return the attitude on the road by a scan match; None where it does not determine both."""
    if match is None or match.road_slope_forward is None or match.road_slope_left is None:
        return None
    tilt = None if match.roll_pitch_yaw_rad is None else _tilt(*match.roll_pitch_yaw_rad[:2])
    rules = replace(vehicle.tilt, attitude_sigma_rad=vehicle.matched_attitude_sigma_rad)
    road = Slopes(match.road_slope_forward, match.road_slope_left)
    return None if tilt is None else BodyAttitude.of(road, tilt, rules)


def _plausible(
    method: HeightMethod, height_and_sigmas_m: tuple[float, ...], vehicle: VehicleGeometry
) -> HeightByMethod:
    """Return the height; ImplausibleError where it cannot be of this vehicle."""
    height_m, *sigmas_m = height_and_sigmas_m
    if not -1.0 <= height_m <= 100.0:
        raise ImplausibleError(f"the antenna {height_m:.3f} m above the road, expected -1 m to 100 m")
    rest, sigma_m = vehicle.antenna, math.hypot(*sigmas_m)
    if method != "fixed" and rest is not None and abs(height_m - rest.z_m) > vehicle.plausible_m:
        raise ImplausibleError(
            f"the antenna {height_m:.3f} m above the road, expected {rest.z_m:.3f} m at rest, "
            f"give or take {vehicle.plausible_m:g} m"
        )
    return HeightByMethod(way=method, height_m=height_m, sigma_m=sigma_m)


def _fixed(vehicle: VehicleGeometry, attitude: BodyAttitude) -> tuple[float, ...]:
    if vehicle.fixed is None:
        raise UnavailableError("fixed_height_m is not set")
    return vehicle.fixed.height_m * attitude.vertical_per_normal, vehicle.fixed.sigma_m


def _stroke(
    vehicle: VehicleGeometry, attitude: BodyAttitude, measured: Suspension | None
) -> tuple[float, ...]:
    if vehicle.stroke is None:
        raise UnavailableError("suspension_to_antenna_m or tyre_radius_m is not set")
    if measured is None:
        raise UnavailableError("no fresh stroke height")
    height = stroke_height(measured, attitude, vehicle.stroke, antenna=vehicle.antenna)
    return *height, vehicle.stored_sigma_m


def _ranging(vehicle: VehicleGeometry, attitude: BodyAttitude, measured: Ranging | None) -> tuple[float, ...]:
    if vehicle.antenna is None or vehicle.ranging is None:
        raise UnavailableError("antenna is not set")
    if measured is None:
        raise UnavailableError("no fresh distance to the road")
    height = ranging_height(measured, attitude, vehicle.ranging, antenna=vehicle.antenna)
    return *height, vehicle.stored_sigma_m


def _ground(vehicle: VehicleGeometry, attitude: BodyAttitude, match: ScanMatch | None) -> tuple[float, ...]:
    """Without a ranging sensor the LiDAR's returns from the road replace it: a sensor of many beams."""
    if match is None:
        raise UnavailableError("ranging is not set, and there is no fresh scan match")
    if match.ground_height_m is None:
        raise UnavailableError("no ranging sensor, and the sweep shows no road near the vehicle")
    return _by_lidar(vehicle, attitude, match.ground_height_m, match.ground_height_sigma_m)


def _scan_matching(
    vehicle: VehicleGeometry, attitude: BodyAttitude, match: ScanMatch | None
) -> tuple[float, ...]:
    if match is None:
        raise UnavailableError("no fresh scan match")
    if match.status != "converged":
        raise UnavailableError(f"scan match {match.status}")
    return _by_lidar(vehicle, attitude, match.sensor_height_m, match.sensor_height_sigma_m)


def _by_lidar(
    vehicle: VehicleGeometry, attitude: BodyAttitude, height_m: float | None, sigma_m: float | None
) -> tuple[float, ...]:
    if vehicle.antenna is None or vehicle.lidar is None:
        raise UnavailableError(f"{'antenna' if vehicle.antenna is None else 'lidar'} is not set")
    if height_m is None or sigma_m is None:
        raise UnavailableError("the scan match gives no height of the sensor")
    arm = vehicle.antenna.minus(vehicle.lidar)
    return *height_from_sensor(height_m, sigma_m, attitude, sensor_to_antenna=arm), vehicle.stored_sigma_m

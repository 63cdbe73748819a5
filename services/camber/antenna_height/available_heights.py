"""All ways to know the antenna's height that a vehicle has, from what was heard of its sensors, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from camber.antenna_height.body_attitude import Arm, Slopes, Stance, Tilt, TiltRules
from camber.antenna_height.height_methods import (
    ImplausibleError,
    fixed_height,
    height_from_sensor,
    ranging_height,
    stroke_height,
)
from camber.antenna_height.latest_inputs import Newest
from camber.schemas.antenna import HeightByMethod, HeightMethod
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.schemas.pose import Pose, ScanMatch


@dataclass(frozen=True, slots=True)
class FixedWay:
    """Measured once."""

    height_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class StrokeWay:
    """H (1). `suspension`: where it is; None: not known."""

    suspension_to_antenna_m: float
    tyre_radius_m: float
    suspension: Arm | None = None


@dataclass(frozen=True, slots=True)
class RangingWay:
    """H (6) (7). Angles in radians, the azimuth counter-clockwise from the vehicle's x."""

    sensor: Arm
    beam_azimuth_rad: float
    beam_sigma_rad: float


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What is known of a vehicle; None: it has not got that, or nobody has measured it.

    `plausible_m`: an antenna further than that from its height at rest is none. `matched_attitude_sigma_rad`: of an
    attitude that a scan match gives. `pose_sigma_limit_m`: of a pose less certain the road's slope is not used.
    """

    tilt: TiltRules
    fixed: FixedWay | None = None
    stroke: StrokeWay | None = None
    ranging: RangingWay | None = None
    antenna: Arm | None = None
    lidar: Arm | None = None
    stored_sigma_m: float = 0.01
    plausible_m: float = 0.5
    matched_attitude_sigma_rad: float = math.radians(0.15)
    pose_sigma_limit_m: float = 3.0


@dataclass(slots=True)
class Heights:
    """What the ways say at one time: a height each, or why not. `problems`: what an operator should know."""

    known: dict[HeightMethod, HeightByMethod] = field(default_factory=dict)
    missing: dict[HeightMethod, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def all(self) -> tuple[HeightByMethod, ...]:
        """The heights, in the order of H."""
        return tuple(self.known.values())


class Sensors:
    """What was heard last."""

    def __init__(self) -> None:
        self.motion: Newest[Motion] = Newest("motion")
        self.pose: Newest[Pose] = Newest("pose")
        self.suspension: Newest[Suspension] = Newest("suspension")
        self.ranging: Newest[Ranging] = Newest("ranging")
        self.match: Newest[ScanMatch] = Newest("scan_match")

    def speed_m_s(self, now_ns: int) -> float | None:
        """By the wheels, or else by the pose; None: not known."""
        motion, pose = self.motion.at(now_ns), self.pose.at(now_ns)
        if motion is not None and motion.wheel_speed_m_s is not None:
            return motion.wheel_speed_m_s
        return None if pose is None else pose.speed_m_s


def heights_at(now_ns: int, vehicle: Vehicle, sensors: Sensors) -> Heights:
    """Every way that the vehicle has."""
    heights = Heights()
    stance = Stance.of(
        road_of(sensors.pose.at(now_ns), vehicle.pose_sigma_limit_m),
        _attitude(sensors.motion.at(now_ns)),
        vehicle.tilt,
    )
    match = sensors.match.at(now_ns)
    _fixed(heights, vehicle, stance)
    _stroke(heights, vehicle, stance, sensors.suspension.at(now_ns))
    if vehicle.ranging is not None:
        _ranging(heights, vehicle, vehicle.ranging, stance, sensors.ranging.at(now_ns))
    else:
        _ground(heights, vehicle, _stance_of(match, stance, vehicle), match)
    _scan_matching(heights, vehicle, _stance_of(match, stance, vehicle), match)
    return heights


def road_of(pose: Pose | None, sigma_limit_m: float) -> Slopes | None:
    """The road's slopes along the heading's axes; None where the pose or the map does not say."""
    if pose is None or pose.yaw_rad is None or pose.covariance_east_north_yaw is None:
        return None
    ee, _, _, nn, _, _ = pose.covariance_east_north_yaw
    if pose.road.slope_east is None or pose.road.slope_north is None or max(ee, nn) > sigma_limit_m**2:
        return None
    return Slopes.along(pose.road.slope_east, pose.road.slope_north, pose.yaw_rad)


def _attitude(motion: Motion | None) -> Tilt | None:
    if motion is None or motion.pitch_rad is None or motion.roll_rad is None:
        return None
    if max(abs(motion.pitch_rad), abs(motion.roll_rad)) > _UPSET_RAD:
        return None
    return Tilt(motion.roll_rad, motion.pitch_rad)


_UPSET_RAD = math.radians(45.0)


def _stance_of(match: ScanMatch | None, stance: Stance, vehicle: Vehicle) -> Stance:
    """By the match's own attitude and road where it gives them."""
    if match is None or match.roll_pitch_yaw_rad is None:
        return stance
    if match.road_slope_forward is None or match.road_slope_left is None:
        return stance
    roll_rad, pitch_rad, _ = match.roll_pitch_yaw_rad
    if max(abs(pitch_rad), abs(roll_rad)) > _UPSET_RAD:
        return stance
    rules = replace(vehicle.tilt, attitude_sigma_rad=vehicle.matched_attitude_sigma_rad)
    return Stance.of(
        Slopes(match.road_slope_forward, match.road_slope_left), Tilt(roll_rad, pitch_rad), rules
    )


def _fixed(heights: Heights, vehicle: Vehicle, stance: Stance) -> None:
    if vehicle.fixed is None:
        heights.missing["fixed"] = "fixed_height_m is not set"
        return
    heights.known["fixed"] = fixed_height(vehicle.fixed.height_m, vehicle.fixed.sigma_m, stance)


def _stroke(heights: Heights, vehicle: Vehicle, stance: Stance, said: Suspension | None) -> None:
    way, arm = vehicle.stroke, None
    if way is None:
        heights.missing["stroke"] = "suspension_to_antenna_m or tyre_radius_m is not set"
    elif said is None:
        heights.missing["stroke"] = "no fresh stroke height"
    else:
        if way.suspension is not None and vehicle.antenna is not None:
            arm = vehicle.antenna.minus(way.suspension)
        _try(
            heights,
            vehicle,
            "stroke",
            lambda: stroke_height(
                said.stroke_height_m,
                said.stroke_sigma_m,
                stance,
                suspension_to_antenna_m=way.suspension_to_antenna_m,
                tyre_radius_m=way.tyre_radius_m,
                arm=arm,
                stored_sigma_m=vehicle.stored_sigma_m,
            ),
        )


def _ranging(
    heights: Heights, vehicle: Vehicle, way: RangingWay, stance: Stance, said: Ranging | None
) -> None:
    antenna = vehicle.antenna
    if antenna is None:
        heights.missing["ranging"] = "antenna is not set"
    elif said is None:
        heights.missing["ranging"] = "no fresh distance to the road"
    else:
        _try(
            heights,
            vehicle,
            "ranging",
            lambda: ranging_height(
                said.distance_m,
                said.distance_sigma_m,
                said.beam_angle_rad,
                stance,
                sensor_to_antenna=antenna.minus(way.sensor),
                beam_azimuth_rad=way.beam_azimuth_rad,
                beam_sigma_rad=way.beam_sigma_rad,
                stored_sigma_m=vehicle.stored_sigma_m,
            ),
        )


def _ground(heights: Heights, vehicle: Vehicle, stance: Stance, match: ScanMatch | None) -> None:
    """Without a ranging sensor the surround sensor's own returns from the road are one, of many beams."""
    if match is not None and match.ground_height_m is None:
        heights.missing["ranging"] = "no ranging sensor, and the sweep shows no road near the vehicle"
    elif match is None:
        heights.missing["ranging"] = "ranging is not set, and there is no fresh scan match"
    else:
        _from_lidar(heights, vehicle, "ranging", stance, match.ground_height_m, match.ground_height_sigma_m)


def _scan_matching(heights: Heights, vehicle: Vehicle, stance: Stance, match: ScanMatch | None) -> None:
    if match is None:
        heights.missing["scan_matching"] = "no fresh scan match"
    elif match.status != "converged":
        heights.missing["scan_matching"] = f"scan match {match.status}"
    else:
        _from_lidar(
            heights, vehicle, "scan_matching", stance, match.sensor_height_m, match.sensor_height_sigma_m
        )


def _from_lidar(
    heights: Heights,
    vehicle: Vehicle,
    way: HeightMethod,
    stance: Stance,
    height_m: float | None,
    sigma_m: float | None,
) -> None:
    antenna, lidar = vehicle.antenna, vehicle.lidar
    if antenna is None or lidar is None:
        heights.missing[way] = f"{'antenna' if antenna is None else 'lidar'} is not set"
    elif height_m is None or sigma_m is None:
        heights.missing[way] = "the scan match gives no height of the sensor"
    else:
        _try(
            heights,
            vehicle,
            way,
            lambda: height_from_sensor(
                way,
                height_m,
                sigma_m,
                stance,
                sensor_to_antenna=antenna.minus(lidar),
                stored_sigma_m=vehicle.stored_sigma_m,
            ),
        )


def _try(heights: Heights, vehicle: Vehicle, way: HeightMethod, work: Callable[[], HeightByMethod]) -> None:
    """What cannot be of this vehicle is no height, and somebody should look."""
    try:
        height = work()
        rest = vehicle.antenna
        if rest is not None and abs(height.height_m - rest.z_m) > vehicle.plausible_m:
            raise ImplausibleError(
                f"the antenna {height.height_m:.3f} m above the road, expected {rest.z_m:.3f} m at rest, "
                f"give or take {vehicle.plausible_m:g} m"
            )
        heights.known[way] = height
    except ImplausibleError as error:
        heights.missing[way] = f"{way} is implausible: {error}"
        heights.problems.append(f"{way}: {error}")

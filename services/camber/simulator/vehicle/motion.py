"""From a path to the true motion of a vehicle along it.

The rear axle's middle follows the path exactly and does not slip sideways; the front wheels are steered as the bicycle
model asks for on the tilted road, tan δ = L κ with κ the path's curvature within the road's plane. The road's plane is
that of the four wheels' contact points. The body turns about the middle between the wheels' centres: heave, pitch and
roll follow the road and the specific force through springs and dampers (`springs`), or exactly for a rigid body.

JP7707657B2 eq. (1), h_a = h_ba + h_s + h_t, is exact at rest on flat road. Otherwise it is off by no more than
|θ| |Δx| + |φ| |Δy| + (h_a + |l|) (1 / cos α − 1 + (|θ| + |φ|)² + |sin α| (|θ| + |φ|)) + the road's unevenness, with
θ, φ the body's pitch and roll against the road, (Δx, Δy) from the suspension to the antenna, l from the body's centre
to the antenna and α the road's steepest slope: a height is upright, a stroke is square to the road.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.simulator.injected_faults import ChangedLoad, ChangedTyre, Fault, WheelSlip, vehicle_effect
from camber.simulator.scene import Floats, Path, Trajectory
from camber.simulator.vehicle.attitude import angular_velocity, body_yaw_rate, rotations
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.cubic_curve import CubicCurve
from camber.simulator.vehicle.driven_path import DrivenPath, contact_curve
from camber.simulator.vehicle.speed_profile import DRIVER, progress_along
from camber.simulator.vehicle.suspension import sprung

RATE_HZ = 100  # chosen: the body swings at less than 2 Hz
_STEP_NS = 1_000_000_000 // RATE_HZ


def drive(
    path: Path,
    body: VehicleBody,
    *,
    start_ns: int,
    faults: Sequence[Fault] = (),
    duration_s: float | None = None,
) -> Trajectory:
    """The motion along a path from rest to rest, at even steps from `start_ns`.

    `duration_s`: cut there, or stand at the end until then. Raises ValueError for paths that cannot be driven (fewer
    than four samples, standing still, no speed allowed).
    """
    driven = DrivenPath.along(path)
    _, turn = driven.yaw_and_turn(driven.distance_m)
    limits = path.speed_limit_m_s, path.stop_s
    progress = progress_along(driven.distance_m, turn, limits, DRIVER)
    lasts_s = progress.duration_s if duration_s is None else duration_s
    time_s = np.arange(int(np.floor(lasts_s * RATE_HZ + 1e-6)) + 1) / RATE_HZ
    rolling = _rolling(driven, contact_curve(driven, body), *progress.at(time_s))
    posed = _posed(body, rolling, faults, time_s)
    antenna = rolling.origin_m + posed.antenna_m
    road = driven.road_m(antenna[:, 0], antenna[:, 1], rolling.distance_m + body.antenna[0])
    slip, _ = vehicle_effect(faults, WheelSlip, time_s)
    point_speed = rolling.speed_m_s * (1.0 - rolling.curvature * body.wheel[1])
    sample = driven.sample_at(rolling.distance_m)
    return Trajectory(
        time_ns=start_ns + _STEP_NS * np.arange(len(time_s), dtype=np.int64),
        origin_m=rolling.origin_m,
        roll_rad=posed.roll_rad,
        pitch_rad=posed.pitch_rad,
        yaw_rad=rolling.yaw_rad,
        velocity_m_s=rolling.velocity_m_s,
        speed_m_s=rolling.speed_m_s,
        wheel_speed_m_s=point_speed * (1.0 + slip) * body.tyre_radius_m / (body.tyre_radius_m + posed.tyre_m),
        yaw_rate_rad_s=rolling.yaw_rate_rad_s,
        steering_rad=np.arctan(body.wheelbase_m * rolling.curvature),
        stroke_m=posed.stroke_m,
        antenna_m=antenna,
        antenna_velocity_m_s=rolling.velocity_m_s + posed.antenna_velocity_m_s,
        antenna_height_m=antenna[:, 2] - road,
        road_height_m=road,
        level=path.level[sample],
        link_id=path.link_id[sample],
        link_offset_m=path.link_offset_m[sample],
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Rolling:
    """The wheels' motion: columns (n,) or (n, 3). `road`: rear height, middle height, pitch, roll, and their rates."""

    distance_m: Floats
    origin_m: Floats
    velocity_m_s: Floats
    speed_m_s: Floats
    acceleration_m_s2: Floats
    yaw_rad: Floats
    yaw_rate_rad_s: Floats
    road: Floats
    road_rate: Floats
    curvature: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Posed:
    """The body's: angles and rates (n,), rotation (n, 3, 3), positions against the rear axle's middle on the road."""

    roll_rad: Floats
    pitch_rad: Floats
    antenna_m: Floats
    antenna_velocity_m_s: Floats
    stroke_m: Floats
    tyre_m: Floats


def _rolling(driven: DrivenPath, contact: CubicCurve, s: Floats, v: Floats, a: Floats) -> _Rolling:
    origin, first, second = driven.curve.at(s)
    yaw, turn = driven.yaw_and_turn(s)
    stretch = np.linalg.norm(first, axis=1)  # one, but for the spline's error
    road, road_slope, _ = contact.at(s)
    normal_turn = body_yaw_rate(road[:, 3], road[:, 2], road_slope[:, 2], turn)
    return _Rolling(
        distance_m=s,
        origin_m=origin,
        velocity_m_s=first * v[:, None],
        speed_m_s=stretch * v,
        acceleration_m_s2=a * stretch + v**2 * np.einsum("ij,ij->i", first, second) / stretch,
        yaw_rad=yaw,
        yaw_rate_rad_s=turn * v,
        road=road,
        road_rate=road_slope * v[:, None],
        curvature=normal_turn / stretch,
    )


def _posed(body: VehicleBody, rolling: _Rolling, faults: Sequence[Fault], time_s: Floats) -> _Posed:
    radius, radius_rate = vehicle_effect(faults, ChangedTyre, time_s)
    load, load_rate = vehicle_effect(faults, ChangedLoad, time_s)
    springs = body.suspension
    road, rate = rolling.road, rolling.road_rate
    road_pitch, road_roll = road[:, 2], road[:, 3]
    if springs is None:
        heave, heave_rate = np.zeros((2, len(time_s)))
        (pitch, pitch_rate), (roll, roll_rate) = (road_pitch, rate[:, 2]), (road_roll, rate[:, 3])
    else:
        radius = radius - springs.tyre_shrinking_m_kg * load
        radius_rate = radius_rate - springs.tyre_shrinking_m_kg * load_rate
        step_s = 1.0 / RATE_HZ
        # Specific force: what the springs feel, on a slope the weight as well.
        forward = rolling.acceleration_m_s2 - STANDARD_GRAVITY_M_S2 * np.sin(road_pitch)
        left = rolling.speed_m_s * rolling.yaw_rate_rad_s + STANDARD_GRAVITY_M_S2 * np.sin(road_roll)
        axle, axle_rate = road[:, 1] + radius, rate[:, 1] + radius_rate
        up, up_rate = sprung(springs.heave, axle, -springs.sinking_m_kg * load, step_s)
        dive = -springs.dive_rad_s2_m * forward - springs.nose_up_rad_kg * load
        pitch, pitch_rate = sprung(springs.pitch, road_pitch, dive, step_s)
        roll, roll_rate = sprung(springs.roll, road_roll, springs.lean_rad_s2_m * left, step_s)
        heave, heave_rate = up - axle, up_rate - axle_rate
    on_road = rotations(road_roll, road_pitch, rolling.yaw_rad)
    on_body = rotations(roll, pitch, rolling.yaw_rad)
    centre = np.array((0.5 * body.wheelbase_m, 0.0, body.tyre_radius_m))
    arm, lever = on_road @ centre, on_body @ (body.antenna - centre)
    upright = np.array([0.0, 0.0, 1.0])
    # The rear axle's middle on the wheels' plane may be off the path's height where the road is not plane.
    lift = (road[:, 0] - rolling.origin_m[:, 2] + radius + heave)[:, None]
    lift_rate = (rate[:, 0] - rolling.velocity_m_s[:, 2] + radius_rate + heave_rate)[:, None]
    yaw, yaw_rate = rolling.yaw_rad, rolling.yaw_rate_rad_s
    turning_road = angular_velocity(road_pitch, yaw, (rate[:, 3], rate[:, 2], yaw_rate))
    turning = angular_velocity(pitch, yaw, (roll_rate, pitch_rate, yaw_rate))
    velocity = lift_rate * upright + np.cross(turning_road, arm) + np.cross(turning, lever)
    stroke = np.full(len(time_s), np.nan)
    if springs is not None:
        top = (*body.stroke_point, body.tyre_radius_m + springs.stroke_m)
        above = heave[:, None] * upright + on_body @ (top - centre)
        stroke = np.einsum("nk,nk->n", on_road[:, :, 2], above)
    return _Posed(
        roll_rad=roll,
        pitch_rad=pitch,
        antenna_m=lift * upright + arm + lever,
        antenna_velocity_m_s=velocity,
        stroke_m=stroke,
        tyre_m=radius,
    )

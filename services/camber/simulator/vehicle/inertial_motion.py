"""What a perfect inertial measurement unit measures on a moving body: angular rate and specific force.

The body moves in the world frame, whose axes follow the local vertical and turn with the earth:

    angular rate    ω = Rᵀ (ω_body + ω_earth + ω_transport)
    specific force  f = Rᵀ (a + (2 ω_earth + ω_transport) × v + γ up)

with R world from sensor, v and a those of the sensor's place: a point apart from the antenna by a lever arm has its
tangential and centripetal acceleration in its path. Source: P. D. Groves, Principles of GNSS, Inertial, and
Multisensor Integrated Navigation Systems, 2nd ed., 2.3.5, 5.3, 5.4 (wander azimuth: the axes do not turn about up).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.geodesy.gravity import normal_gravity_m_s2
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.satellites.orbits import EARTH_ROTATION_RAD_S
from camber.simulator.scene import Floats, Integers
from camber.simulator.vehicle.attitude import angular_velocity, rotations
from camber.simulator.vehicle.cubic_curve import CubicCurve
from camber.simulator.vehicle.pose_track import PoseTrack


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InertialMotion:
    """Columns (n, 3) in the axes of the sensor."""

    angular_rate_rad_s: Floats
    specific_force_m_s2: Floats


def inertial_motion(
    track: PoseTrack, frame: LocalFrame, vehicle_from_sensor: Floats, time_ns: Integers
) -> InertialMotion:
    """Angular rate and specific force at times (n,) at the point of a track.

    Between the track's samples positions and angles are cubic splines, so that accelerations change evenly: twice
    integrated they give the track again. `frame` is that of the world frame's plane, `vehicle_from_sensor` (3, 3).
    """
    start_ns = track.time_ns[0]
    known_s, asked_s = (track.time_ns - start_ns) / 1e9, (time_ns - start_ns) / 1e9
    curve = CubicCurve.through(known_s, np.column_stack((track.position_m, track.angles_rad)))
    value, first, second = curve.at(asked_s)
    velocity, acceleration = first[:, :3], second[:, :3]
    roll, pitch, yaw = value[:, 3:].T
    turning = angular_velocity(pitch, yaw, (first[:, 3], first[:, 4], first[:, 5]))
    latitude_rad, height_m = frame.latitude_rad, float(value[:, 2].mean())
    earth = EARTH_ROTATION_RAD_S * np.array([0.0, math.cos(latitude_rad), math.sin(latitude_rad)])
    transport = np.column_stack(
        (
            -velocity[:, 1] / (meridian_radius_m(latitude_rad) + height_m),
            velocity[:, 0] / (prime_vertical_radius_m(latitude_rad) + height_m),
            np.zeros(len(velocity)),
        )
    )
    gravity = np.array([0.0, 0.0, normal_gravity_m_s2(latitude_rad, height_m)])
    force = acceleration + np.cross(2.0 * earth + transport, velocity) + gravity
    world_from_sensor = rotations(roll, pitch, yaw) @ vehicle_from_sensor
    return InertialMotion(
        angular_rate_rad_s=np.einsum("nij,ni->nj", world_from_sensor, turning + earth + transport),
        specific_force_m_s2=np.einsum("nij,ni->nj", world_from_sensor, force),
    )

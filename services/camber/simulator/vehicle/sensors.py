"""What a vehicle's own sensors say of its true motion, each by its own clock and with its own errors.

Constant errors (scale, bias, mounting) are drawn once for a seed, noise for every sample; each from a random stream
of its own name, so that to change one leaves the others as they were.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.vehicle.attitude import body_yaw_rate
from camber.simulator.vehicle.attitude_sensor import AttitudeSensor, attitude_errors
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensor_clock import Readings, SensorClock, quantised
from camber.simulator.vehicle.wheel_pulses import edge_times, speed_of_edges

Surface = Callable[[Floats, Floats, Integers], Floats]
_BEAM_STEPS = 15  # each shrinks the error by the road's slope × the beam's cotangent, 0.04 for the car


@dataclass(frozen=True, slots=True)
class WheelSensor:
    """A ring of `edges_per_turn`; `edge_sigma` is how far an edge is off, in parts of the pitch."""

    rate_hz: float = 50.0
    edges_per_turn: int = 96
    scale_sigma: float = 0.005
    edge_sigma: float = 0.02
    least_speed_m_s: float = 0.35
    step_m_s: float = 0.01


@dataclass(frozen=True, slots=True)
class RateSensor:
    """A yaw rate sensor: it turns with the body, its bias walks at random."""

    rate_hz: float = 50.0
    bias_sigma_rad_s: float = math.radians(0.05)
    walk_rad_s_sqrt_s: float = math.radians(0.0005)
    noise_rad_s: float = math.radians(0.1)
    scale_sigma: float = 0.002
    step_rad_s: float = math.radians(0.01)


@dataclass(frozen=True, slots=True)
class SteeringSensor:
    """At the equivalent front wheel."""

    rate_hz: float = 50.0
    bias_sigma_rad: float = math.radians(0.3)
    noise_rad: float = math.radians(0.2)
    step_rad: float = math.radians(0.05)


@dataclass(frozen=True, slots=True)
class StrokeSensor:
    """At the suspension nearest to the antenna; `stated_sigma_m` is what it says of itself."""

    rate_hz: float = 50.0
    bias_sigma_m: float = 0.002
    noise_m: float = 0.002
    step_m: float = 0.0005
    stated_sigma_m: float = 0.003


@dataclass(frozen=True, slots=True)
class RangingSensor:
    """`angle_sigma_rad`: how far the true beam is off the angle that was measured when it was mounted."""

    rate_hz: float = 20.0
    bias_sigma_m: float = 0.002
    noise_m: float = 0.003
    step_m: float = 0.001
    angle_sigma_rad: float = math.radians(0.1)
    most_range_m: float = 10.0
    lost_share: float = 0.01
    stated_sigma_m: float = 0.004


@dataclass(frozen=True, slots=True)
class SensorSet:
    """All of a vehicle's. Clocks are off by a random offset and drift of these sizes."""

    wheel: WheelSensor = field(default_factory=WheelSensor)
    yaw_rate: RateSensor = field(default_factory=RateSensor)
    steering: SteeringSensor = field(default_factory=SteeringSensor)
    attitude: AttitudeSensor = field(default_factory=AttitudeSensor)
    stroke: StrokeSensor = field(default_factory=StrokeSensor)
    ranging: RangingSensor = field(default_factory=RangingSensor)
    clock_offset_sigma_s: float = 0.003
    clock_drift_sigma: float = 20.0e-6


@dataclass(frozen=True, slots=True, eq=False)
class VehicleReadings:
    """m/s, rad/s, rad, rad, rad, m, m; `stroke` None: a rigid body has none."""

    wheel_speed: Readings
    yaw_rate: Readings
    steering: Readings
    pitch: Readings
    roll: Readings
    stroke: Readings | None
    ranging: Readings


def read_sensors(
    trajectory: Trajectory, body: VehicleBody, surface_m: Surface, sensors: SensorSet, seed: int
) -> VehicleReadings:
    """All sensors over a whole trajectory. `surface_m` is the true road, as `Path.surface_m`."""

    def drawn(name: str) -> float:
        return float(stream(seed, name).standard_normal())

    def white(name: str, n: int) -> Floats:
        return stream(seed, name).standard_normal(n)

    def sampling(name: str, rate_hz: float) -> tuple[Integers, Integers]:
        clock = SensorClock.drawn(seed, name, sensors.clock_offset_sigma_s, sensors.clock_drift_sigma)
        return clock.sampling(int(trajectory.time_ns[0]), int(trajectory.time_ns[-1]), rate_hz)

    def sampled(column: Floats, true_ns: Integers) -> Floats:
        return np.interp(_seconds(trajectory, true_ns), _seconds(trajectory, trajectory.time_ns), column)

    w = sensors.wheel
    true_ns, stamps = sampling("wheel speed", w.rate_hz)
    speed = _wheel_speed(trajectory, body, w, _seconds(trajectory, true_ns), seed)
    speed = quantised(speed * (1.0 + w.scale_sigma * drawn("wheel scale")), w.step_m_s)
    wheel = Readings(stamps, true_ns, np.where(speed < w.least_speed_m_s, 0.0, speed))

    g = sensors.yaw_rate
    true_ns, stamps = sampling("yaw rate", g.rate_hz)
    n = len(true_ns)
    rate = sampled(_true_body_rate(trajectory), true_ns) * (1.0 + g.scale_sigma * drawn("yaw rate scale"))
    walk = g.walk_rad_s_sqrt_s / math.sqrt(g.rate_hz) * np.cumsum(white("yaw rate walk", n))
    rate = (
        rate + g.bias_sigma_rad_s * drawn("yaw rate bias") + walk + g.noise_rad_s * white("yaw rate noise", n)
    )
    yaw_rate = Readings(stamps, true_ns, quantised(rate, g.step_rad_s))

    s = sensors.steering
    true_ns, stamps = sampling("steering", s.rate_hz)
    angle = sampled(trajectory.steering_rad, true_ns) + s.bias_sigma_rad * drawn("steering bias")
    angle = angle + s.noise_rad * white("steering noise", len(true_ns))
    steering = Readings(stamps, true_ns, quantised(angle, s.step_rad))

    a = sensors.attitude
    true_ns, stamps = sampling("attitude", a.rate_hz)
    pitch, roll = (
        Readings(stamps, true_ns, quantised(sampled(column, true_ns) + error, a.step_rad))
        for column, error in zip(
            (trajectory.pitch_rad, trajectory.roll_rad),
            attitude_errors(trajectory, a, true_ns, seed),
            strict=True,
        )
    )

    stroke = None
    if body.suspension is not None:
        k = sensors.stroke
        true_ns, stamps = sampling("stroke", k.rate_hz)
        height = sampled(trajectory.stroke_m, true_ns) + k.bias_sigma_m * drawn("stroke bias")
        height = height + k.noise_m * white("stroke noise", len(true_ns))
        stroke = Readings(stamps, true_ns, quantised(height, k.step_m))

    r = sensors.ranging
    true_ns, stamps = sampling("ranging", r.rate_hz)
    angle_rad = body.ranging_angle_rad + r.angle_sigma_rad * drawn("ranging angle")
    distance = distance_to_road_m(trajectory, body, surface_m, true_ns, angle_rad)
    distance = distance + r.bias_sigma_m * drawn("ranging bias")
    distance = quantised(distance + r.noise_m * white("ranging noise", len(true_ns)), r.step_m)
    lost = stream(seed, "ranging lost").random(len(true_ns)) < r.lost_share
    lost |= ~((distance > 0.0) & (distance <= r.most_range_m))
    ranging = Readings(stamps, true_ns, np.where(lost, np.nan, distance))
    return VehicleReadings(wheel, yaw_rate, steering, pitch, roll, stroke, ranging)


def distance_to_road_m(
    trajectory: Trajectory, body: VehicleBody, surface_m: Surface, time_ns: Integers, angle_rad: float
) -> Floats:
    """True distance (n,) along the ranging beam, `angle_rad` below the body's horizontal, to the road at times (n,).

    NaN where the road's surface is not known below the beam.
    """
    origin, rotation = PoseTrack.of(trajectory, body, body.ranging).at(time_ns)
    flat, azimuth = math.cos(angle_rad), body.ranging_azimuth_rad
    beam = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), -math.sin(angle_rad)])
    towards = rotation @ beam
    half_ns = np.diff(trajectory.time_ns) // 2
    level = trajectory.level[np.searchsorted(trajectory.time_ns[:-1] + half_ns, time_ns)]
    distance = np.full(len(time_ns), body.ranging[2] / math.sin(angle_rad))
    for _ in range(_BEAM_STEPS):
        end = origin + distance[:, None] * towards
        distance = distance - (end[:, 2] - surface_m(end[:, 0], end[:, 1], level)) / towards[:, 2]
    return distance


def _wheel_speed(
    trajectory: Trajectory, body: VehicleBody, sensor: WheelSensor, time_s: Floats, seed: int
) -> Floats:
    """From edges, with the ring's own unevenness, the wheel standing anyhow in the beginning."""
    rng = stream(seed, "wheel ring")
    pitch_m = 2.0 * math.pi * body.tyre_radius_m / sensor.edges_per_turn
    uneven = np.clip(sensor.edge_sigma * rng.standard_normal(sensor.edges_per_turn), -0.2, 0.2)
    begin = float(rng.random())
    known_s = _seconds(trajectory, trajectory.time_ns)
    most = float(np.abs(trajectory.wheel_speed_m_s).max()) * float(known_s[-1])
    edges = np.arange(int(most / pitch_m) + 2)
    edge_m = (edges + begin + 0.2 + uneven[edges % sensor.edges_per_turn]) * pitch_m
    edge_s = edge_times(known_s, trajectory.wheel_speed_m_s, edge_m)
    return speed_of_edges(edge_s, time_s, 1.0 / sensor.rate_hz, pitch_m)


def _true_body_rate(trajectory: Trajectory) -> Floats:
    time_s = _seconds(trajectory, trajectory.time_ns)
    pitch_rate = np.gradient(trajectory.pitch_rad, time_s)
    return body_yaw_rate(trajectory.roll_rad, trajectory.pitch_rad, pitch_rate, trajectory.yaw_rate_rad_s)


def _seconds(trajectory: Trajectory, time_ns: Integers) -> Floats:
    passed: Floats = (time_ns - trajectory.time_ns[0]) / 1e9
    return passed

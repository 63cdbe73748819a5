"""What a vehicle's sensors measure of its true motion, each by its clock and with its errors, and the messages of it.

Constant errors (scale, bias, mounting) are drawn once for a seed, noise for every sample; each from a random stream
with its name, so that to change one leaves the others as they were.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from camber.schemas.motion import Motion, Ranging, Suspension
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.vehicle.attitude import body_yaw_rate
from camber.simulator.vehicle.attitude_sensor import AttitudeSensor, attitude_errors
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.rate_sensor import RateSensor, additional_errors
from camber.simulator.vehicle.sensor_clock import DriftingClock, Readings, quantised

Surface = Callable[[Floats, Floats, Integers], Floats]
OLDEST_NS = 100_000_000  # chosen: the period of the sensors
_BEAM_STEPS = 15  # each shrinks the error by the road's slope × the beam's cotangent, 0.04 for the car


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSensor:
    """A ring of `edges_per_turn`; `edge_sigma` is how far an edge is off, in parts of the pitch."""

    edges_per_turn: int = 96
    scale_sigma: float = 0.005
    edge_sigma: float = 0.02
    least_speed_m_s: float = 0.35
    step_m_s: float = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasedSensor:
    """Sizes of a constant bias, of noise and of the last digit, in the unit of what it measures."""

    bias_sigma: float
    noise: float
    step: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RangingSensor:
    """`angle_sigma_rad`: how far the true beam is off the angle that was measured when it was mounted."""

    bias_sigma_m: float = 0.002
    noise_m: float = 0.003
    step_m: float = 0.001
    angle_sigma_rad: float = math.radians(0.1)
    most_range_m: float = 10.0
    lost_share: float = 0.01
    stated_sigma_m: float = 0.004


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSet:
    """All of a vehicle's. Clocks are off by a random offset and drift of these sizes.

    Steering is at the equivalent front wheel [rad]; the stroke [m] at the suspension nearest to the antenna.
    """

    rate_hz: float = 50.0
    wheel: WheelSensor = field(default_factory=WheelSensor)
    yaw_rate: RateSensor = field(default_factory=RateSensor)
    steering: BiasedSensor = BiasedSensor(
        bias_sigma=math.radians(0.3), noise=math.radians(0.2), step=math.radians(0.05)
    )
    attitude: AttitudeSensor = field(default_factory=AttitudeSensor)
    stroke: BiasedSensor = BiasedSensor(bias_sigma=0.002, noise=0.002, step=0.0005)
    stroke_stated_sigma_m: float = 0.003
    ranging: RangingSensor = field(default_factory=RangingSensor)
    clock_offset_sigma_s: float = 0.003
    clock_drift_sigma: float = 20.0e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
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
    of = _Sampling(trajectory, sensors, seed)
    w, g, a, r = sensors.wheel, sensors.yaw_rate, sensors.attitude, sensors.ranging

    true_ns, stamps = of.times("wheel speed")
    speed = _wheel_speed(body, w, of, true_ns) * (1.0 + w.scale_sigma * of.draw("wheel scale"))
    speed = quantised(speed, w.step_m_s)
    speed = np.where(speed < w.least_speed_m_s, 0.0, speed)
    wheel_speed = Readings(time_ns=stamps, true_time_ns=true_ns, value=speed)

    true_ns, stamps = of.times("yaw rate")
    n = len(true_ns)
    pitch_rate = np.gradient(trajectory.pitch_rad, of.known_s)
    body_rate = body_yaw_rate(
        trajectory.roll_rad, trajectory.pitch_rad, pitch_rate, trajectory.yaw_rate_rad_s
    )
    rate = of.sampled(body_rate, true_ns) * (1.0 + g.scale_sigma * of.draw("yaw rate scale"))
    walk = g.walk_rad_s_sqrt_s / math.sqrt(sensors.rate_hz) * np.cumsum(of.white("yaw rate walk", n))
    bias, noise = g.bias_sigma_rad_s * of.draw("yaw rate bias"), g.noise_rad_s * of.white("yaw rate noise", n)
    rate = rate + bias + walk + noise
    more = additional_errors(trajectory, g, of.seconds(true_ns), seed)
    rate = quantised(rate if more is None else rate + more, g.step_rad_s)
    yaw_rate = Readings(time_ns=stamps, true_time_ns=true_ns, value=rate)

    true_ns, stamps = of.times("attitude")
    errors = attitude_errors(trajectory, a, true_ns, seed)
    pitch, roll = (
        Readings(
            time_ns=stamps,
            true_time_ns=true_ns,
            value=quantised(of.sampled(column, true_ns) + error, a.step_rad),
        )
        for column, error in zip((trajectory.pitch_rad, trajectory.roll_rad), errors, strict=True)
    )

    true_ns, stamps = of.times("ranging")
    angle_rad = body.ranging_angle_rad + r.angle_sigma_rad * of.draw("ranging angle")
    distance = distance_to_road_m(trajectory, body, surface_m, true_ns, angle_rad=angle_rad)
    distance = distance + r.bias_sigma_m * of.draw("ranging bias")
    distance = quantised(distance + r.noise_m * of.white("ranging noise", len(true_ns)), r.step_m)
    lost = stream(seed, "ranging lost").random(len(true_ns)) < r.lost_share
    lost |= ~((distance > 0.0) & (distance <= r.most_range_m))
    return VehicleReadings(
        wheel_speed=wheel_speed,
        yaw_rate=yaw_rate,
        steering=of.biased("steering", trajectory.steering_rad, sensors.steering),
        pitch=pitch,
        roll=roll,
        stroke=of.biased("stroke", trajectory.stroke_m, sensors.stroke) if body.suspension else None,
        ranging=Readings(time_ns=stamps, true_time_ns=true_ns, value=np.where(lost, np.nan, distance)),
    )


class _Sampling:
    """Times, truth and random numbers of the sensors of one drive."""

    def __init__(self, trajectory: Trajectory, sensors: SensorSet, seed: int) -> None:
        self.trajectory, self.sensors, self.seed = trajectory, sensors, seed
        self.known_s = self.seconds(trajectory.time_ns)

    def draw(self, name: str) -> float:
        return float(stream(self.seed, name).standard_normal())

    def white(self, name: str, n: int) -> Floats:
        return stream(self.seed, name).standard_normal(n)

    def seconds(self, time_ns: Integers) -> Floats:
        passed: Floats = (time_ns - self.trajectory.time_ns[0]) / 1e9
        return passed

    def times(self, name: str) -> tuple[Integers, Integers]:
        """True times and stamps of one sensor's samples."""
        s, t = self.sensors, self.trajectory.time_ns
        clock = DriftingClock.drawn(self.seed, name, s.clock_offset_sigma_s, s.clock_drift_sigma)
        return clock.sampling(int(t[0]), int(t[-1]), s.rate_hz)

    def sampled(self, column: Floats, true_ns: Integers) -> Floats:
        return np.interp(self.seconds(true_ns), self.known_s, column)

    def biased(self, name: str, column: Floats, sensor: BiasedSensor) -> Readings:
        true_ns, stamps = self.times(name)
        value = self.sampled(column, true_ns) + sensor.bias_sigma * self.draw(f"{name} bias")
        value = value + sensor.noise * self.white(f"{name} noise", len(true_ns))
        return Readings(time_ns=stamps, true_time_ns=true_ns, value=quantised(value, sensor.step))


def distance_to_road_m(
    trajectory: Trajectory, body: VehicleBody, surface_m: Surface, time_ns: Integers, *, angle_rad: float
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


def _wheel_speed(body: VehicleBody, sensor: WheelSensor, of: _Sampling, true_ns: Integers) -> Floats:
    """From edges, with the ring's unevenness, the wheel in any position in the beginning."""
    rng = stream(of.seed, "wheel ring")
    pitch_m = 2.0 * math.pi * body.tyre_radius_m / sensor.edges_per_turn
    uneven = np.clip(sensor.edge_sigma * rng.standard_normal(sensor.edges_per_turn), -0.2, 0.2)
    begin = float(rng.random())
    wheel_m_s = of.trajectory.wheel_speed_m_s
    edges = np.arange(int(float(np.abs(wheel_m_s).max()) * float(of.known_s[-1]) / pitch_m) + 2)
    edge_m = (edges + begin + 0.2 + uneven[edges % sensor.edges_per_turn]) * pitch_m
    edge_s = edge_times(of.known_s, wheel_m_s, edge_m)
    return speed_of_edges(edge_s, of.seconds(true_ns), 1.0 / of.sensors.rate_hz, pitch_m)


def edge_times(time_s: Floats, wheel_speed_m_s: Floats, edge_m: Floats) -> Floats:
    """When (m,) the wheel has rolled the ascending distances `edge_m` (m,), those only that it reaches.

    The speed (n,) is that of the circumference, between its samples it changes evenly; backwards counts as forwards.
    """
    speed = np.abs(wheel_speed_m_s)
    rolled = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s)))
    # An edge never lies within a standstill: equal distances there have no width.
    times: Floats = np.interp(edge_m[edge_m <= rolled[-1]], rolled, time_s)
    return times


def speed_of_edges(edge_s: Floats, time_s: Floats, window_s: float, pitch_m: float) -> Floats:
    """Speed (n,) at times (n,): the way from the last edge before the window to the last in it, by its time.

    Without an edge in the window it is that of the last two, or less if the next one is overdue. Zero before two
    edges have been seen.
    """
    if len(edge_s) < 2:
        return np.zeros(len(time_s))
    last = np.searchsorted(edge_s, time_s, side="right") - 1
    before = np.minimum(np.searchsorted(edge_s, time_s - window_s, side="right") - 1, last - 1)
    known = before >= 0
    last, before = np.maximum(last, 1), np.clip(before, 0, None)
    speed = (last - before) * pitch_m / (edge_s[last] - edge_s[before])
    waited_s = np.maximum(time_s - edge_s[last], 1e-9)
    return np.where(known, np.minimum(speed, pitch_m / waited_s), 0.0)


def motion_messages(readings: VehicleReadings) -> list[Motion]:
    """One message a reading of the yaw rate, by its stamp, with the newest readings of the others by then.

    So a vehicle's gateway puts together what comes from several units. What is older than `OLDEST_NS` is None.
    """
    time_ns = readings.yaw_rate.time_ns
    units = (readings.wheel_speed, readings.steering, readings.pitch, readings.roll)
    others = [_newest(one, time_ns) for one in units]
    columns = zip(time_ns.tolist(), readings.yaw_rate.value.tolist(), *others, strict=True)
    names = ("time_ns", "yaw_rate_rad_s", "wheel_speed_m_s", "steering_angle_rad", "pitch_rad", "roll_rad")
    return [Motion(**dict(zip(names, row, strict=True))) for row in columns]


def suspension_messages(readings: VehicleReadings, sensors: SensorSet) -> list[Suspension]:
    """One a reading of the stroke sensor; none for a rigid body."""
    if readings.stroke is None:
        return []
    sigma_m = sensors.stroke_stated_sigma_m
    return [
        Suspension(time_ns=t, stroke_height_m=height_m, stroke_sigma_m=sigma_m)
        for t, height_m in _known(readings.stroke)
    ]


def ranging_messages(readings: VehicleReadings, sensors: SensorSet, body: VehicleBody) -> list[Ranging]:
    """One a distance that was measured; what was lost is left out. The angle is the nominal one."""
    sigma_m, angle_rad = sensors.ranging.stated_sigma_m, body.ranging_angle_rad
    return [
        Ranging(time_ns=t, distance_m=distance_m, beam_angle_rad=angle_rad, distance_sigma_m=sigma_m)
        for t, distance_m in _known(readings.ranging)
    ]


def _known(readings: Readings) -> list[tuple[int, float]]:
    pairs = zip(readings.time_ns.tolist(), readings.value.tolist(), strict=True)
    return [(t, value) for t, value in pairs if not math.isnan(value)]


def _newest(readings: Readings, time_ns: Integers) -> list[float | None]:
    k = np.searchsorted(readings.time_ns, time_ns, side="right") - 1
    fresh = (k >= 0) & (time_ns - readings.time_ns[k] <= OLDEST_NS)
    values = readings.value[k].tolist()
    return [value if new else None for value, new in zip(values, fresh.tolist(), strict=True)]

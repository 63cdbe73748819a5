"""An inertial measurement unit on a vehicle: true angular rate and specific force, vibration, and the unit's errors.

Error model of each axis (IEEE Std 952, annex C, for gyros; IEEE Std 1293 for accelerometers):

    measured = quantised(limited(true + (scale and misalignment) true + bias + instability + walk + noise))

The unit is turned against its nominal mounting by a constant angle, that of a bracket, and has a clock like all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.schemas.motion import Imu, ImuClass, MountedImu
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.vehicle.body import VehicleBody
from camber.simulator.vehicle.inertial_motion import InertialMotion, inertial_motion
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensor_clock import DriftingClock, quantised

_DEG_H: Final = math.radians(1.0) / 3600.0
_MG: Final = 1e-3 * STANDARD_GRAVITY_M_S2
_SQRT_H: Final = 60.0  # √(3600 s)
_BRACKET_SIGMA_RAD: Final = math.radians(0.5)  # chosen: half of what a bracket without alignment has
_ALLAN_PEAK: Final = (
    0.618  # of the σ of a first-order Gauss–Markov process: 0.437 √2, IEEE Std 952, annex C, Markov noise
)
_INSTABILITY_S: Final = (
    100.0  # chosen: the peak, at 189 s, is where data sheets have the bottom of the Allan curve
)
_RISES_AT_S: Final = (
    1000.0  # chosen: there the Allan deviation of the walk is as large as the in-run instability
)


@dataclass(frozen=True, slots=True, kw_only=True)
class InertialErrors:
    """Sizes of the errors of three like axes, in the unit of what they measure, by default none.

    `noise_density` per √Hz: the random walk of angle or velocity, per √s. `instability`: lowest Allan deviation.
    `bias_sigma`: from switching on to switching off. `limit`: largest value, `step`: last digit.
    """

    noise_density: float = 0.0
    instability: float = 0.0
    bias_sigma: float = 0.0
    scale_sigma: float = 0.0
    misalignment_sigma_rad: float = 0.0
    step: float = 0.0
    limit: float = math.inf

    @property
    def walk_density(self) -> float:
        """Of the rate random walk K, per √s: K √(τ / 3) is the instability at `_RISES_AT_S`."""
        return self.instability * math.sqrt(3.0 / _RISES_AT_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class InertialUnit:
    """Errors of a unit, and of its mounting and clock."""

    gyro: InertialErrors
    accelerometer: InertialErrors
    bracket_sigma_rad: float = _BRACKET_SIGMA_RAD
    clock_offset_sigma_s: float = 0.003
    clock_drift_sigma: float = 20.0e-6
    vibration_share: float = 1.0
    """Of the vibration below, that reaches the unit."""


UNITS: Final[dict[ImuClass, InertialUnit]] = {
    # Bosch BMI160 (BST-BMI160-DS000): 0.007 °/s/√Hz, 180 µg/√Hz, ± 40 mg, 16 bits of ± 2000 °/s and ± 8 g; ± 3 °/s at
    # zero rate, of which calibration in the phone leaves a part.
    "phone": InertialUnit(
        gyro=InertialErrors(
            noise_density=math.radians(0.007),
            instability=10.0 * _DEG_H,  # chosen: not in the data sheet; of such sensors 5 to 20 °/h
            bias_sigma=math.radians(0.5),  # chosen: ± 1 °/s as two sigma
            scale_sigma=0.01,  # chosen, as the next: of such sensors 1 to 3 %
            misalignment_sigma_rad=0.01,  # cross-axis sensitivity: 1 to 2 %
            step=math.radians(4000.0 / 65536.0),
            limit=math.radians(2000.0),
        ),
        accelerometer=InertialErrors(
            noise_density=0.18 * _MG,
            instability=0.1 * _MG,  # chosen: not in the data sheet; of such sensors 0.05 to 0.2 mg
            bias_sigma=20.0 * _MG,  # ± 40 mg as two sigma
            scale_sigma=0.005,  # chosen, as the next: of such sensors 0.5 to 1 %
            misalignment_sigma_rad=0.005,  # cross-axis sensitivity
            step=16.0 / 65536.0 * STANDARD_GRAVITY_M_S2,
            limit=8.0 * STANDARD_GRAVITY_M_S2,
        ),
    ),
    # Analog Devices ADIS16465-1, ADIS16475: 0.15 °/√h, 2 to 3 °/h in run; 0.012 m/s/√h, 3.6 µg in run; 16 bits:
    # 160 LSB for 1 °/s, 4 LSB for 1 mg; ± 125 °/s, ± 8 g.
    "mems": InertialUnit(
        gyro=InertialErrors(
            noise_density=math.radians(0.15) / _SQRT_H,
            instability=2.5 * _DEG_H,
            bias_sigma=math.radians(0.2),  # not calibrated after switching on
            scale_sigma=0.003,  # chosen: what factory calibration leaves over temperature
            misalignment_sigma_rad=math.radians(0.05),  # axis to axis
            step=math.radians(1.0 / 160.0),
            limit=math.radians(125.0),
        ),
        accelerometer=InertialErrors(
            noise_density=0.012 / _SQRT_H,
            instability=3.6e-3 * _MG,
            bias_sigma=1.4 * _MG,  # chosen: repeatability over a year
            scale_sigma=0.001,  # chosen: what factory calibration leaves over temperature
            misalignment_sigma_rad=math.radians(0.05),
            step=0.25 * _MG,
            limit=8.0 * STANDARD_GRAVITY_M_S2,
        ),
    ),
    # Sensonor STIM300, data sheet TS1524, 10 g: 0.15 °/√h, 0.5 °/h, bias range ± 250 °/h, 500 ppm, 1 mrad, ± 400 °/s;
    # 0.06 m/s/√h, 0.05 mg, ± 0.75 mg from run to run, 300 ppm, 1 mrad.
    "tactical": InertialUnit(
        gyro=InertialErrors(
            noise_density=math.radians(0.15) / _SQRT_H,
            instability=0.5 * _DEG_H,
            bias_sigma=250.0 / 3.0 * _DEG_H,  # ± 250 °/h as three sigma; not zeroed at rest
            scale_sigma=500e-6,
            misalignment_sigma_rad=1e-3,
            step=math.radians(2.0**-14),
            limit=math.radians(400.0),
        ),
        accelerometer=InertialErrors(
            noise_density=0.06 / _SQRT_H,
            instability=0.05 * _MG,
            bias_sigma=0.75 * _MG,
            scale_sigma=300e-6,
            misalignment_sigma_rad=1e-3,
            step=2.0**-19 * STANDARD_GRAVITY_M_S2,
            limit=10.0 * STANDARD_GRAVITY_M_S2,
        ),
    ),
}

# Vibration that the body has beyond its springs. Chosen: a car's floor on asphalt has 0.3 to 0.5 m/s² at 50 km/h
# (ISO 2631-1, weighted: "a little uncomfortable" from 0.315 on), upright twice as much as along and across.
_ROAD_M_S2_PER_M_S = 0.03
_ROAD_SHARES = np.array([0.5, 0.5, 1.0])
_ROAD_BAND_HZ = (5.0, 30.0)  # above the body on its springs, around the wheels on their tyres at 10 to 15 Hz
# Chosen: the firing of four cylinders, twice a turn, at 750 to 2500 turns a minute.
_ENGINE_M_S2 = 0.05
_ENGINE_HZ_PER_M_S = 2.5
_ENGINE_GROWTH_PER_M_S = 0.1
_ENGINE_HZ = (25.0, 80.0)
_ENGINE_SHARES = np.array([0.3, 1.0, 1.0])
_ARM_M = 1.35  # half a wheelbase: the body rocks by what its ends move against one another
_PASSED_SHARE = 0.4  # of the rate of samples: a unit filters what is above


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImuReadings:
    """Samples by the unit's clock, in its axes: times (n,), columns (n, 3); `true_time_ns` is truth."""

    time_ns: Integers
    true_time_ns: Integers
    angular_rate_rad_s: Floats
    specific_force_m_s2: Floats


def read_imu(
    trajectory: Trajectory,
    body: VehicleBody,
    frame: LocalFrame,
    mounted: MountedImu,
    *,
    unit: InertialUnit,
    rate_hz: float,
    seed: int,
) -> ImuReadings:
    """Sample a unit over a whole trajectory; `frame` is that of the world frame's plane."""
    clock = DriftingClock.drawn(seed, "imu", unit.clock_offset_sigma_s, unit.clock_drift_sigma)
    start_ns, end_ns = int(trajectory.time_ns[0]), int(trajectory.time_ns[-1])
    true_ns, stamps = clock.sampling(start_ns, end_ns, rate_hz)
    track = PoseTrack.of(trajectory, body, (mounted.x_m, mounted.y_m, mounted.z_m))
    turn = _vehicle_from_unit(mounted, unit.bracket_sigma_rad, seed)
    true = inertial_motion(track, frame, turn, true_ns)
    known_s, asked_s = (trajectory.time_ns - start_ns) / 1e9, (true_ns - start_ns) / 1e9
    speed = np.abs(np.interp(asked_s, known_s, trajectory.speed_m_s))
    shaken = vibration(speed, rate_hz, seed)
    return ImuReadings(
        time_ns=stamps,
        true_time_ns=true_ns,
        angular_rate_rad_s=with_errors(
            true.angular_rate_rad_s + unit.vibration_share * shaken.angular_rate_rad_s @ turn,
            unit.gyro,
            rate_hz,
            name="gyro",
            seed=seed,
        ),
        specific_force_m_s2=with_errors(
            true.specific_force_m_s2 + unit.vibration_share * shaken.specific_force_m_s2 @ turn,
            unit.accelerometer,
            rate_hz,
            name="accelerometer",
            seed=seed,
        ),
    )


def with_errors(true: Floats, errors: InertialErrors, rate_hz: float, *, name: str, seed: int) -> Floats:
    """What three axes measure of true values (n, 3) at even steps; each error has its stream of random numbers."""

    def draw(error: str, *shape: int) -> Floats:
        return stream(seed, f"imu {name} {error}").standard_normal(shape)

    n = len(true)
    turned = errors.misalignment_sigma_rad * draw("misalignment", 3, 3)
    np.fill_diagonal(turned, errors.scale_sigma * draw("scale", 3))
    memory = memory_of(np.full(n, 1.0 / rate_hz), _INSTABILITY_S)
    drift = errors.instability / _ALLAN_PEAK * gauss_markov(draw("instability", n, 3), memory)
    drift += errors.walk_density / math.sqrt(rate_hz) * np.cumsum(draw("walk", n, 3), axis=0)
    noise = errors.noise_density * math.sqrt(rate_hz) * draw("noise", n, 3)
    value = true + true @ turned.T + errors.bias_sigma * draw("bias", 3) + drift + noise
    return quantised(np.clip(value, -errors.limit, errors.limit), errors.step)


def vibration(speed_m_s: Floats, rate_hz: float, seed: int) -> InertialMotion:
    """Rates and forces (n, 3) in the vehicle's axes by road and engine at speeds (n,); they have no lasting mean."""
    road = _road_noise(len(speed_m_s), rate_hz, seed)
    middle_hz = math.sqrt(_ROAD_BAND_HZ[0] * _ROAD_BAND_HZ[1])
    road_m_s2 = _ROAD_M_S2_PER_M_S * speed_m_s[:, None] * road[:, :3] * _ROAD_SHARES
    road_rad_s = _ROAD_M_S2_PER_M_S * speed_m_s[:, None] * road[:, 3:] / (2.0 * math.pi * middle_hz * _ARM_M)
    turns_hz = np.clip(_ENGINE_HZ[0] + _ENGINE_HZ_PER_M_S * speed_m_s, *_ENGINE_HZ)
    passed = turns_hz < _PASSED_SHARE * rate_hz
    size_m_s2 = _ENGINE_M_S2 * (1.0 + _ENGINE_GROWTH_PER_M_S * speed_m_s) * passed
    starts = 2.0 * math.pi * stream(seed, "imu engine").random(6)
    engine = math.sqrt(2.0) * np.sin(2.0 * math.pi * np.cumsum(turns_hz)[:, None] / rate_hz + starts)
    return InertialMotion(
        specific_force_m_s2=road_m_s2 + size_m_s2[:, None] * engine[:, :3] * _ENGINE_SHARES,
        angular_rate_rad_s=road_rad_s
        + (size_m_s2 / (2.0 * math.pi * turns_hz * _ARM_M))[:, None] * engine[:, 3:] * _ENGINE_SHARES[::-1],
    )


def imu_messages(readings: ImuReadings) -> list[Imu]:
    """One a sample, by its stamp."""
    columns = (readings.time_ns, readings.angular_rate_rad_s, readings.specific_force_m_s2)
    return [
        Imu(time_ns=time_ns, angular_rate_rad_s=tuple(rate), specific_force_m_s2=tuple(force))
        for time_ns, rate, force in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _vehicle_from_unit(mounted: MountedImu, sigma_rad: float, seed: int) -> Floats:
    """The nominal rotation (3, 3), and by how much the bracket is off."""
    nominal = np.radians((mounted.roll_deg, mounted.pitch_deg, mounted.yaw_deg)).tolist()
    off = (sigma_rad * stream(seed, "imu bracket").standard_normal(3)).tolist()
    return rotation_from_roll_pitch_yaw(*nominal) @ rotation_from_roll_pitch_yaw(*off)


def _road_noise(n: int, rate_hz: float, seed: int) -> Floats:
    """Noise (n, 6) of unit variance in the band of the road's vibration, as far as the unit passes it."""
    spectrum = np.fft.rfft(stream(seed, "imu road").standard_normal((n, 6)), axis=0)
    at_hz = np.fft.rfftfreq(n, 1.0 / rate_hz)
    kept = (at_hz >= _ROAD_BAND_HZ[0]) & (at_hz <= min(_ROAD_BAND_HZ[1], _PASSED_SHARE * rate_hz))
    share = kept.mean()
    noise: Floats = np.fft.irfft(np.where(kept[:, None], spectrum, 0.0), n, axis=0)
    return noise / math.sqrt(share) if share > 0.0 else noise

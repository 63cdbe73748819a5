"""One minute of a real car's wheels, steering and inertial unit: the recording comma-2018-08-02, with its truth.

PYTHONPATH=tests python -m support.comma_drive

Sources: comma2k19's page (axes forward, right, down; wheels front left, front right, rear left, rear right) and the
recording's row in the README of CAMBER_DATA. The car is a RAV4, steering ratio and wheelbase by its specification. The
command prints errors of dead reckoning over windows that begin every second (`support.dead_reckoning_windows`): by
wheels with the yaw rate about the mean specific force, by wheels with the inertial unit, and by wheels and steering.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from camber.geodesy.ellipsoid import geodetic_from_ecef_scalar
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.localizer.arrays import Floats
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.inertial.imu_motion import ImuOptions, InertialSample, with_imu
from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import Imu, Motion
from support.dead_reckoning_windows import DriveTruth, Window, by_imu, figures, windows

FOLDER: Final = "comma-2018-08-02"
WHEELBASE_M: Final = 2.66  # Toyota's specification of the RAV4
STEERING_RATIO: Final = 16.88  # openpilot's parameters of this car
TRUTH_SIGMA_M: Final = 0.3  # "below a metre" at 95 %, per axis, of consecutive positions
RELATIVE_SIGMA_M: Final = (
    0.15  # the truth's own, of a displacement over half a minute: its residual against the wheels
)
YAW_SIGMA_RAD: Final = math.radians(
    0.2
)  # of the truth: its yaw scatters by 0.12° about the integrated yaw rate
BEGIN_NS: Final = (2012 * 604_800 + 404_106) * 1_000_000_000  # GPS time of the first frame, whole seconds


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CommaDrive:
    """Motion with the yaw rate about the mean specific force, the inertial unit by itself, and the truth."""

    motion: list[Motion]
    imu: list[Imu]
    mount: SensorMount
    truth: DriveTruth


def folder() -> Path | None:
    """Where the recording is; None without it."""
    path = Path(os.environ.get("CAMBER_DATA", "")) / FOLDER
    return path if os.environ.get("CAMBER_DATA") and path.is_dir() else None


def read_drive(path: Path) -> CommaDrive:
    """The recording in `path`; yaw rate about the mean specific force, which on a minute's average points up."""

    def read(name: str) -> Floats:
        return np.asarray(np.load(path / name), dtype=np.float64)

    can, imu = "processed_log/CAN", "processed_log/IMU"
    frame_s, ecef_m = read("global_pose/frame_times"), read("global_pose/frame_positions")
    begin_s = float(frame_s[0])
    gyro_s, wheel_s, steering_s = (
        read(f"{imu}/gyro/t"),
        read(f"{can}/wheel_speed/t"),
        read(f"{can}/steering_angle/t"),
    )
    forces = read(f"{imu}/accelerometer/value")
    force = forces.mean(axis=0)
    rate = read(f"{imu}/gyro/value") @ (force / np.linalg.norm(force))
    wheels = read(f"{can}/wheel_speed/value")[:, 2:].mean(axis=1)  # rear: they do not drive
    steering = np.radians(read(f"{can}/steering_angle/value").reshape(-1)) / STEERING_RATIO
    rows = (
        np.searchsorted(gyro_s, wheel_s, side="right") - 1,
        np.searchsorted(steering_s, wheel_s, side="right") - 1,
    )
    motion = [
        Motion(
            time_ns=_ns(t - begin_s),
            wheel_speed_m_s=float(wheels[k]),
            yaw_rate_rad_s=float(rate[i]),
            steering_angle_rad=float(steering[j]),
        )
        for k, (t, i, j) in enumerate(zip(wheel_s.tolist(), *rows, strict=True))
        if i >= 0 and j >= 0 and frame_s[0] <= t <= frame_s[-1]
    ]
    to_enu = LocalFrame(*geodetic_from_ecef_scalar(*ecef_m[0].tolist())).enu_from_ecef_rotation().T
    position = (ecef_m - ecef_m[0]) @ to_enu
    velocity = read("global_pose/frame_velocities") @ to_enu
    forward = _forward(read("global_pose/frame_orientations")) @ to_enu
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    mounted = float(
        np.mean((yaw - course + math.pi) % math.tau - math.pi)
    )  # the camera against the direction of travel
    truth = DriveTruth(
        time_ns=np.array([_ns(t - begin_s) for t in frame_s.tolist()], dtype=np.float64),
        position_m=position[:, :2],
        yaw_rad=yaw - mounted,
        driven_m=np.append(0.0, np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T))),
        sigma_m=TRUTH_SIGMA_M,
        relative_sigma_m=RELATIVE_SIGMA_M,
        yaw_sigma_rad=YAW_SIGMA_RAD,
    )
    force_s = read(f"{imu}/accelerometer/t")
    at_gyro = np.column_stack([np.interp(gyro_s, force_s, column) for column in forces.T])
    samples = [
        Imu(time_ns=_ns(t - begin_s), angular_rate_rad_s=tuple(turn), specific_force_m_s2=tuple(pull))
        for t, turn, pull in zip(
            gyro_s.tolist(), read(f"{imu}/gyro/value").tolist(), at_gyro.tolist(), strict=True
        )
        if frame_s[0] <= t <= frame_s[-1]
    ]
    return CommaDrive(motion=motion, imu=samples, mount=_mount(force), truth=truth)


def _mount(force_m_s2: Floats) -> SensorMount:
    """The unit's mounting by the mean specific force: it points up on a minute's average, and its x axis ahead."""
    up = force_m_s2 / np.linalg.norm(force_m_s2)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead = ahead / np.linalg.norm(ahead)
    vehicle_from_imu = np.vstack((ahead, np.cross(up, ahead), up))
    roll, pitch, yaw = roll_pitch_yaw_from_rotation(vehicle_from_imu)
    return SensorMount(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)


def wheels_and_yaw_rate(drive: CommaDrive) -> list[InertialSample]:
    """Samples without an inertial unit."""
    return [InertialSample(motion, None) for motion in drive.motion]


def wheels_and_steering(drive: CommaDrive) -> list[InertialSample]:
    """Samples without any rotation sensor but the steering."""
    without = [motion.model_copy(update={"yaw_rate_rad_s": None}) for motion in drive.motion]
    return [InertialSample(motion, None) for motion in without]


def wheels_and_imu(drive: CommaDrive) -> tuple[list[InertialSample], PoseModel]:
    """Samples of the phone's inertial unit with the wheels, and the filter's parameters for them."""
    options = ImuOptions(noise=IMU_NOISE["phone"], mount=drive.mount)
    return by_imu(drive.motion, drive.imu, options), with_imu(model_of_car(), options)


def model_of_car(**motion: Any) -> PoseModel:
    """The filter's parameters for the recording's car."""
    return PoseModel(motion=MotionModel(wheelbase_m=WHEELBASE_M, **motion))


def windows_by_wheels(drive: CommaDrive, lasts_s: float, *, anchored: bool = True) -> list[Window]:
    """Windows by wheels, yaw rate and steering."""
    return windows(wheels_and_yaw_rate(drive), drive.truth, lasts_s, model=model_of_car(), anchored=anchored)


def _forward(quaternions: Floats) -> Floats:
    """The camera's forward axis (n, 3) in ECEF, by quaternions (n, 4) w, x, y, z."""
    w, x, y, z = quaternions.T
    return np.column_stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)))


def _ns(seconds: float) -> int:
    return BEGIN_NS + round(seconds * 1e9)


def main() -> None:
    path = folder()
    if path is None:
        print(f"CAMBER_DATA names no folder with {FOLDER}: nothing to do")
        return
    drive = read_drive(path)
    imu_samples, imu_model = wheels_and_imu(drive)
    for name, samples, model in (
        ("wheels and yaw rate", wheels_and_yaw_rate(drive), model_of_car()),
        ("wheels and inertial unit", imu_samples, imu_model),
        ("wheels and steering", wheels_and_steering(drive), model_of_car(a_rate_sensor="steering")),
    ):
        for anchored in (True, False):
            for lasts_s in (10.0, 20.0, 30.0):
                each = windows(samples, drive.truth, lasts_s, model=model, anchored=anchored)
                print(f"{name}, {'anchored' if anchored else 'nothing'} before, {figures(each, lasts_s)}")


if __name__ == "__main__":
    main()

"""Dead reckoning with simulated inertial units, without satellites and LiDAR for a minute, or without wheels.

PYTHONPATH=tests python -m support.imu_statistics --seeds 1 2 3

Ten minutes in rounds through a city, by wheels and by a unit of each class. Once a second a true position, off
by 0.05 m, anchors the pose; from the third minute on windows begin every 10 s in which nothing but motion is used. The
wheels, the unit, its bracket and its clock have the simulator's errors, which are drawn anew for each seed.
"""

from __future__ import annotations

import argparse
from typing import get_args

import numpy as np

from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.inertial.imu_motion import ImuOptions, InertialSample, with_imu
from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import ImuClass, Motion
from camber.simulator.scenario import DistrictPlace, Scenario, SimulatedImu
from camber.simulator.simulated_drive import lay_out, sensors_of
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.imu import UNITS, imu_messages, read_imu
from camber.simulator.vehicle.sensors import motion_messages, read_sensors
from support.dead_reckoning_windows import DriveTruth, Window, by_imu, figures, windows

BEGINS_AFTER_S = 120.0
EVERY_S = 10.0
LEAST_DRIVEN_M = 100.0  # in a window: one that stands has no share of the way


def without_imu(seed: int) -> tuple[list[Motion], DriveTruth]:
    """Motion of the drive, and its truth."""
    scenario = scenario_of(seed)
    _, path, trajectory = lay_out(scenario, CAR)
    readings = read_sensors(trajectory, CAR, path.surface_m, sensors_of(scenario), seed=seed)
    driven = np.append(0.0, np.cumsum(np.hypot(*np.diff(trajectory.origin_m[:, :2], axis=0).T)))
    truth = DriveTruth(
        time_ns=trajectory.time_ns.astype(np.float64),
        position_m=trajectory.origin_m[:, :2],
        yaw_rad=np.unwrap(trajectory.yaw_rad),
        driven_m=driven,
    )
    return motion_messages(readings), truth


def with_unit(seed: int, imu_class: ImuClass, motion: list[Motion]) -> tuple[list[InertialSample], PoseModel]:
    """Samples of the wheels with a unit, and the filter's parameters for them."""
    scenario, mounted = scenario_of(seed), SimulatedImu.model_validate({"class": imu_class})
    district, _, trajectory = lay_out(scenario, CAR)
    readings = read_imu(
        trajectory, CAR, district.frame, mounted, unit=UNITS[imu_class], rate_hz=mounted.rate_hz, seed=seed
    )
    mount = SensorMount(x_m=mounted.x_m, y_m=mounted.y_m, z_m=mounted.z_m)
    options = ImuOptions(noise=IMU_NOISE[imu_class], mount=mount)
    return by_imu(motion, imu_messages(readings), options), with_imu(PoseModel(), options)


def scenario_of(seed: int) -> Scenario:
    """Ten minutes in rounds through a city."""
    place = DistrictPlace(kind="city", route="rounds")
    return Scenario(name="rounds", seed=seed, duration_s=600.0, place=place, yaw_rate_sensor="automotive")


def windows_of(seed: int, imu_class: ImuClass | None, lasts_s: float = 60.0) -> list[Window]:
    """Windows of one drive, by a unit of a class or by the vehicle's yaw-rate sensor."""
    motion, truth = without_imu(seed)
    if imu_class is None:
        samples, model = [InertialSample(one, None) for one in motion], PoseModel()
    else:
        samples, model = with_unit(seed, imu_class, motion)
    each = windows(
        samples, truth, lasts_s, model=model, every_s=EVERY_S, begins_after_s=BEGINS_AFTER_S, seed=seed
    )
    return [window for window in each if window.driven_m >= LEAST_DRIVEN_M]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    args = parser.parse_args()
    classes: tuple[ImuClass | None, ...] = (None, *get_args(ImuClass))
    for imu_class in classes:
        each = [window for seed in args.seeds for window in windows_of(seed, imu_class)]
        name = "yaw-rate sensor" if imu_class is None else f"{imu_class} unit"
        print(f"wheels and {name}, seeds {args.seeds}: {figures(each, 60.0)}", flush=True)


if __name__ == "__main__":
    main()

"""`drive.toml` of a simulated drive."""

from __future__ import annotations

import json
import math

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.simulator.injected_faults import DroppedProcess, of_kind
from camber.simulator.random_streams import stream
from camber.simulator.scenario import SimulatedImu
from camber.simulator.simulated_drive import SimulatedDrive
from camber.simulator.vehicle.body import Point, VehicleBody

# Chosen: a parking place known from a map.
_POSE_SIGMA_M = 1.0
_YAW_SIGMA_RAD = math.radians(2.0)


def manifest_text(drive: SimulatedDrive) -> str:
    """The manifest, with a given pose as from a parking place: off by 1 m and 2° (one sigma, in each direction)."""
    scenario, body = drive.scenario, drive.body
    tables = [
        f'''\
# Simulated: scenario {scenario.name}, seed {scenario.seed}. Nothing in it is evidence of performance on a road.
name = "{scenario.name}"
description = {_text(scenario.description)}
vehicle = "{body.name}"
simulated = true
datum = "WGS84"
''',
        """\
[receiver]
format = "pos"
file = "receiver.pos"
arrivals = "receiver_arrivals.csv"

[observations]
rover_obs = "rover.obs"
rover_arrivals = "rover_arrivals.csv"
base_obs = "base.obs"
ephemerides = ["brdc.nav"]
""",
        '[motion]\nfile = "motion.csv"\n' if scenario.motion else "",
        _imu(scenario.imu),
        '[suspension]\nfile = "suspension.csv"\n' if body.suspension is not None else "",
        '[ranging]\nfile = "ranging.csv"\n',
        '[sweeps]\nfolder = "sweeps"\n' if scenario.lidar is not None else "",
        '[map]\nrelease = "map"\n',
        '[truth]\nformat = "camber"\nfile = "truth.csv"\n',
        *(
            f"[lever_arms.{name}]\nx_m = {x}\ny_m = {y}\nz_m = {z:.6g}\n"
            for name, (x, y, z) in _lever_arms(body).items()
        ),
        *(
            f'[[kills]]\nservice = "{fault.service}"\nat_s = {fault.onset_s}\n'
            for fault in of_kind(scenario.faults, DroppedProcess)
        ),
        _antenna_height(body),
        # No input is synthesised; the table also says how long the vehicle is.
        f"[surrogates]\nwheelbase_m = {body.wheelbase_m}\n",
        _initial_pose(drive),
    ]
    return "\n".join(table for table in tables if table)


def _text(text: str) -> str:
    """As a TOML string: JSON's, but for the one control character that JSON leaves as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _imu(imu: SimulatedImu | None) -> str:
    if imu is None:
        return ""
    fields = imu.model_dump(exclude={"imu_class", "rate_hz"})
    lines = ["[imu]", 'file = "imu.csv"', f'class = "{imu.imu_class}"']
    return "\n".join([*lines, *(f"{name} = {value!r}" for name, value in fields.items()), ""])


def _lever_arms(body: VehicleBody) -> dict[str, Point]:
    arms = {"antenna": body.antenna, "lidar": body.lidar, "wheel": body.wheel, "ranging": body.ranging}
    if body.suspension is not None:
        arms["suspension"] = (*body.stroke_point, body.tyre_radius_m + body.suspension.stroke_m)
    return arms


def _antenna_height(body: VehicleBody) -> str:
    """All that was measured of the vehicle, so that the methods can be compared; stroke first, where there is one."""
    h_ba_m = body.suspension_to_antenna_m
    lines = [
        "[antenna_height]",
        f'way = "{"fixed" if h_ba_m is None else "stroke"}"',
        f"height_m = {body.antenna[2]}",
        "sigma_m = 0.01",
        f"beam_azimuth_deg = {math.degrees(body.ranging_azimuth_rad):.6g}",
    ]
    if h_ba_m is not None:
        lines += [f"suspension_to_antenna_m = {h_ba_m:.6f}", f"tyre_radius_m = {body.tyre_radius_m}"]
    return "\n".join([*lines, ""])


def _initial_pose(drive: SimulatedDrive) -> str:
    rng = stream(drive.scenario.seed, "given pose")
    east_m, north_m, up_m = drive.trajectory.antenna_m[0].tolist()
    off_m = rng.normal(0.0, _POSE_SIGMA_M, 2)
    latitude, longitude, _ = drive.district.frame.geodetic_from_east_north(
        east_m + float(off_m[0]), north_m + float(off_m[1]), up_m
    )
    yaw_rad = wrap_pi(float(drive.trajectory.yaw_rad[0]) + float(rng.normal(0.0, _YAW_SIGMA_RAD)))
    return (
        f"[initial_pose]\nlatitude_deg = {np.degrees(latitude):.9f}\nlongitude_deg = {np.degrees(longitude):.9f}\n"
        f"yaw_deg = {np.degrees(yaw_rad):.4f}\nhorizontal_sigma_m = {_POSE_SIGMA_M}\n"
        f"yaw_sigma_deg = {math.degrees(_YAW_SIGMA_RAD):.6g}\n"
    )

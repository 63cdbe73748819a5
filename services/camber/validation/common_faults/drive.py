"""Drives for common faults: simulated vehicle and map, a receiver's fixes as solutions, sweeps made in their turn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from camber.formats.drive.motion_csv import write_samples
from camber.formats.drive.truth_csv import TruthTable, write_truth
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.geodesy.angles import wrap_pi, wrap_pi_array
from camber.replay.drive_inputs import DriveInputs, prepare_drive
from camber.replay.sweep_files import SweepFile
from camber.schemas.drive import load_manifest
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion
from camber.simulator.random_streams import stream
from camber.simulator.scenario import load_scenario
from camber.simulator.scene import Path as DrivenPath
from camber.simulator.scene import Trajectory
from camber.simulator.simulated_drive import SENSORS, district_of
from camber.simulator.vehicle.beam_pattern import BEAMS_32
from camber.simulator.vehicle.body import CAR
from camber.simulator.vehicle.lidar import Scan, SimulatedLidar
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensors import motion_messages, read_sensors
from camber.simulator.world.countryside import Ground, country_district
from camber.simulator.world.district import District
from camber.simulator.world.ray_tracing import ShapeTracer
from camber.simulator.world.survey import SURVEYED_BEFORE_NS, SurveyErrors, write_survey
from camber.validation.common_faults.fault_cases import CommonFault, Scene
from camber.validation.common_faults.fix_series import OPEN, FixErrors, FixSeries, fix_series
from camber.validation.common_faults.wrong_episodes import WrongEpisodes

_START_NS = load_scenario("open-sky").start_ns
_MOST_SPEED_M_S = 14.0  # chosen: no less than `countryside` allows
_BEYOND_S = 40.0  # the trajectory goes on for the fixes that are led ahead: 0.3 m/s for half an hour is 540 m
_TRUTH_EVERY = 10  # rows of a trajectory of 100 Hz
_POSE_SIGMA_M, _YAW_SIGMA_RAD = 1.0, math.radians(2.0)  # as given poses of other simulated drives


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Where and how long one drives; what else is random follows from `seed`."""

    scene: Scene = "country"
    ground: Ground = "hilly"
    seed: int = 1
    lasts_s: float = 600.0

    @property
    def name(self) -> str:
        """For files and tables."""
        return f"{self.ground if self.scene == 'country' else self.scene}-seed-{self.seed}-{self.lasts_s:g}s"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FaultDrive:
    """A drive ready to be replayed, and what its fixes are."""

    inputs: DriveInputs
    truth: TruthTable
    fixes: FixSeries
    driven_m: float


def fault_drive(
    setting: Setting,
    fault: CommonFault,
    folder: Path,
    *,
    errors: FixErrors = OPEN,
    episodes: WrongEpisodes | None = None,
) -> FaultDrive:
    """Make the native files of a drive in `folder`, and its inputs."""
    district, path, trajectory = _driven(setting)
    folder.mkdir(parents=True, exist_ok=True)
    fixes = fix_series(
        trajectory,
        district.frame,
        fault,
        seed=setting.seed,
        lasts_s=setting.lasts_s,
        errors=errors,
        episodes=episodes,
    )
    last = int(fixes.time_ns[-1])
    readings = read_sensors(trajectory, CAR, path.surface_m, SENSORS, seed=setting.seed)
    motion = [m for m in motion_messages(readings) if m.time_ns <= last]
    write_samples(folder / "motion.csv", Motion, motion)
    lines = (format_pos_line(one, velocity=True) for one in fixes.solutions)
    (folder / "receiver.pos").write_bytes(b"".join((format_pos_header(velocity=True), *lines)))
    truth = _truth(district, trajectory, last)
    write_truth(folder / "truth.csv", truth)
    lidar = setting.scene != "country"
    if lidar:
        (folder / "sweeps").mkdir(exist_ok=True)
    _write_map(folder / "map", setting, district)
    (folder / "drive.toml").write_text(_manifest(setting, fault, district, trajectory, lidar=lidar), "utf-8")
    inputs = prepare_drive(load_manifest(folder / "drive.toml"), folder / "work")
    if lidar:
        inputs = _with_sweeps(inputs, setting, district, trajectory)
    rows = slice(0, round(setting.lasts_s * 100.0))
    driven_m = float(trajectory.speed_m_s[rows].sum() * 0.01)
    return FaultDrive(inputs=inputs, truth=truth, fixes=fixes, driven_m=driven_m)


@lru_cache(maxsize=1)
def _driven(setting: Setting) -> tuple[District, DrivenPath, Trajectory]:
    if setting.scene == "country":
        lasts_s = setting.lasts_s + _BEYOND_S
        district = country_district(setting.seed, setting.ground, length_m=lasts_s * _MOST_SPEED_M_S)
        path = district.path()
    else:
        scenario = load_scenario(setting.scene, [f"seed={setting.seed}"])
        lasts_s = min(setting.lasts_s + _BEYOND_S, 600.0)
        district = district_of(scenario)
        path = district.path()
    return district, path, drive(path, CAR, start_ns=_START_NS, duration_s=lasts_s)


@lru_cache(maxsize=1)
def _shapes(setting: Setting) -> ShapeTracer:
    return ShapeTracer(_driven(setting)[0].shapes("drive"))


def _write_map(folder: Path, setting: Setting, district: District) -> None:
    write_survey(
        folder,
        district,
        _START_NS - SURVEYED_BEFORE_NS,
        SurveyErrors(clouds=setting.scene != "country"),
        scanned_route="default",
    )


def _truth(district: District, trajectory: Trajectory, last_ns: int) -> TruthTable:
    rows = np.arange(0, np.searchsorted(trajectory.time_ns, last_ns, side="right"), _TRUTH_EVERY)
    t, antenna_m = trajectory, trajectory.antenna_m[rows]
    latitude, longitude, _ = district.frame.geodetic_from_east_north_array(antenna_m[:, :2], antenna_m[:, 2])
    return TruthTable(
        time_ns=t.time_ns[rows],
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=antenna_m[:, 2],
        roll_rad=t.roll_rad[rows],
        pitch_rad=t.pitch_rad[rows],
        yaw_rad=wrap_pi_array(t.yaw_rad[rows]),
        velocity_enu_m_s=t.antenna_velocity_m_s[rows],
        more={"driven_m": np.append(0.0, np.cumsum(t.speed_m_s[:-1] * 0.01))[rows]},
    )


def _with_sweeps(
    inputs: DriveInputs, setting: Setting, district: District, trajectory: Trajectory
) -> DriveInputs:
    lidar = SimulatedLidar(
        pattern=BEAMS_32,
        track=PoseTrack.of(trajectory, CAR, CAR.lidar),
        tracer=_shapes(setting),
        seed=setting.seed,
    )
    scans = lidar.scans(1)
    last_ns = inputs.tick_times_ns[-1]
    count = (last_ns - int(trajectory.time_ns[0])) // BEAMS_32.turn_ns
    first_ns = int(trajectory.time_ns[0])
    sweeps = tuple(_SweepInTurn(first_ns + (k + 1) * BEAMS_32.turn_ns, Path(), scans) for k in range(count))
    times = sorted({*inputs.tick_times_ns, *(sweep.time_ns for sweep in sweeps)})
    return replace(inputs, sweeps=sweeps, tick_times_ns=tuple(times))


@dataclass(frozen=True, slots=True)
class _SweepInTurn(SweepFile):
    """The next of a LiDAR's sweeps, made when it is read."""

    scans: Iterator[Scan]

    def read(self) -> Sweep:
        sweep = next(self.scans).sweep
        assert sweep.time_ns == self.time_ns
        return sweep


def _manifest(
    setting: Setting, fault: CommonFault, district: District, trajectory: Trajectory, *, lidar: bool
) -> str:
    x, y, z = CAR.antenna
    lidar_x, lidar_y, lidar_z = CAR.lidar
    parts = [
        f'name = "{setting.name}"\ndescription = "{fault.text}"\nvehicle = "car"\nsimulated = true\n',
        '[receiver]\nformat = "pos"\nfile = "receiver.pos"\n',
        '[motion]\nfile = "motion.csv"\n',
        '[sweeps]\nfolder = "sweeps"\n' if lidar else "",
        '[map]\nrelease = "map"\n',
        '[truth]\nformat = "camber"\nfile = "truth.csv"\n',
        f"[lever_arms.antenna]\nx_m = {x}\ny_m = {y}\nz_m = {z}\n",
        f"[lever_arms.lidar]\nx_m = {lidar_x}\ny_m = {lidar_y}\nz_m = {lidar_z}\n",
        f'[antenna_height]\nway = "fixed"\nheight_m = {z}\nsigma_m = 0.01\n',
        f"[surrogates]\nwheelbase_m = {CAR.wheelbase_m}\n",
        _given_pose(setting, district, trajectory) if fault.given else "",
    ]
    return "\n".join(part for part in parts if part)


def _given_pose(setting: Setting, district: District, trajectory: Trajectory) -> str:
    rng = stream(setting.seed, "given pose")
    east_m, north_m, up_m = trajectory.antenna_m[0].tolist()
    off_m = rng.normal(0.0, _POSE_SIGMA_M, 2)
    latitude, longitude, _ = district.frame.geodetic_from_east_north(
        east_m + float(off_m[0]), north_m + float(off_m[1]), up_m
    )
    yaw_rad = wrap_pi(float(trajectory.yaw_rad[0]) + float(rng.normal(0.0, _YAW_SIGMA_RAD)))
    return (
        f"[initial_pose]\nlatitude_deg = {math.degrees(latitude):.9f}\nlongitude_deg = {math.degrees(longitude):.9f}\n"
        f"yaw_deg = {math.degrees(yaw_rad):.4f}\nhorizontal_sigma_m = {_POSE_SIGMA_M}\n"
        f"yaw_sigma_deg = {math.degrees(_YAW_SIGMA_RAD):.6g}\n"
    )

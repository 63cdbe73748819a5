"""The inputs of antenna_height in a simulated drive, without a bus, and how high the antenna really was.

`matched_drive` lets the localizer itself pose and match. In the others, which are made in a second, the pose is the
truth with a localizer's errors; the road below it is that of the simulated survey, with its errors.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from camber.antenna_height.settings import AntennaHeightSettings, BodyPoint
from camber.localizer.localization import Localization
from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.release import read_release
from camber.schemas.base import Message
from camber.schemas.pose import Pose, Road, ScanMatch
from camber.simulator.injected_faults import Fault
from camber.simulator.random_streams import stream
from camber.simulator.scenario import Scenario, load_scenario
from camber.simulator.scene import Path, Trajectory
from camber.simulator.simulated_drive import SENSORS, lay_out
from camber.simulator.vehicle.body import CAR, VehicleBody
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensors import (
    Surface,
    motion_messages,
    ranging_messages,
    read_sensors,
    suspension_messages,
)
from camber.simulator.world.district import District
from camber.simulator.world.survey import SURVEYED_BEFORE_NS, SurveyErrors, write_survey
from camber.tools.localize.local_map_queries import LocalMapQueries
from camber.tools.localize.localizer_run import IssueTally
from support.lidar_drives import lidar_drive
from support.localization_drives import options_of_car
from support.simulated_paths import path_over, sloping

Floats = NDArray[np.float64]
_POSE_SIGMA_M = 0.3
_YAW_SIGMA_RAD = math.radians(0.3)
_STEP_NS = 100_000_000
START_NS = 1_450_000_000 * 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class AntennaDrive:
    """`messages` as (channel, message) in the order of their times; the truth as columns (n,)."""

    messages: tuple[tuple[str, Message], ...]
    time_ns: NDArray[np.int64]
    antenna_height_m: Floats
    steepness: Floats
    speed_m_s: Floats

    def true_height_m(self, time_ns: int) -> float:
        return self._at(time_ns, self.antenna_height_m)

    def true_steepness(self, time_ns: int) -> float:
        return self._at(time_ns, self.steepness)

    def driven_s(self, from_ns: int, to_ns: int) -> float:
        """Seconds of driving between two times."""
        inside = (self.time_ns >= from_ns) & (self.time_ns < to_ns) & (self.speed_m_s > 1.0)
        return float(np.sum(inside) * np.median(np.diff(self.time_ns)) / 1e9)

    def _at(self, time_ns: int, column: Floats) -> float:
        start = self.time_ns[0]
        return float(np.interp(time_ns - start, (self.time_ns - start).astype(np.float64), column))


def settings_of(body: VehicleBody = CAR, **more: object) -> AntennaHeightSettings:
    """All that was measured of the vehicle."""

    def place(point: tuple[float, float, float]) -> BodyPoint:
        return BodyPoint(x_m=point[0], y_m=point[1], z_m=point[2])

    known: dict[str, object] = {
        "fixed_height_m": body.antenna[2],
        "antenna": place(body.antenna),
        "ranging": place(body.ranging),
        "lidar": place(body.lidar),
        "beam_azimuth_deg": math.degrees(body.ranging_azimuth_rad),
    }
    if body.suspension is not None:
        known |= {
            "suspension": place((*body.stroke_point, body.tyre_radius_m + body.suspension.stroke_m)),
            "suspension_to_antenna_m": body.suspension_to_antenna_m,
            "tyre_radius_m": body.tyre_radius_m,
        }
    return AntennaHeightSettings(**(known | more))  # type: ignore[arg-type]


def antenna_drive(
    name: str,
    seed: int,
    *,
    faults: Sequence[Fault] = (),
    overrides: Sequence[str] = (),
    attitude: bool = True,
    matches: bool = False,
) -> AntennaDrive:
    """One drive of a shipped scenario. `attitude`: motion carries pitch and roll. `matches`: scan matches made from the
    truth are inputs as well, with errors of a size that matching has: a stand-in, no evidence of any matching."""
    scenario = load_scenario(name, [f"seed={seed}", *overrides])
    scenario = scenario.model_copy(update={"faults": (*scenario.faults, *faults)})
    district, path, trajectory = lay_out(scenario, CAR)
    poses = _poses(scenario, district, trajectory)
    return _inputs(seed, path, trajectory, poses, attitude=attitude, matches=matches)


def slope_drive(
    seed: int, grade: float, crossfall: float, *, attitude: bool = True, matches: bool = False
) -> AntennaDrive:
    """Half a kilometre straight to the east on an even slope, known but for the map's errors."""
    path = path_over(sloping(grade, crossfall), np.zeros(2000))
    trajectory = drive(path, CAR, start_ns=START_NS)
    rng = stream(seed, "antenna slope")
    slopes = np.array([grade, crossfall]) + rng.normal(0.0, 0.002, 2)
    road = Road(status="known", slope_east=float(slopes[0]), slope_north=float(slopes[1]))
    poses = [
        _pose_at(trajectory, k, 0.6, 2.4, road, float(rng.normal(0.0, _YAW_SIGMA_RAD)))
        for k in _rows(trajectory)
    ]
    return _inputs(seed, path, trajectory, poses, attitude=attitude, matches=matches)


def matched_drive(
    scenario: str,
    seed: int,
    *,
    start_s: float = 0.0,
    duration_s: float,
    beams: int = 32,
    attitude: bool = True,
) -> AntennaDrive:
    """A drive of `lidar_drive` from a given pose, posed and matched by the localizer: two seconds' work for each
    of driving."""
    drive = lidar_drive(scenario, seed, start_s=start_s, duration_s=duration_s, beams=beams)
    options = options_of_car(initial_pose=drive.given_pose().model_dump())
    localization = Localization(options, LocalMapQueries(drive.map_release), IssueTally())
    messages: list[tuple[str, Message]] = []
    for tick in drive.ticks():
        if tick.motion is not None:
            unsaid = {} if attitude else {"pitch_rad": None, "roll_rad": None}
            motion = tick.motion.model_copy(update=unsaid)
            localization.on_motion(motion)
            messages.append(("motion", motion))
        if tick.sweep is not None:
            localization.on_sweep(tick.sweep)
        messages += [("suspension", tick.suspension)] if tick.suspension is not None else []
        messages += [("ranging", tick.ranging)] if tick.ranging is not None else []
        step = localization.advance()
        messages += [("scan_match", match) for match in step.matches]
        messages += [("pose", step.pose)] if step.pose is not None else []
    t = drive.trajectory
    slopes = _true_slopes(drive.path.surface_m, t)
    return _in_order(messages, t, slopes)


def _inputs(
    seed: int, path: Path, trajectory: Trajectory, poses: list[Pose], *, attitude: bool, matches: bool
) -> AntennaDrive:
    readings = read_sensors(trajectory, CAR, path.surface_m, SENSORS, seed)
    motion = motion_messages(readings)
    if not attitude:
        motion = [one.model_copy(update={"pitch_rad": None, "roll_rad": None}) for one in motion]
    slopes = _true_slopes(path.surface_m, trajectory)
    messages: list[tuple[str, Message]] = [
        *(("motion", one) for one in motion),
        *(("suspension", one) for one in suspension_messages(readings, SENSORS)),
        *(("ranging", one) for one in ranging_messages(readings, SENSORS, CAR)),
        *(("pose", one) for one in poses),
    ]
    if matches:
        messages += [("scan_match", one) for one in _matches(seed, trajectory, path.surface_m, slopes)]
    return _in_order(messages, trajectory, slopes)


def _in_order(messages: list[tuple[str, Message]], trajectory: Trajectory, slopes: Floats) -> AntennaDrive:
    return AntennaDrive(
        tuple(sorted(messages, key=lambda item: item[1].time_ns)),
        trajectory.time_ns,
        trajectory.antenna_height_m,
        np.hypot(*slopes.T),
        trajectory.speed_m_s,
    )


def _poses(scenario: Scenario, district: District, t: Trajectory) -> list[Pose]:
    rng = stream(scenario.seed, "antenna statistics")
    off_m, off_rad = rng.normal(0.0, _POSE_SIGMA_M, 2), float(rng.normal(0.0, _YAW_SIGMA_RAD))
    with tempfile.TemporaryDirectory() as folder:
        before_ns = scenario.start_ns - SURVEYED_BEFORE_NS
        write_survey(FilePath(folder) / "map", district, before_ns, SurveyErrors(clouds=False))
        release = read_release(FilePath(folder) / "map")
        roads = ElevationMap(release.surface_tile, release.link_tile, datum="WGS84", map_version=1)
        return [_pose(roads, district, t, k, off_m, off_rad) for k in _rows(t)]


def _pose(
    roads: ElevationMap, district: District, t: Trajectory, k: int, off_m: Floats, off_rad: float
) -> Pose:
    east_m, north_m = (t.antenna_m[k, :2] + off_m).tolist()
    latitude, longitude, _ = district.frame.geodetic_from_east_north(east_m, north_m, 0.0)
    road: Road = roads.road(latitude, longitude, (int(t.link_id[k]),))
    return _pose_at(t, k, latitude, longitude, road, off_rad)


def _pose_at(t: Trajectory, k: int, latitude: float, longitude: float, road: Road, off_rad: float) -> Pose:
    ee = _POSE_SIGMA_M**2
    return Pose(
        time_ns=int(t.time_ns[k]),
        mode="dead_reckoning",
        provenance="given",
        latitude_rad=latitude,
        longitude_rad=longitude,
        yaw_rad=float(t.yaw_rad[k]) + off_rad,
        covariance_east_north_yaw=(ee, 0.0, 0.0, ee, 0.0, _YAW_SIGMA_RAD**2),
        speed_m_s=float(t.speed_m_s[k]),
        road=road,
    )


def _rows(t: Trajectory) -> list[int]:
    every = _STEP_NS // int(t.time_ns[1] - t.time_ns[0])
    return list(range(0, len(t.time_ns), every))


def _true_slopes(surface_m: Surface, t: Trajectory) -> Floats:
    """Slopes (n, 2) of the true road below the antenna, to the east and to the north."""
    columns = []
    for axis in range(2):
        ends = []
        for sign in (1.0, -1.0):
            place = t.antenna_m[:, :2].copy()
            place[:, axis] += 0.25 * sign
            ends.append(surface_m(place[:, 0], place[:, 1], t.level))
        columns.append((ends[0] - ends[1]) / 0.5)
    return np.column_stack(columns)


def _matches(seed: int, t: Trajectory, surface_m: Surface, slopes: Floats) -> list[ScanMatch]:
    """Sensor heights off by 1 cm (constant for some seconds), attitudes by 0.1°, slopes as they are."""
    rng = stream(seed, "made scan matches")
    rows = _rows(t)
    position, _ = PoseTrack.of(t, CAR, CAR.lidar).at(t.time_ns)
    height = position[:, 2] - surface_m(position[:, 0], position[:, 1], t.level)
    inputs = []
    slow = 0.0
    for k in rows:
        slow = 0.98 * slow + 0.01 * math.sqrt(1.0 - 0.98**2) * float(rng.standard_normal())
        tilt = rng.normal(0.0, math.radians(0.1), 2)
        cos, sin = math.cos(t.yaw_rad[k]), math.sin(t.yaw_rad[k])
        if math.isnan(height[k]) or np.isnan(slopes[k]).any():
            continue
        inputs.append(
            ScanMatch(
                time_ns=int(t.time_ns[k]),
                status="converged",
                sensor_height_m=float(height[k]) + slow,
                sensor_height_sigma_m=0.01,
                ground_height_m=float(height[k]) + float(rng.normal(0.0, 0.01)),
                ground_height_sigma_m=0.01,
                roll_pitch_yaw_rad=(
                    float(t.roll_rad[k] + tilt[0]),
                    float(t.pitch_rad[k] + tilt[1]),
                    float(t.yaw_rad[k]),
                ),
                road_slope_forward=float(slopes[k, 0] * cos + slopes[k, 1] * sin),
                road_slope_left=float(slopes[k, 1] * cos - slopes[k, 0] * sin),
            )
        )
    return inputs

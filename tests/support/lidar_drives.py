"""Drives with a LiDAR for statistics: made in the process, without satellites, their sweeps one at a time.

`lidar_drive("city", seed, start_s=40.0, duration_s=20.0)` is some seconds of a route through the district of that seed;
`ticks()` says what the vehicle's sensors say in the order in which it arrives, `truth` where the vehicle was. The map
is the release that a survey of the roads around made. Drives of different seeds have nothing in common; those of one
seed have the district, its changes since the survey and the map's errors in common, and all else by `drive_seed`.

World frame: that of `camber.simulator.scene`, about `frame`; the third coordinate is the ellipsoidal height. The
vehicle frame's origin is the point of the body that is on the road below the middle of the rear axle when it rests.
"""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from heapq import merge
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release, read_release
from camber.schemas.drive import InitialPose
from camber.schemas.lidar import Sweep
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.simulator.injected_faults import Fault
from camber.simulator.random_streams import stream
from camber.simulator.scenario import Scenario, load_scenario
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.scene import Path as DrivenPath
from camber.simulator.simulated_drive import SENSORS, district_of
from camber.simulator.vehicle.beam_pattern import BEAMS_32, BEAMS_64
from camber.simulator.vehicle.body import CAR, VehicleBody
from camber.simulator.vehicle.lidar import SimulatedLidar
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.pose_track import PoseTrack
from camber.simulator.vehicle.sensors import (
    motion_messages,
    ranging_messages,
    read_sensors,
    suspension_messages,
)
from camber.simulator.vehicle.traffic import RoadUser, Traffic
from camber.simulator.world.district import NAGOYA_RAD, District
from camber.simulator.world.layouts import Layout, Route
from camber.simulator.world.ray_tracing import ShapeTracer
from camber.simulator.world.road_building import LinkKind, RoadBuilder
from camber.simulator.world.routes import Leg
from camber.simulator.world.survey import SURVEYED_BEFORE_NS, SurveyErrors, write_survey
from camber.simulator.world.terrain import rolling_terrain

NS = 1_000_000_000
HILL = "hill"
"""Beside the shipped scenarios: a street over a hill, 10 % up and 10 % down."""
_BEFORE_S = 10.0
"""Sensors begin to say something so long before the drive, as far as the route allows."""
_AROUND_M = 130.0
"""Roads that come so near to the drive are surveyed: a sensor's range and a little."""
_MEETS_EVERY_S = 12.0


class Tick(NamedTuple):
    """What arrives at one time. Of each sort at most one: every sensor stamps by its own clock."""

    time_ns: int
    motion: Motion | None = None
    sweep: Sweep | None = None
    suspension: Suspension | None = None
    ranging: Ranging | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DriveTruth:
    """At times (n,): the vehicle frame's origin (n, 3) and attitude, the antenna (n, 3), heights in metres.

    `latitude_rad`, `longitude_rad` are those of the vehicle frame's origin, `antenna_latitude_rad`, … of the antenna.
    `road_height_m` is that of the road of the drive day under the antenna, `antenna_height_m` the antenna above it.
    """

    time_ns: Integers
    vehicle_m: Floats
    roll_rad: Floats
    pitch_rad: Floats
    yaw_rad: Floats
    latitude_rad: Floats
    longitude_rad: Floats
    antenna_m: Floats
    antenna_latitude_rad: Floats
    antenna_longitude_rad: Floats
    antenna_height_m: Floats
    road_height_m: Floats
    speed_m_s: Floats
    driven_m: Floats
    level: Integers
    link_id: Integers
    in_tunnel: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class LidarDrive:
    """One drive. `district` and `trajectory` are the true ones; the trajectory begins before the drive does."""

    name: str
    seed: int
    drive_seed: int
    body: VehicleBody
    district: District
    path: DrivenPath
    trajectory: Trajectory
    tracer: ShapeTracer
    start_ns: int
    end_ns: int
    beams: int
    traffic: int
    surveyed_links: tuple[int, ...]
    lidar_faults: tuple[Fault, ...] = ()

    @property
    def frame(self) -> LocalFrame:
        """Of the world."""
        return self.district.frame

    @property
    def map_folder(self) -> Path:
        """The release of the roads around, made at the first call; gone when the process ends."""
        return _surveyed(self.district, self.surveyed_links, self.start_ns - SURVEYED_BEFORE_NS)

    @property
    def map_release(self) -> Release:
        """The same, read."""
        return read_release(self.map_folder)

    @property
    def sweep_times_ns(self) -> Integers:
        """Ends of the sweeps, true and as stamped: the LiDAR's clock is right."""
        turn_ns = BEAMS_32.turn_ns
        count = (self.end_ns - self.start_ns) // turn_ns
        return self.start_ns + turn_ns * np.arange(1, count + 1, dtype=np.int64)

    @property
    def truth(self) -> DriveTruth:
        """At the sweeps' ends."""
        return self.truth_at(self.sweep_times_ns)

    def truth_at(self, time_ns: Integers) -> DriveTruth:
        """At any times within the drive; between the trajectory's 100 Hz linearly."""
        t = self.trajectory
        known, asked = (t.time_ns - t.time_ns[0]) / 1e9, (time_ns - t.time_ns[0]) / 1e9

        def at(column: Floats) -> Floats:
            return np.interp(asked, known, column)

        vehicle, rotation = PoseTrack.of(t, self.body, (0.0, 0.0, 0.0)).at(time_ns)
        antenna = np.column_stack([at(column) for column in t.antenna_m.T])
        latitude, longitude, _ = self.frame.geodetic_from_east_north_array(vehicle[:, :2], vehicle[:, 2])
        of_antenna = self.frame.geodetic_from_east_north_array(antenna[:, :2], antenna[:, 2])
        nearest = np.clip(np.rint(asked * (1.0 / (known[1] - known[0]))).astype(np.int64), 0, len(known) - 1)
        driven = np.append(0.0, np.cumsum(t.speed_m_s[:-1] * np.diff(known)))
        begin = np.interp((self.start_ns - t.time_ns[0]) / 1e9, known, driven)
        antenna_height, road = at(t.antenna_height_m), at(t.road_height_m)
        level = t.level[nearest]
        return DriveTruth(
            time_ns=time_ns,
            vehicle_m=vehicle,
            roll_rad=np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2]),
            pitch_rad=-np.arcsin(rotation[:, 2, 0]),
            yaw_rad=np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]),
            latitude_rad=latitude,
            longitude_rad=longitude,
            antenna_m=antenna,
            antenna_latitude_rad=of_antenna[0],
            antenna_longitude_rad=of_antenna[1],
            antenna_height_m=antenna_height,
            road_height_m=road,
            speed_m_s=at(t.speed_m_s),
            driven_m=at(driven) - begin,
            level=level,
            link_id=t.link_id[nearest],
            in_tunnel=_covered(self.district, antenna, t.link_id[nearest]),
        )

    def ticks(self, *, sweeps: bool = True, threads: int = 1, every: int = 1) -> Iterator[Tick]:
        """What arrives, in the order of its stamps; a sweep is made when its turn has come, every so many of them."""
        made = (Tick(sweep.time_ns, sweep=sweep) for sweep in self.sweeps(threads, every)) if sweeps else ()
        yield from merge(_sensor_ticks(self), made, key=lambda tick: tick.time_ns)

    def sweeps(self, threads: int = 1, every: int = 1) -> Iterator[Sweep]:
        """Only these; as many at a time as threads, none kept."""
        track = PoseTrack.of(self.trajectory, self.body, self.body.lidar)
        inside = slice(*np.searchsorted(track.time_ns, (self.start_ns, self.end_ns + 1)).tolist())
        columns = {name: getattr(track, name)[inside] for name in PoseTrack.__slots__}
        pattern = BEAMS_64 if self.beams == 64 else BEAMS_32
        users = _road_users(self)
        traffic = Traffic.of(users, self.start_ns, self.end_ns) if users else None
        lidar = SimulatedLidar(
            pattern=pattern,
            track=PoseTrack(**columns),
            tracer=self.tracer,
            seed=self.drive_seed,
            traffic=traffic,
            faults=self.lidar_faults,
        )
        for scan in lidar.scans(threads, every):
            yield scan.sweep

    def given_pose(self, sigma_m: float = 1.0, yaw_sigma_rad: float = math.radians(2.0)) -> InitialPose:
        """The antenna at the drive's beginning, off at random by so much in east, north and yaw."""
        rng = stream(self.drive_seed, "given pose")
        begin = self.truth_at(np.array([self.start_ns]))
        off_m = sigma_m * rng.standard_normal(2)
        latitude, longitude, _ = self.frame.geodetic_from_east_north(
            float(begin.antenna_m[0, 0] + off_m[0]), float(begin.antenna_m[0, 1] + off_m[1]), 0.0
        )
        yaw_rad = wrap_pi(float(begin.yaw_rad[0]) + yaw_sigma_rad * float(rng.standard_normal()))
        return InitialPose(
            latitude_deg=math.degrees(latitude),
            longitude_deg=math.degrees(longitude),
            yaw_deg=math.degrees(yaw_rad),
            horizontal_sigma_m=sigma_m,
            yaw_sigma_deg=math.degrees(yaw_sigma_rad),
        )


def lidar_drive(
    scenario: str,
    seed: int,
    *,
    start_s: float = 0.0,
    duration_s: float,
    beams: int = 32,
    route: str = "default",
    rounds: int = 1,
    drive_seed: int | None = None,
    traffic: int | None = None,
    vehicle_faults: tuple[Fault, ...] = (),
    lidar_faults: tuple[Fault, ...] = (),
) -> LidarDrive:
    """A drive from `start_s` after a route's beginning (where the vehicle stands for a second) for `duration_s`.

    `scenario`: a shipped one, or HILL. `rounds`: how often a route that ends where it begins is driven ("round" of the
    city). `drive_seed`: of sensors, noise and traffic; without it one that follows from seed, route and start.
    `traffic`: vehicles around; None: as many as the scenario says, or six. Seconds of faults count from the
    trajectory's beginning (vehicle) and the drive's (LiDAR). Raises ValueError where the route is over by then.
    """
    world, path, trajectory = _driven(scenario, seed, route, rounds, vehicle_faults)
    begin_ns = int(trajectory.time_ns[0])
    start_ns, end_ns = (begin_ns + round(t * 10) * (NS // 10) for t in (start_s, start_s + duration_s))
    if end_ns > int(trajectory.time_ns[-1]):
        most_s = (int(trajectory.time_ns[-1]) - begin_ns) / NS
        raise ValueError(f"{scenario}: route {route} lasts {most_s:.1f} s, expected {start_s + duration_s} s")
    kept = slice(
        *np.searchsorted(trajectory.time_ns, (start_ns - round(_BEFORE_S * NS), end_ns + NS // 5)).tolist()
    )
    trajectory = _part(trajectory, kept)
    if drive_seed is None:
        drive_seed = int(stream(seed, f"drive {scenario} {route} {start_s}").integers(2**62))
    if traffic is None:
        lidar = None if world.settings is None else world.settings.lidar
        traffic = 6 if lidar is None else lidar.traffic
    in_drive = trajectory.time_ns >= start_ns
    return LidarDrive(
        name=f"{scenario} {seed} {route} {start_s:g} s",
        seed=seed,
        drive_seed=drive_seed,
        body=CAR,
        district=world.district,
        path=path,
        trajectory=trajectory,
        tracer=world.tracer,
        start_ns=start_ns,
        end_ns=end_ns,
        beams=beams,
        traffic=traffic,
        surveyed_links=_links_around(world.district, trajectory.origin_m[in_drive][::50]),
        lidar_faults=lidar_faults,
    )


def route_duration_s(scenario: str, seed: int, route: str = "default", rounds: int = 1) -> float:
    """How long a route takes: what `start_s + duration_s` may be."""
    trajectory = _driven(scenario, seed, route, rounds, ()).trajectory
    return float((trajectory.time_ns[-1] - trajectory.time_ns[0]) / NS)


class _World(NamedTuple):
    district: District
    tracer: ShapeTracer
    settings: Scenario | None


class _Driven(NamedTuple):
    world: _World
    path: DrivenPath
    trajectory: Trajectory


@lru_cache(maxsize=4)
def _world(scenario: str, seed: int) -> _World:
    if scenario == HILL:
        settings, district = None, hill_district(seed)
    else:
        settings = load_scenario(scenario, [f"seed={seed}"])
        district = district_of(settings)
    return _World(district, ShapeTracer(district.shapes("drive")), settings)


@lru_cache(maxsize=2)
def _driven(scenario: str, seed: int, route: str, rounds: int, faults: tuple[Fault, ...]) -> _Driven:
    world = _world(scenario, seed)
    district, settings = world.district, world.settings
    if rounds > 1:
        once = district.layout.routes[route]
        often = replace(once, legs=once.legs * rounds)
        district = replace(district, layout=Layout(district.layout.roads, {route: often}))
    path = district.path(route)
    start_ns = load_scenario("city").start_ns if settings is None else settings.start_ns
    trajectory = drive(path, CAR, start_ns=start_ns, faults=faults)
    return _Driven(world, path, trajectory)


def hill_district(seed: int) -> District:
    """A built-up street, 10 % up a hill of 35 m and 10 % down it again (steepest; 0.858 height / width)."""
    b = RoadBuilder()
    names = [f"N{k}" for k in range(9)]
    for k, name in enumerate(names):
        b.node(name, -800.0 + 200.0 * k, 0.0, radius_m=0.0)
    kind = LinkKind(style="street", speed_m_s=11.0, crossfall=0.015)
    for one, other in pairwise(names):
        b.straight(one, other, kind)
    hill = (35.0, 0.0, 0.0, 300.0, 2000.0)
    roads = b.roads(rolling_terrain(seed, base_m=45.0, slope=0.002, hills=[hill]))
    there = tuple(Leg(k, True) for k in range(8))
    back = tuple(Leg(k, False) for k in range(7, -1, -1))
    routes = {"default": Route(legs=there, signals=False), "back": Route(legs=back, signals=False)}
    frame = LocalFrame(*NAGOYA_RAD, 0.0)
    return District(kind="city", seed=seed, frame=frame, layout=Layout(roads, routes), changed_roads={})


def _part(trajectory: Trajectory, rows: slice) -> Trajectory:
    columns = {name: getattr(trajectory, name)[rows] for name in Trajectory.__slots__}
    return Trajectory(**columns)


def _links_around(district: District, place_m: Floats) -> tuple[int, ...]:
    """Rows of the links that come near to some places (n, 3)."""
    roads, near = district.layout.roads, []
    for link in range(len(roads.link_id)):
        s = np.linspace(0.0, float(roads.length_m[link]), max(2, int(roads.length_m[link] / 10.0)))
        east, north, _ = roads.centre_line(link, s)
        away = np.hypot(place_m[:, None, 0] - east, place_m[:, None, 1] - north)
        if away.min() < _AROUND_M:
            near.append(link)
    return tuple(near)


def _covered(district: District, place_m: Floats, link_id: Integers) -> np.ndarray:
    roads = district.layout.roads
    row = np.searchsorted(roads.link_id, link_id)
    s, _ = roads.place(row, place_m[:, 0], place_m[:, 1])
    return (s > roads.covered_m[row, 0]) & (s < roads.covered_m[row, 1])


@lru_cache(maxsize=64)
def _surveyed(district: District, links: tuple[int, ...], time_ns: int) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="camber-lidar-map-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    around = Route(legs=tuple(Leg(link, True) for link in links))
    named = replace(district, layout=Layout(district.layout.roads, {"around": around}))
    write_survey(folder / "map", named, time_ns, SurveyErrors(), scanned_route="around")
    return folder / "map"


def _road_users(drive: LidarDrive) -> list[RoadUser]:
    """Half of them drive ahead; if there are more, one comes towards the vehicle every 12 s, or at most a hundred."""
    rng = stream(drive.drive_seed, "road users")
    t, place = drive.trajectory, np.column_stack((drive.path.east_m, drive.path.north_m))
    begin = int(np.searchsorted(t.time_ns, drive.start_ns))
    driven = np.append(0.0, np.cumsum(t.speed_m_s[:-1] * np.diff(t.time_ns) / 1e9))
    first_m = _arc_length_at(drive, place, begin)
    duration_s = (drive.end_ns - drive.start_ns) / NS
    ahead = drive.traffic // 2
    users = [
        RoadUser(
            path=drive.path,
            start_m=first_m + float(rng.uniform(20.0, 40.0)) + 45.0 * k,
            speed_m_s=float(rng.uniform(9.0, 12.0)),
        )
        for k in range(ahead)
    ]
    every_s = max(_MEETS_EVERY_S, duration_s / 100.0)
    meetings = np.arange(0.0, duration_s if drive.traffic > ahead else 0.0, every_s)
    for at_s in meetings + rng.uniform(0.0, every_s, len(meetings)):
        speed = float(rng.uniform(8.0, 12.0))
        row = min(begin + round(at_s * 100.0), len(driven) - 1)
        met_m = first_m + float(driven[row] - driven[begin])
        start_m = met_m + speed * float(at_s)
        users.append(RoadUser(path=drive.path, start_m=start_m, speed_m_s=-speed, left_m=-3.5))
    return users


def _arc_length_at(drive: LidarDrive, place: Floats, row: int) -> float:
    """Metres along the way of the vehicle at a row of the trajectory: the first place that is as near, of rounds."""
    away = np.hypot(*(place - drive.trajectory.origin_m[row, :2]).T)
    return drive.path.step_m * int(np.flatnonzero(away <= away.min() + 0.05)[0])


def _sensor_ticks(drive: LidarDrive) -> Iterator[Tick]:
    """All but the sweeps, by stamp."""
    readings = read_sensors(drive.trajectory, drive.body, drive.path.surface_m, SENSORS, drive.drive_seed)
    ticks = [Tick(m.time_ns, motion=m) for m in motion_messages(readings)]
    ticks += [Tick(s.time_ns, suspension=s) for s in suspension_messages(readings, SENSORS)]
    ticks += [Tick(r.time_ns, ranging=r) for r in ranging_messages(readings, SENSORS, drive.body)]
    inside = [tick for tick in ticks if drive.start_ns <= tick.time_ns <= drive.end_ns + NS // 10]
    return iter(sorted(inside, key=lambda tick: tick.time_ns))

"""One drive of a scenario, from the district to what the receiver reports: everything but the files.

The district's roads are those that the faults make of them, so a drive is laid out twice where roads have changed under
it: once to learn which links it takes when.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camber.formats.drive.truth_csv import WRONG_M
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.injected_faults import (
    ChangedRoad,
    Fault,
    MissingEpochs,
    RepeatedEpochs,
    TimeJump,
    WrongBase,
    WrongMap,
    of_kind,
    until,
)
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER
from camber.simulator.satellites.propagation import Surroundings, what_blocks
from camber.simulator.satellites.receiver_solution import SimulatedSolutions, receiver_solutions
from camber.simulator.satellites.reference_errors import frame_offset_m, with_reference_error
from camber.simulator.satellites.track import AntennaTrack, static_track
from camber.simulator.scenario import Scenario, ScenarioError
from camber.simulator.scene import Booleans, Floats, Integers, Path, Trajectory
from camber.simulator.vehicle.body import CAR, ROBOT, VehicleBody
from camber.simulator.vehicle.imu import UNITS, ImuReadings, read_imu
from camber.simulator.vehicle.motion import RATE_HZ, drive
from camber.simulator.vehicle.rate_sensor import AUTOMOTIVE_YAW_RATE
from camber.simulator.vehicle.sensors import SensorSet, VehicleReadings, read_sensors
from camber.simulator.world.district import District, make_district
from camber.simulator.world.ray_tracing import ShapeTracer

_BODIES = {"car": CAR, "robot": ROBOT}
# A sensor may sample faster; the bus carries ten samples a second (docs/data-flow.md).
SENSORS = SensorSet(rate_hz=10.0)
_BASE_UP_M = 25.0  # chosen: a roof above the highest ground of any district
_DIFFERENTIAL = (SolutionQuality.FIX, SolutionQuality.FLOAT, SolutionQuality.DGPS)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReceiverOutput:
    """What the receiver reports at one time: raw observations and a solution, if any; by *its* clock.

    `arrival_ns` is when that is, by a correct clock.
    """

    arrival_ns: int
    rover: ObservationEpoch | None
    solution: ReceiverSolution | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedDrive:
    """All of a drive.

    `epoch_ns` (n,) are the true times of the receiver's epochs, `of_epoch` (n,) the trajectory's rows then. `outputs`
    is in the order of arrival and may hold an epoch twice, or none. `frame_offset_m` (3,): the frame of the base
    station's coordinates less the map's; `base_offset_m` (n, 3): how far they are wrong in all (east, north, up).
    `fixed`, `fix_wrong` (n,): did the receiver report a fix of this (true) time, and was it wrong? `map_offset_m`: by
    link, how far the map is wrong.
    """

    scenario: Scenario
    district: District
    body: VehicleBody
    path: Path
    trajectory: Trajectory
    tracer: ShapeTracer
    readings: VehicleReadings
    imu: ImuReadings | None
    epoch_ns: Integers
    of_epoch: Integers
    outputs: tuple[ReceiverOutput, ...]
    solutions: SimulatedSolutions
    base: tuple[ObservationEpoch, ...]
    base_m: tuple[float, float, float]
    frame_offset_m: Floats
    base_offset_m: Floats
    broadcast: tuple[Ephemeris, ...]
    fixed: Booleans
    fix_wrong: Booleans
    map_offset_m: dict[int, float]

    @property
    def arrives_s(self) -> float:
        """When the vehicle comes to the end of its path, from the first epoch on; it stands there for what is left."""
        moving = np.flatnonzero(self.trajectory.speed_m_s > 0.0)
        time_ns = self.trajectory.time_ns
        return float(time_ns[moving[-1]] - time_ns[0]) / NS_PER_SECOND if len(moving) else 0.0


def simulate_drive(scenario: Scenario) -> SimulatedDrive:
    """Raises ScenarioError where a fault does not fit into the drive."""
    body = _BODIES[scenario.vehicle]
    try:
        district, path, trajectory = lay_out(scenario, body)
    except ValueError as error:
        raise ScenarioError(f"{scenario.name}: {error}") from None
    sky, seed, faults, frame = scenario.satellites, scenario.seed, scenario.faults, district.frame
    of_epoch = np.arange(0, len(trajectory.time_ns), RATE_HZ // sky.rate_hz)
    epoch_ns = trajectory.time_ns[of_epoch]
    track = AntennaTrack(
        time_ns=epoch_ns,
        antenna_m=trajectory.antenna_m[of_epoch],
        antenna_velocity_m_s=trajectory.antenna_velocity_m_s[of_epoch],
    )
    true_m = track.antenna_m
    track = with_reference_error(track, trajectory.yaw_rad[of_epoch], sky.reference_m, seed)
    shapes = district.shapes("drive")
    every_system = true_ephemerides(int(epoch_ns[0]), int(epoch_ns[-1]), seed)
    true = [e for e in every_system if chr(e.satellite >> 8) in sky.systems]
    surroundings = Surroundings(ShapeTracer(what_blocks(shapes)), district.walls())
    lasting = until(faults, scenario.duration_s)
    rover = simulate_signals(
        track, frame, true, ROVER, seed=seed, receiver="rover", surroundings=surroundings, faults=lasting
    )
    base_m = _base_place(trajectory, sky.base_distance_m)
    base = simulate_signals(static_track(epoch_ns, base_m), frame, true, BASE, seed=seed, receiver="base")
    solutions = receiver_solutions(rover, base, track, frame, seed=seed)
    time_s = (epoch_ns - epoch_ns[0]) / NS_PER_SECOND
    frame_m = frame_offset_m(sky.frame_sigma_m, seed)
    base_offset_m = frame_m + _base_offset(faults, time_s)
    moved = {}
    for solution in solutions.solutions:
        row = int(np.searchsorted(epoch_ns, solution.time_ns))
        shift_m = base_offset_m[row] if solution.quality in _DIFFERENTIAL else np.zeros(3)
        moved[solution.time_ns] = _shifted(solution, shift_m, frame)
    outputs = _outputs(faults, epoch_ns, rover.epochs(), moved)
    if not any(one.rover is not None and len(one.rover.satellite) for one in outputs):
        raise ScenarioError(
            f"{scenario.name}: the receiver says nothing, expected observations at some epoch"
        )
    if not any(one.solution is not None for one in outputs):
        raise ScenarioError(f"{scenario.name}: the receiver has no solution, expected one at some epoch")
    fixed = solutions.quality == int(SolutionQuality.FIX)
    for missing in of_kind(faults, MissingEpochs):
        fixed &= ~missing.acts(time_s)
    error_m = solutions.error_m + track.antenna_m - true_m + base_offset_m
    return SimulatedDrive(
        scenario=scenario,
        district=district,
        body=body,
        path=path,
        trajectory=trajectory,
        tracer=ShapeTracer(shapes),
        readings=read_sensors(trajectory, body, path.surface_m, sensors_of(scenario), seed=seed),
        imu=_imu_readings(scenario, body, trajectory, frame),
        epoch_ns=epoch_ns,
        of_epoch=of_epoch,
        outputs=outputs,
        solutions=solutions,
        base=tuple(base.epochs()),
        base_m=base_m,
        frame_offset_m=frame_m,
        base_offset_m=base_offset_m,
        broadcast=tuple(broadcast_ephemerides(true, seed)),
        fixed=fixed,
        fix_wrong=fixed & (np.linalg.norm(error_m, axis=1) > WRONG_M),
        map_offset_m=offsets_by_link(of_kind(faults, WrongMap), trajectory),
    )


def sensors_of(scenario: Scenario) -> SensorSet:
    """The vehicle's sensors of a scenario."""
    automotive = scenario.yaw_rate_sensor == "automotive"
    return replace(SENSORS, yaw_rate=AUTOMOTIVE_YAW_RATE) if automotive else SENSORS


def _imu_readings(
    scenario: Scenario, body: VehicleBody, trajectory: Trajectory, frame: LocalFrame
) -> ImuReadings | None:
    imu = scenario.imu
    if imu is None:
        return None
    unit = UNITS[imu.imu_class]
    return read_imu(trajectory, body, frame, imu, unit=unit, rate_hz=imu.rate_hz, seed=scenario.seed)


def district_of(scenario: Scenario, changed_roads: dict[int, float] | None = None) -> District:
    """The place of a scenario; `changed_roads` in place of those that it draws, if any."""
    place = scenario.place
    if changed_roads is None and not place.changed_roads:
        changed_roads = {}
    return make_district(
        place.kind,
        scenario.seed if place.seed is None else place.seed,
        math.radians(place.latitude_deg),
        math.radians(place.longitude_deg),
        heading_rad=math.radians(place.heading_deg or 0.0),
        changed_roads=changed_roads,
    )


def lay_out(scenario: Scenario, body: VehicleBody) -> tuple[District, Path, Trajectory]:
    """The district with the roads as the faults change them, the path and the motion along it."""

    def laid_out(changes: dict[int, float] | None) -> tuple[District, Path, Trajectory]:
        district = district_of(scenario, changes)
        path = district.path(scenario.place.route)
        start_ns, lasts_s = scenario.start_ns, scenario.duration_s
        trajectory = drive(path, body, start_ns=start_ns, duration_s=lasts_s, faults=scenario.faults)
        return district, path, trajectory

    district, path, trajectory = laid_out(None)
    changing = of_kind(scenario.faults, ChangedRoad)
    if changing:
        return laid_out(district.changed_roads | offsets_by_link(changing, trajectory))
    return district, path, trajectory


def offsets_by_link(faults: Sequence[ChangedRoad | WrongMap], trajectory: Trajectory) -> dict[int, float]:
    """By the links that are driven while a fault acts: a link is changed as a whole."""
    time_s = (trajectory.time_ns - trajectory.time_ns[0]) / NS_PER_SECOND
    return {
        int(link): fault.offset_m
        for fault in faults
        for link in np.unique(trajectory.link_id[fault.acts(time_s)]).tolist()
    }


def _base_place(trajectory: Trajectory, distance_m: float) -> tuple[float, float, float]:
    east_m, north_m, _ = trajectory.origin_m[0].tolist()
    leg_m = distance_m / math.sqrt(2.0)
    return east_m + leg_m, north_m + leg_m, float(trajectory.origin_m[:, 2].max()) + _BASE_UP_M


def _base_offset(faults: tuple[Fault, ...], time_s: Floats) -> Floats:
    offset_m = np.zeros((len(time_s), 3))
    for fault in of_kind(faults, WrongBase):
        offset_m[fault.acts(time_s)] += (fault.east_m, fault.north_m, fault.up_m)
    return offset_m


def _shifted(solution: ReceiverSolution, shift_m: Floats, frame: LocalFrame) -> ReceiverSolution:
    if not shift_m.any():
        return solution
    east_m, north_m = frame.east_north_from_geodetic(solution.latitude_rad, solution.longitude_rad, 0.0)
    east, north, up = shift_m.tolist()
    latitude, longitude, _ = frame.geodetic_from_east_north(east_m + east, north_m + north, 0.0)
    return replace(solution, latitude_rad=latitude, longitude_rad=longitude, height_m=solution.height_m + up)


def _outputs(
    faults: tuple[Fault, ...],
    epoch_ns: Integers,
    observed: list[ObservationEpoch],
    solutions: dict[int, ReceiverSolution],
) -> tuple[ReceiverOutput, ...]:
    """In the order of arrival: with a clock that jumps, epochs that are repeated, and some that are missing."""
    time_s = (epoch_ns - epoch_ns[0]) / NS_PER_SECOND
    rover = {epoch.time_ns: epoch for epoch in observed}
    jump_ns, times = np.zeros(len(epoch_ns), np.int64), np.ones(len(epoch_ns), np.int64)
    for jump in of_kind(faults, TimeJump):
        jump_ns[jump.acts(time_s)] += round(jump.offset_s * NS_PER_SECOND)
    for repeated in of_kind(faults, RepeatedEpochs):
        times[repeated.acts(time_s)] = 2
    for missing in of_kind(faults, MissingEpochs):
        times[missing.acts(time_s)] = 0
    outputs: list[ReceiverOutput] = []
    for at_ns, by_ns, count in zip(epoch_ns.tolist(), jump_ns.tolist(), times.tolist(), strict=True):
        epoch, solution = rover.get(at_ns), solutions.get(at_ns)
        if epoch is not None:
            epoch = replace(epoch, time_ns=at_ns + by_ns)
        if solution is not None:
            solution = replace(solution, time_ns=at_ns + by_ns)
        if epoch is not None or solution is not None:
            outputs += [ReceiverOutput(arrival_ns=at_ns, rover=epoch, solution=solution)] * count
    return tuple(outputs)

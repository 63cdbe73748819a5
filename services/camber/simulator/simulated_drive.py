"""One drive of a scenario, from the district to what the receiver says: everything but the files.

The district's roads are those that the faults make of them, so a drive is laid out twice where roads have changed under
it: once to learn which links it takes when.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.formats.drive.truth_csv import WRONG_M
from camber.formats.observations import Ephemeris, ObservationEpoch
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.faults.radio_faults import JammingSignal, RadioFaults, SpoofingSignal
from camber.simulator.faults.schedule import (
    ChangedLoad,
    ChangedRoad,
    ChangedTyre,
    Fault,
    Jamming,
    MissingEpochs,
    RepeatedEpochs,
    Spoofing,
    TimeJump,
    WheelSlip,
    WrongBase,
    WrongMap,
    of_kind,
)
from camber.simulator.faults.vehicle_faults import VehicleFault
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER
from camber.simulator.satellites.propagation import Surroundings, what_blocks
from camber.simulator.satellites.receiver_solution import SimulatedSolutions, receiver_solutions
from camber.simulator.satellites.track import AntennaTrack, static_track
from camber.simulator.scenario import Scenario, ScenarioError
from camber.simulator.scene import Floats, Integers, Path, Trajectory
from camber.simulator.vehicle.attitude_sensor import AttitudeSensor
from camber.simulator.vehicle.body import CAR, ROBOT, VehicleBody
from camber.simulator.vehicle.motion import INNER_RATE_HZ, drive
from camber.simulator.vehicle.sensors import (
    RangingSensor,
    RateSensor,
    SensorSet,
    SteeringSensor,
    StrokeSensor,
    VehicleReadings,
    WheelSensor,
    read_sensors,
)
from camber.simulator.world.district import District, make_district
from camber.simulator.world.ray_tracing import ShapeTracer

_NS = 1_000_000_000
_BODIES = {"car": CAR, "robot": ROBOT}
# A sensor may sample faster; the bus carries ten samples a second (docs/data-flow.md).
SENSORS = SensorSet(
    WheelSensor(rate_hz=10.0),
    RateSensor(rate_hz=10.0),
    SteeringSensor(rate_hz=10.0),
    AttitudeSensor(rate_hz=10.0),
    StrokeSensor(rate_hz=10.0),
    RangingSensor(rate_hz=10.0),
)
_BASE_UP_M = 25.0
"""The base station stands on a roof: above the highest ground of any district by this much."""


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """What the receiver says at one time: its raw observations and its own solution, if any; by *its* clock.

    `arrival_ns` is when that is, by a clock that is right.
    """

    arrival_ns: int
    rover: ObservationEpoch | None
    solution: ReceiverSolution | None


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """All of a drive.

    `epoch_ns` (n,) are the true times of the receiver's epochs, `of_epoch` (n,) the trajectory's rows then. `said` is
    in the order of arrival and may hold an epoch twice, or none. `base_offset_m` (n, 3): how far the base station's
    coordinates are wrong (east, north, up). `fixed`, `fix_wrong` (n,): did the receiver say a fix of this (true) time,
    and was it wrong? `map_offset_m`: by link, how far the map is wrong.
    """

    scenario: Scenario
    district: District
    body: VehicleBody
    path: Path
    trajectory: Trajectory
    tracer: ShapeTracer
    readings: VehicleReadings
    epoch_ns: Integers
    of_epoch: Integers
    said: tuple[Said, ...]
    solutions: SimulatedSolutions
    base: tuple[ObservationEpoch, ...]
    base_m: tuple[float, float, float]
    base_offset_m: Floats
    broadcast: tuple[Ephemeris, ...]
    fixed: NDArray[np.bool_]
    fix_wrong: NDArray[np.bool_]
    map_offset_m: dict[int, float]

    @property
    def arrives_s(self) -> float:
        """When the vehicle comes to the end of its way, from the first epoch on; it stands there for what is left."""
        moving = np.flatnonzero(self.trajectory.speed_m_s > 0.0)
        if len(moving) == 0:
            return 0.0
        return float(self.trajectory.time_ns[moving[-1]] - self.trajectory.time_ns[0]) / NS_PER_SECOND


def simulate_drive(scenario: Scenario) -> SimulatedDrive:
    """Raises ScenarioError where a fault does not fit into the drive."""
    body = _BODIES[scenario.vehicle]
    try:
        district, path, trajectory = _laid_out(scenario, body)
    except ValueError as error:
        raise ScenarioError(f"{scenario.name}: {error}") from None
    sky, seed = scenario.satellites, scenario.seed
    of_epoch = np.arange(0, len(trajectory.time_ns), INNER_RATE_HZ // sky.rate_hz)
    epoch_ns = trajectory.time_ns[of_epoch]
    track = AntennaTrack(
        time_ns=epoch_ns,
        antenna_m=trajectory.antenna_m[of_epoch],
        antenna_velocity_m_s=trajectory.antenna_velocity_m_s[of_epoch],
    )
    shapes = district.shapes("drive")
    tracer = ShapeTracer(shapes)
    frame = district.frame
    true = [
        e
        for e in true_ephemerides(int(epoch_ns[0]), int(epoch_ns[-1]), scenario.seed)
        if chr(e.satellite >> 8) in sky.systems
    ]
    radio = _radio_faults(scenario)
    surroundings = Surroundings(ShapeTracer(what_blocks(shapes)), district.walls())
    rover = simulate_signals(
        track, frame, true, ROVER, seed=seed, receiver="rover", surroundings=surroundings, faults=radio
    )
    base_m = _base_place(trajectory, sky.base_distance_m)
    standing = static_track(epoch_ns, base_m)
    base = simulate_signals(standing, frame, true, BASE, seed=seed, receiver="base")
    solutions = receiver_solutions(rover, base, track, frame, seed=seed)
    time_s = (epoch_ns - epoch_ns[0]) / _NS
    base_offset_m = _base_offset(scenario.faults, time_s)
    moved = {
        solution.time_ns: _shifted(solution, base_offset_m[k], frame)
        if _is_differential(solution)
        else solution
        for solution in solutions.solutions
        for k in [int(np.searchsorted(epoch_ns, solution.time_ns))]
    }
    error_m = solutions.error_m + base_offset_m
    said = _said(scenario.faults, epoch_ns, rover.epochs(), moved)
    if not any(one.rover is not None and len(one.rover.satellite) for one in said):
        raise ScenarioError(
            f"{scenario.name}: the receiver says nothing, expected observations at some epoch"
        )
    if not any(one.solution is not None for one in said):
        raise ScenarioError(f"{scenario.name}: the receiver has no solution, expected one at some epoch")
    missing = [fault.acts(time_s) for fault in of_kind(scenario.faults, MissingEpochs)]
    fixed = (solutions.quality == int(SolutionQuality.FIX)) & ~np.any(
        [np.zeros(len(time_s), bool), *missing], axis=0
    )
    return SimulatedDrive(
        scenario=scenario,
        district=district,
        body=body,
        path=path,
        trajectory=trajectory,
        tracer=tracer,
        readings=read_sensors(trajectory, body, path.surface_m, SENSORS, scenario.seed),
        epoch_ns=epoch_ns,
        of_epoch=of_epoch,
        said=said,
        solutions=solutions,
        base=tuple(base.epochs()),
        base_m=base_m,
        base_offset_m=base_offset_m,
        broadcast=tuple(broadcast_ephemerides(true, scenario.seed)),
        fixed=fixed,
        fix_wrong=fixed & (np.linalg.norm(error_m, axis=1) > WRONG_M),
        map_offset_m=offsets_by_link(of_kind(scenario.faults, WrongMap), trajectory),
    )


def drawn_or_none(scenario: Scenario) -> dict[int, float] | None:
    """What `district_of` is given where no fault changes a road: None leaves it to the district to draw."""
    return None if scenario.place.changed_roads else {}


def district_of(scenario: Scenario, changed_roads: dict[int, float] | None) -> District:
    """The place of a scenario."""
    place = scenario.place
    return make_district(
        place.kind,
        scenario.seed if place.seed is None else place.seed,
        math.radians(place.latitude_deg),
        math.radians(place.longitude_deg),
        heading_rad=math.radians(place.heading_deg or 0.0),
        changed_roads=changed_roads,
    )


def _laid_out(scenario: Scenario, body: VehicleBody) -> tuple[District, Path, Trajectory]:
    changed = drawn_or_none(scenario)
    under_way = of_kind(scenario.faults, ChangedRoad)

    def made(changes: dict[int, float] | None) -> tuple[District, Path, Trajectory]:
        district = district_of(scenario, changes)
        path = district.path(scenario.place.route)
        trajectory = drive(
            path,
            body,
            start_ns=scenario.start_ns,
            duration_s=scenario.duration_s,
            faults=_vehicle_faults(scenario.faults),
        )
        return district, path, trajectory

    district, path, trajectory = made(changed)
    if under_way:
        district, path, trajectory = made(district.changed_roads | offsets_by_link(under_way, trajectory))
    return district, path, trajectory


def offsets_by_link(faults: Sequence[ChangedRoad | WrongMap], trajectory: Trajectory) -> dict[int, float]:
    """By the links that are driven while a fault acts: a link is changed as a whole."""
    time_s = (trajectory.time_ns - trajectory.time_ns[0]) / _NS
    return {
        int(link): fault.offset_m
        for fault in faults
        for link in np.unique(trajectory.link_id[fault.acts(time_s)]).tolist()
    }


def _vehicle_faults(faults: tuple[Fault, ...]) -> list[VehicleFault]:
    found = [
        *(("tyre_radius", f.radius_change_m, f) for f in of_kind(faults, ChangedTyre)),
        *(("load", f.load_kg, f) for f in of_kind(faults, ChangedLoad)),
        *(("wheel_slip", f.factor - 1.0, f) for f in of_kind(faults, WheelSlip)),
    ]
    return [
        VehicleFault(kind, amount, f.onset_s, math.inf if f.end_s is None else f.end_s)  # type: ignore[arg-type]
        for kind, amount, f in found
    ]


def _radio_faults(scenario: Scenario) -> RadioFaults:
    def span(fault: Jamming | Spoofing) -> dict[str, int]:
        end_s = scenario.duration_s if fault.end_s is None else fault.end_s
        begin_ns, end_ns = (scenario.start_ns + round(time_s * _NS) for time_s in (fault.onset_s, end_s))
        return {"begin_ns": begin_ns, "end_ns": end_ns}

    return RadioFaults(
        jamming=tuple(JammingSignal(**span(f), loss_db=f.loss_db) for f in of_kind(scenario.faults, Jamming)),
        spoofing=tuple(
            SpoofingSignal(**span(f), drift_m_s=(f.east_m_s, f.north_m_s, f.up_m_s))
            for f in of_kind(scenario.faults, Spoofing)
        ),
    )


def _base_place(trajectory: Trajectory, distance_m: float) -> tuple[float, float, float]:
    east_m, north_m, up_m = trajectory.origin_m[0].tolist()
    leg_m = distance_m / math.sqrt(2.0)
    return east_m + leg_m, north_m + leg_m, max(up_m, float(trajectory.origin_m[:, 2].max())) + _BASE_UP_M


def _base_offset(faults: tuple[Fault, ...], time_s: Floats) -> Floats:
    offset_m = np.zeros((len(time_s), 3))
    for fault in of_kind(faults, WrongBase):
        offset_m[fault.acts(time_s)] += (fault.east_m, fault.north_m, fault.up_m)
    return offset_m


def _is_differential(solution: ReceiverSolution) -> bool:
    return solution.quality in (SolutionQuality.FIX, SolutionQuality.FLOAT, SolutionQuality.DGPS)


def _shifted(solution: ReceiverSolution, shift_m: Floats, frame: LocalFrame) -> ReceiverSolution:
    if not shift_m.any():
        return solution
    east_m, north_m = frame.east_north_from_geodetic(solution.latitude_rad, solution.longitude_rad, 0.0)
    east, north, up = shift_m.tolist()
    latitude, longitude, _ = frame.geodetic_from_east_north(east_m + east, north_m + north, 0.0)
    return replace(solution, latitude_rad=latitude, longitude_rad=longitude, height_m=solution.height_m + up)


def _said(
    faults: tuple[Fault, ...],
    epoch_ns: Integers,
    observed: list[ObservationEpoch],
    solutions: dict[int, ReceiverSolution],
) -> tuple[Said, ...]:
    """In the order of arrival: with a clock that jumps, epochs that are repeated, and some that are missing."""
    time_s = (epoch_ns - epoch_ns[0]) / _NS
    rover = {epoch.time_ns: epoch for epoch in observed}
    jump_ns = np.zeros(len(epoch_ns), np.int64)
    times = np.ones(len(epoch_ns), np.int64)
    for jump in of_kind(faults, TimeJump):
        jump_ns[jump.acts(time_s)] += round(jump.offset_s * _NS)
    for repeated in of_kind(faults, RepeatedEpochs):
        times[repeated.acts(time_s)] = 2
    for missing in of_kind(faults, MissingEpochs):
        times[missing.acts(time_s)] = 0
    said: list[Said] = []
    for at_ns, jumps_ns, count in zip(epoch_ns.tolist(), jump_ns.tolist(), times.tolist(), strict=True):
        epoch, solution = rover.get(at_ns), solutions.get(at_ns)
        if epoch is None and solution is None:
            continue
        if jumps_ns:
            epoch = None if epoch is None else replace(epoch, time_ns=at_ns + jumps_ns)
            solution = None if solution is None else replace(solution, time_ns=at_ns + jumps_ns)
        said += [Said(at_ns, epoch, solution)] * count
    return tuple(said)

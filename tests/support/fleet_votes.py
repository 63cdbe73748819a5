"""A fleet over a simulated district as votes, and what is true of every surface: to test fusion."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.map_server.elevation_queries import ElevationMap
from camber.map_update.contribution import OBSERVATION, from_batch
from camber.map_update.fusion.pipeline import Fusion, FusionSettings
from camber.map_update.fusion.votes import Votes
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.release import read_release
from camber.road_map.road_columns import RoadSurfaces
from camber.simulator.fleet import (
    FleetErrors,
    FleetTrack,
    FleetVehicle,
    drive_days,
    drive_uploads,
    track_of,
    vehicles_of,
)
from camber.simulator.output.fleet_folder import FLEET_SURVEY
from camber.simulator.scenario import Scenario, load_scenario
from camber.simulator.simulated_drive import district_of
from camber.simulator.world.survey import DATUM, SURVEYED_BEFORE_NS, write_survey

Floats = NDArray[np.float64]
DAY_NS = 86_400 * 10**9
SECRET = b"a secret of the fleet's tests"


@dataclass(frozen=True, eq=False)
class FleetWorld:
    """The reference, the ways through it, and by surface of the reference how far the road is from it."""

    scenario: Scenario
    surfaces: RoadSurfaces
    tracks: list[FleetTrack]
    changed_roads: dict[int, float]
    true_offset_m: Floats
    """(surfaces,) in rows of `surfaces`: mean along the ways driven; NaN where none goes."""

    @property
    def start_ns(self) -> int:
        return self.scenario.start_ns


@dataclass(frozen=True, eq=False)
class Record:
    """All that a fleet uploaded: observations (n,), each with the number of its vehicle and its day."""

    observations: NDArray[np.void]
    vehicle: NDArray[np.int64]
    day: NDArray[np.int64]

    def of(self, rows: NDArray[np.bool_]) -> Record:
        return Record(self.observations[rows], self.vehicle[rows], self.day[rows])

    def joined(self, *others: Record) -> Record:
        every = (self, *others)
        return Record(
            np.concatenate([one.observations for one in every]),
            np.concatenate([one.vehicle for one in every]),
            np.concatenate([one.day for one in every]),
        )


def world_of(seed: int, *overrides: str) -> FleetWorld:
    """The district of the scenario `fleet` with this seed, surveyed as the scenario's files are."""
    scenario = load_scenario("fleet", [f"seed={seed}", *overrides])
    district = district_of(scenario)
    with tempfile.TemporaryDirectory() as folder:
        write_survey(Path(folder), district, scenario.start_ns - SURVEYED_BEFORE_NS, FLEET_SURVEY)
        release = read_release(Path(folder))
        surfaces = release.road_surfaces()
        the_map = ElevationMap(release.surface_tile, release.link_tile, datum=DATUM, map_version=1)
        tracks = [track_of(district.path(name), district.frame, the_map) for name in district.layout.routes]
    heights = SurfaceHeights(surfaces)
    surface = np.concatenate([track.surface_id for track in tracks])
    row = heights.rows_of(surface)
    road_m = np.concatenate([track.road_m for track in tracks])
    latitude = np.concatenate([track.latitude_rad for track in tracks])
    longitude = np.concatenate([track.longitude_rad for track in tracks])
    map_m, _ = heights.heights_m(row, latitude, longitude)
    on = row >= 0
    count = np.bincount(row[on], minlength=len(surfaces))
    offset_m = np.bincount(row[on], (road_m - map_m)[on], len(surfaces)) / np.where(count > 0, count, np.nan)
    return FleetWorld(scenario, surfaces, tracks, district.changed_roads, offset_m)


def fleet_of(world: FleetWorld) -> tuple[FleetVehicle, ...]:
    assert world.scenario.fleet is not None
    return vehicles_of(
        world.scenario.fleet.vehicles, world.scenario.fleet.attackers, FleetErrors(), world.scenario.seed
    )


def record_of(world: FleetWorld, vehicles: range | None = None, *, drives: int | None = None) -> Record:
    """What the scenario's vehicles upload, or some of them, as the files of the scenario hold it."""
    fleet, scenario = world.scenario.fleet, world.scenario
    assert fleet is not None
    errors = FleetErrors(wrong_drives=fleet.wrong_drives)
    cars = fleet_of(world)
    pieces, who, when = [np.zeros(0, OBSERVATION)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for nth in vehicles or range(fleet.vehicles):
        days = drive_days(cars[nth], drives or fleet.drives_each, fleet.days, scenario.seed)
        for number, day in enumerate(days):
            for batch in drive_uploads(
                world.tracks[(nth + number) % len(world.tracks)],
                cars[nth],
                number,
                start_ns=world.start_ns + day * DAY_NS,
                duration_s=scenario.duration_s,
                rate_hz=fleet.rate_hz,
                map_version=1,
                errors=errors,
                seed=scenario.seed,
            ):
                rows = from_batch(batch).observations
                pieces.append(rows)
                who.append(np.full(len(rows), nth))
                when.append(np.full(len(rows), day))
    return Record(np.concatenate(pieces), np.concatenate(who), np.concatenate(when))


def fusion_of(world: FleetWorld, settings: FusionSettings | None = None) -> Fusion:
    return Fusion(world.surfaces, SECRET, settings)


def votes_of(fusion: Fusion, record: Record) -> Votes:
    """Votes of a record, as if it had all come at once."""
    names = np.array([fusion.voter_of(f"car{n:05d}") for n in range(int(record.vehicle.max(initial=0)) + 1)])
    return fusion.votes_from(record.observations, names[record.vehicle])

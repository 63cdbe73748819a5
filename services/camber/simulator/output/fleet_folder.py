"""The files of a fleet's scenario: the map, the uploads as one recording, and what is true of them.

map/            the release that a survey made, which the vehicles drive with
uploads.mcap    every batch that a vehicle uploads, on the channel upload_batch
vehicles.csv    by vehicle: its bias, and by how much it lies
changes.csv     by link: how much higher the road is than at its survey
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from camber.formats.drive.mcap_recorder import Recorder
from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.map_error_model import MAP_ERRORS
from camber.road_map.release import read_release
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import encode
from camber.simulator.fleet import FleetErrors, FleetVehicle, drive_days, drive_uploads, track_of, vehicles_of
from camber.simulator.scenario import Scenario
from camber.simulator.simulated_drive import district_of
from camber.simulator.world.survey import DATUM, SURVEYED_BEFORE_NS, SurveyErrors, write_survey

FLEET_SURVEY = SurveyErrors(clouds=False, height_errors=replace(MAP_ERRORS, common_offset_sigma_m=0.0))
"""The survey is in the frame of the fleet's base stations. Another frame is a shift of whole regions, which fusion
reports and does not publish."""


def write_fleet(folder: Path, scenario: Scenario) -> Iterator[str]:
    """Write all of it, naming each vehicle when its uploads are written. OSError where a file cannot be."""
    fleet = scenario.fleet
    assert fleet is not None
    district = district_of(scenario)
    surveyed_ns = scenario.start_ns - SURVEYED_BEFORE_NS
    write_survey(folder / "map", district, surveyed_ns, FLEET_SURVEY)
    release = read_release(folder / "map")
    version = release.manifest.map_version
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=DATUM, map_version=version)
    errors = FleetErrors(wrong_drives=fleet.wrong_drives)
    tracks = [track_of(district.path(name), district.frame, the_map) for name in district.layout.routes]
    vehicles = vehicles_of(fleet.vehicles, fleet.attackers, errors, scenario.seed)
    _write_truth(folder, district.changed_roads, vehicles)
    channel = BY_NAME["upload_batch"]
    with Recorder(folder / "uploads.mcap", limit_bytes=1 << 30) as recorder:
        for nth, vehicle in enumerate(vehicles):
            sequence = 0
            for number, day in enumerate(drive_days(vehicle, fleet.drives_each, fleet.days, scenario.seed)):
                for batch in drive_uploads(
                    tracks[(nth + number) % len(tracks)],
                    vehicle,
                    number,
                    start_ns=scenario.start_ns + day * NS_PER_DAY,
                    duration_s=scenario.duration_s,
                    rate_hz=fleet.rate_hz,
                    map_version=version,
                    errors=errors,
                    seed=scenario.seed,
                ):
                    data = encode(batch, source=vehicle.name, sequence=sequence)
                    sequence += 1
                    # No wall clock was involved: the recorder's time is that of the measurement.
                    key = channel.key_for(vehicle.name)
                    recorder.add(channel.name, data, key=key, arrival_ns=batch.time_ns)
            yield vehicle.name
        if recorder.problem is not None:
            raise OSError(recorder.problem)


def _write_truth(folder: Path, changed_roads: dict[int, float], vehicles: tuple[FleetVehicle, ...]) -> None:
    rows = [f"{v.name},{v.bias_m:.6f},{v.attack_m:.6f}" for v in vehicles]
    (folder / "vehicles.csv").write_text("\n".join(["vehicle,bias_m,attack_m", *rows]) + "\n", "ascii")
    changes = [f"{link},{offset_m:.4f}" for link, offset_m in sorted(changed_roads.items())]
    (folder / "changes.csv").write_text("\n".join(["link_id,road_changed_m", *changes]) + "\n", "ascii")

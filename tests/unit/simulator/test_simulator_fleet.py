"""A fleet at measurement level: what is uploaded is the road's height with the errors it was asked for, no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.road_tiles import surface_tiles
from camber.schemas.codec import encode
from camber.schemas.fleet import UploadBatch
from camber.simulator.fleet import (
    ROWS,
    FleetErrors,
    FleetTrack,
    FleetVehicle,
    drive_days,
    drive_uploads,
    track_of,
    vehicles_of,
)
from camber.simulator.scene import Path
from support.simulated_paths import path_over
from support.small_map import FRAME, surface, surfaces

START_NS = 1_400_000_000 * 1_000_000_000
ERRORS = ("vehicle_m", "drive_m", "correlated_m", "white_m", "sideways_m", "wrong_episodes_per_s")
NONE = FleetErrors(**dict.fromkeys(ERRORS, 0.0))
HONEST = FleetVehicle(name="car00000", bias_m=0.0, attack_m=0.0)


def straight(raised_m: float = 0.0) -> Path:
    """200 m to the east at 50 m with 3 % crossfall, and 50 m more that no map has."""
    sloping = path_over(lambda east, north: 50.0 + raised_m + 0.03 * north, np.zeros(2501), step_m=0.1)
    return replace(sloping, link_id=np.ones(2501, np.int64))


def make_track(raised_m: float = 0.0) -> FleetTrack:
    rows = [
        surface(10 + k, 10.0 + 20.0 * k, link_id=1, heights_m=[[49.94, 50.06], [49.94, 50.06]])
        for k in range(10)
    ]
    tiles = {(tile.x, tile.y): tile for tile in surface_tiles(surfaces(rows))}
    the_map = ElevationMap(lambda x, y: tiles.get((x, y)), lambda x, y: None, datum="WGS84", map_version=7)
    return track_of(straight(raised_m), FRAME, the_map)


FLAT, RAISED = make_track(), make_track(0.3)


def drive(
    track: FleetTrack = FLAT,
    vehicle: FleetVehicle = HONEST,
    errors: FleetErrors = NONE,
    number: int = 0,
    seed: int = 1,
) -> list[UploadBatch]:
    times: dict[str, Any] = {"start_ns": START_NS, "duration_s": 600.0, "rate_hz": 5.0}
    return list(drive_uploads(track, vehicle, number, **times, map_version=7, errors=errors, seed=seed))


def column(batches: list[UploadBatch], name: str) -> np.ndarray:
    return np.concatenate([getattr(batch, name) for batch in batches])


def test_without_errors_the_road_is_uploaded_as_it_is_where_the_map_knows_one() -> None:
    batches = drive()
    assert column(batches, "road_height_m") == pytest.approx(50.0)
    assert set(column(batches, "surface_id").tolist()) == set(range(10, 20))
    assert set(column(batches, "verdict").tolist()) == {0}
    # A fifth of the way has no map; a surface reaches half a metre beyond its end.
    assert len(column(batches, "verdict")) == pytest.approx(3000 * 200.5 / 250, rel=0.1)
    assert all(len(batch.surface_id) == ROWS for batch in batches[:-1])
    assert (np.diff(column(batches, "positioning_time_ns")) > 0).all()


def test_a_changed_road_fails_the_check_and_is_uploaded_all_the_same() -> None:
    batches = drive(RAISED)
    assert column(batches, "road_height_m") == pytest.approx(50.3)
    assert set(column(batches, "verdict").tolist()) == {2}


def test_off_the_lanes_middle_the_crossfall_counts_and_the_place_moves() -> None:
    batches = drive(errors=replace(NONE, sideways_m=0.5))
    north_m = FRAME.east_north_from_geodetic_array(
        column(batches, "latitude_rad"),
        column(batches, "longitude_rad"),
        np.zeros(len(column(batches, "verdict"))),
    )[:, 1]
    assert north_m.std() == pytest.approx(0.5, rel=0.3)
    assert column(batches, "road_height_m") == pytest.approx(50.0 + 0.03 * north_m, abs=1e-4)
    assert set(column(batches, "verdict").tolist()) == {0}


def test_the_errors_are_as_large_as_set_and_of_the_vehicle_the_drive_and_the_fix() -> None:
    errors = FleetErrors(wrong_episodes_per_s=0.0, sideways_m=0.0)
    fleet = vehicles_of(150, 0.0, errors, seed=5)
    drives = [[drive(vehicle=car, errors=errors, number=k) for k in (0, 1)] for car in fleet]
    means = np.array([[column(one, "road_height_m").mean() - 50.0 for one in pair] for pair in drives])
    assert np.std([car.bias_m for car in fleet]) == pytest.approx(errors.vehicle_m, rel=0.2)
    of_drives = means - np.array([[car.bias_m] for car in fleet])
    # 600 s hold many stretches of correlated noise: little of it is left in a mean.
    assert of_drives.std() == pytest.approx(errors.drive_m, rel=0.2)
    assert abs(np.corrcoef(of_drives.T)[0, 1]) < 0.25
    one = column(drive(vehicle=fleet[0], errors=errors), "road_height_m")
    assert one.std() == pytest.approx(np.hypot(errors.white_m, errors.correlated_m), rel=0.25)


def test_wrong_fixes_come_in_episodes_and_most_of_them_fail_the_check() -> None:
    errors = replace(NONE, wrong_episodes_per_s=1 / 60.0)
    batches = drive(errors=errors)
    off = np.abs(column(batches, "road_height_m") - 50.0) > 1e-6
    assert 5 <= np.count_nonzero(np.diff(off.astype(int)) == 1) <= 20
    assert off.mean() < 0.2
    wrong = np.abs(column(batches, "road_height_m") - 50.0) > 0.2
    assert np.array_equal(column(batches, "verdict") == 2, wrong)


def test_attackers_are_the_share_that_was_asked_for_and_report_the_same() -> None:
    fleet = vehicles_of(200, 0.1, FleetErrors(), seed=3)
    attacks = [car.attack_m for car in fleet if car.attack_m]
    assert len(attacks) == 20
    assert len(set(attacks)) == 1
    liar = next(car for car in fleet if car.attack_m)
    assert column(drive(vehicle=liar), "road_height_m") == pytest.approx(50.0 + liar.bias_m + liar.attack_m)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    def data(seed: int, number: int = 0) -> bytes:
        return b"".join(encode(batch) for batch in drive(errors=FleetErrors(), seed=seed, number=number))

    assert data(1) == data(1)
    assert data(1) != data(2)
    assert data(1) != data(1, number=1)


def test_a_wrong_drive_is_off_by_the_same_throughout_and_as_many_are_as_asked_for() -> None:
    errors = replace(NONE, wrong_drives=0.2)
    heights = [column(drive(errors=errors, number=k), "road_height_m") - 50.0 for k in range(60)]
    off_m = np.array([(one.min(), one.max()) for one in heights])
    assert off_m[:, 0] == pytest.approx(off_m[:, 1], abs=1e-9)
    # 60 drives, 12 expected, σ 3.1.
    assert 3 <= np.count_nonzero(np.abs(off_m[:, 0]) > 1e-6) <= 22


def test_drives_are_on_different_days_where_there_are_enough() -> None:
    days = [drive_days(car, 3, 21, seed=1) for car in vehicles_of(50, 0.0, FleetErrors(), seed=1)]
    assert all(one == sorted(set(one)) and len(one) == 3 for one in days)
    assert set().union(*days) == set(range(21))
    assert drive_days(HONEST, 5, 2, seed=1) == sorted(drive_days(HONEST, 5, 2, seed=1))
    assert set(drive_days(HONEST, 50, 2, seed=1)) == {0, 1}

"""A road that has changed, the vehicles that notice it, the release that follows, and the next drive over it.

Real processes on a real bus from end to end: vehicles are replayed with all their services and upload into one state of
map_update; a live map_update fuses that and makes a release; a live map_server brings it to a vehicle and keeps it; the
last drive is judged by the map that this vehicle has then.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from camber.map_server.elevation_queries import ElevationMap
from camber.replay.short_drive import ANTENNA_HEIGHT_M, short_drive_truth, write_short_drive
from camber.road_map.release import Release, load_signing_key, read_release
from camber.road_map.store import MapStore
from support.changed_road import RAISED_M, batches_in, confirmed_there, replay, survey, upload
from support.release_world import write_signing_keys
from support.running import camber_started, loopback_router, settings_file, wait_until

pytestmark = pytest.mark.slow

DAYS_AGO = (9, 9, 7, 7, 5)
"""When each of the vehicles drove."""


def common_offset_m(release: Release) -> float:
    """By how much all heights of a survey are off alike: map less road below the drive, the median."""
    truth, manifest = short_drive_truth(), release.manifest
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=manifest.datum, map_version=1)
    roads = the_map.roads(truth.latitude_rad, truth.longitude_rad)
    road_m = truth.height_m[roads.known] - ANTENNA_HEIGHT_M
    return float(np.median(roads.elevation_m - road_m))


def raised(folder: Path, changed: np.ndarray) -> list[float] | None:
    """By how much the surfaces of the vehicle's map lie above the survey's; None: some that changed do not yet.

    Batches come one after the other, and those of the fifth vehicle make one surface after the other ready.
    """
    path = folder / "vehicle.sqlite"
    if not path.exists():
        return None
    with closing(MapStore(path)) as store:
        current = store.current()
        if current is None or current.map_version < 2:
            return None
        new = store.open(current.map_version).road_surfaces()
    old = read_release(folder / "survey").road_surfaces()
    offset_m = np.array([(a - b).mean() for a, b in zip(new.heights_m, old.heights_m, strict=True)])
    return offset_m.tolist() if offset_m[np.isin(old.surface_id, changed)].all() else None


@contextmanager
def cloud_and_vehicle(folder: Path, key: Path, public: Path) -> Iterator[str]:
    """A router, a map_update that fuses, and the map_server of a vehicle; where the router is."""
    with loopback_router() as endpoint, (folder / "log").open("w") as log:
        config = "--config", settings_file(folder / "bus.toml", endpoint, vehicle="car9")
        cloud = (
            "--reference",
            folder / "survey",
            "--signing-key",
            key,
            "--fuse-every-s",
            0.5,
            "--street-m",
            60.0,
        )
        vehicle = "--release", folder / "survey", "--public-key", public, "--store", folder / "vehicle.sqlite"
        with (
            camber_started("map_update", *config, "--state-dir", folder / "cloud", *cloud, stdout=log),
            camber_started("map_server", *config, *vehicle, "--ask-every-s", 0.5, stdout=log),
        ):
            first = (folder / "cloud/releases/root.msgpack").exists
            wait_until(first, timeout_s=60.0, why="no first release")
            yield endpoint


def test_vehicles_that_find_a_changed_road_correct_it_for_the_next_one(tmp_path: Path) -> None:
    key, public = write_signing_keys(tmp_path, tmp_path)
    write_short_drive(tmp_path / "now")
    _, changed = survey(tmp_path, tmp_path / "now/map", load_signing_key(key))
    outs = [replay(tmp_path, vehicle, ago, "survey") for vehicle, ago in enumerate(DAYS_AGO)]
    before = [confirmed_there(out) for out in outs]
    assert max(confirmed / total for confirmed, total in before) < 0.5, before

    with cloud_and_vehicle(tmp_path, key, public) as endpoint:
        for out in outs:
            for batch in batches_in(out):
                upload(endpoint, batch)
        result = wait_until(
            lambda: raised(tmp_path, changed), timeout_s=60.0, why="no corrected release in the vehicle"
        )
    offset_m = np.array(result)
    ids = read_release(tmp_path / "survey").road_surfaces().surface_id
    print(dict(zip(ids.tolist(), np.round(offset_m, 3).tolist(), strict=True)))
    is_changed = np.isin(ids, changed)
    # What changed gets the height by the fixes, and the survey's offset, too small to be corrected elsewhere, with it.
    survey_m = common_offset_m(read_release(tmp_path / "now/map"))
    print(f"survey off by {survey_m:.3f} m")
    assert offset_m[is_changed] == pytest.approx(RAISED_M - survey_m, abs=0.04)
    assert np.abs(offset_m[~is_changed]).max() == 0.0

    confirmed, total = confirmed_there(replay(tmp_path, 9, 1, "cloud/releases"))
    print(f"confirmed at once where the road has changed: before {before}, after {confirmed} of {total}")
    assert confirmed >= 0.99 * total

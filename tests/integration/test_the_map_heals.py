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
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from camber.formats.drive.truth_csv import FIX_STATES
from camber.map_server.elevation_queries import ElevationMap
from camber.map_update.contribution import OBSERVATION
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.replay.short_drive import ANTENNA_HEIGHT_M, RATE_HZ, short_drive_truth, write_short_drive
from camber.road_map.release import Release, RoadSurfaces, load_signing_key, read_release, write_release
from camber.road_map.store import MapStore
from camber.runtime.query import query_once
from camber.schemas.fleet import UploadBatch
from support.release_world import write_signing_keys
from support.running import (
    CLOCK,
    camber_started,
    client_of,
    loopback_router,
    recorded,
    replayed,
    settings_file,
    wait_until,
)

pytestmark = pytest.mark.slow

RAISED_M = 0.4
"""The road has been resurfaced since the survey: the map is lower."""
CHANGED_S = (66.0, 71.0)
"""Of the drive, when it is on the piece that has changed: some 45 m on the bridge, with right fixes only."""
DAY_NS = 86_400 * 10**9
TODAY_NS = CLOCK.now_ns() // DAY_NS * DAY_NS
DAYS_AGO = (9, 9, 7, 7, 5)
"""When each of the vehicles drove."""


def changed_surfaces(release: Release) -> np.ndarray:
    """Ids of the surfaces that the drive is on while the road is another than at the survey."""
    truth = short_drive_truth()
    now_s = (truth.time_ns - truth.time_ns[0]) / 1e9
    there = (now_s >= CHANGED_S[0]) & (now_s < CHANGED_S[1])
    manifest = release.manifest
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=manifest.datum, map_version=1)
    return np.unique(the_map.roads(truth.latitude_rad[there], truth.longitude_rad[there]).surface_id)


def common_offset_m(release: Release) -> float:
    """By how much all heights of a survey are off alike: map less road below the drive, the median."""
    truth, manifest = short_drive_truth(), release.manifest
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=manifest.datum, map_version=1)
    roads = the_map.roads(truth.latitude_rad, truth.longitude_rad)
    road_m = truth.height_m[roads.known] - ANTENNA_HEIGHT_M
    return float(np.median(roads.elevation_m - road_m))


def survey(folder: Path, made: Path, key: Ed25519PrivateKey) -> tuple[Path, np.ndarray]:
    """The map of before the road was raised, signed; and which of its surfaces are no longer so."""
    release = read_release(made)
    now, manifest = release.road_surfaces(), release.manifest
    changed = changed_surfaces(release)
    lower = np.isin(now.surface_id, changed)
    heights_m = [
        grid - RAISED_M * is_lower for grid, is_lower in zip(now.heights_m, lower.tolist(), strict=True)
    ]
    write_release(
        folder / "survey",
        region=manifest.region,
        map_version=1,
        datum=manifest.datum,
        epoch_year=manifest.epoch_year,
        time_ns=TODAY_NS - 100 * DAY_NS,
        surfaces=RoadSurfaces(**now.__dict__ | {"heights_m": heights_m}),
        links=release.road_links(),
        signing_key=key,
    )
    return folder / "survey", changed


def replay(folder: Path, vehicle: int, days_ago: int, release: str) -> Path:
    """A drive of a vehicle by the map in a folder beside it, through all real processes; what they leave."""
    start_ns = TODAY_NS - days_ago * DAY_NS
    manifest = write_short_drive(folder / f"car{vehicle}", 10 + vehicle, start_ns=start_ns)
    sets = "--set", f"vehicle=car{vehicle}", "--set", f'map.release="../{release}"'
    return replayed(manifest, folder / f"out{vehicle}", "--processes", *sets, timeout_s=300.0)


def confirmed_there(out: Path) -> tuple[int, int]:
    """Of the right fixes where the road has changed: how many were confirmed at once, and how many there are."""
    verdicts = {item.message.fix_id: item.message for item in recorded(out)["verdict"]}
    fixes = [item.message for item in recorded(out)["fix"]]
    truth = short_drive_truth()
    right = truth.fix_state == FIX_STATES.index("right")
    confirmed = total = 0
    for fix in fixes:
        row = round((fix.time_ns - TODAY_NS) % DAY_NS / 1e9 * RATE_HZ)
        now_s = row / RATE_HZ
        if fix.quality == "fixed" and right[row] and CHANGED_S[0] <= now_s < CHANGED_S[1]:
            total += 1
            confirmed += verdicts[fix.fix_id].verdict == "confirmed"
    return confirmed, total


def batches_in(out: Path) -> Iterator[UploadBatch]:
    """What a vehicle uploaded in its replay, as it was acknowledged and stored there."""
    with closing(SqliteStore(out / "state/map_update/uploads.sqlite")) as store:
        stored = store.observations_after(0, 1 << 40)
    for n, heading in enumerate(stored.entries):
        rows = stored.rows[stored.entry_of == n]
        columns = {
            name: np.ascontiguousarray(rows[name]) for name in OBSERVATION.names or () if name != "time_ns"
        }
        yield UploadBatch(
            time_ns=int(rows["time_ns"][-1]),
            vehicle=heading.vehicle,
            batch_id=heading.id,
            datum=heading.datum,
            epoch_year=heading.epoch_year,
            map_version=heading.map_version,
            positioning_time_ns=np.ascontiguousarray(rows["time_ns"]),
            **columns,
        )


def upload(endpoint: str, batch: UploadBatch) -> None:
    """Over the bus, until it is acknowledged."""
    settings = client_of(endpoint, batch.vehicle)
    receipt = query_once(settings, "upload_batch", batch, service="map_update", timeout_s=10.0)
    assert receipt.status == "stored"


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

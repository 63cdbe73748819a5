"""A short drive over a road that has changed since its survey: drives with the old map, what they upload, verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from camber.formats.drive.truth_csv import FIX_STATES
from camber.map_server.elevation_queries import ElevationMap
from camber.map_update.contribution import OBSERVATION
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.replay.short_drive import RATE_HZ, short_drive_truth, write_short_drive
from camber.road_map.release import Release, RoadSurfaces, read_release, write_release
from camber.runtime.query import query_once
from camber.schemas.fleet import UploadBatch
from support.running import CLOCK, client_of, recorded, replayed

RAISED_M = 0.4
"""The road has been resurfaced since the survey: the map is lower."""
CHANGED_S = (66.0, 71.0)
"""Of the drive, when it is on the piece that has changed: some 45 m on the bridge, with right fixes only."""
DAY_NS = 86_400 * 10**9
TODAY_NS = CLOCK.now_ns() // DAY_NS * DAY_NS


def changed_surfaces(release: Release) -> np.ndarray:
    """Ids of the surfaces that the drive is on while the road is another than at the survey."""
    truth = short_drive_truth()
    now_s = (truth.time_ns - truth.time_ns[0]) / 1e9
    there = (now_s >= CHANGED_S[0]) & (now_s < CHANGED_S[1])
    manifest = release.manifest
    the_map = ElevationMap(release.surface_tile, release.link_tile, datum=manifest.datum, map_version=1)
    return np.unique(the_map.roads(truth.latitude_rad[there], truth.longitude_rad[there]).surface_id)


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

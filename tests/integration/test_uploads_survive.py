"""Ten thousand uploads, real processes, real Zenoh; router, store and vehicle are killed again and again."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from support.databases import lasting_port
from support.paced_uploads import PacedUploads, ids_stored, paced_upload
from support.running import Processes, settings_file

UPLOADS = 10_000
RATE_HZ = 1_000.0
ROUNDS = 5
COLUMNS = ("time_ns", "surface_id", "road_height_m")


@pytest.mark.slow
def test_every_upload_is_stored_once_through_kills_of_router_store_and_vehicle(tmp_path: Path) -> None:
    fleet, endpoint = Processes(tmp_path), f"tcp/127.0.0.1:{lasting_port()}"
    store = tmp_path / "cloud" / "uploads.sqlite"
    config = settings_file(tmp_path / "map_update.toml", endpoint, f'state_dir = "{store.parent}"')
    try:
        fleet.start("router", "-m", "camber.cli", "router", "--listen", endpoint)
        fleet.start("map_update", "-m", "camber.map_update", "--config", config)
        uploads = PacedUploads(fleet, endpoint, RATE_HZ, lambda: ids_stored(store))
        for kill in range(ROUNDS):
            for step, name in ((1, "map_update"), (2, "router")):
                uploads.wait_for(UPLOADS * (2 * kill + step) // (2 * ROUNDS + 1))
                fleet.kill(name)
                fleet.start(name)
            if kill == ROUNDS // 2:
                fleet.kill("uploads")
                fleet.start("uploads")
        uploads.wait_for(UPLOADS)
        count = uploads.finish()
    finally:
        fleet.end()
    with closing(SqliteStore(store)) as opened:
        result = opened.observations_after(0, 2 * count)
    columns = [result.rows[name].tolist() for name in COLUMNS]
    ids = [result.entries[heading].id for heading in result.entry_of.tolist()]
    sent = [paced_upload(n, uploads.begin_ns) for n in range(count)]
    expected = [(*(getattr(each, name) for name in COLUMNS), each.upload_id) for each in sent]
    assert sorted(zip(*columns, ids, strict=True)) == expected

"""A vehicle uploads ten times a second, and the cloud has no database, or the vehicle no certificate, for a while.

Nothing is acknowledged meanwhile, everything waits in the vehicle, and in the end all of it is stored once. That the
vehicle's own verdicts need no cloud is what `test_faults_of_the_link.py` shows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ZenohSettings
from camber.tools.security.certificates import Authority
from support import paced_uploads
from support.databases import PostgresServer, lasting_port, needs_postgres
from support.fault_figures import LONG, measured
from support.fleet_routers import HOST, Certificates, cloud_file, vehicle_file
from support.live_vehicle import VEHICLE, Processes, wait_s
from support.running import free_port, wait_until

pytestmark = pytest.mark.slow

RATE_HZ = 10.0
LIMIT_S = 240.0
AWAY_S = 60.0 if LONG else 3.0
VALID_S = 20.0


class Uploads:
    """What a vehicle has handed over, and what of it is stored, by the ids that `stored` returns."""

    def __init__(self, processes: Processes, endpoint: str, stored: Callable[[], list[str]]) -> None:
        self.folder = processes.folder / "uploads"
        self.folder.mkdir()
        self.processes, self.stored = processes, stored
        processes.start("uploads", "-m", "support.paced_uploads", endpoint, self.folder, RATE_HZ)

    def acknowledged(self) -> int:
        counts = paced_uploads.progress(self.folder)
        return counts["put"] - counts["waiting"]

    def flow(self) -> float:
        """Seconds until all that had been handed over by now is acknowledged."""
        began_s, put = time.monotonic(), paced_uploads.progress(self.folder)["put"]
        wait_until(
            lambda: self.acknowledged() >= max(put, 1), timeout_s=LIMIT_S, why=f"{put} uploads acknowledged"
        )
        return time.monotonic() - began_s

    def stand_still(self) -> None:
        """Nothing is acknowledged any more, for as long as this row lasts."""
        wait_s(1.0)  # what was on its way
        before = self.acknowledged()
        wait_s(AWAY_S)
        assert self.acknowledged() == before

    def finish(self, fault: str, after_s: float) -> None:
        """Once each: all."""
        (self.folder / "enough").touch()
        self.processes.running["uploads"].wait(LIMIT_S)
        counts = paced_uploads.progress(self.folder)
        assert (counts["waiting"], counts["dead"]) == (0, 0)
        assert sorted(self.stored()) == sorted(f"u{n}" for n in range(counts["put"]))
        measured(fault, for_s=AWAY_S, all_in_the_cloud_after_s=after_s, uploads=counts["put"])


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    result = Processes(tmp_path)
    try:
        yield result
    finally:
        result.end()


@needs_postgres
def test_the_database_away(processes: Processes) -> None:
    with ExitStack() as ends:
        postgres = PostgresServer()
        ends.callback(postgres.remove)
        postgres.start()
        endpoint, address = f"tcp/{HOST}:{lasting_port()}", postgres.new_database()
        config = processes.folder / "map_update.toml"
        config.write_text(
            f'state_dir = "{processes.folder / "state"}"\nstore = "{address}"\n'
            f'[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]\n'
        )
        processes.start("router", "-m", "camber.cli", "router", "--listen", endpoint)
        processes.start("map_update", "-m", "camber.map_update", "--config", config)
        schema = address.rpartition("=")[2]

        def stored() -> list[str]:
            rows = postgres.execute(f"SET search_path TO {schema}", "SELECT id FROM contribution")
            return [str(row[0]) for row in rows]

        uploads = Uploads(processes, endpoint, stored)
        uploads.flow()
        postgres.end()
        uploads.stand_still()
        postgres.start()
        uploads.finish("cloud's database away", uploads.flow())


class Fleet:
    """A cloud behind TLS, with the access list of one vehicle, and that vehicle's router."""

    def __init__(self, processes: Processes) -> None:
        self.processes = processes
        folder, now = processes.folder, datetime.now(UTC)
        self.authority = Authority.make(folder / "pki", name="fleet", days=30, now=now)
        self.authority.issue("cloud", "router", hosts=[HOST], days=20, now=now)
        self.authority.issue("map_update", "map_update", days=20, now=now)
        self.authority.issue(VEHICLE, "vehicle", days=20, now=now)
        self.certificates = Certificates(self.authority.folder, self.authority.folder)
        self.cloud = f"tls/{HOST}:{lasting_port()}"
        self.inside = f"tcp/{HOST}:{free_port()}"
        self.state = folder / "state"
        file = vehicle_file(self.certificates, VEHICLE, self.inside, folder / "vehicle.json5", self.cloud)
        processes.start("vehicle", "-m", "camber.cli", "router", "--config-file", file)
        self.start_cloud()
        tls = self.certificates.settings("map_update", self.cloud)
        config = folder / "map_update.toml"
        config.write_text(
            f'vehicle = "fleet"\nstate_dir = "{self.state}"\n'
            f'[zenoh]\nmode = "client"\nconnect = ["{self.cloud}"]\n'
            f'tls_ca = "{tls.tls_ca}"\ntls_certificate = "{tls.tls_certificate}"\ntls_key = "{tls.tls_key}"\n'
        )
        processes.start("map_update", "-m", "camber.map_update", "--config", config)

    def start_cloud(self) -> None:
        """Anew, by the list as it is now."""
        if "cloud" in self.processes.running:
            self.processes.kill("cloud")
        file = cloud_file(self.certificates, self.cloud, self.processes.folder / "cloud.json5")
        self.processes.start("cloud", "-m", "camber.cli", "router", "--config-file", file)

    def stored(self) -> list[str]:
        with closing(SqliteStore(self.state / "uploads.sqlite")) as store:
            result = store.observations_after(0, 1_000_000)
        return [result.entries[heading].id for heading in result.entry_of.tolist()]

    def renew(self, days: float = 20.0, *, renew: bool = True) -> None:
        self.authority.issue(VEHICLE, "vehicle", days=days, now=datetime.now(UTC), renew=renew)

    def bus_in_the_vehicle_works(self) -> bool:
        try:
            open_session(ZenohSettings(mode="client", connect=[self.inside]), timeout_s=10.0).close()
        except BusError:
            return False
        return True


def test_a_certificate_that_was_revoked(processes: Processes) -> None:
    fleet = Fleet(processes)
    uploads = Uploads(processes, fleet.inside, fleet.stored)
    uploads.flow()
    fleet.authority.revoke(VEHICLE, now=datetime.now(UTC))
    fleet.start_cloud()
    wait_s(1.0)  # what was on its way
    before = len(fleet.stored())
    uploads.stand_still()
    assert len(fleet.stored()) == before, "taken in, though not acknowledged"
    assert fleet.bus_in_the_vehicle_works()
    fleet.renew(renew=False)
    fleet.start_cloud()
    uploads.finish("vehicle's certificate revoked", uploads.flow())


def test_a_certificate_that_has_expired(processes: Processes) -> None:
    fleet = Fleet(processes)
    uploads = Uploads(processes, fleet.inside, fleet.stored)
    uploads.flow()
    ends = datetime.now(UTC) + timedelta(seconds=VALID_S)
    fleet.renew(VALID_S / 86_400.0)
    fleet.start_cloud()
    uploads.flow()  # by the one that is about to end
    wait_s((ends - datetime.now(UTC)).total_seconds() + 1.0)
    # A vehicle that is started now has its bus all the same.
    processes.kill("vehicle")
    processes.start("vehicle")
    uploads.stand_still()
    wait_until(fleet.bus_in_the_vehicle_works, timeout_s=LIMIT_S, why="no bus in the vehicle")
    wait_until(
        lambda: "expired" in processes.log("vehicle").read_text(),
        timeout_s=LIMIT_S,
        why="expiry is not logged",
    )
    fleet.renew()
    uploads.finish("vehicle's certificate expired", uploads.flow())

"""A vehicle uploads ten times a second, and the cloud has no database, or the vehicle no certificate, for a while.

Nothing is acknowledged meanwhile, everything waits in the vehicle, and in the end all of it is stored once. That the
vehicle's own verdicts need no cloud is what `test_faults_of_the_link.py` shows.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from camber.runtime.session import BusError, open_session
from camber.tools.security.certificate_authority import Authority
from support.databases import PostgresServer, lasting_port, needs_postgres, running
from support.fault_figures import LONG, measured
from support.fleet_routers import HOST, make_certificates
from support.live_vehicle import VEHICLE
from support.paced_uploads import LIMIT_S, PacedUploads, ids_stored
from support.running import Processes, client_of, free_endpoint, settings_file, wait_until

pytestmark = pytest.mark.slow

RATE_HZ = 10.0
AWAY_S = 60.0 if LONG else 3.0
VALID_S = 20.0


def stand_still(uploads: PacedUploads) -> None:
    """Nothing is acknowledged any more, for as long as this row lasts."""
    time.sleep(1.0)  # what was on its way
    before = uploads.acknowledged
    time.sleep(AWAY_S)
    assert uploads.acknowledged == before


def finish(uploads: PacedUploads, fault: str) -> None:
    """What was handed over meanwhile is acknowledged, and all is stored once."""
    after_s = uploads.flow()
    measured(fault, for_s=AWAY_S, all_in_the_cloud_after_s=after_s, uploads=uploads.finish())


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    result = Processes(tmp_path)
    try:
        yield result
    finally:
        result.end()


@needs_postgres
def test_the_database_away(processes: Processes) -> None:
    with running(PostgresServer()) as postgres:
        endpoint, address = f"tcp/{HOST}:{lasting_port()}", postgres.new_database()
        lines = (f'state_dir = "{processes.folder / "state"}"', f'store = "{address}"')
        config = settings_file(processes.folder / "map_update.toml", endpoint, *lines)
        processes.start("router", "-m", "camber.cli", "router", "--listen", endpoint)
        processes.start("map_update", "-m", "camber.map_update", "--config", config)
        schema = address.rpartition("=")[2]

        def stored() -> list[str]:
            rows = postgres.execute(f"SET search_path TO {schema}", "SELECT id FROM contribution")
            return [str(row[0]) for row in rows]

        uploads = PacedUploads(processes, endpoint, RATE_HZ, stored)
        uploads.flow()
        postgres.end()
        stand_still(uploads)
        postgres.start()
        finish(uploads, "cloud's database away")


class Fleet:
    """A cloud behind TLS, with the access list of one vehicle, and that vehicle's router."""

    def __init__(self, processes: Processes) -> None:
        self.processes, folder = processes, processes.folder
        self.certificates = make_certificates(folder, vehicle=VEHICLE)
        self.authority = Authority(self.certificates.folder)
        self.cloud = f"tls/{HOST}:{lasting_port()}"
        self.inside = free_endpoint()
        self.store = folder / "state" / "uploads.sqlite"
        file = self.certificates.vehicle_file(VEHICLE, self.inside, self.cloud)
        processes.start("vehicle", "-m", "camber.cli", "router", "--config-file", file)
        self.start_cloud()
        joining = self.certificates.settings("map_update", self.cloud)
        where = f'state_dir = "{self.store.parent}"'
        config = settings_file(folder / "map_update.toml", joining, where, vehicle="fleet")
        processes.start("map_update", "-m", "camber.map_update", "--config", config)
        self.uploads = PacedUploads(processes, self.inside, RATE_HZ, self.stored)
        self.uploads.flow()

    def start_cloud(self) -> None:
        """Anew, by the list as it is now."""
        if "cloud" in self.processes.running:
            self.processes.kill("cloud")
        file = self.certificates.cloud_file(self.cloud)
        self.processes.start("cloud", "-m", "camber.cli", "router", "--config-file", file)

    def stored(self) -> list[str]:
        return ids_stored(self.store)

    def issue(self, days: float = 20.0, *, renew: bool = False) -> None:
        self.authority.issue(VEHICLE, "vehicle", days=days, now=datetime.now(UTC), renew=renew)

    def bus_in_the_vehicle_works(self) -> bool:
        try:
            open_session(client_of(self.inside).zenoh, timeout_s=10.0).close()
        except BusError:
            return False
        return True


def test_a_certificate_that_was_revoked(processes: Processes) -> None:
    fleet = Fleet(processes)
    fleet.authority.revoke(VEHICLE, now=datetime.now(UTC))
    fleet.start_cloud()
    time.sleep(1.0)  # what was on its way
    before = len(fleet.stored())
    stand_still(fleet.uploads)
    assert len(fleet.stored()) == before, "taken in, though not acknowledged"
    assert fleet.bus_in_the_vehicle_works()
    fleet.issue()
    fleet.start_cloud()
    finish(fleet.uploads, "vehicle's certificate revoked")


def test_a_certificate_that_has_expired(processes: Processes) -> None:
    fleet = Fleet(processes)
    ends = datetime.now(UTC) + timedelta(seconds=VALID_S)
    fleet.issue(VALID_S / 86_400.0, renew=True)
    fleet.start_cloud()
    fleet.uploads.flow()  # by the one that is about to end
    time.sleep((ends - datetime.now(UTC)).total_seconds() + 1.0)
    # A vehicle that is started now has its bus all the same.
    processes.kill("vehicle")
    processes.start("vehicle")
    stand_still(fleet.uploads)
    wait_until(fleet.bus_in_the_vehicle_works, timeout_s=LIMIT_S, why="no bus in the vehicle")
    log = processes.log("vehicle")
    wait_until(lambda: "expired" in log.read_text(), timeout_s=LIMIT_S, why="expiry is not logged")
    fleet.issue(renew=True)
    finish(fleet.uploads, "vehicle's certificate expired")

"""A vehicle and the cloud in network namespaces, and what happens on the link between them, which is one of TLS.

The vehicle drives with wrong fixes all along and uploads ten times a second beside what its judge uploads. Whatever
becomes of the link, the vehicle confirms right fixes and no wrong one; in the end the cloud holds every upload once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from support import paced_uploads
from support.fault_figures import LONG, measured
from support.fleet_routers import Certificates, cloud_file, make_certificates, vehicle_file
from support.link import CLOUD_ADDRESS, Link, link
from support.live_vehicle import VEHICLE, LiveVehicle, Processes, Witness, driving, now_ns, wait_s
from support.running import wait_until

pytestmark = pytest.mark.slow

RATE_HZ = 10.0
RIGHT_FIX_HZ = 4.0
"""Right fixes of the drive. The fault lasts until a quarter as many are confirmed as come in its time: a busy machine
may need longer for that."""
LIMIT_S = 240.0
WITHOUT_S = 3.0
CLOUD_PORT = 7448


@dataclass
class Here:
    line: Link
    vehicle: LiveVehicle
    cloud: Processes
    uploads: Path
    witness: Witness

    @property
    def store(self) -> Path:
        return self.cloud.folder / "state" / "uploads.sqlite"


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> Iterator[Here]:
    folder = tmp_path_factory.mktemp("link")
    with ExitStack() as ends:
        line = ends.enter_context(link())
        cloud = Processes(folder / "cloud")
        cloud.folder.mkdir()
        ends.callback(cloud.end)
        certificates = make_certificates(folder, host=CLOUD_ADDRESS, vehicle=VEHICLE)
        where = f"tls/{CLOUD_ADDRESS}:{CLOUD_PORT}"
        file = cloud_file(certificates, where, folder / "cloud.json5")
        cloud.start("router", "-m", "camber.cli", "router", "--config-file", file, within=line.cloud)
        config = cloud.folder / "map_update.toml"
        config.write_text(f'state_dir = "{cloud.folder / "state"}"\n{joining(certificates, where)}')
        cloud.start("map_update", "-m", "camber.map_update", "--config", config, within=line.cloud)
        (folder / "vehicle").mkdir()
        inside = f"unixsock-stream/{folder / 'bus'}"
        file = vehicle_file(certificates, VEHICLE, inside, folder / "vehicle.json5", where)
        vehicle = LiveVehicle(folder / "vehicle", inside, router_file=file, within=line.vehicle)
        uploads = folder / "uploads"
        uploads.mkdir()
        witness = ends.enter_context(driving(vehicle))
        vehicle.start("uploads", "-m", "support.paced_uploads", inside, uploads, RATE_HZ, within=line.vehicle)
        wait_until(
            lambda: paced_uploads.progress(uploads)["put"], timeout_s=LIMIT_S, why="nothing is handed over"
        )
        yield Here(line, vehicle, cloud, uploads, witness)


def joining(certificates: Certificates, where: str) -> str:
    """The table of `map_update`'s settings with which it joins its router."""
    pki = certificates.folder
    return (
        f'[zenoh]\nmode = "client"\nconnect = ["{where}"]\ntls_ca = "{pki / "ca.pem"}"\n'
        f'tls_certificate = "{pki / "map_update.pem"}"\ntls_key = "{pki / "map_update.key"}"\n'
    )


@pytest.fixture(autouse=True)
def promised(here: Here) -> Iterator[None]:
    """Of every fault: the vehicle confirms right fixes meanwhile, no wrong one, and nobody dies of it."""
    began_s = time.monotonic()
    yield
    here.witness.wait_for_trust(began_s, timeout_s=LIMIT_S)
    assert not here.witness.wrong_but_trusted(began_s), here.witness.verdict_counts(began_s)
    assert here.vehicle.ended() == {}
    assert here.cloud.ended() == {}


def cloud_has(here: Here) -> int:
    """How many of the paced uploads are stored."""
    return sum(1 for upload_id in stored_ids(here) if upload_id.startswith("u"))


def stored_ids(here: Here) -> list[str]:
    """Of all uploads, each as often as it is stored."""
    with closing(SqliteStore(here.store)) as store:
        result = store.observations_after(0, 1_000_000)
    return [result.entries[heading].id for heading in result.entry_of.tolist()]


def put(here: Here) -> int:
    return paced_uploads.progress(here.uploads)["put"]


def caught_up(here: Here) -> float:
    """Seconds until all is stored that had been handed over by now."""
    began_s, handed_over = time.monotonic(), put(here)
    wait_until(
        lambda: cloud_has(here) >= handed_over, timeout_s=LIMIT_S, why=f"{handed_over} uploads in the cloud"
    )
    return time.monotonic() - began_s


def suffer(
    here: Here,
    fault: str,
    begin: Callable[[], None],
    end: Callable[[], None],
    for_s: float,
    *,
    passes: bool = False,
) -> None:
    """A fault for some time while the vehicle drives on as ever, and how long until the cloud has all of that time.

    Uploads wait meanwhile, or, where enough still `passes`, those of that time are there before it ends.
    """
    caught_up(here)
    begin()
    try:
        began_s = time.monotonic()
        wait_s(for_s)
        wait_until(
            lambda: here.witness.verdict_counts(began_s)["right", "confirmed"] >= for_s * RIGHT_FIX_HZ / 4.0,
            timeout_s=LIMIT_S,
            why="too few right fixes confirmed during the fault",
        )
        here.witness.wait_for_trust(time.monotonic(), timeout_s=LIMIT_S, dated_after_ns=now_ns())
        waited = put(here) - cloud_has(here)
        if passes:
            caught_up(here)
        else:
            assert waited >= for_s * RATE_HZ / 2.0, "it went through"
    finally:
        end()
    measured(fault, for_s=for_s, uploads_waiting=waited, uploads_in_the_cloud_after_s=caught_up(here))


@pytest.mark.parametrize("for_s", [1.0, 60.0, 600.0] if LONG else [1.0, 8.0])
def test_link_cut(here: Here, for_s: float) -> None:
    suffer(here, "link cut", here.line.cut, here.line.mend, for_s)


def test_a_tenth_of_all_packets_lost(here: Here) -> None:
    lost: list[int] = []

    def mend() -> None:
        lost.append(here.line.dropped())
        here.line.mend()

    for_s = 60.0 if LONG else 5.0
    suffer(here, "10 % of packets lost", lambda: here.line.lose(0.1), mend, for_s, passes=True)
    assert lost[0] > 0


def test_a_hundred_kilobits_a_second(here: Here) -> None:
    """After a while without a link, so that there is more to say than passes at once."""
    held_back: list[int] = []

    def begin() -> None:
        here.line.cut()
        wait_s(WITHOUT_S)
        here.line.slow(100)
        here.line.join()

    def mend() -> None:
        held_back.append(here.line.held_back())
        here.line.mend()

    suffer(here, "100 kbit/s", begin, mend, 60.0 if LONG else 5.0, passes=True)
    assert held_back[0] > 0


@pytest.mark.parametrize("victim", ["router", "map_update"])
def test_the_cloud_away(here: Here, victim: str) -> None:
    suffer(
        here,
        f"cloud's {victim} killed",
        lambda: here.cloud.kill(victim),
        lambda: here.cloud.start(victim),
        60.0 if LONG else 2.0,
    )


def test_in_the_end_the_cloud_holds_every_upload_once(here: Here) -> None:
    (here.uploads / "enough").touch()
    here.vehicle.running["uploads"].wait(LIMIT_S)
    del here.vehicle.running["uploads"]
    counts = paced_uploads.progress(here.uploads)
    assert (counts["waiting"], counts["dead"]) == (0, 0)
    stored = [upload_id for upload_id in stored_ids(here) if upload_id.startswith("u")]
    assert sorted(stored) == sorted(f"u{n}" for n in range(counts["put"]))
    assert counts["put"] > 100
    measured("uploads through all that", handed_over=counts["put"], stored_once=len(stored))

"""A vehicle and the cloud in network namespaces, and what happens on the link between them, which is one of TLS.

The vehicle drives with wrong fixes all along and uploads ten times a second beside what its judge uploads. Whatever
becomes of the link, the vehicle confirms right fixes and no wrong one; in the end the cloud holds every upload once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from support.fault_figures import LONG, measured
from support.fleet_routers import make_certificates
from support.link import CLOUD_ADDRESS, Link, link
from support.live_vehicle import VEHICLE, LiveVehicle, Witness, driving
from support.paced_uploads import LIMIT_S, PacedUploads, ids_stored
from support.running import Processes, settings_file, wait_until

pytestmark = pytest.mark.slow

RATE_HZ = 10.0
RIGHT_FIX_HZ = 4.0
"""Right fixes of the drive. The fault lasts until a quarter as many are confirmed as come in its time: a busy machine
may need longer for that."""
WITHOUT_S = 3.0
CLOUD_PORT = 7448


@dataclass
class Here:
    line: Link
    vehicle: LiveVehicle
    cloud: Processes
    uploads: PacedUploads
    witness: Witness


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> Iterator[Here]:
    folder = tmp_path_factory.mktemp("link")
    with ExitStack() as ends:
        line = ends.enter_context(link())
        cloud = Processes(folder / "cloud")
        state = cloud.folder / "state"
        ends.callback(cloud.end)
        certificates = make_certificates(folder, host=CLOUD_ADDRESS, vehicle=VEHICLE)
        where = f"tls/{CLOUD_ADDRESS}:{CLOUD_PORT}"
        joining = certificates.settings("map_update", where)
        config = settings_file(cloud.folder / "map_update.toml", joining, f'state_dir = "{state}"')
        file = certificates.cloud_file(where)
        cloud.start("router", "-m", "camber.cli", "router", "--config-file", file, within=line.cloud)
        cloud.start("map_update", "-m", "camber.map_update", "--config", config, within=line.cloud)
        (folder / "vehicle").mkdir()
        inside = f"unixsock-stream/{folder / 'bus'}"
        file = certificates.vehicle_file(VEHICLE, inside, where)
        vehicle = LiveVehicle(folder / "vehicle", inside, router_file=file, within=line.vehicle)
        witness = ends.enter_context(driving(vehicle))
        uploads = PacedUploads(
            vehicle, inside, RATE_HZ, lambda: ids_stored(state / "uploads.sqlite"), line.vehicle
        )
        yield Here(line, vehicle, cloud, uploads, witness)


@pytest.fixture(autouse=True)
def promised(here: Here) -> Iterator[None]:
    """Of every fault: the vehicle confirms right fixes meanwhile, no wrong one, and nobody dies of it."""
    began_s = time.monotonic()
    yield
    here.witness.wait_for_trust(began_s, timeout_s=LIMIT_S)
    assert not here.witness.wrong_but_trusted(began_s), here.witness.verdict_counts(began_s)
    assert here.vehicle.ended() == {}
    assert here.cloud.ended() == {}


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
    here.uploads.flow()
    begin()
    try:
        began_s = time.monotonic()
        time.sleep(for_s)
        wait_until(
            lambda: here.witness.verdict_counts(began_s)["right", "confirmed"] >= for_s * RIGHT_FIX_HZ / 4.0,
            timeout_s=LIMIT_S,
            why="too few right fixes confirmed during the fault",
        )
        here.witness.wait_for_new_trust(timeout_s=LIMIT_S)
        waited = here.uploads.put - here.uploads.acknowledged
        if passes:
            here.uploads.flow()
        else:
            assert waited >= for_s * RATE_HZ / 2.0, "it went through"
    finally:
        end()
    measured(fault, for_s=for_s, uploads_waiting=waited, uploads_in_the_cloud_after_s=here.uploads.flow())


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
        time.sleep(WITHOUT_S)
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
    handed_over = here.uploads.finish()
    assert handed_over > 100
    measured("uploads through all that", handed_over=handed_over, stored_once=handed_over)

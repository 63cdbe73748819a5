"""A vehicle and its one link to the cloud: real routers, real TLS, a real store of uploads, bytes counted."""

from __future__ import annotations

import stat
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh

from camber.runtime.query import query_once
from camber.runtime.session import open_session
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME
from camber.schemas.fleet import UploadBatch, UploadReceipt
from camber.tools.security import access
from camber.tools.security.certificate_authority import Authority
from support.fleet_routers import (
    HOST,
    Certificates,
    Router,
    joined,
    make_certificates,
    router,
    tls_endpoint,
    unchecked,
)
from support.relay import Relay
from support.running import (
    CLOCK,
    camber,
    camber_started,
    client_of,
    free_endpoint,
    free_port,
    settings_file,
    wait_until,
)
from support.upload_load import Load, upload

SWEEP = bytes(2_000_000)
SWEEPS = 10
LITTLE_BYTES = 60_000
"""Keep-alives, a handshake, verdicts: of 20 MB within, so much at most may cross."""
CAR = "camber/v1/car-1"


class Vehicle(NamedTuple):
    router: Router
    endpoint: str
    link: Relay

    def session(self) -> zenoh.Session:
        return inside_session(self.endpoint)


class World(NamedTuple):
    certificates: Certificates
    cloud: str
    vehicle: Vehicle
    other: Vehicle

    def session(self, who: str) -> zenoh.Session:
        return joined(self.certificates.settings(who, self.cloud))


def inside_session(endpoint: str) -> zenoh.Session:
    """Of a process in a vehicle."""
    return open_session(client_of(endpoint).zenoh)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("world")
    certificates, cloud = make_certificates(folder), tls_endpoint()
    # One listens on the loopback, the other on a socket in the file system.
    inside = {"car-1": free_endpoint(), "car-2": f"unixsock-stream/{folder}/bus.sock"}
    vehicles = []
    with ExitStack() as stack:
        # The vehicles are there before the cloud is.
        for name, endpoint in inside.items():
            link = stack.enter_context(Relay(int(cloud.rpartition(":")[2])))
            file = certificates.vehicle_file(name, endpoint, f"tls/{HOST}:{link.port}")
            vehicles.append(Vehicle(stack.enter_context(router(file)), endpoint, link))
        stack.enter_context(router(certificates.cloud_file(cloud)))
        for vehicle in vehicles:
            vehicle.router.wait_for("accepted as")
        yield World(certificates, cloud, *vehicles)


@pytest.fixture
def certificates(tmp_path: Path) -> Certificates:
    return make_certificates(tmp_path)


@pytest.fixture
def inside() -> str:
    """An endpoint for the router of a vehicle."""
    return free_endpoint()


class Received:
    """The keys of what is received."""

    def __init__(self) -> None:
        self.keys: list[str] = []
        self._lock = threading.Lock()

    def __call__(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.keys.append(str(sample.key_expr))

    def until_received(self, publisher: zenoh.Publisher, *, timeout_s: float = 20.0) -> None:
        """Publish until something is received."""
        wait_until(
            lambda: publisher.put(b"v") or self.keys, timeout_s=timeout_s, why=f"no {publisher.key_expr}"
        )


def route_within(inside: str) -> None:
    """Assert that the router of a vehicle passes on within it."""
    with inside_session(inside) as one, inside_session(inside) as two:
        received = Received()
        two.declare_subscriber(f"{CAR}/**", received)
        received.until_received(one.declare_publisher(f"{CAR}/vehicle/sweep"), timeout_s=10.0)


def receive_a_verdict(
    certificates: Certificates, cloud: str, inside: str, *, timeout_s: float = 20.0
) -> None:
    """Receive, at a router of the cloud, a verdict published inside car-1."""
    with joined(certificates.settings("consumer", cloud)) as consumer, inside_session(inside) as judge:
        received = Received()
        consumer.declare_subscriber(f"{CAR}/integrity/verdict", received)
        received.until_received(judge.declare_publisher(f"{CAR}/integrity/verdict"), timeout_s=timeout_s)


def test_a_vehicles_router_routes_before_there_is_a_cloud_and_says_so(
    certificates: Certificates, inside: str
) -> None:
    with router(certificates.vehicle_file("car-1", inside, tls_endpoint())) as hub:
        route_within(inside)
        hub.wait_for("no link", timeout_s=30.0)


def test_a_peer_in_a_vehicle_is_reported(world: World) -> None:
    peer = client_of(world.vehicle.endpoint).zenoh.model_copy(update={"mode": "peer"})
    with open_session(peer):
        world.vehicle.router.wait_for('need [zenoh] mode = "client"', timeout_s=20.0)


def test_a_router_whose_certificate_is_in_no_list_says_so(world: World, inside: str) -> None:
    file = world.certificates.vehicle_file("revoked", inside, world.cloud)
    with router(file) as hub:
        hub.wait_for("not in its access list")
    checked = camber("access", "check", file)
    assert (checked.returncode, checked.stderr.count("\n")) == (1, 1)
    assert "lets nothing pass that revoked says as revoked" in checked.stderr


def test_sweeps_stay_within_and_verdicts_cross(world: World) -> None:
    link = world.vehicle.link
    with (
        world.vehicle.session() as lidar,
        world.vehicle.session() as localizer,
        world.session("consumer") as consumer,
        world.session("cloud") as cloud,
    ):
        within, outside, everything = Received(), Received(), Received()
        localizer.declare_subscriber(f"{CAR}/vehicle/sweep", within)
        consumer.declare_subscriber("camber/v1/*/integrity/verdict", outside)
        # Even a cloud that wants all gets no more: the vehicle's own router has the rules, too.
        cloud.declare_subscriber("**", everything)
        blocking = zenoh.CongestionControl.BLOCK
        sweeps = lidar.declare_publisher(f"{CAR}/vehicle/sweep", congestion_control=blocking)
        verdicts = lidar.declare_publisher(f"{CAR}/integrity/verdict")
        outside.until_received(verdicts, timeout_s=10.0)
        before = link.bytes_passed
        for _ in range(SWEEPS):
            sweeps.put(SWEEP)
            verdicts.put(bytes(300))
        wait_until(lambda: len(within.keys) == SWEEPS, timeout_s=30.0, why="sweeps are missing within")
        time.sleep(1.0)
        crossed = link.bytes_passed - before
        print(f"{SWEEPS * len(SWEEP)} bytes of sweeps within, {crossed} bytes over the link")
        assert crossed < LITTLE_BYTES
        assert set(everything.keys) == {f"{CAR}/integrity/verdict"}
        assert len(outside.keys) > SWEEPS


def test_vehicles_do_not_see_each_other(world: World) -> None:
    socket = Path(world.other.endpoint.partition("/")[2])
    assert stat.S_IMODE(socket.stat().st_mode) == 0o770, "its owner and its group join, and nobody else"
    with world.vehicle.session() as one, world.other.session() as two:
        token = one.liveliness().declare_token("camber/v1/car-1/integrity/alive")
        queryable = one.declare_queryable("camber/v1/car-1/integrity/health", lambda query: query.drop())
        received = Received()
        two.declare_subscriber("**", received)
        two.liveliness().declare_subscriber("camber/v1/**", received, history=True)
        for _ in range(5):
            one.put("camber/v1/car-1/integrity/verdict", b"v")
            one.put("camber/v1/car-1/integrity/position", b"p")
            one.put("camber/v1/fleet/release", b"forged")
            one.put("camber/v1/car-2/vehicle/motion", b"forged")
            time.sleep(0.1)
        assert received.keys == []
        assert list(two.get("camber/v1/car-1/integrity/health", timeout=1.0)) == []
        assert list(two.liveliness().get("camber/v1/**", timeout=1.0)) == []
        assert [str(zid) for zid in two.info.peers_zid()] == []
        token.undeclare()
        queryable.undeclare()


def test_an_upload_is_stored_in_the_name_of_the_certificate_only(world: World, tmp_path: Path) -> None:
    joining = world.certificates.settings("map_update", world.cloud)
    config = settings_file(
        tmp_path / "map_update.toml", joining, f'state_dir = "{tmp_path}"', vehicle="fleet"
    )

    def receipt(vehicle: str) -> UploadReceipt | None:
        made = upload(Load("", "", 0, 1, records=4, time_ns=CLOCK.now_ns() - 10**12), 1)
        assert isinstance(made, UploadBatch)
        batch = made.model_copy(update={"vehicle": vehicle})
        settings = client_of(world.vehicle.endpoint, "car-1")
        try:
            return query_once(settings, "upload_batch", batch, service="map_update", timeout_s=5.0)
        except Exception:
            return None

    with (tmp_path / "log").open("w") as log, camber_started("map_update", "--config", config, stdout=log):
        stored = wait_until(lambda: receipt("car-1"), timeout_s=60.0, why="no receipt came")
        assert stored.status == "stored"
        refused = receipt("car-2")
        assert refused is not None
        assert refused.status == "refused"
        assert refused.reason == "vehicle car-2 was uploaded under the key of car-1, expected the same"
        asked = camber("health", "map_update", "--config", config, "--json")
        assert '"refused.vehicle":1' in asked.stdout.replace(" ", "")
        assert "not_heard" not in asked.stdout
    output = (tmp_path / "log").read_text()
    assert (world.certificates.folder / "map_update.key").read_text().splitlines()[1] not in output


def test_a_consumer_in_the_cloud_listens_with_its_certificate(world: World) -> None:
    settings = world.certificates.settings("consumer", world.cloud)
    with (
        Subscription("verdict", vehicle="car-1", zenoh=settings) as listener,
        world.vehicle.session() as judge,
    ):
        key = BY_NAME["verdict"].key_for("car-1")
        deadline = time.monotonic() + 10.0
        while not listener.refused and time.monotonic() < deadline:
            judge.put(key, b"no verdict", encoding="application/msgpack;camber.Verdict.v1")
            listener.next(timeout_s=0.1)
        assert listener.refused, "nothing came"


def test_a_link_is_made_again_after_a_cut(world: World) -> None:
    link = world.vehicle.link
    with world.vehicle.session() as judge, world.session("consumer") as consumer:
        received = Received()
        consumer.declare_subscriber(f"{CAR}/integrity/verdict", received)
        verdicts = judge.declare_publisher(f"{CAR}/integrity/verdict")
        received.until_received(verdicts, timeout_s=10.0)
        link.cut(True)
        time.sleep(3.0)
        received.keys.clear()
        verdicts.put(b"lost")
        time.sleep(0.3)
        assert received.keys == []
        link.cut(False)
        received.until_received(verdicts)


def test_a_cloud_of_two_routers_and_a_vehicle_that_takes_the_one_that_is_there(
    certificates: Certificates, inside: str
) -> None:
    Authority(certificates.folder).issue("cloud-2", "router", hosts=[HOST], days=1, now=datetime.now(UTC))
    first, second = tls_endpoint(), tls_endpoint()
    other = certificates.cloud_file(second, "--router", "cloud-2", "--connect", first)
    with router(other), router(certificates.vehicle_file("car-1", inside, first, second)) as hub:
        with router(certificates.cloud_file(first)):
            hub.wait_for("accepted as")
            receive_a_verdict(certificates, second, inside)
        # The first has gone; the vehicle takes the other.
        receive_a_verdict(certificates, second, inside, timeout_s=30.0)


def test_a_vehicle_that_starts_while_the_first_router_is_away_takes_the_second(
    certificates: Certificates, tmp_path: Path
) -> None:
    """Also where at first nobody is there, as where a vehicle is started below ground."""
    away, there, inside = tls_endpoint(), tls_endpoint(), f"unixsock-stream/{tmp_path}/bus.sock"
    with router(certificates.vehicle_file("car-1", inside, away, there)) as hub:
        hub.wait_for("no link")
        with router(certificates.cloud_file(there)):
            hub.wait_for("accepted as car-1")
            receive_a_verdict(certificates, there, inside, timeout_s=30.0)
        assert hub.process.poll() is None


def test_a_link_over_quic_is_as_good_and_as_strict(certificates: Certificates, inside: str) -> None:
    cloud = f"quic/{HOST}:{free_port()}"
    with (
        router(certificates.cloud_file(cloud)),
        router(certificates.vehicle_file("car-1", inside, cloud)) as hub,
        router(certificates.vehicle_file("revoked", free_endpoint(), cloud)) as other,
    ):
        hub.wait_for("accepted as car-1")
        receive_a_verdict(certificates, cloud, inside)
        other.wait_for("lets nothing pass")
        foreign = certificates.settings("other authority", cloud)
        assert unchecked(foreign) is None
        assert unchecked(foreign.model_copy(update={"tls_certificate": None})) is None


@pytest.mark.parametrize("wrong", ["missing", "damaged", "foreign key"])
def test_a_certificate_that_cannot_be_used_is_one_line_and_the_bus_within_goes_on(
    certificates: Certificates, inside: str, wrong: str
) -> None:
    key = certificates.folder / "car-1.key"
    file = certificates.vehicle_file("car-1", inside, tls_endpoint())
    secret = key.read_text().splitlines()[1]
    if wrong == "missing":
        key.unlink()
    elif wrong == "damaged":
        key.write_text(key.read_text().replace("MIGH", "MIGX")[:-40])
    else:
        key.write_bytes((certificates.folder / "car-2.key").read_bytes())
    with router(file) as hub:
        route_within(inside)
        hub.wait_for(str(key), timeout_s=10.0)
        assert hub.output.count("\n") == 2
        assert secret not in hub.output
    checked = camber("access", "check", file)
    assert (checked.returncode, checked.stderr.count("\n")) == (3, 1)


def test_a_vehicle_is_queried_by_its_name_if_its_certificate_has_another(
    certificates: Certificates, inside: str, tmp_path: Path
) -> None:
    cloud = tls_endpoint()
    for end in ("pem", "key"):
        (certificates.folder / f"unlisted.{end}").rename(certificates.folder / f"car-9.{end}")
    options = ["cloud", "--vehicle", "car-9=unlisted", "--listen", cloud, "--tls", str(certificates.folder)]
    made = tmp_path / "cloud.json5"
    assert access.main([*options, "--out", str(made)]) == 0
    file = certificates.vehicle_file("car-9", inside, cloud)
    with router(made), router(file) as hub:
        hub.wait_for("accepted as car-9", timeout_s=30.0)
        assert camber("access", "check", file).returncode == 0


def test_a_judge_in_the_cloud_has_what_it_needs_and_others_still_do_not(
    certificates: Certificates, inside: str
) -> None:
    cloud = tls_endpoint()
    Authority(certificates.folder).issue("judge", "judge", days=1, now=datetime.now(UTC))
    file = certificates.vehicle_file("car-1", inside, cloud, to=("map_update", "consumer", "judge"))
    with router(certificates.cloud_file(cloud)), router(file) as hub:
        hub.wait_for("accepted as")
        with (
            joined(certificates.settings("judge", cloud)) as judge,
            joined(certificates.settings("consumer", cloud)) as consumer,
            inside_session(inside) as vehicle,
        ):
            token = vehicle.liveliness().declare_token(f"{CAR}/gnss/alive")
            gnss = vehicle.declare_queryable(f"{CAR}/gnss/estimates", _answer)
            alive, fixes, overheard, verdicts, there = (Received() for _ in range(5))
            judge.liveliness().declare_subscriber(f"{CAR}/*/alive", alive, history=True)
            judge.declare_subscriber(f"{CAR}/gnss/fix", fixes)
            consumer.declare_subscriber(f"{CAR}/gnss/fix", overheard)
            vehicle.declare_subscriber(f"{CAR}/integrity/verdict", verdicts)
            vehicle.liveliness().declare_subscriber(f"{CAR}/*/alive", there, history=True)
            here = judge.liveliness().declare_token(f"{CAR}/integrity/alive")
            fixes.until_received(vehicle.declare_publisher(f"{CAR}/gnss/fix"), timeout_s=10.0)
            verdicts.until_received(judge.declare_publisher(f"{CAR}/integrity/verdict"), timeout_s=10.0)
            wait_until(lambda: f"{CAR}/gnss/alive" in alive.keys, timeout_s=10.0, why="gnss is not seen")
            wait_until(lambda: f"{CAR}/integrity/alive" in there.keys, timeout_s=10.0, why="nor the judge")
            replies = judge.get(f"{CAR}/gnss/estimates", payload=b"?", timeout=5.0)
            assert [reply.ok is not None for reply in replies] == [True]
            assert overheard.keys == []
            for entity in (token, here, gnss):
                entity.undeclare()


def _answer(query: zenoh.Query) -> None:
    with query:
        query.reply(str(query.key_expr), b"estimates")

"""A vehicle and its one link to the cloud: real routers, real TLS, a real store of uploads, bytes counted."""

from __future__ import annotations

import stat
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh

from camber.runtime.clock import SystemClock
from camber.runtime.query import query_once
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.subscription import Subscription
from camber.schemas.channels import BY_NAME
from camber.schemas.fleet import UploadBatch
from camber.tools.security import access
from camber.tools.security.certificates import Authority
from support.fleet_routers import (
    HOST,
    Certificates,
    CountedLink,
    Router,
    cloud_file,
    joined,
    make_certificates,
    router,
    tls_endpoint,
    unchecked,
    vehicle_file,
)
from support.running import camber, free_port, started, wait_until
from support.upload_load import Load, upload

SWEEP = bytes(2_000_000)
SWEEPS = 10
LITTLE_BYTES = 60_000
"""Keep-alives, a handshake, verdicts: of 20 MB within, so much at most may cross."""


class Vehicle(NamedTuple):
    router: Router
    endpoint: str
    link: CountedLink

    def settings(self, vehicle: str = "car-1") -> ServiceSettings:
        return ServiceSettings(
            vehicle=vehicle, zenoh=ZenohSettings(mode="client", connect=[self.endpoint], listen=[])
        )

    def session(self) -> zenoh.Session:
        return open_session(self.settings().zenoh)


class World(NamedTuple):
    certificates: Certificates
    cloud: str
    vehicle: Vehicle
    other: Vehicle

    def session(self, who: str) -> zenoh.Session:
        return joined(self.certificates.settings(who, self.cloud))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("world")
    certificates, cloud = make_certificates(folder), tls_endpoint()
    links = [CountedLink(int(cloud.rpartition(":")[2])) for _ in range(2)]
    # One listens on the loopback, the other on a socket in the file system.
    inside = [f"tcp/{HOST}:{free_port()}", f"unixsock-stream/{folder}/bus.sock"]
    files = [
        vehicle_file(certificates, name, endpoint, folder / f"{name}.json5", f"tls/{HOST}:{link.port}")
        for name, endpoint, link in zip(("car-1", "car-2"), inside, links, strict=True)
    ]
    # The vehicles are there before the cloud is.
    with router(files[0]) as first, router(files[1]) as second:
        with router(cloud_file(certificates, cloud, folder / "cloud.json5")):
            for hub, name in ((first, "car-1"), (second, "car-2")):
                wait_until(
                    lambda hub=hub: "accepted as" in hub.output, timeout_s=60.0, why=f"{name} is not accepted"
                )
            yield World(
                certificates,
                cloud,
                Vehicle(first, inside[0], links[0]),
                Vehicle(second, inside[1], links[1]),
            )
        for link in links:
            link.close()


class Received:
    """Counts by key what has come."""

    def __init__(self) -> None:
        self.keys: list[str] = []
        self._lock = threading.Lock()

    def __call__(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.keys.append(str(sample.key_expr))


def test_a_vehicles_router_routes_before_there_is_a_cloud_and_says_so(tmp_path: Path) -> None:
    certificates, inside = make_certificates(tmp_path), f"tcp/{HOST}:{free_port()}"
    file = vehicle_file(certificates, "car-1", inside, tmp_path / "v.json5", tls_endpoint())
    settings = ZenohSettings(mode="client", connect=[inside])
    with router(file) as hub, open_session(settings) as one, open_session(settings) as two:
        received = Received()
        two.declare_subscriber("camber/v1/car-1/**", received)
        wait_until(
            lambda: one.put("camber/v1/car-1/vehicle/sweep", b"x") or received.keys,
            timeout_s=10.0,
            why="nothing came within",
        )
        wait_until(lambda: "no link" in hub.output, timeout_s=30.0, why="no message on the link")


def test_a_peer_in_a_vehicle_is_reported(world: World) -> None:
    with open_session(ZenohSettings(mode="peer", connect=[world.vehicle.endpoint])):
        wait_until(
            lambda: 'need [zenoh] mode = "client"' in world.vehicle.router.output,
            timeout_s=20.0,
            why="no message on a peer",
        )


def test_a_router_whose_certificate_is_in_no_list_says_so(world: World, tmp_path: Path) -> None:
    certificates, inside = world.certificates, f"tcp/{HOST}:{free_port()}"
    file = vehicle_file(certificates, "revoked", inside, tmp_path / "v.json5", world.cloud)
    with router(file) as hub:
        wait_until(lambda: "not in its access list" in hub.output, timeout_s=60.0, why="it did not say so")
    checked = camber("access", "check", file)
    assert (checked.returncode, checked.stderr.count("\n")) == (1, 1)
    assert "lets nothing pass that revoked says as revoked" in checked.stderr


def test_sweeps_stay_within_and_verdicts_cross(world: World) -> None:
    link, prefix = world.vehicle.link, "camber/v1/car-1"
    with (
        world.vehicle.session() as lidar,
        world.vehicle.session() as localizer,
        world.session("consumer") as consumer,
        world.session("cloud") as cloud,
    ):
        within, outside, everything = Received(), Received(), Received()
        localizer.declare_subscriber(f"{prefix}/vehicle/sweep", within)
        consumer.declare_subscriber("camber/v1/*/integrity/verdict", outside)
        # Even a cloud that wants all gets no more: the vehicle's own router has the rules, too.
        cloud.declare_subscriber("**", everything)
        sweeps = lidar.declare_publisher(
            f"{prefix}/vehicle/sweep", congestion_control=zenoh.CongestionControl.BLOCK
        )
        verdicts = lidar.declare_publisher(f"{prefix}/integrity/verdict")
        wait_until(
            lambda: verdicts.put(b"v") or outside.keys, timeout_s=10.0, why="no verdict has crossed the link"
        )
        before = link.up + link.down
        for _ in range(SWEEPS):
            sweeps.put(SWEEP)
            verdicts.put(bytes(300))
        wait_until(lambda: len(within.keys) == SWEEPS, timeout_s=30.0, why="sweeps are missing within")
        time.sleep(1.0)
        crossed = link.up + link.down - before
        print(f"{SWEEPS * len(SWEEP)} bytes of sweeps within, {crossed} bytes over the link")
        assert crossed < LITTLE_BYTES
        assert set(everything.keys) == {f"{prefix}/integrity/verdict"}
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
    tls = world.certificates.settings("map_update", world.cloud)
    config = tmp_path / "map_update.toml"
    config.write_text(
        f'vehicle = "fleet"\nstate_dir = "{tmp_path}"\n[zenoh]\nmode = "client"\nconnect = ["{world.cloud}"]\n'
        f'tls_ca = "{tls.tls_ca}"\ntls_certificate = "{tls.tls_certificate}"\ntls_key = "{tls.tls_key}"\n'
    )

    def batch(vehicle: str) -> UploadBatch:
        made = upload(Load("", "", 0, 1, records=4, time_ns=SystemClock().now_ns() - 10**12), 1)
        assert isinstance(made, UploadBatch)
        return made.model_copy(update={"vehicle": vehicle})

    def receipt(vehicle: str) -> object:
        try:
            return query_once(
                world.vehicle.settings(), "upload_batch", batch(vehicle), service="map_update", timeout_s=5.0
            )
        except Exception:
            return None

    log = (tmp_path / "log").open("w")
    with started("-m", "camber.cli", "map_update", "--config", config, stdout=log, stderr=log):
        stored = wait_until(lambda: receipt("car-1"), timeout_s=60.0, why="no receipt came")
        assert stored.status == "stored"
        refused = receipt("car-2")
        assert refused.status == "refused"
        assert refused.reason == "vehicle car-2 was uploaded under the key of car-1, expected the same"
        asked = camber("health", "map_update", "--config", config, "--json")
        assert '"refused.vehicle":1' in asked.stdout.replace(" ", "")
        assert "not_heard" not in asked.stdout
    log.close()
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
    prefix, link = "camber/v1/car-1", world.vehicle.link
    with world.vehicle.session() as judge, world.session("consumer") as consumer:
        received = Received()
        consumer.declare_subscriber(f"{prefix}/integrity/verdict", received)
        verdicts = judge.declare_publisher(f"{prefix}/integrity/verdict")
        wait_until(lambda: verdicts.put(b"v") or received.keys, timeout_s=10.0, why="no verdict has crossed")
        link.cut(True)
        time.sleep(3.0)
        received.keys.clear()
        verdicts.put(b"lost")
        time.sleep(0.3)
        assert received.keys == []
        link.cut(False)
        wait_until(
            lambda: verdicts.put(b"v") or received.keys, timeout_s=20.0, why="no verdict has crossed again"
        )


def test_a_cloud_of_two_routers_and_a_vehicle_that_takes_the_one_that_is_there(tmp_path: Path) -> None:
    certificates = make_certificates(tmp_path)
    Authority(certificates.folder).issue("cloud-2", "router", hosts=[HOST], days=1, now=datetime.now(UTC))
    first, second, inside = tls_endpoint(), tls_endpoint(), f"tcp/{HOST}:{free_port()}"
    files = (
        cloud_file(certificates, first, tmp_path / "1.json5"),
        cloud_file(certificates, second, tmp_path / "2.json5", "--router", "cloud-2", "--connect", first),
    )
    file = vehicle_file(certificates, "car-1", inside, tmp_path / "v.json5", first, second)
    with router(files[1]), router(file) as hub:
        with router(files[0]):
            wait_until(lambda: "accepted as" in hub.output, timeout_s=60.0, why="the vehicle is not accepted")
            receive_a_verdict(
                certificates, second, inside, timeout_s=20.0, why="nothing came over two routers"
            )
        # The first has gone; the vehicle takes the other.
        receive_a_verdict(
            certificates, second, inside, timeout_s=30.0, why="the vehicle found no other router"
        )


def test_a_vehicle_that_starts_while_the_first_router_is_away_takes_the_second(tmp_path: Path) -> None:
    """Also where at first nobody is there, as where a vehicle is started below ground."""
    certificates = make_certificates(tmp_path)
    away, there, inside = tls_endpoint(), tls_endpoint(), f"unixsock-stream/{tmp_path}/bus.sock"
    cloud = cloud_file(certificates, there, tmp_path / "cloud.json5")
    with router(vehicle_file(certificates, "car-1", inside, tmp_path / "v.json5", away, there)) as hub:
        wait_until(lambda: "no link" in hub.output, timeout_s=60.0, why="nobody was missed")
        with router(cloud):
            wait_until(
                lambda: "accepted as car-1" in hub.output, timeout_s=60.0, why="the second was not taken"
            )
            receive_a_verdict(certificates, there, inside, timeout_s=30.0, why="no verdict has crossed")
        assert hub.process.poll() is None


def test_a_link_over_quic_is_as_good_and_as_strict(tmp_path: Path) -> None:
    certificates, inside = make_certificates(tmp_path), f"tcp/{HOST}:{free_port()}"
    cloud = f"quic/{HOST}:{free_port()}"
    revoked = vehicle_file(certificates, "revoked", f"tcp/{HOST}:{free_port()}", tmp_path / "r.json5", cloud)
    with (
        router(cloud_file(certificates, cloud, tmp_path / "cloud.json5")),
        router(vehicle_file(certificates, "car-1", inside, tmp_path / "v.json5", cloud)) as hub,
        router(revoked) as other,
    ):
        wait_until(lambda: "accepted as car-1" in hub.output, timeout_s=60.0, why="car-1 is not accepted")
        receive_a_verdict(certificates, cloud, inside, timeout_s=20.0, why="no verdict has crossed")
        wait_until(
            lambda: "lets nothing pass" in other.output,
            timeout_s=60.0,
            why="the revoked vehicle logs nothing",
        )
        foreign = certificates.settings("other authority", cloud)
        assert unchecked(foreign) is None
        assert unchecked(foreign.model_copy(update={"tls_certificate": None})) is None


def receive_a_verdict(certificates, cloud: str, inside: str, *, timeout_s: float, why: str) -> None:
    """Receive, at a router of the cloud, a verdict published inside car-1."""
    key = "camber/v1/car-1/integrity/verdict"
    with (
        joined(certificates.settings("consumer", cloud)) as consumer,
        open_session(ZenohSettings(mode="client", connect=[inside])) as judge,
    ):
        received = Received()
        consumer.declare_subscriber(key, received)
        wait_until(lambda: judge.put(key, b"v") or received.keys, timeout_s=timeout_s, why=why)


@pytest.mark.parametrize("wrong", ["missing", "damaged", "foreign key"])
def test_a_certificate_that_cannot_be_used_is_one_line_and_the_bus_within_goes_on(
    tmp_path: Path, wrong: str
) -> None:
    certificates, inside = make_certificates(tmp_path), f"tcp/{HOST}:{free_port()}"
    key, file = certificates.folder / "car-1.key", tmp_path / "v.json5"
    vehicle_file(certificates, "car-1", inside, file, tls_endpoint())
    secret = key.read_text().splitlines()[1]
    if wrong == "missing":
        key.unlink()
    elif wrong == "damaged":
        key.write_text(key.read_text().replace("MIGH", "MIGX")[:-40])
    else:
        key.write_bytes((certificates.folder / "car-2.key").read_bytes())
    settings = ZenohSettings(mode="client", connect=[inside])
    with router(file) as hub, open_session(settings) as one, open_session(settings) as two:
        received = Received()
        two.declare_subscriber("camber/v1/car-1/**", received)
        wait_until(
            lambda: one.put("camber/v1/car-1/vehicle/sweep", b"x") or received.keys,
            timeout_s=10.0,
            why="nothing came within",
        )
        wait_until(lambda: str(key) in hub.output, timeout_s=10.0, why="no message on the key")
        assert hub.output.count("\n") == 2
        assert secret not in hub.output
    checked = camber("access", "check", file)
    assert (checked.returncode, checked.stderr.count("\n")) == (3, 1)


def test_a_vehicle_is_queried_by_its_name_if_its_certificate_has_another(tmp_path: Path) -> None:
    certificates, cloud = make_certificates(tmp_path), tls_endpoint()
    for end in ("pem", "key"):
        (certificates.folder / f"car-9.{end}").write_bytes(
            (certificates.folder / f"unlisted.{end}").read_bytes()
        )
    options = ["cloud", "--vehicle", "car-9=unlisted", "--listen", cloud, "--tls", str(certificates.folder)]
    made = tmp_path / "cloud.json5"
    assert access.main([*options, "--out", str(made)]) == 0
    file = vehicle_file(certificates, "car-9", f"tcp/{HOST}:{free_port()}", tmp_path / "v.json5", cloud)
    with router(made), router(file) as hub:
        wait_until(lambda: "accepted as car-9" in hub.output, timeout_s=30.0, why="it is not accepted")
        assert camber("access", "check", file).returncode == 0


def test_a_judge_in_the_cloud_has_what_it_needs_and_others_still_do_not(tmp_path: Path) -> None:
    certificates, cloud = make_certificates(tmp_path), tls_endpoint()
    Authority(certificates.folder).issue("judge", "judge", days=1, now=datetime.now(UTC))
    inside, to = f"tcp/{HOST}:{free_port()}", ["--to", "map_update", "consumer", "judge"]
    file = vehicle_file(certificates, "car-1", inside, tmp_path / "v.json5", cloud, more=to)
    prefix = "camber/v1/car-1"
    with router(cloud_file(certificates, cloud, tmp_path / "c.json5")), router(file) as hub:
        wait_until(lambda: "accepted as" in hub.output, timeout_s=60.0, why="the vehicle is not accepted")
        with (
            joined(certificates.settings("judge", cloud)) as judge,
            joined(certificates.settings("consumer", cloud)) as consumer,
            open_session(ZenohSettings(mode="client", connect=[inside])) as vehicle,
        ):
            token = vehicle.liveliness().declare_token(f"{prefix}/gnss/alive")
            gnss = vehicle.declare_queryable(f"{prefix}/gnss/estimates", _answer)
            alive, fixes, overheard, verdicts, there = (Received() for _ in range(5))
            judge.liveliness().declare_subscriber(f"{prefix}/*/alive", alive, history=True)
            judge.declare_subscriber(f"{prefix}/gnss/fix", fixes)
            consumer.declare_subscriber(f"{prefix}/gnss/fix", overheard)
            vehicle.declare_subscriber(f"{prefix}/integrity/verdict", verdicts)
            vehicle.liveliness().declare_subscriber(f"{prefix}/*/alive", there, history=True)
            here = judge.liveliness().declare_token(f"{prefix}/integrity/alive")
            fix = vehicle.declare_publisher(f"{prefix}/gnss/fix")
            verdict = judge.declare_publisher(f"{prefix}/integrity/verdict")
            wait_until(lambda: fix.put(b"f") or fixes.keys, timeout_s=10.0, why="no fix came to the judge")
            wait_until(lambda: verdict.put(b"v") or verdicts.keys, timeout_s=10.0, why="no verdict came back")
            wait_until(lambda: f"{prefix}/gnss/alive" in alive.keys, timeout_s=10.0, why="gnss is not seen")
            wait_until(lambda: f"{prefix}/integrity/alive" in there.keys, timeout_s=10.0, why="nor the judge")
            replies = [
                reply.ok is not None
                for reply in judge.get(f"{prefix}/gnss/estimates", payload=b"?", timeout=5.0)
            ]
            assert replies == [True]
            assert overheard.keys == []
            for entity in (token, here, gnss):
                entity.undeclare()


def _answer(query: zenoh.Query) -> None:
    with query:
        query.reply(str(query.key_expr), b"estimates")

"""A vehicle and a cloud on networks of their own, one link over mutual TLS between them: from uploads to a new release.

Both are the compose file with deployed settings; certificates and access rules are made by Camber's own commands. All
containers start in a random order, since none may depend on another.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from camber.replay.short_drive import ANTENNA_HEIGHT_M, short_drive_truth, write_short_drive
from camber.road_map.release import Release, load_signing_key, read_release, write_release
from camber.runtime.clock import SystemClock
from camber.runtime.query import query_once
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.road import ElevationRequest
from support.containers import Stack, docker, skip_without_engine
from support.containers import stack as built_stack
from support.fleet_files import RAISED_M, RAISED_S, write_fleet
from support.running import camber, started, wait_until
from support.tree import ROOT

pytestmark = [pytest.mark.container, pytest.mark.slow, pytest.mark.timed]

CAR = "car-9"
CLOUD = "cloud.example"
HEALTHY_WITHIN_S = 150.0
CUT_S = 10.0
EVERYONE = 0o755
SEED = int.from_bytes(os.urandom(2), "big")


@dataclass
class World:
    """Both projects, the network between them, and what they were set up with."""

    folder: Path
    vehicle: Stack
    cloud: Stack
    between: str
    drive: Path
    uploads: list[Path]
    surface_id: int

    def join(self) -> None:
        """Lay the link."""
        docker("network", "connect", self.between, self.vehicle.container("vehicle_router"))

    def cut(self) -> None:
        """Take it away."""
        docker("network", "disconnect", self.between, self.vehicle.container("vehicle_router"))

    def elevation_m(self) -> tuple[int, float]:
        """Version and elevation of the road where it was raised, as the vehicle's map_server says."""
        truth = short_drive_truth()
        n = int(np.searchsorted((truth.time_ns - truth.time_ns[0]) / 1e9, sum(RAISED_S) / 2))
        request = ElevationRequest(
            time_ns=SystemClock().now_ns(),
            latitude_rad=float(truth.latitude_rad[n]),
            longitude_rad=float(truth.longitude_rad[n]),
            last_surface_id=self.surface_id,  # on the bridge, not under it
        )
        bus = ZenohSettings(mode="client", connect=[f"tcp/127.0.0.1:{self.vehicle.port}"])
        settings = ServiceSettings(vehicle=CAR, zenoh=bus)
        reply = query_once(settings, "elevation", request, service="map_server", timeout_s=5.0)
        road = reply.road
        assert road.elevation_m is not None, road.reason
        return road.map_version or 0, road.elevation_m


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    skip_without_engine()
    folder = tmp_path_factory.mktemp("world")
    drive = write_short_drive(folder / "drive")
    write_settings(folder)
    uploads, raised = write_fleet(folder, survey(folder))
    for path in (folder, *folder.rglob("*")):  # the containers' user is nobody of this machine
        path.chmod(EVERYONE if path.is_dir() else 0o644)
    cloud = {"config": folder / "cloud", "certs": folder / "tls/cloud", "maps": folder / "maps"}
    cloud |= {"update_certs": folder / "tls/map_update", "signing": folder / "signing"}
    vehicle = {"config": folder / "vehicle", "certs": folder / "tls/vehicle", "maps": folder / "maps"}
    with (
        built_stack("cloud", "cloud", **cloud) as up_there,
        built_stack("car", "vehicle", **vehicle) as down_here,
        network(f"camber-between-{os.getpid()}") as between,
    ):
        start_in_any_order(up_there, down_here)
        docker("network", "connect", "--alias", CLOUD, between, up_there.container("cloud_router"))
        world = World(folder, down_here, up_there, between, drive, uploads, int(raised[len(raised) // 2]))
        world.join()
        try:
            yield world
        finally:
            world.cut()
            docker("network", "disconnect", between, up_there.container("cloud_router"))


@contextmanager
def network(name: str) -> Iterator[str]:
    docker("network", "create", "--internal", name)
    try:
        yield name
    finally:
        docker("network", "rm", name)


def start_in_any_order(*stacks: Stack) -> None:
    """Every container by itself, with a pause, in an order drawn by lot."""
    for stack in stacks:
        stack.compose("up", "--no-start", timeout_s=120.0)
    services = [(stack, service) for stack in stacks for service in stack.services()]
    random.Random(SEED).shuffle(services)
    print(f"seed {SEED}: {', '.join(service for _, service in services)}")
    for stack, service in services:
        stack.compose("start", service)
        time.sleep(0.5)


def write_settings(folder: Path) -> None:
    """Certificates, access rules, keys of releases and settings, from what is deployed."""
    done = camber(
        "certs", "make", folder / "ca", "--host", CLOUD, "--host", "router", "--host", "127.0.0.1",
        *(part for n in range(1, 10) for part in ("--vehicle", f"car-{n}")),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for place in ("cloud", "vehicle"):
        (folder / place).mkdir()
    for place, name in (("cloud", "cloud"), ("map_update", "map_update"), ("vehicle", CAR)):
        (folder / "tls" / place).mkdir(parents=True)
        for file in ("ca.pem", f"{name}.pem", f"{name}.key"):
            (folder / "tls" / place / file).write_bytes((folder / "ca" / file).read_bytes())
    vehicle = camber(
        "access", "vehicle", CAR, "--connect", f"tls/{CLOUD}:7448", "--listen", "tcp/0.0.0.0:7447",
        "--out", folder / "vehicle/vehicle_router.json5",
    )  # fmt: skip
    assert vehicle.returncode == 0, vehicle.stderr
    cloud = camber(
        "access", "cloud", "--certs", folder / "ca", "--listen", "tls/0.0.0.0:7448",
        "--listen", "tcp/127.0.0.1:7447", "--out", folder / "cloud/cloud_router.json5",
    )  # fmt: skip
    assert cloud.returncode == 0, cloud.stderr
    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (folder / "signing").mkdir()
    (folder / "signing/release.key").write_bytes(private)
    (folder / "vehicle/release.pub").write_bytes(public)
    deployed = ROOT / "deploy" / "config"
    fuse = 'fuse_every_s = 1.0\nstreet_m = 60.0\nreference = "/var/lib/camber/maps/survey"\n'
    fuse += 'signing_key = "/etc/camber/signing/release.key"\n'
    settings = {
        "cloud/map_update": fuse + (deployed / "cloud/map_update.toml").read_text(),
        "vehicle/gnss": 'source = "bus"\nprotocol = "pos"\n' + bus(),
        "vehicle/localizer": bus(),
        "vehicle/antenna_height": f"fixed_height_m = {ANTENNA_HEIGHT_M}\nfixed_sigma_m = 0.02\n" + bus(),
        "vehicle/integrity": 'state_dir = "/var/lib/camber/state"\nupload_every_s = 1.0\n' + bus(),
        "vehicle/map_server": 'store = "/var/lib/camber/state/map.sqlite"\nask_every_s = 2.0\n'
        'release = "/var/lib/camber/maps/survey"\npublic_key = "/etc/camber/release.pub"\n'
        "ask_spread_s = 0.0\n" + bus(),
    }
    for name, text in settings.items():
        (folder / f"{name}.toml").write_text(text)


def bus() -> str:
    return f'vehicle = "{CAR}"\n[zenoh]\nmode = "client"\nconnect = ["tcp/router:7447"]\n'


def survey(folder: Path) -> Release:
    """The drive's map as it was measured, signed: what the fleet's corrections are against."""
    made = read_release(folder / "drive/map")
    manifest = made.manifest
    write_release(
        folder / "maps/survey",
        region=manifest.region,
        map_version=1,
        datum=manifest.datum,
        epoch_year=manifest.epoch_year,
        time_ns=SystemClock().now_ns() - 100 * 86_400 * 10**9,
        surfaces=made.road_surfaces(),
        links=made.road_links(),
        signing_key=load_signing_key(folder / "signing/release.key"),
    )
    return read_release(folder / "maps/survey")


def stored(world: World) -> int:
    text = world.cloud.inside("map_update", "camber", "uploads", "/var/lib/camber/state/uploads.sqlite")
    return sum(f",{CAR}," in line for line in text.splitlines())


def test_all_become_healthy_whatever_the_order(world: World) -> None:
    def healthy() -> bool:
        states = world.vehicle.states() | world.cloud.states()
        return set(states.values()) == {"healthy"}

    wait_until(healthy, timeout_s=HEALTHY_WITHIN_S, why="not all are healthy")


def test_the_vehicle_knows_nobody_in_the_cloud_but_its_router(world: World) -> None:
    """The judge, for one, is on no network that leads there."""
    for name in (CLOUD, "map_update", "cloud_router"):
        reach = f"import socket; socket.getaddrinfo({name!r}, 7448)"
        output = world.vehicle.inside("integrity", "sh", "-c", f'python -c "{reach}" 2>&1 || true')
        assert "gaierror" in output


def test_a_drive_becomes_uploads_in_the_cloud_also_after_the_link_was_cut(world: World) -> None:
    router = f"tcp/127.0.0.1:{world.vehicle.port}"
    feed = ("feed", world.drive, "--loop", "--connect", router, "--vehicle", CAR)
    with (world.folder / "feed.log").open("w") as log, started("-m", "camber.cli", *feed, stdout=log):
        wait_until(lambda: stored(world) > 0, timeout_s=90.0, why="no upload of the drive arrived")
        world.cut()
        time.sleep(CUT_S)
        before = stored(world)
        assert world.vehicle.health("integrity")["status"] in ("ok", "degraded")
        world.join()
        wait_until(lambda: stored(world) > before + 3, timeout_s=60.0, why="no upload after the cut")


def test_what_a_fleet_uploads_comes_back_as_a_release(world: World) -> None:
    older, before_m = world.elevation_m()
    for path in world.uploads:
        config = world.folder / f"{path.stem}.toml"
        pair = "".join(
            f'{name} = "{world.folder / "ca" / file}"\n'
            for name, file in (
                ("tls_ca", "ca.pem"),
                ("tls_certificate", f"{path.stem}.pem"),
                ("tls_key", f"{path.stem}.key"),
            )
        )
        config.write_text(f'[zenoh]\nconnect = ["tls/127.0.0.1:{world.cloud.cloud_port}"]\n{pair}')
        done = camber("upload", path, "--config", config)
        assert done.returncode == 0, done.stderr
    wait_until(
        lambda: world.elevation_m()[1] > before_m + RAISED_M / 2,
        timeout_s=60.0,
        why="the vehicle's map still has the road as it was",
    )
    version, after_m = world.elevation_m()
    print(f"release {version} in the vehicle: {after_m - before_m:+.3f} m where the road was raised")
    assert version > older
    assert after_m - before_m == pytest.approx(RAISED_M, abs=0.03)

"""Releases on their way out, with real processes and a real bus: made in the cloud, in force in the vehicle.

`python -m integration.test_map_out` is the long form: a minute of swaps, and fetches killed in the middle.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import zenoh
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from camber.map_update.fusion.corrections import CORRECTION, Corrections
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.road_map.release import open_release
from camber.road_map.release_files import blob_path
from camber.road_map.store import MapStore
from camber.runtime.clock import SystemClock
from camber.runtime.query import QueryFailed, query_once
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.health import Health, HealthRequest
from camber.schemas.road import ElevationReply, ElevationRequest
from support.release_world import KEY, OTHER_KEY, STEP_M, making
from support.running import free_port, started, wait_until
from support.small_map import MADE_NS, at

SURFACES = 12

CLOUD = """
import sys
import time
from pathlib import Path

from camber.road_map.release_server import ReleaseServer
from camber.runtime.run import run
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings


class CloudSettings(ServiceSettings):
    "Serves a folder of releases."

    SERVICE = "map_update"
    releases: Path
    delay_s: float = 0.0


class Cloud(Service):
    "What map_update does with its releases."

    NAME, SETTINGS = "map_update", CloudSettings

    def __init__(self, settings, bus):
        super().__init__(settings, bus)
        self.serving, self.announced = ReleaseServer(settings.releases), None

    def answers(self):
        answers = self.serving.answers(self.bus.now_ns)
        blob = answers["map_blob"]

        def slowly(requests):
            time.sleep(self.settings.delay_s)
            return blob(requests)

        return {**answers, "map_blob": slowly}

    def advance(self, now_ns):
        head = self.serving.head(time_ns=now_ns)
        if head.map_version != self.announced:
            self.announced = head.map_version
            self.bus.publish("release", head)


raise SystemExit(run(Cloud))
"""


def corrections(step_m: float) -> Corrections:
    """All surfaces higher by `step_m`."""
    return np.array([(k, step_m, 0.01, 7, MADE_NS, 0) for k in range(SURFACES)], CORRECTION)


class World:
    """A router, a cloud that serves a folder, and a vehicle's map_server with a store."""

    def __init__(self, folder: Path, ends: ExitStack) -> None:
        self.folder = folder
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.making: ReleaseBuilder = making(folder, SURFACES)
        self.store = folder / "vehicle" / "map.sqlite"
        self.ends = ends
        self.settings = ServiceSettings(
            vehicle="car", zenoh=ZenohSettings(mode="client", connect=[self.endpoint])
        )
        (folder / "release.pub").write_bytes(public_pem())
        self.start("-m", "camber.cli", "router", "--listen", self.endpoint)
        self.cloud = self.vehicle = None

    def start(self, *command: object) -> subprocess.Popen[str]:
        log = self.ends.enter_context((self.folder / f"log{len(list(self.folder.glob('log*')))}").open("w"))
        return self.ends.enter_context(started(*command, stdout=log))

    def start_cloud(self, releases: Path, *, delay_s: float = 0.0) -> None:
        if self.cloud is not None:
            self.cloud.kill()
            self.cloud.wait()
        self.cloud = self.start("-c", CLOUD, *self.common(), "--releases", releases, "--delay-s", delay_s)

    def start_vehicle(self, **settings: Any) -> None:
        options = {"store": self.store, "region": "test", "public-key": self.folder / "release.pub"}
        options |= {
            "look-every-s": 0.2,
            "retry-every-s": 0.5,
            "ask-every-s": 2.0,
            "ask-spread-s": 0.0,
            **settings,
        }
        given = [(f"--{name}", value) for name, value in options.items() if value is not None]
        options = [part for pair in given for part in pair if part != ""]
        self.vehicle = self.start("-m", "camber.map_server", *self.common(), *options)

    def common(self) -> list[object]:
        path = self.folder / "common.toml"
        path.write_text(f'vehicle = "car"\n[zenoh]\nmode = "client"\nconnect = ["{self.endpoint}"]\n')
        return ["--config", path]

    def health(self) -> Health | None:
        try:
            request = HealthRequest(time_ns=MADE_NS)
            return query_once(self.settings, "health", request, service="map_server", timeout_s=2.0)
        except (QueryFailed, RuntimeError):
            return None

    def issues(self) -> dict[str, str]:
        health = self.health()
        return {} if health is None else {issue.code: issue.text for issue in health.issues}

    def version(self) -> int | None:
        """What is in force, by the file itself."""
        if not self.store.exists():
            return None
        store = MapStore(self.store)
        kept = store.current()
        store.close()
        return None if kept is None else kept.map_version


def public_pem() -> bytes:
    """The public half of the key that signs here, as a file holds it."""
    return KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


@contextmanager
def world(folder: Path) -> Iterator[World]:
    with ExitStack() as ends:
        yield World(folder, ends)


class QueryClient:
    """Asks for elevations over the bus, `rate_hz` of them, a hundred at a time at the most; keeps what came of each."""

    def __init__(self, settings: ServiceSettings, rate_hz: float) -> None:
        self.asked = 0
        self.failed: list[str] = []
        self.answers: list[tuple[int, int, float]] = []  # surface, version, elevation
        self._settings, self._rate_hz = settings, rate_hz

    def ask_until(self, enough: Callable[[float], bool]) -> None:
        """Ask until the answers suffice; `enough` gets the seconds that have passed."""
        key = BY_NAME["elevation"].key_for("car")
        points = [at(STEP_M * k, 0.0) for k in range(SURFACES)]
        now_ns = SystemClock().now_ns()
        bodies = [
            encode(ElevationRequest(time_ns=now_ns, latitude_rad=lat, longitude_rad=lon), source="test")
            for lat, lon in points
        ]

        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is None:
                self.failed.append(reply.err.payload.to_string() if reply.err else "no answer")
                return
            road = decode(ElevationReply, reply.ok.payload.to_bytes()).message.road
            if road.status != "known" or road.elevation_m is None or road.surface_id is None:
                self.failed.append(str(road.reason))
            else:
                self.answers.append((road.surface_id, road.map_version or 0, road.elevation_m))

        with open_session(self._settings.zenoh) as session:
            querier = session.declare_querier(key, timeout=5.0)
            begin = time.monotonic()
            while not enough(passed := time.monotonic() - begin):
                waiting = self.asked - len(self.answers) - len(self.failed)
                for _ in range(min(int(passed * self._rate_hz) - self.asked, 100 - waiting)):
                    querier.get(
                        answered,
                        payload=bodies[self.asked % SURFACES],
                        encoding=encoding_of(ElevationRequest),
                    )
                    self.asked += 1
                time.sleep(0.002)
            wait_until(
                lambda: len(self.answers) + len(self.failed) >= self.asked, timeout_s=30.0, why="all answers"
            )


def swaps(folder: Path, *, releases: int, rate_hz: float, every_s: float) -> dict[str, Any]:
    """So many releases, one after the other while questions are asked; what came of them."""
    with world(folder) as here:
        steps: dict[int, float] = {}

        def make(step_m: float) -> None:
            steps[here.making.build(corrections(step_m), time_ns=MADE_NS + len(steps)).map_version] = step_m

        make(0.0)
        here.start_cloud(folder / "out")
        here.start_vehicle()
        wait_until(lambda: here.version() == 8, timeout_s=90.0, why="the first release")
        wait_until(
            lambda: (h := here.health()) is not None and h.status == "ok", timeout_s=90.0, why="a map in use"
        )
        asker = QueryClient(here.settings, rate_hz)

        def enough(passed_s: float) -> bool:
            assert passed_s < every_s * releases + 60.0, f"{releases} releases were not in use by then"
            in_use = bool(asker.answers) and asker.answers[-1][1] == max(steps)
            if in_use and every_s * len(steps) < passed_s:
                if len(steps) == releases:
                    return True
                make(0.1 * len(steps))
            return False

        asker.ask_until(enough)
        base_m = min(elevation for _, version, elevation in asker.answers if version == 8)
        mixed = [answers for answers in asker.answers if abs(answers[2] - base_m - steps[answers[1]]) > 1e-3]
        return {
            "asked": asker.asked,
            "failed": asker.failed,
            "mixed": mixed,
            "releases": sorted({version for _, version, _ in asker.answers}),
            "made": sorted(steps),
        }


def killed(folder: Path, *, delay_s: float) -> dict[str, int]:
    """SIGKILL of the vehicle's map_server in the middle of a fetch; how many blobs it had to be sent in all."""
    with world(folder) as here:
        here.making.build(corrections(0.0), time_ns=MADE_NS)
        here.start_cloud(folder / "out", delay_s=delay_s)
        here.start_vehicle()
        lacked = wait_until(lambda: lacking(here.store), timeout_s=90.0, why="a manifest")
        assert here.version() is None
        assert here.vehicle is not None
        here.vehicle.kill()
        here.vehicle.wait()
        here.start_vehicle()
        wait_until(lambda: here.version() == 8, timeout_s=90.0, why="the rest of the release")
        health = wait_until(here.health, timeout_s=60.0, why="health")
        wait_until(
            lambda: here.health().counters.get("release.fetched_blobs", 0), timeout_s=60.0, why="its counters"
        )
        health = here.health()
        return {"lacked": lacked, "fetched": health.counters["release.fetched_blobs"]}


def lacking(path: Path) -> int | None:
    """How many blobs are lacking, once there is a manifest that names them."""
    if not path.exists():
        return None
    store = MapStore(path)
    try:
        coming = store.coming()
        if coming is None or store.missing([coming.manifest_sha256]):
            return None
        return len(store.missing(store.open(coming.map_version).hashes()))
    finally:
        store.close()


@pytest.mark.slow
def test_a_release_is_swapped_under_a_thousand_questions_a_second(tmp_path: Path) -> None:
    came = swaps(tmp_path, releases=4, rate_hz=1000.0, every_s=1.0)
    assert came["failed"] == []
    assert came["mixed"] == []
    assert came["releases"] == [8, 9, 10, 11]
    assert came["asked"] > 500


@pytest.mark.slow
def test_a_fetch_that_was_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    came = killed(tmp_path, delay_s=0.15)
    assert came["fetched"] <= came["lacked"]


@pytest.mark.slow
def test_a_vehicle_without_a_key_takes_what_it_was_given_and_nothing_over_the_bus(tmp_path: Path) -> None:
    with world(tmp_path) as here:
        here.making.build(corrections(0.0), time_ns=MADE_NS)
        here.start_cloud(tmp_path / "out")
        shutil.copytree(tmp_path / "out", tmp_path / "given")
        here.making.build(corrections(0.1), time_ns=MADE_NS + 1)
        here.start_vehicle(**{"public-key": None, "release": tmp_path / "given"})
        wait_until(lambda: here.version() == 8, timeout_s=90.0, why="the release that was given")
        wait_until(
            lambda: "map_update: public_key" in here.issues().get("release_refused", ""),
            timeout_s=90.0,
            why="that no key was set",
        )
        assert here.version() == 8
        here.vehicle.kill()
        here.vehicle.wait()
        here.start_vehicle(**{"public-key": None, "unsigned": ""})
        wait_until(lambda: here.version() == 9, timeout_s=90.0, why="anyone's release")


@pytest.mark.slow
def test_what_is_forged_is_named_and_never_in_force(tmp_path: Path) -> None:
    with world(tmp_path) as here:
        here.making.build(corrections(0.0), time_ns=MADE_NS)
        other = making(tmp_path / "other", SURFACES, key=OTHER_KEY)
        for step in range(3):
            other.build(corrections(1.0 + step), time_ns=MADE_NS + step)
        here.start_cloud(tmp_path / "out")
        here.start_vehicle()
        wait_until(lambda: here.version() == 8, timeout_s=90.0, why="the first release")
        here.start_cloud(tmp_path / "other" / "out")
        wait_until(
            lambda: "map_update: key_id" in here.issues().get("release_refused", ""),
            timeout_s=90.0,
            why="the name of what was refused",
        )
        assert here.version() == 8
        # A root that is right, and tiles cut short on the cloud's disk.
        before = open_release(tmp_path / "out").hashes()
        here.making.build(corrections(0.1), time_ns=MADE_NS + 1)
        for digest in open_release(tmp_path / "out").hashes() - before:
            path = blob_path(tmp_path / "out", digest)
            path.write_bytes(path.read_bytes()[:-9])
        here.start_cloud(tmp_path / "out")
        wait_until(
            lambda: "no such blob" in here.issues().get("fetch_unanswered", ""),
            timeout_s=90.0,
            why="what the cloud itself does not give away any more",
        )
        assert here.version() == 8
        here.making.build(corrections(0.2), time_ns=MADE_NS + 2)
        wait_until(lambda: here.version() == 10, timeout_s=90.0, why="the next release, which is whole")


def main() -> None:
    """The long form, with its figures."""
    with TemporaryDirectory() as folder:
        came = swaps(Path(folder), releases=30, rate_hz=1000.0, every_s=2.0)
        print({**came, "failed": len(came["failed"]), "mixed": len(came["mixed"]), "made": len(came["made"])})
    for delay_s in (0.05, 0.1, 0.2, 0.4):
        with TemporaryDirectory() as folder:
            print(delay_s, killed(Path(folder), delay_s=delay_s))


if __name__ == "__main__":
    sys.exit(main())

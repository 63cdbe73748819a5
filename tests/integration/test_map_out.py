"""Releases on their way out, with real processes and a real bus: made in the cloud, in force in the vehicle."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
import zenoh

from camber.map_update.fusion.correction_rows import CORRECTION, Corrections
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.road_map.release import open_release
from camber.road_map.release_files import blob_path
from camber.road_map.store import MapStore
from camber.runtime.query import QueryFailed
from camber.runtime.session import open_session
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.health import Health
from camber.schemas.road import ElevationReply, ElevationRequest
from support.release_world import KEY, OTHER_KEY, STEP_M, making, public_pem
from support.running import (
    CLOCK,
    client_of,
    health_of,
    loopback_router,
    settings_file,
    started,
    wait_until,
)
from support.small_map import MADE_NS, at

pytestmark = pytest.mark.slow

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
        self.folder, self.ends = folder, ends
        self.making: ReleaseBuilder = making(folder, SURFACES)
        self.store = folder / "vehicle" / "map.sqlite"
        (folder / "release.pub").write_bytes(public_pem(KEY))
        self.endpoint = ends.enter_context(loopback_router())
        self.config = settings_file(folder / "common.toml", self.endpoint)
        self.running: dict[str, subprocess.Popen[str]] = {}

    def build(self, step_m: float, number: int = 0) -> int:
        """A release in which all surfaces are higher by `step_m`; its version."""
        return self.making.build(corrections(step_m), time_ns=MADE_NS + number).map_version

    def end(self, name: str) -> None:
        self.running[name].kill()
        self.running[name].wait()

    def _start(self, name: str, command: tuple[str, str], options: dict[str, object]) -> None:
        """In the place of the one of this name, if any."""
        if name in self.running:
            self.end(name)
        given = [part for option, value in options.items() for part in (f"--{option}", value) if part != ""]
        log = self.ends.enter_context((self.folder / f"{name}.log").open("a"))
        process = started(*command, "--config", self.config, *given, stdout=log)
        self.running[name] = self.ends.enter_context(process)

    def start_cloud(self, releases: Path, *, delay_s: float = 0.0) -> None:
        self._start("cloud", ("-c", CLOUD), {"releases": releases, "delay-s": delay_s})

    def start_vehicle(self, **settings: object) -> None:
        """With a key, unless the settings name another source; an empty value: the option alone."""
        often = {"look-every-s": 0.2, "retry-every-s": 0.5, "ask-every-s": 2.0, "ask-spread-s": 0.0}
        common = {"store": self.store, "region": "test", **often}
        source = settings or {"public-key": self.folder / "release.pub"}
        self._start("vehicle", ("-m", "camber.map_server"), common | source)

    def health(self) -> Health | None:
        try:
            return health_of(self.endpoint, "map_server", timeout_s=2.0)
        except (QueryFailed, RuntimeError):
            return None

    def wait_for_issue(self, code: str, text: str) -> None:
        def reported() -> bool:
            health = self.health()
            return health is not None and any(i.code == code and text in i.text for i in health.issues)

        wait_until(reported, timeout_s=90.0, why=f"{code}: {text}")

    def version(self) -> int | None:
        """What is in force, by the file itself."""
        if not self.store.exists():
            return None
        with closing(MapStore(self.store)) as store:
            kept = store.current()
        return None if kept is None else kept.map_version

    def wait_for_version(self, version: int) -> None:
        wait_until(lambda: self.version() == version, timeout_s=90.0, why=f"version {version} in force")


@pytest.fixture
def here(tmp_path: Path) -> Iterator[World]:
    with ExitStack() as ends:
        yield World(tmp_path, ends)


class QueryClient:
    """Asks for elevations over the bus, `rate_hz` of them, a hundred at a time at the most; keeps what came of each."""

    def __init__(self, endpoint: str, rate_hz: float) -> None:
        self.asked = 0
        self.failed: list[str] = []
        self.answers: list[tuple[int, int, float]] = []  # surface, version, elevation
        self._zenoh, self._rate_hz = client_of(endpoint).zenoh, rate_hz

    def ask_until(self, enough: Callable[[float], bool]) -> None:
        """Ask until the answers suffice; `enough` gets the seconds that have passed."""
        key = BY_NAME["elevation"].key_for("car")
        points = [at(STEP_M * k, 0.0) for k in range(SURFACES)]
        bodies = [
            encode(
                ElevationRequest(time_ns=CLOCK.now_ns(), latitude_rad=lat, longitude_rad=lon), source="test"
            )
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

        with open_session(self._zenoh) as session:
            querier = session.declare_querier(key, timeout=5.0)
            begin = time.monotonic()
            while not enough(passed := time.monotonic() - begin):
                waiting = self.asked - len(self.answers) - len(self.failed)
                for _ in range(min(int(passed * self._rate_hz) - self.asked, 100 - waiting)):
                    body = bodies[self.asked % SURFACES]
                    querier.get(answered, payload=body, encoding=encoding_of(ElevationRequest))
                    self.asked += 1
                time.sleep(0.002)
            wait_until(
                lambda: len(self.answers) + len(self.failed) >= self.asked, timeout_s=30.0, why="all answers"
            )


def test_a_release_is_swapped_under_a_thousand_questions_a_second(here: World) -> None:
    releases, every_s = 4, 1.0
    steps = {here.build(0.0): 0.0}
    here.start_cloud(here.folder / "out")
    here.start_vehicle()
    here.wait_for_version(8)
    wait_until(lambda: (h := here.health()) and h.status == "ok", timeout_s=90.0, why="a map in use")
    asker = QueryClient(here.endpoint, 1000.0)

    def enough(passed_s: float) -> bool:
        assert passed_s < every_s * releases + 60.0, f"{releases} releases were not in use by then"
        in_use = bool(asker.answers) and asker.answers[-1][1] == max(steps)
        if in_use and every_s * len(steps) < passed_s:
            if len(steps) == releases:
                return True
            step_m = 0.1 * len(steps)
            steps[here.build(step_m, len(steps))] = step_m
        return False

    asker.ask_until(enough)
    base_m = min(elevation for _, version, elevation in asker.answers if version == 8)
    assert [answer for answer in asker.answers if abs(answer[2] - base_m - steps[answer[1]]) > 1e-3] == []
    assert asker.failed == []
    assert {version for _, version, _ in asker.answers} == {8, 9, 10, 11}
    assert asker.asked > 500


def test_a_fetch_that_was_killed_goes_on_where_it_was(here: World) -> None:
    here.build(0.0)
    here.start_cloud(here.folder / "out", delay_s=0.15)
    here.start_vehicle()
    lacked = wait_until(lambda: lacking(here.store), timeout_s=90.0, why="a manifest")
    assert here.version() is None
    here.start_vehicle()  # in the place of the one that is killed
    here.wait_for_version(8)

    def fetched() -> int:
        health = here.health()
        return 0 if health is None else health.counters.get("release.fetched_blobs", 0)

    wait_until(fetched, timeout_s=60.0, why="its counters")
    assert 0 < fetched() <= lacked


def lacking(path: Path) -> int | None:
    """How many blobs are lacking, once there is a manifest that names them."""
    if not path.exists():
        return None
    with closing(MapStore(path)) as store:
        coming = store.coming()
        if coming is None or store.missing([coming.manifest_sha256]):
            return None
        return len(store.missing(store.open(coming.map_version).hashes()))


def test_a_vehicle_without_a_key_takes_what_it_was_given_and_nothing_over_the_bus(here: World) -> None:
    here.build(0.0)
    here.start_cloud(here.folder / "out")
    given = shutil.copytree(here.folder / "out", here.folder / "given")
    here.build(0.1, 1)
    here.start_vehicle(release=given)
    here.wait_for_version(8)
    here.wait_for_issue("release_refused", "map_update: public_key")
    assert here.version() == 8
    here.start_vehicle(unsigned="")
    here.wait_for_version(9)


def test_what_is_forged_is_named_and_never_in_force(here: World) -> None:
    here.build(0.0)
    other = making(here.folder / "other", SURFACES, key=OTHER_KEY)
    for step in range(3):
        other.build(corrections(1.0 + step), time_ns=MADE_NS + step)
    out = here.folder / "out"
    here.start_cloud(out)
    here.start_vehicle()
    here.wait_for_version(8)
    here.start_cloud(here.folder / "other" / "out")
    here.wait_for_issue("release_refused", "map_update: key_id")
    assert here.version() == 8
    # A root that is right, and tiles cut short on the cloud's disk.
    before = open_release(out).hashes()
    here.build(0.1, 1)
    for digest in open_release(out).hashes() - before:
        path = blob_path(out, digest)
        path.write_bytes(path.read_bytes()[:-9])
    here.start_cloud(out)
    here.wait_for_issue("fetch_unanswered", "no such blob")  # the cloud does not give it away any more
    assert here.version() == 8
    here.build(0.2, 2)
    here.wait_for_version(10)

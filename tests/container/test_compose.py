"""The compose file, run by a real engine: healthy, sound over the demo's drive, back after the router was killed."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.drive.truth_csv import read_truth
from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.schemas.channels import BY_NAME, SERVICES, VEHICLE_SERVICES
from camber.schemas.codec import decode
from camber.schemas.integrity import Verdict
from support.containers import RELEASE, Stack, docker, skip_without_engine
from support.containers import stack as started_stack
from support.running import wait_until

pytestmark = [pytest.mark.container, pytest.mark.slow, pytest.mark.timed]

HEALTHY_WITHIN_S = 60
OUTAGE_S = 6.0
BACK_WITHIN_S = 30.0
ROUTERS = ("vehicle_router", "cloud_router")
CONFIRMED = ("confirmed", "confirmed_after_verification")
RIGHT_WITHIN_M = 0.2  # the wrong fixes of the drive are off by 0.35 m of height and more


class Subscription:
    """Receives the verdicts like a consumer on this machine, from before the router is killed until after."""

    def __init__(self, port: int) -> None:
        self.received: list[tuple[float, Verdict]] = []
        settings = ZenohSettings(mode="client", connect=[f"tcp/127.0.0.1:{port}"])
        self._session = open_session(settings, timeout_s=20.0)
        self._session.declare_subscriber(BY_NAME["verdict"].key_for("demo"), self._receive)

    def _receive(self, sample: Any) -> None:
        verdict = decode(Verdict, sample.payload.to_bytes(), str(sample.encoding)).message
        self.received.append((time.monotonic(), verdict))

    def confirmed_since(self, moment: float) -> list[Verdict]:
        """Positions passed on after a moment of the monotonic clock."""
        return [
            verdict for at, verdict in list(self.received) if at > moment and verdict.verdict in CONFIRMED
        ]

    def close(self) -> None:
        """Leave the bus."""
        self._session.close()


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    skip_without_engine()
    with started_stack("demo", "demo") as stack:
        stack.compose("up", "--detach", "--wait", "--wait-timeout", str(HEALTHY_WITHIN_S), timeout_s=120.0)
        yield stack


@pytest.fixture(scope="module")
def listener(stack: Stack) -> Iterator[Subscription]:
    listener = Subscription(stack.port)
    yield listener
    listener.close()


def test_every_service_is_healthy(stack: Stack) -> None:
    assert stack.states() == dict.fromkeys((*SERVICES, *ROUTERS, "demo", "live"), "healthy")


def test_the_summary_of_the_demo_is_there_and_nothing_wrong_was_confirmed(stack: Stack) -> None:
    summary = json.loads(stack.inside("demo", "cat", "summary.json"))
    assert summary["confirmed"]["wrong"] == 0
    assert summary["confirmed"]["count"] > 300
    assert summary["tentative"]["wrong"] > 50
    assert "wrong among them 0" in stack.compose("logs", "--no-color", "demo")


def test_services_run_without_rights_and_cannot_change_their_code(stack: Stack) -> None:
    for service in ("gnss", "vehicle_router", "map_update", "demo"):
        assert stack.inside(service, "id", "-u").strip() == "10001"
        code = stack.inside(service, "python", "-c", "import camber.cli; print(camber.cli.__file__)").strip()
        assert code.startswith("/opt/code/")
        assert stack.inside(service, "sh", "-c", f"echo '#' >>{code} || echo refused").strip() == "refused"
        status = stack.inside(service, "cat", "/proc/self/status")
        assert "CapEff:\t0000000000000000" in status
        assert "NoNewPrivs:\t1" in status


def test_only_this_machine_reaches_the_routers_and_the_page_and_nothing_else_is_published(
    stack: Stack,
) -> None:
    assert stack.compose("port", "vehicle_router", "7447").strip() == f"127.0.0.1:{stack.port}"
    assert stack.compose("port", "cloud_router", "7448").strip() == f"127.0.0.1:{stack.cloud_port}"
    assert stack.compose("port", "live", "8080").strip() == f"127.0.0.1:{stack.live_port}"
    published = [p["PublishedPort"] for row in stack.rows() for p in row["Publishers"] or ()]
    assert sorted(port for port in published if port) == sorted(
        (stack.port, stack.cloud_port, stack.live_port)
    )


def test_the_cloud_and_the_vehicle_meet_at_their_routers_alone(stack: Stack) -> None:
    project = json.loads(stack.compose("config", "--format", "json"))
    networks = {name: set(service["networks"]) for name, service in project["services"].items()}
    assert {name for name, on in networks.items() if "vehicle" in on} == {
        *VEHICLE_SERVICES,
        "vehicle_router",
        "demo",
        "live",
    }
    assert {name for name, on in networks.items() if "cloud" in on} == {"map_update", "cloud_router"}
    assert {name for name, on in networks.items() if "uplink" in on} == set(ROUTERS)
    assert all(project["networks"][name]["internal"] for name in ("vehicle", "cloud"))
    for service, other in (("integrity", "cloud_router"), ("map_update", "vehicle_router")):
        known = f"import socket; socket.getaddrinfo({other!r}, 7447)"
        output = stack.inside(service, "sh", "-c", f'python -c "{known}" 2>&1 || true')
        assert "gaierror" in output, service


def test_the_page_of_the_vehicle_is_served_to_this_machine_alone(stack: Stack) -> None:
    page = f"http://127.0.0.1:{stack.live_port}/"
    with urllib.request.urlopen(page, timeout=10.0) as answer:
        assert b"<title>" in answer.read()
    elsewhere = urllib.request.Request(page, headers={"Host": "elsewhere.example"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(elsewhere, timeout=10.0)


def test_live_inputs_become_verdicts_and_uploads(stack: Stack, listener: Subscription) -> None:
    wait_until(
        lambda: len(listener.confirmed_since(0.0)) > 20, timeout_s=240.0, why="no positions were confirmed"
    )
    wait_until(
        lambda: stack.health("map_update").get("counters", {}).get("stored", 0) > 0,
        timeout_s=30.0,
        why="no upload reached the store",
    )


def test_verdicts_are_back_after_the_router_was_killed(stack: Stack, listener: Subscription) -> None:
    wait_until(
        lambda: listener.confirmed_since(0.0), timeout_s=90.0, why="no positions were confirmed before"
    )
    stack.compose("kill", "vehicle_router")
    killed = time.monotonic()
    time.sleep(OUTAGE_S)
    assert listener.confirmed_since(killed + 0.5) == []
    stack.compose("start", "vehicle_router")
    started = time.monotonic()
    wait_until(
        lambda: len(listener.confirmed_since(started)) > 3,
        timeout_s=BACK_WITHIN_S,
        why="no verdicts after the router came back",
    )


def test_a_service_that_was_killed_is_started_again(stack: Stack) -> None:
    before_s = stack.health("integrity")["uptime_s"]
    # From inside, as a crash would end it: what an operator kills from outside stays down.
    stack.inside("integrity", "sh", "-c", "kill -9 -1", check=False)
    wait_until(
        lambda: stack.health("integrity").get("uptime_s", before_s) < before_s,
        timeout_s=30.0,
        why="integrity is not back",
    )


def test_no_confirmed_position_was_wrong(stack: Stack, listener: Subscription, tmp_path: Path) -> None:
    """Runs last: over all verdicts received, including start, outage and restart."""
    confirmed = [verdict for _, verdict in listener.received if verdict.verdict in CONFIRMED]
    assert len(confirmed) > 20
    copy = tmp_path / "truth.csv"
    copy.write_text(stack.inside("demo", "cat", "city/truth.csv"))
    truth = read_truth(copy, "camber")
    path_m = ecef_from_geodetic(truth.latitude_rad, truth.longitude_rad, truth.height_m)
    places = np.array([(v.latitude_rad, v.longitude_rad, v.height_m) for v in confirmed], dtype=np.float64)
    # Fixes are of the truth's own epochs, so each right one has a point of the way beside it, in height too.
    apart_m = np.linalg.norm(ecef_from_geodetic(*places.T)[:, None] - path_m[None], axis=2).min(axis=1)
    assert float(apart_m.max()) < RIGHT_WITHIN_M


def test_a_roll_back_is_a_start_of_the_images_that_were_kept(stack: Stack) -> None:
    """Here of the judge alone, to another release and back: nothing is built, nothing is asked of a registry."""
    docker("tag", stack.image("integrity"), stack.image("integrity", "next"))
    try:
        for release in ("next", RELEASE):
            start = ("up", "--detach", "--wait", "--no-build", "--no-deps", "--pull", "never", "integrity")
            stack.compose(*start, release=release, timeout_s=60.0)
            runs = docker("inspect", "--format", "{{.Config.Image}}", stack.container("integrity")).strip()
            assert runs == stack.image("integrity", release)
    finally:
        docker("image", "rm", stack.image("integrity", "next"))


def test_every_service_is_confined(stack: Stack) -> None:
    project = json.loads(stack.compose("config", "--format", "json"))
    assert set(project["services"]) == {*SERVICES, *ROUTERS, "demo", "live"}
    for name, service in project["services"].items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"] is True, name
        assert Path(service["build"]["dockerfile"]) == Path("deploy/Dockerfile"), name
        assert int(service["mem_limit"]) <= 2 << 30, name
        assert 0 < service["pids_limit"] <= 256, name
        assert 0.0 < service["cpus"] <= 2.0, name
        assert "depends_on" not in service, name

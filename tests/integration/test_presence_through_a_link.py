"""Services present behind a linked router are listed every time, though Zenoh itself may omit them."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from camber.runtime.query import QueryClient
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from support.fleet_routers import make_certificates, router, tls_endpoint
from support.running import client_of, free_endpoint, wait_until

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Fleet:
    """A vehicle's router that is linked to a cloud's; a client by `settings` joins the vehicle's."""

    vehicle_file: Path
    settings: ServiceSettings

    @property
    def bus(self) -> ZenohSettings:
        return self.settings.zenoh


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    certificates, cloud, inside = make_certificates(tmp_path), tls_endpoint(), free_endpoint()
    with router(certificates.cloud_file(cloud)):
        yield Fleet(certificates.vehicle_file("car-1", inside, cloud), client_of(inside, "car-1"))


@contextmanager
def linked(fleet: Fleet) -> Iterator[None]:
    with router(fleet.vehicle_file) as vehicle:
        vehicle.wait_for("accepted as")
        yield


def token(session: Any, service: str) -> Any:
    return session.liveliness().declare_token(f"camber/v1/car-1/{service}/alive")


BOTH = {"car-1": frozenset({"gnss", "integrity"})}
ONE = {"car-1": frozenset({"integrity"})}


def test_present_services_are_listed_every_time_and_those_that_left_are_not(fleet: Fleet) -> None:
    with linked(fleet), open_session(fleet.bus) as service:
        leaver, _stayer = token(service, "gnss"), token(service, "integrity")
        time.sleep(0.5)
        for _ in range(12):
            with QueryClient(fleet.settings, timeout_s=3.0) as asker:
                assert asker.alive("car-1") == BOTH
                assert asker.alive("car-2") == {}
        with QueryClient(fleet.settings, timeout_s=3.0) as asker:
            assert [asker.alive() for _ in range(12)] == [BOTH] * 12
            leaver.undeclare()
            wait_until(lambda: asker.alive() == ONE, timeout_s=20.0, why="who has left is still there")
            assert asker.alive("car-1") == ONE
            assert asker.alive("car-2") == {}


def test_a_service_that_leaves_during_the_query_is_not_listed_later(fleet: Fleet) -> None:
    """As `camber status --watch` asks."""
    when = random.Random(seed := random.randrange(2**32))
    print("seed", seed)
    with (
        linked(fleet),
        open_session(fleet.bus) as service,
        QueryClient(fleet.settings, timeout_s=3.0) as asker,
    ):
        _stayer = token(service, "integrity")
        for _ in range(60):
            leaver = token(service, "gnss")
            wait_until(lambda: asker.alive() == BOTH, timeout_s=10.0, why="a new service is not listed")
            leaving = threading.Timer(when.uniform(0.0, 0.02), leaver.undeclare)
            leaving.start()
            time.sleep(when.uniform(0.0, 0.02))
            asker.alive()
            leaving.join()
            wait_until(lambda: asker.alive() == ONE, timeout_s=10.0, why="who has left is still there")


def test_nobody_is_there_without_a_router_and_all_are_again_with_a_new_one(fleet: Fleet) -> None:
    with ExitStack() as stays:
        with linked(fleet):
            service = stays.enter_context(open_session(fleet.bus))
            asker = stays.enter_context(QueryClient(fleet.settings, timeout_s=3.0))
            _tokens = token(service, "gnss"), token(service, "integrity")
            wait_until(lambda: asker.alive() == BOTH, timeout_s=10.0, why="not listed")
        wait_until(lambda: asker.alive() == {}, timeout_s=20.0, why="listed without a router")
        with linked(fleet):
            wait_until(lambda: asker.alive() == BOTH, timeout_s=20.0, why="not listed again")

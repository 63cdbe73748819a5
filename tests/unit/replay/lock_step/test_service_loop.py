"""A service in lock step: what it sends with the end of a tick, who is alive, when it answers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from camber.replay.lock_step.service_loop import LockStepBus, LockStepLoop
from camber.runtime.clock import ReplayClock
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.runtime.uploads.received_upload import ReceivedUpload
from camber.schemas.health import HealthRequest

NOW_NS, ASKED_NS = 1_400_000_000_000_000_000, 1_400_000_000_200_000_000


def make_bus(service: str, session: Any = None, clock: ReplayClock | None = None) -> LockStepBus:
    settings = ServiceSettings(log_level="error")
    return LockStepBus(cast(zenoh.Session, session), settings, service, clock or ReplayClock())


def test_alive_are_the_participants_of_the_tick() -> None:
    bus = make_bus("gnss")
    assert not bus.is_alive("map_server")
    bus.participants = frozenset({"map_server"})
    assert bus.is_alive("map_server")
    assert not bus.is_alive("localizer")


def flushed(
    service: str, published: list[str], wanted_by: set[str]
) -> tuple[list[tuple[str, bool]], set[str]]:
    """Publish and flush; returns the keys sent, each with whether the done was attached, and who is not reached."""
    sent: list[tuple[str, bool]] = []

    def declare_publisher(key: str, **_: Any) -> Any:
        kind = key.rsplit("/", 1)[-1]
        return SimpleNamespace(put=lambda data, attachment=None: sent.append((kind, attachment is not None)))

    bus = make_bus(service, SimpleNamespace(declare_publisher=declare_publisher))
    for name in published:
        bus.publish(name, HealthRequest(time_ns=NOW_NS))
    assert sent == [], "sent before the end of the tick"
    done = HealthRequest(time_ns=NOW_NS)
    unreached = bus.flush(done, wanted_by)
    assert bus.flush(done, set()) == set()
    return sent, unreached


@pytest.mark.parametrize(
    ("service", "published", "wanted_by", "sent"),
    [
        pytest.param(
            "gnss",
            ["fix", "fix", "velocity"],
            {"localizer", "integrity"},
            [("fix", False), ("fix", True), ("velocity", False)],
            id="the last message of as few channels as reach all",
        ),
        pytest.param(
            "integrity",
            ["verdict", "position"],
            {"localizer", "feeder"},
            [("verdict", True), ("position", True)],
            id="the very last message for the feeder",
        ),
    ],
)
def test_the_done_is_attached_to(
    service: str, published: list[str], wanted_by: set[str], sent: list[tuple[str, bool]]
) -> None:
    assert flushed(service, published, wanted_by) == (sent, set())


def test_those_that_the_attached_done_does_not_reach_are_returned() -> None:
    assert flushed("localizer", ["pose"], {"integrity", "map_server", "feeder"})[1] == {"map_server"}
    assert flushed("localizer", [], {"integrity", "feeder"})[1] == {"integrity", "feeder"}
    # A fleet's key is not among those that the feeder of a vehicle subscribes to.
    assert flushed("map_update", ["release"], {"map_server", "feeder"}) == ([("release", True)], {"feeder"})


class Answering(Service[ServiceSettings]):
    """Answers with the time that it is then."""

    NAME = "map_update"
    SETTINGS = ServiceSettings

    def answers(self) -> dict[str, Any]:
        return {"upload_batch": lambda requests: [self.bus.now_ns() for _ in requests]}


@pytest.mark.parametrize("upload", [False, True], ids=["a query", "an upload"])
def test_a_query_is_answered_at_the_time_of_its_request(upload: bool) -> None:
    clock = ReplayClock()
    clock.set(NOW_NS)
    bus = make_bus("map_update", clock=clock)
    loop = LockStepLoop(Answering(bus.settings, bus), bus, clock)
    message: Any = HealthRequest(time_ns=ASKED_NS)
    request = ReceivedUpload("car", message) if upload else message
    assert loop._replies("upload_batch", [request]) == [ASKED_NS]
    assert clock.now_ns() == NOW_NS

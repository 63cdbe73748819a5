"""Whatever a service has met, it can say how it is."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from camber.runtime.bus import Bus
from camber.runtime.clock import Clock, ReplayClock, SystemClock
from camber.runtime.inbox import Inbox
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode
from camber.schemas.health import Health, HealthRequest


class Plain(Service[ServiceSettings]):
    """A service that does nothing."""

    NAME = "gnss"
    SETTINGS = ServiceSettings
    state: Any = True

    def healthy(self) -> bool:
        if isinstance(self.state, Exception):
            raise self.state
        return bool(self.state)


def make_bus(clock: Clock | None = None) -> Bus:
    """A bus that has not joined anything."""
    settings = ServiceSettings(log_level="error")
    return Bus(cast(zenoh.Session, None), settings, "gnss", clock or ReplayClock())


def health_of(bus: Bus, state: Any = True) -> Health:
    """What is answered, over the wire."""
    clock = SystemClock()
    service = Plain(ServiceSettings(), bus)
    service.state = state
    return decode(Health, encode(Loop(service, bus, clock).health())).message


def test_an_issue_is_counted_and_its_newest_text_shown() -> None:
    bus = make_bus()
    bus.issue("source_lost", "first")
    bus.issue("source_lost", "second")
    bus.issue("other", "")
    assert [(i.code, i.text, i.count) for i in bus.issues()] == [
        ("other", "", 1),
        ("source_lost", "second", 2),
    ]


def test_more_issues_than_health_can_carry_are_counted_together() -> None:
    bus = make_bus()
    for n in range(500):
        bus.issue(f"issue_{n}", f"text {n}")
    issues = health_of(bus).issues
    assert len(issues) == 64
    assert sum(issue.count for issue in issues) == 500
    assert {issue.code: issue.text for issue in issues}["others"] == "text 499"


def test_an_issue_that_is_known_is_counted_as_itself_however_many_there_are() -> None:
    bus = make_bus()
    for n in range(500):
        bus.issue(f"issue_{n}", "")
    bus.issue("issue_3", "again")
    assert {issue.code: issue.count for issue in bus.issues()}["issue_3"] == 2


def test_a_long_text_is_cut() -> None:
    bus = make_bus()
    bus.issue("long", "x" * 10_000)
    assert health_of(bus).issues[0].text == "x" * 512


def test_more_counters_than_health_can_carry_are_counted_together() -> None:
    bus = make_bus()
    for n in range(5000):
        bus.count(f"counter.{n}", 2)
    counters = health_of(bus).counters
    assert len(counters) <= 256
    assert sum(counters.values()) == 10_000


def test_the_inboxes_own_counters_find_room() -> None:
    bus = make_bus()
    for n in range(5000):
        bus.count(f"counter.{n}")
    loop = Loop(Plain(ServiceSettings(), bus), bus, SystemClock())
    for name in BY_NAME:
        inbox = Inbox(BY_NAME[name])
        inbox.refused.update(["stale", "future"])
        loop.refused(inbox)
    assert loop.health().counters["fix.stale"] == 1


@given(names=st.lists(st.text(max_size=80), max_size=100), text=st.text(max_size=600), n=st.integers(-5, 5))
def test_no_name_and_no_text_makes_health_refuse_itself(names: list[str], text: str, n: int) -> None:
    bus = make_bus()
    for name in names:
        bus.issue(name, text)
        bus.count(name, n)
    issues = health_of(bus).issues
    assert sum(issue.count for issue in issues) == len(names)


def test_a_text_that_is_no_unicode_is_shown_all_the_same() -> None:
    bus = make_bus()
    bus.issue("unreadable", b"caf\xe9.pos".decode("utf-8", "surrogateescape"))
    assert health_of(bus).issues[0].text == r"caf\udce9.pos"


@pytest.mark.parametrize("unix_s", [5, 946_000_000, 5_000_000_000])
def test_a_machine_without_the_right_time_still_answers(monkeypatch: pytest.MonkeyPatch, unix_s: int) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: unix_s * 1_000_000_000)
    assert health_of(make_bus()).status == "ok"


def test_status_is_the_services_own_word_and_a_fault_is_failing() -> None:
    assert health_of(make_bus(), state=True).status == "ok"
    assert health_of(make_bus(), state=False).status == "degraded"
    failed = health_of(make_bus(), state=RuntimeError("boom"))
    assert failed.status == "failing"
    assert [issue.code for issue in failed.issues] == ["internal_error"]


def test_in_a_replay_who_is_alive_is_what_the_tick_says() -> None:
    bus = make_bus(ReplayClock())
    assert not bus.is_alive("map_server")
    bus.participants = frozenset({"map_server"})
    assert bus.is_alive("map_server")
    assert not bus.is_alive("localizer")


class Wire:
    """What goes out: key, and whom the rider would reach."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, bool]] = []

    def declare_publisher(self, key: str, **_: Any) -> Any:
        return SimpleNamespace(
            put=lambda data, attachment=None: self.sent.append((key, attachment is not None))
        )


def flushed(
    service: str, published: list[str], wanted_by: set[str]
) -> tuple[list[tuple[str, bool]], set[str]]:
    wire = Wire()
    bus = Bus(cast(Any, wire), ServiceSettings(log_level="error"), service, ReplayClock())
    for name in published:
        bus.publish(name, HealthRequest(time_ns=10**18))
    assert wire.sent == [], "before the end of the tick nothing goes"
    rider = HealthRequest(time_ns=10**18)
    left = bus.flush(rider, wanted_by)
    assert bus.flush(rider, set()) == set()
    return [(key.rsplit("/", 1)[-1], ridden) for key, ridden in wire.sent], left


def test_the_rider_travels_with_the_last_message_of_as_few_channels_as_reach_all() -> None:
    sent, left = flushed("gnss", ["fix", "fix", "velocity"], {"localizer", "integrity"})
    assert sent == [("fix", False), ("fix", True), ("velocity", False)]
    assert left == set()


def test_for_the_feeder_it_travels_with_the_very_last_message() -> None:
    sent, left = flushed("integrity", ["verdict", "position"], {"localizer", "feeder"})
    assert sent == [("verdict", True), ("position", True)]
    assert left == set()


def test_whom_it_does_not_reach_is_told() -> None:
    assert flushed("localizer", ["pose"], {"integrity", "map_server", "feeder"})[1] == {"map_server"}
    assert flushed("localizer", [], {"integrity", "feeder"})[1] == {"integrity", "feeder"}
    # A fleet's key is not among those that the feeder of a vehicle hears.
    sent, left = flushed("map_update", ["release"], {"map_server", "feeder"})
    assert (sent, left) == ([("release", True)], {"feeder"})

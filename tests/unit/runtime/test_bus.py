"""Whatever a service has met, it can say how it is."""

from __future__ import annotations

import time
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from camber.runtime import bus as module
from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.inbox import Inbox
from camber.runtime.run import Loop
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import decode, encode, encoding_of
from camber.schemas.health import Health, HealthRequest
from camber.schemas.lidar import Sweep
from support.messages import build


class Plain(Service[ServiceSettings]):
    """A service that does nothing."""

    NAME = "gnss"
    SETTINGS = ServiceSettings
    state: Any = True

    def healthy(self) -> bool:
        if isinstance(self.state, Exception):
            raise self.state
        return bool(self.state)


def make_bus(session: Any = None) -> Bus:
    """A bus that has not joined anything."""
    return Bus(cast(zenoh.Session, session), ServiceSettings(log_level="error"), "gnss", SystemClock())


def health_of(bus: Bus, state: Any = True) -> Health:
    """What is answered, over the wire."""
    clock = SystemClock()
    service = Plain(ServiceSettings(), bus)
    service.state = state
    return decode(Health, encode(Loop(service, bus, clock).health())).message


def test_an_issue_is_counted_and_its_newest_text_and_time_shown() -> None:
    bus = make_bus()
    bus.issue("source_lost", "first")
    bus.issue("source_lost", "second")
    bus.issue("other", "")
    assert [(i.code, i.text, i.count) for i in bus.issues()] == [
        ("other", "", 1),
        ("source_lost", "second", 2),
    ]
    for issue in bus.issues():
        assert abs(SystemClock().now_ns() - issue.last_time_ns) < 10**10


def test_more_issues_than_health_can_carry_are_counted_together_but_for_those_that_are_known() -> None:
    bus = make_bus()
    for n in range(500):
        bus.issue(f"issue_{n}", f"text {n}")
    issues = health_of(bus).issues
    assert len(issues) == 64
    assert sum(issue.count for issue in issues) == 500
    assert {issue.code: issue.text for issue in issues}["others"] == "text 499"
    bus.issue("issue_3", "again")
    assert {issue.code: issue.count for issue in bus.issues()}["issue_3"] == 2


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("x" * 10_000, "x" * 512),
        (b"caf\xe9.pos".decode("utf-8", "surrogateescape"), r"caf\udce9.pos"),  # no Unicode
    ],
)
def test_a_text_that_health_cannot_carry_is_shown_as_it_can(text: str, shown: str) -> None:
    bus = make_bus()
    bus.issue("code", text)
    assert health_of(bus).issues[0].text == shown


def test_more_counters_than_health_can_carry_are_counted_together() -> None:
    bus = make_bus()
    for n in range(5000):
        bus.count(f"counter.{n}", 2)
    counters = health_of(bus).counters
    assert len(counters) <= 256
    assert sum(counters.values()) == 10_000


def test_the_counters_of_the_inbox_find_room() -> None:
    bus = make_bus()
    for n in range(5000):
        bus.count(f"counter.{n}")
    loop = Loop(Plain(ServiceSettings(), bus), bus, SystemClock())
    for name in BY_NAME:
        inbox = Inbox(channel=BY_NAME[name])
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


@pytest.mark.parametrize("unix_s", [5, 946_000_000, 5_000_000_000])
def test_a_machine_without_the_right_time_still_answers(monkeypatch: pytest.MonkeyPatch, unix_s: int) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: unix_s * 1_000_000_000)
    assert health_of(make_bus()).status == "ok"


def test_status_is_set_by_the_service_and_a_fault_is_failing() -> None:
    assert health_of(make_bus(), state=True).status == "ok"
    assert health_of(make_bus(), state=False).status == "degraded"
    failed = health_of(make_bus(), state=RuntimeError("boom"))
    assert failed.status == "failing"
    assert [issue.code for issue in failed.issues] == ["internal_error"]


def test_what_went_over_a_channel_is_counted_with_its_age(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = SimpleNamespace(
        declare_publisher=lambda *_, **__: SimpleNamespace(),
        declare_subscriber=lambda *_: SimpleNamespace(undeclare=lambda: None),
    )
    bus = make_bus(wire)
    monkeypatch.setattr(bus, "send", lambda *_: None)
    bus.subscribe(BY_NAME["motion"])
    for _ in range(3):
        bus.publish("fix", HealthRequest(time_ns=10**18))
    uses = {(use.channel, use.direction): use for use in health_of(bus).channels}
    assert (uses["fix", "out"].messages, uses["motion", "in"].messages) == (3, 0)
    assert uses["fix", "out"].age_s is not None
    assert uses["motion", "in"].age_s is None


def test_a_service_that_met_all_there_can_be_still_fits_into_one_message() -> None:
    bus = make_bus()
    for n in range(5000):
        bus.issue(f"issue_{n}".ljust(64, "x"), "€" * 512)
        bus.count(f"counter_{n}".ljust(64, "x"), 2**40)
    health = health_of(bus)
    assert len(health.issues) == 64
    assert all(issue.text for issue in health.issues)


def test_another_log_level_falls_back_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = make_bus()
    bus.set_log_level("debug", 600.0)
    bus.restore_log_level()
    assert health_of(bus).log_level == "debug"
    monkeypatch.setattr(time, "monotonic", lambda real=time.monotonic: real() + 601.0)
    bus.restore_log_level()
    assert health_of(bus).log_level == "error"


def test_at_debug_an_issue_is_logged_each_time(capsys: pytest.CaptureFixture[str]) -> None:
    bus = make_bus()
    bus.set_log_level("info", 600.0)
    for _ in range(3):
        bus.issue("source_lost", "text")
    assert capsys.readouterr().err.count("source_lost") == 1
    bus.set_log_level("debug", 600.0)
    for _ in range(3):
        bus.issue("source_lost", "text")
    assert capsys.readouterr().err.count("source_lost") == 3


class Subscribing:
    """A session that hands over what is declared to it."""

    receive: Any = None

    def declare_subscriber(self, key: str, handler: Any) -> object:
        self.receive = handler.callback
        return object()


def arriving(data: bytes, encoding: str) -> Any:
    payload = SimpleNamespace(to_bytes=lambda: data)
    return SimpleNamespace(payload=payload, encoding=encoding, attachment=None, source_info=None)


@pytest.mark.parametrize("size", [0, 3, 200_000])
def test_of_what_is_large_the_newest_that_can_be_read_waits(size: int) -> None:
    session = Subscribing()
    bus = make_bus(session)
    bus.subscribe(BY_NAME["sweep"])
    sweeps = [encode(build(Sweep, Random(n), filled=True)) for n in range(2)]
    encoding = encoding_of(Sweep)
    for sweep in sweeps:
        session.receive(arriving(sweep, encoding))
        session.receive(arriving(bytes(size), encoding))
        session.receive(arriving(sweep[:-5], encoding))
        session.receive(arriving(sweep, "text/plain"))
    item = bus.pop("sweep")
    assert item.data == sweeps[1]
    assert bus.counters["sweep.overflow"] == 7
    assert bus.pop("sweep") is None


def test_of_what_is_large_one_that_comes_while_the_last_is_taken_is_handed_out_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whether it can be read is looked at while the work loop goes on."""
    session = Subscribing()
    bus = make_bus(session)
    bus.subscribe(BY_NAME["sweep"])
    monkeypatch.setattr(module, "_can_be_read", lambda *_: bus.pop("sweep") is not None)
    for number in (b"1", b"2", b"3"):
        session.receive(arriving(number, encoding_of(Sweep)))
    waiting = 0
    while bus.next_event(0.0) is not None:
        waiting += 1
    assert waiting == 3
    item = bus.pop("sweep")
    assert item.data == b"3"


def test_what_a_service_cannot_say_of_itself_is_a_fault_and_no_end() -> None:
    bus = make_bus()
    service = Plain(ServiceSettings(), bus)
    service.gauges = lambda: 1 / 0  # type: ignore[method-assign,assignment,return-value]
    health = Loop(service, bus, SystemClock()).health()
    assert health.status == "failing"
    assert "ZeroDivisionError" in health.issues[0].text

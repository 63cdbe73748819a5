"""A judge whose inputs come late, in a time of its own: the clock of the test, so that no machine's pace is in it."""

from __future__ import annotations

import heapq
from random import Random
from typing import Any

import pytest

from camber.integrity.service import IntegrityService
from camber.integrity.settings import IntegritySettings
from camber.runtime.bus import QueryFailed
from camber.runtime.inbox import Inbox
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import Received
from camber.schemas.gnss import Estimates
from support.judges_inputs import outcome, recorded_inputs

PERIOD_NS = 50_000_000
DURATION_S = 40.0


class LateBus:
    """A bus at the end of a link: `link_ns` behind, answers as late as they may be."""

    def __init__(self) -> None:
        self.time_ns = 0
        self.link_ns = 0
        self.verdicts: dict[int, Any] = {}
        self.asked = 0

    def set_link_delay(self, delay_s: float) -> None:
        self.link_ns = round(delay_s * 1e9)

    def now_ns(self) -> int:
        return self.time_ns - self.link_ns

    def publish(self, name: str, message: Any) -> None:
        if name == "verdict" and message.fix_id is not None:
            assert message.fix_id not in self.verdicts
            self.verdicts[message.fix_id] = message

    def ask(self, name: str, request: Any) -> Any:
        self.asked += 1
        if name != "estimates":
            raise QueryFailed("absent")
        return Estimates(time_ns=request.time_ns, fix_id=request.fix_id, status="unavailable")

    def is_alive(self, service: str) -> bool:
        return True

    def issue(self, code: str, text: str) -> None: ...

    def count(self, name: str, n: int = 1) -> None: ...


def judged(
    messages: list, delay_s: float, setting_s: float, jitter_s: float = 0.0
) -> tuple[LateBus, dict[str, int]]:
    """Verdicts on messages that come so much later, and how many inputs were refused, by channel."""
    bus, random = LateBus(), Random(5)
    service = IntegrityService(IntegritySettings(upload=False, link_delay_s=setting_s), bus)  # type: ignore[arg-type]
    handlers = service.handlers()
    inboxes = {name: Inbox(channel=BY_NAME[name]) for name in handlers}
    first_ns = min(message.time_ns for _, _, message in messages)
    events: list[tuple[int, int, str, Any]] = []
    for number, (at_s, name, message) in enumerate(messages):
        late_s = at_s + delay_s + random.uniform(0.0, jitter_s)
        heapq.heappush(events, (first_ns + round(late_s * 1e9), number, name, message))
    next_ns = events[0][0]
    last_ns = max(event[0] for event in events) + 4 * PERIOD_NS
    while bus.time_ns < last_ns:
        bus.time_ns = min(next_ns, events[0][0] if events else last_ns)
        if events and events[0][0] <= next_ns:
            _, number, name, message = heapq.heappop(events)
            if name not in handlers:
                continue
            accepted = inboxes[name].accept(
                Received(message=message, source=name, sequence=number), bus.now_ns()
            )
            if accepted is not None:
                handlers[name](accepted)
        else:
            next_ns += PERIOD_NS
        service.advance(bus.now_ns())
    return bus, {name: sum(inbox.refused.values()) for name, inbox in inboxes.items() if inbox.refused}


@pytest.fixture(scope="module")
def messages(tmp_path_factory) -> list:
    return recorded_inputs(tmp_path_factory.mktemp("drive"), DURATION_S)


@pytest.fixture(scope="module")
def in_vehicle(messages) -> dict:
    bus, refused = judged(messages, 0.0, 0.0)
    assert refused == {}
    assert {verdict.verdict for verdict in bus.verdicts.values()} >= {"confirmed", "erroneous", "unknown"}
    assert sorted(bus.verdicts) == sorted(message.fix_id for _, name, message in messages if name == "fix")
    return {fix_id: outcome(verdict) for fix_id, verdict in bus.verdicts.items()}


@pytest.mark.parametrize("delay_s", [0.1, 0.4, 1.5])
def test_a_delay_that_is_known_changes_nothing_but_the_time(messages, in_vehicle, delay_s: float) -> None:
    bus, refused = judged(messages, delay_s, delay_s)
    assert refused == {}
    assert {fix_id: outcome(verdict) for fix_id, verdict in bus.verdicts.items()} == in_vehicle


def test_a_delay_that_varies_below_the_setting_loses_no_fix_and_changes_no_verdict(
    messages, in_vehicle
) -> None:
    """Of what one epoch has, the last may come 50 ms after the first."""
    bus, _ = judged(messages, 0.08, 0.15, jitter_s=0.05)
    result = {fix_id: outcome(verdict) for fix_id, verdict in bus.verdicts.items()}
    assert result.keys() == in_vehicle.keys()
    verdicts = {fix_id: one["verdict"] for fix_id, one in result.items()}
    assert verdicts == {fix_id: one["verdict"] for fix_id, one in in_vehicle.items()}


def test_without_the_setting_a_delay_costs_verdicts(messages, in_vehicle) -> None:
    """The tests above can fail."""
    late, refused = judged(messages, 0.6, 0.0)
    assert refused
    assert len(late.verdicts) < len(in_vehicle)
    some, _ = judged(messages, 0.1, 0.0)
    assert {fix_id: outcome(verdict) for fix_id, verdict in some.verdicts.items()} != in_vehicle

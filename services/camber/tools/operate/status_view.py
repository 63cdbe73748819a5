"""Content of `camber status` from the health reports of the services; no bus, no clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from camber.runtime.query import QueryFailed
from camber.schemas.channels import BY_NAME
from camber.schemas.health import ChannelUse, Health, Issue

State = Literal["ok", "starting", "degraded", "failing", "not answering"]
Answers = Mapping[str, Sequence[Health | QueryFailed]]
"""Service → health reports of its workers, or why there is none."""

NOT_ANSWERING: State = "not answering"
LATE_PERIODS = 5.0  # chosen: a channel is late after so many periods without a message
_REFUSALS = frozenset({"undecodable", "stale", "future", "repeated", "out_of_order", "overflow"})
_WORSE: dict[State, int] = {"ok": 0, "starting": 4, "degraded": 4, "failing": 1, "not answering": 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceRow:
    """One process, present or expected."""

    service: str
    state: State
    why: str
    health: Health | None

    def as_json(self) -> dict[str, Any]:
        """Return the row as JSON, with the whole health report."""
        report = None if self.health is None else self.health.model_dump(mode="json")
        return {"service": self.service, "state": self.state, "why": self.why, "health": report}


@dataclass(slots=True, kw_only=True)
class ChannelRow:
    """One channel, from the reports of its producers and consumers together."""

    channel: str
    producers: set[str] = field(default_factory=set)
    received_s_ago: dict[str, float] = field(default_factory=dict)
    """By consumer; since its start without a message."""
    rate_hz: float | None = None
    table_rate_hz: float | None = None
    youngest_s: float | None = None
    refused: Counter[str] = field(default_factory=Counter)
    waiting: int = 0

    @property
    def age_s(self) -> float | None:
        """Return the age of the last message at the consumer that waits longest; None without any message."""
        return None if self.youngest_s is None else max(self.received_s_ago.values(), default=self.youngest_s)

    @property
    def late(self) -> bool:
        """Whether a consumer has received nothing for too long on a channel that carried messages."""
        return self.age_s is not None and self.age_s > self._limit_s

    @property
    def deaf(self) -> list[str]:
        """Return consumers that receive nothing although others send or receive messages."""
        if self.youngest_s is None or self.youngest_s > self._limit_s:
            return []
        return sorted(service for service, age_s in self.received_s_ago.items() if age_s > self._limit_s)

    @property
    def _limit_s(self) -> float:
        return max(LATE_PERIODS / self.table_rate_hz, 1.0) if self.table_rate_hz else float("inf")

    def as_json(self) -> dict[str, Any]:
        """Return this as JSON."""
        names = ("rate_hz", "table_rate_hz", "age_s", "late", "deaf", "refused", "waiting")
        services = {"producers": sorted(self.producers), "consumers": sorted(self.received_s_ago)}
        return {"channel": self.channel, **services, **{name: getattr(self, name) for name in names}}


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusView:
    """The status of a vehicle, or of the cloud (`vehicle` is then `fleet`)."""

    vehicle: str
    services: tuple[ServiceRow, ...]
    channels: tuple[ChannelRow, ...]
    notes: tuple[str, ...]

    @property
    def exit_code(self) -> int:
        """Return 0: all ok; 1: one failing or not answering; 4: one degraded, starting or without messages."""
        codes = {_WORSE[row.state] for row in self.services}
        codes |= {4 for row in self.channels if row.deaf}
        return 1 if 1 in codes else 4 if 4 in codes else 0

    def as_json(self) -> dict[str, Any]:
        """Return this as JSON."""
        return {
            "vehicle": self.vehicle,
            "exit_code": self.exit_code,
            "services": [row.as_json() for row in self.services],
            "channels": [row.as_json() for row in self.channels],
            "notes": list(self.notes),
        }


def view_of(vehicle: str, answers: Answers, before: Answers, alive: frozenset[str]) -> StatusView:
    """Build the view from two rounds of answers; `alive` are the services with a liveliness token."""
    services = tuple(
        _service_row(service, answer, service in alive)
        for service, several in answers.items()
        for answer in several
    )
    reports = (health for several in before.values() for health in several if isinstance(health, Health))
    earlier = {_worker(health): health for health in reports}
    channels = _channel_rows(services, earlier)
    notes = (*_notes(services), *_deaf_notes(channels))
    return StatusView(vehicle=vehicle, services=services, channels=channels, notes=notes)


def last_issue(health: Health) -> Issue | None:
    """Return the most recent issue of a service."""
    dated = [issue for issue in health.issues if issue.last_time_ns is not None]
    return max(dated, key=lambda issue: issue.last_time_ns or 0, default=None)


def _service_row(service: str, answer: Health | QueryFailed, is_alive: bool) -> ServiceRow:
    if isinstance(answer, Health):
        return ServiceRow(service=service, state=answer.status, why="", health=answer)
    if answer.reason == "invalid":
        why = f"its answer cannot be read: another version of Camber? ({answer})"
    elif is_alive:
        why = "on the bus, but its work loop does not answer: frozen or overloaded"
    elif answer.reason == "absent":
        why = "not on the bus: not started, ended, disconnected, or access denied"
    else:
        why = f"not on the bus any more ({answer})"
    return ServiceRow(service=service, state=NOT_ANSWERING, why=why, health=None)


def _worker(health: Health) -> tuple[str, str]:
    return health.service, health.facts.get("process", "")


def _channel_rows(
    services: Sequence[ServiceRow], earlier: Mapping[tuple[str, str], Health]
) -> tuple[ChannelRow, ...]:
    rows: dict[str, ChannelRow] = {}
    for row in services:
        if row.health is None:
            continue
        before = earlier.get(_worker(row.health))
        for use in row.health.channels:
            channel = BY_NAME.get(use.channel)
            if channel is None or channel.delivery == "barrier" or use.channel in ("health", "log_level"):
                continue
            new = ChannelRow(
                channel=use.channel, producers=set(channel.producers), table_rate_hz=channel.rate_hz
            )
            _add(rows.setdefault(use.channel, new), row.health, use, _rate(use, row.health, before))
    order = {name: place for place, name in enumerate(BY_NAME)}
    return tuple(sorted(rows.values(), key=lambda shown: order[shown.channel]))


def _add(shown: ChannelRow, health: Health, use: ChannelUse, rate_hz: float | None) -> None:
    if rate_hz is not None:
        shown.rate_hz = max(shown.rate_hz or 0.0, rate_hz)
    if use.age_s is not None:
        shown.youngest_s = use.age_s if shown.youngest_s is None else min(shown.youngest_s, use.age_s)
    if use.direction == "out":
        return
    received_s_ago = health.uptime_s if use.age_s is None else use.age_s
    # Each message goes to one of several workers.
    shown.received_s_ago[health.service] = min(
        received_s_ago, shown.received_s_ago.get(health.service, received_s_ago)
    )
    shown.waiting = max(shown.waiting, use.waiting)
    for name, count in health.counters.items():
        channel, _, reason = name.partition(".")
        if channel == use.channel and reason in _REFUSALS and use.direction == "in":
            shown.refused[reason] += count


def _rate(use: ChannelUse, now: Health, before: Health | None) -> float | None:
    over_s = 0.0 if before is None else now.uptime_s - before.uptime_s
    if before is None or over_s <= 0.0:
        return None
    for was in before.channels:
        if (was.channel, was.direction) == (use.channel, use.direction):
            return max(use.messages - was.messages, 0) / over_s
    return None


def _deaf_notes(channels: Sequence[ChannelRow]) -> Iterator[str]:
    for row in channels:
        for service in row.deaf:
            yield f"{service} has had no {row.channel} for {row.received_s_ago[service]:.0f} s, though it is published"


def _notes(services: Sequence[ServiceRow]) -> tuple[str, ...]:
    """Return notes on versions that differ and on debug logging."""
    reports = [row.health for row in services if row.health is not None]
    versions = {
        "version of Camber": {health.version for health in reports},
        "versions of messages": {
            health.facts["messages"] for health in reports if "messages" in health.facts
        },
    }
    notes = [
        f"not all have the same {what}: {', '.join(sorted(values))}"
        for what, values in versions.items()
        if len(values) > 1
    ]
    notes += [f"{health.service} logs at debug" for health in reports if health.log_level == "debug"]
    return tuple(notes)

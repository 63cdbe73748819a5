"""What `camber status` shows, made from what services said of themselves: no bus, no clock."""

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
"""Service → what its workers said, or why nobody did."""

NOT_ANSWERING: State = "not answering"
LATE_PERIODS = 5.0  # a channel of the table that has been silent for so many of its periods
_REFUSALS = frozenset({"undecodable", "stale", "future", "repeated", "out_of_order", "overflow"})
_WORSE: dict[State, int] = {"ok": 0, "starting": 4, "degraded": 4, "failing": 1, "not answering": 1}


@dataclass(frozen=True, slots=True)
class ServiceRow:
    """One process, or one that should be there."""

    service: str
    state: State
    why: str
    health: Health | None

    def as_json(self) -> dict[str, Any]:
        """For programs: everything the service said."""
        said = None if self.health is None else self.health.model_dump(mode="json")
        return {"service": self.service, "state": self.state, "why": self.why, "health": said}


@dataclass(slots=True)
class ChannelRow:
    """One channel, as its producers and consumers see it together."""

    channel: str
    producers: set[str] = field(default_factory=set)
    heard_s: dict[str, float] = field(default_factory=dict)  # consumer → since its last message, or its begin
    rate_hz: float | None = None
    table_rate_hz: float | None = None
    youngest_s: float | None = None
    refused: Counter[str] = field(default_factory=Counter)
    waiting: int = 0

    @property
    def age_s(self) -> float | None:
        """Since the consumer that has waited longest had a message; none: nobody has said or heard one."""
        return None if self.youngest_s is None else max(self.heard_s.values(), default=self.youngest_s)

    @property
    def late(self) -> bool:
        """It has carried messages, and somebody had none for long."""
        return self.age_s is not None and self.age_s > self._limit_s

    @property
    def deaf(self) -> list[str]:
        """Who had no message for long, though others say or hear them."""
        if self.youngest_s is None or self.youngest_s > self._limit_s:
            return []
        return sorted(service for service, age_s in self.heard_s.items() if age_s > self._limit_s)

    @property
    def _limit_s(self) -> float:
        return max(LATE_PERIODS / self.table_rate_hz, 1.0) if self.table_rate_hz else float("inf")

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "channel": self.channel,
            "producers": sorted(self.producers),
            "consumers": sorted(self.heard_s),
            "rate_hz": self.rate_hz,
            "table_rate_hz": self.table_rate_hz,
            "age_s": self.age_s,
            "late": self.late,
            "deaf": self.deaf,
            "refused": dict(self.refused),
            "waiting": self.waiting,
        }


@dataclass(frozen=True, slots=True)
class View:
    """One look at a vehicle, or at the cloud (`vehicle` is then `fleet`)."""

    vehicle: str
    services: tuple[ServiceRow, ...]
    channels: tuple[ChannelRow, ...]
    notes: tuple[str, ...]

    @property
    def exit_code(self) -> int:
        """0: all are well; 1: one has failed or does not answer; 4: one waits for its inputs, or is deaf to one."""
        codes = {_WORSE[row.state] for row in self.services}
        codes |= {4 for row in self.channels if row.deaf}
        return 1 if 1 in codes else 4 if 4 in codes else 0

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "vehicle": self.vehicle,
            "exit_code": self.exit_code,
            "services": [row.as_json() for row in self.services],
            "channels": [row.as_json() for row in self.channels],
            "notes": list(self.notes),
        }


def view_of(vehicle: str, answers: Answers, before: Answers, alive: frozenset[str]) -> View:
    """What the services said now and a moment before; `alive` are those who declare to be on the bus."""
    services = tuple(
        _service_row(service, said, service in alive)
        for service, several in answers.items()
        for said in several
    )
    earlier = {
        _worker(health): health
        for several in before.values()
        for health in several
        if isinstance(health, Health)
    }
    channels = _channel_rows(services, earlier)
    return View(vehicle, services, channels, (*_notes(services), *_deaf_notes(channels)))


def last_issue(health: Health) -> Issue | None:
    """What the service met last."""
    met = [issue for issue in health.issues if issue.last_time_ns is not None]
    return max(met, key=lambda issue: issue.last_time_ns or 0, default=None)


def _service_row(service: str, said: Health | QueryFailed, is_alive: bool) -> ServiceRow:
    if isinstance(said, Health):
        return ServiceRow(service, said.status, "", said)
    if said.reason == "invalid":
        why = f"its answer cannot be read: another version of Camber? ({said})"
    elif is_alive:
        why = "on the bus, but its work loop does not answer: frozen, or at work for too long"
    elif said.reason == "absent":
        why = "not on the bus: not started, ended, cut off, or denied to us"
    else:
        why = f"not on the bus any more ({said})"
    return ServiceRow(service, NOT_ANSWERING, why, None)


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
            shown = rows.setdefault(
                use.channel,
                ChannelRow(use.channel, producers=set(channel.producers), table_rate_hz=channel.rate_hz),
            )
            _add(shown, row.health, use, _rate(use, row.health, before))
    order = {name: place for place, name in enumerate(BY_NAME)}
    return tuple(sorted(rows.values(), key=lambda shown: order[shown.channel]))


def _add(shown: ChannelRow, health: Health, use: ChannelUse, rate_hz: float | None) -> None:
    if rate_hz is not None:
        shown.rate_hz = max(shown.rate_hz or 0.0, rate_hz)
    if use.age_s is not None:
        shown.youngest_s = use.age_s if shown.youngest_s is None else min(shown.youngest_s, use.age_s)
    if use.direction == "out":
        return
    heard_s = health.uptime_s if use.age_s is None else use.age_s
    # Of several workers one takes a message.
    shown.heard_s[health.service] = min(heard_s, shown.heard_s.get(health.service, heard_s))
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
            yield f"{service} has had no {row.channel} for {row.heard_s[service]:.0f} s, though it is being said"


def _notes(services: Sequence[ServiceRow]) -> tuple[str, ...]:
    """What stands out when the services are seen together."""
    said = [row.health for row in services if row.health is not None]
    notes = []
    for what, values in (
        ("version of Camber", {health.version for health in said}),
        ("versions of messages", {health.facts["messages"] for health in said if "messages" in health.facts}),
    ):
        if len(values) > 1:
            notes.append(f"not all have the same {what}: {', '.join(sorted(values))}")
    notes += [
        f"{health.service} logs at {health.log_level}" for health in said if health.log_level == "debug"
    ]
    return tuple(notes)

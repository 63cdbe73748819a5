"""Is a service alive, and what it has met; the ticks of a replay."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from camber.schemas.base import Count, Message, Model, Name, Sigma, Text


class Issue(Model):
    """Something a service met that an operator should know, counted."""

    code: Name
    text: Text
    count: Count


class HealthRequest(Message):
    """Asks a service how it is."""


class Health(Message):
    """Answered by the work loop itself: a loop that hangs answers nothing."""

    service: Name
    version: Name
    status: Literal["starting", "ok", "degraded", "failing"]
    uptime_s: Sigma
    loop_age_s: Sigma = Field(description="since the work loop last finished a round")
    issues: tuple[Issue, ...] = Field(default=(), max_length=64)
    counters: dict[Name, Count] = Field(default={}, max_length=256)


class Tick(Message):
    """Replay: everything up to `time_ns` has been published by the feeder."""

    index: Count
    participants: dict[Name, Annotated[int, Field(ge=-1, le=2**62)]] = Field(
        max_length=32,
        description="who is there → the last tick before this one on which it worked, −1: none yet",
    )
    working: tuple[Name, ...] = Field(max_length=32, description="who works on this tick")
    published: dict[Annotated[str, Field(max_length=64)], Count] = Field(
        max_length=64, description="by channel: how many messages the feeder has published so far"
    )
    last: bool = False


class Done(Message):
    """Replay: this service has done everything up to tick `index`; -1: it has joined the bus and listens."""

    service: Name
    index: Annotated[int, Field(ge=-1, le=2**62)]
    published: dict[Annotated[str, Field(max_length=64)], Count] = Field(max_length=64)
    heard: tuple[Name, ...] = Field(default=(), max_length=32)

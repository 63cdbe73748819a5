"""Is a service alive, and what it has met; the ticks of a replay."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from camber.schemas.base import Count, Message, Model, Name, Sigma, Text, TimeNs

LogLevel = Literal["debug", "info", "warning", "error"]


class Issue(Model):
    """Something a service met that an operator should know, counted."""

    code: Name
    text: Text
    count: Count
    last_time_ns: TimeNs | None = Field(None, description="when it was met last")


class ChannelUse(Model):
    """What went over one channel since a service started, as that service saw it."""

    channel: Name = Field(description="as in the table; `channel.service` where a channel has a key for each")
    direction: Literal["in", "out", "asked"] = Field(description="asked: questions that it was asked")
    messages: Count = Field(description="taken from its queue, refused ones among them; or published")
    age_s: Sigma | None = Field(description="since the last one; none: there was none yet")
    waiting: Count = Field(0, description="in its queue now")


class HealthRequest(Message):
    """Asks a service how it is."""


class Health(Message):
    """Answered by the work loop itself: a loop that hangs answers nothing."""

    service: Name
    version: Name
    status: Literal["starting", "ok", "degraded", "failing"]
    uptime_s: Sigma
    loop_age_s: Sigma = Field(description="since the work loop last finished a round")
    issues: tuple[Issue, ...] = Field((), max_length=64)
    counters: dict[Name, Count] = Field({}, max_length=256)
    channels: tuple[ChannelUse, ...] = Field((), max_length=64)
    gauges: dict[Name, Annotated[float, Field(ge=-1e15, le=1e15)]] = Field(
        {}, max_length=48, description="what goes up and down; names end in their unit, or count what waits"
    )
    facts: dict[Name, Text] = Field({}, max_length=16, description="what it works with: process, map_release")
    log_level: LogLevel | None = Field(None, description="least level that is logged now")


class LogLevelRequest(Message):
    """Asks a service to log more, or less, for a while."""

    level: LogLevel
    for_s: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        description="after which it falls back by itself to the level of its settings"
    )


class LogLevelReply(Message):
    """What is logged now."""

    service: Name
    level: LogLevel
    for_s: Sigma
    before: LogLevel


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
    heard: tuple[Name, ...] = Field((), max_length=32)

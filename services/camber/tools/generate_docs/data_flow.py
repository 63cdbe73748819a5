"""The page `docs/data-flow.md`: every channel and every message, from the table of channels."""

from __future__ import annotations

import importlib
import pkgutil
import re
import typing
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from pydantic.fields import FieldInfo

import camber.schemas
from camber.schemas.base import ArrayOf, Message, Model
from camber.schemas.channels import CHANNELS, Channel

_HEAD = """\
# How data flows

Made from `schemas/camber/schemas/channels.py` by `make docs`; do not edit.
Frames, heights, times and units are those of [conventions](conventions.md).

```
receiver, base ─▶ gnss ───────────────────── fix, velocity ────────────┐
sweeps, IMU ─▶ localizer ── prior pose with the road under it, match ─┬┤
                  ▲                                                   ▼│
   map_server (links, surfaces, points)              antenna_height ──▶├─▶ integrity ─▶ verdict, position
        ▲                                                              │       │  └──▶ gnss: other estimates (query)
        └──────── release ◀── map_update ◀── uploads ──────────────────│───────┘
motion (wheel speed, steering, yaw rate, stroke, ranging) ─▶ gnss, localizer, antenna_height, integrity
```
"""

_DELIVERY = """\
## What a delivery means

| delivery | reliability | when congested | how old it may be | used for |
|---|---|---|---|---|
| `small` | reliable between sessions that are connected | dropped, at high priority | consumers refuse what is older than the table says | fixes, poses, heights, verdicts |
| `bulk` | the newest only | dropped, at low priority | as above | sweeps |
| `query` | a question and its reply, at most 256 kB; no reply in time is an answer of its own, never a value | asker waits up to the age in the table | the reply must come within it | the map, other estimates, health |
| `upload` | kept in a durable outbox until the receipt says it is committed; the receiver keeps each once | waits and tries again | any age | fleet uploads |
| `fetch` | a question and its reply, at most 256 kB, at low priority; verified by signature and hash, asked again until it comes | asker waits up to the age in the table and tries again | the reply must come within it | releases of the map |
| `barrier` | reliable, and the sender waits | waits | none | replays only |

Every message carries the time of its measurement, a sequence number and its source. Consumers count and drop what is
too old, repeated or out of order. A **looped** channel is consumed one epoch after it was produced.
"""  # noqa: E501 rows of a table


def page() -> str:
    """Return the whole page."""
    queries = [channel for channel in CHANNELS if channel.reply is not None]
    streams = [channel for channel in CHANNELS if channel.reply is None]
    parts = [
        _HEAD,
        "## Published",
        _streams(streams),
        "## Asked",
        _queries(queries),
        _DELIVERY,
        "## Messages",
    ]
    on_the_bus = _models(message for channel in CHANNELS for message in (channel.message, channel.reply))
    in_files = [model for model in _models(_all_messages()) if model not in on_the_bus]
    parts += [_model(model) for model in on_the_bus]
    parts += ["## Messages in files", *(_model(model) for model in in_files)]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def _table(header: str, channels: list[Channel], columns: Callable[[Channel], list[str]]) -> str:
    rows = [
        f"| {c.name}{_note(c)} | `{c.key}` | {_link(c.message)} | {' | '.join(columns(c))} |"
        for c in channels
    ]
    return "\n".join([f"| {header} |", "|" + "---|" * (header.count("|") + 1), *rows])


def _streams(channels: list[Channel]) -> str:
    def columns(c: Channel) -> list[str]:
        consumers = ", ".join(c.consumers) or "recorders"
        delivery = f"`{c.delivery}`" + (", looped" if c.looped else "")
        late = "".join(f", {service} {_seconds(limit_s)}" for service, limit_s in c.late_s)
        return [", ".join(c.producers), consumers, _number(c.rate_hz), _seconds(c.max_age_s) + late, delivery]

    return _table("channel | key | message | from | to | Hz | oldest | delivery", channels, columns)


def _queries(channels: list[Channel]) -> str:
    def columns(c: Channel) -> list[str]:
        assert c.reply is not None
        services = [", ".join(c.producers), ", ".join(c.consumers)]
        return [_link(c.reply), *services, _number(c.rate_hz), _seconds(c.max_age_s), f"`{c.delivery}`"]

    header = "channel | key | question | reply | asked by | answered by | Hz | within | delivery"
    return _table(header, channels, columns)


def _note(channel: Channel) -> str:
    return f" ({channel.note})" if channel.note else ""


def _number(rate: float | None) -> str:
    return "as needed" if rate is None else f"{rate:g}"


def _seconds(age: float | None) -> str:
    return "any" if age is None else f"{age:g} s"


def _link(model: type[Model]) -> str:
    return f"[{model.__name__}](#{model.__name__.lower()})"


def _all_messages() -> Iterator[type[Message]]:
    """By module and there in the order of the file, whatever else has been imported."""
    for module in sorted(module.name for module in pkgutil.iter_modules(camber.schemas.__path__)):
        name = f"camber.schemas.{module}"
        for value in vars(importlib.import_module(name)).values():
            if isinstance(value, type) and issubclass(value, Message) and value.__module__ == name:
                yield value


def _models(messages: Iterable[type[Message] | None]) -> list[type[Model]]:
    """Messages in their order, each followed by its parts, each once."""
    models: dict[type[Model], None] = {}
    for message in messages:
        if message is not None and message is not Message:
            models |= dict.fromkeys([message, *_parts(message)])
    return list(models)


def _parts(model: type[Model]) -> list[type[Model]]:
    parts: list[type[Model]] = []
    for info in model.model_fields.values():
        for part in _leaves(info.annotation):
            if isinstance(part, type) and issubclass(part, Model):
                parts += [part, *_parts(part)]
    return parts


def _leaves(annotation: Any) -> list[Any]:
    arguments = typing.get_args(annotation)
    return [leaf for argument in arguments for leaf in _leaves(argument)] if arguments else [annotation]


def _model(model: type[Model]) -> str:
    title = f"### {model.__name__}"
    if issubclass(model, Message):
        title += f"\n\n`{model.schema_name()}`"
    text = re.sub(r"\n    ", "\n", model.__doc__ or "")
    rows = ["| field | type | unit | description |", "|---|---|---|---|"]
    for name, info in model.model_fields.items():
        rows.append(f"| `{name}` | {_type(info)} | {unit_of(name)} | {info.description or ''} |")
    return f"{title}\n\n{text.strip()}\n\n" + "\n".join(rows)


_UNITS = (
    ("_enu_m2_s2", "m²/s²"), ("_enu_m2", "m²"), ("_rad_s", "rad/s"), ("_enu_m_s", "m/s"), ("_m_s", "m/s"),
    ("_dbhz", "dB-Hz"), ("_cycles", "cycles"), ("_bytes", "bytes"), ("_year", "year"), ("_hz", "Hz"), ("_rad", "rad"),
    ("_999_m", "m"), ("time_ns", "ns of GPS time"), ("_seen_ns", "ns of GPS time"), ("_ns", "ns"),
    ("_east_north", "m²"), ("_m", "m"), ("_s", "s"), ("_c", "°C"),
)  # fmt: skip
"""Ending of a field's name and its unit; the first that fits counts."""


def unit_of(name: str) -> str:
    """The unit that the name of a field ends in, or nothing."""
    return next((unit for ending, unit in _UNITS if name.endswith(ending)), "")


def _type(info: FieldInfo) -> str:
    return _named(info.annotation, list(info.metadata)).replace("|", "\\|")


def _named(annotation: Any, metadata: list[Any]) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _named(arguments[0], [*metadata, *arguments[1:]])
    for item in metadata:
        if isinstance(item, ArrayOf):
            return f"{item.dtype.lstrip('<|')}[{', '.join(map(str, item.shape))}]"
    if origin is typing.Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin is tuple and Ellipsis in arguments:
        return f"list of {_named(arguments[0], [])}"
    if origin is tuple:
        return f"{len(arguments)} × {_named(arguments[0], [])}"
    if origin is dict:
        return f"{_named(arguments[0], [])} → {_named(arguments[1], [])}"
    if arguments:
        return " | ".join(_named(argument, metadata) for argument in arguments)
    if isinstance(annotation, type) and issubclass(annotation, Model):
        return _link(annotation)
    return "none" if annotation is type(None) else str(annotation.__name__)

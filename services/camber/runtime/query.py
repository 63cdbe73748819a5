"""Questions to services, from outside: for tools that come and go."""

from __future__ import annotations

import queue
import time
from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Self

import zenoh

from camber.runtime.bus import QueryFailed
from camber.runtime.session import BusError, open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, Channel
from camber.schemas.codec import DecodeError, decode, encode, encoding_of

_QUIET_S = 0.3  # chosen: silence after which the list is taken as complete


@dataclass
class _Present:
    """The keys of those who are there, after all changes so far."""

    keys: set[str] = field(default_factory=set)
    changes: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)

    def heed(self, *, quiet_s: float, within_s: float) -> None:
        """Apply changes until nothing came for `quiet_s`; who comes and goes all the time does not hold us."""
        until = time.monotonic() + within_s
        with suppress(queue.Empty):
            while (left_s := until - time.monotonic()) > 0.0:
                sample = self.changes.get(timeout=min(left_s, quiet_s))
                change = self.keys.add if sample.kind == zenoh.SampleKind.PUT else self.keys.discard
                change(str(sample.key_expr))


class QueryClient:
    """On the bus as a client, to ask again and again; use as a context. Raises BusError within about `timeout_s`."""

    def __init__(self, settings: ServiceSettings, *, timeout_s: float, source: str = "tools") -> None:
        self._timeout_s = timeout_s
        self._source = source
        self._entities: list[Any] = []
        self._watched: dict[str, _Present] = {}
        self._session = open_session(
            settings.zenoh.model_copy(update={"mode": "client"}), timeout_s=timeout_s
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def alive(self, vehicle: str = "*") -> dict[str, frozenset[str]]:
        """Who has declared to be there: vehicle → services. One that hangs still has, for some seconds or for ever."""
        # A subscriber for all vehicles serves for one: each that is declared while a service leaves could miss that.
        present = self._watched.get("*", self._watched.get(vehicle))
        if present is None:
            present = self._watched[vehicle] = self._watch(vehicle)
        else:
            present.heed(quiet_s=0.0, within_s=self._timeout_s)
        results: defaultdict[str, set[str]] = defaultdict(set)
        for alive in present.keys:
            _, _, name, service, _ = alive.split("/")
            if vehicle in ("*", name):
                results[name].add(service)
        return {name: frozenset(services) for name, services in results.items()}

    def _watch(self, vehicle: str) -> _Present:
        """Who is there from now on, as long as this session lasts."""
        key, liveliness = f"camber/v1/{vehicle}/*/alive", self._session.liveliness()
        present = _Present()
        # Declared once and kept: a session of Zenoh 1.10 that undeclares a subscriber misses departures at that moment,
        # and would report them to its next subscriber for ever.
        self._entities.append(liveliness.declare_subscriber(key, present.changes.put, history=True))
        # A router that is linked to another one answers half of such questions with nothing, so the subscriber is what
        # counts; but by the answer's end its notifications are on their way, however long that is.
        replies: Any = liveliness.get(key, timeout=min(self._timeout_s, 2.0))
        present.keys.update(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        present.heed(quiet_s=_QUIET_S, within_s=self._timeout_s)
        return present

    def ask(
        self, name: str, request: Message, vehicle: str, services: Iterable[str]
    ) -> dict[str, list[Any | QueryFailed]]:
        """Ask all these services at once over the query channel `name`: their replies, of several workers several.

        Where there is none, the list has the QueryFailed that says why. Within about `timeout_s`.
        """
        channel = BY_NAME[name]
        asked = {service: self._get(channel, request, vehicle, service) for service in services}
        return {service: _replies(channel, replies, service, vehicle) for service, replies in asked.items()}

    def _get(self, channel: Channel, request: Message, vehicle: str, service: str) -> Any:
        return self._session.get(
            channel.key_for(vehicle).replace("{service}", service),
            payload=encode(request, source=self._source),
            encoding=encoding_of(channel.message),
            timeout=self._timeout_s,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )


def _replies(channel: Channel, replies: Any, service: str, vehicle: str) -> list[Any | QueryFailed]:
    assert channel.reply is not None
    results: list[Any | QueryFailed] = []
    failure: QueryFailed | None = None
    for reply in replies:
        if reply.ok is not None:
            try:
                results.append(
                    decode(channel.reply, reply.ok.payload.to_bytes(), str(reply.ok.encoding)).message
                )
            except DecodeError as error:
                results.append(QueryFailed("invalid", str(error)))
        elif reply.err is not None:
            text = reply.err.payload.to_bytes()[:200].decode("utf-8", "replace")
            # Zenoh ends the wait of an unanswered question with an error reply that says so.
            failure = QueryFailed("timeout" if "timeout" in text.lower() else "refused", text)
    if failure is not None and (not results or failure.reason == "timeout"):  # also one worker among several
        results.append(failure)
    return results or [QueryFailed("absent", f"{service} of {vehicle} is not on the bus, or denied to us")]


def query_once(
    settings: ServiceSettings, name: str, request: Message, *, service: str, timeout_s: float
) -> Any:
    """Join the bus, ask `service` over the query channel `name`, leave; returns the reply.

    Raises BusError where the bus cannot be joined, QueryFailed where there is no usable answer, each within about
    `timeout_s`.
    """
    with QueryClient(settings, timeout_s=timeout_s) as asker:
        (replies,) = asker.ask(name, request, settings.vehicle, [service]).values()
    if isinstance(replies[0], QueryFailed):
        raise replies[0]
    return replies[0]


def check_router(settings: ServiceSettings, *, timeout_s: float) -> None:
    """Join the bus and leave it; raises BusError within about `timeout_s`."""
    with QueryClient(settings, timeout_s=timeout_s):
        pass


__all__ = ["BusError", "QueryClient", "QueryFailed", "check_router", "query_once"]

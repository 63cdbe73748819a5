"""What a service uses of `runtime.bus.Bus`, within one process: messages go to an object instead of a network."""

from __future__ import annotations

from collections import Counter
from typing import Any, Protocol

from camber.runtime.bus import QueryFailed
from camber.runtime.clock import ReplayClock
from camber.schemas.base import Message


class MessageSink(Protocol):
    """Where the messages, questions and issues of services in one process go."""

    clock: ReplayClock

    def publish(self, source: str, name: str, message: Message) -> None:
        """Take a message of a service on a channel."""

    def ask(self, name: str, request: Message) -> Any:
        """Return the answer on a query channel; raise QueryFailed where there is none."""

    def is_kept(self, name: str) -> bool:
        """Whether messages of this channel are of use to anybody."""

    def is_running(self, name: str) -> bool:
        """Whether a service is there."""

    def report(self, service: str, time_ns: int, code: str, text: str) -> None:
        """Take an issue."""


class LocalBus:
    """The bus of one service."""

    def __init__(self, sink: MessageSink, service: str) -> None:
        self.service = service
        self.counters: Counter[str] = Counter()
        self.now_ns = sink.clock.now_ns
        self.ask = sink.ask
        self.is_alive = sink.is_running
        self._sink = sink

    def publish(self, name: str, message: Message) -> None:
        """Hand a message on."""
        self._sink.publish(self.service, name, message)

    def has_subscriber(self, name: str) -> bool:
        """Whether a message would be of use."""
        return self._sink.is_kept(name)

    def ask_bytes(self, name: str, data: bytes) -> tuple[bytes, str]:
        """Raise QueryFailed: nobody takes uploads."""
        raise QueryFailed("absent", name)

    def issue(self, code: str, text: str) -> None:
        """Report an issue at the time of now."""
        self._sink.report(self.service, self.now_ns(), code, text)

    def count(self, name: str, n: int = 1) -> None:
        """Count what happens."""
        self.counters[name] += n

    def wake(self) -> None:
        """Do nothing: no service waits."""

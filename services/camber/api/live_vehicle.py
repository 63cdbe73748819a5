"""Verdicts and positions of a vehicle that drives now."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Generic, TypeVar

from camber.runtime.settings import ZenohSettings
from camber.runtime.subscription import Subscription
from camber.schemas.base import Message
from camber.schemas.integrity import Position, Verdict

M = TypeVar("M", bound=Message)
_POLL_S = 0.2
"""Chosen: how long an asynchronous iterator that is cancelled keeps its thread."""


def connect(
    vehicle: str = "vehicle",
    *,
    endpoints: Sequence[str] | None = None,
    replay: bool = False,
    zenoh: ZenohSettings | None = None,
) -> LiveVehicle:
    """Return a vehicle whose verdicts and positions can be iterated over.

    `endpoints` name the vehicle's router or any of its processes, as in `tcp/127.0.0.1:7447`; None: the default of all
    services. `zenoh` says more, such as certificates, and replaces them. `replay`: times are those of a drive, so that
    nothing is too old.
    """
    if zenoh is None:
        zenoh = ZenohSettings() if endpoints is None else ZenohSettings(connect=list(endpoints))
    return LiveVehicle(vehicle, zenoh, live=not replay)


class LiveVehicle:
    """Iterators over what one vehicle publishes. Each opens a session of its own; BusError where that fails."""

    def __init__(self, vehicle: str, zenoh: ZenohSettings, *, live: bool = True) -> None:
        self.vehicle = vehicle
        self._zenoh = zenoh
        self._live = live

    def positions(self) -> FreshMessages[Position]:
        """The newest position; then None when it has become too old and nothing newer has come."""
        return FreshMessages("position", self._subscription("position"))

    def verdicts(self) -> FreshMessages[Verdict]:
        """All verdicts in the order in which they come, with None as for positions."""
        return FreshMessages("verdict", self._subscription("verdict"))

    def _subscription(self, channel: str) -> Subscription:
        return Subscription(channel, vehicle=self.vehicle, zenoh=self._zenoh, live=self._live)


class FreshMessages(Generic[M]):
    """Messages of one channel, and None as soon as the last one is too old to be used.

    None comes once for each silence; what is known then is nothing. Use `for` or `async for`, not both, and in one
    thread; as a context it closes its session at the end.
    """

    def __init__(self, channel: str, subscription: Subscription) -> None:
        self._channel = channel
        self._subscription = subscription
        self._fresh_for_s: float | None = None

    def __enter__(self) -> FreshMessages[M]:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """End the session."""
        self._subscription.__exit__(None, None, None)

    def __iter__(self) -> Iterator[M | None]:
        return self

    def __next__(self) -> M | None:
        return self._taken(self._subscription.next(timeout_s=self._fresh_for_s))

    def __aiter__(self) -> AsyncIterator[M | None]:
        return self

    async def __anext__(self) -> M | None:
        loop = asyncio.get_running_loop()
        until_s = None if self._fresh_for_s is None else loop.time() + self._fresh_for_s
        while True:
            left_s = _POLL_S if until_s is None else min(max(until_s - loop.time(), 0.0), _POLL_S)
            message = await asyncio.to_thread(self._subscription.next, left_s)
            if message is not None or (until_s is not None and loop.time() >= until_s):
                return self._taken(message)

    def _taken(self, message: M | None) -> M | None:
        self._fresh_for_s = (
            None if message is None else self._subscription.fresh_for_s(self._channel, message)
        )
        return message

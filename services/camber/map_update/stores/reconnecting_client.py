"""A connection to a server for synchronous code, reconnected on demand after a failure.

Its event loop runs only during calls, so there is no thread and no lock.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

C = TypeVar("C")
T = TypeVar("T")

# Chosen: callers are not held up by a missing server, and are connected within 2 s of its return.
SHORTEST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 2.0


class ReconnectingClient(Generic[C]):
    """Connects with `connect`, disconnects with `disconnect`; after `broken` errors it reconnects.

    If the server is not reached, `error` is raised with the `name`, without credentials, and the cause; all calls then
    fail at once for 0.2 s to 2 s.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], Awaitable[C]],
        disconnect: Callable[[C], Awaitable[None]],
        broken: tuple[type[Exception], ...],
        error: type[Exception],
    ) -> None:
        self.name = name
        self._error = error
        self._connect, self._disconnect = connect, disconnect
        self._broken: tuple[type[Exception], ...] = (*broken, OSError, TimeoutError)
        self._loop = asyncio.new_event_loop()
        self._connection: C | None = None
        self._pause_s, self._closed_until_s, self._cause = SHORTEST_PAUSE_S, 0.0, ""

    def run(self, work: Callable[[C], Awaitable[T]]) -> T:
        """Return what `work` returns of a live connection. After an error there is no connection."""
        if self._loop.time() < self._closed_until_s:
            raise self._error(self._cause)
        try:
            return self._loop.run_until_complete(self._work(work))
        except self._broken as error:
            self._drop()
            self._cause = f"{self.name}: {str(error) or type(error).__name__}"
            self._closed_until_s = self._loop.time() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            raise self._error(self._cause) from error

    def close(self) -> None:
        """Disconnect."""
        self._drop()
        self._loop.close()

    async def _work(self, work: Callable[[C], Awaitable[T]]) -> T:
        if self._connection is None:
            self._connection = await self._connect()
            self._pause_s = SHORTEST_PAUSE_S
        return await work(self._connection)

    def _drop(self) -> None:
        if self._connection is not None:
            self._loop.run_until_complete(self._disconnect(self._connection))
            self._connection = None

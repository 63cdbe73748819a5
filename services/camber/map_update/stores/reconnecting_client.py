"""A connection to a server that may go away, for code without coroutines: made anew when it is next needed.

It has an event loop of its own, which runs while something is asked and not otherwise: no thread, no lock, nothing that
happens behind the caller's back.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

C = TypeVar("C")
T = TypeVar("T")

SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0


class ConnectionFailedError(RuntimeError):
    """It did not come about; the text names the server, without credentials, and what hinders it."""


class ReconnectingClient(Generic[C]):
    """Connects with `connect`, ends a connection with `end`; `broken` are the errors after which it is made anew.

    `name` stands before every complaint. After a failure everything fails at once for 0.2 s to 2 s, so that who asks
    again and again is not held up by a server that is not there.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], Awaitable[C]],
        end: Callable[[C], Awaitable[None]],
        broken: tuple[type[Exception], ...],
    ) -> None:
        self.name = name
        self._connect, self._end = connect, end
        self._broken: tuple[type[Exception], ...] = (*broken, OSError, TimeoutError)
        self._loop = asyncio.new_event_loop()
        self._connection: C | None = None
        self._pause_s, self._closed_until_s, self._why = SHORTEST_PAUSE_S, 0.0, ""

    def run(self, work: Callable[[C], Awaitable[T]]) -> T:
        """What `work` returns of a live connection. Raises LinkError, and then there is no connection."""
        if self._loop.time() < self._closed_until_s:
            raise ConnectionFailedError(self._why)
        try:
            return self._loop.run_until_complete(self._work(work))
        except self._broken as error:
            self._drop()
            self._why = f"{self.name}: {str(error) or type(error).__name__}"
            self._closed_until_s = self._loop.time() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            raise ConnectionFailedError(self._why) from error

    def close(self) -> None:
        """End the connection."""
        self._drop()
        self._loop.close()

    async def _work(self, work: Callable[[C], Awaitable[T]]) -> T:
        if self._connection is None:
            self._connection = await self._connect()
            self._pause_s = SHORTEST_PAUSE_S
        return await work(self._connection)

    def _drop(self) -> None:
        if self._connection is not None:
            self._loop.run_until_complete(self._end(self._connection))
            self._connection = None

"""Receive channels byte for byte, as a recorder does: nothing is decoded or refused, losses are counted."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple, Self

import zenoh

from camber.runtime.bus import arrival_of
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings
from camber.runtime.single_producer import SampleOrigin
from camber.schemas.channels import Channel

LIMIT_BYTES = 256 << 20  # chosen: half a minute of sweeps while the disk hangs


class RawSample(NamedTuple):
    """One message as it came; `arrival_ns` is this machine's clock, Unix nanoseconds. `arrival`: who published it."""

    channel: str
    key: str
    data: bytes
    arrival_ns: int
    arrival: SampleOrigin | None = None


class RawSubscription:
    """Queues what comes on some channels, up to `limit_bytes`; use as a context. Raises BusError.

    Beyond that the newest is dropped, and `dropped` counts it by channel.
    """

    def __init__(
        self,
        settings: ServiceSettings,
        channels: Sequence[Channel],
        *,
        timeout_s: float | None,
        limit_bytes: int = LIMIT_BYTES,
    ) -> None:
        self._limit_bytes = limit_bytes
        self.dropped: Counter[str] = Counter()
        self._bytes = 0
        self._items: deque[RawSample] = deque()
        self._lock = threading.Lock()
        self._session = open_session(settings.zenoh, timeout_s=timeout_s)
        self._subscribers = [self._subscribe(channel, settings.vehicle) for channel in channels]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop receiving; what is queued can still be taken."""
        self._session.close()  # type: ignore[no-untyped-call]

    def take(self) -> list[RawSample]:
        """What has come since this was last called."""
        with self._lock:
            items, self._items, self._bytes = list(self._items), deque(), 0
        return items

    def _subscribe(self, channel: Channel, vehicle: str) -> zenoh.Subscriber[None]:
        name = channel.name

        def arrived(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            with self._lock:
                if self._bytes + len(data) > self._limit_bytes:
                    self.dropped[name] += 1
                    return
                self._bytes += len(data)
                self._items.append(
                    RawSample(name, str(sample.key_expr), data, time.time_ns(), arrival=arrival_of(sample))
                )

        # In the thread that receives: it only queues.
        callback = zenoh.handlers.Callback(arrived, indirect=False)
        return self._session.declare_subscriber(channel.key_for(vehicle), callback)

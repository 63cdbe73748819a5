"""Subscribe to what Camber publishes: all that a consumer needs of the bus, in one class.

with Subscription("position", vehicle="car", connect=["tcp/127.0.0.1:7447"]) as subscription:
    position = subscription.next(timeout_s=1.0)  # None: nothing that may be used came in that time
"""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import zenoh

from camber.runtime.bus import arrival_of
from camber.runtime.clock import SystemClock
from camber.runtime.inbox import Inbox
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings
from camber.runtime.single_producer import SampleOrigin
from camber.schemas.channels import BY_NAME, Channel

_LIMIT = 4096  # messages waiting for a consumer; then the oldest goes

Sample = tuple[str, bytes, str, SampleOrigin]


class Subscription:
    """Hands out fresh, valid messages of some channels in order of arrival; use as a context, in one thread.

    `connect` names the router, or any process of the vehicle; None: the default of all services. `live=False` is for
    a replay, whose times are those of the drive: then nothing is refused for its age. `zenoh` is for the cloud, which
    is joined over TLS with a consumer's certificate. Raises BusError.
    """

    def __init__(
        self,
        *names: str,
        vehicle: str = "vehicle",
        connect: Sequence[str] | None = None,
        live: bool = True,
        zenoh: ZenohSettings | None = None,
    ) -> None:
        self._inboxes = {name: Inbox(channel=BY_NAME[name]) for name in names}
        self._live = live
        self._clock = SystemClock()
        self._waiting: queue.Queue[Sample] = queue.Queue(_LIMIT)
        if zenoh is None:
            zenoh = ZenohSettings() if connect is None else ZenohSettings(connect=list(connect))
        self._session = open_session(zenoh)
        self._subscribers = [self._subscribe(BY_NAME[name], vehicle) for name in names]

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *exc: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    @property
    def refused(self) -> Counter[str]:
        """How many messages were not handed out, by reason."""
        return sum((inbox.refused for inbox in self._inboxes.values()), Counter())

    def next(self, timeout_s: float | None = None) -> Any:
        """The next message that may be used, or None when none came for so long."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left_s = None if deadline is None else deadline - time.monotonic()
            try:
                name, data, encoding, arrival = self._waiting.get(left_s is None or left_s > 0.0, left_s)
            except queue.Empty:
                return None
            inbox = self._inboxes[name]
            received = inbox.open(data, encoding)
            if received is None:
                continue
            message = inbox.accept(
                received,
                self._clock.now_ns(),
                judge_age=self._live,
                arrival=arrival if self._live else None,
            )
            if message is not None:
                return message

    def fresh_for_s(self, name: str, message: Any) -> float | None:
        """For how long this message may still be used, by the table's age limit; None: there is no limit."""
        limit_s = BY_NAME[name].max_age_s
        if limit_s is None:
            return None
        age_s = (self._clock.now_ns() - message.time_ns) / 1e9 if self._live else 0.0
        return max(limit_s - age_s, 0.0)

    def _subscribe(self, channel: Channel, vehicle: str) -> zenoh.Subscriber[Any]:
        def arrived(sample: zenoh.Sample) -> None:
            item = (channel.name, sample.payload.to_bytes(), str(sample.encoding), arrival_of(sample))
            while True:
                try:
                    self._waiting.put_nowait(item)
                    return
                except queue.Full:
                    with suppress(queue.Empty):  # the oldest goes
                        self._waiting.get_nowait()

        return self._session.declare_subscriber(channel.key_for(vehicle), arrived)

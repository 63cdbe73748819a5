"""A session for keys that are not Camber's: bytes with attachments and liveliness tokens, for bridges."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh
import zenoh.ext

from camber.runtime.bus import direct
from camber.runtime.session import open_session
from camber.runtime.settings import ZenohSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachedBytes:
    """A message and its attachment; None: it has none."""

    data: bytes
    attachment: bytes | None


@dataclass(slots=True, kw_only=True)
class BoundedSubscription:
    """What has arrived on a key; beyond `limit` the oldest is dropped and counted."""

    limit: int
    dropped: int = 0
    _items: deque[AttachedBytes] = field(default_factory=deque)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self) -> list[AttachedBytes]:
        """Return what has arrived since this was last called."""
        with self._lock:
            items = list(self._items)
            self._items.clear()
        return items

    def put(self, item: AttachedBytes) -> None:
        """Queue a message; called in the receiving thread."""
        with self._lock:
            if len(self._items) == self.limit:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)


class RawSession:
    """A peer does not wait for its router, a client does; both try again for ever. Raises BusError.

    `wake` is called in the receiving thread after each message.
    """

    def __init__(self, settings: ZenohSettings, wake: Callable[[], None]) -> None:
        self._session = open_session(settings)
        self._wake = wake
        self._entities: list[Any] = []

    @property
    def session_id(self) -> str:
        """Zenoh's id of the session, hexadecimal."""
        return str(self._session.info.zid())

    def declare_token(self, key: str) -> None:
        """Declare a liveliness token until the session ends."""
        self._entities.append(self._session.liveliness().declare_token(key))

    def watch_tokens(self, key: str, changed: Callable[[str, bool], None]) -> None:
        """Call back, in the receiving thread, with the key of each token and whether it is there."""

        def arrived(sample: zenoh.Sample) -> None:
            changed(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._entities.append(self._session.liveliness().declare_subscriber(key, arrived, history=True))

    def declare_publisher(self, key: str) -> Callable[[bytes, bytes], None]:
        """Return the function that publishes a message and its attachment; dropped when congested."""
        publisher = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        self._entities.append(publisher)

        def put(data: bytes, attachment: bytes) -> None:
            publisher.put(data, attachment=attachment)

        return put

    def subscribe(self, key: str, *, limit: int, history: int = 0) -> BoundedSubscription:
        """Queue what arrives on a key, with up to `history` messages that each publisher has kept."""
        subscription = BoundedSubscription(limit=limit)

        def arrived(sample: zenoh.Sample) -> None:
            attachment = None if sample.attachment is None else sample.attachment.to_bytes()
            subscription.put(AttachedBytes(data=sample.payload.to_bytes(), attachment=attachment))
            self._wake()

        if history:
            kept = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=history)
            self._entities.append(
                zenoh.ext.declare_advanced_subscriber(self._session, key, direct(arrived), history=kept)
            )
        else:
            self._entities.append(self._session.declare_subscriber(key, direct(arrived)))
        return subscription

    def close(self) -> None:
        """Withdraw tokens, publishers and subscriptions, and end the session."""
        for entity in self._entities:
            entity.undeclare()
        self._session.close()  # type: ignore[no-untyped-call]

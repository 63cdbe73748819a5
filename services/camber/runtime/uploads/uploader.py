"""A service's uploads: encoded in the work loop, made durable and sent beside it, so that no disk delays a verdict."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from camber.runtime.uploads.outbox import Outbox, OutboxError, OutboxFull, Upload
from camber.runtime.uploads.sender import Reply, SenderThread
from camber.schemas.base import Message
from camber.schemas.codec import encode

_QUEUE_LIMIT = 10_000  # waiting for the disk; beyond it the newest is dropped, and `problems` says so
_GROUP = 1_000  # uploads that share one flush
_RETRY_S = 1.0  # a disk that is full or locked is tried again this often
_SILENT_S = 30.0  # a router or a store that is started again is back by then
_STORE_LIMIT_S = 1.0  # at the end, for the disk to take what was handed over

Problem = tuple[str, str]
"""A code and a text, as `Bus.issue` takes them."""


class Uploader:
    """Durable outbox and sender behind a queue. `put`, `problems` and `close` are called from the work loop."""

    def __init__(
        self, path: Path, *, vehicle: str, source: str, limit_bytes: int, ask: Callable[[str, bytes], Reply]
    ) -> None:
        self._source = source
        self._queue: queue.Queue[Upload | None] = queue.Queue(_QUEUE_LIMIT)
        self._ended = threading.Event()
        self._problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self._reported: Counter[str] = Counter()
        self._silence_reported_s = float("-inf")
        self._hindrance = ""
        self.outbox = Outbox(path, vehicle=vehicle, limit_bytes=limit_bytes)
        self.sender = SenderThread(self.outbox, ask)
        self._writer = threading.Thread(target=self._write, name="outbox", daemon=True)
        self._writer.start()

    def put(self, upload_id: str, channel: str, message: Message) -> None:
        """Hand over one upload; it is durable a moment later, and then it is never lost."""
        try:
            self._queue.put_nowait(Upload(upload_id, channel, encode(message, source=self._source)))
        except queue.Full:
            self._problems.put(("upload_dropped", f"{_QUEUE_LIMIT} uploads wait for the disk"))

    def waiting(self) -> dict[str, float]:
        """How many uploads wait for the disk, and for the cloud where that is known; needs no disk."""
        for_cloud = self.sender.sender.waiting
        known = {} if for_cloud is None else {"uploads_waiting": float(for_cloud)}
        return {"uploads_not_stored": float(self._queue.qsize()), **known}

    def problems(self) -> list[Problem]:
        """What has happened beside the work loop since this was last asked."""
        problems = [self._problems.get() for _ in range(self._problems.qsize())]
        sender = self.sender.sender
        for code, count, text in (
            ("outbox_damaged", int(self.outbox.notice is not None), self.outbox.notice or ""),
            ("upload_unanswered", sender.counts["failed"], sender.last_failure),
            ("upload_refused", sender.counts["refused"], f"{sender.counts['refused']} are dead letters"),
        ):
            if count > self._reported[code]:
                self._reported[code] = count
                problems.append((code, text))
        return [*problems, *self._silence()]

    def _silence(self) -> list[Problem]:
        """Report missing receipts: Zenoh does not report what access rules deny."""
        now_s = time.monotonic()
        silent_s = self.sender.sender.silent_s(now_s)
        if silent_s < _SILENT_S or now_s - self._silence_reported_s < _SILENT_S:
            return []
        self._silence_reported_s = now_s
        text = (
            f"no receipt for {silent_s:.0f} s: no link, no map_update, or our certificate is not that of this vehicle: "
            f"camber access check; {self.sender.sender.last_failure}"
        )
        return [("upload_not_acknowledged", text)]

    def close(self) -> None:
        """Make durable what was handed over, send no more."""
        self._ended.set()
        with suppress(queue.Full):
            self._queue.put_nowait(None)  # ends the writer's wait
        self._writer.join(_STORE_LIMIT_S)
        if self._writer.is_alive():
            self._problems.put(("upload_lost", f"the disk hangs; {self._queue.qsize()} uploads or more"))
        self.sender.close(0.3)
        self.outbox.close()

    def _write(self) -> None:
        while not (self._ended.is_set() and self._queue.empty()):
            group = [self._queue.get()]
            while not self._queue.empty() and len(group) < _GROUP:
                group.append(self._queue.get())
            lost = self._store([upload for upload in group if upload is not None])
            if lost:
                self._problems.put(("upload_lost", f"{lost} uploads: {self._hindrance}"))

    def _store(self, group: list[Upload]) -> int:
        """Make a group durable, however often that takes; returns how many the end of the service has given up."""
        while group:
            try:
                self.outbox.put_many(group)
                self.sender.wake()
                return 0
            except ValueError as error:  # one of them has the id of another upload
                if len(group) == 1:
                    self._problems.put(("upload_lost", str(error)))
                    return 0
                return sum(self._store([upload]) for upload in group)
            except OutboxError as error:
                if isinstance(error, OutboxFull) and len(group) > 1:  # for some of them there may be room
                    half = len(group) // 2
                    return self._store(group[:half]) + self._store(group[half:])
                self._hindrance = str(error)
                if not self._ended.is_set():
                    self._problems.put(("upload_not_stored", str(error)))
                if self._ended.wait(_RETRY_S):
                    return len(group)
        return 0

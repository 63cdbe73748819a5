"""A service's uploads: encoded in the work loop, made durable and sent beside it, so that no disk delays a verdict."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from pathlib import Path

from camber.runtime.outbox import Outbox, OutboxError, Upload
from camber.runtime.sender import Reply, SenderThread
from camber.schemas.base import Message
from camber.schemas.codec import encode

_QUEUE_LIMIT = 10_000  # waiting for the disk; beyond it the newest is dropped and counted


class Uploader:
    """Durable outbox and sender behind a queue. `report(code, text)` is called from the writer's thread."""

    def __init__(
        self,
        path: Path,
        *,
        source: str,
        limit_bytes: int,
        ask: Callable[[str, bytes], Reply],
        report: Callable[[str, str], None],
    ) -> None:
        self._source = source
        self._report = report
        self._queue: queue.Queue[Upload | None] = queue.Queue(_QUEUE_LIMIT)
        self.outbox = Outbox(path, limit_bytes=limit_bytes)
        self.sender = SenderThread(self.outbox, ask)
        self._writer = threading.Thread(target=self._write, name="outbox", daemon=True)
        self._writer.start()

    def put(self, upload_id: str, channel: str, message: Message) -> None:
        """Hand over one upload; it is durable a moment later, and then it is never lost."""
        try:
            self._queue.put_nowait(Upload(upload_id, channel, encode(message, source=self._source)))
        except queue.Full:
            self._report("upload_dropped", f"{_QUEUE_LIMIT} uploads wait for the disk")

    def close(self) -> None:
        """Make durable what was handed over, send no more."""
        self._queue.put(None)
        self._writer.join(1.0)
        self.sender.close(0.3)
        self.outbox.close()

    def _write(self) -> None:
        ended = False
        while not ended:
            uploads = [self._queue.get()]
            while not self._queue.empty() and len(uploads) < 1000:
                uploads.append(self._queue.get())
            ended = None in uploads
            try:
                self.outbox.put_many(upload for upload in uploads if upload is not None)
            except OutboxError as error:
                self._report("upload_not_stored", str(error))
            self.sender.wake()

"""Where the page's messages come from: the bus, or a recording; each fills a history in a thread of its own."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from camber.formats.drive.recording import RecordingError, read_recording
from camber.live.rows import CHANNELS, RowWriter
from camber.runtime.inbox import Inbox
from camber.runtime.raw_subscription import RawSample, RawSubscription
from camber.runtime.session import BusError
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME

_EVERY_S = 0.05  # chosen: half of a batch's period, so that a message waits no longer than a batch
_RETRY_S = 2.0  # chosen: a router that is started comes within some seconds
_MOST_MESSAGES = 200
"""Read in one round, of `_EVERY_S`. Chosen: thirty times what a vehicle at 20 Hz publishes; beyond it the oldest go."""
_LIMIT_BYTES = 32 << 20  # chosen: a flood must not take the machine's memory
State = Literal["waiting", "receiving", "reading", "complete", "failed"]


class ThreadedSource(ABC):
    """Reads in a thread of its own from `start` to `end`."""

    def __init__(self, name: str, state: State) -> None:
        self.state: State = state
        self.problem = ""
        self._left_out: Counter[str] = Counter()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def end(self) -> None:
        """Stop reading."""
        self._ended.set()
        self._thread.join(_RETRY_S)

    def left_out(self) -> dict[str, int]:
        """How many messages are not shown, by reason."""
        return dict(self._left_out)

    @abstractmethod
    def _run(self) -> None: ...


class ListeningSource(ThreadedSource):
    """Reads channels of the bus, and tries again where there is none; a flood of messages is left out, not read."""

    def __init__(
        self,
        name: str,
        settings: ServiceSettings,
        channels: Iterable[str],
        *,
        every_s: float,
        most_messages: int,
    ) -> None:
        super().__init__(name, "waiting")
        self._settings, self._channels = settings, [BY_NAME[channel] for channel in channels]
        self._every_s, self.most_messages = every_s, most_messages

    def take(self, samples: list[RawSample]) -> None:
        """Keep what the newest of these messages say."""
        dropped = max(len(samples) - self.most_messages, 0)
        self._left_out["flood"] += dropped
        for sample in samples[dropped:]:
            self._read(sample)

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self._listen()
            except BusError as error:
                self.state, self.problem = "waiting", str(error)
                self._ended.wait(_RETRY_S)

    def _listen(self) -> None:
        with RawSubscription(
            self._settings, self._channels, timeout_s=_RETRY_S, limit_bytes=_LIMIT_BYTES
        ) as listener:
            self.state, self.problem = "receiving", ""
            while not self._ended.wait(self._every_s):
                self.take(listener.take())
                self._left_out["flood"] += listener.dropped.total()
                listener.dropped.clear()

    @abstractmethod
    def _read(self, sample: RawSample) -> None: ...


class BusSource(ListeningSource):
    """Reads a vehicle's channels."""

    mode = "bus"

    def __init__(self, settings: ServiceSettings, rows: RowWriter) -> None:
        super().__init__("bus", settings, CHANNELS, every_s=_EVERY_S, most_messages=_MOST_MESSAGES)
        self._rows = rows
        self._inboxes = {name: Inbox(channel=BY_NAME[name]) for name in CHANNELS}

    def left_out(self) -> dict[str, int]:
        """How many messages are not shown, by reason."""
        refused = sum((inbox.refused for inbox in self._inboxes.values()), Counter[str]())
        return dict(refused + self._left_out)

    def _read(self, sample: RawSample) -> None:
        inbox = self._inboxes[sample.channel]
        received = inbox.open(sample.data, None)
        if received is None:
            return
        message = inbox.accept(received, time.time_ns(), judge_age=False, arrival=sample.arrival)
        if message is not None:
            self._rows.add(sample.channel, message)


class RecordingSource(ThreadedSource):
    """Reads a recording from its beginning to its end; what is damaged is left out, and named in `problem`."""

    mode = "recording"

    def __init__(self, path: Path, rows: RowWriter) -> None:
        super().__init__("recording", "reading")
        self.vehicle = ""
        self._path, self._rows = path, rows

    def _run(self) -> None:
        try:
            for item in read_recording(self._path, CHANNELS):
                if self._ended.is_set():
                    return
                self._take(item)
        except OSError as error:
            self.state, self.problem = "failed", f"{self._path.name}: {error.strerror or error}"
            return
        self.state = "complete"

    def _take(self, item: Any) -> None:
        if isinstance(item, RecordingError):
            self.problem = f"{self.problem}; {item}" if self.problem else str(item)
            self._left_out["damaged"] += 1
            return
        self._rows.add(item.channel, item.message)


Source = BusSource | RecordingSource

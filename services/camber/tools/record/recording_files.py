"""Rotation of recording files: a new one by size or duration, the oldest deleted, none on a nearly full disk."""

from __future__ import annotations

import contextlib
import itertools
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.foxglove.drawings import Drawing
from camber.geodesy.gps_time import UNIX_OF_GPS_EPOCH_NS, gps_ns_from_unix_ns
from camber.runtime.raw_subscription import RawSample

SUFFIX = ".mcap"
_FLUSH_AFTER_S = 10.0  # chosen: at most this much is lost to a power cut
_PART_BYTES = 16 << 20  # chosen: within what `Recorder` buffers between two ticks


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingLimits:
    """Size and duration of one file, size of all files kept, and free disk space to leave; None: no limit."""

    file_bytes: int | None = 1 << 30
    file_s: float | None = None
    kept_bytes: int | None = None
    free_bytes: int = 500 << 20


class RecordingFiles:
    """Writes raw messages into rotating files. After `problem` is set nothing is written and `dropped` counts the rest.

    File names are prefix, UTC of the first message, and number; existing files are never overwritten. Raises OSError
    where the first file cannot be created.
    """

    def __init__(
        self, folder: Path, prefix: str, limits: RecordingLimits, *, roads: Drawing | None = None
    ) -> None:
        self.written = self.dropped = self.malformed = 0
        self.problem: str | None = None
        self.by_channel: Counter[str] = Counter()
        self.files: list[Path] = []
        self._folder, self._prefix, self._limits = folder, prefix, limits
        self._roads = roads  # at the beginning of each file
        self._recorder: Recorder | None = None
        self._began_s = self._flushed_s = 0.0
        folder.mkdir(parents=True, exist_ok=True)

    def write(self, items: list[RawSample], now_s: float, *, lost: int = 0) -> None:
        """Write messages to the current file and note that `lost` were dropped before; `now_s` is monotonic."""
        for part in _parts(items):
            self._write(part, now_s, lost)
            lost = 0

    def _write(self, items: list[RawSample], now_s: float, lost: int) -> None:
        if self._recorder is not None and self._is_full(now_s):
            self.close()
        if self.problem is None and items and self._recorder is None:
            self._begin_file(items[0].arrival_ns, now_s)
        if self._recorder is None or self.problem is not None:
            self.dropped += len(items) + lost
            return
        self._recorder.dropped += lost
        for item in items:
            self._recorder.add(item.channel, item.data, key=item.key, arrival_ns=item.arrival_ns)
            self.by_channel[item.channel] += 1
        self._recorder.tick_done()
        if now_s - self._flushed_s >= _FLUSH_AFTER_S:
            self._recorder.flush()
            self._flushed_s = now_s
        if self._recorder.problem is not None:
            self.problem = f"{self._folder}: {self._recorder.problem}"
        else:
            self.problem = self._too_full()
        if self.problem is not None:
            self.close()

    def _begin_file(self, arrival_ns: int, now_s: float) -> None:
        self.problem = self._too_full()
        if self.problem is not None:
            return
        try:
            self._open_file(f"{self._prefix}-{datetime.fromtimestamp(arrival_ns / 1e9, UTC):%Y%m%dT%H%M%SZ}")
        except OSError as error:
            if not self.files:
                raise
            self.problem = f"{self._folder}: {error.strerror or error}"
            return
        if self._recorder is not None and self._roads is not None:
            # The clock of a machine that has just started may say 1970.
            time_ns = gps_ns_from_unix_ns(max(arrival_ns, UNIX_OF_GPS_EPOCH_NS))
            self._recorder.draw(self._roads, time_ns=time_ns, arrival_ns=arrival_ns)
        self._began_s = self._flushed_s = now_s
        self._delete_oldest()

    def _open_file(self, name: str) -> None:
        """Open the file of the next free number: another recorder may write into the same folder."""
        for number in itertools.count(len(self.files)):
            path = self._folder / f"{name}-{number:03d}{SUFFIX}"
            try:
                about = {"vehicle": self._prefix, "camber": version("camber")}
                self._recorder = Recorder(path, anew=True, about=about)
            except FileExistsError:
                continue
            self.files.append(path)
            return

    def _too_full(self) -> str | None:
        free_bytes, limit_bytes = shutil.disk_usage(self._folder).free, self._limits.free_bytes
        if free_bytes >= limit_bytes:
            return None
        return f"{self._folder}: {free_bytes >> 20} MB free on the disk, expected at least {limit_bytes >> 20} MB"

    def _is_full(self, now_s: float) -> bool:
        limits = self._limits
        too_long = limits.file_s is not None and now_s - self._began_s >= limits.file_s
        return too_long or (limits.file_bytes is not None and _size(self.files[-1]) >= limits.file_bytes)

    def close(self) -> None:
        """Close the current file."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        recorder.close()
        self.written += recorder.written
        self.dropped += recorder.dropped
        self.malformed += recorder.malformed
        if recorder.problem is not None and self.problem is None:
            self.problem = f"{self._folder}: {recorder.problem}"

    def _delete_oldest(self) -> None:
        """Delete the oldest files of this prefix, also of earlier runs, never the one being written."""
        if self._limits.kept_bytes is None:
            return
        pattern = re.compile(rf"{re.escape(self._prefix)}-\d{{8}}T\d{{6}}Z-\d{{3,}}{re.escape(SUFFIX)}")
        files = sorted(
            (p for p in self._folder.iterdir() if pattern.fullmatch(p.name) and p != self.files[-1]),
            key=lambda path: path.name,
        )
        total = sum(_size(path) for path in files)
        while files and total > self._limits.kept_bytes:
            oldest = files.pop(0)
            total -= _size(oldest)
            with contextlib.suppress(OSError):  # of another user: it stays and counts as deleted
                oldest.unlink()


def _parts(items: list[RawSample]) -> Iterator[list[RawSample]]:
    """Yield parts that a recorder accepts within one tick, in order of arrival; one empty part for no messages."""
    part: list[RawSample] = []
    part_bytes = 0
    for item in items:
        if part and part_bytes + len(item.data) > _PART_BYTES:
            yield part
            part, part_bytes = [], 0
        part.append(item)
        part_bytes += len(item.data)
    yield part


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0

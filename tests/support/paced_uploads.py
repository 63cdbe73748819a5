"""A vehicle that hands over uploads at a steady rate: `python -m support.paced_uploads ENDPOINT FOLDER RATE_HZ`.

By Camber's own durable outbox and sender. It goes on until the file `enough` is there and nothing waits any more, and
where it was after it was killed; `progress.json` says how many were handed over, wait, are dead letters.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.runtime.uploads.outbox import Outbox, Upload
from camber.runtime.uploads.sender import SenderThread
from camber.schemas.codec import encode
from camber.schemas.fleet import ElevationUpload
from support.live_vehicle import VEHICLE
from support.running import CLOCK, Processes, bus_of, wait_until
from support.upload_load import Load, upload

LIMIT_S = 240.0
_PERIOD_S = 0.05
_HOUR_NS = 3600 * 1_000_000_000


class PacedUploads:
    """The process `uploads` among others, and what of its uploads is stored, by the ids that `stored` returns."""

    def __init__(
        self,
        processes: Processes,
        endpoint: str,
        rate_hz: float,
        stored: Callable[[], list[str]],
        within: Sequence[str] = (),
    ) -> None:
        self.folder = processes.folder / "uploads"
        self.folder.mkdir()
        self._processes, self._stored = processes, stored
        command = ("-m", "support.paced_uploads", endpoint, self.folder, rate_hz)
        processes.start("uploads", *command, within=within)
        wait_until(lambda: self.put, timeout_s=LIMIT_S, why="nothing is handed over")

    @property
    def put(self) -> int:
        """How many have been handed over."""
        return _progress(self.folder)["put"]

    @property
    def begin_ns(self) -> int:
        """Upload number n is dated n ns later."""
        return _progress(self.folder)["time_ns"]

    @property
    def acknowledged(self) -> int:
        counts = _progress(self.folder)
        return counts["put"] - counts["waiting"]

    def wait_for(self, count: int) -> None:
        """Until so many are acknowledged."""
        wait_until(lambda: self.acknowledged >= count, timeout_s=LIMIT_S, why=f"{count} acknowledged uploads")

    def flow(self) -> float:
        """Seconds until all that had been handed over by now is acknowledged."""
        began_s = time.monotonic()
        self.wait_for(self.put)
        return time.monotonic() - began_s

    def finish(self) -> int:
        """Hand over no more; assert that each of all is stored once. Returns how many."""
        (self.folder / "enough").touch()
        self._processes.running.pop("uploads").wait(LIMIT_S)
        counts = _progress(self.folder)
        assert (counts["waiting"], counts["dead"]) == (0, 0)
        stored = [upload_id for upload_id in self._stored() if upload_id.startswith("u")]
        assert sorted(stored) == sorted(f"u{n}" for n in range(counts["put"]))
        return counts["put"]


def ids_stored(path: Path) -> list[str]:
    """Of all uploads in a store, each as often as it is stored."""
    with closing(SqliteStore(path)) as store:
        result = store.observations_after(0, 1_000_000)
    return [result.entries[heading].id for heading in result.entry_of.tolist()]


def paced_upload(n: int, time_ns: int) -> ElevationUpload:
    """Upload number n of those that begin at a time."""
    made = upload(Load("", "", 0, 0, records=0, time_ns=time_ns), n)
    assert isinstance(made, ElevationUpload)
    return made.model_copy(update={"vehicle": VEHICLE})


def _progress(folder: Path) -> dict[str, int]:
    """As it was last written."""
    path = folder / "progress.json"
    if not path.exists():
        return {"put": 0, "waiting": 0, "dead": 0, "time_ns": CLOCK.now_ns() - _HOUR_NS}
    return dict(json.loads(path.read_text()))


def main(endpoint: str, folder: Path, rate_hz: float) -> None:
    bus = bus_of(endpoint, "integrity", VEHICLE)
    outbox = Outbox(folder / "outbox.sqlite", vehicle="car", limit_bytes=64 << 20)
    sending = SenderThread(outbox, bus.ask_bytes)
    before = _progress(folder)
    put, time_ns = before["put"], before["time_ns"]
    began = time.monotonic() - put / rate_hz
    while True:
        enough = (folder / "enough").exists()
        due = put if enough else int((time.monotonic() - began) * rate_hz)
        if due > put:
            uploads = [paced_upload(n, time_ns) for n in range(put, due)]
            outbox.put_many(
                [Upload(each.upload_id, "upload", encode(each, source=VEHICLE)) for each in uploads]
            )
            put = due
            sending.wake()
        counts = outbox.counts()
        now = {"put": put, "waiting": counts.pending, "dead": counts.dead_letters, "time_ns": time_ns}
        fresh = folder / "progress.new"
        fresh.write_text(json.dumps(now))
        fresh.replace(folder / "progress.json")
        if enough and counts.pending == 0:
            break
        time.sleep(_PERIOD_S)
    sending.close()
    outbox.close()
    bus.close()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]))

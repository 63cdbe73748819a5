"""Vehicles that upload as fast as they are acknowledged: a process, for tests and benchmarks of the fleet's store.

    python upload_load.py '{"endpoint": "tcp/127.0.0.1:7447", "acknowledged": "acks", "first": 0, "until": 1000, …}'

Upload n is vehicle `car<n mod vehicles>`'s, a batch of `records` observations or a single one (`records` 0). It is sent
until a receipt says that it is stored, and its number is then written to the file `acknowledged` (int64). Nothing is
asked about what the file has already, so a process that is killed goes on where it was.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import Counter, deque
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import zenoh

from camber.runtime.clock import SystemClock
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import DecodeError, decode, encode, encoding_of
from camber.schemas.fleet import ElevationUpload, UploadBatch, UploadReceipt

TIMEOUT_S = 5.0
PAUSE_S = 0.25
DATUM, EPOCH_YEAR, MAP_VERSION = "WGS84", 2024.5, 1
CORNERS_RAD = ((0.61, 2.39), (0.9, 0.2), (-0.6, 2.6), (-0.4, -0.8))
"""Latitude and longitude where the vehicles of each quarter of the world drive: shards 1, 1 …, 3, 2."""


@dataclass(frozen=True)
class Load:
    endpoint: str
    acknowledged: str
    first: int
    until: int
    records: int = 64
    window: int = 128
    vehicles: int = 1000
    time_ns: int = 0
    everywhere: bool = False
    report_s: float = 1.0
    prepared: bool = False
    """Encoded before the first is sent: the rate is then that of the other side."""


def upload(load: Load, n: int) -> Message:
    """Upload number n. Its observations are those with a fix_id from n · max(records, 1) on."""
    vehicle = f"car{n % load.vehicles}"
    place = CORNERS_RAD[n % len(CORNERS_RAD) if load.everywhere else 0]
    if load.records == 0:
        return ElevationUpload(
            time_ns=load.time_ns + n,
            vehicle=vehicle,
            upload_id=f"u{n}",
            fix_id=n,
            fix_quality="fixed",
            verdict="confirmed",
            latitude_rad=place[0],
            longitude_rad=place[1],
            road_height_m=40.0 + n % 1000 * 1e-3,
            road_height_sigma_m=0.05,
            antenna_height_m=1.7,
            position_covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 4.0),
            datum=DATUM,
            epoch_year=EPOCH_YEAR,
            map_version=MAP_VERSION,
            surface_id=n % 5000,
        )
    k = np.arange(load.records)
    fix_id = n * load.records + k
    return UploadBatch(
        time_ns=load.time_ns + n,
        vehicle=vehicle,
        batch_id=f"u{n}",
        datum=DATUM,
        epoch_year=EPOCH_YEAR,
        map_version=MAP_VERSION,
        positioning_time_ns=load.time_ns + fix_id,
        fix_id=fix_id,
        fix_quality=np.zeros(load.records, np.uint8),
        surface_id=fix_id % 5000,
        verdict=np.zeros(load.records, np.uint8),
        latitude_rad=place[0] + k * 1e-7,
        longitude_rad=place[1] + k * 1e-7,
        horizontal_sigma_m=np.full(load.records, 0.03),
        road_height_m=40.0 + fix_id % 1000 * 1e-3,
        road_height_sigma_m=np.full(load.records, 0.05),
        antenna_height_m=np.full(load.records, 1.7),
    )


def acknowledged(path: Path) -> np.ndarray:
    """Numbers of the uploads that were; one that was being written when its process was killed counts not."""
    data = path.read_bytes() if path.exists() else b""
    return np.frombuffer(data[: len(data) // 8 * 8], np.int64)


class Uploading:
    """Keeps `window` uploads in flight; the callbacks of Zenoh only queue."""

    def __init__(self, load: Load) -> None:
        self.load = load
        self.counts: Counter[str] = Counter()
        self._channel = BY_NAME["upload" if load.records == 0 else "upload_batch"]
        self._prepared: dict[int, bytes] = {}
        self._answers: deque[tuple[int, bytes | None]] = deque()
        self._answered = threading.Event()
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([load.endpoint]))
        config.insert_json5("connect/timeout_ms", "-1")
        config.insert_json5("connect/exit_on_failure", "false")
        config.insert_json5("connect/retry", '{"period_init_ms": 100, "period_max_ms": 500}')
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = zenoh.open(config)

    def run(self) -> None:
        """Until all are acknowledged."""
        load, path = self.load, Path(self.load.acknowledged)
        done = acknowledged(path)
        if path.exists():
            os.truncate(path, 8 * len(done))
        left = np.setdiff1d(np.arange(load.first, load.until), done)
        ready, later, in_flight = deque(left.tolist()), deque[tuple[float, int]](), 0
        if load.prepared:
            self._prepared = {n: self._encoded(n) for n in ready}
        reported = began = time.monotonic()
        with path.open("ab", buffering=0) as file:
            while ready or later or in_flight:
                while later and later[0][0] <= time.monotonic():
                    ready.append(later.popleft()[1])
                while ready and in_flight < load.window:
                    self._ask(ready.popleft())
                    in_flight += 1
                self._answered.wait(0.05)
                self._answered.clear()
                stored = []
                while self._answers:
                    n, data = self._answers.popleft()
                    in_flight -= 1
                    if self._status(n, data) in ("stored", "duplicate"):
                        stored.append(n)
                    else:
                        later.append((time.monotonic() + PAUSE_S, n))
                if stored:
                    file.write(np.array(stored, np.int64).tobytes())
                now = time.monotonic()
                if now - reported >= load.report_s:
                    reported = now
                    print(json.dumps({"s": round(now - began, 2), **self.counts}), flush=True)
        print(json.dumps({"s": time.monotonic() - began, **self.counts}), flush=True)
        self._session.close()

    def _ask(self, n: int) -> None:
        answers: list[bytes] = []

        def reply(got: zenoh.Reply) -> None:
            if got.ok is not None:
                answers.append(got.ok.payload.to_bytes())

        def over() -> None:
            self._answers.append((n, answers[0] if answers else None))
            self._answered.set()

        self._session.get(
            self._channel.key_for(f"car{n % self.load.vehicles}"),
            zenoh.handlers.Callback(reply, over, indirect=False),
            payload=self._prepared[n] if self._prepared else self._encoded(n),
            encoding=encoding_of(self._channel.message),
            timeout=TIMEOUT_S,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def _encoded(self, n: int) -> bytes:
        return encode(upload(self.load, n), source="load")

    def _status(self, n: int, data: bytes | None) -> str:
        try:
            receipt = decode(UploadReceipt, data).message if data is not None else None
        except DecodeError:
            receipt = None
        status = "failed" if receipt is None or receipt.upload_id != f"u{n}" else receipt.status
        self.counts[status] += 1
        return status


def command(load: Load) -> list[str]:
    """This process."""
    return [__file__, json.dumps(asdict(load))]


if __name__ == "__main__":
    given = Load(**json.loads(sys.argv[1]))
    if given.time_ns == 0:
        given = Load(**{**asdict(given), "time_ns": SystemClock().now_ns() - 86_400 * 1_000_000_000})
    Uploading(given).run()

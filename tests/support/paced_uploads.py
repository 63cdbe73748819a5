"""A vehicle that hands over uploads at a steady rate: `python -m support.paced_uploads ENDPOINT FOLDER RATE_HZ`.

By Camber's own durable outbox and sender. It goes on until the file `enough` is there and nothing waits any more;
`progress.json` says how many were handed over, wait, are dead letters.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.uploads.outbox import Outbox, Upload
from camber.runtime.uploads.sender import SenderThread
from camber.schemas.codec import encode
from support.live_vehicle import VEHICLE
from support.upload_load import Load, upload

_PERIOD_S = 0.05


def progress(folder: Path) -> dict[str, int]:
    """As it was last written."""
    path = folder / "progress.json"
    result: dict[str, int] = (
        json.loads(path.read_text()) if path.exists() else {"put": 0, "waiting": 0, "dead": 0}
    )
    return result


def main(endpoint: str, folder: Path, rate_hz: float) -> None:
    zenoh = ZenohSettings(mode="client", connect=[endpoint])
    settings = ServiceSettings(vehicle=VEHICLE, zenoh=zenoh)
    bus = Bus(open_session(zenoh), settings, "integrity", SystemClock())
    outbox = Outbox(folder / "outbox.sqlite", limit_bytes=64 << 20)
    sending = SenderThread(outbox, bus.ask_bytes)
    load = Load(
        endpoint, "", 0, 0, records=0, vehicles=1, time_ns=SystemClock().now_ns() - 3600 * 1_000_000_000
    )
    began, put = time.monotonic(), 0
    while True:
        enough = (folder / "enough").exists()
        due = put if enough else int((time.monotonic() - began) * rate_hz)
        if due > put:
            uploads = (upload(load, n).model_copy(update={"vehicle": VEHICLE}) for n in range(put, due))
            outbox.put_many(
                [Upload(each.upload_id, "upload", encode(each, source=VEHICLE)) for each in uploads]
            )
            put = due
            sending.wake()
        counts = outbox.counts()
        fresh = folder / "progress.new"
        fresh.write_text(json.dumps({"put": put, "waiting": counts.pending, "dead": counts.dead_letters}))
        fresh.replace(folder / "progress.json")
        if enough and counts.pending == 0:
            break
        time.sleep(_PERIOD_S)
    sending.close()
    outbox.close()
    bus.close()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]))

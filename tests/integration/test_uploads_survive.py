"""Ten thousand uploads, real processes, real Zenoh; router, store and vehicle are killed again and again."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.runtime.clock import SystemClock

UPLOADS = 10_000
ROUNDS = 5
LIMIT_S = 240.0  # a hang ends the test; it takes about a tenth

VEHICLE = """
import sys
import time
from pathlib import Path

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.uploads.outbox import Outbox, Upload
from camber.runtime.uploads.sender import SenderThread
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.codec import encode
from camber.schemas.fleet import ElevationUpload

endpoint, path, first, until, time_ns = sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:6])


def upload(n):
    message = ElevationUpload(
        time_ns=time_ns + n, vehicle="car", upload_id=f"u{n}", fix_id=n, fix_quality="fixed", verdict="confirmed",
        latitude_rad=0.61, longitude_rad=2.39, road_height_m=40.0 + n * 1e-3, road_height_sigma_m=0.05,
        antenna_height_m=1.7, position_covariance_enu_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 4.0), datum="WGS84",
        epoch_year=2024.5, map_version=1, surface_id=n % 50,
    )
    return Upload(message.upload_id, "upload", encode(message, source="vehicle"))


zenoh = ZenohSettings(mode="client", connect=[endpoint])
settings = ServiceSettings(vehicle="car", zenoh=zenoh)
bus = Bus(open_session(zenoh), settings, "integrity", SystemClock())
outbox = Outbox(path, limit_bytes=64 << 20)
sending = SenderThread(outbox, bus.ask_bytes)
while True:
    if first < until:
        outbox.put_many([upload(n) for n in range(first, first + 50)])
        first += 50
        sending.wake()
    else:
        time.sleep(0.02)
    counts = outbox.counts()
    print(first, counts.pending, counts.dead_letters, flush=True)
"""


class Child:
    """A process of this test; ended with it, whatever happens."""

    def __init__(self, *command: str, **options) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        self.process = subprocess.Popen([sys.executable, *command], env=environment, text=True, **options)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


class Fleet:
    """Router, store and vehicle; each can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        with closing(socket.create_server(("127.0.0.1", 0))) as probe:
            self.endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        self.outbox = folder / "vehicle" / "outbox.sqlite"
        self.store = folder / "cloud" / "uploads.sqlite"
        self.config = folder / "map_update.toml"
        self.config.write_text(
            f'state_dir = "{self.store.parent}"\n[zenoh]\nmode = "client"\nconnect = ["{self.endpoint}"]\n'
        )
        self.time_ns = SystemClock().now_ns() - 3_600_000_000_000
        self.put = 0
        self.children: dict[str, Child] = {}

    def start(self, name: str) -> None:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        if name == "router":
            self.children[name] = Child("-m", "camber.cli", "router", "--listen", self.endpoint, **quiet)
        elif name == "map_update":
            self.children[name] = Child("-m", "camber.map_update", "--config", str(self.config), **quiet)
        else:
            arguments = (self.endpoint, str(self.outbox), str(self.put), str(UPLOADS), str(self.time_ns))
            self.children[name] = Child("-c", VEHICLE, *arguments, stdout=subprocess.PIPE)

    def restart(self, name: str) -> None:
        self.children[name].kill()
        self.start(name)

    def progress(self) -> int:
        """How many uploads the vehicle has put and knows to be stored, by its next word."""
        stdout = self.children["vehicle"].process.stdout
        assert stdout is not None
        line = stdout.readline()
        assert line, "the vehicle has ended"
        self.put, pending, dead_letters = (int(field) for field in line.split())
        assert dead_letters == 0
        return self.put - pending

    def wait_for(self, known: int, deadline_s: float) -> None:
        while self.progress() < known:
            assert time.monotonic() < deadline_s, (
                f"{known} of {UPLOADS} uploads were not acknowledged in time"
            )


@contextmanager
def running(folder: Path):
    with ExitStack() as ends:
        fleet = Fleet(folder)
        for name in ("router", "map_update", "vehicle"):
            fleet.start(name)
        ends.callback(lambda: [child.kill() for child in fleet.children.values()])
        yield fleet


@pytest.mark.slow
def test_every_upload_is_stored_once_through_kills_of_router_store_and_vehicle(tmp_path):
    deadline_s = time.monotonic() + LIMIT_S
    with running(tmp_path) as fleet:
        for kill in range(ROUNDS):
            fleet.wait_for(UPLOADS * (2 * kill + 1) // (2 * ROUNDS + 1), deadline_s)
            fleet.restart("map_update")
            fleet.wait_for(UPLOADS * (2 * kill + 2) // (2 * ROUNDS + 1), deadline_s)
            fleet.restart("router")
            if kill == ROUNDS // 2:
                fleet.restart("vehicle")
        fleet.wait_for(UPLOADS, deadline_s)
    with closing(SqliteStore(fleet.store)) as store:
        result = store.observations_after(0, 2 * UPLOADS)
    rows = sorted(
        (time_ns, result.entries[heading].id, surface_id, height_m)
        for heading, time_ns, surface_id, height_m in zip(
            result.entry_of.tolist(),
            *(result.rows[name].tolist() for name in ("time_ns", "surface_id", "road_height_m")),
            strict=True,
        )
    )
    assert rows == [(fleet.time_ns + n, f"u{n}", n % 50, 40.0 + n * 1e-3) for n in range(UPLOADS)]

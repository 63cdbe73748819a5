"""A vehicle as real processes on a real bus, fed the drive of `live_drive`, and a witness of their messages.

Processes are killed, frozen and started again by name, each in a network namespace if wanted (`support/link.py`).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.replay.short_drive import ANTENNA_HEIGHT_M
from camber.runtime.clock import SystemClock
from camber.runtime.query import QueryFailed, query_once
from camber.runtime.session import BusError
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.runtime.subscription import Subscription
from camber.schemas.channels import VEHICLE_SERVICES
from camber.schemas.gnss import Fix
from camber.schemas.health import Health, HealthRequest
from camber.schemas.integrity import Position, Verdict
from support.live_drive import TRUSTED, Known, count_verdicts, known_fixes, write_drive
from support.running import environment, wait_until

VEHICLE = "demo"
START_LIMIT_S = 180.0
_NS = 1_000_000_000
_CLOCK = SystemClock()
_KEPT = 200_000
_LONG_S = 10.0


@dataclass(frozen=True)
class ReceivedMessage:
    """A message with its time of arrival: of this machine's monotonic clock, and GPS time."""

    at_s: float
    at_ns: int
    message: Any


class Witness(threading.Thread):
    """Keeps every message of some channels, even those a consumer would refuse for their age, unless `live`."""

    def __init__(
        self,
        endpoint: str,
        known: Known,
        *,
        vehicle: str = VEHICLE,
        more: Sequence[str] = (),
        live: bool = False,
    ) -> None:
        super().__init__(daemon=True)
        self.known = known
        self.received: deque[ReceivedMessage] = deque(maxlen=_KEPT)
        self._ended = threading.Event()
        self._listener = Subscription(
            "fix", "verdict", "position", *more, vehicle=vehicle, connect=[endpoint], live=live
        )

    def run(self) -> None:
        with self._listener as listener:
            while not self._ended.is_set():
                message = listener.next(0.1)
                if message is not None:
                    self.received.append(ReceivedMessage(time.monotonic(), _CLOCK.now_ns(), message))

    def end(self) -> None:
        self._ended.set()
        self.join(10.0)

    def since(self, from_s: float, until_s: float = float("inf")) -> list[ReceivedMessage]:
        """Messages that arrived in that time."""
        return [item for item in list(self.received) if from_s <= item.at_s < until_s]

    def messages(self, kind: type, from_s: float = 0.0, until_s: float = float("inf")) -> list[Any]:
        """Messages of one class that arrived in that time."""
        return [item.message for item in self.since(from_s, until_s) if isinstance(item.message, kind)]

    def verdict_counts(self, from_s: float = 0.0, until_s: float = float("inf")) -> Counter[tuple[str, str]]:
        """How many verdicts of which kind, of right fixes and of wrong ones: (fix, verdict)."""
        return count_verdicts(self.known, self.messages(Fix), self.messages(Verdict, from_s, until_s))

    def wrong_but_trusted(
        self, from_s: float = 0.0, until_s: float = float("inf")
    ) -> Counter[tuple[str, str]]:
        """Trusted verdicts and usable positions that are not those of a right fix, counted by (fix, what trusts it)."""
        verdicts = self.verdict_counts(from_s, until_s)
        trusted = Counter({key: n for key, n in verdicts.items() if key[1] in TRUSTED and key[0] != "right"})
        for position in self.messages(Position, from_s, until_s):
            if position.usable and position.source == "rtk" and self.known.label(position) != "right":
                trusted[self.known.label(position), "usable position"] += 1
        return trusted

    def trusted_right(self, verdict: Any) -> bool:
        """Whether the verdict trusts a right fix."""
        return verdict.verdict in TRUSTED and self.known.label(verdict) == "right"

    def wait_for_trust(self, from_s: float, *, timeout_s: float = 60.0, dated_after_ns: int = 0) -> float:
        """Seconds from then until a right fix (measured after `dated_after_ns`) is confirmed."""

        def confirmed() -> float | None:
            for item in self.since(from_s):
                verdict = item.message
                is_later = isinstance(verdict, Verdict) and verdict.time_ns > dated_after_ns
                if is_later and self.trusted_right(verdict):
                    return item.at_s - from_s + 1e-9
            return None

        after_s = float(wait_until(confirmed, timeout_s=timeout_s, why="no right fix is confirmed"))
        if after_s > _LONG_S:
            verdicts = self.messages(Verdict, from_s, from_s + after_s)
            why = Counter((verdict.verdict, verdict.reason) for verdict in verdicts)
            print(f"nothing confirmed for {after_s:.1f} s: {dict(why)}", flush=True)
        return after_s


class Processes:
    """By name; each logs into the folder, and can be killed, frozen and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self._commands: dict[str, list[str]] = {}

    def start(self, name: str, *command: object, within: Sequence[str] = ()) -> None:
        """Run `within… python command…`; without a command, the one it was started with before."""
        if command:
            self._commands[name] = [*within, sys.executable, *map(str, command)]
        with self.log(name).open("ab") as log:
            self.running[name] = subprocess.Popen(
                self._commands[name],
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def kill(self, name: str) -> None:
        self.running[name].kill()
        self.running[name].wait()

    def freeze(self, name: str) -> None:
        os.kill(self.running[name].pid, signal.SIGSTOP)

    def resume(self, name: str) -> None:
        os.kill(self.running[name].pid, signal.SIGCONT)

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def ended(self) -> dict[str, str]:
        """Processes that have ended though they should run, with the end of their logs."""
        return {
            name: self.log(name).read_text()[-1500:]
            for name, process in self.running.items()
            if process.poll() is not None
        }

    def end(self) -> None:
        for process in self.running.values():
            if process.poll() is None:
                process.kill()
            process.wait()


class LiveVehicle(Processes):
    """Router, services of a vehicle (with map_update if wanted) and a drive fed to and fro without end.

    `endpoint` is the bus of services and witness; `within` goes before each of their commands. `settings` are lines
    of TOML by service. `state` holds a folder for each service. `router_file` is made by `camber access`.
    """

    def __init__(
        self,
        folder: Path,
        endpoint: str,
        *,
        services: Sequence[str] = VEHICLE_SERVICES,
        settings: dict[str, str] | None = None,
        router_file: Path | None = None,
        listens: Sequence[str] = (),
        within: Sequence[str] = (),
        launcher: dict[str, list[str]] | None = None,
    ) -> None:
        super().__init__(folder)
        self.endpoint = endpoint
        self.services = tuple(services)
        self.state = folder / "state"
        self.manifest = write_drive(folder / "drive")
        self.known = known_fixes(self.manifest)
        self._within, self._router_file, self._listens = within, router_file, (endpoint, *listens)
        self._launcher = launcher or {}
        self._settings = settings or {}

    def assemble(self) -> None:
        """Start all of it."""
        ends: list[object] = [word for endpoint in self._listens for word in ("--listen", endpoint)]
        if self._router_file is not None:
            ends += ["--config-file", self._router_file]
        self.start("router", "-m", "camber.cli", "router", *ends, within=self._within)
        for name in self.services:
            self.config(name).write_text(self._text(name))
            command = self._launcher.get(name, ["-m", "camber.cli", name])
            self.start(name, *command, "--config", self.config(name), within=self._within)
        self.feed()

    def feed(self) -> None:
        """Drive from the beginning, there and back."""
        self.start(
            "feed", "-m", "camber.cli", "feed", self.manifest, "--loop", "--connect", self.endpoint,
            "--vehicle", VEHICLE, within=self._within,
        )  # fmt: skip

    def config(self, name: str) -> Path:
        return self.folder / f"{name}.toml"

    def _text(self, name: str) -> str:
        usual = {
            "gnss": 'source = "bus"\nprotocol = "pos"\n',
            "map_server": f'release = "{self.manifest.parent / "map"}"\n',
            "antenna_height": f"fixed_height_m = {ANTENNA_HEIGHT_M}\nfixed_sigma_m = 0.02\n",
            "integrity": "upload_every_s = 1.0\n",
        }
        where = self.state / name
        where.mkdir(parents=True, exist_ok=True)
        head = f'vehicle = "{VEHICLE}"\nstate_dir = "{where}"\n'
        bus = f'[zenoh]\nmode = "client"\nconnect = ["{self.endpoint}"]\n'
        return f"{head}{self._settings.get(name, usual.get(name, ''))}{bus}"

    @contextmanager
    def witnessed(self, *more: str, live: bool = False) -> Iterator[Witness]:
        witness = Witness(self.endpoint, self.known, more=more, live=live)
        witness.start()
        try:
            yield witness
        finally:
            witness.end()

    def stored_ns(self) -> list[int]:
        """Times of the observations that its `map_update` holds, in order."""
        with closing(SqliteStore(self.state / "map_update" / "uploads.sqlite")) as store:
            stored = store.observations_after(0, 1_000_000)
        return sorted(int(t) for t in stored.rows["time_ns"].tolist())

    def health(self, service: str, *, timeout_s: float = 2.0) -> Health | None:
        """Health of a service; None where it does not answer."""
        settings = ServiceSettings(
            vehicle=VEHICLE, zenoh=ZenohSettings(mode="client", connect=[self.endpoint])
        )
        try:
            health: Health = query_once(
                settings,
                "health",
                HealthRequest(time_ns=_CLOCK.now_ns()),
                service=service,
                timeout_s=timeout_s,
            )
        except (QueryFailed, BusError):
            return None
        return health


@contextmanager
def driving(vehicle: LiveVehicle, *more: str, live: bool = False) -> Iterator[Witness]:
    """A driving vehicle, from its first confirmed right fix on; all its processes are ended on leaving."""
    try:
        vehicle.assemble()
        with vehicle.witnessed(*more, live=live) as witness:
            try:
                witness.wait_for_trust(time.monotonic(), timeout_s=START_LIMIT_S)
            except AssertionError as error:
                why = Counter(verdict.reason for verdict in witness.messages(Verdict))
                raise AssertionError(f"{error}; {dict(why)}; {vehicle.ended()}") from None
            yield witness
    finally:
        vehicle.end()


def now_ns() -> int:
    """GPS time."""
    return _CLOCK.now_ns()


def wait_s(seconds: float, while_: Callable[[], bool] = lambda: True) -> None:
    """Let the drive go on."""
    until = time.monotonic() + seconds
    while time.monotonic() < until and while_():
        time.sleep(0.05)

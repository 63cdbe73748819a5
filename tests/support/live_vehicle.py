"""A vehicle as real processes on a real bus, fed the drive of `live_drive`, and a witness of their messages.

Processes are killed, frozen and started again by name, each in a network namespace if wanted (`support/link.py`).
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.map_update.stores.sqlite_store import SqliteStore
from camber.replay.short_drive import ANTENNA_HEIGHT_M
from camber.runtime.query import QueryFailed
from camber.runtime.session import BusError
from camber.runtime.subscription import Subscription
from camber.schemas.channels import VEHICLE_SERVICES
from camber.schemas.gnss import Fix
from camber.schemas.health import Health
from camber.schemas.integrity import Position, Verdict
from support.live_drive import TRUSTED, Known, count_verdicts, known_fixes, write_drive
from support.running import CLOCK, Processes, health_of, settings_file, wait_until

VEHICLE = "demo"
START_LIMIT_S = 180.0
_KEPT = 200_000
_LONG_S = 10.0


@dataclass(frozen=True)
class ReceivedMessage:
    """A message with its time of arrival, of this machine's monotonic clock."""

    at_s: float
    message: Any


class Witness(threading.Thread):
    """Keeps every fix, verdict and position, even those a consumer would refuse for their age, unless `live`."""

    def __init__(self, endpoint: str, known: Known, *, live: bool = False) -> None:
        super().__init__(daemon=True)
        self.known = known
        self.received: deque[ReceivedMessage] = deque(maxlen=_KEPT)
        self._ended = threading.Event()
        channels = ("fix", "verdict", "position")
        self._listener = Subscription(*channels, vehicle=VEHICLE, connect=[endpoint], live=live)

    def run(self) -> None:
        with self._listener as listener:
            while not self._ended.is_set():
                message = listener.next(0.1)
                if message is not None:
                    self.received.append(ReceivedMessage(time.monotonic(), message))

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

    def wait_for_trust(self, from_s: float, *, timeout_s: float = 60.0, dated_after_ns: int = 0) -> float:
        """Seconds from then until a right fix (measured after `dated_after_ns`) is confirmed."""

        def confirmed() -> float | None:
            for item in self.since(from_s):
                verdict = item.message
                is_later = isinstance(verdict, Verdict) and verdict.time_ns > dated_after_ns
                if is_later and verdict.verdict in TRUSTED and self.known.label(verdict) == "right":
                    return item.at_s - from_s + 1e-9
            return None

        after_s = float(wait_until(confirmed, timeout_s=timeout_s, why="no right fix is confirmed"))
        if after_s > _LONG_S:
            verdicts = self.messages(Verdict, from_s, from_s + after_s)
            why = Counter((verdict.verdict, verdict.reason) for verdict in verdicts)
            print(f"nothing confirmed for {after_s:.1f} s: {dict(why)}", flush=True)
        return after_s

    def wait_for_new_trust(self, *, timeout_s: float) -> float:
        """Seconds from now until a right fix that is measured from now on is confirmed."""
        return self.wait_for_trust(time.monotonic(), timeout_s=timeout_s, dated_after_ns=now_ns())


class LiveVehicle(Processes):
    """Router, services of a vehicle (with map_update if wanted) and a drive fed to and fro without end.

    `endpoint` is the bus of services and witness; `within` goes before each of their commands. `state` holds a folder
    for each service. `router_file` is made by `camber access`.
    """

    def __init__(
        self,
        folder: Path,
        endpoint: str,
        *,
        services: Sequence[str] = VEHICLE_SERVICES,
        router_file: Path | None = None,
        within: Sequence[str] = (),
        launcher: dict[str, list[str]] | None = None,
    ) -> None:
        super().__init__(folder)
        self.endpoint = endpoint
        self.services = tuple(services)
        self.state = folder / "state"
        self.manifest = write_drive(folder / "drive")
        self.known = known_fixes(self.manifest)
        self._within, self._router_file = within, router_file
        self._launcher = launcher or {}

    def assemble(self) -> None:
        """Start all of it; what is fed is the drive from the beginning, there and back."""
        rules = () if self._router_file is None else ("--config-file", self._router_file)
        router = ("router", "--listen", self.endpoint, *rules)
        self.start("router", "-m", "camber.cli", *router, within=self._within)
        for name in self.services:
            self._write_config(name)
            command = self._launcher.get(name, ["-m", "camber.cli", name])
            self.start(name, *command, "--config", self.config(name), within=self._within)
        feed = ("feed", self.manifest, "--loop", "--connect", self.endpoint, "--vehicle", VEHICLE)
        self.start("feed", "-m", "camber.cli", *feed, within=self._within)

    def config(self, name: str) -> Path:
        return self.folder / f"{name}.toml"

    def _write_config(self, name: str) -> None:
        settings = {
            "gnss": ('source = "bus"', 'protocol = "pos"'),
            "map_server": (f'release = "{self.manifest.parent / "map"}"',),
            "antenna_height": (f"fixed_height_m = {ANTENNA_HEIGHT_M}", "fixed_sigma_m = 0.02"),
            "integrity": ("upload_every_s = 1.0",),
        }
        where = self.state / name
        where.mkdir(parents=True, exist_ok=True)
        lines = (f'state_dir = "{where}"', *settings.get(name, ()))
        settings_file(self.config(name), self.endpoint, *lines, vehicle=VEHICLE)

    def stored_ns(self) -> list[int]:
        """Times of the observations that its `map_update` holds, in order."""
        with closing(SqliteStore(self.state / "map_update" / "uploads.sqlite")) as store:
            stored = store.observations_after(0, 1_000_000)
        return sorted(int(t) for t in stored.rows["time_ns"].tolist())

    def health(self, service: str, *, timeout_s: float = 2.0) -> Health | None:
        """Health of a service; None where it does not answer."""
        try:
            return health_of(self.endpoint, service, VEHICLE, timeout_s=timeout_s)
        except (QueryFailed, BusError):
            return None


@contextmanager
def driving(vehicle: LiveVehicle, *, live: bool = False) -> Iterator[Witness]:
    """A driving vehicle, from its first confirmed right fix on; all its processes are ended on leaving."""
    with ExitStack() as ends:
        ends.callback(vehicle.end)
        vehicle.assemble()
        witness = Witness(vehicle.endpoint, vehicle.known, live=live)
        witness.start()
        ends.callback(witness.end)
        try:
            witness.wait_for_trust(time.monotonic(), timeout_s=START_LIMIT_S)
        except AssertionError as error:
            why = Counter(verdict.reason for verdict in witness.messages(Verdict))
            raise AssertionError(f"{error}; {dict(why)}; {vehicle.ended()}") from None
        yield witness


def now_ns() -> int:
    """GPS time."""
    return CLOCK.now_ns()

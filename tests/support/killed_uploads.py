"""Uploads through receiving workers, JetStream and storing workers into PostgreSQL, while all of them are killed.

    PYTHONPATH=tests python -m support.killed_uploads --uploads 1000000 --kills 10 --seed 1

Everything is a real process: vehicles that upload (`upload_load.py`), `camber map_update` in the roles receive and
store, nats-server and PostgreSQL. Each of map_update (either role), PostgreSQL and NATS is killed (SIGKILL) `--kills`
times, at moments drawn at random. In the end every upload is acknowledged, and what the databases hold is compared
with it.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camber.runtime.settings import ZenohSettings
from support.databases import NatsServer, PostgresServer, Server, lasting_port
from support.running import Processes, environment, settings_file
from support.upload_load import Load, acknowledged, command

STALLED_S = 120.0


@dataclass(frozen=True)
class Outcome:
    """Result of a run; `problems` is empty where acknowledged is what is stored, each once."""

    acknowledged: int
    stored: int
    observations: int
    kills: dict[str, int]
    seconds: float
    problems: list[str]


class Fleet(Processes):
    """The processes; each can be killed and started again by its name."""

    def __init__(self, folder: Path, shards: list[str]) -> None:
        super().__init__(folder)
        self.postgres, nats = PostgresServer(), NatsServer()
        self.servers: dict[str, Server] = {"postgres": self.postgres, "nats": nats}
        self.endpoint = f"tcp/127.0.0.1:{lasting_port()}"
        for server in self.servers.values():
            server.start()
        self.addresses = {shard: self.postgres.new_database() for shard in shards}
        common = (f'queue = "{nats.address}"', f"shards = {json.dumps(shards)}", 'log_level = "error"')
        router = ZenohSettings(mode="router", connect=[], listen=[self.endpoint])
        self._add("receive", router, 'role = "receive"', *common)
        for shard, address in self.addresses.items():
            lines = ('role = "store"', f'shard = "{shard}"', f'store = "{address}"', *common)
            self._add(f"store{shard}", self.endpoint, *lines)

    def _add(self, name: str, joining: str | ZenohSettings, *lines: str) -> None:
        config = settings_file(self.folder / f"{name}.toml", joining, *lines, vehicle=name)
        self.start(name, "-m", "camber.map_update", "--config", config)

    def start(self, name: str, *command: object, within: Sequence[str] = ()) -> None:
        if name in self.servers:
            self.servers[name].start()
        else:
            super().start(name, *command, within=within)

    def kill(self, name: str) -> None:
        if name in self.servers:
            self.servers[name].end()
        else:
            super().kill(name)

    def end(self) -> None:
        super().end()
        for server in self.servers.values():
            server.remove()

    def logs(self) -> str:
        """The ends of the workers' logs."""
        return "\n".join(f"{name}: {self.log(name).read_text()[-1500:]}" for name in self.running)

    def rows(self, query: str) -> list[list[tuple[object, ...]]]:
        """Of a query, in the database of each shard."""
        return [
            [
                tuple(row)
                for row in self.postgres.execute(f"SET search_path TO {address.rpartition('=')[2]}", query)
            ]
            for address in self.addresses.values()
        ]


def run(
    folder: Path,
    *,
    uploads: int,
    kills: int,
    seed: int,
    records: int = 0,
    shards: list[str],
    limit_s: float = math.inf,
    say: bool = False,
) -> Outcome:
    """Upload, kill, and compare. After `limit_s` the vehicles end, and what is acknowledged by then is compared."""
    rng = random.Random(seed)
    began = time.monotonic()
    with ExitStack() as ends:
        fleet = Fleet(folder, shards)
        ends.callback(fleet.end)
        victims = [name for name in ("map_update", "postgres", "nats") for _ in range(kills)]
        rng.shuffle(victims)
        moments = sorted(rng.uniform(0.02, 0.98) for _ in victims)  # parts of the way, in uploads or in time
        path = folder / "acknowledged"
        load = Load(fleet.endpoint, str(path), 0, uploads, records, window=500, everywhere=len(shards) > 1)
        vehicles = subprocess.Popen(
            [sys.executable, *command(load)],
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        ends.callback(vehicles.wait)
        ends.callback(vehicles.kill)
        killed: dict[str, int] = {}
        known, moved = 0, time.monotonic()
        while vehicles.poll() is None:
            time.sleep(0.02)
            now = path.stat().st_size // 8 if path.exists() else 0
            if now > known:
                known, moved = now, time.monotonic()
            ended = [name for name, worker in fleet.running.items() if worker.poll() is not None]
            if time.monotonic() - moved > STALLED_S:
                raise AssertionError(f"{known} of {uploads} acknowledged, and no more\n{fleet.logs()}")
            for name in ended:  # as a supervisor does
                killed[f"{name} ended"] = killed.get(f"{name} ended", 0) + 1
                fleet.start(name)
            spent = (time.monotonic() - began) / limit_s
            if spent > 1.0:
                vehicles.kill()
            if not moments or max(now / uploads, spent) < moments[0]:
                continue
            victim = victims.pop()
            if victim == "map_update":
                victim = rng.choice(list(fleet.running))
            moments.pop(0)
            time.sleep(rng.uniform(0.0, 0.3))
            fleet.kill(victim)
            killed[victim] = killed.get(victim, 0) + 1
            if say:
                print(f"{time.monotonic() - began:7.1f} s  {now:8} acknowledged  {victim} killed", flush=True)
            time.sleep(rng.uniform(0.0, 1.0))
            fleet.start(victim)
        for name in fleet.running:  # what was under way is not stored between two questions
            fleet.kill(name)
        return _compared(fleet, path, uploads, max(records, 1), killed, began, whole=vehicles.returncode == 0)


def _compared(
    fleet: Fleet,
    path: Path,
    uploads: int,
    records: int,
    killed: dict[str, int],
    began: float,
    *,
    whole: bool,
) -> Outcome:
    known = acknowledged(path)
    ledger = [row for rows in fleet.rows("SELECT id, vehicle, records FROM contribution") for row in rows]
    stored = np.array([int(str(name)[1:]) for name, _, _ in ledger], np.int64)
    of_rows = [
        rows[0]
        for rows in fleet.rows(
            "SELECT count(*), count(DISTINCT fix_id), count(*) FILTER (WHERE number IS NULL)"
            " FROM observation LEFT JOIN contribution ON contribution = number"
        )
    ]
    total, distinct, orphans = (sum(int(str(row[k])) for row in of_rows) for k in range(3))
    checks = {
        "an upload was acknowledged that is not stored": np.isin(known, stored).all(),
        "not every upload was acknowledged": not whole or len(np.unique(known)) == uploads,
        "an upload is stored more than once": len(np.unique(stored)) == len(stored),
        "an upload is stored that nobody sent": set(stored.tolist()) <= set(range(uploads)),
        "an observation is stored more than once": distinct == total,
        "observations are missing or too many": total == records * len(stored),
        "observations without their contribution": orphans == 0,
        "the number of records in the ledger is wrong": all(row[2] == records for row in ledger),
    }
    problems = [problem for problem, right in checks.items() if not right]
    return Outcome(len(known), len(stored), total, killed, round(time.monotonic() - began, 1), problems)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--uploads", type=int, default=1_000_000)
    parser.add_argument("--kills", type=int, default=10, help="of map_update, of PostgreSQL and of NATS each")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(1 << 31))
    parser.add_argument("--minutes", type=float, default=math.inf, help="end after so long, all kills done")
    parser.add_argument("--records", type=int, default=0, help="observations of a batch; 0: single uploads")
    args = parser.parse_args()
    print(f"seed {args.seed}", flush=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and with it what it has started
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        result = run(
            Path(name),
            uploads=args.uploads,
            kills=args.kills,
            seed=args.seed,
            records=args.records,
            shards=[""],
            limit_s=60.0 * args.minutes,
            say=True,
        )
    print(result)
    return 1 if result.problems else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""The fleet's store beside the bare database, and uploads from end to end, committed and acknowledged.

PostgreSQL and NATS are Debian's, started on the loopback, flushing as they should. All rates are of one run, medians of
five rounds in turn; what vehicles send are batches of 64 records, as the judge makes them. Where a server is not
installed its figures are left out.
"""

from __future__ import annotations

import asyncio
import json
import os
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from figure import Figure, higher

from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import Store
from support.contributions import NOW_NS, random_batch, take_all
from support.databases import NATS, POSTGRES, NatsServer, PostgresServer, lasting_port, running
from support.running import environment, wait_until
from support.upload_load import Load, command

RECORDS, GROUP, GROUPS, ROUNDS = 64, 256, 6, 5
UPLOADS = int(os.environ.get("CAMBER_BENCH_UPLOADS", "6000"))
_COLUMNS = OBSERVATION.names or ()


def groups(first: int) -> list[list[Contribution]]:
    """Groups of batches of a vehicle each, no two alike."""
    rng = np.random.default_rng(first)
    batch = random_batch("b", RECORDS, rng)
    return [
        [
            replace(
                batch, vehicle=f"car{k % 50}", id=f"{first}.{k}.{n}", observations=batch.observations.copy()
            )
            for n in range(GROUP)
        ]
        for k in range(GROUPS)
    ]


def work_of(
    prepare: Callable[[list[Contribution]], Any], send: Callable[[Any], object]
) -> Callable[[int], float]:
    """Given the number of its round, sends all groups, prepared before, and returns its seconds."""

    def work(k: int) -> float:
        prepared = [prepare(group) for group in groups(k)]
        began = time.perf_counter()
        for group in prepared:
            send(group)
        return time.perf_counter() - began

    return work


def in_turn(*works: Callable[[int], float]) -> list[float]:
    """Medians of records/s of rounds in turn; each is given its number and returns its seconds."""
    took = [[work(k) for work in works] for k in range(ROUNDS)]
    return [RECORDS * GROUP * GROUPS / statistics.median(seconds) for seconds in zip(*took, strict=True)]


def storing(store: Store) -> Callable[[int], float]:
    def commit(group: list[Contribution]) -> None:
        assert all(o.status == "stored" for o in store.commit(group, NOW_NS, take_all))

    return work_of(list, commit)


def rows_of(group: list[Contribution]) -> np.ndarray:
    return np.concatenate([contribution.observations for contribution in group])


def sqlite_figures(folder: Path) -> list[Figure]:
    db = sqlite3.connect(folder / "raw.sqlite", isolation_level=None)
    db.execute("PRAGMA journal_mode = WAL")
    db.execute("PRAGMA synchronous = FULL")
    types = (f"{name} {'REAL' if OBSERVATION[name].kind == 'f' else 'INTEGER'} NOT NULL" for name in _COLUMNS)
    db.execute(f"CREATE TABLE observation ({', '.join(types)})")

    def insert(rows: list[Any]) -> None:
        db.execute("BEGIN IMMEDIATE")
        db.executemany(f"INSERT INTO observation VALUES (?{', ?' * (len(_COLUMNS) - 1)})", rows)
        db.execute("COMMIT")

    with closing(SqliteStore(folder / "uploads.sqlite")) as store, closing(db):
        ours, peer = in_turn(storing(store), work_of(lambda group: rows_of(group).tolist(), insert))
    name = "executemany of the same rows into a plain table, as durable"
    return [higher("uploads into SQLite with their ledger", "records/s", ours, peer, name)]


def binary_copy(rows: np.ndarray) -> memoryview:
    """Rows of OBSERVATION (n,) as PostgreSQL's documentation of COPY has its binary format, numbered first."""
    binary = {"i": ">i8", "u": ">i2", "f": ">f8"}
    fields = [("number", ">i8"), *((name, binary[OBSERVATION[name].kind]) for name in _COLUMNS)]
    table = np.empty(
        len(rows),
        [
            ("fields", ">i2"),
            *(item for name, kind in fields for item in ((f"{name} size", ">i4"), (name, kind))),
        ],
    )
    table["fields"] = len(fields)
    for name, kind in fields:
        table[f"{name} size"] = np.dtype(kind).itemsize
        table[name] = np.arange(len(rows)) if name == "number" else rows[name]
    return memoryview(b"PGCOPY\n\xff\r\n\0" + bytes(8) + table.tobytes() + b"\xff\xff")


def postgres_figures(server: PostgresServer) -> list[Figure]:
    import asyncpg

    from camber.map_update.stores.postgres_store import PostgresStore

    loop = asyncio.new_event_loop()
    db = loop.run_until_complete(asyncpg.connect(server.address()))
    types = {"i": "bigint", "u": "smallint", "f": "double precision"}
    definition = ", ".join(f"{name} {types[OBSERVATION[name].kind]} NOT NULL" for name in _COLUMNS)
    for table in ("made_before", "by_driver"):
        loop.run_until_complete(db.execute(f"CREATE TABLE {table} (number bigint NOT NULL, {definition})"))
    loop.run_until_complete(
        db.execute("CREATE TABLE as_stored (number bigint NOT NULL, rows bytea NOT NULL)")
    )
    loop.run_until_complete(db.execute("ALTER TABLE as_stored ALTER rows SET STORAGE EXTERNAL"))

    def copy(table: str, records: list[Any]) -> None:
        loop.run_until_complete(db.copy_records_to_table(table, records=records))

    def copy_binary(data: memoryview) -> None:
        loop.run_until_complete(db.copy_to_table("made_before", source=data, format="binary"))

    def copy_by_driver(group: list[Contribution]) -> None:
        copy("by_driver", [(n, *row) for n, c in enumerate(group) for row in c.observations.tolist()])

    peers_of_store = (
        work_of(lambda group: binary_copy(rows_of(group)), copy_binary),
        work_of(list, copy_by_driver),
        work_of(
            lambda g: [(n, c.observations.tobytes()) for n, c in enumerate(g)], partial(copy, "as_stored")
        ),
    )
    with closing(PostgresStore(server.new_database(), limit_s=30.0)) as store:
        ours, *peers = in_turn(storing(store), *peers_of_store)
    loop.run_until_complete(db.close())
    loop.close()
    names = (
        "binary COPY of the same rows, encoded before, into a plain table",
        "binary COPY of the same rows, encoded by the driver",
        "binary COPY of the same values a batch, without a ledger: what the ledger costs",
    )
    what = "uploads into PostgreSQL with their ledger"
    return [higher(what, "records/s", ours, peer, name) for peer, name in zip(peers, names, strict=True)]


@contextmanager
def workers(
    folder: Path, postgres: PostgresServer, nats: NatsServer | None, shards: list[str], each: int
) -> Iterator[str]:
    """map_update in all its roles; gives the endpoint that vehicles connect to."""
    endpoint = f"tcp/127.0.0.1:{lasting_port()}"
    router = f'[zenoh]\nmode = "router"\nconnect = []\nlisten = ["{endpoint}"]\n'
    client = f'[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]\n'
    tables = {}
    if nats is None:
        tables["all"] = f'vehicle = "fleet"\nstore = "{postgres.new_database()}"\nanswer_s = 5.0\n{router}'
    else:
        queue = f'queue = "{nats.address}"\nshards = {json.dumps(shards)}\nanswer_s = 5.0\n'
        tables["receive"] = f'vehicle = "receive"\nrole = "receive"\n{queue}{router}'
        for shard in shards:
            address = postgres.new_database()
            for n in range(each):
                name = f"store{shard}_{n}"
                tables[name] = (
                    f'vehicle = "{name}"\nrole = "store"\nshard = "{shard}"\nstore = "{address}"\n{queue}{client}'
                )
    with ExitStack() as ends:
        for name, table in tables.items():
            path = folder / f"{name}.toml"
            path.write_text(table)
            log = ends.enter_context((folder / f"{name}.log").open("w"))
            process = subprocess.Popen(
                [sys.executable, "-m", "camber.map_update", "--config", str(path)],
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
            ends.callback(process.wait)
            ends.callback(process.kill)
        for name in tables:
            wait_until(
                lambda path=folder / f"{name}.log": "started" in path.read_text(),
                timeout_s=60.0,
                why=f"{name} does not start",
            )
        yield endpoint


def uploaded(folder: Path, endpoint: str, *, everywhere: bool) -> float:
    """Records per second that were acknowledged, from the first to the last; a first part of them warms up."""
    warm = UPLOADS // 4
    spans = []
    for first, until in ((0, warm), (warm, UPLOADS)):
        load = Load(
            endpoint,
            str(folder / "acks"),
            first,
            until,
            RECORDS,
            window=500,
            everywhere=everywhere,
            prepared=True,
        )
        out = subprocess.run(
            [sys.executable, *command(load)],
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            check=True,
            timeout=300.0,
        ).stdout
        spans.append(json.loads(out.splitlines()[-1])["s"])
    (folder / "acks").unlink()
    return (UPLOADS - warm) * RECORDS / spans[-1]


def end_to_end(folder: Path, postgres: PostgresServer, copy_rate: float) -> list[Figure]:
    rates = {}
    with workers(folder, postgres, None, [""], 1) as endpoint:
        rates["Zenoh into PostgreSQL, one worker"] = uploaded(folder, endpoint, everywhere=False)
    if NATS is not None:
        kinds = (
            ("one that stores", [""], 1),
            ("two that store in one database", [""], 2),
            ("four that store, a database each", ["0", "1", "2", "3"], 1),
        )
        for name, shards, each in kinds:
            with running(NatsServer()) as nats, workers(folder, postgres, nats, shards, each) as endpoint:
                rates[f"Zenoh and JetStream, one that receives, {name}"] = uploaded(
                    folder, endpoint, everywhere=len(shards) > 1
                )
    peer = "binary COPY alone of rows encoded before, as above"
    return [
        higher(f"{name}: committed and acknowledged", "records/s", rate, copy_rate, peer)
        for name, rate in rates.items()
    ]


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        figures = sqlite_figures(folder)
        if POSTGRES:
            with running(PostgresServer()) as server:
                copies = postgres_figures(server)
                figures += [*copies, *end_to_end(folder, server, copies[0].peer)]
    return figures

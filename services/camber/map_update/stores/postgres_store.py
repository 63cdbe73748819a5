"""The store in PostgreSQL, 14 or later, for more than one machine.

Any number of processes may use one database. The ledger's numbers follow the order of commits, without gaps that are
filled later: a commit locks the row of `ledger_end` before it looks up known contributions, so numbers are assigned to
one transaction after another (a sequence would assign them earlier, and transactions overtake one another).

The observations of a contribution are one value (see `postgres_tables`), written by one binary COPY for a group of
contributions into the partition of their numbers. Partitions have no index, because the fusion reads them in the order
written, and the values are stored out of line. A partition is dropped once all of it is forgotten. Values and digests
are computed while the server looks up known contributions.

If the server is not reached, every call raises StoreError at once, and a connection is tried again after 0.2 s to 2 s.
Commits request `synchronous_commit`, and a server with `fsync = off` is refused.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from itertools import groupby
from typing import Any, TypeVar
from urllib.parse import urlsplit

import asyncpg
import numpy as np

from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.fusion.votes import VOTE
from camber.map_update.stores.postgres_tables import CREATE, FORMAT, LAYOUT
from camber.map_update.stores.reconnecting_client import ConnectionFailedError, ReconnectingClient
from camber.map_update.stores.store import (
    ENTRY_COLUMNS,
    Counts,
    FusionProgress,
    FusionStep,
    Ids,
    Judge,
    LedgerEntry,
    ObservationPage,
    Outcome,
    OvertakenError,
    Rows,
    Store,
    StoreError,
    forgettable,
    ledger_row,
    observation_page,
    settle,
    votes_by_surface,
)

T = TypeVar("T")

PARTITION = 8192
"""Chosen: contributions of one partition; with batches of 64 half a million observations, 45 MB."""
_PAGE = 1024  # chosen: ledger rows of one query
_KNOWN = """
SELECT vehicle, kind, id, digest FROM contribution
JOIN unnest($1::text[], $2::text[], $3::text[]) AS asked (vehicle, kind, id) USING (vehicle, kind, id)"""
_ENTRIES = f"""
SELECT {", ".join(ENTRY_COLUMNS)},
    CASE WHEN number > forgotten THEN records ELSE 0 END
FROM contribution, progress WHERE number > $1 ORDER BY number LIMIT {_PAGE}"""


class PostgresStore(Store):
    """A store in a database of a server, by `address`: `postgresql://user@host:port/database`.

    `limit_s`: longest wait for the server. Raises StoreError if the database holds something else or has a later
    format; a server that cannot be reached is tried again by later calls.
    """

    def __init__(self, address: str, *, password: str | None = None, limit_s: float = 1.0) -> None:
        parts = urlsplit(address)
        self._name = f"{parts.scheme}://{parts.hostname or ''}:{parts.port or 5432}{parts.path}"
        self._address, self._password, self._limit_s = address, password, limit_s
        broken = (asyncpg.PostgresError, asyncpg.InterfaceError)
        self._client: ReconnectingClient[asyncpg.Connection] = ReconnectingClient(
            self._name, self._connected, _terminate, broken
        )
        try:
            self.check()
        except _WrongDatabaseError:
            self._client.close()
            raise
        except StoreError:
            pass  # not reached yet

    def commit(self, contributions: Sequence[Contribution], now_ns: int, judge: Judge) -> list[Outcome]:
        """See `Store.commit`."""
        return self._run(lambda db: self._commit(db, contributions, now_ns, judge))

    def check(self) -> None:
        """See `Store.check`."""
        self._run(lambda db: db.fetchval('SELECT "cursor" FROM progress'))

    def counts(self) -> Counts:
        """See `Store.counts`."""
        row = self._run(
            lambda db: db.fetchrow("SELECT count(*), coalesce(sum(records), 0) FROM contribution")
        )
        return Counts(*map(int, row))

    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """See `Store.observations_after`."""
        return self._run(lambda db: self._observations_after(db, cursor, limit))

    def forget(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.forget`."""
        return self._run(lambda db: self._forget(db, before_ns, most))

    def prune(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.prune`."""
        return self._run(lambda db: self._prune(db, before_ns, most))

    def progress(self) -> FusionProgress:
        """See `Store.progress`."""
        return FusionProgress(*self._run(lambda db: db.fetchrow('SELECT "cursor", revision FROM progress')))

    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """See `Store.votes_of`."""
        if surfaces is None:
            selected = self._run(lambda db: db.fetch("SELECT rows FROM vote ORDER BY surface_id"))
        else:
            wanted = np.unique(surfaces).tolist()
            query = "SELECT rows FROM vote WHERE surface_id = ANY ($1::bigint[]) ORDER BY surface_id"
            selected = self._run(lambda db: db.fetch(query, wanted))
        return np.frombuffer(b"".join(rows for (rows,) in selected), VOTE)

    def advance(self, seen: FusionProgress, step: FusionStep) -> FusionProgress:
        """See `Store.advance`."""
        surfaces, votes = votes_by_surface(step, VOTE)
        return self._run(lambda db: self._advance(db, seen, step, surfaces=surfaces, votes=votes))

    def close(self) -> None:
        """Disconnect from the server."""
        self._client.close()

    def _run(self, work: Callable[[asyncpg.Connection], Coroutine[Any, Any, T]]) -> T:
        try:
            return self._client.run(work)
        except ConnectionFailedError as error:
            raise StoreError(str(error)) from error

    async def _connected(self) -> asyncpg.Connection:
        limit_ms = str(round(1000 * self._limit_s))
        connection = await asyncpg.connect(
            self._address,
            password=self._password,
            timeout=self._limit_s,
            command_timeout=self._limit_s,
            server_settings={
                "application_name": "camber map_update",
                "synchronous_commit": "on",
                # Locks of a client that disappeared are released.
                "lock_timeout": limit_ms,
                "idle_in_transaction_session_timeout": "10000",
            },
        )
        try:
            await self._prepare(connection)
        except BaseException:
            connection.terminate()
            raise
        return connection

    async def _prepare(self, db: asyncpg.Connection) -> None:
        if await db.fetchval("SHOW fsync") != "on":
            raise _WrongDatabaseError(
                f"{self._name}: fsync is off: a commit would not survive a loss of power"
            )
        async with db.transaction():
            await db.execute("SELECT pg_advisory_xact_lock(hashtext('camber map_update'))")
            if await db.fetchval("SELECT to_regclass('contribution') IS NULL"):
                await db.execute(CREATE)
                await db.executemany("INSERT INTO layout VALUES ($1, $2)", list(LAYOUT.items()))
            if await db.fetchval("SELECT to_regclass('layout') IS NULL"):
                raise _WrongDatabaseError(f"{self._name}: its table contribution is not Camber's")
            layout = dict(await db.fetch("SELECT name, descr FROM layout"))
        if layout.get("format") != str(FORMAT):
            raise _WrongDatabaseError(f"{self._name}: format {layout.get('format')}, expected {FORMAT}")
        if wrong := [name for name, descr in LAYOUT.items() if layout.get(name) != descr]:
            raise _WrongDatabaseError(
                f"{self._name}: table {wrong[0]} is of another layout: {layout.get(wrong[0])}"
            )

    async def _commit(
        self, db: asyncpg.Connection, contributions: Sequence[Contribution], now_ns: int, judge: Judge
    ) -> list[Outcome]:
        async with db.transaction():
            last, partitions = await db.fetchrow("SELECT number, partitions FROM ledger_end FOR UPDATE")
            names = [contribution.name for contribution in contributions]
            query = asyncio.ensure_future(db.fetch(_KNOWN, *([name[k] for name in names] for k in range(3))))
            await asyncio.sleep(0)  # sends the query
            encoded = {id(each): (each.observations.tobytes(), each.digest()) for each in contributions}
            known = {(vehicle, kind, id_): bytes(digest) for vehicle, kind, id_, digest in await query}
            outcomes, new = settle(contributions, known, judge)
            if new:
                rows, digests = zip(*(encoded[id(each)] for each in new), strict=True)
                await self._create_partitions(db, partitions, last + len(new))
                await self._insert(db, list(enumerate(rows, last + 1)))
                numbered = zip(range(last + 1, last + len(new) + 1), new, digests, strict=True)
                ledger = [ledger_row(*each, now_ns) for each in numbered]
                await db.copy_records_to_table("contribution", records=ledger)
        return outcomes

    async def _create_partitions(self, db: asyncpg.Connection, existing: int, end: int) -> None:
        """Create the partitions needed up to the number `end`, which becomes the ledger's end."""
        needed = (end - 1) // PARTITION + 1
        for k in range(existing, needed):
            await db.execute(
                f"CREATE TABLE observation_{k} PARTITION OF packed"
                f" FOR VALUES FROM ({k * PARTITION + 1}) TO ({(k + 1) * PARTITION + 1})"
            )
        await db.execute("UPDATE ledger_end SET number = $1, partitions = $2", end, max(needed, existing))

    async def _insert(self, db: asyncpg.Connection, rows: Sequence[tuple[int, bytes]]) -> None:
        for k, part in groupby(rows, lambda row: (row[0] - 1) // PARTITION):
            await db.copy_records_to_table(f"observation_{k}", records=list(part))

    async def _observations_after(self, db: asyncpg.Connection, cursor: int, limit: int) -> ObservationPage:
        entries: list[LedgerEntry] = []
        total, last, full = 0, cursor, False
        while not full:
            page = await db.fetch(_ENTRIES, last)
            for *columns, records in page:
                total += records
                full = bool(entries) and (total > limit or len(entries) >= limit)
                if full:
                    break
                entries.append(LedgerEntry(**dict(zip(ENTRY_COLUMNS, columns, strict=True))))
                last = entries[-1].number
            full |= len(page) < _PAGE
        if not entries:
            return observation_page(cursor, (), np.empty(0, OBSERVATION), np.empty(0, np.intp))
        packed = await db.fetch(
            "SELECT contribution, rows FROM packed WHERE contribution BETWEEN $1 AND $2",
            entries[0].number,
            last,
        )
        rows = np.frombuffer(b"".join(rows for _, rows in packed), OBSERVATION)
        number = np.repeat(
            np.array([number for number, _ in packed], np.int64),
            [len(rows) // OBSERVATION.itemsize for _, rows in packed],
        )
        entry_of = np.searchsorted([entry.number for entry in entries], number)
        return observation_page(last, entries, rows, entry_of)

    async def _forget(self, db: asyncpg.Connection, before_ns: int, most: int) -> int:
        async with db.transaction():
            forgotten = await db.fetchval("SELECT forgotten FROM progress FOR UPDATE")
            selected = await db.fetch(
                "SELECT number, received_ns FROM contribution, progress"
                ' WHERE number > $1 AND number <= "cursor" ORDER BY number LIMIT $2',
                forgotten,
                most,
            )
            numbers = forgettable(selected, before_ns)
            if numbers:
                await db.execute("UPDATE progress SET forgotten = $1", numbers[-1])
                for k in range((numbers[0] - 1) // PARTITION, (numbers[-1] - 1) // PARTITION + 1):
                    if numbers[-1] >= (k + 1) * PARTITION:
                        await db.execute(f"DROP TABLE observation_{k}")
                    else:
                        await db.execute(f"DELETE FROM observation_{k} WHERE contribution <= $1", numbers[-1])
        return len(numbers)

    async def _prune(self, db: asyncpg.Connection, before_ns: int, most: int) -> int:
        async with db.transaction():
            selected = await db.fetch(
                "SELECT number, received_ns FROM contribution, progress WHERE number <= forgotten"
                " ORDER BY number LIMIT $1",
                most,
            )
            numbers = forgettable(selected, before_ns)
            if numbers:
                await db.execute("DELETE FROM contribution WHERE number <= $1", numbers[-1])
        return len(numbers)

    async def _advance(
        self,
        db: asyncpg.Connection,
        seen: FusionProgress,
        step: FusionStep,
        surfaces: list[int],
        votes: list[bytes],
    ) -> FusionProgress:
        async with db.transaction():
            moved = await db.execute(
                'UPDATE progress SET "cursor" = $1, revision = revision + 1 WHERE "cursor" = $2 AND revision = $3',
                step.cursor,
                *seen,
            )
            if moved != "UPDATE 1":
                raise OvertakenError(f"{self._name}: others have written since revision {seen.revision}")
            pairs = [(surface, rows) for surface, rows in zip(surfaces, votes, strict=True) if rows]
            await db.execute(
                "INSERT INTO vote SELECT * FROM unnest($1::bigint[], $2::bytea[])"
                " ON CONFLICT (surface_id) DO UPDATE SET rows = excluded.rows",
                [surface for surface, _ in pairs],
                [rows for _, rows in pairs],
            )
            emptied = [surface for surface, rows in zip(surfaces, votes, strict=True) if not rows]
            await db.execute("DELETE FROM vote WHERE surface_id = ANY ($1::bigint[])", emptied)
        return FusionProgress(step.cursor, seen.revision + 1)


async def _terminate(connection: asyncpg.Connection) -> None:
    connection.terminate()
    await asyncio.sleep(0)  # the transport closes in the loop


class _WrongDatabaseError(StoreError):
    """The server was reached, and its database cannot be used."""

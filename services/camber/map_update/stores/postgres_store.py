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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import groupby
from typing import Any
from urllib.parse import urlsplit

import asyncpg

from camber.map_update.contribution import Contribution
from camber.map_update.stores.postgres_tables import CREATE
from camber.map_update.stores.reconnecting_client import ReconnectingClient
from camber.map_update.stores.store import (
    FORMAT,
    LAYOUT,
    Store,
    StoreError,
    layout_defect,
    ledger_row,
)
from camber.map_update.stores.upload_deduplication import Outcome, RefusalCheck, deduplicate

PARTITION = 8192
"""Chosen: contributions of one partition; with batches of 64 half a million observations, 45 MB."""
_KNOWN = """
SELECT vehicle, kind, id, digest FROM contribution
JOIN unnest($1::text[], $2::text[], $3::text[]) AS asked (vehicle, kind, id) USING (vehicle, kind, id)"""


class PostgresStore(Store):
    """A store in a database of a server, by `address`: `postgresql://user@host:port/database`.

    `limit_s`: longest wait for the server. Raises StoreError if the database holds something else or has a later
    format; a server that cannot be reached is tried again by later calls.
    """

    _PACKED = "packed"
    _IDS = "SELECT value::bigint FROM json_array_elements_text($1)"

    def __init__(self, address: str, *, password: str | None = None, limit_s: float = 1.0) -> None:
        parts = urlsplit(address)
        self.name = f"{parts.scheme}://{parts.hostname or ''}:{parts.port or 5432}{parts.path}"
        self._address, self._password, self._limit_s = address, password, limit_s
        broken = (asyncpg.PostgresError, asyncpg.InterfaceError)
        self._client: ReconnectingClient[asyncpg.Connection] = ReconnectingClient(
            self.name, self._connected, _terminate, broken=broken, error=StoreError
        )
        try:
            self.check()
        except _WrongDatabaseError:
            self._client.close()
            raise
        except StoreError:
            pass  # not reached yet

    def commit(
        self, contributions: Sequence[Contribution], now_ns: int, refusal_of: RefusalCheck
    ) -> list[Outcome]:
        """See `Store.commit`."""
        return self._client.run(lambda db: self._commit(db, contributions, now_ns, refusal_of))

    def close(self) -> None:
        """Disconnect from the server."""
        self._client.close()

    def _fetch(self, query: str, *parameters: object) -> list[Any]:
        return self._client.run(lambda db: db.fetch(query, *parameters))

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        async def begin(db: asyncpg.Connection) -> Any:
            transaction = db.transaction()
            await transaction.start()
            await db.execute("SELECT 1 FROM progress FOR UPDATE")
            return transaction

        transaction = self._client.run(begin)
        try:
            yield
        except BaseException:
            with suppress(StoreError):  # without a connection the server has rolled it back
                self._client.run(lambda _: transaction.rollback())
            raise
        self._client.run(lambda _: transaction.commit())

    def _delete_observations(self, first: int, last: int) -> None:
        for k in range((first - 1) // PARTITION, (last - 1) // PARTITION + 1):
            if last >= (k + 1) * PARTITION:
                self._fetch(f"DROP TABLE observation_{k}")
            else:
                self._fetch(f"DELETE FROM observation_{k} WHERE contribution <= $1", last)

    def _replace_votes(self, pairs: list[tuple[int, bytes]], emptied: list[int]) -> None:
        self._fetch(
            "INSERT INTO vote SELECT * FROM unnest($1::bigint[], $2::bytea[])"
            " ON CONFLICT (surface_id) DO UPDATE SET rows = excluded.rows",
            [surface for surface, _ in pairs],
            [rows for _, rows in pairs],
        )
        self._fetch("DELETE FROM vote WHERE surface_id = ANY ($1::bigint[])", emptied)

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
                f"{self.name}: fsync is off: a commit would not survive a loss of power"
            )
        async with db.transaction():
            await db.execute("SELECT pg_advisory_xact_lock(hashtext('camber map_update'))")
            if await db.fetchval("SELECT to_regclass('contribution') IS NULL"):
                await db.execute(CREATE)
                layout = {"format": str(FORMAT), **LAYOUT}
                await db.executemany("INSERT INTO layout VALUES ($1, $2)", list(layout.items()))
            if await db.fetchval("SELECT to_regclass('layout') IS NULL"):
                raise _WrongDatabaseError(f"{self.name}: its table contribution is not Camber's")
            layout = dict(await db.fetch("SELECT name, descr FROM layout"))
        if layout.get("format") != str(FORMAT):
            raise _WrongDatabaseError(f"{self.name}: format {layout.get('format')}, expected {FORMAT}")
        if defect := layout_defect(layout):
            raise _WrongDatabaseError(f"{self.name}: {defect}")

    async def _commit(
        self,
        db: asyncpg.Connection,
        contributions: Sequence[Contribution],
        now_ns: int,
        refusal_of: RefusalCheck,
    ) -> list[Outcome]:
        async with db.transaction():
            last, partitions = await db.fetchrow("SELECT number, partitions FROM ledger_end FOR UPDATE")
            names = [contribution.name for contribution in contributions]
            query = asyncio.ensure_future(db.fetch(_KNOWN, *([name[k] for name in names] for k in range(3))))
            await asyncio.sleep(0)  # sends the query
            encoded = {id(each): (each.observations.tobytes(), each.digest()) for each in contributions}
            known = {(vehicle, kind, id_): bytes(digest) for vehicle, kind, id_, digest in await query}
            outcomes, new = deduplicate(contributions, known, refusal_of)
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


async def _terminate(connection: asyncpg.Connection) -> None:
    connection.terminate()
    await asyncio.sleep(0)  # the transport closes in the loop


class _WrongDatabaseError(StoreError):
    """The server was reached, and its database cannot be used."""

"""The store in a local SQLite file, for a single machine.

With a write-ahead log and `synchronous=FULL` a group of contributions is one transaction and one flush, about as fast
for a hundred as for one. The observations of a contribution, and the votes of a surface, are one value: the array's
bytes, whose dtype is in the table `layout`. They are always read and deleted together, and this is three times as fast
as one database row each (`benchmarks/ingest.py`). `camber uploads FILE --records` prints them; with NumPy alone:

    descr, = db.execute("SELECT descr FROM layout WHERE name = 'observation'").fetchone()
    np.frombuffer(rows, np.dtype([tuple(field) for field in json.loads(descr)]))

Deleted content is overwritten (`secure_delete`), because it shows where vehicles were.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.stores.store import (
    FORMAT,
    LAYOUT,
    LEDGER,
    TABLES,
    Store,
    StoreError,
    layout_defect,
    ledger_row,
)
from camber.map_update.stores.upload_deduplication import Outcome, RefusalCheck, deduplicate
from camber.schemas.plain_file import check_plain_file

_TYPES = {"bigint": "INTEGER", "blob": "BLOB"}


class SqliteStore(Store):
    """A store in one file. A damaged file is never replaced: its content has been acknowledged.

    Raises StoreError if the file cannot be opened, is damaged (checked at the start) or has a later format; an earlier
    format is converted. `busy_s`: how long a commit waits for another process that has locked the file. `read_only`:
    the file is not changed, and an earlier format is an error too.
    """

    _PACKED = "observation"
    _IDS = "SELECT value FROM json_each($1)"

    def __init__(self, path: Path, *, busy_s: float = 1.0, read_only: bool = False) -> None:
        self.name = str(path)
        with self._errors_named():
            if not read_only:
                path.parent.mkdir(parents=True, exist_ok=True)
            check_plain_file(path)
            uri = f"{path.absolute().as_uri()}?mode={'ro' if read_only else 'rwc'}"
            self._db = sqlite3.connect(uri, uri=True, timeout=busy_s, isolation_level=None)
        try:
            with self._errors_named():
                self._prepare(read_only)
        except StoreError:
            self._db.close()
            raise

    def commit(
        self, contributions: Sequence[Contribution], now_ns: int, refusal_of: RefusalCheck
    ) -> list[Outcome]:
        """See `Store.commit`."""
        with self._transaction():
            known = {}
            for contribution in contributions:
                query = "SELECT digest FROM contribution WHERE vehicle = $1 AND kind = $2 AND id = $3"
                for (digest,) in self._fetch(query, *contribution.name):
                    known[contribution.name] = digest
            outcomes, new = deduplicate(contributions, known, refusal_of)
            # Numbers are never reused, even if the last row of the ledger was deleted.
            ((last,),) = self._fetch(
                "SELECT max(cursor, coalesce((SELECT max(number) FROM contribution), 0)) FROM progress"
            )
            numbered = list(enumerate(new, last + 1))
            self._db.executemany(
                f"INSERT INTO contribution VALUES (?{', ?' * 10})",
                [ledger_row(number, each, each.digest(), now_ns) for number, each in numbered],
            )
            self._db.executemany(
                "INSERT INTO observation VALUES (?, ?)",
                [(number, each.observations.tobytes()) for number, each in numbered],
            )
        return outcomes

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError, UnicodeError) as error:  # the last: damaged names in an error's text
            raise StoreError(f"{self.name}: {error}") from error

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._errors_named():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _fetch(self, query: str, *parameters: object) -> list[Any]:
        with self._errors_named():
            return self._db.execute(query.replace("$", "?"), parameters).fetchall()

    def _delete_observations(self, first: int, last: int) -> None:
        self._fetch("DELETE FROM observation WHERE contribution <= $1", last)

    def _replace_votes(self, pairs: list[tuple[int, bytes]], emptied: list[int]) -> None:
        self._db.executemany("REPLACE INTO vote VALUES (?, ?)", pairs)
        self._db.executemany("DELETE FROM vote WHERE surface_id = ?", [(surface,) for surface in emptied])

    def _prepare(self, read_only: bool) -> None:
        written = ("journal_mode = WAL", "synchronous = FULL", "secure_delete = ON")
        for setting in (*(() if read_only else written), "cell_size_check = ON"):
            self._fetch(f"PRAGMA {setting}")
        ((result,),) = self._fetch("PRAGMA integrity_check(1)")
        if result != "ok":
            raise StoreError(f"{self.name}: damaged, restore it from a copy: {result}")
        with nullcontext() if read_only else self._transaction():
            ((version,),) = self._fetch("PRAGMA user_version")
            if version != FORMAT and read_only:
                what = f"format {version}, expected {FORMAT}: another version, or not a store"
                raise StoreError(f"{self.name}: {what}")
            if version > FORMAT:
                what = f"format {version}, expected at most {FORMAT}: made by a later version"
                raise StoreError(f"{self.name}: {what}")
            if version < FORMAT:
                _migrate(self._db, version)
                self._fetch(f"PRAGMA user_version = {FORMAT}")
            if defect := layout_defect(dict(self._fetch("SELECT name, descr FROM layout"))):
                raise StoreError(f"{self.name}: {defect}")


def _migrate(db: sqlite3.Connection, version: int) -> None:
    """Create the tables, or convert format 1: one database row for each observation, and no tables of the fusion."""
    begin = LEDGER if version == 0 else "ALTER TABLE observation RENAME TO observation_1"
    observations = "CREATE TABLE observation (contribution {bigint} PRIMARY KEY, rows {blob} NOT NULL)"
    for statement in (begin, observations, *TABLES):
        db.execute(statement.format(**_TYPES))
    db.executemany("INSERT INTO layout VALUES (?, ?)", list(LAYOUT.items()))
    if version == 0:
        return
    columns = ", ".join(OBSERVATION.names or ())
    selected = db.execute(f"SELECT contribution, {columns} FROM observation_1 ORDER BY contribution, rowid")
    for number, rows in groupby(selected, key=itemgetter(0)):
        array = np.array([row[1:] for row in rows], OBSERVATION)
        db.execute("INSERT INTO observation VALUES (?, ?)", (number, array.tobytes()))
    db.execute("DROP TABLE observation_1")

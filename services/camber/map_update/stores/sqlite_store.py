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

import json
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np

from camber.map_update.contribution import OBSERVATION, Contribution
from camber.map_update.fusion.votes import VOTE
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

FORMAT = 2  # of the file: 1 had one row for each observation
_LAYOUT = {"observation": json.dumps(OBSERVATION.descr), "vote": json.dumps(VOTE.descr)}
_LEDGER = """
CREATE TABLE contribution (
    number INTEGER PRIMARY KEY,
    vehicle TEXT NOT NULL,
    kind TEXT NOT NULL,
    id TEXT NOT NULL,
    digest BLOB NOT NULL,
    received_ns INTEGER NOT NULL,
    records INTEGER NOT NULL,
    datum TEXT NOT NULL,
    map_version INTEGER NOT NULL,
    epoch_year REAL NOT NULL,
    position_covariance_enu_m2 BLOB,
    UNIQUE (vehicle, kind, id)
)"""
_TABLES = (
    "CREATE TABLE observation (contribution INTEGER PRIMARY KEY, rows BLOB NOT NULL)",
    "CREATE TABLE vote (surface_id INTEGER PRIMARY KEY, rows BLOB NOT NULL)",
    "CREATE TABLE state (name TEXT PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID",
    "CREATE TABLE progress (cursor INTEGER NOT NULL, revision INTEGER NOT NULL, forgotten INTEGER NOT NULL)",
    "INSERT INTO progress VALUES (0, 0, 0)",
    "CREATE TABLE layout (name TEXT PRIMARY KEY, descr TEXT NOT NULL)",
)


class SqliteStore(Store):
    """A store in one file. A damaged file is never replaced: its content has been acknowledged.

    Raises StoreError if the file cannot be opened, is damaged (checked at the start) or has a later format; an earlier
    format is converted. `busy_s`: how long a commit waits for another process that has locked the file. `read_only`:
    the file is not changed, and an earlier format is an error too.
    """

    def __init__(self, path: Path, *, busy_s: float = 1.0, read_only: bool = False) -> None:
        self.path = path
        with self._errors_named():
            if not read_only:
                path.parent.mkdir(parents=True, exist_ok=True)
            uri = f"{path.absolute().as_uri()}?mode={'ro' if read_only else 'rwc'}"
            self._db = sqlite3.connect(uri, uri=True, timeout=busy_s, isolation_level=None)
        try:
            with self._errors_named():
                if read_only:
                    self._check()
                else:
                    self._prepare()
        except StoreError:
            self._db.close()
            raise

    def commit(self, contributions: Sequence[Contribution], now_ns: int, judge: Judge) -> list[Outcome]:
        """See `Store.commit`."""
        with self._writing() as db:
            known = {}
            for contribution in contributions:
                row = db.execute(
                    "SELECT digest FROM contribution WHERE vehicle = ? AND kind = ? AND id = ?",
                    contribution.name,
                ).fetchone()
                if row is not None:
                    known[contribution.name] = row[0]
            outcomes, new = settle(contributions, known, judge)
            # Numbers are never reused, even if the last row of the ledger was deleted.
            (last,) = db.execute(
                "SELECT max(cursor, coalesce((SELECT max(number) FROM contribution), 0)) FROM progress"
            ).fetchone()
            db.executemany(
                f"INSERT INTO contribution VALUES (?{', ?' * 10})",
                [
                    ledger_row(number, contribution, contribution.digest(), now_ns)
                    for number, contribution in enumerate(new, last + 1)
                ],
            )
            db.executemany(
                "INSERT INTO observation VALUES (?, ?)",
                [(number, c.observations.tobytes()) for number, c in enumerate(new, last + 1)],
            )
        return outcomes

    def check(self) -> None:
        """See `Store.check`."""
        with self._errors_named():
            self._db.execute("SELECT 1 FROM progress").fetchone()

    def counts(self) -> Counts:
        """See `Store.counts`."""
        with self._errors_named():
            row = self._db.execute("SELECT count(*), coalesce(sum(records), 0) FROM contribution").fetchone()
        return Counts(*row)

    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """See `Store.observations_after`."""
        entries: list[LedgerEntry] = []
        parts: list[Rows] = []
        total = 0
        with self._errors_named():
            selected = self._db.execute(
                f"SELECT {', '.join(ENTRY_COLUMNS)}, rows FROM contribution"
                " LEFT JOIN observation ON contribution = number WHERE number > ? ORDER BY number",
                (cursor,),
            )
            for *columns, rows in selected:
                part = np.frombuffer(rows or b"", OBSERVATION)
                total += len(part)
                if entries and (total > limit or len(entries) >= limit):
                    break
                entries.append(LedgerEntry(**dict(zip(ENTRY_COLUMNS, columns, strict=True))))
                parts.append(part)
            selected.close()
        entry_of = np.repeat(np.arange(len(entries)), [len(part) for part in parts])
        last = entries[-1].number if entries else cursor
        # np.concatenate would compare the dtypes of each pair.
        rows = np.frombuffer(b"".join(part.tobytes() for part in parts), OBSERVATION)
        return observation_page(last, entries, rows, entry_of)

    def forget(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.forget`."""
        with self._writing() as db:
            selected = db.execute(
                "SELECT number, received_ns FROM contribution, progress"
                " WHERE number > forgotten AND number <= cursor ORDER BY number LIMIT ?",
                (most,),
            ).fetchall()
            numbers = forgettable(selected, before_ns)
            if numbers:
                db.execute("DELETE FROM observation WHERE contribution <= ?", numbers[-1:])
                db.execute("UPDATE progress SET forgotten = ?", numbers[-1:])
        return len(numbers)

    def prune(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.prune`."""
        with self._writing() as db:
            selected = db.execute(
                "SELECT number, received_ns FROM contribution, progress WHERE number <= forgotten"
                " ORDER BY number LIMIT ?",
                (most,),
            ).fetchall()
            numbers = forgettable(selected, before_ns)
            db.execute("DELETE FROM contribution WHERE number <= ?", (numbers[-1] if numbers else 0,))
        return len(numbers)

    def progress(self) -> FusionProgress:
        """See `Store.progress`."""
        with self._errors_named():
            return FusionProgress(*self._db.execute("SELECT cursor, revision FROM progress").fetchone())

    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """See `Store.votes_of`."""
        with self._errors_named():
            if surfaces is None:
                selected = self._db.execute("SELECT rows FROM vote ORDER BY surface_id").fetchall()
            else:
                wanted = json.dumps(np.unique(surfaces).tolist())
                selected = self._db.execute(
                    "SELECT rows FROM json_each(?) JOIN vote ON surface_id = json_each.value ORDER BY surface_id",
                    (wanted,),
                ).fetchall()
        return np.frombuffer(b"".join(rows for (rows,) in selected), VOTE)

    def advance(self, seen: FusionProgress, step: FusionStep) -> FusionProgress:
        """See `Store.advance`."""
        surfaces, votes = votes_by_surface(step, VOTE)
        with self._writing() as db:
            moved = db.execute(
                "UPDATE progress SET cursor = ?, revision = revision + 1 WHERE cursor = ? AND revision = ?",
                (step.cursor, *seen),
            )
            if moved.rowcount != 1:
                raise OvertakenError(f"{self.path}: others have written since revision {seen.revision}")
            pairs = list(zip(surfaces, votes, strict=True))
            db.executemany("REPLACE INTO vote VALUES (?, ?)", [pair for pair in pairs if pair[1]])
            db.executemany("DELETE FROM vote WHERE surface_id = ?", [(s,) for s, rows in pairs if not rows])
        return FusionProgress(step.cursor, seen.revision + 1)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{self.path}: {error}") from error

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with self._errors_named():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _prepare(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute("PRAGMA secure_delete = ON")
        self._check_integrity()
        with self._writing() as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version > FORMAT:
                raise StoreError(
                    f"{self.path}: format {version}, expected at most {FORMAT}: made by a later version"
                )
            if version < FORMAT:
                _MIGRATIONS[version](db)
                db.execute(f"PRAGMA user_version = {FORMAT}")
            self._check_layout()

    def _check(self) -> None:
        self._check_integrity()
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version != FORMAT:
            raise StoreError(
                f"{self.path}: format {version}, expected {FORMAT}: another version, or not a store"
            )
        self._check_layout()

    def _check_integrity(self) -> None:
        self._db.execute("PRAGMA cell_size_check = ON")
        (result,) = self._db.execute("PRAGMA integrity_check(1)").fetchone()
        if result != "ok":
            raise StoreError(f"{self.path}: damaged, restore it from a copy: {result}")

    def _check_layout(self) -> None:
        layout = dict(self._db.execute("SELECT name, descr FROM layout").fetchall())
        if wrong := [name for name, descr in _LAYOUT.items() if layout.get(name) != descr]:
            raise StoreError(f"{self.path}: table {wrong[0]} is of another layout: {layout.get(wrong[0])}")


def _create(db: sqlite3.Connection) -> None:
    db.execute(_LEDGER)
    _add_tables(db)


def _convert_from_1(db: sqlite3.Connection) -> None:
    """Convert format 1: one database row for each observation, and no tables of the fusion."""
    db.execute("ALTER TABLE observation RENAME TO observation_1")
    _add_tables(db)
    columns = ", ".join(OBSERVATION.names or ())
    selected = db.execute(f"SELECT contribution, {columns} FROM observation_1 ORDER BY contribution, rowid")
    for number, rows in groupby(selected, key=itemgetter(0)):
        array = np.array([row[1:] for row in rows], OBSERVATION)
        db.execute("INSERT INTO observation VALUES (?, ?)", (number, array.tobytes()))
    db.execute("DROP TABLE observation_1")


def _add_tables(db: sqlite3.Connection) -> None:
    for statement in _TABLES:
        db.execute(statement)
    db.executemany("INSERT INTO layout VALUES (?, ?)", list(_LAYOUT.items()))


_MIGRATIONS: dict[int, Callable[[sqlite3.Connection], None]] = {0: _create, 1: _convert_from_1}

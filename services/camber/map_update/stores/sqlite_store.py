"""The store in a file of SQLite beside the service: nothing to install or to run.

A write-ahead log and `synchronous=FULL`: a group of contributions is one transaction and one flush, about as fast for a
hundred as for one. The observations of a contribution, and the votes of a surface, are one value: the rows of an array
as they lie in memory, whose layout stands in the table `layout`. They are always read and deleted together, and this is
three times as fast as a row of the database for each. `camber uploads FILE --records` prints them; with NumPy alone:

    descr, = db.execute("SELECT descr FROM layout WHERE name = 'observation'").fetchone()
    np.frombuffer(rows, np.dtype([tuple(field) for field in json.loads(descr)]))

What is deleted is overwritten (`secure_delete`): it tells where vehicles were.
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
    empty_rows,
    forgettable,
    joined,
    ledger_row,
    observed,
    settle,
    votes_by_surface,
)

FORMAT = 2
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
_HEADING = "number, vehicle, kind, id, received_ns, datum, map_version, epoch_year"


class SqliteStore(Store):
    """The file. A damaged one is never replaced: what it holds has been acknowledged.

    Raises StoreError when the file cannot be opened, is damaged (it is read through at the start) or comes from a
    later version of this program; one of an earlier version is brought to this one. `busy_s`: how long a commit waits
    for another process that has the file locked. `read_only`: the file is left as it is, and one of another version
    is an error too.
    """

    def __init__(self, path: Path, *, busy_s: float = 1.0, read_only: bool = False) -> None:
        self.path = path
        with self._named():
            if not read_only:
                path.parent.mkdir(parents=True, exist_ok=True)
            uri = f"{path.absolute().as_uri()}?mode={'ro' if read_only else 'rwc'}"
            self._db = sqlite3.connect(uri, uri=True, timeout=busy_s, isolation_level=None)
        try:
            with self._named():
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
            # Numbers are never used again, also where the last row of the ledger is gone.
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
        with self._named():
            self._db.execute("SELECT 1 FROM progress").fetchone()

    def counts(self) -> Counts:
        """See `Store.counts`."""
        with self._named():
            row = self._db.execute("SELECT count(*), coalesce(sum(records), 0) FROM contribution").fetchone()
        return Counts(*row)

    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """See `Store.observations_after`."""
        headings: list[LedgerEntry] = []
        parts: list[Rows] = [empty_rows()]
        total = 0
        with self._named():
            found = self._db.execute(
                f"SELECT {_HEADING}, rows FROM contribution LEFT JOIN observation ON contribution = number"
                " WHERE number > ? ORDER BY number",
                (cursor,),
            )
            for *heading, rows in found:
                part = empty_rows() if rows is None else np.frombuffer(rows, OBSERVATION)
                total += len(part)
                if headings and (total > limit or len(headings) >= limit):
                    break
                headings.append(LedgerEntry(*heading))
                parts.append(part)
            found.close()
        heading_of = np.repeat(np.arange(len(headings)), [len(part) for part in parts[1:]])
        last = headings[-1].number if headings else cursor
        return observed(last, headings, joined(parts), heading_of)

    def forget(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.forget`."""
        with self._writing() as db:
            found = db.execute(
                "SELECT number, received_ns FROM contribution, progress"
                " WHERE number > forgotten AND number <= cursor ORDER BY number LIMIT ?",
                (most,),
            ).fetchall()
            numbers = forgettable(found, before_ns)
            if numbers:
                db.execute("DELETE FROM observation WHERE contribution <= ?", numbers[-1:])
                db.execute("UPDATE progress SET forgotten = ?", numbers[-1:])
        return len(numbers)

    def prune(self, before_ns: int, *, most: int = 1000) -> int:
        """See `Store.prune`."""
        with self._writing() as db:
            found = db.execute(
                "SELECT number, received_ns FROM contribution, progress WHERE number <= forgotten"
                " ORDER BY number LIMIT ?",
                (most,),
            ).fetchall()
            numbers = forgettable(found, before_ns)
            db.execute("DELETE FROM contribution WHERE number <= ?", (numbers[-1] if numbers else 0,))
        return len(numbers)

    def progress(self) -> FusionProgress:
        """See `Store.progress`."""
        with self._named():
            return FusionProgress(*self._db.execute("SELECT cursor, revision FROM progress").fetchone())

    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """See `Store.votes_of`."""
        with self._named():
            if surfaces is None:
                found = self._db.execute("SELECT rows FROM vote ORDER BY surface_id").fetchall()
            else:
                wanted = json.dumps(np.unique(surfaces).tolist())
                found = self._db.execute(
                    "SELECT rows FROM json_each(?) JOIN vote ON surface_id = json_each.value ORDER BY surface_id",
                    (wanted,),
                ).fetchall()
        return np.frombuffer(b"".join(rows for (rows,) in found), VOTE)

    def state_of(self, name: str) -> bytes | None:
        """See `Store.state_of`."""
        with self._named():
            row = self._db.execute("SELECT value FROM state WHERE name = ?", (name,)).fetchone()
        return None if row is None else bytes(row[0])

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
            for name, value in step.state.items():
                if value is None:
                    db.execute("DELETE FROM state WHERE name = ?", (name,))
                else:
                    db.execute("REPLACE INTO state VALUES (?, ?)", (name, value))
        return FusionProgress(step.cursor, seen.revision + 1)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{self.path}: {error}") from error

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with self._named():
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
        self._check_whole()
        with self._writing() as db:
            (found,) = db.execute("PRAGMA user_version").fetchone()
            if found > FORMAT:
                raise StoreError(
                    f"{self.path}: format {found}, expected at most {FORMAT}: made by a later version"
                )
            if found < FORMAT:
                _MAKE[found](db)
                db.execute(f"PRAGMA user_version = {FORMAT}")
            self._check_layout()

    def _check(self) -> None:
        self._check_whole()
        (found,) = self._db.execute("PRAGMA user_version").fetchone()
        if found != FORMAT:
            raise StoreError(
                f"{self.path}: format {found}, expected {FORMAT}: of another version, or no store"
            )
        self._check_layout()

    def _check_whole(self) -> None:
        self._db.execute("PRAGMA cell_size_check = ON")
        (verdict,) = self._db.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            raise StoreError(f"{self.path}: damaged, restore it from a copy: {verdict}")

    def _check_layout(self) -> None:
        layout = dict(self._db.execute("SELECT name, descr FROM layout").fetchall())
        if wrong := [name for name, descr in _LAYOUT.items() if layout.get(name) != descr]:
            raise StoreError(f"{self.path}: table {wrong[0]} is of another layout: {layout.get(wrong[0])}")


def _make(db: sqlite3.Connection) -> None:
    """An empty file."""
    db.execute(_LEDGER)
    _add_tables(db)


def _make_from_1(db: sqlite3.Connection) -> None:
    """Format 1 had a row of the database for each observation, and nothing of the fusion."""
    db.execute("ALTER TABLE observation RENAME TO observation_1")
    _add_tables(db)
    columns = ", ".join(OBSERVATION.names or ())
    found = db.execute(f"SELECT contribution, {columns} FROM observation_1 ORDER BY contribution, rowid")
    for number, rows in groupby(found, key=itemgetter(0)):
        array = np.array([row[1:] for row in rows], OBSERVATION)
        db.execute("INSERT INTO observation VALUES (?, ?)", (number, array.tobytes()))
    db.execute("DROP TABLE observation_1")


def _add_tables(db: sqlite3.Connection) -> None:
    for statement in _TABLES:
        db.execute(statement)
    db.executemany("INSERT INTO layout VALUES (?, ?)", list(_LAYOUT.items()))


_MAKE: dict[int, Callable[[sqlite3.Connection], None]] = {0: _make, 1: _make_from_1}

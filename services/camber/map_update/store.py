"""Where contributions are kept: each once, and for good before anyone is told so.

An SQLite file with a write-ahead log and `synchronous=FULL`. A group of contributions is one transaction and one
flush: about as fast for a hundred as for one. Tables:

    contribution    one row for each (vehicle, kind, id): its heading, the digest of its contents, when it came
    observation     its observations, as columns of OBSERVATION

The ledger row and the observations are committed together, so a repeated upload can never be counted twice.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from struct import pack
from typing import Literal, NamedTuple

from camber.map_update.admission import Refusal
from camber.map_update.contribution import OBSERVATION, Contribution

FORMAT = 1
_FIELDS = OBSERVATION.names or ()
_SCHEMA = f"""
BEGIN IMMEDIATE;
CREATE TABLE IF NOT EXISTS contribution (
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
);
CREATE TABLE IF NOT EXISTS observation (
    contribution INTEGER NOT NULL REFERENCES contribution (number),
    {", ".join(f"{name} {'REAL' if OBSERVATION[name].kind == 'f' else 'INTEGER'} NOT NULL" for name in _FIELDS)}
);
PRAGMA user_version = {FORMAT};
COMMIT;
"""
_INSERT_HEADING = f"INSERT INTO contribution VALUES (NULL{', ?' * 10})"
_INSERT_OBSERVATION = f"INSERT INTO observation VALUES (?{', ?' * len(_FIELDS)})"


class StoreError(RuntimeError):
    """Nothing of this group was stored, nothing may be acknowledged; the text names the file and what hinders it."""


class Outcome(NamedTuple):
    """What became of one contribution; `refusal` says why it was refused."""

    status: Literal["stored", "duplicate", "refused"]
    refusal: Refusal | None = None


class Counts(NamedTuple):
    """How much is stored."""

    contributions: int
    observations: int


class Store:
    """The file; used from one thread. A damaged one is never replaced: what it holds has been acknowledged.

    Raises StoreError when the file cannot be opened, is damaged (it is read through at the start) or comes from a
    later version of this program. `busy_s`: how long a commit waits for another process that has the file locked.
    """

    def __init__(self, path: Path, *, busy_s: float = 1.0) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, timeout=busy_s, isolation_level=None)
        except (sqlite3.Error, OSError) as error:
            raise StoreError(f"{path}: {error}") from error
        try:
            self._prepare()
        except sqlite3.Error as error:
            self._db.close()
            raise StoreError(f"{path}: {error}") from error
        except StoreError:
            self._db.close()
            raise

    def commit(
        self,
        contributions: Sequence[Contribution],
        now_ns: int,
        judge: Callable[[Contribution], Refusal | None],
    ) -> list[Outcome]:
        """Store what is new and not refused by `judge`, in one transaction; returns when it is on the disk.

        What is known already is a duplicate whatever `judge` would say of it now: its vehicle missed the receipt. Other
        contents under a known name are refused. Raises StoreError: then nothing of this group was stored.
        """
        try:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                outcomes = [self._store(contribution, now_ns, judge) for contribution in contributions]
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}") from error
        return outcomes

    def counts(self) -> Counts:
        """How much there is."""
        try:
            row = self._db.execute("SELECT count(*), coalesce(sum(records), 0) FROM contribution").fetchone()
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}") from error
        return Counts(*row)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def _prepare(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute("PRAGMA cell_size_check = ON")
        (verdict,) = self._db.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            raise StoreError(f"{self.path}: damaged, restore it from a copy: {verdict}")
        (found,) = self._db.execute("PRAGMA user_version").fetchone()
        if found > FORMAT:
            raise StoreError(
                f"{self.path}: format {found}, expected at most {FORMAT}: made by a later version"
            )
        if found < FORMAT:
            self._db.executescript(_SCHEMA)

    def _store(
        self, contribution: Contribution, now_ns: int, judge: Callable[[Contribution], Refusal | None]
    ) -> Outcome:
        digest = contribution.digest()
        known = self._db.execute(
            "SELECT digest FROM contribution WHERE vehicle = ? AND kind = ? AND id = ?",
            (contribution.vehicle, contribution.kind, contribution.id),
        ).fetchone()
        if known == (digest,):
            return Outcome("duplicate")
        if known is not None:
            text = f"{contribution.kind} {contribution.id}: other contents are stored under this id"
            return Outcome("refused", Refusal("id_reused", text))
        refusal = judge(contribution)
        if refusal is not None:
            return Outcome("refused", refusal)
        self._insert(contribution, digest, now_ns)
        return Outcome("stored")

    def _insert(self, contribution: Contribution, digest: bytes, now_ns: int) -> None:
        covariance = contribution.position_covariance_enu_m2
        heading = (
            contribution.vehicle,
            contribution.kind,
            contribution.id,
            digest,
            now_ns,
            len(contribution.observations),
            contribution.datum,
            contribution.map_version,
            contribution.epoch_year,
            None if covariance is None else pack("<6d", *covariance),
        )
        number = self._db.execute(_INSERT_HEADING, heading).lastrowid
        rows = ((number, *row) for row in contribution.observations.tolist())
        self._db.executemany(_INSERT_OBSERVATION, rows)

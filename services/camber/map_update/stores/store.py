"""The stores of contributions and of the fusion's results: what both databases have in common.

Two implementations, `sqlite_store.SqliteStore` (a local file) and `postgres_store.PostgresStore` (a server), hold the
same content and pass the same tests:

    contribution    the ledger: a row for each (vehicle, kind, id) with its content's digest, numbered as committed
    observation     the observations of a contribution, until the retention time is over
    vote            the fusion's votes, by surface
    state           unused; part of the released format
    progress        the last contribution that was fused, and how often the fusion has written

A ledger row and its observations are one transaction, so a repeated upload is never counted twice. Votes and progress
are one transaction, so a contribution is never fused twice, nor skipped.
"""

from __future__ import annotations

import abc
import itertools
import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, fields
from struct import pack
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from camber.map_update.contribution import OBSERVATION, Contribution, Kind
from camber.map_update.fusion.votes import VOTE
from camber.map_update.stores.upload_deduplication import Outcome, RefusalCheck

Rows = npt.NDArray[np.void]
Ids = npt.NDArray[np.int64]

FORMAT = 2  # of the tables: 1 had one row for each observation
LEDGER = """
CREATE TABLE contribution (
    number {bigint} PRIMARY KEY,
    vehicle text NOT NULL,
    kind text NOT NULL,
    id text NOT NULL,
    digest {blob} NOT NULL,
    received_ns {bigint} NOT NULL,
    records integer NOT NULL,
    datum text NOT NULL,
    map_version {bigint} NOT NULL,
    epoch_year double precision NOT NULL,
    position_covariance_enu_m2 {blob},
    UNIQUE (vehicle, kind, id)
)"""
TABLES = (
    "CREATE TABLE vote (surface_id {bigint} PRIMARY KEY, rows {blob} NOT NULL)",
    "CREATE TABLE state (name text PRIMARY KEY, value {blob} NOT NULL)",
    'CREATE TABLE progress ("cursor" {bigint} NOT NULL, revision {bigint} NOT NULL, forgotten {bigint} NOT NULL)',
    "INSERT INTO progress VALUES (0, 0, 0)",
    "CREATE TABLE layout (name text PRIMARY KEY, descr text NOT NULL)",
)
"""The tables of both databases, with their types of integers of 64 bits and of bytes."""
LAYOUT = {"observation": json.dumps(OBSERVATION.descr), "vote": json.dumps(VOTE.descr)}
"""Content of the table `layout`: how rows are packed."""


class StoreError(RuntimeError):
    """Nothing was stored, nothing may be acknowledged; the text names the database and the cause."""


class OvertakenError(StoreError):
    """Another process has written votes since they were read: read again and continue from there."""


class Counts(NamedTuple):
    """Totals stored, including what was deleted since."""

    contributions: int
    observations: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerEntry:
    """The ledger's row of a contribution; `number` increases in the order of commits."""

    number: int
    vehicle: str
    kind: Kind
    id: str
    received_ns: int
    datum: str
    map_version: int
    epoch_year: float


ENTRY_COLUMNS = tuple(field.name for field in fields(LedgerEntry))
_PAGE = 1024  # chosen: ledger rows of one query
_ENTRIES = f"""
SELECT {", ".join(ENTRY_COLUMNS)}, CASE WHEN number > forgotten THEN records ELSE 0 END
FROM contribution, progress WHERE number > $1 ORDER BY number LIMIT {_PAGE}"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationPage:
    """Whole contributions in the order of commits, each sorted by time.

    `rows` (n,) of OBSERVATION; `entry_of` (n,) is the index of each into `entries`; `cursor` is where to continue.
    """

    cursor: int
    entries: tuple[LedgerEntry, ...]
    rows: Rows
    entry_of: npt.NDArray[np.intp]


class FusionProgress(NamedTuple):
    """Progress of the fusion: the last contribution fused, and the number of its writes."""

    cursor: int
    revision: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionStep:
    """One write of the fusion: `votes` replace all votes of `surfaces`."""

    cursor: int
    surfaces: Ids = field(default_factory=lambda: np.empty(0, np.int64))
    votes: Rows | None = None


class Store(abc.ABC):
    """A database of contributions; used from one thread. Every method raises StoreError if it cannot be reached.

    The queries here are those of both databases; `$1` is their first parameter.
    """

    name: str
    """Names the database in errors."""
    _PACKED: ClassVar[str]
    """Table of each contribution's observations as one value."""
    _IDS: ClassVar[str]
    """Query of the integers of a JSON array `$1`."""

    @abc.abstractmethod
    def commit(
        self, contributions: Sequence[Contribution], now_ns: int, refusal_of: RefusalCheck
    ) -> list[Outcome]:
        """Store what is new and not refused by `refusal_of` in one transaction; returns when it is on the disk.

        A known contribution is a duplicate whatever `refusal_of` returns: its vehicle missed the receipt. Other content
        under a known name is refused. Raises StoreError if nothing of this group was stored, or if that is unknown
        (the connection broke during the commit); sent again, it is stored once in both cases.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Disconnect from the database."""

    def check(self) -> None:
        """Raise StoreError if the database cannot be used now; reconnects if the connection was lost."""
        self._fetch("SELECT 1 FROM progress")

    def counts(self) -> Counts:
        """Return the totals."""
        (row,) = self._fetch("SELECT count(*), coalesce(sum(records), 0) FROM contribution")
        return Counts(*map(int, row))

    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """Return contributions after `cursor`: at most `limit` observations, but at least one contribution if any.

        No contribution with a smaller number is ever committed later, so continuing at `cursor` skips none.
        """
        entries: list[LedgerEntry] = []
        total, last, full = 0, cursor, False
        while not full:
            page = self._fetch(_ENTRIES, last)
            for *columns, records in page:
                total += records
                full = bool(entries) and (total > limit or len(entries) >= limit)
                if full:
                    break
                entries.append(LedgerEntry(**dict(zip(ENTRY_COLUMNS, columns, strict=True))))
                last = entries[-1].number
            full |= len(page) < _PAGE
        condition = "contribution > $1 AND contribution <= $2"
        query = f"SELECT contribution, rows FROM {self._PACKED} WHERE {condition}"
        packed = self._fetch(query, cursor, last) if entries else []
        rows = np.frombuffer(b"".join(part for _, part in packed), OBSERVATION)
        sizes = [len(part) // OBSERVATION.itemsize for _, part in packed]
        number = np.repeat(np.array([number for number, _ in packed], np.int64), sizes)
        entry_of = np.searchsorted([entry.number for entry in entries], number)
        order = np.lexsort((rows["fix_id"], rows["time_ns"], entry_of))
        return ObservationPage(
            cursor=last, entries=tuple(entries), rows=rows[order], entry_of=entry_of[order]
        )

    def forget(self, before_ns: int, *, most: int = 1000) -> int:
        """Delete the observations of at most `most` contributions, in the order of commits; returns how many.

        Only of contributions received before `before_ns` (GPS time) that are fused. Their ledger rows stay, so
        that repeated uploads are still duplicates. A result below `most` means that none are left.
        """
        with self._transaction():
            numbers = self._received('number > forgotten AND number <= "cursor"', before_ns, most)
            if numbers:
                self._delete_observations(numbers[0], numbers[-1])
                self._fetch("UPDATE progress SET forgotten = $1", numbers[-1])
        return len(numbers)

    def prune(self, before_ns: int, *, most: int = 1000) -> int:
        """Delete at most `most` ledger rows of forgotten contributions, in the order of commits; returns how many.

        Only for contributions that the admission refuses by age: others would be stored a second time.
        """
        with self._transaction():
            numbers = self._received("number <= forgotten", before_ns, most)
            if numbers:
                self._fetch("DELETE FROM contribution WHERE number <= $1", numbers[-1])
        return len(numbers)

    def progress(self) -> FusionProgress:
        """Return the progress of the fusion."""
        (row,) = self._fetch('SELECT "cursor", revision FROM progress')
        return FusionProgress(*row)

    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """Return votes (n,) of VOTE of these surfaces (k,), or of all, sorted by surface, in the order written."""
        if surfaces is None:
            selected = self._fetch("SELECT rows FROM vote ORDER BY surface_id")
        else:
            query = f"SELECT rows FROM vote WHERE surface_id IN ({self._IDS}) ORDER BY surface_id"
            selected = self._fetch(query, json.dumps(np.unique(surfaces).tolist()))
        return np.frombuffer(b"".join(rows for (rows,) in selected), VOTE)

    def advance(self, seen: FusionProgress, step: FusionStep) -> FusionProgress:
        """Write a step of the fusion in one transaction; returns the progress after it.

        Raises OvertakenError unless the progress is still `seen`, as it was before the step's inputs were read.
        """
        votes = _votes_by_surface(step)
        after = FusionProgress(step.cursor, seen.revision + 1)
        with self._transaction():
            if self.progress() != seen:
                raise OvertakenError(f"{self.name}: others have written since revision {seen.revision}")
            self._fetch('UPDATE progress SET "cursor" = $1, revision = $2', *after)
            self._replace_votes(
                [(surface, rows) for surface, rows in votes.items() if rows],
                [surface for surface, rows in votes.items() if not rows],
            )
        return after

    def _received(self, condition: str, before_ns: int, most: int) -> list[int]:
        """Return the numbers of contributions up to the first received at `before_ns` or later."""
        query = f"SELECT number, received_ns FROM contribution, progress WHERE {condition} ORDER BY number LIMIT $1"
        received = itertools.takewhile(lambda row: row[1] < before_ns, self._fetch(query, most))
        return [number for number, _ in received]

    @abc.abstractmethod
    def _fetch(self, query: str, *parameters: object) -> list[Any]:
        """Return the rows of a query."""

    @abc.abstractmethod
    def _transaction(self) -> AbstractContextManager[object]:
        """Begin a transaction that no other one on `progress` overtakes; roll it back on any exception."""

    @abc.abstractmethod
    def _delete_observations(self, first: int, last: int) -> None:
        """Delete the observations of contributions up to `last`; `first` is the earliest that has any."""

    @abc.abstractmethod
    def _replace_votes(self, pairs: list[tuple[int, bytes]], emptied: list[int]) -> None:
        """Write the votes of surfaces, and delete those of surfaces without any."""


def ledger_row(number: int, contribution: Contribution, digest: bytes, now_ns: int) -> tuple[Any, ...]:
    """Return the ledger's columns in order; a covariance as six little-endian doubles."""
    covariance = contribution.position_covariance_enu_m2
    return (
        number,
        *contribution.name,
        digest,
        now_ns,
        len(contribution.observations),
        contribution.datum,
        contribution.map_version,
        contribution.epoch_year,
        None if covariance is None else pack("<6d", *covariance),
    )


def layout_defect(layout: Mapping[str, str]) -> str | None:
    """Return which table of a database has another layout than LAYOUT."""
    wrong = [name for name, description in LAYOUT.items() if layout.get(name) != description]
    return f"table {wrong[0]} is of another layout: {layout.get(wrong[0])}" if wrong else None


def _votes_by_surface(step: FusionStep) -> dict[int, bytes]:
    """Return the bytes of the votes of each surface of a step (empty: none are left).

    Raises ValueError for votes of another layout, or of a surface that the step does not list.
    """
    votes = np.empty(0, VOTE) if step.votes is None else step.votes
    if votes.dtype != VOTE:
        raise ValueError(f"votes of layout {votes.dtype}, expected {VOTE}")
    surfaces = np.unique(step.surfaces)
    if not np.isin(votes["surface_id"], surfaces).all():
        raise ValueError("votes of a surface that the step does not list")
    ordered = votes[np.argsort(votes["surface_id"], kind="stable")]
    ends = np.searchsorted(ordered["surface_id"], surfaces, side="right")
    parts = np.split(ordered, ends[:-1])
    return {surface: part.tobytes() for surface, part in zip(surfaces.tolist(), parts, strict=False)}

"""Interface of the stores of contributions and of the fusion's results.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from struct import pack
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from camber.map_update.admission import Refusal
from camber.map_update.contribution import Contribution, Kind

Judge = Callable[[Contribution], Refusal | None]
Rows = npt.NDArray[np.void]
Ids = npt.NDArray[np.int64]


class StoreError(RuntimeError):
    """Nothing was stored, nothing may be acknowledged; the text names the database and the cause."""


class OvertakenError(StoreError):
    """Another process has written votes since they were read: read again and continue from there."""


class Outcome(NamedTuple):
    """Result of one contribution; `refusal` is the reason of `refused`."""

    status: Literal["stored", "duplicate", "refused"]
    refusal: Refusal | None = None


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


ENTRY_COLUMNS = ("number", "vehicle", "kind", "id", "received_ns", "datum", "map_version", "epoch_year")
"""The fields of LedgerEntry."""


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
    """A database of contributions; used from one thread. Every method raises StoreError if it cannot be reached."""

    @abc.abstractmethod
    def commit(self, contributions: Sequence[Contribution], now_ns: int, judge: Judge) -> list[Outcome]:
        """Store what is new and not refused by `judge` in one transaction; returns when it is on the disk.

        A known contribution is a duplicate whatever `judge` returns: its vehicle missed the receipt. Other content
        under a known name is refused. Raises StoreError if nothing of this group was stored, or if that is unknown
        (the connection broke during the commit); sent again, it is stored once in both cases.
        """

    @abc.abstractmethod
    def check(self) -> None:
        """Raise StoreError if the database cannot be used now; reconnects if the connection was lost."""

    @abc.abstractmethod
    def counts(self) -> Counts:
        """Return the totals."""

    @abc.abstractmethod
    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """Return contributions after `cursor`: at most `limit` observations, but at least one contribution if any.

        No contribution with a smaller number is ever committed later, so continuing at `cursor` skips none.
        """

    @abc.abstractmethod
    def forget(self, before_ns: int, *, most: int) -> int:
        """Delete the observations of at most `most` contributions, in the order of commits; returns how many.

        Only of contributions received before `before_ns` (GPS time) that are fused. Their ledger rows stay, so
        that repeated uploads are still duplicates. A result below `most` means that none are left.
        """

    @abc.abstractmethod
    def prune(self, before_ns: int, *, most: int) -> int:
        """Delete at most `most` ledger rows of forgotten contributions, in the order of commits; returns how many.

        Only for contributions that the admission refuses by age: others would be stored a second time.
        """

    @abc.abstractmethod
    def progress(self) -> FusionProgress:
        """Return the progress of the fusion."""

    @abc.abstractmethod
    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """Return votes (n,) of VOTE of these surfaces (k,), or of all, sorted by surface, in the order written."""

    @abc.abstractmethod
    def advance(self, seen: FusionProgress, step: FusionStep) -> FusionProgress:
        """Write a step of the fusion in one transaction; returns the progress after it.

        Raises OvertakenError unless the progress is still `seen`, as it was before the step's inputs were read.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Disconnect from the database."""


def settle(
    contributions: Sequence[Contribution], known: Mapping[tuple[str, str, str], bytes], judge: Judge
) -> tuple[list[Outcome], list[Contribution]]:
    """Return the outcome of each contribution, given the ledger's digests `known`, and the contributions to store."""
    digests = dict(known)
    new: dict[tuple[str, str, str], Contribution] = {}
    outcomes = []
    for contribution in contributions:
        name = contribution.name
        if name in new and name not in digests:
            digests[name] = new[name].digest()
        refusal: Refusal | None = None
        if name in digests:
            if digests[name] == contribution.digest():
                outcomes.append(Outcome("duplicate"))
                continue
            text = f"{contribution.kind} {contribution.id}: other contents are stored under this id"
            refusal = Refusal("id_reused", text)
        refusal = refusal or judge(contribution)
        if refusal is not None:
            outcomes.append(Outcome("refused", refusal))
            continue
        new[name] = contribution
        outcomes.append(Outcome("stored"))
    return outcomes, list(new.values())


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


def observation_page(
    cursor: int, entries: Sequence[LedgerEntry], rows: Rows, entry_of: npt.NDArray[np.intp]
) -> ObservationPage:
    """Return an `ObservationPage` with its rows sorted."""
    order = np.lexsort((rows["fix_id"], rows["time_ns"], entry_of))
    return ObservationPage(cursor=cursor, entries=tuple(entries), rows=rows[order], entry_of=entry_of[order])


def votes_by_surface(step: FusionStep, vote: np.dtype[np.void]) -> tuple[list[int], list[bytes]]:
    """Return the surfaces of a step and the bytes of each one's votes (empty: none are left).

    Raises ValueError for votes of another layout, or of a surface that the step does not list.
    """
    votes = np.empty(0, vote) if step.votes is None else step.votes
    if votes.dtype != vote:
        raise ValueError(f"votes of layout {votes.dtype}, expected {vote}")
    surfaces = np.unique(step.surfaces)
    if not np.isin(votes["surface_id"], surfaces).all():
        raise ValueError("votes of a surface that the step does not list")
    ordered = votes[np.argsort(votes["surface_id"], kind="stable")]
    starts = np.searchsorted(ordered["surface_id"], surfaces, side="left").tolist()
    ends = np.searchsorted(ordered["surface_id"], surfaces, side="right").tolist()
    return surfaces.tolist(), [ordered[a:b].tobytes() for a, b in zip(starts, ends, strict=True)]


def forgettable(received: Sequence[tuple[int, int]], before_ns: int) -> list[int]:
    """Return the numbers of contributions (number, received_ns) up to the first received at `before_ns` or later."""
    return [number for number, _ in itertools.takewhile(lambda row: row[1] < before_ns, received)]

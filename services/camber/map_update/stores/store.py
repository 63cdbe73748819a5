"""Where contributions are kept, each once, and what the fusion has made of them; without saying in which database.

Two implementations: `sqlite_store.SqliteStore`, a file beside the service, and `postgres_store.PostgresStore`, a
server. Both hold the same, and the same tests run over both:

    contribution    the ledger: a row for each (vehicle, kind, id) with its contents' digest, numbered as committed
    observation     what a contribution brought, until the retention time is over
    vote            what the fusion has made of observations, by surface
    state           what else the fusion keeps, by name
    progress        the last contribution that the fusion has taken in, and how often it has written

A ledger row and its observations are one transaction, so a repeated upload is never counted twice. Votes, state and
progress are one transaction, so a contribution is never fused twice, nor left out.
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
from camber.map_update.contribution import OBSERVATION, Contribution, Kind

Judge = Callable[[Contribution], Refusal | None]
Rows = npt.NDArray[np.void]
Ids = npt.NDArray[np.int64]


class StoreError(RuntimeError):
    """Nothing of this was stored, nothing may be acknowledged; the text names the database and what hinders it."""


class OvertakenError(StoreError):
    """Somebody else has written votes or state since they were read: read again, and work from there."""


class Outcome(NamedTuple):
    """What became of one contribution; `refusal` says why it was refused."""

    status: Literal["stored", "duplicate", "refused"]
    refusal: Refusal | None = None


class Counts(NamedTuple):
    """How much has been stored, also of what is forgotten since."""

    contributions: int
    observations: int


class LedgerEntry(NamedTuple):
    """The ledger's row of a contribution; `number` rises in the order of commits."""

    number: int
    vehicle: str
    kind: Kind
    id: str
    received_ns: int
    datum: str
    map_version: int
    epoch_year: float


@dataclass(frozen=True, slots=True)
class ObservationPage:
    """Whole contributions in the order of commits, within each by time.

    `rows` (n,) of OBSERVATION; `heading_of` (n,) is the index into `headings` of each; `cursor` is where to go on.
    """

    cursor: int
    headings: tuple[LedgerEntry, ...]
    rows: Rows
    heading_of: npt.NDArray[np.intp]


class FusionProgress(NamedTuple):
    """How far the fusion has come: the last contribution taken in, and a count of its writes."""

    cursor: int
    revision: int


@dataclass(frozen=True, slots=True)
class FusionStep:
    """What the fusion writes at once. `votes` replace all votes of `surfaces`; a state of None is removed."""

    cursor: int
    surfaces: Ids = field(default_factory=lambda: np.empty(0, np.int64))
    votes: Rows | None = None
    state: Mapping[str, bytes | None] = field(default_factory=dict)


class Store(abc.ABC):
    """A database of contributions; used from one thread. Every method raises StoreError where it cannot be reached."""

    @abc.abstractmethod
    def commit(self, contributions: Sequence[Contribution], now_ns: int, judge: Judge) -> list[Outcome]:
        """Store what is new and not refused by `judge`, in one transaction; returns when it is on the disk.

        What is known already is a duplicate whatever `judge` would say of it now: its vehicle missed the receipt. Other
        contents under a known name are refused. Raises StoreError: then nothing of this group was stored, or it is not
        known whether it was (the connection broke on the commit); sent again, it is stored once either way.
        """

    @abc.abstractmethod
    def check(self) -> None:
        """Raise StoreError if the database cannot be used now; connects again where the connection was lost."""

    @abc.abstractmethod
    def counts(self) -> Counts:
        """How much there is."""

    @abc.abstractmethod
    def observations_after(self, cursor: int, limit: int) -> ObservationPage:
        """Contributions after `cursor`, at most `limit` observations but at least one contribution if there is one.

        No contribution with a smaller number is ever committed later, so continuing at `cursor` skips none.
        """

    @abc.abstractmethod
    def forget(self, before_ns: int, *, most: int = 1000) -> int:
        """Delete the observations of at most `most` contributions, in the order of commits.

        It goes as far as they were received before `before_ns` (GPS time) and are fused. Their ledger rows stay: what
        comes again is still a duplicate. Returns of how many; none are left when fewer than `most`.
        """

    @abc.abstractmethod
    def prune(self, before_ns: int, *, most: int = 1000) -> int:
        """Delete at most `most` rows of the ledger, in the order of commits; as `forget`, of what is forgotten already.

        Only for what the admission refuses by its age: it would be stored a second time. Returns how many.
        """

    @abc.abstractmethod
    def progress(self) -> FusionProgress:
        """How far the fusion has come."""

    @abc.abstractmethod
    def votes_of(self, surfaces: Ids | None = None) -> Rows:
        """Votes (n,) of VOTE of these surfaces (k,), or of all; ordered by surface, within one as they were written."""

    @abc.abstractmethod
    def state_of(self, name: str) -> bytes | None:
        """What the fusion keeps under a name; None: nothing."""

    @abc.abstractmethod
    def advance(self, seen: FusionProgress, step: FusionStep) -> FusionProgress:
        """Write a step of the fusion in one transaction; returns the progress after it.

        Raises OvertakenError unless the progress is still `seen`, that of before everything was read that the step was
        made from.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Leave the database."""


def settle(
    contributions: Sequence[Contribution],
    known: Mapping[tuple[str, str, str], bytes],
    judge: Judge,
) -> tuple[list[Outcome], list[Contribution]]:
    """What becomes of each, where the ledger has the digests `known`; and those to store."""
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
    """The ledger's columns, in their order; a covariance as six numbers of eight bytes, little-endian."""
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


def observed(
    cursor: int, headings: Sequence[LedgerEntry], rows: Rows, heading_of: npt.NDArray[np.intp]
) -> ObservationPage:
    """`ObservationPage` with its rows in order, however the database gave them."""
    order = np.lexsort((rows["fix_id"], rows["time_ns"], heading_of))
    return ObservationPage(cursor, tuple(headings), rows[order], heading_of[order])


def votes_by_surface(step: FusionStep, vote: np.dtype[np.void]) -> tuple[list[int], list[bytes]]:
    """The surfaces of a step, and the bytes of each one's votes (empty: none are left).

    Raises ValueError for votes of another layout, or of a surface that the step does not name.
    """
    votes = np.empty(0, vote) if step.votes is None else step.votes
    if votes.dtype != vote:
        raise ValueError(f"votes of layout {votes.dtype}, expected {vote}")
    surfaces = np.unique(step.surfaces)
    if not np.isin(votes["surface_id"], surfaces).all():
        raise ValueError("votes of a surface that the step does not name")
    ordered = votes[np.argsort(votes["surface_id"], kind="stable")]
    starts = np.searchsorted(ordered["surface_id"], surfaces, side="left").tolist()
    ends = np.searchsorted(ordered["surface_id"], surfaces, side="right").tolist()
    return surfaces.tolist(), [ordered[a:b].tobytes() for a, b in zip(starts, ends, strict=True)]


def joined(parts: Sequence[Rows]) -> Rows:
    """Observations of several arrays as one; what np.concatenate does, which compares the fields of each pair."""
    return np.frombuffer(b"".join(part.tobytes() for part in parts), OBSERVATION)


def forgettable(received: Sequence[tuple[int, int]], before_ns: int) -> list[int]:
    """The numbers of contributions (number, received_ns) up to the first that came at `before_ns` or later."""
    return [number for number, _ in itertools.takewhile(lambda row: row[1] < before_ns, received)]


def empty_rows() -> Rows:
    """No observations."""
    return np.empty(0, OBSERVATION)

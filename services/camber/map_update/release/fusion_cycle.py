"""The fusion cycle on a store: observations into votes, votes into corrections, corrections into a release.

    ingest_votes   new observations → votes, written with the progress in one transaction
    decide         all votes → decisions → a release, if corrections changed
    step           whichever of the two is due

Each step starts from the content of the store and of the releases folder, and ends with one transaction or one new
root. A process that is killed continues where it was, and of two that do the same work one finds itself overtaken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.admission import KnownRoads, Refusal, check_roads
from camber.map_update.contribution import Contribution
from camber.map_update.fusion.correction_rows import CORRECTION, NONE, Corrections
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication_decision import Decisions
from camber.map_update.fusion.votes import merge_votes
from camber.map_update.release.map_changes import map_changes, votes_by_day
from camber.map_update.release.operator_decisions import decide, roll_back
from camber.map_update.release.release_builder import ReleaseBuilder, corrections_of
from camber.map_update.release.review import ReviewFolder
from camber.map_update.stores.store import FusionStep, ObservationPage, Store
from camber.road_map.operator_keys import OperatorKeys
from camber.road_map.release_files import ReleaseFolder
from camber.road_map.road_columns import ReleaseError, rows_of_ids
from camber.schemas.fleet import MapChanges, MapDecision, MapVotes
from camber.schemas.road import ReleaseRoot

_GLOBAL = frozenset({"WGS84", "ITRF2014", "ITRF2020"})
"""Realisations that agree to about a centimetre (WGS 84 (G2139) is aligned with ITRF2014, and that with ITRF2020)."""
_SIGMA_CHANGE = 0.25
"""Chosen: σ of an unchanged height is released again when it changed by this share, so that few tiles change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestResult:
    """What one step ingested: contributions, observations, and those of the observations in another datum."""

    contributions: int = 0
    observations: int = 0
    other_datum: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionDecision:
    """The decisions of one cycle, the corrections after it, and the release in force."""

    decisions: Decisions
    corrections: Corrections
    root: ReleaseRoot
    is_new: bool


class FusionCycle:
    """The fusion of one store into the releases of one region; raises the errors of its store and its builder."""

    def __init__(
        self,
        store: Store,
        fusion: Fusion,
        builder: ReleaseBuilder,
        *,
        every_s: float,
        most_records: int,
        operators: OperatorKeys | None = None,
    ) -> None:
        self._store, self._fusion, self._builder = store, fusion, builder
        self._datum = builder.reference.manifest.datum
        self._every_ns, self._most_records = round(every_s * 1e9), most_records
        self._operators = operators
        reference = builder.reference.root.manifest_sha256
        self._review = ReviewFolder(builder.folder, operators, reference=reference)
        self._review.publish_operators()
        self._versions = builder.versions_of_reference()
        self._known_roads = KnownRoads(
            surfaces=fusion.roads,
            tiles=frozenset(builder.reference.tiles("surfaces")),
            versions=self._versions,
        )
        self._due_ns: int | None = None
        self._decided_state: object = None  # external state at the last decision; None: votes are newer

    def step(self, now_ns: int) -> IngestResult | FusionDecision | None:
        """Do one step if one is due: every `every_s` all new observations are ingested, then a decision is made.

        After a step that ingested something the next is due at once. None: nothing is due, or nothing is new.
        """
        # The second condition: a clock that was set back must not stop the fusion.
        if self._due_ns is not None and self._due_ns - self._every_ns <= now_ns < self._due_ns:
            return None
        ingested = self.ingest_votes(now_ns)
        if ingested.contributions:
            self._decided_state = None
            return ingested
        self._due_ns = now_ns + self._every_ns
        if self._decided_state is not None and self._decided_state == self._external_state():
            return None
        return self.decide(now_ns)

    def ingest_votes(self, now_ns: int) -> IngestResult:
        """Make votes of at most about `most_records` observations; an empty result: none are left."""
        progress = self._store.progress()
        page = self._store.observations_after(progress.cursor, self._most_records)
        if page.cursor == progress.cursor:
            return IngestResult()
        comparable = self._has_comparable_datum(page)
        rows, entry_of = page.rows[comparable], page.entry_of[comparable]
        voters = np.array([self._fusion.voter_of(entry.vehicle) for entry in page.entries], np.int64)
        new = self._fusion.votes_from(rows, voters[entry_of])
        surfaces = np.unique(new["surface_id"])
        votes = new
        if len(surfaces):
            votes = self._fusion.thin(merge_votes(self._store.votes_of(surfaces), new), now_ns)
        self._store.advance(progress, FusionStep(cursor=page.cursor, surfaces=surfaces, votes=votes))
        return IngestResult(
            contributions=len(page.entries),
            observations=len(page.rows),
            other_datum=int(len(page.rows) - comparable.sum()),
        )

    def decide(self, now_ns: int) -> FusionDecision:
        """Decide on all surfaces with votes, and make the next release if anything changed.

        The first release is always made: the reference itself. OvertakenError if another was made meanwhile.
        """
        current = self._builder.current()
        before = NONE if current is None else corrections_of(current.source, current.manifest)
        votes = merge_votes(self._store.votes_of())
        automatic = self._fusion.decide(votes, before["surface_id"], before["offset_m"], now_ns)
        previous = None if current is None else current.root
        with (
            self._review.locked()
        ):  # nobody decides between what is applied here and what is known to be applied
            decisions = self._review.apply(automatic, now_ns, self._fusion.neighbourhood)
            corrections = corrections_after(before, decisions)
            root = self._builder.build(corrections, time_ns=now_ns, previous=previous)
            self._decided_state = self._external_state()
        self._versions.add(root.map_version)
        return FusionDecision(
            decisions=decisions,
            corrections=self._builder.corrections(),
            root=root,
            is_new=root != previous,
        )

    def refusal(self, contribution: Contribution) -> Refusal | None:
        """Return why a contribution cannot be of the roads of this map, or None."""
        return check_roads(contribution, self._known_roads)

    def changes(self, decided: FusionDecision, now_ns: int) -> MapChanges:
        """The changes that a decision holds, publishes and alarms, with their places."""
        return map_changes(
            decided.decisions,
            decided.corrections,
            self._fusion.neighbourhood,
            root=decided.root,
            reference_sha256=self._builder.reference.root.manifest_sha256,
            time_ns=now_ns,
        )

    def is_of_this_map(self, decision: MapDecision) -> bool:
        """Return whether a decision is on the map of this worker."""
        return decision.reference_sha256 == self._builder.reference.root.manifest_sha256

    def carry_out(self, decision: MapDecision, now_ns: int) -> None:
        """Record an operator's decision and make the next step due; ReleaseError for one that is refused."""
        if self._operators is None:
            raise ReleaseError(
                "map_update", "operator_keys", "keys of operators: without them nobody can decide"
            )
        if decision.action == "roll_back":
            builder, operators = self._builder, self._operators
            roll_back(self._review, decision, builder, time_ns=now_ns, operators=operators)
        else:
            decide(self._review, [decision], now_ns=now_ns, operators=self._operators)
        self._due_ns = None

    def votes_over_time(self, surface_id: int, now_ns: int) -> MapVotes:
        """The votes on a surface by day."""
        votes = merge_votes(self._store.votes_of(np.array([surface_id], np.int64)))
        return votes_by_day(votes, time_ns=now_ns)

    def _external_state(self) -> tuple[object, object]:
        """Return what others may change: the release in force (by a roll-back) and the reviewers' decisions."""
        return ReleaseFolder(self._builder.folder).stamp(), self._review.size()

    def _has_comparable_datum(self, page: ObservationPage) -> NDArray[np.bool_]:
        """Return which observations (n,) are in a datum that is comparable with the reference's."""
        datums = _GLOBAL if self._datum in _GLOBAL else frozenset({self._datum})
        comparable = np.array([entry.datum in datums for entry in page.entries], bool)
        result: NDArray[np.bool_] = comparable[page.entry_of] if len(comparable) else np.zeros(0, bool)
        return result


def corrections_after(before: Corrections, decisions: Decisions) -> Corrections:
    """Return the corrections after decisions.

    A published or withdrawn height gets a row, also at an offset of 0, because its σ is smaller than the reference's.
    A confirmed height gets a new σ only if it changed notably. All other rows stay.
    """
    rows = decisions.surfaces
    at = rows_of_ids(before["surface_id"], rows["surface_id"])
    present = at >= 0
    offset_m = np.zeros(len(rows))
    offset_m[present] = before["offset_m"][at[present]]
    sigma_m = np.full(len(rows), np.inf)
    sigma_m[present] = before["sigma_m"][at[present]]
    has_sigma = np.isfinite(rows["sigma_m"])
    moved = has_sigma & (np.abs(rows["correction_m"] - offset_m) > 0.0)
    notable = has_sigma & ~(np.abs(rows["sigma_m"] - sigma_m) <= _SIGMA_CHANGE * sigma_m)
    chosen = np.flatnonzero(moved | notable)
    new = np.zeros(len(chosen), CORRECTION)
    new["surface_id"] = rows["surface_id"][chosen]
    new["offset_m"], new["sigma_m"] = rows["correction_m"][chosen], rows["sigma_m"][chosen]
    new["vehicles"] = rows["vehicles"][chosen]
    new["last_seen_ns"] = rows["last_session"][chosen] * NS_PER_DAY
    unchanged = before[~np.isin(before["surface_id"], new["surface_id"])]
    return np.sort(np.concatenate([unchanged, new]), order="surface_id")

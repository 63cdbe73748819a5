"""What the fusion does with a store: observations into votes, votes into corrections, those into a release.

    take_in    observations after the last ones → votes, written with the progress in one transaction
    decide     all votes → decisions → a release with other corrections, if there are any
    step       the one or the other, when it is due

Each step starts from what the store and the folder of releases hold, and ends with one transaction or one new root. So
a process that is killed at any moment goes on where it was, and of two that do the same one finds itself overtaken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.map_update.fusion.corrections import CORRECTION, Corrections, rows_of
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication import Decisions
from camber.map_update.fusion.votes import DAY_NS
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.map_update.release.review import ReviewFolder
from camber.map_update.stores.store import FusionStep, ObservationPage, Rows, Store
from camber.road_map.release_files import ReleaseFolder
from camber.schemas.road import ReleaseRoot

_GLOBAL = frozenset({"WGS84", "ITRF2014", "ITRF2020"})
"""Realisations that agree to about a centimetre (WGS 84 (G2139) is aligned with ITRF2014, and that with ITRF2020)."""
_NEWS = 0.25
"""σ of a height that was not touched is told anew when it has changed by this share: no tile changes for less."""


@dataclass(frozen=True, slots=True)
class IngestResult:
    """What one step took in: contributions and observations, and of the latter those of another datum."""

    contributions: int = 0
    observations: int = 0
    other_datum: int = 0


@dataclass(frozen=True, slots=True)
class FusionDecision:
    """What came of one round: the release in force after it, and whether it is a new one."""

    decisions: Decisions
    root: ReleaseRoot
    made: bool


class FusionCycle:
    """The fusion of one store into the releases of one region; raises what its store and its making raise."""

    def __init__(
        self,
        store: Store,
        fusion: Fusion,
        making: ReleaseBuilder,
        *,
        every_s: float = 60.0,
        most: int = 200_000,
    ) -> None:
        self._store, self._fusion, self._making = store, fusion, making
        self._datum = making.reference.manifest.datum
        self._every_ns, self._most = round(every_s * 1e9), most
        self._review = ReviewFolder(making.folder)
        self._due_ns: int | None = None
        self._decided_by: object = None  # what the last round rested on, besides votes; None: there was none

    def step(self, now_ns: int) -> IngestResult | FusionDecision | None:
        """One step where one is due: every `every_s` all that has come is taken in, then decided, if there was any.

        After a step that took something in the next is due at once. None: nothing is due, or nothing is new.
        """
        # A clock that was set back must not stop the fusion.
        if self._due_ns is not None and self._due_ns - self._every_ns <= now_ns < self._due_ns:
            return None
        taken = self.ingest_votes(now_ns, self._most)
        if taken.contributions:
            self._decided_by = None
            return taken
        self._due_ns = now_ns + self._every_ns
        if self._decided_by is not None and self._decided_by == self._given():
            return None
        found = self.decide(now_ns)
        self._decided_by = self._given()
        return found

    def ingest_votes(self, now_ns: int, most: int) -> IngestResult:
        """Make votes of at most some `most` observations; nothing taken: there are none left."""
        seen = self._store.progress()
        found = self._store.observations_after(seen.cursor, most)
        if found.cursor == seen.cursor:
            return IngestResult()
        of_datum = self._of_our_datum(found)
        rows, heading_of = found.rows[of_datum], found.heading_of[of_datum]
        voters = np.array([self._fusion.voter_of(heading.vehicle) for heading in found.headings], np.int64)
        new = self._fusion.votes_of_voters(rows, voters[heading_of])
        surfaces = np.unique(new["surface_id"])
        votes = new
        if len(surfaces):
            votes = self._fusion.kept(self._fusion.merge(self._store.votes_of(surfaces), new), now_ns)
        self._store.advance(seen, FusionStep(found.cursor, surfaces, votes))
        return IngestResult(len(found.headings), len(found.rows), int(len(found.rows) - of_datum.sum()))

    def decide(self, now_ns: int) -> FusionDecision:
        """Decide of all surfaces with votes, and make the release that follows, if there is anything new.

        The first is made whatever is decided: the reference itself, for vehicles to take.
        """
        before = self._making.corrections()
        votes = self._fusion.merge(self._store.votes_of())
        found = self._fusion.decide(votes, before["surface_id"], before["offset_m"], now_ns)
        decisions = self._review.judged(found, now_ns)
        current = self._making.current()
        root = self._making.make(corrections_after(before, decisions), time_ns=now_ns)
        return FusionDecision(decisions, root, made=current is None or root != current.root)

    def _given(self) -> tuple[object, object]:
        """What others may change: the release in force, by a roll-back, and what people have decided."""
        return ReleaseFolder(self._making.folder).stamp(), len(self._review.decisions())

    def _of_our_datum(self, found: ObservationPage) -> NDArray[np.bool_]:
        """Which observations (n,) are in a datum that the reference's heights can be compared with."""
        alike = _GLOBAL if self._datum in _GLOBAL else frozenset({self._datum})
        ours = np.array([heading.datum in alike for heading in found.headings], bool)
        result: NDArray[np.bool_] = ours[found.heading_of] if len(ours) else np.zeros(0, bool)
        return result


def corrections_after(before: Corrections, decisions: Decisions) -> Corrections:
    """The corrections that decisions make of those before.

    A height that is published or withdrawn gets its row, also at an offset of 0: its σ is known better than the
    reference's. One that many have confirmed gets a new σ only where that is news. All other rows stay.
    """
    rows: Rows = decisions.surfaces
    at = rows_of(before, rows["surface_id"])
    there = at >= 0
    offset_m = np.zeros(len(rows))
    offset_m[there] = before["offset_m"][at[there]]
    sigma_m = np.full(len(rows), np.inf)
    sigma_m[there] = before["sigma_m"][at[there]]
    said = np.isfinite(rows["sigma_m"])
    moved = said & (np.abs(rows["correction_m"] - offset_m) > 0.0)
    news = said & ~(np.abs(rows["sigma_m"] - sigma_m) <= _NEWS * sigma_m)
    chosen = np.flatnonzero(moved | news)
    new = np.zeros(len(chosen), CORRECTION)
    new["surface_id"] = rows["surface_id"][chosen]
    new["offset_m"], new["sigma_m"] = rows["correction_m"][chosen], rows["sigma_m"][chosen]
    new["vehicles"] = rows["vehicles"][chosen]
    new["last_seen_ns"] = rows["last_session"][chosen] * DAY_NS
    stays = before[~np.isin(before["surface_id"], new["surface_id"])]
    return np.sort(np.concatenate([stays, new]), order="surface_id")

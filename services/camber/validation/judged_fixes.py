"""Fixes and the verdicts on them, put together again from a recording."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from camber.formats.drive.recording import Recorded
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Verdict

CONFIRMED_WORDS = ("confirmed", "confirmed_after_verification")


@dataclass(frozen=True, slots=True)
class Judged:
    """A fix with a verdict on it, a fix without one, or a verdict on an epoch without a fix."""

    fix: Fix | None
    verdict: Verdict | None
    fix_arrival_ns: int | None = None
    verdict_arrival_ns: int | None = None

    @property
    def time_ns(self) -> int:
        """Of the fix, or of the epoch."""
        if self.fix is not None:
            return self.fix.time_ns
        assert self.verdict is not None
        return self.verdict.time_ns

    @property
    def tentative(self) -> bool:
        """Whether this is a fix that passed the ratio test."""
        return self.fix is not None and self.fix.quality == "fixed"

    @property
    def word(self) -> str:
        """The verdict's word; `no_verdict` where nothing was said, which is not trust either."""
        return "no_verdict" if self.verdict is None else self.verdict.verdict

    @property
    def confirmed(self) -> bool:
        """Whether consumers were given this as a position."""
        return self.word in CONFIRMED_WORDS

    @property
    def confirmed_position(self) -> tuple[float, float, float] | None:
        """What was confirmed (latitude, longitude, height): the verdict's, maybe a new estimate, else the fix's."""
        if not self.confirmed or self.verdict is None:
            return None
        for message in (self.verdict, self.fix):
            if message is not None:
                latitude, longitude, height = message.latitude_rad, message.longitude_rad, message.height_m
                if latitude is not None and longitude is not None and height is not None:
                    return latitude, longitude, height
        return None


def put_together(fixes: Iterable[Recorded[Fix]], verdicts: Iterable[Recorded[Verdict]]) -> list[Judged]:
    """One row for every verdict and for every fix without one, in the order of time.

    A fix that was published again (same id, same time) counts once. A verdict belongs to the fix of its id;
    where a restarted gnss has used an id twice, to the one nearest in time. A second verdict on a fix is a
    row of its own: consumers had it.
    """
    by_id: dict[int, list[Recorded[Fix]]] = defaultdict(list)
    for fix in fixes:
        same_id = by_id[fix.message.fix_id]
        if all(other.message.time_ns != fix.message.time_ns for other in same_id):
            same_id.append(fix)
    rows: list[Judged] = []
    judged: set[tuple[int, int]] = set()
    for verdict in verdicts:
        found = _nearest(by_id, verdict.message)
        if found is None:
            rows.append(Judged(None, verdict.message, None, verdict.arrival_ns))
        else:
            judged.add((found.message.fix_id, found.message.time_ns))
            rows.append(Judged(found.message, verdict.message, found.arrival_ns, verdict.arrival_ns))
    for same_id in by_id.values():
        for fix in same_id:
            if (fix.message.fix_id, fix.message.time_ns) not in judged:
                rows.append(Judged(fix.message, None, fix.arrival_ns, None))
    return sorted(rows, key=lambda row: row.time_ns)


def _nearest(by_id: dict[int, list[Recorded[Fix]]], verdict: Verdict) -> Recorded[Fix] | None:
    candidates: Sequence[Recorded[Fix]] = by_id.get(verdict.fix_id, ()) if verdict.fix_id is not None else ()
    return min(candidates, key=lambda fix: abs(fix.message.time_ns - verdict.time_ns), default=None)

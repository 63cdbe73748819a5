"""Fixes of a recording paired with their verdicts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from camber.formats.drive.recording import Recorded
from camber.schemas.gnss import Fix
from camber.schemas.integrity import CONFIRMED_VERDICTS, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedFix:
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
    def verdict_name(self) -> str:
        """The verdict, or `no_verdict`, which is no confirmation either."""
        return "no_verdict" if self.verdict is None else self.verdict.verdict

    @property
    def confirmed(self) -> bool:
        """Whether consumers were given this as a confirmed position."""
        return self.verdict_name in CONFIRMED_VERDICTS

    @property
    def confirmed_position(self) -> tuple[float, float, float] | None:
        """Latitude, longitude, height of the verdict (a re-estimated position, maybe), else of the fix."""
        if not self.confirmed or self.verdict is None:
            return None
        for message in (self.verdict, self.fix):
            if message is not None:
                latitude, longitude, height = message.latitude_rad, message.longitude_rad, message.height_m
                if latitude is not None and longitude is not None and height is not None:
                    return latitude, longitude, height
        return None


def pair_fixes_with_verdicts(
    fixes: Iterable[Recorded[Fix]], verdicts: Iterable[Recorded[Verdict]]
) -> list[JudgedFix]:
    """One row for every verdict and for every fix without one, in the order of time.

    A fix that was published again (same id, same time) counts once. A verdict belongs to the fix of its id, or, where
    a restarted gnss used the id twice, to the one nearest in time. A second verdict on a fix has a row of its own.
    """
    by_id: dict[int, list[Recorded[Fix]]] = defaultdict(list)
    for fix in fixes:
        same_id = by_id[fix.message.fix_id]
        if all(other.message.time_ns != fix.message.time_ns for other in same_id):
            same_id.append(fix)
    rows: list[JudgedFix] = []
    judged: set[tuple[int, int]] = set()
    for verdict in verdicts:
        judged_fix = _nearest(by_id, verdict.message)
        if judged_fix is not None:
            judged.add((judged_fix.message.fix_id, judged_fix.message.time_ns))
        rows.append(
            JudgedFix(
                fix=None if judged_fix is None else judged_fix.message,
                verdict=verdict.message,
                fix_arrival_ns=None if judged_fix is None else judged_fix.arrival_ns,
                verdict_arrival_ns=verdict.arrival_ns,
            )
        )
    for same_id in by_id.values():
        for fix in same_id:
            if (fix.message.fix_id, fix.message.time_ns) not in judged:
                rows.append(JudgedFix(fix=fix.message, verdict=None, fix_arrival_ns=fix.arrival_ns))
    return sorted(rows, key=lambda row: row.time_ns)


def _nearest(by_id: dict[int, list[Recorded[Fix]]], verdict: Verdict) -> Recorded[Fix] | None:
    candidates: Sequence[Recorded[Fix]] = by_id.get(verdict.fix_id, ()) if verdict.fix_id is not None else ()
    return min(candidates, key=lambda fix: abs(fix.message.time_ns - verdict.time_ns), default=None)

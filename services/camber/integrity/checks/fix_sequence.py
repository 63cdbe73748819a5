"""Each fix has one verdict: ids and times of the fixes received, to detect late, early and repeated ones."""

from __future__ import annotations

from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason

_REMEMBERED = 1024  # ids; minutes at any rate of a receiver


class FixSequence:
    """Ids and times of the fixes received so far."""

    def __init__(self) -> None:
        self.last_ns: int | None = None
        """Time of the last solution, of whatever quality."""
        self._ids: dict[int, None] = {}

    def register_once(self, fix: Fix) -> bool:
        """Was a fix of this id judged already? Else it counts as judged from now on."""
        if fix.fix_id in self._ids:
            return True
        self._ids[fix.fix_id] = None
        if len(self._ids) > _REMEMBERED:
            del self._ids[next(iter(self._ids))]
        return False

    def check_epoch(self, fix: Fix, now_ns: int, rules: Rules) -> Reason | None:
        """Why the fix cannot be judged at its place in time; one dated ahead leaves no trace here."""
        ahead_s = (fix.time_ns - now_ns) / 1e9
        if ahead_s > rules.future_limit_s:
            return "fix_implausible"
        last_ns = self.last_ns
        self.last_ns = fix.time_ns if last_ns is None else max(last_ns, fix.time_ns)
        if not -ahead_s <= rules.fix_max_age_s:
            return "gnss_stale"
        if last_ns is None or fix.time_ns > last_ns:
            return None
        return "fix_repeated" if fix.time_ns == last_ns else "fix_out_of_order"

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this: the clock was set back."""
        if self.last_ns is not None and self.last_ns > limit_ns:
            self.last_ns = None

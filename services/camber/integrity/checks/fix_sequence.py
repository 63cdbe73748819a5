"""Checks of a fix by itself as it arrives: its time among those received, its quality and what it claims."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from camber.integrity.checks.pose_offset import claimed_sigma_m
from camber.integrity.epoch_inputs import Check, age_s, first_reason
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason

_REMEMBERED = 1024  # ids; minutes at any rate of a receiver


@dataclass(frozen=True, slots=True, kw_only=True)
class FixArrival:
    """A fix, and the time of the newest solution before it, of whatever quality."""

    fix: Fix
    previous_ns: int | None


def _is_ahead(arrival: FixArrival, now_ns: int, rules: Rules) -> bool:
    return age_s(arrival.fix.time_ns, now_ns) < -rules.future_limit_s


def _has_no_valid_claim(arrival: FixArrival, now_ns: int, rules: Rules) -> bool:
    fix = arrival.fix
    position = (fix.latitude_rad, fix.longitude_rad, fix.height_m)
    if fix.covariance_enu_m2 is None or not all(map(math.isfinite, position)):
        return True
    return not claimed_sigma_m(fix.covariance_enu_m2) <= rules.fix_sigma_limit_m


_ROWS: tuple[tuple[Reason, str, Callable[[FixArrival, int, Rules], bool]], ...] = (
    ("fix_implausible", "dated more than 0.5 s ahead of the clock", _is_ahead),
    (
        "gnss_stale",
        "older than 0.5 s",
        lambda arrival, now_ns, rules: not age_s(arrival.fix.time_ns, now_ns) <= rules.fix_max_age_s,
    ),
    (
        "fix_repeated",
        "another solution of the newest epoch",
        lambda arrival, _, __: arrival.fix.time_ns == arrival.previous_ns,
    ),
    (
        "fix_out_of_order",
        "of an earlier epoch than the newest solution",
        lambda arrival, _, __: arrival.fix.time_ns < (arrival.previous_ns or 0),
    ),
    ("not_a_fix", "quality other than *fixed*", lambda arrival, _, __: arrival.fix.quality != "fixed"),
    (
        "fix_implausible",
        "no valid covariance, or a σ above `fix_sigma_limit_m` in any direction: resolved integers give centimetres",
        _has_no_valid_claim,
    ),
)
ARRIVAL_CHECKS: tuple[Check[FixArrival], ...] = tuple(
    Check(reason=reason, explanation=explanation, applies=applies) for reason, explanation, applies in _ROWS
)


class FixSequence:
    """Ids and times of the fixes received so far: each fix has one verdict."""

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

    def check_arrival(self, fix: Fix, now_ns: int, rules: Rules) -> Reason | None:
        """Return why a fix cannot be tested; one dated ahead leaves no trace here."""
        arrival = FixArrival(fix=fix, previous_ns=self.last_ns)
        if not _is_ahead(arrival, now_ns, rules):
            self.last_ns = max(fix.time_ns, self.last_ns or fix.time_ns)
        return first_reason(ARRIVAL_CHECKS, arrival, now_ns, rules)

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this: the clock was set back."""
        if self.last_ns is not None and self.last_ns > limit_ns:
            self.last_ns = None

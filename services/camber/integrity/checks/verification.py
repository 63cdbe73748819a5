"""Verification (JP7707657B2, second embodiment): what supports a fix although the height contradicts it?

If the fix is right all the same, it is the height model that is off, map or antenna. There are four kinds of evidence:

- **time series**: it has moved since the last right fix as the vehicle has (`time_series.py`);
- **ambiguity continuity**: its integers are those of fixes that the height has confirmed, on unbroken arcs. Then all
  of them are right or all are wrong, and the height has tested several of them already;
- **scan matching**: it is where the sweeps find the vehicle, by centimetres, horizontally;
- **phase residuals**: its own phases fit its integers, and there are enough of them.

The first two say why the *height* may be wrong, and each is enough. Scan matching alone is not: of wrong fixes with a
horizontal error of σ 1 m some 2 % lie within 0.2 m of the truth, and one of the recording of Nagoya does, half a metre
too low; that is about as often as a map is half a metre off. Neither are the residuals alone, for sets of integers that
fit and are wrong are why there is a judge. Both together are: what fits ten ambiguities is wrong in one case of a
hundred or fewer, and the two do not know of one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from camber.schemas.gnss import Fix
from camber.schemas.integrity import Evidence
from camber.schemas.pose import Pose

VerificationEvidence = Literal[
    "time_series", "ambiguity_continuity", "scan_matching", "phase_residuals", "scan_and_phase"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationRules:
    """Which evidence suffices, and when it counts.

    A fix whose σ, multipath included, is above `fix_sigma_m` in any direction is not verified and vouches for none.
    `continuity_fixes` of the chain must have been confirmed by the height, the last at most `continuity_s` ago; the
    pose of a scan match is at most `scan_sigma_m` wide; residuals count from `phase_ambiguities` resolved ones on.
    """

    enough: tuple[VerificationEvidence, ...] = ("time_series", "ambiguity_continuity", "scan_and_phase")
    fix_sigma_m: float = 0.15
    continuity_fixes: int = 5
    continuity_s: float = 30.0
    scan_sigma_m: float = 0.15
    phase_ambiguities: int = 10


def verified(evidence: frozenset[Evidence], rules: VerificationRules) -> bool:
    """Does this evidence suffice?"""
    if "scan_and_phase" in rules.enough and {"scan_matching", "phase_residuals"} <= evidence:
        return True
    return any(name in rules.enough for name in evidence)


def scan_matching_agrees(
    pose: Pose, pose_sigma_m: float, at_ns: int, max_age_s: float, limit_m: float
) -> bool:
    """Is the pose, with which the fix agrees, that of a fresh scan match, and narrow?"""
    if pose.mode != "scan_match" or pose.match_time_ns is None:
        return False
    return abs(at_ns - pose.match_time_ns) <= max_age_s * 1e9 and pose_sigma_m <= limit_m


def phase_residuals_agree(fix: Fix, rules: VerificationRules) -> bool:
    """Do its phases fit its integers, and are there enough of them that others would not?"""
    enough = fix.ambiguities_fixed is not None and fix.ambiguities_fixed >= rules.phase_ambiguities
    return fix.phase_residuals == "consistent" and enough


@dataclass(frozen=True, slots=True, kw_only=True)
class AmbiguityHistory:
    """What is remembered of the integers of the fixes so far: of the chain that the height has confirmed.

    `confirmed` fixes of it were, from `first_ns` to `last_ns`; `newest` says whether the fix before was one of them.
    A chain that contradicts it began at `disputed_ns`.
    """

    confirmed: int = 0
    first_ns: int = 0
    last_ns: int = 0
    newest: bool = False
    disputed_ns: int | None = None

    def carry(self, fix: Fix, rules: VerificationRules) -> bool:
        """Are the integers of this fix those of fixes that the height has confirmed?"""
        return (
            self._goes_on(fix)
            and self.confirmed >= rules.continuity_fixes
            and 0 < fix.time_ns - self.last_ns <= rules.continuity_s * 1e9
        )

    def contradict(self, fix: Fix, lasts_s: float) -> bool:
        """Are they others than those of a fix that was confirmed just before, on the same arcs? One of both is wrong.

        It counts for the fix after, and for those whose integers are the same as its, for `lasts_s`: by then the pose,
        the height and the wheels have had their say on the new ones as on any others.
        """
        if not self.confirmed or not 0 < fix.time_ns - self.last_ns <= lasts_s * 1e9:
            return False
        if fix.ambiguity_continuity == "broken":
            return self.newest
        since_ns = fix.continuous_since_ns
        return (
            fix.ambiguity_continuity == "continuous" and since_ns is not None and since_ns == self.disputed_ns
        )

    def after(self, fix: Fix, *, confirmed: bool, contradicted: bool) -> AmbiguityHistory:
        """The memory after the verdict on one more fix; `confirmed`: by its height, not by its integers."""
        if contradicted:
            return replace(self, newest=False, disputed_ns=fix.continuous_since_ns)
        if not confirmed:
            return replace(self, newest=False)
        if self._goes_on(fix):
            return replace(
                self, confirmed=self.confirmed + 1, last_ns=fix.time_ns, newest=True, disputed_ns=None
            )
        return AmbiguityHistory(confirmed=1, first_ns=fix.time_ns, last_ns=fix.time_ns, newest=True)

    def _goes_on(self, fix: Fix) -> bool:
        if fix.ambiguity_continuity != "continuous" or fix.continuous_since_ns is None or not self.confirmed:
            return False
        return fix.continuous_since_ns <= self.first_ns

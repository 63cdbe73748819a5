"""That what fixes and pose stand on is a wrong fix that has passed all tests.

Confirmed fixes anchor the pose: one that was wrong and has passed has pulled it along, and agrees with it afterwards.
The hypothesis fades as episodes of wrong fixes end, which a pose that has been pulled along would show, and where scan
matching agrees with the pose place after place.

How far off such a fix may be depends on how well the pose was known then: metres at the start, centimetres later. Both
are kept, by classes of the offset's variance, four to a factor of two, and rounded up. One variance for all would be
that of the many narrow ones; what reaches beyond the alert limit at a risk of 1e-7 are the few wide ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent
from camber.integrity.protection.wrong_fix_probability import WrongFixRules, log_odds_of_share
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose

_MATCH_SIGMAS = 4.0  # σ of a match that lie within the offset of the latent fault
_CLASSES = 4
"""To a factor of two of the variance. Chosen: 9 % of σ is the most that rounding adds."""
_LEAST_M2 = 2.0**-8
"""Chosen: variances up to it, σ 6 cm, are one class; it is what a right fix is off by."""
_LEAST_ODDS = 1e-14
"""Chosen: a ten-millionth of an integrity risk of 1e-7; what is less likely is not kept."""


def is_same_draw(fix: Fix, last_ns: int | None) -> bool:
    """Are a fix's integers those of the fix at `last_ns`, carried on by the engine?

    Then both are right or both are wrong: it is no further draw from the share of wrong fixes, and that it agrees with
    the one before says nothing.
    """
    since_ns = fix.continuous_since_ns
    if fix.ambiguity_mode != "carried" or fix.ambiguity_continuity != "continuous" or since_ns is None:
        return False
    return last_ns is not None and since_ns <= last_ns


class LatentFaultPart(NamedTuple):
    """Wrong fixes of one class: odds, and mean squares of the offset (each axis, upwards) [m²].

    `marked_odds`: the share of `odds` that was there at the last `marked`.
    """

    odds: float
    horizontal_m2: float
    up_m2: float
    marked_odds: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentFaultHypothesis:
    """That what fixes and pose stand on is a wrong fix, by how far it is off: the widest class first.

    `time_ns` None: no fix has been confirmed yet.
    """

    time_ns: int | None
    parts: tuple[LatentFaultPart, ...]

    @classmethod
    def initial(cls, rules: WrongFixRules) -> LatentFaultHypothesis:
        """Of a pose that rests on fixes of which nothing is known here."""
        odds = math.exp(log_odds_of_share(rules.prior))
        parts = [
            LatentFaultPart(odds=share * odds, horizontal_m2=east_m2, up_m2=up_m2)
            for share, (east_m2, _, up_m2) in rules.parts
        ]
        return cls(time_ns=None, parts=_by_class(parts))

    @property
    def odds(self) -> float:
        """Odds of all classes together."""
        return sum(part.odds for part in self.parts)

    def remaining_share(self, time_ns: int, rules: WrongFixRules, *, same_draw: bool = False) -> float:
        """The share of it that is left at a later time: episodes of wrong fixes end, but not while integers last."""
        if self.time_ns is None:
            return 0.0
        if same_draw:
            return 1.0
        return math.exp(-max(time_ns - self.time_ns, 0) / (rules.episode_s * 1e9))

    def after(
        self,
        time_ns: int,
        odds: float,
        wrong: Sequence[MixtureComponent],
        rules: WrongFixRules,
        *,
        same_draw: bool = False,
    ) -> LatentFaultHypothesis:
        """After a confirmed fix: the episode may have lasted, or another have begun since the fix before.

        `odds` are those of the fix by itself, `wrong` is how far off it is if it is wrong, by shares of one. With
        `same_draw` (`is_same_draw`) the episode has lasted, and no other has begun.
        """
        remaining_share = self.remaining_share(time_ns, rules, same_draw=same_draw)
        lasted = [
            LatentFaultPart(
                remaining_share * part.odds,
                part.horizontal_m2,
                part.up_m2,
                remaining_share * part.marked_odds,
            )
            for part in self.parts
        ]
        begun = (1.0 - remaining_share) * odds
        return LatentFaultHypothesis(
            time_ns=time_ns, parts=_by_class([*lasted, *(_begun(part, begun) for part in wrong)])
        )

    def marked(self) -> LatentFaultHypothesis:
        """The same; `corroborated` is about what is there now."""
        return replace(self, parts=tuple(part._replace(marked_odds=part.odds) for part in self.parts))

    def corroborated(self, least_m2: float, rules: LevelRules) -> LatentFaultHypothesis:
        """After a scan match has found the pose where it is: what is left of what was marked would take a wrong match.

        Of classes from `least_m2` on alone: the match says nothing of less.
        """
        wrong = 1.0 - rules.false_match_prior
        parts = [
            part._replace(odds=part.odds - wrong * part.marked_odds, marked_odds=0.0)
            if part.horizontal_m2 >= least_m2
            else part
            for part in self.parts
        ]
        return replace(self, parts=tuple(parts))

    def components(self, share: float, least: float = 0.0) -> tuple[MixtureComponent, ...]:
        """What was pulled along, `share` of its odds as weights; those of `least` or less are left out."""
        return tuple(
            MixtureComponent(share * odds, (horizontal_m2, 0.0, horizontal_m2), up_m2, is_latent=True)
            for odds, horizontal_m2, up_m2, _ in self.parts
            if share * odds > least
        )


def _begun(wrong: MixtureComponent, odds: float) -> LatentFaultPart:
    (east_m, north_m, up_m), (ee, _, nn) = wrong.mean_m, wrong.horizontal_m2
    return LatentFaultPart(
        odds=wrong.weight * odds,
        horizontal_m2=max(east_m * east_m + ee, north_m * north_m + nn),
        up_m2=up_m * up_m + wrong.up_m2,
    )


def _by_class(parts: Sequence[LatentFaultPart]) -> tuple[LatentFaultPart, ...]:
    """One part for each class, the widest first; heights are averaged within it."""
    classes: dict[int, LatentFaultPart] = {}
    for part in parts:
        if not part.odds > _LEAST_ODDS:
            continue
        number = math.ceil(_CLASSES * math.log2(max(part.horizontal_m2, _LEAST_M2)))
        before = classes.get(number)
        if before is None:
            classes[number] = LatentFaultPart(part.odds, 2.0 ** (number / _CLASSES), *part[2:])
            continue
        odds = before.odds + part.odds
        up_m2 = before.up_m2 + part.odds / odds * (part.up_m2 - before.up_m2)
        marked_odds = before.marked_odds + part.marked_odds
        classes[number] = LatentFaultPart(odds, before.horizontal_m2, up_m2, marked_odds)
    return tuple(classes[number] for number in sorted(classes, reverse=True))


class MatchCorroboration:
    """Scan matches that agree with the pose, so far apart that what makes one wrong is gone at the next.

    Only a match counts that is newer than the hypothesis, and precise compared with its offset.
    """

    def __init__(self, rules: LevelRules) -> None:
        self._rules = rules
        self._last: tuple[float, float] | None = None
        self._marked_ns: int | None = None

    def update(self, pose: Pose, latent_fault: LatentFaultHypothesis) -> LatentFaultHypothesis:
        """The fault hypothesis after a pose."""
        if pose.mode != "scan_match" or pose.latitude_rad is None or pose.longitude_rad is None:
            return latent_fault
        here = pose.latitude_rad, pose.longitude_rad
        if self._last is None:
            self._last = here
        if self._marked_ns is None:
            far = math.hypot(*east_north_between(*self._last, *here)) >= self._rules.matches_apart_m
            if not far or latent_fault.time_ns is None:
                return latent_fault
            self._marked_ns = latent_fault.time_ns
            return latent_fault.marked()
        newer = pose.match_time_ns is not None and pose.match_time_ns > self._marked_ns
        least_m2 = _MATCH_SIGMAS**2 * _larger_m2(pose)
        if not newer or not any(part.horizontal_m2 >= least_m2 for part in latent_fault.parts):
            return latent_fault
        self._last, self._marked_ns = here, None
        return latent_fault.corroborated(least_m2, self._rules)


def _larger_m2(pose: Pose) -> float:
    """The larger eigenvalue of the position's covariance; not a number without one."""
    if pose.covariance_east_north_yaw is None:
        return math.nan
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    larger_m2: float = larger_eigenvalue(ee, en, nn)
    return larger_m2

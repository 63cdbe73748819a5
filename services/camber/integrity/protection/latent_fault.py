"""That what fixes and pose stand on is a wrong fix that has passed all tests.

Confirmed fixes anchor the pose: one that was wrong and has passed has pulled it along, and agrees with it afterwards.
The hypothesis fades as episodes of wrong fixes end, which a pose that has been pulled along would show, and where scan
matching agrees with the pose place after place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent
from camber.integrity.protection.wrong_fix_probability import WrongFixRules, log_odds_of_share
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.pose import Pose

_MATCH_SIGMAS = 4.0  # σ of a match that lie within the offset of the latent fault


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentFaultHypothesis:
    """That what fixes and pose stand on is a wrong fix: odds, and mean squares of the offset (each axis, upwards).

    `time_ns` None: no fix has been confirmed yet.
    """

    time_ns: int | None
    odds: float
    horizontal_m2: float
    up_m2: float

    @classmethod
    def initial(cls, rules: WrongFixRules) -> LatentFaultHypothesis:
        """Of a pose that rests on fixes of which nothing is known here."""
        horizontal_m2, up_m2 = rules.second_moment_m2
        odds = math.exp(log_odds_of_share(rules.prior))
        return cls(time_ns=None, odds=odds, horizontal_m2=horizontal_m2, up_m2=up_m2)

    def remaining_share(self, time_ns: int, rules: WrongFixRules) -> float:
        """The share of it that is left at a later time: episodes of wrong fixes end."""
        if self.time_ns is None:
            return 0.0
        return math.exp(-max(time_ns - self.time_ns, 0) / (rules.episode_s * 1e9))

    def after(
        self, time_ns: int, odds: float, wrong: MixtureComponent, rules: WrongFixRules
    ) -> LatentFaultHypothesis:
        """After a confirmed fix: the episode may have lasted, or another have begun since the fix before.

        `odds` are those of the fix by itself, `wrong` is how far off it is if it is wrong.
        """
        remaining_share = self.remaining_share(time_ns, rules)
        begun = (1.0 - remaining_share) * odds
        total = remaining_share * self.odds + begun
        share = begun / total if total > 0.0 else 0.0
        (east_m, north_m, up_m), (ee, _, nn) = wrong.mean_m, wrong.horizontal_m2
        horizontal_m2, up_m2 = max(east_m * east_m + ee, north_m * north_m + nn), up_m * up_m + wrong.up_m2
        return LatentFaultHypothesis(
            time_ns=time_ns,
            odds=total,
            horizontal_m2=self.horizontal_m2 + share * (horizontal_m2 - self.horizontal_m2),
            up_m2=self.up_m2 + share * (up_m2 - self.up_m2),
        )

    def corroborate(self, before: LatentFaultHypothesis, rules: LevelRules) -> LatentFaultHypothesis:
        """After a scan match has found the pose where it is: what is left of `before` would take a wrong match too."""
        assert self.time_ns is not None
        left = before.remaining_share(self.time_ns, rules.wrong_fix) * before.odds
        return replace(self, odds=self.odds - (1.0 - rules.false_match_prior) * left)

    def part(self, weight: float) -> MixtureComponent:
        """What was pulled along."""
        return MixtureComponent(
            weight=weight,
            horizontal_m2=(self.horizontal_m2, 0.0, self.horizontal_m2),
            up_m2=self.up_m2,
            is_latent=True,
        )


class MatchCorroboration:
    """Scan matches that agree with the pose, so far apart that what makes one wrong is gone at the next.

    Only a match counts that is newer than the hypothesis, and precise compared with its offset.
    """

    def __init__(self, rules: LevelRules) -> None:
        self._rules = rules
        self._last: tuple[float, float] | None = None
        self._before: LatentFaultHypothesis | None = None

    def update(self, pose: Pose, latent_fault: LatentFaultHypothesis) -> LatentFaultHypothesis:
        """The fault hypothesis after a pose."""
        if pose.mode != "scan_match" or pose.latitude_rad is None or pose.longitude_rad is None:
            return latent_fault
        here = pose.latitude_rad, pose.longitude_rad
        if self._last is None:
            self._last = here
        if self._before is None:
            far = math.hypot(*east_north_between(*self._last, *here)) >= self._rules.matches_apart_m
            if far and latent_fault.time_ns is not None:
                self._before = latent_fault
            return latent_fault
        assert self._before.time_ns is not None
        newer = pose.match_time_ns is not None and pose.match_time_ns > self._before.time_ns
        if not newer or not _MATCH_SIGMAS**2 * _larger_m2(pose) <= latent_fault.horizontal_m2:
            return latent_fault
        before, self._last, self._before = self._before, here, None
        return latent_fault.corroborate(before, self._rules)


def _larger_m2(pose: Pose) -> float:
    """The larger eigenvalue of the position's covariance; not a number without one."""
    if pose.covariance_east_north_yaw is None:
        return math.nan
    ee, en, _, nn, _, _ = pose.covariance_east_north_yaw
    larger_m2: float = larger_eigenvalue(ee, en, nn)
    return larger_m2

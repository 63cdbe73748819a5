"""Where earlier confirmed fixes say that the vehicle is: narrower than the pose while wrong fixes last.

Dead reckoning loses metres in a minute, so a wrong fix that the pose contradicted at first agrees with it later: the
pose has become wide, and nothing about the fix has changed. But fixes themselves say how the vehicle has moved. Those
with one set of integers, right or wrong, form a *run* and move as the vehicle does. A run that differs from the carried
position by d at its first fix differs by d ever after, but for the drift of wrong integers as the satellites move, some
`drift_per_s` of d a second. So the last confirmed position is carried on

- by a run: to its newest fix less d, and from there by odometry to the next. With the variance v of the carried
  position at the run's first fix and F of a fix, the variance after t is v + F + (drift_per_s · t · |d|)²;
- by the pose, as far as that fix was the last to anchor it;

whichever has the smaller variance; variances are those of each axis in the worst direction. And a run is judged by its
first fix too, when the carried position was known best.

A confirmed position may itself be wrong. Its odds fade as those of episodes of wrong fixes do (`LatentFaultHypothesis`)
while confirmed fixes go on. A run with the height of the road is wrong with odds of some 0.01 to 0.04: the prior, 0.11
to 0.43, times the tenth of wrong fixes that have that height by chance. From `most_odds` on the carried position is as
doubtful as a run that contradicts it, and is not used: the pose decides alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from camber.geodesy.horizontal_offsets import east_north_between, place_at
from camber.integrity.checks.chi2_test import AGREES
from camber.integrity.checks.consistency_tests import ConsistencyLimits, consistency_of
from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.pose_offset import can_move_on, offset_from_pose, pose_sigma_m, unsteady_m2
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.latent_fault import is_same_draw
from camber.integrity.protection.wrong_fix_probability import WrongFixRules, log_odds_of
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose, Road

EastNorth = tuple[float, float]
_UNKNOWN_HEIGHT_M2 = 1e6  # the variance in place of a height that is not tested
_MOST_LOG_ODDS = 30.0  # chosen: odds of 1e13 are certainty, and exp does not overflow


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedRules:
    """How long a confirmed position is carried, and what is one run of fixes.

    `longest_s`: chosen, the longest episodes of wrong fixes known here. Fixes of a run are at most `longest_gap_s`
    apart, as those of a time series, and move with vehicle and road within `step_m` in the plane and upwards: the step
    from a right fix to a wrong one, 0.5 m off, is larger in one of both. `odometry_m`: error of the motion between two
    fixes, 1 σ, chosen; 4 of 9,000 in a simulated drive are beyond 0.15 m. `odometry_share`: of the way between two
    fixes, what wheels may be off by (`speed_scale_bound` of the localizer), where a new run is compared with the one
    before. `drift_per_s`: of the offset of wrong integers, 1 σ; of 538 in simulated skies it is 6e-4 (rms) and 2.8e-3
    at most (`simulator.satellites.wrong_fix_shapes`). `most_odds`: see above.
    """

    longest_s: float = 120.0
    longest_gap_s: float = 1.0
    step_m: float = 0.3
    odometry_m: float = 0.05
    odometry_share: float = 0.02
    drift_per_s: float = 1e-3
    most_odds: float = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """From a fix to the carried position, east and north, and the variance of that position."""

    metres: EastNorth
    variance_m2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """Fixes that move with the vehicle: the carried position as seen from the first, the last one, the pose then.

    `off_road`: has the height of one of them contradicted the road?
    """

    begun_ns: int
    begun: _Place
    last: Fix
    pose: Pose
    off_road: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Carried:
    """What is carried: a place seen from a fix. Time of the last confirmed fix, and odds that the place is wrong."""

    fix: Fix
    place: _Place
    confirmed_ns: int
    odds: float


_ONSET_S = 5.0  # chosen: the stretch of 20 m in which fixes begin to differ may have begun so long before


class CarriedPosition:
    """The last confirmed position, carried on, and the present run of fixes."""

    def __init__(self, rules: CarriedRules, sigma: TrueSigma, wrong: WrongFixRules) -> None:
        self._rules, self._sigma, self._wrong = rules, sigma, wrong
        self._base: _Carried | None = None
        self._run: _Run | None = None
        self._held_back_ns = (
            0,
            0,
        )  # times of two confirmed fixes, with runs between them that began elsewhere

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this."""
        if self._base is not None and self._base.fix.time_ns > limit_ns:
            self._base = self._run = None

    def improve(self, pose: Pose) -> Pose:
        """The pose at the carried position, with its road, where that is known better; else the pose as it is."""
        base = self._trusted(pose.time_ns)
        if base is None or pose.latitude_rad is None or pose.longitude_rad is None:
            return pose
        if base.fix.time_ns == base.confirmed_ns:
            return pose  # it knows that fix, and all before it
        place = self._moved(base, pose.time_ns, pose)
        if place is None or not place.variance_m2 < pose_sigma_m(pose) ** 2:
            return pose
        fix = base.fix
        east_m, north_m = east_north_between(
            pose.latitude_rad, pose.longitude_rad, fix.latitude_rad, fix.longitude_rad, height_m=fix.height_m
        )
        shift_m = east_m + place.metres[0], north_m + place.metres[1]
        latitude_rad, longitude_rad = place_at(
            pose.latitude_rad, pose.longitude_rad, *shift_m, height_m=fix.height_m
        )
        assert pose.covariance_east_north_yaw is not None
        v, yaw_rad2 = place.variance_m2, pose.covariance_east_north_yaw[5]
        return pose.model_copy(
            update={
                "latitude_rad": latitude_rad,
                "longitude_rad": longitude_rad,
                "covariance_east_north_yaw": (v, 0.0, 0.0, v, 0.0, yaw_rad2),
                "road": _road_seen_from(pose.road, *shift_m),
            }
        )

    def began_elsewhere(self, fix: Fix, pose: Pose, limits: ConsistencyLimits) -> bool:
        """Has the run of a fix with a covariance begun where the carried position, known best then, did not agree?"""
        base, run = self._trusted(fix.time_ns), self._continued(fix, pose)
        if base is None:
            return False
        begun = self._begins(base, fix, pose) if run is None else run.begun
        if begun is None:
            return False
        assert fix.covariance_enu_m2 is not None
        v = begun.variance_m2
        fix_ee, fix_en, _, fix_nn, _, fix_uu = inflate_covariance(fix.covariance_enu_m2, self._sigma)
        # The height is tested against the road: here it differs by nothing.
        covariance = (fix_ee + v, fix_en, 0.0, fix_nn + v, 0.0, fix_uu)
        outcome = consistency_of((*begun.metres, 0.0), covariance, (v, 0.0, v), limits).position
        return bool(outcome != AGREES)

    def _begins(self, base: _Carried, fix: Fix, pose: Pose) -> _Place | None:
        """The carried position seen from the first fix of a run, where it is known better than the pose.

        A pose that has just become wide, as when sensors leave their bounds, would let a step to wrong integers pass.
        The same integers as before make no such step.
        """
        place = self._place(fix, pose)
        if place is None or fix.ambiguity_continuity == "continuous":
            return None
        wheels_m = self._rules.odometry_share * math.hypot(*_between(base.fix, fix))
        place = replace(place, variance_m2=place.variance_m2 + wheels_m * wheels_m)
        return place if place.variance_m2 < pose_sigma_m(pose) ** 2 else None

    def has_returned_since(self, onset_ns: int, time_ns: int) -> bool:
        """Has an offset that began then been that of fixes which were not confirmed, with confirmed ones before it?"""
        base, begun_ns = self._trusted(time_ns), onset_ns + round(_ONSET_S * 1e9)
        if base is None:
            return False
        return begun_ns > base.confirmed_ns or self._held_back_ns[0] < begun_ns <= self._held_back_ns[1]

    def off_road_since_ns(self, fix: Fix, pose: Pose, *, off_road: bool) -> int | None:
        """When the run of a fix began, where a height of it has contradicted the road; `off_road`: that of the fix."""
        run = self._continued(fix, pose)
        if run is None:
            return fix.time_ns if off_road else None
        return run.begun_ns if off_road or run.off_road else None

    def settle(self, fix: Fix, pose: Pose, odds: float | None, *, off_road: bool = False) -> None:
        """After the final verdict on a fix with a covariance; `odds` that it is wrong where it is confirmed.

        `pose` is the localizer's, not an improved one.
        """
        run = self._continued(fix, pose)
        if odds is not None:
            here = _Place(metres=(0.0, 0.0), variance_m2=self._fix_variance_m2(fix))
            if self._base is not None and self._base.fix.time_ns > self._base.confirmed_ns:
                self._held_back_ns = self._base.confirmed_ns, fix.time_ns
            odds = self._odds_after(fix, odds)
            self._base = _Carried(fix=fix, place=here, confirmed_ns=fix.time_ns, odds=odds)
            self._run = _Run(begun_ns=fix.time_ns, begun=here, last=fix, pose=pose)
            return
        place = self._place(fix, pose)
        if place is None or self._base is None:
            self._run = None
            return
        if run is None:
            run = _Run(begun_ns=fix.time_ns, begun=place, last=fix, pose=pose)
        self._run = run = replace(run, last=fix, pose=pose, off_road=off_road or run.off_road)
        by_run = replace(run.begun, variance_m2=self._variance_by_run_m2(run))
        if by_run.variance_m2 <= place.variance_m2 or run.begun_ns == fix.time_ns:
            self._base = replace(self._base, fix=fix, place=by_run)

    def _odds_after(self, fix: Fix, odds: float) -> float:
        """That the carried position is wrong after a confirmed fix whose own odds are these."""
        if self._base is None:
            return odds
        if is_same_draw(fix, self._base.confirmed_ns):
            return self._base.odds
        left = math.exp(-max(fix.time_ns - self._base.confirmed_ns, 0) / (self._wrong.episode_s * 1e9))
        return left * self._base.odds + (1.0 - left) * odds

    def _trusted(self, time_ns: int) -> _Carried | None:
        """What is carried, where it may be used at a time."""
        base, rules = self._base, self._rules
        if base is None or not base.odds <= rules.most_odds:
            return None
        return base if 0 <= time_ns - base.confirmed_ns <= rules.longest_s * 1e9 else None

    def _variance_by_run_m2(self, run: _Run) -> float:
        lasts_s = (run.last.time_ns - run.begun_ns) / 1e9
        drift_m = self._rules.drift_per_s * lasts_s * math.hypot(*run.begun.metres)
        return run.begun.variance_m2 + self._fix_variance_m2(run.last) + drift_m * drift_m

    def _fix_variance_m2(self, fix: Fix) -> float:
        assert fix.covariance_enu_m2 is not None
        ee, en, _, nn, _, _ = inflate_covariance(fix.covariance_enu_m2, self._sigma)
        larger_m2: float = larger_eigenvalue(ee, en, nn)
        return larger_m2

    def _place(self, fix: Fix, pose: Pose) -> _Place | None:
        """The carried position seen from a fix, by the way with the smallest variance; None where there is none."""
        base = self._base
        if base is None or not 0 < fix.time_ns - base.confirmed_ns <= self._rules.longest_s * 1e9:
            return None
        places = []
        moved = self._moved(base, fix.time_ns, pose)
        if moved is not None:
            east_m, north_m = _between(base.fix, fix)
            places.append(replace(moved, metres=(moved.metres[0] - east_m, moved.metres[1] - north_m)))
        if pose.anchor_time_ns == base.confirmed_ns:
            east_m, north_m = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
            variance_m2 = pose_sigma_m(pose) ** 2 + unsteady_m2(pose, fix.time_ns)
            places.append(_Place(metres=(-east_m, -north_m), variance_m2=variance_m2))
        return min(places, key=lambda place: place.variance_m2, default=None)

    def _moved(self, base: _Carried, time_ns: int, pose: Pose) -> _Place | None:
        """The carried position at a time, seen from the fix of the base: by odometry, after a fix.

        Wheels that slip are off by the same from fix to fix: it is wider by what the pose's σ has grown since.
        """
        run = self._run
        driven_m = None if run is None or run.last is not base.fix else self._driven(run, time_ns, pose)
        if run is None or driven_m is None:
            return None
        metres = base.place.metres[0] + driven_m[0], base.place.metres[1] + driven_m[1]
        grown_m = max(pose_sigma_m(pose) - pose_sigma_m(run.pose), 0.0)
        sigma_m = math.sqrt(base.place.variance_m2) + grown_m
        return _Place(metres=metres, variance_m2=sigma_m * sigma_m + self._rules.odometry_m**2)

    def _continued(self, fix: Fix, pose: Pose) -> _Run | None:
        """The present run, where the fix is one more of it."""
        run = self._run
        driven_m = None if run is None else self._driven(run, fix.time_ns, pose)
        if run is None or driven_m is None:
            return None
        east_m, north_m = _between(run.last, fix)
        over_m = math.hypot(east_m - driven_m[0], north_m - driven_m[1])
        slope_east, slope_north = pose.road.slope_east or 0.0, pose.road.slope_north or 0.0
        up_m = fix.height_m - run.last.height_m - slope_east * driven_m[0] - slope_north * driven_m[1]
        return run if max(over_m, abs(up_m)) <= self._rules.step_m else None

    def _driven(self, run: _Run, time_ns: int, pose: Pose) -> EastNorth | None:
        """East and north metres since the last fix of a run by odometry; None where that does not say."""
        since_s = (time_ns - run.last.time_ns) / 1e9
        if not (can_move_on(run.pose) and can_move_on(pose) and 0.0 <= since_s <= self._rules.longest_gap_s):
            return None
        then, now = _velocity_m_s(run.pose), _velocity_m_s(pose)
        return 0.5 * since_s * (then[0] + now[0]), 0.5 * since_s * (then[1] + now[1])


def odds_of(result: FixComparison, rules: WrongFixRules, satellites: int | None, trials: int) -> float:
    """That a confirmed fix is wrong, by its own comparison; without a tested height by its place alone."""
    east_m, north_m, up_m = result.difference_m.tolist()
    (ee, en, eu), (_, nn, nu), (_, _, uu) = result.covariance_m2.tolist()
    if not (math.isfinite(up_m) and math.isfinite(uu)):
        up_m, eu, nu, uu = 0.0, 0.0, 0.0, _UNKNOWN_HEIGHT_M2
    log_odds = log_odds_of(
        (east_m, north_m, up_m),
        (ee, en, eu, nn, nu, uu),
        rules=rules,
        prior_log_odds=rules.prior_log_odds(satellites),
        trials=trials,
    )
    return math.exp(min(float(log_odds), _MOST_LOG_ODDS))


def _between(one: Fix, other: Fix) -> EastNorth:
    return east_north_between(
        one.latitude_rad, one.longitude_rad, other.latitude_rad, other.longitude_rad, height_m=other.height_m
    )


def _velocity_m_s(pose: Pose) -> EastNorth:
    """East and north of a pose that can be moved on."""
    speed_m_s, yaw_rad = pose.speed_m_s or 0.0, pose.yaw_rad or 0.0
    return speed_m_s * math.cos(yaw_rad), speed_m_s * math.sin(yaw_rad)


def _road_seen_from(road: Road, east_m: float, north_m: float) -> Road:
    """The same road seen from a place that far from the pose."""
    changes: dict[str, Any] = {}
    if road.elevation_m is not None and road.slope_east is not None and road.slope_north is not None:
        changes["elevation_m"] = road.elevation_m + road.slope_east * east_m + road.slope_north * north_m
    if road.patch is not None:
        patch = road.patch
        changes["patch"] = patch.model_copy(
            update={"east_m": patch.east_m - east_m, "north_m": patch.north_m - north_m}
        )
    return road.model_copy(update=changes)

"""Scan matches: `(east, north, yaw) = pose + common + noise`, all three of the vehicle's reference point.

`common` is a Gauss-Markov process along the distance: what is wrong in the map, or seen wrongly, is wrong in the next
match too, so that a thousand of them at a standstill do not make a millimetre. For the same reason a match that comes
soon after another weighs less: within `match_renewed_m` and `match_renewed_s` all matches together weigh as one.

A match that is not unique is refused where the pose is vague and the match is not. One outside the gate is refused.
Refused ones that are unique and agree with one another along the track *insist*; over some distance they are believed,
if the pose may be as far off as they say: by its own covariance and by what dead reckoning gets wrong unnoticed since
it was last held.

The wheels are doubted (`wheel_doubt`) where a slip of them explains a match much better, and it tells of another way
since one before it, of the last second, than they do. To be off by as much as that one was is no sign of a slip.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.filter.consistent_match_sequence import (
    ConsistencyModel,
    ConsistentMatchSequence,
    MatchedPose,
    shifted,
)
from camber.localizer.filter.dead_reckoning import (
    EAST,
    NORTH,
    SCALE,
    WHEEL_LAG,
    WHEEL_SLIP,
    YAW,
    OverlayLag,
    TrackPoint,
)
from camber.localizer.filter.filter_state import MATCH_EAST, MATCH_NORTH, MATCH_YAW, FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.start import lever_arm
from camber.localizer.filter.wheel_slip import WheelSlipDetector
from camber.localizer.links.link_filter import Array, wrapped

MatchOutcome: TypeAlias = Literal[
    "accepted",
    "outside_gate",
    "recovered",
    "supported",
    "provisional",
    "no_pose",
    "too_old",
    "ahead",
]


_TRACK_FOLLOWS = 0.1
"""Of the way since: a track that departs farther from the wheels was driven while they were in doubt."""


class MatchUpdate(NamedTuple):
    """What became of a scan match; `nis` is the normalised innovation squared (3 degrees of freedom), `innovation`
    the match less the pose: east, north (m) and yaw (rad)."""

    outcome: MatchOutcome
    nis: float | None = None
    innovation: tuple[float, float, float] | None = None

    @property
    def accepted(self) -> bool:
        """Whether the pose has taken it in."""
        return self.outcome in ("accepted", "recovered", "supported")


class _Observed(NamedTuple):
    """Rows (3, n), innovation (3,) and noise (3, 3) of a match."""

    h: Array
    innovation: Array
    noise: Array


class ScanMatches:
    """Takes scan matches into a pose whose heading is known."""

    def __init__(self, state: FilterState, wheels: WheelSlipDetector, model: PoseModel) -> None:
        self._state, self._wheels, self._model = state, wheels, model
        self.run = ConsistentMatchSequence(ConsistencyModel(gate=model.match_gate))
        self.held_at_m = -math.inf  # path at which a match or an anchor last held the pose
        self._last: tuple[int, float] | None = None  # time and path of the last that was taken in
        self._taken: list[MatchedPose] = []  # of the last second
        self._refused_ns: int | None = None

    def forget(self) -> None:
        """The pose is another one."""
        self.run.forget()
        self._last, self._taken, self._refused_ns = None, [], None

    def shift(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north)."""
        self.run.shift(east_m, north_m)
        self._taken = [shifted(match, east_m, north_m) for match in self._taken]

    def update(self, match: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """Take in a match of the past; says `outside_gate` where it is refused."""
        seen = self._observed(match, here)
        moved = (float(seen.innovation[0]), float(seen.innovation[1]), float(seen.innovation[2]))
        nis = _normalised(seen, self._state.p)
        if not unique and self._could_be_elsewhere(match):
            return MatchUpdate("outside_gate", nis, moved)
        if nis > self._model.match_doubt and self._doubt_wheels(seen, match):
            seen = self._observed(match, here)
            nis = _normalised(seen, self._state.p)
        if nis > self._model.match_gate:
            self.run.add(match, unique=unique)
            self._refused_ns = match.time_ns
            return MatchUpdate("outside_gate", nis, moved)
        slip = float(self._state.x[WHEEL_SLIP])
        noise = seen.noise / self._news(match)
        self._state.update_by(seen.h, seen.innovation, noise, teach=not self._contradicted(match))
        self._wheels.learnt(slip)
        self.taken(match)
        return MatchUpdate("accepted", nis, moved)

    def taken(self, match: MatchedPose) -> None:
        """The pose follows this match."""
        self.run.forget()
        self._last = (match.time_ns, match.track.path_m)
        oldest_ns = match.time_ns - round(self._model.slip_seen_within_s * 1e9)
        self._taken = [*(one for one in self._taken if one.time_ns >= oldest_ns), match]
        self.held_at_m = match.track.path_m
        self._wheels.seen()

    @property
    def insist(self) -> bool:
        """Whether refused matches agree with one another, though not with the pose."""
        return self.run.count >= self._model.recover_after_matches

    def may_recover(self, match: MatchedPose, here: TrackPoint) -> bool:
        """Whether refused matches are to be believed: they insist over a distance, and the pose may be so far off."""
        model = self._model
        if not self.insist or self.run.path_m < model.recover_after_m:
            return False
        seen = self._observed(match, here)
        drift = model.unmodelled_drift * min(here.path_m - self.held_at_m, 1e6)
        noise = seen.noise + np.diag([drift**2, drift**2, model.unmodelled_turn_rad**2])
        return _normalised(seen._replace(noise=noise), self._state.p) <= model.match_gate

    def floored(self, covariance: Array) -> Array:
        """Covariance (3, 3) of a match, better than which none is believed to be."""
        model = self._model
        position, yaw = model.match_sigma_floor_m**2, model.match_sigma_floor_rad**2
        return covariance + np.diag([position, position, yaw])

    def _observed(self, match: MatchedPose, here: TrackPoint) -> _Observed:
        """z = pose now - motion since + common; what was driven since turns with the yaw.

        What is seen is where the overlaid sweeps were in the mean: all motion since then is the wheels'.
        """
        x, then = self._state.x, match.track
        since = lever_arm(
            float(x[YAW]) - here.yaw_rad, here.east_m - then.east_m, here.north_m - then.north_m
        )
        if self._wheels.active:
            missed = lever_arm(float(x[YAW]), self._wheels.missed_m(match.time_ns), 0.0)
            since = since[0] + missed[0], since[1] + missed[1]
        turned = here.yaw_rad - then.yaw_rad
        h = self._state.rows(3)
        h[0, EAST] = h[1, NORTH] = h[2, YAW] = 1.0
        h[0, MATCH_EAST] = h[1, MATCH_NORTH] = h[2, MATCH_YAW] = 1.0
        h[0, YAW], h[1, YAW] = since[1], -since[0]
        if self._wheels.active:
            h = self._with_slip(h, self._wheels.late_s(match.time_ns))
        yaw = wrapped(match.yaw_rad - float(x[YAW]) + turned - float(x[MATCH_YAW]))
        east = match.east_m - float(x[EAST]) + since[0] - float(x[MATCH_EAST])
        north = match.north_m - float(x[NORTH]) + since[1] - float(x[MATCH_NORTH])
        back = _behind_now(match, here)
        known = (1.0 + float(x[SCALE])) * (back.wheel_m + float(x[WHEEL_LAG]) * back.wheel_change_m_s)
        if abs(known - back.path_m) < _TRACK_FOLLOWS * (1.0 + abs(back.path_m)):
            ahead = math.cos(match.yaw_rad), math.sin(match.yaw_rad)
            east += (known - back.path_m) * ahead[0]
            north += (known - back.path_m) * ahead[1]
            for row in (0, 1):
                h[row, SCALE] = -back.wheel_m * ahead[row]
                h[row, WHEEL_LAG] = -back.wheel_change_m_s * ahead[row]
        return _Observed(h, np.array([east, north, yaw]), match.covariance + late_noise(then, here))

    def motion_share(self, behind: OverlayLag, yaw_rad: float) -> Array:
        """Covariance (3, 3) of what the wheels are not known by, over the way since the sweeps' mean."""
        p = self._state.p[np.ix_((SCALE, WHEEL_LAG), (SCALE, WHEEL_LAG))]
        way = np.array([behind.wheel_m, behind.wheel_change_m_s])
        ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
        return np.outer(ahead, ahead) * float(way @ p @ way)

    def _contradicted(self, match: MatchedPose) -> bool:
        """Whether a match was refused just now: then one that moves the pose shows that the pose was wrong, and not
        that the wheels or the rotation sensor were."""
        if self._refused_ns is None:
            return False
        return match.time_ns - self._refused_ns <= self._model.holds_for_s * 1e9

    def _could_be_elsewhere(self, match: MatchedPose) -> bool:
        """Whether the pose is vague where the match is not: any place that looks alike would pass the gate."""
        model, p = self._model, self._state.p
        variances, directions = np.linalg.eigh(match.covariance[:2, :2])
        before = np.einsum("ij,ik,kj->j", directions, p[:2, :2], directions)
        place = (variances < 0.1 * model.match_sure_m**2) & (before > model.match_sure_m**2)
        yaw_vague = p[YAW, YAW] > model.match_sure_rad**2 > 10.0 * match.covariance[2, 2]
        return bool(place.any() or yaw_vague)

    def _doubt_wheels(self, seen: _Observed, match: MatchedPose) -> bool:
        """Doubt the wheels where that explains the match, and only that; says whether they are doubted from now on."""
        since_ns = None if self._wheels.active else self._other_way_since_ns(match)
        if since_ns is None:
            return False
        covariance = self._wheels.covariance_if_slipping(since_ns)
        h = self._with_slip(seen.h, self._wheels.late_s(match.time_ns))
        if _normalised(seen._replace(h=h), covariance) > self._model.match_doubt:
            return False
        self._wheels.begin(since_ns, covariance)
        return True

    def _with_slip(self, h: Array, late_s: float) -> Array:
        """Rows (3, n) of a match this late, where the way since hangs on the slip."""
        h = h.copy()
        yaw = float(self._state.x[YAW])
        h[0, WHEEL_SLIP], h[1, WHEEL_SLIP] = -late_s * math.cos(yaw), -late_s * math.sin(yaw)
        return h

    def _other_way_since_ns(self, match: MatchedPose) -> int | None:
        """When the newest match was since which this one and the wheels tell of different ways."""
        model, p = self._model, self._state.p
        ahead = np.array([math.cos(match.yaw_rad), math.sin(match.yaw_rad)])
        for one in reversed(self._taken):
            if match.time_ns - one.time_ns > model.slip_seen_within_s * 1e9:
                return None
            east, north, _, covariance = one.carried(match.track)
            off = ahead @ (match.east_m - east, match.north_m - north)
            by_scale = float(p[SCALE, SCALE]) * (match.track.wheel_m - one.track.wheel_m) ** 2
            by_lag = float(p[WHEEL_LAG, WHEEL_LAG]) * (match.track.wheel_m_s - one.track.wheel_m_s) ** 2
            both = ahead @ (covariance + match.covariance)[:2, :2] @ ahead
            if off**2 > model.match_gate * (both + by_scale + by_lag):
                return one.time_ns
        return None

    def _news(self, match: MatchedPose) -> float:
        """The share of a match, in ]0, 1], that the one before has not said already."""
        if self._last is None or self._wheels.active:  # nobody else says what was driven since
            return 1.0
        time_ns, path_m = self._last
        distance = abs(match.track.path_m - path_m) / self._model.match_renewed_m
        return min(1.0, max(1e-3, distance + (match.time_ns - time_ns) * 1e-9 / self._model.match_renewed_s))


def _behind_now(match: MatchedPose, here: TrackPoint) -> OverlayLag:
    """How far behind the end of the track the match's sweeps lie in the mean."""
    then, behind = match.track, match.behind
    return OverlayLag(
        here.path_m - then.path_m + behind.path_m,
        here.wheel_m - then.wheel_m + behind.wheel_m,
        here.wheel_m_s - then.wheel_m_s + behind.wheel_change_m_s,
    )


def late_noise(then: TrackPoint, here: TrackPoint) -> Array:
    """Covariance (3, 3) of what was driven since: of its length, and of its turn."""
    path, turn = abs(here.path_m - then.path_m), abs(here.yaw_rad - then.yaw_rad)
    along = (0.005 * path) ** 2
    return np.diag([along, along, (0.005 * turn) ** 2 + (2e-4 * path) ** 2])


def _normalised(seen: _Observed, p: Array) -> float:
    s = seen.h @ p @ seen.h.T + seen.noise
    return float(seen.innovation @ np.linalg.solve(s, seen.innovation))

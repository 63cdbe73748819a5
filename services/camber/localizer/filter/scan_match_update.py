"""Update by scan matches: `(east, north, yaw) = pose + common + noise`, of the vehicle's reference point.

`common` is a Gauss-Markov process along the distance: an error of the map is the same in the next match, so a thousand
matches at a standstill do not average down to a millimetre. For the same reason matches within `match_renewed_m` and
`match_renewed_s` of one another together weigh as one.

Rejected are matches outside the gate, and matches that are not unique where the pose is less precise than they are.
Rejected matches that are unique and consistent along the track are *persistent*; over a distance they are believed,
if the pose may be so far off by its covariance and by the undetected error of dead reckoning since it was last held.

Wheel slip is suspected where it explains a match much better, and the match contradicts the distance by the wheels
since an earlier match of the last second. An offset that the earlier match had already is no sign of slip.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats
from camber.localizer.filter.consistent_match_sequence import ConsistentMatchSequence, MatchedPose
from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH, SCALE, SPEED_ERROR, WHEEL_LAG, YAW
from camber.localizer.filter.filter_state import MATCH_EAST, MATCH_NORTH, MATCH_YAW, FilterState
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.speed_error import SpeedError
from camber.localizer.filter.track import OverlayLag, TrackPoint
from camber.localizer.filter.wheel_slip import WheelSlipDetector

MatchOutcome: TypeAlias = Literal[
    "accepted", "outside_gate", "recovered", "supported", "provisional", "no_pose", "too_old", "ahead"
]

_TRACK_FOLLOWS = 0.1
"""Chosen: a track that departs from the wheels by a greater share of the distance was driven while slip was
suspected."""


class MatchUpdate(NamedTuple):
    """Outcome of a scan match; `innovation`: the match less the pose, east, north [m], yaw [rad]."""

    outcome: MatchOutcome
    innovation: tuple[float, float, float] | None = None

    @property
    def accepted(self) -> bool:
        """Whether the match updated the pose."""
        return self.outcome in ("accepted", "recovered", "supported")


class _Observation(NamedTuple):
    """Rows (3, n), innovation (3,) and noise (3, 3) of a match."""

    h: Floats
    innovation: Floats
    noise: Floats

    def nis(self, p: Floats) -> float:
        """Return the normalised innovation squared for a state covariance (n, n)."""
        s = self.h @ p @ self.h.T + self.noise
        return float(self.innovation @ np.linalg.solve(s, self.innovation))


class ScanMatches:
    """Updates a pose whose heading is known by scan matches."""

    def __init__(
        self, state: FilterState, wheel_slip: WheelSlipDetector, error: SpeedError, model: PoseModel
    ) -> None:
        self._state, self._wheel_slip, self._error, self._model = state, wheel_slip, error, model
        self.sequence = ConsistentMatchSequence(model.match_gate)
        self.held_at_m = -math.inf  # path at which a match or an anchor last held the pose
        self._accepted: list[MatchedPose] = []  # of the last second
        self._last: MatchedPose | None = None
        self._rejected_ns: int | None = None

    def forget(self) -> None:
        """Clear all matches: the pose is another one."""
        self.sequence.forget()
        self._last, self._accepted, self._rejected_ns = None, [], None

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        self.sequence.shift(east_m, north_m)
        self._accepted = [match.shifted(east_m, north_m) for match in self._accepted]

    def update(self, match: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """Update by a past match; outcome `outside_gate` where it is rejected."""
        observation = self._observation(match, here)
        east, north, yaw = observation.innovation.tolist()
        innovation = (east, north, yaw)
        nis = observation.nis(self._state.p)
        if not unique and self._is_pose_less_precise(match):
            return MatchUpdate("outside_gate", innovation)
        if nis > self._model.slip_gate and self._detect_slip(observation, match):
            observation = self._observation(match, here)
            nis = observation.nis(self._state.p)
        if nis > self._model.match_gate:
            self.sequence.add(match, unique=unique)
            self._rejected_ns = match.time_ns
            return MatchUpdate("outside_gate", innovation)
        speed_error = float(self._state.x[SPEED_ERROR])
        self._state.update_joseph(
            observation.h,
            observation.innovation,
            observation.noise / self._independent_share(match),
            update_sensors=not self._follows_rejection(match),
        )
        self._error.record_update(speed_error)
        self.accept(match)
        return MatchUpdate("accepted", innovation)

    def accept(self, match: MatchedPose) -> None:
        """Record that the pose follows this match."""
        self.sequence.forget()
        self._last = match
        oldest_ns = match.time_ns - round(self._model.slip_memory_s * 1e9)
        self._accepted = [*(one for one in self._accepted if one.time_ns >= oldest_ns), match]
        self.held_at_m = match.track.path_m
        self._wheel_slip.mark_observed()

    @property
    def is_persistent(self) -> bool:
        """Whether rejected matches agree with one another, though not with the pose."""
        return self.sequence.count >= self._model.recover_after_matches

    def can_recover(self, match: MatchedPose, here: TrackPoint) -> bool:
        """Whether rejected matches are believed: they persist over a distance, and the pose may be so far off."""
        model = self._model
        if not self.is_persistent or self.sequence.path_m < model.recover_after_m:
            return False
        observation = self._observation(match, here)
        drift = model.unmodelled_drift * min(here.path_m - self.held_at_m, 1e6)
        noise = observation.noise + np.diag([drift**2, drift**2, model.unmodelled_turn_rad**2])
        return observation._replace(noise=noise).nis(self._state.p) <= model.match_gate

    def is_within_gate(self, match: MatchedPose, here: TrackPoint) -> bool:
        """Whether the pose may be at a match, by its covariance alone."""
        return self._observation(match, here).nis(self._state.p) <= self._model.match_gate

    def floored(self, covariance: Floats) -> Floats:
        """Return the covariance (3, 3) of a match plus the floor."""
        model = self._model
        position, yaw = model.match_sigma_floor_m**2, model.match_sigma_floor_rad**2
        return covariance + np.diag([position, position, yaw])

    def motion_share(self, lag: OverlayLag, yaw_rad: float) -> Floats:
        """Return the covariance (3, 3) by the unknown scale and lag of the wheels over the overlay's lag."""
        p = self._state.p[np.ix_((SCALE, WHEEL_LAG), (SCALE, WHEEL_LAG))]
        by_error = np.array([lag.wheel_m, lag.wheel_change_m_s])
        ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
        return np.outer(ahead, ahead) * float(by_error @ p @ by_error)

    def _observation(self, match: MatchedPose, here: TrackPoint) -> _Observation:
        """Return rows of z = pose now - motion since + common; the displacement since turns with the yaw.

        The match observes the mean position of the overlaid sweeps: all motion since is by the wheels.
        """
        x, then = self._state.x, match.track
        since = rotated(float(x[YAW]) - here.yaw_rad, here.east_m - then.east_m, here.north_m - then.north_m)
        if self._error.is_estimated:
            untracked = rotated(float(x[YAW]), self._error.untracked_m(_sweeps_ns(match)), 0.0)
            since = since[0] + untracked[0], since[1] + untracked[1]
        turned = here.yaw_rad - then.yaw_rad
        h = self._state.rows(3)
        h[0, EAST] = h[1, NORTH] = h[2, YAW] = 1.0
        h[0, MATCH_EAST] = h[1, MATCH_NORTH] = h[2, MATCH_YAW] = 1.0
        h[0, YAW], h[1, YAW] = since[1], -since[0]
        if self._error.is_estimated:
            h = self._with_speed_error(h, self._error.duration_s(_sweeps_ns(match)))
        yaw = wrap_pi(match.yaw_rad - float(x[YAW]) + turned - float(x[MATCH_YAW]))
        east = match.east_m - float(x[EAST]) + since[0] - float(x[MATCH_EAST])
        north = match.north_m - float(x[NORTH]) + since[1] - float(x[MATCH_NORTH])
        if self._error.is_integrated:
            return _Observation(h, np.array([east, north, yaw]), match.covariance + late_noise(then, here))
        lag = _lag_now(match, here)
        by_wheels = (1.0 + float(x[SCALE])) * (lag.wheel_m + float(x[WHEEL_LAG]) * lag.wheel_change_m_s)
        if abs(by_wheels - lag.path_m) < _TRACK_FOLLOWS * (1.0 + abs(lag.path_m)):
            ahead = math.cos(match.yaw_rad), math.sin(match.yaw_rad)
            east += (by_wheels - lag.path_m) * ahead[0]
            north += (by_wheels - lag.path_m) * ahead[1]
            for row in (0, 1):
                h[row, SCALE] = -lag.wheel_m * ahead[row]
                h[row, WHEEL_LAG] = -lag.wheel_change_m_s * ahead[row]
        return _Observation(h, np.array([east, north, yaw]), match.covariance + late_noise(then, here))

    def _follows_rejection(self, match: MatchedPose) -> bool:
        """Whether a match was rejected just before: then the pose was wrong, and not the wheels or the yaw rate."""
        if self._rejected_ns is None:
            return False
        return match.time_ns - self._rejected_ns <= self._model.holds_for_s * 1e9

    def _is_pose_less_precise(self, match: MatchedPose) -> bool:
        """Whether the pose is vague where the match is precise: a similar place elsewhere would pass the gate."""
        model, p = self._model, self._state.p
        variances, directions = np.linalg.eigh(match.covariance[:2, :2])
        before = np.einsum("ij,ik,kj->j", directions, p[:2, :2], directions)
        place = (variances < 0.1 * model.match_sure_m**2) & (before > model.match_sure_m**2)
        yaw_vague = p[YAW, YAW] > model.match_sure_rad**2 > 10.0 * match.covariance[2, 2]
        return bool(place.any() or yaw_vague)

    def _detect_slip(self, observation: _Observation, match: MatchedPose) -> bool:
        """Suspect wheel slip where only that explains the match; return whether it is suspected from now on."""
        since_ns = None if self._error.is_estimated else self._contradicts_wheels_since_ns(match)
        if since_ns is None:
            return False
        covariance = self._wheel_slip.covariance_if_slipping(since_ns)
        late_s = (self._error.now_ns - max(match.time_ns, since_ns)) * 1e-9
        h = self._with_speed_error(observation.h, late_s)
        if observation._replace(h=h).nis(covariance) > self._model.slip_gate:
            return False
        self._wheel_slip.begin(since_ns, covariance)
        return True

    def _with_speed_error(self, h: Floats, late_s: float) -> Floats:
        """Return rows (3, n) in which the displacement of `late_s` depends on the error of the speed."""
        h = h.copy()
        yaw = float(self._state.x[YAW])
        h[0, SPEED_ERROR], h[1, SPEED_ERROR] = -late_s * math.cos(yaw), -late_s * math.sin(yaw)
        return h

    def _contradicts_wheels_since_ns(self, match: MatchedPose) -> int | None:
        """Return the time of the newest match since which this one contradicts the distance by the wheels."""
        model, p = self._model, self._state.p
        ahead = np.array([math.cos(match.yaw_rad), math.sin(match.yaw_rad)])
        for one in reversed(self._accepted):
            if match.time_ns - one.time_ns > model.slip_memory_s * 1e9:
                return None
            east, north, _, covariance = one.carried(match.track)
            off = ahead @ (match.east_m - east, match.north_m - north)
            by_scale = float(p[SCALE, SCALE]) * (match.track.wheel_m - one.track.wheel_m) ** 2
            by_lag = float(p[WHEEL_LAG, WHEEL_LAG]) * (match.track.wheel_m_s - one.track.wheel_m_s) ** 2
            both = ahead @ (covariance + match.covariance)[:2, :2] @ ahead
            if off**2 > model.match_gate * (both + by_scale + by_lag):
                return one.time_ns
        return None

    def _independent_share(self, match: MatchedPose) -> float:
        """Return the share of a match, in ]0, 1], that is independent of the one before."""
        if self._last is None or self._wheel_slip.active:  # with slip no other source observes the distance
            return 1.0
        distance = abs(match.track.path_m - self._last.track.path_m) / self._model.match_renewed_m
        time = (match.time_ns - self._last.time_ns) * 1e-9 / self._model.match_renewed_s
        return min(1.0, max(1e-3, distance + time))


def _sweeps_ns(match: MatchedPose) -> int:
    """Return the mean time of the overlaid sweeps of a match."""
    return match.time_ns - round(match.overlay_lag.duration_s * 1e9)


def _lag_now(match: MatchedPose, here: TrackPoint) -> OverlayLag:
    """Return the mean lag of a match's sweeps from the end of the track."""
    then, lag = match.track, match.overlay_lag
    return OverlayLag(
        path_m=here.path_m - then.path_m + lag.path_m,
        wheel_m=here.wheel_m - then.wheel_m + lag.wheel_m,
        wheel_change_m_s=here.wheel_m_s - then.wheel_m_s + lag.wheel_change_m_s,
    )


def late_noise(then: TrackPoint, here: TrackPoint) -> Floats:
    """Return the covariance (3, 3) of the motion between two points of the track, of its length and of its turn."""
    path, turn = abs(here.path_m - then.path_m), abs(here.yaw_rad - then.yaw_rad)
    along = (0.005 * path) ** 2
    return np.diag([along, along, (0.005 * turn) ** 2 + (2e-4 * path) ** 2])

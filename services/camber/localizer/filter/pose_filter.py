"""The localizer's pose without the satellites under test: dead reckoning, links, anchors, start.

Sources: CN101360971 (spec/link-filter.md, numbers in parentheses), spec/reliability-index.md. The document's
coupling takes the errors of `S = (alpha, c, r, phi)` for white. They are not, and the states (`filter_state`)
say so: pose, the sensors' lasting errors (`dead_reckoning`), and what repeated observations have in common
(`link_coupling`, `rotation_coupling`, `anchors`, `scan_matches`), which makes their repetition honest.

What is supported by unconfirmed fixes alone is *provisional*: it teaches the sensors nothing, and once scan matches
have shown where the vehicle is, the pose begins anew from them and owes the fixes nothing.
"""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.filter.anchors import AnchorResult, Anchors, floored
from camber.localizer.filter.consistent_match_sequence import MatchedPose
from camber.localizer.filter.dead_reckoning import (
    BIAS_A,
    BIAS_B,
    EAST,
    NORTH,
    SCALE,
    TURN_GAIN,
    YAW,
    MotionSample,
    MotionStep,
    Outcome,
    OverlayLag,
    RelativeTrack,
    TrackPoint,
    WheelOdometry,
    propagate,
    rotation,
    speed_over_ground,
)
from camber.localizer.filter.filter_state import DEVIATION, LANE, FilterState
from camber.localizer.filter.pose_estimate import Mode, PoseEstimate, Prediction, Provenance
from camber.localizer.filter.pose_initialization import PoseInitialization
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.scan_match_update import MatchUpdate, ScanMatches, late_noise
from camber.localizer.filter.source_conflict import Dispute
from camber.localizer.filter.start import (
    Place,
    StartPose,
    largest_variance,
    lever_arm,
    moved_by_lever,
    require_covariance,
)
from camber.localizer.filter.wheel_slip import WheelSlipDetector
from camber.localizer.filter.yaw_rate_coupling import RotationCoupling
from camber.localizer.links.link_coupling import CouplingResult, LinkCoupling
from camber.localizer.links.link_filter import Array, wrapped
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.matching.match_covariance import DEGENERATE_SIGMA_M

__all__ = [
    "AnchorResult",
    "CouplingResult",
    "MatchUpdate",
    "PoseEstimate",
    "PoseFilter",
    "PoseModel",
    "Prediction",
]

NO_LAG = OverlayLag()


class PoseFilter:
    """One vehicle's pose. Call `predict` with every motion sample, the rest as it comes."""

    def __init__(self, model: PoseModel | None = None) -> None:
        self._model = model or PoseModel()
        motion = self._model.motion
        self._gyro = BIAS_A if motion.a_rate_sensor == "yaw_rate" else BIAS_B
        self._odometer = WheelOdometry(motion)
        self._track = RelativeTrack()
        self._state = FilterState(self._model)
        self._rotation = RotationCoupling(self._state, self._model)
        self._link = LinkCoupling(self._state, self._model)
        self._anchors = Anchors(self._state, self._model)
        self._wheels = WheelSlipDetector(self._state, self._model)
        self._matches = ScanMatches(self._state, self._wheels, self._model)
        self._dispute = Dispute(self._model.holds_for_s)
        self._begin = PoseInitialization(self._state, self._track, self._rotation, self._model)
        self._provenance: Provenance = "none"
        self._last_step: MotionStep | None = None
        self._rate_rad_s: float | None = None
        self._speed_ns: int | None = None
        self._rotation_ns: int | None = None
        self._anchor_ns: int | None = None
        self._match_ns: int | None = None
        self._placed_ns: int | None = None  # of the last match that told both directions
        self._heard_ns = 0  # the latest time of which anything was said
        self._travelled_m = 0.0

    # What is asked of it

    @property
    def track(self) -> RelativeTrack:
        """The dead-reckoned track in a frame of its own, for `StartFromFixes`."""
        return self._track

    @property
    def travelled_m(self) -> float:
        """Path length since the beginning: what `LinkMatcher.step` wants to know."""
        return self._travelled_m

    @property
    def time_ns(self) -> int | None:
        """Time of the estimate: that of the last motion sample."""
        return self._odometer.time_ns

    @property
    def mode(self) -> Mode:
        """none, provisional (fixes alone), scan_match (one holds the pose, along and across), anchored (a confirmed
        fix just now), or dead_reckoning; the last too where matches and anchors contradict each other."""
        if self._provenance == "none":
            return "none"
        if self._provenance == "fixes":
            return "provisional"
        if self._dispute.by(self.time_ns) is not None:
            return "dead_reckoning"
        if self._is_fresh(self._placed_ns, self._model.match_fresh_s):
            return "scan_match"
        fresh = self._is_fresh(self._anchor_ns, self._model.anchored_for_s)
        return "anchored" if fresh and self._provenance == "confirmed" else "dead_reckoning"

    @property
    def accepts_fixes(self) -> bool:
        """Whether unconfirmed fixes may start a pose: there is none, a provisional one, or one that has
        drifted beyond `restart_sigma_m` by its own account."""
        drifted = self._state.horizontal_sigma_m > self._model.restart_sigma_m
        return self.mode in ("none", "provisional") or drifted

    def estimate(self) -> PoseEstimate | None:
        """The pose now; None before the first motion sample or without any start."""
        now = self.time_ns
        if now is None or self._provenance == "none":
            return None
        x, p, step, match = self._state.x, self._state.p, self._last_step, self._link.match
        blind = step is None or self._speed_ns != now
        lane_var = p[LANE, LANE] + p[DEVIATION, DEVIATION] + 2.0 * p[LANE, DEVIATION]
        return PoseEstimate(
            time_ns=now,
            mode=self.mode,
            provenance=self._provenance,
            east_m=float(x[EAST]),
            north_m=float(x[NORTH]),
            yaw_rad=wrapped(float(x[YAW])),
            yaw_known=self._begin.heading_known,
            covariance=p[:3, :3] + self._dispute.covariance(now),
            speed_m_s=None if blind or step is None else self._speed_m_s(step),
            yaw_rate_rad_s=self._rate_rad_s,
            standing=self._odometer.standing,
            speed_age_s=self._age_s(self._speed_ns),
            rotation_age_s=self._age_s(self._rotation_ns),
            anchor_age_s=self._age_s(self._anchor_ns),
            match_age_s=self._age_s(self._placed_ns),
            link_age_s=self._age_s(self._link.coupled_ns),
            link_status=match.status,
            link_id=match.link_id,
            link_level=match.level,
            link_candidates=match.candidates,
            link_offset_m=float(x[LANE] + x[DEVIATION]),
            link_offset_sigma_m=math.sqrt(max(0.0, float(lane_var))),
            disputed_by=self._dispute.by(now),
            wheel_slip_suspected=self._wheels.active,
            motion_late_s=max(0.0, (self._heard_ns - now) * 1e-9),
        )

    def prediction_at(self, time_ns: int) -> Prediction | None:
        """The pose at a time of the last minutes or up to 0.3 s ahead; None outside, and without a pose."""
        then, here = self._track.at(time_ns), self._track_now()
        if self._provenance == "none" or self.time_ns is None or then is None or here is None:
            return None
        x = self._state.x
        frame = float(x[YAW]) - here.yaw_rad
        back = lever_arm(frame, then.east_m - here.east_m, then.north_m - here.north_m)
        covariance = moved_by_lever(self._state.p[:3, :3], *back) + late_noise(then, here)
        return Prediction(
            time_ns,
            float(x[EAST]) + back[0],
            float(x[NORTH]) + back[1],
            wrapped(frame + then.yaw_rad),
            self._begin.heading_known,
            covariance + self._dispute.covariance(self.time_ns),
        )

    # Motion

    def predict(self, sample: MotionSample) -> Outcome:
        """Move on to this sample; says whether it was used."""
        model, state = self._model.motion, self._state
        step = self._odometer.advance(sample, float(state.x[self._gyro]))
        if step.outcome in ("repeated", "backwards"):
            return step.outcome
        self._note_ages(sample)
        self._heard_ns = max(self._heard_ns, sample.time_ns)
        if step.dt_s > model.max_bridge_s:
            self._lose_pose()
        x, p = state.x, state.p
        known = float(x[BIAS_A]), float(x[SCALE]), float(x[TURN_GAIN])
        turn = rotation(step, model.a_rate_sensor, model, *known)
        changed = self._wheels.before(sample.time_ns, sample.speed_m_s, step)
        x, p = state.x, state.p
        if self._wheels.active:
            step = step._replace(standing=False, wheel_change_m_s=0.0)
        self._last_step = step
        speed = self._speed_m_s(step)
        rate = turn.rate_rad_s if turn else 0.0
        self._rate_rad_s = None if turn is None else 0.0 if step.standing else rate
        self._track.append(sample.time_ns, step, speed, rate)
        if step.outcome == "first":
            return step.outcome
        posed = self._provenance != "none"
        self._rotation.accumulate(step, heading_known=posed and self._begin.heading_known)
        path = propagate(x, p, step, turn, model)
        self._travelled_m += path
        state.age_common(self._model, step.dt_s, path, self._link.sigma_m)
        self._wheels.after(step, changed)
        if step.standing:
            self._learn_bias(step)
        if not self._begin.heading_known:
            self._begin.spread(self._track_now())
        elif self._provenance != "none":
            self._lose_what_is_worthless()
        return step.outcome

    def _note_ages(self, sample: MotionSample) -> None:
        rotation_reading = (
            sample.yaw_rate_rad_s if self._model.motion.a_rate_sensor == "yaw_rate" else sample.steering_rad
        )
        if sample.speed_m_s is not None:
            self._speed_ns = sample.time_ns
        if rotation_reading is not None:
            self._rotation_ns = sample.time_ns

    def _learn_bias(self, step: MotionStep) -> None:
        """At a standstill the yaw-rate sensor reads its bias: a measurement of one state."""
        if step.yaw_rate_rad_s is None:
            return
        motion, index, x, p = self._model.motion, self._gyro, self._state.x, self._state.p
        noise_var = motion.yaw_rate_noise_rad_s**2 * max(1.0, motion.noise_hold_s / step.dt_s)
        column = p[:, index].copy()
        variance = float(column[index]) + noise_var
        x += column * ((step.yaw_rate_rad_s - float(x[index])) / variance)
        p -= column[:, None] * (column / variance)

    def _lose_what_is_worthless(self) -> None:
        if self._state.p[YAW, YAW] > self._model.max_yaw_sigma_rad**2:
            self._begin.lose_heading(self._track_now())
            self._anchors.forget()
        if self._state.horizontal_sigma_m > self._model.lost_sigma_m:
            self._lose_pose()

    # Links

    def couple_link(self, match: LinkMatch) -> CouplingResult:
        """Take in the current link, and couple with it where due and where its direction means something."""
        self._link.set_link(match)
        self.couple_rotation()
        if self._provenance == "none" or not self._model.couple_links:
            return CouplingResult("no_pose")
        return self._link.couple(
            self.time_ns,
            self._travelled_m,
            standing=self._odometer.standing,
            heading_known=self._begin.heading_known,
        )

    def couple_rotation(self) -> None:
        """Weigh the two rotation sensors against each other, if there are two."""
        self._rotation.couple()

    # Anchors

    def anchor(self, time_ns: int, east_m: float, north_m: float, covariance: Array) -> AnchorResult:
        """Anchor to the antenna's position by a *confirmed* fix, covariance (2, 2), measured at `time_ns`.

        It may come late by `anchor_max_age_s`: the motion since brings it to the present. An innovation
        outside the gate is refused, until several in a row say the same. ValueError names what is not finite.
        """
        _require_finite(east_m=east_m, north_m=north_m)
        require_covariance("covariance", covariance, 2)
        self._heard_ns = max(self._heard_ns, time_ns)
        now, here = self.time_ns, self._track_now()
        then = self._track.at(time_ns)
        if now is None or then is None or here is None:
            return AnchorResult("ahead" if now is None or time_ns > now else "too_old", None, None, None)
        if now - time_ns > self._model.anchor_max_age_s * 1e9:
            return AnchorResult("too_old", None, None, None)
        noise = floored(covariance, self._model.anchor_sigma_floor_m)
        if self._provenance == "none" or not self._begin.heading_known:
            variance = largest_variance(noise) + self._model.anchor_common_sigma_m**2
            self._begin.add_place(east_m, north_m, variance, then, here)
            result = AnchorResult("accepted", None, None, None)
        else:
            overrules = self._provenance == "fixes"
            held = self._provenance != "fixes" and self._is_fresh(self._match_ns, self._model.holds_for_s)
            result = self._anchors.update(
                time_ns, east_m, north_m, noise, then, here, overrules=overrules, held=held
            )
            if held and self._anchors.insist and result.innovation_m is not None:
                self._dispute.raised("anchors", *result.innovation_m, now)
        if result.accepted:
            self._comes_from("confirmed")
            self._dispute.settled("anchors")
            self._matches.held_at_m = then.path_m
            self._wheels.seen()
            self._anchor_ns = time_ns if self._anchor_ns is None else max(time_ns, self._anchor_ns)
            self._anchors.forget()
        return result

    # Scan matches

    def match(
        self,
        time_ns: int,
        east_m: float,
        north_m: float,
        yaw_rad: float,
        covariance: Array,
        *,
        unique: bool,
        behind: OverlayLag = NO_LAG,
    ) -> MatchUpdate:
        """Take in where the vehicle's reference point was at `time_ns` by a scan match, covariance (3, 3) of
        east, north (m) and yaw (rad), with large variances where the scene determines nothing.

        `unique`: a search around has found no other place as good. `behind`: how far behind the sweeps lie that the
        motion has brought together; the covariance is without the motion's share. It may come late by
        `match_max_age_s`. A
        provisional pose stays as it is, until unique matches that agree support it: then it begins anew from them
        alone. ValueError names what is not finite or not a covariance.
        """
        _require_finite(east_m=east_m, north_m=north_m, yaw_rad=yaw_rad)
        require_covariance("covariance", covariance, 3)
        self._heard_ns = max(self._heard_ns, time_ns)
        now, here, then = self.time_ns, self._track_now(), self._track.at(time_ns)
        if now is None or self._provenance == "none" or here is None:
            return MatchUpdate("no_pose")
        if then is None and time_ns > now:
            return MatchUpdate("ahead")
        newest = self._match_ns is None or time_ns > self._match_ns
        if then is None or not newest or now - time_ns > self._model.match_max_age_s * 1e9:
            return MatchUpdate("too_old")
        seen = MatchedPose(time_ns, east_m, north_m, yaw_rad, self._matches.floored(covariance), then, behind)
        if self._provenance == "fixes":
            return self._support(seen, here, unique=unique)
        if not self._begin.heading_known:
            return self._show_heading(seen, here, unique=unique)
        result = self._matches.update(seen, here, unique=unique)
        if result.accepted:
            self._taken(seen)
            self._dispute.settled("matches")
        elif self._matches.insist:
            result = self._hear_insisting(seen, here, result)
        return result

    def motion_share(self, behind: OverlayLag, yaw_rad: float) -> Array:
        """Covariance (3, 3) that a match of sweeps which lie so far behind owes to what the wheels are not known by."""
        return self._matches.motion_share(behind, yaw_rad)

    def _support(self, seen: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """Nothing but fixes stands for the pose: begin anew from matches that agree, far or long enough."""
        model, run = self._model, self._matches.run
        run.add(seen, unique=unique)
        enough = run.path_m >= model.support_after_m or run.duration_s >= model.support_after_s
        if not unique or run.count < model.support_after_matches or not enough:
            return MatchUpdate("provisional")
        self._begin_from(seen, here, np.zeros(2))
        self._comes_from("scan_match")
        self._anchor_ns = None
        self._link.forget()
        self._state.forget_common(model)
        return MatchUpdate("supported")

    def _show_heading(self, seen: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """The place is known and the heading is not: a unique match at that place shows it."""
        x, variance = self._state.x, largest_variance(self._state.p) + largest_variance(seen.covariance)
        east, north, yaw, _ = seen.carried(here)
        off = (east - float(x[EAST]), north - float(x[NORTH]), wrapped(yaw - float(x[YAW])))
        nis = (off[0] ** 2 + off[1] ** 2) / variance
        if not unique or nis > self._model.match_gate:
            return MatchUpdate("outside_gate", nis, off)
        self._begin_from(seen, here, np.zeros(2))
        return MatchUpdate("accepted", nis, off)

    def _hear_insisting(self, seen: MatchedPose, here: TrackPoint, refused: MatchUpdate) -> MatchUpdate:
        """Refused matches agree with one another: believe them, or own that they dispute the pose."""
        assert refused.innovation is not None
        assert self.time_ns is not None
        off = np.array(refused.innovation[:2])
        anchored = self._is_fresh(self._anchor_ns, self._model.holds_for_s)
        if not anchored and self._matches.may_recover(seen, here):
            self._begin_from(seen, here, off)
            return refused._replace(outcome="recovered")
        self._dispute.raised("matches", float(off[0]), float(off[1]), self.time_ns)
        return refused

    def _begin_from(self, seen: MatchedPose, here: TrackPoint, off_m: Array) -> None:
        """The pose of a match, doubted a little; `off_m`: by how much another one was given up."""
        model = self._model
        doubt = np.diag([model.support_sigma_m**2] * 2 + [model.support_sigma_rad**2])
        doubt[:2, :2] += 0.01 * np.outer(off_m, off_m)
        place = (seen.east_m, seen.north_m, seen.yaw_rad)
        self._begin.at_past_pose(*place, seen.covariance + doubt, seen.track, here)
        self._anchors.forget()
        self._dispute.forget()
        self._wheels.forget()
        self._matches.forget()
        self._matches.taken(seen)
        self._taken(seen)

    def _taken(self, seen: MatchedPose) -> None:
        """A match has entered; one that leaves a direction open places nothing along it."""
        self._match_ns = seen.time_ns
        if largest_variance(seen.covariance) <= DEGENERATE_SIGMA_M**2:
            self._placed_ns = seen.time_ns

    # Start and loss

    def start(self, pose: StartPose) -> bool:
        """Start anew from a given pose, or from fixes where `accepts_fixes` allows; whether it was taken."""
        if pose.provenance == "fixes":
            if not self.accepts_fixes:
                return False
            known = self._provenance == "fixes" and self._begin.heading_known
            drifted = self._state.horizontal_sigma_m > self._model.restart_sigma_m
            if known and pose.yaw_rad is None and not drifted:
                return False
        now, here = self.time_ns, self._track_now()
        then = here if now is None else self._track.at(pose.time_ns)
        if then is None or here is None:
            return False
        yaw_var = float(pose.covariance[2, 2])
        if pose.yaw_rad is None or yaw_var > self._model.max_yaw_sigma_rad**2:
            place = Place(pose.east_m, pose.north_m, largest_variance(pose.covariance), then)
            self._begin.at_place(place, here)
        else:
            self._begin.at_past_pose(pose.east_m, pose.north_m, pose.yaw_rad, pose.covariance, then, here)
        self._comes_from(pose.provenance)
        if pose.provenance != "fixes":
            self._matches.forget()
        self._forget_witnesses()
        return True

    def _lose_pose(self) -> None:
        self._comes_from("none")
        self._begin.at_pose(0.0, 0.0, 0.0, np.zeros((3, 3)))
        self._matches.forget()
        self._forget_witnesses()

    def _forget_witnesses(self) -> None:
        self._anchor_ns = self._match_ns = self._placed_ns = None
        self._anchors.forget()
        self._dispute.forget()
        self._link.forget()

    def _comes_from(self, provenance: Provenance) -> None:
        """The pose comes from there now; one from fixes alone teaches the sensors nothing."""
        self._provenance = provenance
        self._state.sensors_learn = provenance != "fixes"

    def shifted(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north): every place is told from there."""
        if not (math.isfinite(east_m) and math.isfinite(north_m)):
            raise ValueError("east_m, north_m: must be finite")
        self._state.x[EAST] -= east_m
        self._state.x[NORTH] -= north_m
        self._begin.shift(east_m, north_m)
        self._matches.shift(east_m, north_m)
        self._link.shifted(east_m, north_m)

    # Small things

    def _track_now(self) -> TrackPoint | None:
        """The end of the track; before any motion, its beginning."""
        now = self.time_ns
        return TrackPoint(0.0, 0.0, 0.0, 0.0) if now is None else self._track.at(now)

    def _speed_m_s(self, step: MotionStep) -> float:
        return speed_over_ground(self._state.x, step)

    def _is_fresh(self, time_ns: int | None, for_s: float) -> bool:
        age_s = self._age_s(time_ns)
        return age_s is not None and age_s <= for_s

    def _age_s(self, time_ns: int | None) -> float | None:
        now = self.time_ns
        return None if time_ns is None or now is None else (now - time_ns) * 1e-9


def _require_finite(**values: float) -> None:
    """ValueError naming the first that is not."""
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f"{name}: must be finite; got {value}")

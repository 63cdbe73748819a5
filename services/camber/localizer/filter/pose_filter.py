"""The localizer's pose filter: dead reckoning, links, anchors and scan matches, independent of the satellites under
test.

Sources: CN101360971 (spec/link-filter.md); Kikuchi (TUMSAT), reliability index (spec/reliability-index.md). CN101360971
takes the errors of `S = (alpha, c, r, phi)` for white. They are not: pose, lasting errors of the sensors
(`dead_reckoning_time_update`) and the errors common to repeated observations (`link_coupling`, `yaw_rate_coupling`,
`anchors`, `scan_match_update`) are states (`filter_state`), so that repetition does not make the covariance too small.

A pose that rests on unconfirmed fixes alone is *provisional*: the sensors learn nothing from it, and once scan matches
have shown where the vehicle is, the pose restarts from them and no longer depends on the fixes.
"""

from __future__ import annotations

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats, require_covariance, require_finite
from camber.localizer.contradictions.odometry_contradiction import OdometryContradiction
from camber.localizer.contradictions.path_comparison import PathTest, PlacedPosition
from camber.localizer.contradictions.sensor_bounds import SensorFault
from camber.localizer.filter.anchors import AnchorResult, Anchors, floored
from camber.localizer.filter.consistent_match_sequence import MatchedPose
from camber.localizer.filter.dead_reckoning_time_update import (
    BIAS_A,
    BIAS_B,
    EAST,
    NORTH,
    SCALE,
    TURN_GAIN,
    YAW,
    propagate,
    speed_over_ground,
)
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.heading_search import TrackedPosition
from camber.localizer.filter.odometry import (
    InertialReading,
    MotionStep,
    SampleOutcome,
    WheelOdometry,
    reading,
    yaw_rate,
)
from camber.localizer.filter.planar_pose import covariance_at_offset, largest_variance, rotated
from camber.localizer.filter.pose_estimate import Mode, PoseEstimate, Prediction, Provenance
from camber.localizer.filter.pose_initialization import PoseInitialization
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.scan_match_update import MatchUpdate, ScanMatches, late_noise
from camber.localizer.filter.source_conflict import SourceConflict
from camber.localizer.filter.speed_error import SpeedError
from camber.localizer.filter.start_from_fixes import StartPose
from camber.localizer.filter.track import OverlayLag, RelativeTrack, TrackPoint
from camber.localizer.filter.wheel_slip import WheelSlipDetector
from camber.localizer.filter.yaw_rate_coupling import YawRateCoupling
from camber.localizer.inertial.inertial_speed import InertialSpeed
from camber.localizer.links.link_coupling import CouplingOutcome, LinkCoupling
from camber.localizer.links.link_matching import LinkMatch
from camber.localizer.matching.match_covariance import DEGENERATE_SIGMA_M
from camber.schemas.motion import Motion

_NO_LAG = OverlayLag()
_OVERLAY_S = 1.0  # sweeps that are overlaid in a match are no older
_KNOWN_SPEED_SIGMA_M_S = 0.2  # chosen: a fifth of a metre over the second in which the judge carries a pose
_SHAPELESS_SIGMA_M_S = 1.0  # chosen: a track whose speed is off by half would fit positions in reverse
_RECOVERY_SHARE = 0.01  # chosen: (a tenth)² of the offset from a pose that was given up adds to the variance


class PoseFilter:
    """Estimates one vehicle's pose. Call `predict` with every motion sample, the updates as they come."""

    def __init__(self, model: PoseModel | None = None, *, extra_states: int = 0) -> None:
        self.model = model or PoseModel()
        motion = self.model.motion
        self._gyro = BIAS_A if motion.a_rate_sensor == "yaw_rate" else BIAS_B
        self._odometer = WheelOdometry(motion)
        self.track = RelativeTrack()
        """The dead-reckoned track in a frame of its own."""
        self.travelled_m = 0.0
        """Path length since the beginning."""
        self.state = FilterState(self.model, extra_states)
        self._yaw_rates = YawRateCoupling(self.state, self.model)
        self._link = LinkCoupling(self.state, self.model)
        self._speed_error = SpeedError(self.state, self.model.anchor_max_age_s + _OVERLAY_S)
        self._anchors = Anchors(self.state, self._speed_error, self.model)
        self._wheel_slip = WheelSlipDetector(self.state, self._speed_error, self.model)
        self._inertial_speed = InertialSpeed(
            self.state, self._speed_error, motion=motion, acceleration=self.model.acceleration
        )
        self._matches = ScanMatches(self.state, self._wheel_slip, self._speed_error, self.model)
        self._conflict = SourceConflict(self.model.holds_for_s)
        self._odometry = OdometryContradiction(self.state, self.model)
        self._initialization = PoseInitialization(self.state, self._yaw_rates, self.model)
        self._provenance: Provenance = "none"
        self._last_sample: Motion | None = None
        self._last_step: MotionStep | None = None
        self._rate_rad_s: float | None = None
        self._anchor_ns: int | None = None
        self._match_ns: int | None = None
        self._position_match_ns: int | None = None  # of the last match that determined both directions

    @property
    def time_ns(self) -> int | None:
        """Time of the estimate: that of the last motion sample."""
        return self._odometer.time_ns

    @property
    def mode(self) -> Mode:
        """none, provisional (fixes alone), scan_match (a fresh one determines along and across), anchored (by a fresh
        confirmed fix), or dead_reckoning; the last too where matches and anchors contradict each other."""
        if self._provenance == "none":
            return "none"
        if self._provenance == "fixes":
            return "provisional"
        if self._conflict.source(self.time_ns) is not None:
            return "dead_reckoning"
        if self._is_fresh(self._position_match_ns, self.model.match_fresh_s):
            return "scan_match"
        fresh = self._is_fresh(self._anchor_ns, self.model.anchored_for_s)
        return "anchored" if fresh and self._provenance == "confirmed" else "dead_reckoning"

    @property
    def speed_is_integrated(self) -> bool:
        """Whether an accelerometer carries the speed on, as the wheels give none."""
        return self._speed_error.is_integrated

    @property
    def speed_is_unknown(self) -> bool:
        """Whether the track has no shape to compare with positions: its speed is a vague integral."""
        return self._speed_error.is_integrated and self._inertial_speed.sigma_m_s > _SHAPELESS_SIGMA_M_S

    @property
    def speed_sigma_m_s(self) -> float:
        """σ of an integrated speed."""
        return self._inertial_speed.sigma_m_s

    @property
    def measures_distance(self) -> bool:
        """Whether the distance driven in a second is known to a decimetre or two: no wheel slip, no vague speed."""
        if self._speed_error.is_integrated:
            return self._inertial_speed.sigma_m_s < _KNOWN_SPEED_SIGMA_M_S
        return not self._wheel_slip.active

    @property
    def wheel_slip_suspected(self) -> bool:
        """Whether the wheels do not show the vehicle's speed."""
        return self._wheel_slip.active

    @property
    def accepts_fixes(self) -> bool:
        """Whether unconfirmed fixes may start a pose: there is none, a provisional one, or one whose σ exceeds
        `restart_sigma_m`."""
        drifted = self.state.horizontal_sigma_m > self.model.restart_sigma_m
        return self.mode in ("none", "provisional") or drifted

    @property
    def sensor_fault(self) -> SensorFault | None:
        """The sensor's error that has left its physical bound, while it lasts."""
        return self._odometry.sensor_fault(self.time_ns)

    @property
    def path_fault(self) -> PathTest | None:
        """The comparison by which anchors depart from the path by odometry, while that lasts."""
        return self._odometry.path_fault(self.time_ns)

    def use_sensors_of(self, other: PoseFilter) -> None:
        """Compare anchors with the path by odometry as calibrated by another filter, which has no anchors."""
        self._odometry.use_sensors(other.state)

    def estimate(self) -> PoseEstimate | None:
        """Return the present pose; None before the first motion sample and without a start."""
        now, sample, step = self.time_ns, self._last_sample, self._last_step
        if now is None or sample is None or step is None or self._provenance == "none":
            return None
        x = self.state.x
        return PoseEstimate(
            time_ns=now,
            mode=self.mode,
            provenance=self._provenance,
            east_m=float(x[EAST]),
            north_m=float(x[NORTH]),
            yaw_rad=wrap_pi(float(x[YAW])),
            yaw_known=self._initialization.heading_known,
            covariance=self.state.p[:3, :3] + self._conflict.covariance(now),
            speed_m_s=speed_over_ground(x, step) if self._knows_speed(sample) else None,
            yaw_rate_rad_s=self._rate_rad_s,
            rotation_read=reading(sample, self.model.motion.a_rate_sensor) is not None,
            anchor_time_ns=self._anchor_ns,
            match_time_ns=self._position_match_ns,
            link=self._link.match,
            conflict=self._conflict.source(now),
            wheel_slip_suspected=self._wheel_slip.active,
        )

    def prediction_at(self, time_ns: int) -> Prediction | None:
        """Return the pose at a time of the last minutes or up to 0.3 s ahead; None outside, and without a pose."""
        then, here = self.track.at(time_ns), self._track_now()
        if self._provenance == "none" or self.time_ns is None or then is None or here is None:
            return None
        x = self.state.x
        frame = float(x[YAW]) - here.yaw_rad
        back = rotated(frame, then.east_m - here.east_m, then.north_m - here.north_m)
        covariance = covariance_at_offset(self.state.p[:3, :3], *back) + late_noise(then, here)
        return Prediction(
            time_ns=time_ns,
            east_m=float(x[EAST]) + back[0],
            north_m=float(x[NORTH]) + back[1],
            yaw_rad=wrap_pi(frame + then.yaw_rad),
            yaw_known=self._initialization.heading_known,
            covariance=covariance + self._conflict.covariance(self.time_ns),
        )

    def predict(self, sample: Motion, inertial: InertialReading | None = None) -> SampleOutcome:
        """Propagate the pose to this sample, with what an inertial unit has measured; return whether it was used."""
        model, state = self.model.motion, self.state
        may_stand = (
            inertial is not None
            and self._speed_error.is_integrated
            and self._inertial_speed.may_stand(inertial.quiet_s)
        )
        step = self._odometer.advance(sample, float(state.x[self._gyro]), inertial, may_stand=may_stand)
        if step.outcome in ("repeated", "backwards"):
            return step.outcome
        before, self._last_sample = self._last_sample, sample
        if step.dt_s > model.max_bridge_s:
            self._lose_pose()
        bias, scale, gain = float(state.x[BIAS_A]), float(state.x[SCALE]), float(state.x[TURN_GAIN])
        turn = yaw_rate(step, model.a_rate_sensor, model, bias=bias, scale=scale, gain=gain)
        self._begin_speed(before, step, inertial)
        slip_change = self._wheel_slip.before_step(sample.time_ns, sample.wheel_speed_m_s, step)
        if self._wheel_slip.active:
            step = step._replace(standing=False, wheel_change_m_s=0.0)
        self._last_step = step
        speed = speed_over_ground(self.state.x, step)
        rate = turn.rate_rad_s if turn else 0.0
        self._rate_rad_s = None if turn is None else 0.0 if step.standing else rate
        tilt = (0.0, 0.0) if inertial is None else (inertial.roll_rad, inertial.pitch_rad)
        self.track.append(sample.time_ns, step, speed, rate, tilt_rad=tilt)
        if step.outcome == "first":
            return step.outcome
        posed = self._provenance != "none"
        self._yaw_rates.accumulate(step, heading_known=posed and self._initialization.heading_known)
        path = propagate(state.x, state.p, step, turn=turn, model=model)
        self.travelled_m += path
        state.age_common(self.model, step.dt_s, path, self._link.sigma_m)
        self._wheel_slip.after_step(step, slip_change)
        if inertial is not None and step.is_integrated:
            self._inertial_speed.after_step(step, inertial)
        if step.standing:
            self._learn_bias(step)
        if step.outcome == "gap":
            self._matches.forget()
        if not self._initialization.heading_known:
            if step.outcome == "gap":
                self._initialization.lose_heading(self._track_now())
            else:
                self._initialization.spread(self._track_now())
        elif self._provenance != "none":
            self._drop_lost_estimates()
        self._odometry.advance(sample.time_ns, step)
        return step.outcome

    def _begin_speed(self, before: Motion | None, step: MotionStep, inertial: InertialReading | None) -> None:
        """Begin or end to integrate the speed, where the wheels have ceased or begun to give it; `before` is the sample
        before this one.

        While wheels and unit are both silent the last speed is held, with its error.
        """
        sample, error, last = self._last_sample, self._speed_error, self._last_step
        assert sample is not None
        error.now_ns = sample.time_ns
        if sample.wheel_speed_m_s is not None:
            if error.is_integrated:
                self._inertial_speed.end()
            return
        if inertial is None:
            return
        begin_ns = sample.time_ns - round(step.dt_s * 1e9)
        goes_on = error.is_integrated and last is not None and last.is_integrated
        if step.outcome == "gap":
            self._wheel_slip.forget()
            self._inertial_speed.begin_unknown(begin_ns)
        elif not step.is_integrated or goes_on:
            return
        elif before is not None and before.wheel_speed_m_s is not None:
            self._inertial_speed.begin_from_wheels(begin_ns, before.wheel_speed_m_s)
            self._wheel_slip.active = False
        elif inertial.quiet_s > 0.0:
            self._inertial_speed.begin_at_rest(begin_ns)
        else:
            self._inertial_speed.begin_unknown(begin_ns)

    def _knows_speed(self, sample: Motion) -> bool:
        """Whether the speed is known: by the wheels, or by fresh matches that an accelerometer carries on."""
        if sample.wheel_speed_m_s is not None:
            return True
        matched = self._is_fresh(self._position_match_ns, self.model.match_fresh_s)
        return (
            self._speed_error.is_integrated
            and matched
            and self._inertial_speed.sigma_m_s < _KNOWN_SPEED_SIGMA_M_S
        )

    def _learn_bias(self, step: MotionStep) -> None:
        """At a standstill the yaw-rate sensor reads its bias: a measurement of one state."""
        if step.yaw_rate_rad_s is None:
            return
        motion, index, x, p = self.model.motion, self._gyro, self.state.x, self.state.p
        noise_var = motion.yaw_rate_noise_rad_s**2 * max(1.0, motion.noise_hold_s / step.dt_s)
        column = p[:, index].copy()
        variance = float(column[index]) + noise_var
        x += column * ((step.yaw_rate_rad_s - float(x[index])) / variance)
        p -= column[:, None] * (column / variance)

    def _drop_lost_estimates(self) -> None:
        """Drop a heading or a pose whose σ is beyond use."""
        if self.state.p[YAW, YAW] > self.model.max_yaw_sigma_rad**2:
            self._initialization.lose_heading(self._track_now())
            self._anchors.forget()
        if self.state.horizontal_sigma_m > self.model.lost_sigma_m:
            self._lose_pose()

    def couple_link(self, match: LinkMatch) -> CouplingOutcome:
        """Set the current link and couple the pose with it, where due and where its direction is meaningful."""
        self._link.set_link(match)
        self.couple_rotation()
        if self._provenance == "none" or not self.model.couple_links:
            return "no_pose"
        standing, heading_known = self._odometer.standing, self._initialization.heading_known
        return self._link.couple(self.travelled_m, standing=standing, heading_known=heading_known)

    def couple_rotation(self) -> None:
        """Couple the two rotation sensors, where there are two."""
        self._yaw_rates.couple()

    def anchor(self, time_ns: int, east_m: float, north_m: float, covariance: Floats) -> AnchorResult:
        """Update by the antenna's position of a *confirmed* fix, covariance (2, 2), measured at `time_ns`.

        It may be late by `anchor_max_age_s`: the motion since carries it to the present. An innovation outside the
        gate is rejected until several in a row agree. ValueError names what is not finite.
        """
        require_finite(east_m=east_m, north_m=north_m)
        require_covariance("covariance", covariance, 2)
        now, here = self.time_ns, self._track_now()
        then = self.track.at(time_ns)
        if now is None or then is None or here is None:
            return AnchorResult("ahead" if now is None or time_ns > now else "too_old")
        if now - time_ns > self.model.anchor_max_age_s * 1e9:
            return AnchorResult("too_old")
        noise = floored(covariance, self.model.anchor_sigma_floor_m)
        variance = largest_variance(noise) + self.model.anchor_common_sigma_m**2
        position = TrackedPosition(east_m, north_m, variance, then)
        if self._provenance == "none" or not self._initialization.heading_known:
            if self.speed_is_unknown:
                return AnchorResult("no_speed")
            self._initialization.add_position(position, here)
            result = AnchorResult("accepted")
        else:
            provisional, before_m = self._provenance == "fixes", self.state.x[:2].copy()
            held = not provisional and self._is_fresh(self._match_ns, self.model.holds_for_s)
            result = self._anchors.update(
                time_ns, (east_m, north_m), noise, then=then, here=here, overrules=provisional, held=held
            )
            if held and self._anchors.is_persistent and result.innovation_m is not None:
                self._conflict.report("anchors", result.innovation_m, now)
            self._compare_with_odometry(position, here, before_m)
        if result.accepted:
            self._set_provenance("confirmed")
            self._conflict.resolve("anchors")
            self._matches.held_at_m = then.path_m
            self._wheel_slip.mark_observed()
            self._anchor_ns = time_ns if self._anchor_ns is None else max(time_ns, self._anchor_ns)
            self._anchors.forget()
        return result

    def match(
        self,
        time_ns: int,
        pose: tuple[float, float, float],
        covariance: Floats,
        *,
        unique: bool,
        overlay_lag: OverlayLag = _NO_LAG,
        restart: bool = False,
    ) -> MatchUpdate:
        """Update by a scan match: east, north, yaw of the vehicle's reference point at `time_ns`, covariance (3, 3).

        The covariance is without the share of the motion (`motion_share`), and large along what the scene leaves open.
        `unique`: a search has excluded other positions. A match may be late by `match_max_age_s`. A provisional pose
        is not updated: it restarts from unique matches that agree. So does any pose with `restart`, for matches that
        were not searched around it, where it may be there by its covariance; and where there is none, it starts.
        ValueError names what is not finite.
        """
        east_m, north_m, yaw_rad = (float(value) for value in pose)
        require_finite(east_m=east_m, north_m=north_m, yaw_rad=yaw_rad)
        require_covariance("covariance", covariance, 3)
        now, here, then = self.time_ns, self._track_now(), self.track.at(time_ns)
        if now is None or here is None or (self._provenance == "none" and not restart):
            return MatchUpdate("no_pose")
        if then is None and time_ns > now:
            return MatchUpdate("ahead")
        newest = self._match_ns is None or time_ns > self._match_ns
        if then is None or not newest or now - time_ns > self.model.match_max_age_s * 1e9:
            return MatchUpdate("too_old")
        match = MatchedPose(
            time_ns=time_ns,
            east_m=east_m,
            north_m=north_m,
            yaw_rad=yaw_rad,
            covariance=self._matches.floored(covariance),
            track=then,
            overlay_lag=overlay_lag,
        )
        if restart or self._provenance == "fixes":
            return self._restart_from(match, here, unique=unique)
        if not self._initialization.heading_known:
            return self._determine_heading(match, here, unique=unique)
        result = self._matches.update(match, here, unique=unique)
        if result.accepted:
            self._note_match(match)
            self._conflict.resolve("matches")
        elif self._matches.is_persistent:
            result = self._handle_persistent(match, here, result)
        return result

    def _compare_with_odometry(self, position: TrackedPosition, here: TrackPoint, before_m: Floats) -> None:
        """Compare an anchor with odometry; where they contradict each other the covariance covers both."""
        assert self.time_ns is not None
        now_ns, then, x = self.time_ns, position.track, self.state.x
        frame = float(x[YAW]) - here.yaw_rad
        since = rotated(frame, here.east_m - then.east_m, here.north_m - then.north_m)
        lever = rotated(frame + then.yaw_rad, self.model.antenna_x_m, self.model.antenna_y_m)
        at = np.array((position.east_m + since[0] - lever[0], position.north_m + since[1] - lever[1]))
        placed = PlacedPosition(at, np.eye(2) * position.variance_m2)
        departure = self._odometry.add_anchor(
            now_ns, placed, moved_m=x[:2] - before_m, travelled_m=self.travelled_m
        )
        if departure is not None:
            self._conflict.report("odometry", (float(departure[0]), float(departure[1])), now_ns)

    def motion_share(self, overlay_lag: OverlayLag, yaw_rad: float) -> Floats:
        """Return the covariance (3, 3) of a match by the wheels' unknown errors over the overlay's lag."""
        return self._matches.motion_share(overlay_lag, yaw_rad)

    def _restart_from(self, match: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """Replace the pose, once matches agree over a distance or a time; one by other evidence than fixes only where
        it may be so far off."""
        model, sequence = self.model, self._matches.sequence
        known = self._provenance not in ("none", "fixes") and self._initialization.heading_known
        if known and not self._matches.is_within_gate(match, here):
            return MatchUpdate("outside_gate")
        sequence.add(match, unique=unique)
        enough = sequence.path_m >= model.support_after_m or sequence.duration_s >= model.support_after_s
        if not unique or sequence.count < model.support_after_matches or not enough:
            return MatchUpdate("provisional")
        self._begin_from(match, here, np.zeros(2))
        self._set_provenance("scan_match")
        self._anchor_ns = None
        self._link.forget()
        self.state.forget_common(model)
        return MatchUpdate("supported")

    def _determine_heading(self, match: MatchedPose, here: TrackPoint, *, unique: bool) -> MatchUpdate:
        """Take the heading of a unique match at the known position."""
        x, variance = self.state.x, largest_variance(self.state.p) + largest_variance(match.covariance)
        east, north, yaw, _ = match.carried(here)
        offset = (east - float(x[EAST]), north - float(x[NORTH]), wrap_pi(yaw - float(x[YAW])))
        nis = (offset[0] ** 2 + offset[1] ** 2) / variance
        if not unique or nis > self.model.match_gate:
            return MatchUpdate("outside_gate", offset)
        self._begin_from(match, here, np.zeros(2))
        return MatchUpdate("accepted", offset)

    def _handle_persistent(self, match: MatchedPose, here: TrackPoint, rejected: MatchUpdate) -> MatchUpdate:
        """Recover by rejected matches that agree with one another, or report the conflict."""
        assert rejected.innovation is not None
        assert self.time_ns is not None
        east_m, north_m, _ = rejected.innovation
        anchored = self._is_fresh(self._anchor_ns, self.model.holds_for_s)
        if not anchored and self._matches.can_recover(match, here):
            self._begin_from(match, here, np.array([east_m, north_m]))
            return rejected._replace(outcome="recovered")
        self._conflict.report("matches", (east_m, north_m), self.time_ns)
        return rejected

    def _begin_from(self, match: MatchedPose, here: TrackPoint, offset_m: Floats) -> None:
        """Restart from a match with an enlarged covariance; `offset_m`: from the pose that was given up."""
        model = self.model
        added = np.diag([model.support_sigma_m**2] * 2 + [model.support_sigma_rad**2])
        added[:2, :2] += _RECOVERY_SHARE * np.outer(offset_m, offset_m)
        self._initialization.at_past_pose(match._replace(covariance=match.covariance + added), here)
        self._anchors.forget()
        self._conflict.forget()
        self._odometry.forget()
        self._wheel_slip.forget()
        self._matches.forget()
        self._matches.accept(match)
        self._note_match(match)

    def _note_match(self, match: MatchedPose) -> None:
        """Note the time of a match; one that leaves a direction open determines no position."""
        self._match_ns = match.time_ns
        if largest_variance(match.covariance) <= DEGENERATE_SIGMA_M**2:
            self._position_match_ns = match.time_ns

    def start(self, pose: StartPose) -> bool:
        """Start from a given pose, or from fixes where `accepts_fixes` allows; return whether the pose was used."""
        if pose.provenance == "fixes":
            if not self.accepts_fixes:
                return False
            known = self._provenance == "fixes" and self._initialization.heading_known
            drifted = self.state.horizontal_sigma_m > self.model.restart_sigma_m
            if known and pose.yaw_rad is None and not drifted:
                return False
        now, here = self.time_ns, self._track_now()
        then = here if now is None else self.track.at(pose.time_ns)
        if then is None or here is None:
            return False
        yaw_var = float(pose.covariance[2, 2])
        if pose.yaw_rad is None or yaw_var > self.model.max_yaw_sigma_rad**2:
            variance = largest_variance(pose.covariance)
            self._initialization.at_position(TrackedPosition(pose.east_m, pose.north_m, variance, then), here)
        else:
            past = MatchedPose(
                time_ns=pose.time_ns,
                east_m=pose.east_m,
                north_m=pose.north_m,
                yaw_rad=pose.yaw_rad,
                covariance=pose.covariance,
                track=then,
            )
            self._initialization.at_past_pose(past, here)
        self._set_provenance(pose.provenance)
        if pose.provenance != "fixes":
            self._matches.forget()
        self._forget_sources()
        return True

    def _lose_pose(self) -> None:
        self._set_provenance("none")
        self._initialization.at_pose(0.0, 0.0, 0.0, np.zeros((3, 3)))
        self._matches.forget()
        self._forget_sources()

    def _forget_sources(self) -> None:
        self._anchor_ns = self._match_ns = self._position_match_ns = None
        self._anchors.forget()
        self._conflict.forget()
        self._odometry.forget()
        self._link.forget()

    def _set_provenance(self, provenance: Provenance) -> None:
        """Set the provenance; by a pose from fixes alone the sensors' errors are not learnt."""
        self._provenance = provenance
        self.state.sensors_learn = provenance != "fixes"

    def shift_origin(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        require_finite(east_m=east_m, north_m=north_m)
        self.state.x[EAST] -= east_m
        self.state.x[NORTH] -= north_m
        self._initialization.shift(east_m, north_m)
        self._matches.shift(east_m, north_m)
        self._link.shift(east_m, north_m)
        self._odometry.shift(east_m, north_m)

    def _track_now(self) -> TrackPoint | None:
        """Return the end of the track; before any motion, its beginning."""
        now = self.time_ns
        return TrackPoint() if now is None else self.track.at(now)

    def _is_fresh(self, time_ns: int | None, for_s: float) -> bool:
        now = self.time_ns
        return time_ns is not None and now is not None and (now - time_ns) * 1e-9 <= for_s

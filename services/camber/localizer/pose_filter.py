"""The localizer's pose without the satellites under test: dead reckoning, links, anchors, start.

Sources: CN101360971 (spec/link-filter.md, numbers in parentheses), spec/reliability-index.md. The document's
coupling takes the errors of `S = (alpha, c, r, phi)` for white. They are not, and twelve states say so:
pose, the sensors' lasting errors (`dead_reckoning`), and five that make repeated coupling honest.

**Row 1 of h (3)**, `-x sin(alpha) + y cos(alpha) + c - r = 0`. A coarse link departs from its road by up to
metres, and slowly: applied at every epoch as if independent, row 1 would claim `sigma / sqrt(n)`. So
`r = lane + deviation` is part of the state: `lane`, the vehicle's offset from the road's line, stays (it walks
a little with the distance, and more in a turn); `deviation` is a Gauss-Markov process along the distance
travelled, of the link's own sigma and a length of `deviation_length_m`. As a perfect measurement of the state
`(X, r)` row 1 may then be applied as often as one likes: what is old in it brings no gain. The document's "r
stays what it was when the satellites were lost" is the case of a zero distance; every anchor measures r anew
through the correlations. At a standstill there is nothing to gain and nothing is coupled.

**Row 2**, `yaw - alpha + phi = 0`, with `phi = alpha - yaw_B`: alpha cancels, whatever its error. B's heading
starts from the heading at the last coupling, `yaw_B = yaw_0 + D_B`, and A's is `yaw = yaw_0 + D_A`. The error
of `yaw_0` is in both and cancels: `h_2 = D_A - D_B`, whose errors are only those of the increments. So
`yaw_0` is a state (a clone of yaw, fully correlated with it at first), the row is `(yaw - yaw_0) - D_B = 0`,
its noise is B's noise since the last coupling, and B's bias, which the next increment repeats, is a state too.
A common rotation of everything is left untouched by it, as it must.

**Anchors**: a confirmed fix is `antenna = position + lever arm + common + noise`, `common` a Gauss-Markov
process in time, for the errors of consecutive fixes resemble each other: a thousand anchors at a standstill
do not make a millimetre.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.dead_reckoning import (
    BIAS_A,
    BIAS_B,
    EAST,
    N_MOTION,
    NORTH,
    SCALE,
    SIDE_SLIP,
    YAW,
    MotionModel,
    MotionSample,
    MotionStep,
    Odometer,
    Outcome,
    RelativeTrack,
    TrackPoint,
    propagate,
    rotation,
)
from camber.localizer.link_filter import (
    Array,
    inverse_2x2,
    jacobian_s,
    jacobian_x,
    kalman_update,
    observation,
    wrapped,
)
from camber.localizer.link_matching import LinkId, LinkMatch
from camber.localizer.start import (
    HeadingModel,
    HeadingSearch,
    Place,
    StartPose,
    largest_variance,
    lever_arm,
    moved_by_lever,
    require_covariance,
)

Mode: TypeAlias = Literal["none", "provisional", "anchored", "dead_reckoning"]
Provenance: TypeAlias = Literal["none", "fixes", "given", "confirmed"]
AnchorOutcome: TypeAlias = Literal["accepted", "recovered", "outside_gate", "too_old", "ahead"]
CouplingOutcome: TypeAlias = Literal[
    "coupled",
    "no_pose",
    "no_heading",
    "standing",
    "not_matched",
    "too_soon",
    "not_parallel",
    "near_bend",
    "rejected",
]

YAW_0: Final = N_MOTION  # yaw at the last coupling of the two rotation sensors
LANE: Final = N_MOTION + 1  # the lasting part of r (m)
DEVIATION: Final = N_MOTION + 2  # the part of r that is the link's own (m)
COMMON_EAST: Final = N_MOTION + 3  # what consecutive anchors have in common (m)
COMMON_NORTH: Final = N_MOTION + 4
N_STATES: Final = N_MOTION + 5
_TURN_FLOOR_RAD2: Final = 1e-8
_LATE_PER_M: Final = 0.005  # error of the path driven since an anchor that comes late


@dataclass(frozen=True, slots=True)
class PoseModel:
    """Everything the filter assumes. Antenna: x forward, y left of the vehicle's reference point."""

    motion: MotionModel = field(default_factory=MotionModel)
    antenna_x_m: float = 0.0
    antenna_y_m: float = 0.0
    anchor_sigma_floor_m: float = 0.05
    anchor_common_sigma_m: float = 0.04
    anchor_common_time_s: float = 30.0
    anchor_gate: float = 18.42  # chi-square, 2 degrees of freedom, 99.99 %
    anchored_for_s: float = 1.0
    anchor_max_age_s: float = 5.0
    recover_after_anchors: int = 5
    recover_after_s: float = 0.8
    heading: HeadingModel = field(default_factory=HeadingModel)
    max_yaw_sigma_rad: float = 0.5
    restart_sigma_m: float = 20.0
    lost_sigma_m: float = 500.0
    couple_links: bool = True
    couple_every_m: float = 5.0
    couple_rotation_every_s: float = 1.0
    road_noise_m: float = 0.1
    lane_sigma_m: float = 4.0
    lane_wander_m_sqrt_m: float = 0.1
    lane_turn_sigma_m: float = 2.0
    deviation_length_m: float = 40.0
    new_road_rad: float = math.radians(20.0)
    parallel_sigma_rad: float = math.radians(5.0)
    parallel_max_rad: float = math.radians(25.0)
    bend_clearance_m: float = 12.0
    bend_max_sigma_m: float = 30.0
    coupling_gate: float = 9.0
    lane_change_after_rejections: int = 3


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """The pose of the vehicle's reference point in the plane, and where it comes from.

    Covariance (3, 3) of east, north (m) and yaw (rad). Ages are None for what never came; speed and yaw rate
    None where the last reading gave none. With an unknown heading `yaw_known` is false and yaw means nothing.
    """

    time_ns: int
    mode: Mode
    provenance: Provenance
    east_m: float
    north_m: float
    yaw_rad: float
    yaw_known: bool
    covariance: Array
    speed_m_s: float | None
    yaw_rate_rad_s: float | None
    standing: bool
    speed_age_s: float | None
    rotation_age_s: float | None
    anchor_age_s: float | None
    link_age_s: float | None
    link_status: Literal["none", "ambiguous", "matched"]
    link_id: LinkId | None
    link_level: int | None
    link_candidates: tuple[LinkId, ...]
    link_offset_m: float
    link_offset_sigma_m: float

    @property
    def horizontal_sigma_m(self) -> float:
        """Square root of the position covariance's larger eigenvalue."""
        return math.sqrt(largest_variance(self.covariance))


class AnchorResult(NamedTuple):
    """What became of an anchor; `nis` is the normalised innovation squared (2 degrees of freedom)."""

    outcome: AnchorOutcome
    nis: float | None
    innovation_m: tuple[float, float] | None
    innovation_covariance: Array | None

    @property
    def accepted(self) -> bool:
        """Whether the pose has taken it in."""
        return self.outcome in ("accepted", "recovered")


class CouplingResult(NamedTuple):
    """What became of a link; innovation of row 1 (m) and its normalised square (1 degree of freedom)."""

    outcome: CouplingOutcome
    innovation_m: float | None = None
    nis: float | None = None


class PoseFilter:
    """One vehicle's pose. Call `predict` with every motion sample, the rest as it comes."""

    def __init__(self, model: PoseModel | None = None) -> None:
        self._model = model or PoseModel()
        motion = self._model.motion
        self._gyro = BIAS_A if motion.a_rate_sensor == "yaw_rate" else BIAS_B
        self._odometer = Odometer(motion)
        self._track = RelativeTrack()
        self._x = np.zeros(N_STATES)
        self._p = np.zeros((N_STATES, N_STATES))
        common = self._model.anchor_common_sigma_m**2
        sigma_a, sigma_b = motion.bias_sigma(motion.a_rate_sensor), motion.bias_sigma(motion.b_rate_sensor)
        for index, variance in (
            (BIAS_A, sigma_a**2),
            (BIAS_B, sigma_b**2),
            (SCALE, motion.speed_scale_sigma**2),
            (SIDE_SLIP, motion.side_slip_sigma_rad_s2_m**2),
            (COMMON_EAST, common),
            (COMMON_NORTH, common),
        ):
            self._p[index, index] = max(variance, 1e-18)
        self._provenance: Provenance = "none"
        self._search: HeadingSearch | None = None  # while the heading is unknown
        self._last_step: MotionStep | None = None
        self._rate_rad_s: float | None = None
        self._speed_ns: int | None = None
        self._rotation_ns: int | None = None
        self._anchor_ns: int | None = None
        self._link_ns: int | None = None
        self._travelled_m = 0.0
        self._rejected_ns: deque[int] = deque(maxlen=max(1, self._model.recover_after_anchors))
        self._match = LinkMatch("none")
        self._link_sigma_m = 0.0
        self._forget_rotation_b()
        self._forget_link()

    # What is asked of it

    @property
    def track(self) -> RelativeTrack:
        """The dead-reckoned track in a frame of its own, for `FixTrackStart`."""
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
        """none, provisional (fixes alone), anchored (a confirmed fix just now), or dead_reckoning."""
        if self._provenance == "none":
            return "none"
        if self._provenance == "fixes":
            return "provisional"
        age_s = self._age_s(self._anchor_ns)
        fresh = age_s is not None and age_s <= self._model.anchored_for_s
        return "anchored" if fresh and self._provenance == "confirmed" else "dead_reckoning"

    @property
    def accepts_fixes(self) -> bool:
        """Whether unconfirmed fixes may start a pose: there is none, a provisional one, or one that has
        drifted beyond `restart_sigma_m` by its own account."""
        return self.mode in ("none", "provisional") or self._sigma_m() > self._model.restart_sigma_m

    def estimate(self) -> PoseEstimate | None:
        """The pose now; None before the first motion sample or without any start."""
        now = self.time_ns
        if now is None or self._provenance == "none":
            return None
        x, p, step, match = self._x, self._p, self._last_step, self._match
        blind = step is None or self._speed_ns != now
        lane_var = p[LANE, LANE] + p[DEVIATION, DEVIATION] + 2.0 * p[LANE, DEVIATION]
        return PoseEstimate(
            time_ns=now,
            mode=self.mode,
            provenance=self._provenance,
            east_m=float(x[EAST]),
            north_m=float(x[NORTH]),
            yaw_rad=wrapped(float(x[YAW])),
            yaw_known=self._search is None,
            covariance=p[:3, :3].copy(),
            speed_m_s=None if blind or step is None else (1.0 + float(x[SCALE])) * step.speed_m_s,
            yaw_rate_rad_s=self._rate_rad_s,
            standing=self._odometer.standing,
            speed_age_s=self._age_s(self._speed_ns),
            rotation_age_s=self._age_s(self._rotation_ns),
            anchor_age_s=self._age_s(self._anchor_ns),
            link_age_s=self._age_s(self._link_ns),
            link_status=match.status,
            link_id=match.link_id,
            link_level=match.level,
            link_candidates=match.candidates,
            link_offset_m=float(x[LANE] + x[DEVIATION]),
            link_offset_sigma_m=math.sqrt(max(0.0, float(lane_var))),
        )

    # Motion

    def predict(self, sample: MotionSample) -> Outcome:
        """Move on to this sample; says whether it was used."""
        model = self._model.motion
        step = self._odometer.advance(sample, float(self._x[self._gyro]))
        if step.outcome in ("repeated", "backwards"):
            return step.outcome
        self._note_ages(sample)
        if step.dt_s > model.max_bridge_s:
            self._lose_pose()
        x, p = self._x, self._p
        turn = rotation(step, model.a_rate_sensor, model, float(x[BIAS_A]), float(x[SCALE]))
        self._last_step = step
        speed = (1.0 + float(x[SCALE])) * step.speed_m_s
        rate = turn.rate_rad_s if turn else 0.0
        self._rate_rad_s = None if turn is None else 0.0 if step.standing else rate
        self._track.append(sample.time_ns, step, speed, rate)
        if step.outcome == "first":
            return step.outcome
        self._accumulate_rotation_b(step)
        path = propagate(x, p, step, turn, model)
        self._travelled_m += path
        self._age_noise(step.dt_s, path)
        if step.standing:
            self._learn_bias(step)
        if self._search is not None:
            self._spread()
        elif self._provenance != "none":
            if p[YAW, YAW] > self._model.max_yaw_sigma_rad**2:
                self._lose_heading()
            if self._sigma_m() > self._model.lost_sigma_m:
                self._lose_pose()
        return step.outcome

    def _note_ages(self, sample: MotionSample) -> None:
        rotation_reading = (
            sample.yaw_rate_rad_s if self._model.motion.a_rate_sensor == "yaw_rate" else sample.steering_rad
        )
        if sample.speed_m_s is not None:
            self._speed_ns = sample.time_ns
        if rotation_reading is not None:
            self._rotation_ns = sample.time_ns

    def _age_noise(self, dt: float, path: float) -> None:
        """Let the link's deviation change with the distance, what anchors have in common with the time."""
        model, x, p = self._model, self._x, self._p
        in_space = math.exp(-path / model.deviation_length_m)
        in_time = math.exp(-dt / model.anchor_common_time_s)
        keep = np.array((in_space, in_time, in_time))
        x[DEVIATION:] *= keep
        p[:, DEVIATION:] *= keep
        p[DEVIATION:] *= keep[:, None]
        common_var = (1.0 - in_time * in_time) * model.anchor_common_sigma_m**2
        p[COMMON_EAST, COMMON_EAST] += common_var
        p[COMMON_NORTH, COMMON_NORTH] += common_var
        if path > 0.0:
            p[DEVIATION, DEVIATION] += (1.0 - in_space * in_space) * self._link_sigma_m**2
            p[LANE, LANE] += model.lane_wander_m_sqrt_m**2 * path

    def _renew_deviation(self, keep: float, sigma_m: float) -> None:
        """The link's deviation where only the share `keep` of the one before remains."""
        self._x[DEVIATION] *= keep
        self._p[DEVIATION] *= keep
        self._p[:, DEVIATION] *= keep
        self._p[DEVIATION, DEVIATION] += (1.0 - keep * keep) * sigma_m * sigma_m

    def _learn_bias(self, step: MotionStep) -> None:
        """At a standstill the yaw-rate sensor reads its bias: a measurement of one state."""
        if step.yaw_rate_rad_s is None:
            return
        motion, index, p = self._model.motion, self._gyro, self._p
        noise_var = motion.yaw_rate_noise_rad_s**2 * max(1.0, motion.noise_hold_s / step.dt_s)
        column = p[:, index].copy()
        variance = float(column[index]) + noise_var
        self._x += column * ((step.yaw_rate_rad_s - float(self._x[index])) / variance)
        p -= column[:, None] * (column / variance)

    # Row 2: the other rotation sensor

    def _forget_rotation_b(self) -> None:
        self._b_turn = self._b_d_bias = self._b_d_scale = self._b_var = self._b_s = 0.0
        self._b_bias, self._b_scale = float(self._x[BIAS_B]), float(self._x[SCALE])
        self._copy_state(YAW, YAW_0)

    def _copy_state(self, source: int, target: int) -> None:
        self._x[target] = self._x[source]
        self._p[target] = self._p[source]
        self._p[:, target] = self._p[:, source]
        self._p[target, target] = self._p[source, source]

    def _accumulate_rotation_b(self, step: MotionStep) -> None:
        motion = self._model.motion
        if step.standing:
            return
        turn = rotation(step, motion.b_rate_sensor, motion, self._b_bias, self._b_scale)
        if turn is None or step.outcome == "gap" or self._provenance == "none" or self._search is not None:
            self._b_s = -1.0
            return
        if self._b_s < 0.0:
            self._forget_rotation_b()
        self._b_turn += turn.rate_rad_s * step.dt_s
        self._b_d_bias += turn.d_bias * step.dt_s
        self._b_d_scale += turn.d_scale * step.dt_s
        self._b_var += turn.turn_var_rad2
        self._b_s += step.dt_s

    def couple_rotation(self) -> None:
        """Row 2: weigh the increments of both rotation sensors since the last time, if B gave any."""
        if self._b_s < self._model.couple_rotation_every_s:
            return
        h = np.zeros((1, N_STATES))
        h[0, YAW], h[0, YAW_0], h[0, BIAS_B], h[0, SCALE] = 1.0, -1.0, -self._b_d_bias, -self._b_d_scale
        x = self._x
        turn_b = self._b_turn + self._b_d_bias * (x[BIAS_B] - self._b_bias)
        turn_b += self._b_d_scale * (x[SCALE] - self._b_scale)
        innovation = np.array([turn_b - (x[YAW] - x[YAW_0])])
        self._update(h, innovation, np.array([[self._b_var + _TURN_FLOOR_RAD2]]))
        self._forget_rotation_b()

    # Row 1: the link

    def _forget_link(self) -> None:
        self._coupled_at_m = -math.inf
        self._coupled_alpha: float | None = None
        self._coupled_link: LinkId | None = None
        self._coupled_forward = True
        self._rejections = 0
        self._set_independent(LANE, self._model.lane_sigma_m**2)
        self._set_independent(DEVIATION, 0.0)
        self._x[LANE] = self._x[DEVIATION] = 0.0

    def _set_independent(self, index: int, variance: float) -> None:
        self._p[index] = self._p[:, index] = 0.0
        self._p[index, index] = variance

    def couple_link(self, match: LinkMatch) -> CouplingResult:
        """Take in the current link, and couple with it where due and where its direction means something."""
        model = self._model
        self._match = match
        if match.status == "none":
            self._coupled_alpha = None
        self.couple_rotation()
        if self._provenance == "none" or not model.couple_links:
            return CouplingResult("no_pose")
        refusal = self._refuse_link(match)
        if refusal is not None or match.line is None:
            return CouplingResult(refusal or "not_matched")
        self._enter_link(match)
        self._coupled_at_m = self._travelled_m
        return self._couple_offset(match)

    def _refuse_link(self, match: LinkMatch) -> CouplingOutcome | None:
        model, p = self._model, self._p
        if match.status != "matched" or match.line is None:
            return "not_matched"
        if self._search is not None:
            return "no_heading"
        if self._odometer.standing:
            return "standing"
        if self._travelled_m - self._coupled_at_m < model.couple_every_m:
            return "too_soon"
        turn = abs(wrapped(float(self._x[YAW]) - match.line.alpha_rad))
        sigma = math.sqrt(p[YAW, YAW] + model.parallel_sigma_rad**2)
        if turn > min(3.0 * sigma, model.parallel_max_rad):
            return "not_parallel"
        cos, sin = math.cos(match.line.alpha_rad), math.sin(match.line.alpha_rad)
        along = p[EAST, EAST] * cos * cos + p[NORTH, NORTH] * sin * sin + 2.0 * p[EAST, NORTH] * sin * cos
        clearance = model.bend_clearance_m + min(2.0 * math.sqrt(max(0.0, along)), model.bend_max_sigma_m)
        return "near_bend" if match.to_sharp_m < clearance else None

    def _enter_link(self, match: LinkMatch) -> None:
        """On a new road alpha and c change and the lane stays, within what a turn does to it; the deviation
        of a road that runs straight on is the same, of one in another direction a new one."""
        assert match.line is not None
        model, before = self._model, self._coupled_alpha
        self._link_sigma_m = match.sigma_m
        turned_back = self._coupled_link == match.link_id and self._coupled_forward != match.forward
        if before is None:
            self._x[DEVIATION] = 0.0
            self._set_independent(DEVIATION, match.sigma_m**2)
            self._p[LANE, LANE] += model.lane_turn_sigma_m**2
        elif turned_back:
            for index in (DEVIATION, LANE):
                self._x[index] *= -1.0
                self._p[index] *= -1.0
                self._p[:, index] *= -1.0
            self._p[LANE, LANE] += 4.0 * model.lane_turn_sigma_m**2
        elif abs(wrapped(match.line.alpha_rad - before)) > model.new_road_rad:
            cos = math.cos(match.line.alpha_rad - before)
            self._renew_deviation(max(0.0, cos), match.sigma_m)
            self._p[LANE, LANE] += (1.0 - cos) * model.lane_turn_sigma_m**2
        self._coupled_alpha, self._coupled_link = match.line.alpha_rad, match.link_id
        self._coupled_forward = match.forward

    def _couple_offset(self, match: LinkMatch) -> CouplingResult:
        assert match.line is not None
        x = self._x
        s = np.array([match.line.alpha_rad, match.line.c_m, x[LANE] + x[DEVIATION], 0.0])
        innovation = -observation(x[:3], s)[:1]
        h = np.zeros((1, N_STATES))
        h[0, :3] = jacobian_x(s)[0]
        h[0, LANE] = h[0, DEVIATION] = jacobian_s(x[:3], s)[0, 2]
        noise = np.array([[self._model.road_noise_m**2]])
        variance = float((h @ self._p @ h.T)[0, 0] + noise[0, 0])
        nis = float(innovation[0]) ** 2 / variance
        if nis > self._model.coupling_gate:
            self._rejections += 1
            if self._rejections < self._model.lane_change_after_rejections:
                return CouplingResult("rejected", float(innovation[0]), nis)
            self._set_independent(LANE, self._model.lane_sigma_m**2 + float(innovation[0]) ** 2)
            self._set_independent(DEVIATION, match.sigma_m**2)
        self._rejections = 0
        self._update(h, innovation, noise)
        self._link_ns = self.time_ns
        return CouplingResult("coupled", float(innovation[0]), nis)

    # Anchors

    def anchor(self, time_ns: int, east_m: float, north_m: float, covariance: Array) -> AnchorResult:
        """Anchor to the antenna's position by a *confirmed* fix, covariance (2, 2), measured at `time_ns`.

        It may come late by `anchor_max_age_s`: the motion since brings it to the present. An innovation
        outside the gate is refused, until several in a row say the same. ValueError names what is not finite.
        """
        for name, value in (("east_m", east_m), ("north_m", north_m)):
            if not math.isfinite(value):
                raise ValueError(f"{name}: must be finite; got {value}")
        require_covariance("covariance", covariance, 2)
        now = self.time_ns
        then, here = self._track.at(time_ns), self._track.at(now) if now is not None else None
        if now is None or then is None or here is None:
            return AnchorResult("ahead" if now is None or time_ns > now else "too_old", None, None, None)
        if now - time_ns > self._model.anchor_max_age_s * 1e9:
            return AnchorResult("too_old", None, None, None)
        noise = covariance + _floor_for(covariance, self._model.anchor_sigma_floor_m)
        if self._provenance == "none" or self._search is not None:
            self._anchor_without_heading(east_m, north_m, noise, then, here)
            result = AnchorResult("accepted", None, None, None)
        else:
            result = self._anchor_with_heading(time_ns, east_m, north_m, noise, then, here)
        if result.accepted:
            self._provenance = "confirmed"
            self._anchor_ns = time_ns if self._anchor_ns is None else max(time_ns, self._anchor_ns)
            self._rejected_ns.clear()
        return result

    def _anchor_with_heading(
        self, time_ns: int, east_m: float, north_m: float, noise: Array, then: TrackPoint, here: TrackPoint
    ) -> AnchorResult:
        """z = position now - displacement since + lever arm then + common; all of it turns with the yaw."""
        model, x = self._model, self._x
        frame = float(x[YAW]) - here.yaw_rad
        to_here = _turned(here.east_m - then.east_m, here.north_m - then.north_m, frame)
        lever = lever_arm(frame + then.yaw_rad, model.antenna_x_m, model.antenna_y_m)
        east, north = lever[0] - to_here[0], lever[1] - to_here[1]
        h = np.zeros((2, N_STATES))
        h[0, EAST] = h[1, NORTH] = h[0, COMMON_EAST] = h[1, COMMON_NORTH] = 1.0
        h[0, YAW], h[1, YAW] = -north, east
        innovation = np.array(
            [east_m - x[EAST] - east - x[COMMON_EAST], north_m - x[NORTH] - north - x[COMMON_NORTH]]
        )
        path = abs(here.path_m - then.path_m)
        noise = noise + np.diag([(_LATE_PER_M * path) ** 2] * 2)
        s = h @ self._p @ h.T + noise
        nis = float(innovation @ inverse_2x2(s) @ innovation)
        moved = (float(innovation[0]), float(innovation[1]))
        if nis <= model.anchor_gate:
            self._update(h, innovation, noise)
            return AnchorResult("accepted", nis, moved, s)
        if not self._recovers(time_ns):
            return AnchorResult("outside_gate", nis, moved, s)
        self._p[:2, :2] += np.outer(innovation, innovation)
        self._p[YAW, YAW] += 0.01
        self._update(h, innovation, noise)
        return AnchorResult("recovered", nis, moved, s)

    def _recovers(self, time_ns: int) -> bool:
        """Whether confirmed positions have contradicted the pose often and long enough to give it up."""
        if self._provenance == "fixes":
            return True
        self._rejected_ns.append(time_ns)
        enough = len(self._rejected_ns) == self._rejected_ns.maxlen
        return enough and self._rejected_ns[-1] - self._rejected_ns[0] >= self._model.recover_after_s * 1e9

    def _anchor_without_heading(
        self, east_m: float, north_m: float, noise: Array, then: TrackPoint, here: TrackPoint
    ) -> None:
        """Place the pose at the anchor; the track between two anchors shows the heading once long enough."""
        variance = largest_variance(noise) + self._model.anchor_common_sigma_m**2
        place = Place(east_m, north_m, variance, then)
        if self._search is None:
            self._begin_without_heading(place)
            return
        found = self._search.add(place)
        if found is None:
            self._spread()
            return
        self._begin_from_track(east_m, north_m, *found, then, here)

    def _begin_from_track(
        self,
        east_m: float,
        north_m: float,
        turned: float,
        covariance: Array,
        then: TrackPoint,
        here: TrackPoint,
    ) -> None:
        """Known heading: the antenna's place then, brought to the vehicle's place now."""
        model = self._model
        lever = lever_arm(then.yaw_rad + turned, model.antenna_x_m, model.antenna_y_m)
        since = _turned(here.east_m - then.east_m, here.north_m - then.north_m, turned)
        move = (since[0] - lever[0], since[1] - lever[1])
        covariance = moved_by_lever(covariance, *move)
        self._begin(east_m + move[0], north_m + move[1], here.yaw_rad + turned, covariance)

    # Start and loss

    def start(self, pose: StartPose) -> bool:
        """Start anew from a given pose, or from fixes where `accepts_fixes` allows; whether it was taken."""
        if pose.provenance == "fixes":
            if not self.accepts_fixes:
                return False
            known = self._provenance == "fixes" and self._search is None
            if known and pose.yaw_rad is None and self._sigma_m() <= self._model.restart_sigma_m:
                return False
        now, here = self.time_ns, self._track_now()
        then = here if now is None else self._track.at(pose.time_ns)
        if then is None or here is None:
            return False
        variance = largest_variance(pose.covariance)
        yaw_var = float(pose.covariance[2, 2])
        if pose.yaw_rad is None or yaw_var > self._model.max_yaw_sigma_rad**2:
            self._begin_without_heading(Place(pose.east_m, pose.north_m, variance, then))
        else:
            turned = pose.yaw_rad - then.yaw_rad
            since = _turned(here.east_m - then.east_m, here.north_m - then.north_m, turned)
            covariance = moved_by_lever(pose.covariance, *since)
            self._begin(pose.east_m + since[0], pose.north_m + since[1], here.yaw_rad + turned, covariance)
        self._provenance = pose.provenance
        self._anchor_ns = None
        self._forget_link()
        return True

    def _begin(self, east_m: float, north_m: float, yaw_rad: float, covariance: Array) -> None:
        """Pose anew; what is known of the sensors stays, uncorrelated with it."""
        self._search = None
        self._x[:3] = (east_m, north_m, yaw_rad)
        self._p[:3, :] = self._p[:, :3] = 0.0
        self._p[:3, :3] = covariance
        self._rejected_ns.clear()
        self._forget_rotation_b()

    def _begin_without_heading(self, place: Place) -> None:
        """Known place, unknown heading: what is driven from here spreads over a circle."""
        model = self._model
        self._search = HeadingSearch(place, model.antenna_x_m, model.antenna_y_m, model.heading)
        self._spread()

    def _spread(self) -> None:
        here = self._track_now()
        if self._search is None or here is None:
            return
        east, north, variance = self._search.spread(here)
        search = self._search
        self._begin(east, north, here.yaw_rad, np.diag([variance, variance, math.pi**2]))
        self._search = search

    def _lose_heading(self) -> None:
        here = self._track_now()
        if here is not None:
            variance = largest_variance(self._p)
            self._begin_without_heading(Place(float(self._x[EAST]), float(self._x[NORTH]), variance, here))

    def _track_now(self) -> TrackPoint | None:
        """The end of the track; before any motion, its beginning."""
        now = self.time_ns
        return TrackPoint(0.0, 0.0, 0.0, 0.0) if now is None else self._track.at(now)

    def _lose_pose(self) -> None:
        self._provenance, self._search, self._anchor_ns = "none", None, None
        self._begin(0.0, 0.0, 0.0, np.zeros((3, 3)))
        self._forget_link()

    def shifted(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north): every place is told from there."""
        if not (math.isfinite(east_m) and math.isfinite(north_m)):
            raise ValueError("east_m, north_m: must be finite")
        self._x[EAST] -= east_m
        self._x[NORTH] -= north_m
        if self._search is not None:
            self._search.shift(east_m, north_m)
        if self._match.line is not None:
            self._match = replace(self._match, line=self._match.line.shifted(east_m, north_m))

    # Small things

    def _update(self, h: Array, innovation: Array, noise: Array) -> None:
        self._x, self._p, _ = kalman_update(self._x, self._p, h, innovation, noise)

    def _sigma_m(self) -> float:
        return math.sqrt(max(0.0, largest_variance(self._p)))

    def _age_s(self, time_ns: int | None) -> float | None:
        now = self.time_ns
        return None if time_ns is None or now is None else (now - time_ns) * 1e-9


def _turned(east_m: float, north_m: float, angle_rad: float) -> tuple[float, float]:
    return lever_arm(angle_rad, east_m, north_m)


def _floor_for(covariance: Array, floor_m: float) -> Array:
    """What must be added for no direction to be better known than the floor (on the safe side)."""
    a, b, c = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    smallest = 0.5 * (a + b) - math.hypot(0.5 * (a - b), c)
    return np.eye(2) * max(0.0, floor_m**2 - smallest)

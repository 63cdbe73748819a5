"""Detection of wheel slip, and the state of the slip while it is suspected.

Tyre grip bounds the acceleration of a vehicle; wheels can change faster. While slip is suspected, `SPEED_ERROR`, the
speed over ground less the wheel speed, is a state: matches and anchors estimate it at once, and the wheel scale is
not learnt from it. The slip takes up changes of wheel speed that no vehicle makes, and what follows within
`slip_window_s`. A later change may be the vehicle's or the slip's: the slip takes up half of it, with a σ of half,
all such changes having the same sign of error. Locked wheels brake the vehicle: it slides to rest, and after
`locked_for_s` it is taken to stand.

On a bump a wheel swings on its tyre: its speed departs from the vehicle's by 1 m/s and back within a tenth of a second
(comma-2018-08-02). Readings that come faster are therefore compared by their means over `wheel_hop_s`.

Slip is suspected where the wheels change faster than a vehicle can, or where scan matches contradict the distance
by the wheels since a match of the last second. It ends when wheels and pose have agreed for a while, when the
wheels have returned by a change as fast as few drivers make it, when they stand, or after a time without any
observation.
"""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import SCALE, SPEED_ERROR, YAW
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionStep
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.speed_error import SpeedError


class WheelSlipDetector:
    """Detects wheel slip, and updates its state."""

    def __init__(self, state: FilterState, error: SpeedError, model: PoseModel) -> None:
        self._state, self._error, self._model = state, error, model
        self._recent: list[tuple[int, float]] = []  # times and mean wheel speeds of the last window
        self._block: list[tuple[int, float]] = []  # readings not in it yet
        self._last_m_s: float | None = None
        self._standing_s = 0.0  # how long the wheels have stood
        self._end()

    def forget(self) -> None:
        """End the suspicion of slip."""
        if self.active:
            self._error.end()
        self._end()

    def _end(self) -> None:
        self.active = False
        self._agreed_s = self._unobserved_s = self._half_changes_m_s = 0.0
        self._jump_ns: int | None = None

    def before_step(self, time_ns: int, speed_m_s: float | None, step: MotionStep) -> float:
        """Apply the first half of a step's change of slip, before the pose is propagated; return the change."""
        change = self._wheel_change(time_ns, speed_m_s, step)
        at_rest = speed_m_s is not None and abs(speed_m_s) <= self._model.motion.standstill_speed_m_s
        self._standing_s = self._standing_s + step.dt_s if at_rest else 0.0
        if not self.active:
            return 0.0
        if not self._is_jumping(time_ns):
            change *= 0.5
            self._add_half_change(change)
        self._state.x[SPEED_ERROR] -= 0.5 * change
        return change

    def after_step(self, step: MotionStep, change_m_s: float) -> None:
        """Apply the second half of the change, after the pose was propagated, and the process noise of the slip."""
        if not self.active:
            return
        model, state = self._model, self._state
        state.x[SPEED_ERROR] -= 0.5 * change_m_s
        slip = abs(float(state.x[SPEED_ERROR]))
        if self._standing_s > 0.0:
            state.renew(SPEED_ERROR, math.exp(-step.dt_s / model.locked_time_s), slip)
        else:
            state.renew(
                SPEED_ERROR, math.exp(-step.dt_s / model.slip_state_time_s), model.slip_state_sigma_m_s
            )
        self._unobserved_s += step.dt_s
        sigma = math.sqrt(float(state.p[SPEED_ERROR, SPEED_ERROR]))
        agrees = sigma < model.slip_state_sigma_m_s / 3.0 and slip < 2.0 * sigma
        self._agreed_s = self._agreed_s + step.dt_s if agrees else 0.0
        has_jumped = self._jump_ns is not None and not self._is_jumping(self._error.now_ns)
        if (
            self._standing_s > model.locked_for_s
            or (has_jumped and slip < model.slip_recovered_m_s)
            or self._agreed_s > model.slip_ends_after_s
            or self._unobserved_s > model.slip_unobserved_s
        ):
            self.forget()

    def mark_observed(self) -> None:
        """Note that a measurement has observed the vehicle's position."""
        self._unobserved_s = 0.0

    def covariance_if_slipping(self, since_ns: int) -> Floats:
        """Return the covariance (n, n) had the wheels been wrong by `slip_sigma_m_s` since then."""
        for_s = (self._error.now_ns - since_ns) * 1e-9
        p, sigma = self._state.p.copy(), self._model.slip_sigma_m_s
        yaw = float(self._state.x[YAW])
        ahead = np.zeros(len(p))
        ahead[:2] = math.cos(yaw) * for_s, math.sin(yaw) * for_s
        ahead[SPEED_ERROR] = 1.0
        return np.asarray(p + np.outer(ahead, ahead) * sigma**2)

    def begin(self, since_ns: int, covariance: Floats) -> None:
        """Suspect slip since then, with this covariance (n, n)."""
        self.active = True
        self._error.begin(since_ns)
        self._agreed_s = self._unobserved_s = self._half_changes_m_s = 0.0
        self._state.p = covariance

    def _is_jumping(self, time_ns: int) -> bool:
        """Whether the wheels have made a change that no vehicle makes within the window."""
        window_ns = round(self._model.slip_window_s * 1e9)
        return self._jump_ns is not None and time_ns - self._jump_ns <= window_ns

    def _add_half_change(self, half_m_s: float) -> None:
        """Add the variance of a half change; all have the same sign of error, so their sum is squared."""
        before, self._half_changes_m_s = self._half_changes_m_s, self._half_changes_m_s + half_m_s
        more = self._half_changes_m_s**2 - before**2
        if more > 0.0:
            self._state.p[SPEED_ERROR, SPEED_ERROR] += more

    def _wheel_change(self, time_ns: int, speed_m_s: float | None, step: MotionStep) -> float:
        """Return the change of wheel speed over a step; one that no vehicle makes begins the suspicion."""
        if speed_m_s is None or step.outcome == "gap":
            self._recent.clear()
            self._block.clear()
            self._last_m_s = None
            return 0.0
        change = 0.0 if self._last_m_s is None else speed_m_s - self._last_m_s
        self._last_m_s = speed_m_s
        begin = self._last_plausible() if self._add_reading(time_ns, speed_m_s) else None
        if begin is not None:
            del self._recent[:-1]
            before_m_s = begin[1] - (speed_m_s - change)
            if not self.active:
                self.begin(begin[0], self.covariance_if_slipping(begin[0]))
                self._state.x[SPEED_ERROR] = before_m_s
            elif not self._is_jumping(time_ns):
                self._state.x[SPEED_ERROR] += 0.5 * before_m_s  # the slip has taken up half of it already
            self._jump_ns = time_ns
            self._error.since_ns = begin[0]
        return (1.0 + float(self._state.x[SCALE])) * change

    def _add_reading(self, time_ns: int, speed_m_s: float) -> bool:
        """Add a reading to those of the last window; return whether it completes a mean over `wheel_hop_s`."""
        model, block, recent = self._model, self._block, self._recent
        block.append((time_ns, speed_m_s))
        before_ns = recent[-1][0] if recent else None
        if before_ns is not None and time_ns - before_ns < round(model.wheel_hop_s * 1e9):
            return False
        recent.append((time_ns, sum(speed for _, speed in block) / len(block)))
        block.clear()
        while time_ns - recent[0][0] > round(model.slip_window_s * 1e9):
            recent.pop(0)
        return True

    def _last_plausible(self) -> tuple[int, float] | None:
        """Return time and wheel speed from which no vehicle reaches the present wheel speed; None without slip."""
        return next(
            (begin for begin in self._recent[:-1] if self._is_implausible(begin, self._recent[-1])), None
        )

    def _is_implausible(self, begin: tuple[int, float], end: tuple[int, float]) -> bool:
        """Whether no vehicle changes its speed from one to the other."""
        model = self._model
        if min(abs(begin[1]), abs(end[1])) < model.slip_above_m_s:
            return False
        faster = abs(end[1]) - abs(begin[1])
        limit = model.max_acceleration_m_s2 if faster > 0.0 else model.max_braking_m_s2
        if self.active:
            limit = model.max_calm_change_m_s2
        noise = 4.0 * math.sqrt(2.0) * model.motion.speed_noise_m_s
        return abs(faster) > limit * (end[0] - begin[0]) * 1e-9 + noise

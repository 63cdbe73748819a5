"""Wheels that do not say how fast the vehicle goes: they spin, or slide.

A vehicle cannot change its speed faster than its tyres grip, wheels can. `WHEEL_SLIP`, the speed over ground less the
wheels', is a state of its own while they are in doubt, so that matches and anchors show it at once and the wheels'
scale learns nothing from it. It takes up the changes of the wheels' speed that no vehicle makes, and what follows
within `slip_window_s`. Of a later change nobody knows whether vehicle or slip has changed: it takes up half, give or
take half, all of them in one direction. Wheels that do not turn brake the vehicle: it slides to rest, and once they
have stood for `locked_for_s` it stands.

Doubt begins by wheels that change faster than a vehicle can, or by scan matches that tell of another way than the
wheels since one of the last second; it ends when wheels and pose have agreed for a while, when the wheels have come
back by a change as fast as few drivers make it, when they stand, or have had no witness for long.
"""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.filter.dead_reckoning import SCALE, WHEEL_SLIP, YAW, MotionStep
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_filter import Array


class WheelSlipDetector:
    """Says whether the wheels are believed, and keeps the state that stands for what they miss."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self._recent: list[tuple[int, float]] = []
        self._standing_s = 0.0  # so long have the wheels stood
        self._now_ns = self._since_ns = 0
        self.forget()

    def forget(self) -> None:
        """Believe the wheels."""
        self.active = False
        self._agreed_s = self._unseen_s = self._swing_m_s = 0.0
        self._jumped_ns: int | None = None
        self._learnt: list[tuple[int, float]] = []  # when and by how much the slip became another one
        self._state.set_independent(WHEEL_SLIP, 0.0)
        self._state.x[WHEEL_SLIP] = 0.0

    def before(self, time_ns: int, speed_m_s: float | None, step: MotionStep) -> float:
        """Before the pose is moved by a step that ends with this reading: by how much the slip changes with it."""
        self._now_ns = time_ns
        changed = self._changed(time_ns, speed_m_s, step)
        at_rest = speed_m_s is not None and abs(speed_m_s) <= self._model.motion.standstill_speed_m_s
        self._standing_s = self._standing_s + step.dt_s if at_rest else 0.0
        if not self.active:
            return 0.0
        if not self._jumping(time_ns):
            changed *= 0.5
            self._swing(changed)
        self._state.x[WHEEL_SLIP] -= 0.5 * changed
        return changed

    def after(self, step: MotionStep, changed_m_s: float) -> None:
        """After the pose was moved: the other half of the change, and what may have become of the speed since."""
        if not self.active:
            return
        model, state = self._model, self._state
        state.x[WHEEL_SLIP] -= 0.5 * changed_m_s
        slip = abs(float(state.x[WHEEL_SLIP]))
        if self._standing_s > 0.0:
            state.renew(WHEEL_SLIP, math.exp(-step.dt_s / model.locked_time_s), slip)
        else:
            state.renew(WHEEL_SLIP, math.exp(-step.dt_s / model.doubt_time_s), model.doubt_sigma_m_s)
        self._unseen_s += step.dt_s
        sigma = math.sqrt(float(state.p[WHEEL_SLIP, WHEEL_SLIP]))
        agrees = sigma < model.doubt_sigma_m_s / 3.0 and slip < 2.0 * sigma
        self._agreed_s = self._agreed_s + step.dt_s if agrees else 0.0
        stands = self._standing_s > model.locked_for_s
        came_back = (
            self._jumped_ns is not None and not self._jumping(self._now_ns) and slip < model.come_back_m_s
        )
        if (
            stands
            or came_back
            or self._agreed_s > model.doubt_ends_s
            or self._unseen_s > model.doubt_unseen_s
        ):
            self.forget()

    def seen(self) -> None:
        """Something has shown where the vehicle is."""
        self._unseen_s = 0.0

    def learnt(self, slip_before_m_s: float) -> None:
        """An observation has changed the slip from this to what it is."""
        oldest_ns = self._now_ns - round(self._model.match_max_age_s * 1e9)
        learnt = (self._now_ns, float(self._state.x[WHEEL_SLIP]) - slip_before_m_s)
        self._learnt = [*(one for one in self._learnt if one[0] >= oldest_ns), learnt]

    def late_s(self, time_ns: int) -> float:
        """How long since then the vehicle has driven with the slip of now."""
        return (self._now_ns - max(time_ns, self._since_ns)) * 1e-9

    def missed_m(self, time_ns: int) -> float:
        """By how much more than the track says the vehicle has moved on since then, by what was learnt of the slip."""
        begin_ns = max(time_ns, self._since_ns)
        return sum(more * (at_ns - begin_ns) * 1e-9 for at_ns, more in self._learnt if at_ns > begin_ns)

    def covariance_if_slipping(self, since_ns: int) -> Array:
        """Covariance (n, n) had the wheels been wrong by `slip_sigma_m_s` since then."""
        for_s = (self._now_ns - since_ns) * 1e-9
        p, sigma = self._state.p.copy(), self._model.slip_sigma_m_s
        yaw = float(self._state.x[YAW])
        ahead = np.zeros(len(p))
        ahead[:2] = math.cos(yaw) * for_s, math.sin(yaw) * for_s
        ahead[WHEEL_SLIP] = 1.0
        return np.asarray(p + np.outer(ahead, ahead) * sigma**2)

    def begin(self, since_ns: int, covariance: Array) -> None:
        """Doubt them since then, with this covariance (n, n)."""
        self.active, self._since_ns, self._learnt = True, since_ns, []
        self._agreed_s = self._unseen_s = self._swing_m_s = 0.0
        self._state.p = covariance

    def _jumping(self, time_ns: int) -> bool:
        """Whether the wheels have just made a change that no vehicle makes."""
        window_ns = round(self._model.slip_window_s * 1e9)
        return self._jumped_ns is not None and time_ns - self._jumped_ns <= window_ns

    def _swing(self, half_m_s: float) -> None:
        """Half of a change that may be the vehicle's or the slip's: errors of one sign, so they add up as they are."""
        before, self._swing_m_s = self._swing_m_s, self._swing_m_s + half_m_s
        more = self._swing_m_s**2 - before**2
        if more > 0.0:
            self._state.p[WHEEL_SLIP, WHEEL_SLIP] += more

    def _changed(self, time_ns: int, speed_m_s: float | None, step: MotionStep) -> float:
        """The change of the wheels' speed over a step; a change that no vehicle makes begins the doubt."""
        model = self._model
        if speed_m_s is None or step.outcome == "gap":
            self._recent.clear()
            return 0.0
        recent = self._recent
        changed = speed_m_s - recent[-1][1] if recent else 0.0
        recent.append((time_ns, speed_m_s))
        while time_ns - recent[0][0] > round(model.slip_window_s * 1e9):
            recent.pop(0)
        begin = self._last_possible()
        if begin is not None:
            del recent[:-1]
            before_m_s = begin[1] - (speed_m_s - changed)
            if not self.active:
                self.begin(begin[0], self.covariance_if_slipping(begin[0]))
                self._state.x[WHEEL_SLIP] = before_m_s
            elif not self._jumping(time_ns):
                self._state.x[WHEEL_SLIP] += 0.5 * before_m_s  # half of it has been taken up
            self._jumped_ns = time_ns
            self._since_ns = begin[0]
        return (1.0 + float(self._state.x[SCALE])) * changed

    def _last_possible(self) -> tuple[int, float] | None:
        """Time and speed of the wheels from which no vehicle comes to their speed of now; None where all is well."""
        model, (end_ns, end) = self._model, self._recent[-1]
        noise = 4.0 * math.sqrt(2.0) * model.motion.speed_noise_m_s
        for begin_ns, begin in self._recent[:-1]:
            if min(abs(begin), abs(end)) < model.slip_above_m_s:
                continue
            faster = abs(end) - abs(begin)
            most = model.most_acceleration_m_s2 if faster > 0.0 else model.most_braking_m_s2
            if self.active:
                most = model.calm_change_m_s2
            if abs(faster) > most * (end_ns - begin_ns) * 1e-9 + noise:
                return begin_ns, begin
        return None

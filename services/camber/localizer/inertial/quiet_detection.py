"""Detection of a unit at rest: neither force nor rate changes, and the force is gravity's.

Standing vehicles shake by their engine, moving ones by the road as well, upwards most of all. A unit whose output does
not change at all is broken and not at rest. (Skog, Händel, Nilsson, Rantakokko, Zero-velocity detection, IEEE
Transactions on Biomedical Engineering 57, 2010, compares such tests.)
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.localizer.inertial.imu_noise import ImuNoise

_WINDOW_NS: Final = 600_000_000  # as `MotionModel.standstill_after_s`
_FULL_NS: Final = 500_000_000  # chosen: less is no window
_FORCE_M_S2: Final = 0.05  # chosen: of means over 20 ms, an idling engine
_RATE_RAD_S: Final = math.radians(0.2)  # chosen: the same
_NOISE_SIGMAS: Final = 2.0  # chosen: a standard deviation of 30 values is 13 % off
_GRAVITY_OFF_M_S2: Final = 0.6  # chosen: bias and scale of the poorest unit


class QuietDetection:
    """Watches the means of force and rate over steps."""

    def __init__(self, noise: ImuNoise) -> None:
        self._noise = noise
        self._recent: deque[tuple[int, tuple[float, ...]]] = deque()
        self._since_ns: int | None = None

    def forget(self) -> None:
        """Begin anew: the samples had a gap."""
        self._recent.clear()
        self._since_ns = None

    def add(
        self, time_ns: int, force_m_s2: tuple[float, ...], rate_rad_s: tuple[float, ...], *, step_s: float
    ) -> float:
        """Add the means (3,) over a step that ends now, as the unit measures them; return for how long it is quiet."""
        recent = self._recent
        recent.append((time_ns, (*force_m_s2, *rate_rad_s)))
        while time_ns - recent[0][0] > _WINDOW_NS:
            recent.popleft()
        if not self._is_quiet(step_s):
            self._since_ns = None
            return 0.0
        if self._since_ns is None:
            self._since_ns = recent[0][0]
        return (time_ns - self._since_ns) * 1e-9

    def _is_quiet(self, step_s: float) -> bool:
        if self._recent[-1][0] - self._recent[0][0] < _FULL_NS:
            return False
        values = np.array([value for _, value in self._recent])
        spread = np.std(values, axis=0)
        per_step = _NOISE_SIGMAS / math.sqrt(step_s)
        force = _FORCE_M_S2 + per_step * self._noise.velocity_random_walk_m_s_sqrt_s
        rate = _RATE_RAD_S + per_step * self._noise.angle_random_walk_rad_sqrt_s
        gravity = float(np.linalg.norm(values[:, :3].mean(axis=0)))
        is_steady = bool(spread[:3].max() <= force and spread[3:].max() <= rate)
        return is_steady and spread.max() > 0.0 and abs(gravity - STANDARD_GRAVITY_M_S2) < _GRAVITY_OFF_M_S2

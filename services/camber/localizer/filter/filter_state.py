"""State vector and covariance of the localizer's filter, and the operations on them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import (
    BIAS_A,
    BIAS_B,
    N_MOTION,
    SCALE,
    SIDE_SLIP,
    TURN_GAIN,
    WHEEL_LAG,
)
from camber.localizer.filter.planar_pose import largest_variance
from camber.localizer.filter.pose_model import PoseModel

YAW_0: Final = N_MOTION  # yaw at the last coupling of the two rotation sensors
LANE: Final = N_MOTION + 1  # the lasting part of r (m)
DEVIATION: Final = N_MOTION + 2  # the link's deviation from its road in r (m)
COMMON_EAST: Final = N_MOTION + 3  # error common to consecutive anchors (m)
COMMON_NORTH: Final = N_MOTION + 4
MATCH_EAST: Final = N_MOTION + 5  # error common to consecutive scan matches (m, m, rad): the map's
MATCH_NORTH: Final = N_MOTION + 6
MATCH_YAW: Final = N_MOTION + 7
SHIFT_EAST: Final = N_MOTION + 8  # common shift of all links of a neighbourhood, in their sigmas
SHIFT_NORTH: Final = N_MOTION + 9
N_STATES: Final = N_MOTION + 10
_SENSORS: Final = slice(BIAS_A, WHEEL_LAG + 1)
_AGING: Final = np.arange(DEVIATION, N_STATES)


class FilterState:
    """State `x` (n,) and covariance `p` (n, n): pose and sensors (`dead_reckoning_time_update`), the states named here,
    `extra` ones (zero and certain until their user sets them), then those of `link_offset_memory`."""

    def __init__(self, model: PoseModel, extra_states: int = 0) -> None:
        motion = model.motion
        self.extra = slice(N_STATES, N_STATES + extra_states)
        """Indices of the extra states."""
        self.x: Floats = np.zeros(self.extra.stop)
        self.p: Floats = np.zeros((self.extra.stop, self.extra.stop))
        self.sensors_learn = True
        """Whether observations of the pose update the sensors' errors too."""
        sigma_a, sigma_b = motion.bias_sigma(motion.a_rate_sensor), motion.bias_sigma(motion.b_rate_sensor)
        for index, variance in (
            (BIAS_A, sigma_a**2),
            (BIAS_B, sigma_b**2),
            (SCALE, motion.speed_scale_sigma**2),
            (SIDE_SLIP, motion.side_slip_sigma_rad_s2_m**2),
            (TURN_GAIN, motion.gain_sigma(motion.a_rate_sensor) ** 2),
            (WHEEL_LAG, motion.wheel_lag_sigma_s**2),
        ):
            self.p[index, index] = max(variance, 1e-18)
        self.x[WHEEL_LAG] = motion.wheel_lag_s
        self.forget_common(model)

    @property
    def horizontal_sigma_m(self) -> float:
        """Square root of the position covariance's larger eigenvalue."""
        return math.sqrt(max(0.0, largest_variance(self.p)))

    def forget_common(self, model: PoseModel) -> None:
        """Reset the errors common to anchors and to scan matches."""
        position, yaw = model.match_common_sigma_m**2, model.match_common_sigma_rad**2
        anchor = model.anchor_common_sigma_m**2
        for index, variance in enumerate((anchor, anchor, position, position, yaw), COMMON_EAST):
            self.x[index] = 0.0
            self.set_independent(index, max(variance, 1e-18))

    def update(self, h: Floats, innovation: Floats, noise: Floats) -> None:
        """Apply a Kalman update by m = 1 or 2 rows `h` (m, n) with `noise` (m, m); their sum of covariances must be
        regular."""
        if not self.sensors_learn:
            self.update_joseph(h, innovation, noise)
            return
        ph = self.p @ h.T
        s = h @ ph + noise
        gain = ph / s[0, 0] if len(s) == 1 else ph @ inverse_2x2(s)
        updated = self.p - gain @ ph.T
        self.x, self.p = self.x + gain @ innovation, 0.5 * (updated + updated.T)

    def update_joseph(
        self, h: Floats, innovation: Floats, noise: Floats, *, update_sensors: bool = True
    ) -> None:
        """Apply an update by m rows `h` (m, n) in Joseph's form: `noise` (m, m) may differ by powers of ten.

        Where `update_sensors` or `sensors_learn` is false the sensors' errors are considered and not estimated
        (Schmidt–Kalman filter).
        """
        learn = update_sensors and self.sensors_learn
        ph = self.p @ h.T
        s = h @ ph + noise
        scale = 1.0 / np.sqrt(np.diag(s))
        gain = ph * scale @ np.linalg.inv(s * np.outer(scale, scale)) * scale
        if not learn:
            gain[_SENSORS] = 0.0
        keep = np.eye(len(self.x)) - gain @ h
        sensors = self.p[_SENSORS, _SENSORS]
        updated = keep @ self.p @ keep.T + gain @ noise @ gain.T
        updated = 0.5 * (updated + updated.T)
        if not learn:
            updated[_SENSORS, _SENSORS] = sensors
        self.x, self.p = self.x + gain @ innovation, updated

    def rows(self, count: int) -> Floats:
        """Return zeros (count, n), to be filled where an observation depends on a state."""
        return np.zeros((count, len(self.x)))

    def append_clone(self, index: int) -> None:
        """Append a state that is a clone of this one."""
        n = len(self.x)
        source = np.append(np.arange(n), index)
        self.x, self.p = self.x[source], self.p[np.ix_(source, source)]

    def drop(self, index: int) -> None:
        """Delete this state; the indices after it decrease by one."""
        self.x = np.delete(self.x, index)
        self.p = np.delete(np.delete(self.p, index, axis=0), index, axis=1)

    def keep_first(self, count: int) -> None:
        """Delete the states from `count` on."""
        self.x, self.p = self.x[:count].copy(), self.p[:count, :count].copy()

    def set_pose(self, east_m: float, north_m: float, yaw_rad: float, covariance: Floats) -> None:
        """Set another pose, covariance (3, 3); the sensors' states stay, uncorrelated with it."""
        self.x[:3] = (east_m, north_m, yaw_rad)
        self.p[:3, :] = self.p[:, :3] = 0.0
        self.p[:3, :3] = covariance

    def copy(self, source: int, target: int) -> None:
        """Make one state a clone of another, fully correlated with it."""
        self.x[target] = self.x[source]
        self.p[target] = self.p[source]
        self.p[:, target] = self.p[:, source]
        self.p[target, target] = self.p[source, source]

    def negate(self, index: int) -> None:
        """Change the sign of a state."""
        self.x[index] *= -1.0
        self.p[index] *= -1.0
        self.p[:, index] *= -1.0

    def set_independent(self, index: int, variance: float) -> None:
        """Give a state this variance and no correlation with any other."""
        self.p[index] = self.p[:, index] = 0.0
        self.p[index, index] = variance

    def renew(self, index: int, keep: float, sigma: float) -> None:
        """Advance a stationary process of this sigma, of which the share `keep` remains."""
        self.x[index] *= keep
        self.p[index] *= keep
        self.p[:, index] *= keep
        self.p[index, index] += (1.0 - keep * keep) * sigma * sigma

    def age_common(self, model: PoseModel, dt_s: float, path_m: float, link_sigma_m: float) -> None:
        """Advance the Gauss-Markov errors: of links and map by the distance, common to anchors by the time."""
        x, p = self.x, self.p
        in_space = math.exp(-path_m / model.deviation_length_m)
        in_time = math.exp(-dt_s / model.anchor_common_time_s)
        in_map = math.exp(-path_m / model.match_common_length_m)
        in_area = math.exp(-path_m / model.link_shift_length_m)
        keep = np.array((in_space, in_time, in_time, in_map, in_map, in_map, in_area, in_area))
        x[DEVIATION:N_STATES] *= keep
        p[:, DEVIATION:N_STATES] *= keep
        p[DEVIATION:N_STATES] *= keep[:, None]
        anchor, match = model.anchor_common_sigma_m, model.match_common_sigma_m
        sigma = np.array((link_sigma_m, anchor, anchor, match, match, model.match_common_sigma_rad, 1.0, 1.0))
        p[_AGING, _AGING] += (1.0 - keep * keep) * sigma**2
        p[LANE, LANE] += model.lane_wander_m_sqrt_m**2 * path_m


def inverse_2x2(s: Floats) -> Floats:
    """Return the inverse of a regular matrix (2, 2)."""
    a, b, c, d = float(s[0, 0]), float(s[0, 1]), float(s[1, 0]), float(s[1, 1])
    scale = 1.0 / (a * d - b * c)
    return np.array(((d * scale, -b * scale), (-c * scale, a * scale)))

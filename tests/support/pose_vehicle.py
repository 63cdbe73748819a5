"""A vehicle with a true motion, sensors, anchors, matches and links with errors, and the pose filter that sees them."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from camber.localizer.filter.anchors import AnchorResult
from camber.localizer.filter.odometry import SampleOutcome
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.scan_match_update import MatchUpdate
from camber.localizer.filter.start_from_fixes import StartPose
from support.pose_inputs import sample, start_pose

FIX = np.eye(2) * 0.02**2
MATCH_SIGMAS = np.array([0.02, 0.02, math.radians(0.1)])
MATCH = np.diag(MATCH_SIGMAS**2)
RIGHT = (0.0, 0.0)
"""Of anchors that are where the vehicle is."""


class PoseVehicle:
    """It changes speed and rate as vehicles can, or at once where it is `agile`; `noise` scales all errors but those of
    matches. Offsets are in its axes: forward, left, yaw."""

    def __init__(
        self,
        seed: int = 1,
        model: PoseModel | None = None,
        *,
        at: tuple[float, float, float] = (5.0, -3.0, 0.4),
        step_s: float = 0.1,
        agile: bool = False,
        both_sensors: bool = False,
        noise: float = 1.0,
    ) -> None:
        print("seed", seed)
        self.rng, self.model, self.noise = np.random.default_rng(seed), model or PoseModel(), noise
        self.filter, m = PoseFilter(self.model), self.model.motion
        sigmas = (m.yaw_rate_bias_sigma_rad_s, m.steering_bias_sigma_rad, m.speed_scale_sigma)
        self.bias, self.steering_bias, self.scale = noise * self.rng.normal(0.0, sigmas)
        self.sensors = ("yaw_rate", "steering") if both_sensors else (m.a_rate_sensor,)
        self.truth, self.time_ns = np.array(at), 10**15
        self.past: list[tuple[int, Any]] = []
        self.step_s, self.most = step_s, math.inf if agile else step_s
        self.speed = self.rate = self.path_m = self.matched_m = 0.0
        self.common, self.map_error = np.zeros(2), np.zeros(3)
        self.sense()

    def sense(self, slip: float = 1.0) -> SampleOutcome:
        m = self.model.motion
        sigmas = (m.speed_noise_m_s, m.steering_noise_rad, m.yaw_rate_noise_rad_s)
        wheel, steering, gyro = self.noise * self.rng.normal(0.0, sigmas)
        wheel += slip * self.speed / (1.0 + self.scale)
        gyro += self.rate + self.bias
        steering += self.steering_bias
        if self.speed > 0.5:
            steering += math.atan(self.rate * m.wheelbase_m / self.speed)
        self.past.append((self.time_ns, self.truth.copy()))
        by_rate, by_steering = (name in self.sensors for name in ("yaw_rate", "steering"))
        read = sample(self.time_ns, wheel, gyro if by_rate else None, steering if by_steering else None)
        return self.filter.predict(read)

    def step(self, speed: float, rate: float = 0.0, slip: float = 1.0) -> None:
        before = self.speed, self.rate
        self.speed += float(np.clip(speed - self.speed, -3.0 * self.most, 3.0 * self.most))
        self.rate += float(np.clip(rate - self.rate, -0.5 * self.most, 0.5 * self.most))
        along, turn = (
            0.5 * self.step_s * (a + b) for a, b in zip(before, (self.speed, self.rate), strict=True)
        )
        middle = self.truth[2] + 0.5 * turn
        self.truth += (along * math.cos(middle), along * math.sin(middle), turn)
        self.path_m += along
        self.time_ns += round(self.step_s * 1e9)
        self.sense(slip)

    def drive(
        self,
        seconds: float,
        speed: float,
        rate: float = 0.0,
        *,
        matches: dict[str, Any] | None = None,
        anchors: tuple[float, float] | None = None,
    ) -> Counter[str]:
        """Outcomes of the matches; those and the anchors, by their arguments, come five a second."""
        outcomes = Counter[str]()
        for k in range(round(seconds / self.step_s)):
            self.step(speed, rate)
            due = k % round(0.2 / self.step_s) == 0
            if matches is not None and due:
                outcomes[self.match(**matches).outcome] += 1
            if anchors is not None and due:
                self.anchor(anchors)
        return outcomes

    def antenna(self) -> Any:
        return self.truth[:2] + rotated(self.truth[2], self.model.antenna_x_m, self.model.antenna_y_m)

    def anchor(self, off: tuple[float, float] = RIGHT, time_ns: int | None = None) -> AnchorResult:
        """A confirmed fix; part of its error lasts half a minute."""
        keep = math.exp(-self.step_s / 30.0)
        new = self.noise * self.rng.normal(0.0, 0.03, 2)
        self.common = keep * self.common + math.sqrt(1.0 - keep**2) * new
        at = self.antenna() + self.common + self.noise * self.rng.normal(0.0, 0.02, 2)
        at = at + rotated(self.truth[2], *off)
        return self.filter.anchor(self.time_ns if time_ns is None else time_ns, at[0], at[1], FIX)

    def match(
        self,
        off: tuple[float, float, float] = (0.0, 0.0, 0.0),
        steps_late: int = 2,
        unique: bool = True,
        covariance: Any = MATCH,
    ) -> MatchUpdate:
        """Of a past sweep, to a map whose errors last 15 m."""
        time_ns, at = self.past[-1 - steps_late]
        keep = math.exp(-(self.path_m - self.matched_m) / 15.0)
        self.matched_m = self.path_m
        new = self.rng.normal(0.0, 1.0, 3) * (0.02, 0.02, 0.0005)
        self.map_error = keep * self.map_error + math.sqrt(1.0 - keep**2) * new
        seen = at + self.map_error + self.rng.normal(0.0, 1.0, 3) * MATCH_SIGMAS
        seen += (*rotated(at[2], off[0], off[1]), off[2])
        return self.filter.match(time_ns, tuple(seen), covariance, unique=unique)

    def given(self, off: tuple[float, float] = RIGHT, **more: Any) -> StartPose:
        """Where it is, off east and north by so much."""
        return start_pose(self.time_ns, np.add(self.truth, (*off, 0.0)), **more)

    def error(self) -> Any:
        e = self.filter.estimate()
        assert e is not None
        off = np.array([e.east_m, e.north_m, e.yaw_rad]) - self.truth
        off[2] = math.remainder(off[2], math.tau)
        return off

    def distance(self) -> float:
        return math.hypot(*self.error()[:2])

    def nees(self) -> float:
        e, off = self.filter.estimate(), self.error()
        assert e is not None
        return float(off @ np.linalg.solve(e.covariance, off))

"""What the wheels get wrong between a sweep and now: their age and their scale, which matches show."""

import math

import numpy as np
import pytest

from camber.localizer.filter.dead_reckoning_time_update import SCALE, WHEEL_LAG
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.track import OverlayLag
from support.pose_inputs import sample, start_pose

MATCH = np.diag([0.02**2, 0.02**2, math.radians(0.05) ** 2])
STEP_S = 0.1


class Straight:
    """East along a road; the wheels say the speed of `lag_s` ago, `scale` too little. Ten sweeps make a local map."""

    def __init__(self, lag_s=0.0, scale=0.0, seed=3):
        print("seed", seed)
        self.lag_s, self.scale, self.rng = lag_s, scale, np.random.default_rng(seed)
        self.filter = PoseFilter(PoseModel(motion=MotionModel()))
        self.wheels = []
        self.step(0.0)
        self.filter.start(start_pose(0, (0.0, 0.0, 0.0), sigma_m=0.05, yaw_deg=0.1))

    @staticmethod
    def speed(t):
        """Up to 12 m/s, down to 4 m/s, up again."""
        return float(np.interp(t, [1.0, 6.0, 9.0, 12.0, 17.0], [2.0, 12.0, 12.0, 4.0, 12.0]))

    def step(self, t):
        wheel = self.speed(t - self.lag_s) / (1.0 + self.scale)
        self.filter.predict(sample(round(t * 1e9), wheel + self.rng.normal(0.0, 0.01)))
        self.wheels.append((t, wheel))

    def run(self, seconds):
        """Errors along the road and their normalised squares, ten a second."""
        errors, squares = [], []
        fine = np.arange(0.0, seconds + 1e-9, 0.001)
        true = np.append(0.0, np.cumsum([0.001 * self.speed(t + 0.0005) for t in fine[:-1]]))
        for k in range(1, round(seconds / STEP_S)):
            t = STEP_S * k
            self.step(t)
            here = self.filter.track.at(round(t * 1e9))
            sweeps = [self.filter.track.at(round(s * 1e9)) for s, _ in self.wheels[-10:]]
            lag = OverlayLag(
                *(
                    np.mean([getattr(here, name) - getattr(sweep, name) for sweep in sweeps])
                    for name in ("path_m", "wheel_m", "wheel_m_s")
                )
            )
            # Where the sweeps were is seen; from there on the motion has carried them.
            seen = np.mean([np.interp(s, fine, true) for s, _ in self.wheels[-10:]]) + lag.path_m
            seen += self.rng.normal(0.0, 0.01)
            self.filter.match(round(t * 1e9), (seen, 0.0, 0.0), MATCH, unique=True, overlay_lag=lag)
            e = self.filter.estimate()
            errors.append(e.east_m - float(np.interp(t, fine, true)))
            squares.append(errors[-1] ** 2 / e.covariance[0, 0])
        return np.array(errors), np.array(squares)


@pytest.mark.parametrize("lag_s", [0.0, 0.06, 0.15])
def test_the_age_of_the_wheels_speed_is_learnt_where_the_speed_changes(lag_s):
    drive = Straight(lag_s=lag_s)
    errors, squares = drive.run(20.0)
    state = drive.filter.state
    assert state.x[WHEEL_LAG] == pytest.approx(lag_s, abs=0.02)
    assert math.sqrt(state.p[WHEEL_LAG, WHEEL_LAG]) < 0.015
    assert np.abs(errors[60:]).max() < 0.06
    assert np.mean(squares < 6.63) > 0.95


@pytest.mark.parametrize("scale", [-0.012, 0.008])
def test_a_wheel_scale_that_smears_the_local_map_is_learnt_and_does_not_move_the_pose(scale):
    drive = Straight(lag_s=0.05, scale=scale)
    errors, squares = drive.run(20.0)
    assert drive.filter.state.x[SCALE] == pytest.approx(scale, abs=0.002)
    assert np.abs(errors[100:]).max() < 0.05
    assert np.mean(squares < 6.63) > 0.95

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.interpolate import CubicSpline

from camber.simulator.vehicle.body import Mode
from camber.simulator.vehicle.cubic_curve import CubicCurve
from camber.simulator.vehicle.suspension import sprung


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.floats(0.5, 4.0), st.floats(0.05, 0.9), st.integers(0, 2**31))
def test_the_motion_is_that_of_another_simulation(hz: float, damping: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    road, push = (np.cumsum(rng.normal(0.0, 0.01, 300)) for _ in range(2))
    road, push = road - road[0], push - push[0]
    mode = Mode(hz, damping)
    w = mode.natural_frequency_rad_s
    system = signal.StateSpace(
        [[0.0, 1.0], [-(w**2), -2.0 * damping * w]],
        [[0.0, 0.0], [w**2, 1.0]],
        [[1.0, 0.0], [0.0, 1.0]],
        np.zeros((2, 2)),
    )
    time_s = np.arange(300) * 0.01
    pushed = signal.lsim(system, np.column_stack((push, np.zeros(300))), time_s)[1]
    transfer = signal.TransferFunction([2.0 * damping * w, w**2], [1.0, 2.0 * damping * w, w**2])
    followed = signal.lsim(transfer, road, time_s)[1]
    q, rate = sprung(mode, road, push, 0.01)
    np.testing.assert_allclose(q, pushed[:, 0] + followed, atol=1e-9)
    only_pushed = sprung(mode, np.zeros(300), push, 0.01)[1]
    np.testing.assert_allclose(only_pushed, pushed[:, 1], atol=1e-9)
    assert np.isfinite(rate).all()


def test_a_long_climb_is_followed_without_lag() -> None:
    road = 0.1 * np.arange(2000) * 0.05
    q, rate = sprung(Mode(1.3, 0.3), road, np.zeros(2000), 0.01)
    np.testing.assert_allclose(q[1000:], road[1000:], atol=1e-6)
    np.testing.assert_allclose(rate[1000:], 0.5, atol=1e-6)


def test_the_curve_is_another_library_s_cubic_spline() -> None:
    rng = np.random.default_rng(1)
    s = np.cumsum(rng.uniform(0.1, 0.4, 60))
    y = np.column_stack((np.sin(s), np.cos(0.5 * s)))
    curve = CubicCurve.through(s, y)
    ends = ((2, curve.second[0]), (2, curve.second[-1]))
    other = CubicSpline(s, y, bc_type=ends)
    at = np.linspace(s[0], s[-1], 500)
    for derivative, ours in enumerate(curve.at(at)):
        np.testing.assert_allclose(ours, other(at, derivative), atol=1e-9)
    np.testing.assert_allclose(curve.second[[0, -1]], curve.second[[1, -2]], atol=1e-12)


def test_a_curve_needs_ascending_distances() -> None:
    with pytest.raises(ValueError, match="ascending"):
        CubicCurve.through(np.array([0.0, 1.0, 1.0, 2.0]), np.zeros((4, 1)))

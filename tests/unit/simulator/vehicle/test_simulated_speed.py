from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.simulator.scene import Floats
from camber.simulator.vehicle.speed_profile import Driver, progress_along


def at_even_times(progress, step_s: float = 0.01) -> tuple[Floats, Floats, Floats, Floats]:  # type: ignore[no-untyped-def]
    time_s = np.arange(0.0, progress.duration_s, step_s)
    return time_s, *progress.at(time_s)


@st.composite
def roads(draw: st.DrawFn) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
    n = draw(st.integers(40, 400))
    step = draw(st.floats(0.1, 1.0))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    curvature = np.repeat(rng.normal(0.0, 0.08, 1 + n // 10), 10)[:n]
    limit = np.repeat(rng.uniform(2.0, 16.0, 1 + n // 25), 25)[:n]
    stop = np.zeros(n)
    for k in draw(st.lists(st.integers(0, n - 1), max_size=5)):
        limit[k], stop[k] = 0.0, draw(st.floats(0.0, 8.0))
    return step * np.arange(n), curvature, (limit, stop)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    roads(),
    st.builds(
        Driver,
        acceleration_m_s2=st.floats(0.5, 3.0),
        deceleration_m_s2=st.floats(0.5, 4.0),
        lateral_acceleration_m_s2=st.floats(1.0, 4.0),
        jerk_m_s3=st.floats(0.8, 10.0),
    ),
)
def test_every_bound_holds_on_every_road(
    road: tuple[Floats, Floats, tuple[Floats, Floats]], driver: Driver
) -> None:
    s, curvature, (limit, _) = road
    time_s, distance, speed, acceleration = at_even_times(progress := progress_along(*road, driver))
    assert distance[0] == pytest.approx(s[0], abs=1e-6)
    assert progress.at(np.array([progress.duration_s]))[0][0] == pytest.approx(s[-1], abs=1e-6)
    assert (np.diff(distance) > -1e-7).all()
    assert speed.min() >= -1e-9
    assert acceleration.max() <= driver.acceleration_m_s2 + 1e-9
    assert acceleration.min() >= -driver.deceleration_m_s2 - 1e-9
    assert np.abs(np.diff(acceleration)).max() <= driver.jerk_m_s3 * 0.01 + 1e-9
    # At a place between two samples the slacker of theirs is the most that may be meant.
    after = np.clip(np.searchsorted(s, distance - 1e-7), 1, len(s) - 1)
    for bound in (
        np.where(limit > 0.0, limit, np.inf),
        np.sqrt(driver.lateral_acceleration_m_s2 / np.maximum(np.abs(curvature), 1e-9)),
    ):
        assert (speed <= np.maximum(bound[after - 1], bound[after]) + 1e-6).all()
    # The distance is the integral of the speed.
    rolled = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) * 0.01
    np.testing.assert_allclose(distance[0] + rolled, distance, atol=1e-3)
    assert len(time_s) > 0


def test_a_free_road_is_driven_as_fast_as_the_driver_may() -> None:
    # The closed form: v / a to the limit, v / d from it, and between them at the limit; averaging adds T a rest.
    driver = Driver(jerk_m_s3=7.0)
    s = np.arange(0.0, 500.0, 0.5)
    progress = progress_along(s, np.zeros(len(s)), (np.full(len(s), 12.0), np.zeros(len(s))), driver)
    a, d, v = driver.acceleration_m_s2, driver.deceleration_m_s2, 12.0
    cruising_s = (s[-1] - v**2 / (2 * a) - v**2 / (2 * d)) / v
    expected = v / a + v / d + cruising_s + driver.rest_before_s + driver.rest_after_s + driver.window_s
    assert progress.duration_s == pytest.approx(expected, abs=0.02)
    _, _, speed, acceleration = at_even_times(progress)
    assert speed.max() == pytest.approx(12.0, abs=1e-6)
    assert (acceleration.max(), acceleration.min()) == (pytest.approx(a), pytest.approx(-d))


def test_neighbouring_stops_are_one_and_the_longest_counts() -> None:
    s = np.arange(0.0, 60.0, 0.5)
    limit, stop = np.full(len(s), 8.0), np.zeros(len(s))
    limit[50:53], stop[50:53] = 0.0, (1.0, 4.0, 2.0)
    time_s, distance, speed, _ = at_even_times(progress_along(s, np.zeros(len(s)), (limit, stop), Driver()))
    waiting = (np.abs(distance - s[50]) < 1e-6) & (speed == 0.0)
    assert waiting.sum() * 0.01 == pytest.approx(4.0, abs=0.03)
    standing = (speed == 0.0) & (time_s > 2.0) & (time_s < time_s[-1] - 1.2)
    assert standing.sum() == waiting.sum()

"""The error states in a filter: the same answer as the dense covariance, and nothing from a flat road."""

from __future__ import annotations

import numpy as np
import pytest

from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.relief.height_errors import HeightErrorModel
from camber.localizer.relief.height_states import HEIGHT_STATES, HeightStates

MODEL = HeightErrorModel()
SIGMA_M, NOISE_M = 0.02, 0.018


def filtered(
    slopes: np.ndarray, heights: np.ndarray, step_m: float, step_s: float, *, stepped: bool = False
) -> FilterState:
    """A position of σ 5 m in east and north after heights every `step_m` on a straight path."""
    state = FilterState(PoseModel(), HEIGHT_STATES)
    state.set_pose(0.0, 0.0, 0.0, np.diag([25.0, 25.0, 1e-12]))
    states = HeightStates(state, MODEL)
    if stepped:
        states.reopen()
    for k, (slope, height) in enumerate(zip(slopes, heights, strict=True)):
        if k:
            states.age(step_m, step_s)
        h = state.rows(1)
        h[0, :2] = slope
        h[0, state.extra] = states.row(SIGMA_M, NOISE_M)
        innovation = np.array([height - float(h[0] @ state.x)])
        state.update_joseph(h, innovation, np.array([[NOISE_M**2]]))
    return state


@pytest.mark.parametrize("stepped", [False, True])
def test_it_is_the_dense_least_squares_solution(stepped: bool) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        count, step_m, step_s = 60, 8.0, 1.0
        slopes = 0.02 * rng.standard_normal((count, 2))
        path = step_m * np.arange(count)
        places = np.column_stack([path, np.zeros(count)])
        sigma = np.full(count, SIGMA_M)
        errors = MODEL.covariance(
            places,
            step_s * np.arange(count),
            map_sigma_m=sigma,
            fix_sigma_m=np.full(count, NOISE_M),
            stepped=stepped,
        )
        heights = slopes @ [2.0, -1.0] + 1.5 + np.linalg.cholesky(errors) @ rng.standard_normal(count)
        state = filtered(slopes, heights, step_m, step_s, stepped=stepped)
        design = np.column_stack([slopes, np.ones(count)])
        prior = np.diag([1 / 25.0, 1 / 25.0, 1 / MODEL.offset_sigma_m**2])
        covariance = np.linalg.inv(design.T @ np.linalg.solve(errors, design) + prior)
        expected = covariance @ design.T @ np.linalg.solve(errors, heights)
        np.testing.assert_allclose(state.x[:2], expected[:2], atol=1e-5)
        np.testing.assert_allclose(state.p[:2, :2], covariance[:2, :2], rtol=1e-4, atol=1e-8)


def test_even_roads_and_standstills_give_nothing() -> None:
    even = filtered(np.tile([0.03, 0.01], (200, 1)), np.full(200, 51.8), 5.0, 0.5)
    assert np.linalg.eigvalsh(even.p[:2, :2])[0] > 0.99 * 25.0
    standing = filtered(np.tile([0.03, 0.01], (200, 1)), np.full(200, 51.8), 0.0, 1.0)
    assert np.linalg.eigvalsh(standing.p[:2, :2])[0] > 0.99 * 25.0


def test_states_that_are_reopened_know_neither_offset_nor_its_rate() -> None:
    state = FilterState(PoseModel(), HEIGHT_STATES)
    states = HeightStates(state, MODEL)
    states.age(100.0, 10.0)
    assert state.p[state.extra, state.extra][1, 1] == 0.0
    states.reopen()
    extra = state.p[state.extra, state.extra]
    assert extra[0, 0] == MODEL.offset_sigma_m**2
    assert extra[1, 1] == MODEL.stepped_rate_m_s**2
    states.reset()
    assert state.p[state.extra, state.extra][1, 1] == MODEL.stepped_rate_m_s**2

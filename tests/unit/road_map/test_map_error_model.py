"""The correlation function, the process along a road and the state-space form are one model."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

from camber.road_map.map_error_model import MAP_ERRORS, STATES, MapErrorModel

MODELS = st.builds(
    MapErrorModel,
    short_share=st.floats(0.0, 1.0),
    short_m=st.floats(1.0, 500.0),
    long_m=st.floats(1.0, 500.0),
)
STEPS = st.one_of(st.just(0.0), st.floats(1e-6, 1000.0))


@given(MODELS, st.integers(0, 2**32))
def test_the_covariance_over_a_plane_is_positive_definite(model: MapErrorModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    place_m = rng.uniform(0.0, 1000.0, (40, 2))
    place_m[30:] = place_m[:10]  # a street driven twice
    sigma_m = rng.uniform(0.01, 0.2, 40)
    covariance_m2 = model.covariance_m2(place_m, sigma_m)
    np.testing.assert_allclose(covariance_m2, covariance_m2.T, rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(np.diag(covariance_m2), sigma_m**2, rtol=1e-12)
    assert np.linalg.eigvalsh(covariance_m2).min() > -1e-12


@given(MODELS, STEPS)
def test_the_state_space_form_has_the_correlation_of_the_function(
    model: MapErrorModel, step_m: float
) -> None:
    row, stationary = model.observation, model.stationary_covariance
    ahead = row @ model.transition(step_m) @ stationary @ row
    assert ahead == pytest.approx(float(model.correlation(step_m)), abs=1e-12)
    assert row @ stationary @ row == pytest.approx(1.0)


@given(MODELS, STEPS)
def test_the_state_stays_stationary(model: MapErrorModel, step_m: float) -> None:
    phi, stationary = model.transition(step_m), model.stationary_covariance
    np.testing.assert_allclose(
        phi @ stationary @ phi.T + model.process_noise(step_m), stationary, rtol=0.0, atol=1e-12
    )


@given(MODELS, STEPS, STEPS)
def test_two_steps_are_one(model: MapErrorModel, first_m: float, second_m: float) -> None:
    both = model.transition(second_m)
    np.testing.assert_allclose(
        both @ model.transition(first_m), model.transition(first_m + second_m), rtol=0.0, atol=1e-12
    )
    noise = both @ model.process_noise(first_m) @ both.T + model.process_noise(second_m)
    np.testing.assert_allclose(noise, model.process_noise(first_m + second_m), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("step_m", [1e-4, 0.3, 9.99, 10.01, 50.0, 700.0])
def test_discretization_is_that_of_the_differential_equation(step_m: float) -> None:
    """Oracle: matrix exponential and quadrature of dx = F x ds + G dw, slope in units of 1 / L₂."""
    m = MAP_ERRORS
    rate = 1.0 / m.long_m
    drift = np.array([[-1.0 / m.short_m, 0.0, 0.0], [0.0, 0.0, rate], [0.0, -rate, -2.0 * rate]])
    white = np.diag([2.0 * m.short_share / m.short_m, 0.0, 4.0 * rate * (1.0 - m.short_share)])
    np.testing.assert_allclose(m.transition(step_m), expm(drift * step_m), rtol=0.0, atol=1e-12)
    noise, _ = quad_vec(lambda s: expm(drift * s) @ white @ expm(drift * s).T, 0.0, step_m, epsrel=1e-11)
    np.testing.assert_allclose(m.process_noise(step_m), noise, rtol=1e-7, atol=1e-16)


@pytest.mark.parametrize("spacing_m", [0.7, 9.0])
def test_simulated_errors_have_sigma_and_correlation_whatever_the_spacing(spacing_m: float) -> None:
    seed, drives, n = 41, 4000, 60
    rng = np.random.default_rng(seed)
    at_m = spacing_m * np.arange(n)
    z = np.array([MAP_ERRORS.simulate(at_m, 0.05, rng) for _ in range(drives)])
    covariance_m2 = z.T @ z / drives
    expected = MAP_ERRORS.covariance_m2(at_m[:, None], np.full(n, 0.05))
    # σ of an element of a sample covariance: √((σ⁴ + c²) / drives) ≤ √(2 / drives) σ²; six of them for 1,830 elements.
    assert np.abs(covariance_m2 - expected).max() < 6.0 * math.sqrt(2.0 / drives) * 0.05**2, seed


def test_a_road_of_no_length_has_no_error() -> None:
    assert MAP_ERRORS.simulate(np.zeros(0), 0.05, np.random.default_rng(1)).shape == (0,)
    same_place = MAP_ERRORS.simulate(np.zeros(5), 0.05, np.random.default_rng(1))
    assert np.ptp(same_place) == 0.0
    assert MAP_ERRORS.transition(0.0) == pytest.approx(np.eye(STATES))


def test_surveys_differ_by_their_common_offset() -> None:
    rng = np.random.default_rng(7)
    offset_m = [MAP_ERRORS.common_offset(rng) for _ in range(4000)]
    assert np.std(offset_m) == pytest.approx(MAP_ERRORS.common_offset_sigma_m, rel=0.05)


@pytest.mark.parametrize(
    "values",
    [
        {"short_share": 1.1},
        {"short_share": math.nan},
        {"short_m": 0.0},
        {"long_m": math.inf},
        {"common_offset_sigma_m": -1.0},
    ],
)
def test_values_that_are_no_model_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        MapErrorModel(**values)

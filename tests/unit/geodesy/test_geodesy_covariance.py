"""Error ellipses in closed form against numpy's eigenvalues, and against drawn errors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.covariance import (
    confidence_scale,
    eigenvalues_m2,
    error_ellipse,
    horizontal_from_enu,
    radius_m,
)

sigmas = st.floats(1e-4, 100.0)
correlations = st.floats(-1.0, 1.0)


def covariance(sigma_e: float, sigma_n: float, correlation: float) -> tuple[float, float, float]:
    return sigma_e**2, correlation * sigma_e * sigma_n, sigma_n**2


@pytest.mark.parametrize(("probability", "scale"), [(0.99, 9.21), (0.999, 13.82), (0.0, 0.0)])
def test_scales_of_the_document(probability: float, scale: float) -> None:
    assert confidence_scale(probability) == pytest.approx(scale, abs=0.005)


@given(sigmas, sigmas, correlations)
def test_eigenvalues_are_those_of_numpy(sigma_e: float, sigma_n: float, correlation: float) -> None:
    ee, en, nn = covariance(sigma_e, sigma_n, correlation)
    smaller, larger = np.linalg.eigvalsh([[ee, en], [en, nn]])
    assert eigenvalues_m2((ee, en, nn)) == pytest.approx((larger, smaller), rel=1e-9, abs=1e-12 * larger)


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0), st.floats(-0.99, 0.99))
def test_ellipse_reaches_the_chosen_level_at_the_end_of_its_axes(
    sigma_e: float, sigma_n: float, correlation: float
) -> None:
    ee, en, nn = covariance(sigma_e, sigma_n, correlation)
    ellipse = error_ellipse((ee, en, nn), 0.99)
    inverse = np.linalg.inv([[ee, en], [en, nn]])
    c, s = math.cos(ellipse.orientation_rad), math.sin(ellipse.orientation_rad)
    major, minor = ellipse.semi_major_m * np.array([c, s]), ellipse.semi_minor_m * np.array([-s, c])
    assert major @ inverse @ major == pytest.approx(confidence_scale(0.99), rel=1e-5)
    assert minor @ inverse @ minor == pytest.approx(confidence_scale(0.99), rel=1e-4)


@given(sigmas, sigmas, correlations, st.floats(0.01, 0.999), st.floats(0.01, 0.999))
def test_radius_grows_with_probability_and_covers_each_axis(
    sigma_e: float, sigma_n: float, correlation: float, p: float, q: float
) -> None:
    cov = covariance(sigma_e, sigma_n, correlation)
    assert radius_m(cov, min(p, q)) <= radius_m(cov, max(p, q))
    assert radius_m(cov, p) >= math.sqrt(confidence_scale(p)) * max(sigma_e, sigma_n) * (1.0 - 1e-12)


def test_a_small_axis_is_not_lost_next_to_a_large_one() -> None:
    minor_m = error_ellipse((33.0**2, 0.0, 0.0001**2), 0.99).semi_minor_m
    assert minor_m == pytest.approx(0.0001 * math.sqrt(-2.0 * math.log(0.01)), rel=1e-9)


def test_circle_has_radius_and_no_orientation() -> None:
    ellipse = error_ellipse((0.0004, 0.0, 0.0004), 0.99)
    assert ellipse.semi_major_m == ellipse.semi_minor_m == pytest.approx(0.02 * math.sqrt(9.2103), rel=1e-4)
    assert ellipse.orientation_rad == 0.0


def test_orientation_is_that_of_the_major_axis() -> None:
    assert error_ellipse((1.0, 0.0, 4.0), 0.5).orientation_rad == pytest.approx(math.pi / 2)
    assert error_ellipse((1.0, 0.5, 1.0), 0.5).orientation_rad == pytest.approx(math.pi / 4)
    assert error_ellipse((1.0, -0.5, 1.0), 0.5).orientation_rad == pytest.approx(-math.pi / 4)


def test_rounding_is_forgiven() -> None:
    assert eigenvalues_m2((1.0, 1.0 + 1e-12, 1.0))[1] == 0.0


@pytest.mark.parametrize(
    "bad",
    [
        (-1.0, 0.0, 1.0), (-1.0, 0.0, -1.0), (math.nan, 0.0, 1.0), (1.0, math.nan, 1.0), (math.inf, 0.0, 1.0),
        (0.0, 1e-9, 0.0), (1.0, 1.001, 1.0),
    ],
)  # fmt: skip
def test_what_is_no_covariance_is_refused(bad: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="not positive semidefinite"):
        radius_m(bad, 0.99)


@pytest.mark.parametrize("probability", [1.0, -0.1, math.nan, 1.5])
def test_what_is_no_probability_is_refused(probability: float) -> None:
    with pytest.raises(ValueError, match="probability"):
        confidence_scale(probability)


def test_horizontal_part() -> None:
    assert horizontal_from_enu((1.0, 2.0, 3.0, 4.0, 5.0, 6.0)) == (1.0, 2.0, 4.0)

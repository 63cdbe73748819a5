"""Wrapping of angles, and heading against yaw."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.geodesy.angles import angle_difference, heading_from_yaw, wrap_pi, wrap_pi_array, wrap_two_pi

angles = st.floats(-1000.0, 1000.0)


def same_direction(a: float, b: float) -> bool:
    return math.isclose(math.cos(a - b), 1.0, abs_tol=1e-9)


@given(angles)
def test_wrapping_keeps_the_direction_and_the_range(angle: float) -> None:
    assert -math.pi < wrap_pi(angle) <= math.pi
    assert 0.0 <= wrap_two_pi(angle) < 2.0 * math.pi
    assert same_direction(wrap_pi(angle), angle)
    assert same_direction(wrap_two_pi(angle), angle)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (-1e-20, -1e-20), (0.0, 0.0)],
)
def test_wrap_pi_edges(angle: float, wrapped: float) -> None:
    assert wrap_pi(angle) == wrapped


def test_wrap_two_pi_of_a_tiny_negative_angle_stays_below_the_end() -> None:
    assert wrap_two_pi(-1e-20) == 0.0


@given(st.lists(angles, max_size=20))
def test_array_agrees_with_scalar(values: list[float]) -> None:
    wrapped = wrap_pi_array(np.array(values))
    assert wrapped.shape == (len(values),)
    assert np.all((wrapped > -math.pi) & (wrapped <= math.pi))
    assert all(same_direction(a, b) for a, b in zip(wrapped, values, strict=True))


def test_not_finite_never_becomes_a_direction() -> None:
    assert math.isnan(wrap_pi(math.nan))
    assert math.isnan(wrap_two_pi(math.nan))
    assert np.all(np.isnan(wrap_pi_array([math.nan, math.inf])))
    with pytest.raises(ValueError, match="math domain error"):
        wrap_pi(math.inf)


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"), [(90.0, 0.0), (0.0, 90.0), (-90.0, 180.0), (180.0, 270.0), (45.0, 45.0)]
)
def test_heading_and_yaw(yaw_deg: float, heading_deg: float) -> None:
    assert math.degrees(heading_from_yaw(math.radians(yaw_deg))) == pytest.approx(heading_deg)


def test_a_difference_is_the_smaller_angle() -> None:
    assert angle_difference(math.radians(-179.0), math.radians(179.0)) == pytest.approx(math.radians(2.0))

"""The line of a link, and the Kalman update by one row and by two."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.localizer.filter.filter_state import kalman_update
from camber.localizer.links.link_line import LinkLine
from support.plain_links import line_through

ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-200.0, 200.0)


@given(METRES, METRES, ANGLES, METRES)
def test_the_normal_is_the_derivative_of_the_offset(east, north, alpha, c):
    line, step = LinkLine(alpha, c), 1e-3
    by_east = (line.offset_m(east + step, north) - line.offset_m(east - step, north)) / (2 * step)
    by_north = (line.offset_m(east, north + step) - line.offset_m(east, north - step)) / (2 * step)
    assert line.normal == pytest.approx((by_east, by_north), abs=1e-9)


def test_the_offset_is_positive_to_the_left_of_the_link_and_negative_to_its_right():
    line = line_through((0.0, 0.0), (10.0, 0.0))
    assert line.offset_m(5.0, 2.0) == pytest.approx(2.0)
    assert line.offset_m(5.0, -2.0) == pytest.approx(-2.0)


@given(METRES, METRES, METRES, METRES, ANGLES)
def test_a_line_does_not_move_when_the_origin_does(east, north, origin_e, origin_n, alpha):
    line = LinkLine(alpha, 3.0)
    moved = line.shifted(origin_e, origin_n)
    assert moved.offset_m(east - origin_e, north - origin_n) == pytest.approx(line.offset_m(east, north))


@pytest.mark.parametrize("seed", range(5))
def test_the_kalman_update_is_weighted_least_squares(seed):
    """CN101360971 eq. (9) to (13): minimise |X - x|² in Q_x plus |z - h X|² in the noise; two rows or one by one."""
    rng = np.random.default_rng(seed)
    x, h, z = rng.uniform(-5, 5, 3), rng.standard_normal((2, 3)), rng.standard_normal(2)
    root, noise = np.eye(3) + 0.3 * rng.standard_normal((3, 3)), np.diag([0.3, 0.002])
    p = root @ root.T
    both_x, both_p, s = kalman_update(x, p, h=h, innovation=z, noise=noise)
    expected = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(noise) @ h)
    np.testing.assert_allclose(both_p, expected, atol=1e-9)
    np.testing.assert_allclose(both_x, x + expected @ h.T @ np.linalg.inv(noise) @ z, atol=1e-9)
    np.testing.assert_allclose(s, h @ p @ h.T + noise)
    one_x, one_p, _ = kalman_update(x, p, h=h[:1], innovation=z[:1], noise=noise[:1, :1])
    z2 = z[1:] - h[1:] @ (one_x - x)
    two_x, two_p, _ = kalman_update(one_x, one_p, h=h[1:], innovation=z2, noise=noise[1:, 1:])
    np.testing.assert_allclose(both_x, two_x, atol=1e-10)
    np.testing.assert_allclose(both_p, two_p, atol=1e-10)

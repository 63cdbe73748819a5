"""The coupling of pose and link against the document's own forms, computed another way."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from camber.geodesy.angles import wrap_pi
from camber.localizer.filter.kalman import kalman_update
from camber.localizer.links.link_observation import LinkLine, jacobian_s, jacobian_x, observation
from support.plain_links import couple, line_through

ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-200.0, 200.0)


def a_covariance(rng, sigmas):
    size = len(sigmas)
    mixed = np.eye(size) + 0.3 * rng.standard_normal((size, size))
    root = np.diag(sigmas) @ mixed
    return root @ root.T


def a_case(seed):
    rng = np.random.default_rng(seed)
    x = np.array([*rng.uniform(-50, 50, 2), rng.uniform(-3, 3)])
    alpha = x[2] + rng.normal(0, 0.05)
    c = x[0] * math.sin(alpha) - x[1] * math.cos(alpha) + rng.normal(0, 3)
    s = np.array([alpha, c, rng.normal(0, 2), rng.normal(0, 0.05)])
    return x, a_covariance(rng, [3.0, 2.0, 0.03]), s, a_covariance(rng, [0.02, 1.0, 1.5, 0.02])


def weighted_least_squares(x, q_x, s, q_s):
    """Solve eq. (9) to (13) as a batch: minimise |X - x|^2 in Q_x plus |J_S dS|^2 in Q'_S under h = 0."""
    h, j_x, j_s = observation(x, s), jacobian_x(s), jacobian_s(x, s)
    q_s_prime = j_s @ q_s @ j_s.T
    a = np.vstack([np.eye(3), j_x])
    b = np.concatenate([np.zeros(3), -h])
    weight = np.zeros((5, 5))
    weight[:3, :3] = np.linalg.inv(q_x)
    weight[3:, 3:] = np.linalg.inv(q_s_prime)
    normal = a.T @ weight @ a
    return x + np.linalg.solve(normal, a.T @ weight @ b), np.linalg.inv(normal)


@pytest.mark.parametrize("seed", range(20))
def test_coupling_is_the_documents_weighted_least_squares(seed):
    x, q_x, s, q_s = a_case(seed)
    coupled = couple(x, q_x, s, q_s)
    expected, covariance = weighted_least_squares(x, q_x, s, q_s)
    np.testing.assert_allclose(coupled.x_hat, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(coupled.q_hat, covariance, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_coupling_minimises_the_cost_a_general_optimiser_minimises(seed):
    x, q_x, s, q_s = a_case(seed)
    root_x = np.linalg.cholesky(np.linalg.inv(q_x)).T
    h, j_x, j_s = observation(x, s), jacobian_x(s), jacobian_s(x, s)
    root_s = np.linalg.cholesky(np.linalg.inv(j_s @ q_s @ j_s.T)).T
    optimum = optimize.least_squares(
        lambda d: np.concatenate([root_x @ d, root_s @ (h + j_x @ d)]), np.zeros(3), xtol=1e-15, ftol=1e-15
    )
    np.testing.assert_allclose(couple(x, q_x, s, q_s).x_hat - x, optimum.x, atol=1e-6)


@given(METRES, METRES, ANGLES, ANGLES, METRES, METRES, ANGLES)
def test_jacobians_are_the_derivatives(east, north, yaw, alpha, c, r, phi):
    x, s = np.array([east, north, yaw]), np.array([alpha, c, r, phi])
    step = 1e-6

    def difference(plus, minus):
        d = plus - minus
        return np.array([d[0], wrap_pi(d[1])]) / (2 * step)

    for k in range(3):
        e = step * np.eye(3)[k]
        slope = difference(observation(x + e, s), observation(x - e, s))
        np.testing.assert_allclose(jacobian_x(s)[:, k], slope, atol=1e-6)
    for k in range(4):
        e = step * np.eye(4)[k]
        slope = difference(observation(x, s + e), observation(x, s - e))
        np.testing.assert_allclose(jacobian_s(x, s)[:, k], slope, atol=1e-6)


def test_normalised_error_of_the_coupled_pose_is_chi_square():
    seed = 20260701
    print("seed", seed)
    rng = np.random.default_rng(seed)
    truth = np.array([12.0, -7.0, 0.6])
    alpha = 0.55
    c = 12.0 * math.sin(alpha) + 7.0 * math.cos(alpha)
    s_true = np.array([alpha, c + 1.5, 1.5, alpha - truth[2]])
    assert np.allclose(observation(truth, s_true), 0.0, atol=1e-12)
    q_x, q_s = a_covariance(rng, [2.0, 1.0, 0.02]), a_covariance(rng, [0.01, 0.5, 0.5, 0.01])
    n = 3000
    nees, nis = [], []
    for _ in range(n):
        x = rng.multivariate_normal(truth, q_x)
        s = rng.multivariate_normal(s_true, q_s)
        coupled = couple(x, q_x, s, q_s)
        error = coupled.x_hat - truth
        nees.append(error @ np.linalg.solve(coupled.q_hat, error))
        nis.append(coupled.innovation @ np.linalg.solve(coupled.innovation_covariance, coupled.innovation))
    for values, dof in ((nees, 3), (nis, 2)):
        low, high = stats.chi2.ppf([0.0005, 0.9995], dof * n) / n
        assert low < np.mean(values) < high


def test_the_offset_is_positive_to_the_left_of_the_link_and_negative_to_its_right():
    line = line_through((0.0, 0.0), (10.0, 0.0))
    assert line.offset_m(5.0, 2.0) == pytest.approx(2.0)
    assert line.offset_m(5.0, -2.0) == pytest.approx(-2.0)
    for side in (3.0, -3.0):
        s = np.array([line.alpha_rad, line.c_m, side, 0.0])
        assert observation(np.array([4.0, side, 0.0]), s) == pytest.approx([0.0, 0.0])


def test_coupling_works_across_the_link_and_leaves_the_position_along_it():
    q_x, q_s = np.diag([9.0, 9.0, 0.01]), np.diag([1e-6, 0.01, 0.01, 1.0])
    coupled = couple(np.array([1.0, 4.0, 0.0]), q_x, np.array([0.0, 0.0, 1.0, 0.0]), q_s)
    assert coupled.x_hat[0] == pytest.approx(1.0)
    assert coupled.x_hat[1] == pytest.approx(1.0, abs=0.02)
    assert coupled.q_hat[0, 0] == pytest.approx(9.0)


def test_an_error_of_the_links_direction_cancels_in_an_absolute_heading():
    """phi = alpha - yaw_B: its error is alpha's with the same sign, and row 2 does not feel it."""
    x, q_x = np.array([0.0, 0.0, 0.3]), np.diag([1.0, 1.0, 0.04])
    var_alpha, var_b = 0.5, 0.01
    q_s = np.diag([var_alpha, 1.0, 1.0, var_alpha + var_b])
    q_s[0, 3] = q_s[3, 0] = var_alpha
    coupled = couple(x, q_x, np.array([0.2, 0.0, 0.0, 0.0]), q_s)
    assert coupled.innovation_covariance[1, 1] == pytest.approx(0.04 + var_b)


@given(METRES, METRES, METRES, METRES, ANGLES)
def test_a_line_does_not_move_when_the_origin_does(east, north, origin_e, origin_n, alpha):
    line = LinkLine(alpha, 3.0)
    moved = line.shifted(origin_e, origin_n)
    assert moved.offset_m(east - origin_e, north - origin_n) == pytest.approx(line.offset_m(east, north))


@given(st.integers(0, 10_000), st.floats(1.0, 1e4))
def test_more_noise_never_shrinks_the_result(seed, factor):
    x, q_x, s, q_s = a_case(seed)
    less, more = couple(x, q_x, s, q_s).q_hat, couple(x, q_x, s, q_s * factor).q_hat
    np.testing.assert_array_equal(less, less.T)
    assert np.linalg.eigvalsh(less)[0] > 0.0
    assert np.linalg.eigvalsh(more - less)[0] > -1e-9


def test_two_rows_at_once_are_one_row_after_the_other_when_their_noise_is_independent():
    x, q_x, s, _ = a_case(3)
    h, noise, z = jacobian_x(s), np.diag([0.3, 0.002]), np.array([0.4, -0.01])
    both_x, both_p, _ = kalman_update(x, q_x, h=h, innovation=z, noise=noise)
    one_x, one_p, _ = kalman_update(x, q_x, h=h[:1], innovation=z[:1], noise=noise[:1, :1])
    z2 = z[1:] - h[1:] @ (one_x - x)
    two_x, two_p, _ = kalman_update(one_x, one_p, h=h[1:], innovation=z2, noise=noise[1:, 1:])
    np.testing.assert_allclose(both_x, two_x, atol=1e-10)
    np.testing.assert_allclose(both_p, two_p, atol=1e-10)

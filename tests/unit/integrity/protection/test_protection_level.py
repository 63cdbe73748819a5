"""Protection levels: against other formulas and against draws; what must always hold."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import integrate, special, stats

from camber.integrity.protection.protection_level import levels_m
from support.tails import horizontal, in_parts, whitened

exactly = settings(derandomize=True, deadline=None)
sigma = st.floats(0.01, 5.0)
risks = st.floats(1e-9, 0.1)
SLACK = 1.0 + 5e-4
SPENT = 0.97
"""Of the risk: the rest is for what the nodes are wrong by."""


def alone(covariance):
    """A mixture of one part, without a mean."""
    return horizontal(np.ones((1, 1)), np.zeros((1, 1, 2)), np.asarray(covariance, float)[None, None])


def vertical(weight, mean, variance):
    """On a line."""
    covariance = np.zeros((*variance.shape, 2, 2))
    covariance[..., 0, 0] = variance
    return horizontal(weight, np.stack((mean, np.zeros_like(mean)), axis=-1), covariance)


def in_ellipses(weight, mean, covariance):
    """In standard deviations of the first part."""
    return horizontal(weight, *whitened(mean, covariance))


def of_rows(parts, risk):
    return levels_m(parts, [risk])[0]


def in_floats(parts, row=0):
    """One of many mixtures as the judge has it."""
    return [tuple(column[row].item() for column in part) for part in parts]


def level(parts, risk):
    (result,) = levels_m(in_floats(parts), [risk])
    assert isinstance(result, float)
    return result


def mixture(weights, means, sigmas):
    covariances = [np.diag([s * s, (s * 0.6) ** 2]) for s in sigmas]
    return horizontal(np.array([weights]), np.array([means], float), np.array([covariances]))


@exactly
@given(sigma, risks)
def test_of_a_round_error_it_is_rayleighs(s, risk):
    exact = s * math.sqrt(-2.0 * math.log(SPENT * risk))
    assert level(alone(s * s * np.eye(2)), risk) == pytest.approx(exact, rel=5e-4)


@exactly
@given(sigma, risks)
def test_on_a_line_it_is_the_normal_distributions(s, risk):
    exact = s * stats.norm.isf(SPENT * risk / 2.0)
    for tails in (
        alone([[s * s, 0.0], [0.0, 0.0]]),
        vertical(np.ones((1, 1)), np.zeros((1, 1)), np.array([[s * s]])),
    ):
        assert level(tails, risk) == pytest.approx(exact, rel=5e-4)


@pytest.mark.parametrize(("a", "b", "rho"), [(1.0, 0.5, 0.3), (2.0, 0.1, -0.8), (0.3, 0.31, 0.99)])
def test_of_an_ellipse_it_is_that_of_quadrature_over_the_plane(a, b, rho):
    covariance = np.array([[a * a, rho * a * b], [rho * a * b, b * b]])
    larger, smaller = np.linalg.eigvalsh(covariance)[::-1]
    result = level(alone(covariance), 1e-5)

    def beyond(x):
        rest = max(result * result - x * x, 0.0)
        return stats.norm.pdf(x, scale=math.sqrt(larger)) * special.erfc(math.sqrt(0.5 * rest / smaller))

    inside = integrate.quad(beyond, 0.0, result, epsabs=1e-15, limit=500)[0]
    outside = stats.norm.sf(result, scale=math.sqrt(larger))
    assert 2.0 * (inside + outside) == pytest.approx(SPENT * 1e-5, rel=2e-3)


def test_of_heights_with_a_mean_it_is_exact():
    result = level(vertical(np.array([[0.9, 0.1]]), np.array([[0.0, -0.3]]), np.array([[0.01, 0.04]])), 1e-4)
    p = 0.9 * 2.0 * stats.norm.sf(result, scale=0.1)
    p += 0.1 * (stats.norm.sf(result, 0.3, 0.2) + stats.norm.cdf(-result, 0.3, 0.2))
    assert p == pytest.approx(SPENT * 1e-4, rel=2e-3)
    assert p <= 1e-4


def exact(weight, mean, sigma, result):
    """P of round errors about means: Rice's distribution, by the non-central χ² of two degrees of freedom."""
    x, m = result[:, None] / sigma, np.maximum((mean / sigma) ** 2, 1e-300)
    return (weight * stats.ncx2.sf(x**2, 2, m)).sum(axis=1)


@pytest.mark.parametrize("farthest", [0.0, 10.0])
def test_where_a_part_weighs_as_much_as_the_risk_the_exact_formula_keeps_to_it(farthest):
    rng = np.random.default_rng(17)
    n = 4000
    risk = 10.0 ** rng.uniform(-9.0, -1.0, n)
    second = risk * (1.0 + rng.normal(size=n) * 10.0 ** rng.uniform(-6.0, -0.5, n))
    weight, sigma = np.column_stack((1.0 - second, second)), 10.0 ** rng.uniform(-2.0, 0.5, (n, 2))
    mean = np.column_stack((np.zeros(n), rng.uniform(0.0, farthest, n) * sigma[:, 1]))
    covariance = (sigma**2)[:, :, None, None] * np.eye(2)
    result = of_rows(horizontal(weight, np.stack((mean, 0.0 * mean), axis=2), covariance), risk)
    assert (exact(weight, mean, sigma, result) <= risk).all()


@pytest.mark.parametrize("far", [0.0, 3.0])
def test_about_where_the_level_jumps_to_another_part_the_risk_is_kept(far):
    second = 1e-7 * (1.0 + np.linspace(-2e-3, 2e-3, 101))
    weight = np.column_stack((1.0 - second, second))
    mean = np.tile([0.0, far], (101, 1))
    sigma = np.full((101, 2), [0.05, 0.4])
    covariance = (sigma**2)[:, :, None, None] * np.eye(2)
    result = of_rows(horizontal(weight, np.stack((mean, 0.0 * mean), axis=2), covariance), np.full(101, 1e-7))
    assert (exact(weight, mean, sigma, result) <= 1e-7).all()


def test_draws_of_a_mixture_exceed_it_no_more_often_than_the_risk_and_not_much_more_seldom():
    rng = np.random.default_rng(5)
    n = 1_000_000
    weights, means, sigmas = (0.97, 0.03), ((0.0, 0.0), (0.3, 0.4)), (0.1, 0.2)
    part = rng.random(n) < weights[1]
    scale = np.where(part[:, None], sigmas[1], sigmas[0]) * np.array([1.0, 0.6])
    error = rng.normal(size=(n, 2)) * scale + np.where(part[:, None], means[1], means[0])
    for risk in (0.1, 1e-2, 1e-3):
        share = (np.hypot(*error.T) > level(mixture(weights, means, sigmas), risk)).mean()
        spread = math.sqrt(risk / n)
        assert share <= risk + 4.0 * spread
        assert share >= SPENT * risk - 5.0 * spread
    assert (
        np.abs(error[:, 1])
        > level(vertical(np.array([weights]), np.array([[0.0, 0.4]]), np.array([[0.06**2, 0.12**2]])), 1e-2)
    ).mean() == pytest.approx(1e-2, rel=0.05)


@exactly
@given(risks, st.floats(1.01, 100.0), st.floats(0.0, 0.5), st.floats(0.0, 3.0), sigma, sigma)
def test_less_risk_never_shrinks_it(risk, less, w, offset, s, t):
    tails = mixture((1.0 - w, w), ((0, 0), (offset, 0)), (s, t))
    assert level(tails, risk / less) * SLACK >= level(tails, risk)


@exactly
@given(risks, st.floats(0.0, 0.5), st.floats(0.0, 3.0), sigma, sigma, sigma, st.booleans())
def test_more_uncertainty_never_shrinks_it(risk, w, offset, s, t, more, of_first):
    assume(abs(w - risk) > 0.02 * risk)  # there the level jumps to where the second part counts in full

    def of(extra):
        sigmas = (math.hypot(s, extra), t) if of_first else (s, math.hypot(t, extra))
        return level(mixture((1.0 - w, w), ((0, 0), (offset, 0)), sigmas), risk)

    assert of(more) * SLACK >= of(0.0)


@exactly
@given(risks, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 3.0), sigma, sigma)
def test_more_weight_on_the_worse_part_never_shrinks_it(risk, w, share, offset, s, more):
    def of(weight):
        return level(mixture((1.0 - weight, weight), ((0, 0), (offset, 0)), (s, s + more)), risk)

    assert of(w) * SLACK >= of(w * share)


@exactly
@given(risks, st.floats(0.0, 3.0), st.floats(0.0, 2.0), sigma)
def test_a_mean_farther_off_never_shrinks_it(risk, offset, more, s):
    for make in (
        lambda d: mixture((0.5, 0.5), ((0, 0), (d, 0)), (s, s)),
        lambda d: vertical(np.array([[0.5, 0.5]]), np.array([[0.0, d]]), np.array([[s * s, s * s]])),
    ):
        assert level(make(offset + more), risk) * SLACK >= level(make(offset), risk)


def test_all_rows_are_solved_alike_however_many():
    rng = np.random.default_rng(2)
    spread = rng.uniform(0.01, 2.0, 9000)
    tails = horizontal(
        np.ones((9000, 1)), np.zeros((9000, 1, 2)), (spread**2)[:, None, None, None] * np.eye(2)
    )
    result = of_rows(tails, np.full(9000, 1e-7))
    assert result == pytest.approx(spread * math.sqrt(-2.0 * math.log(SPENT * 1e-7)), rel=1e-4)
    nothing = horizontal(np.ones((0, 1)), np.zeros((0, 1, 2)), np.zeros((0, 1, 2, 2)))
    assert of_rows(nothing, np.zeros(0)).shape == (0,)


def test_rows_of_different_kinds_may_be_solved_together():
    one, two = alone(np.eye(2)), vertical(np.ones((1, 1)), np.zeros((1, 1)), np.ones((1, 1)))
    ((*both,),) = [
        tuple(map(np.concatenate, zip(*of_both, strict=True))) for of_both in zip(one, two, strict=True)
    ]
    together = of_rows([tuple(both)], np.array([1e-7, 1e-7]))
    assert together == pytest.approx([level(one, 1e-7), level(two, 1e-7)], rel=1e-4)


def some_mixtures(seed):
    """200 of three parts, the second with a mean, and a risk for each."""
    rng = np.random.default_rng(seed)
    weight, sigma = 10.0 ** rng.uniform(-8.0, 0.0, (200, 3)), 10.0 ** rng.uniform(-2.0, 0.5, (200, 3))
    mean = np.array([0.0, 1.0, 0.0]) * rng.uniform(0.0, 3.0, (200, 3))
    return in_parts(weight, mean, 0.3 * mean, sigma**2, 0.2 * sigma**2), 10.0 ** rng.uniform(-9, -1, 200)


def test_a_level_does_not_depend_on_those_computed_with_it():
    parts, risk = some_mixtures(4)
    for row, together in enumerate(of_rows(parts, risk)[:20]):
        one = [tuple(column[row : row + 1] for column in part) for part in parts]
        assert of_rows(one, risk[row : row + 1])[0] == pytest.approx(together, rel=1e-12)


def test_one_in_plain_floats_has_the_level_that_it_has_among_many():
    parts, risk = some_mixtures(6)
    for row, among_many in enumerate(of_rows(parts, risk)):
        assert level([tuple(c[row:] for c in part) for part in parts], risk[row].item()) == pytest.approx(
            among_many, rel=1e-9
        )


def test_levels_at_several_risks_are_those_of_each():
    parts, risk = some_mixtures(7)
    both = levels_m(parts, [risk, 0.1 * risk])
    assert (both[0] == of_rows(parts, risk)).all()
    assert (both[1] == of_rows(parts, 0.1 * risk)).all()
    assert levels_m(in_floats(parts), [0.01, -1.0]) == [level(parts, 0.01), math.inf]


@pytest.mark.parametrize("across", [0.0, 1e-9])
@pytest.mark.parametrize("round_by", [0.0, 1e-7])
def test_nodes_that_say_the_same_need_not_be_asked(across, round_by):
    few = [(0.9, 0.0, 0.0, 1.0, 1.0), (0.1, 2.0, 0.0, 0.4, 0.2)]
    all_of_them = [(0.9, 0.0, 0.0, 1.0, 1.0 - round_by), (0.1, 2.0, across, 0.4, 0.2)]
    for risk in (0.05, 1e-3, 1e-7):
        assert levels_m(few, [risk]) == pytest.approx(levels_m(all_of_them, [risk]), rel=1e-6)


def test_a_mean_of_a_metre_across_is_like_one_of_a_little_more():
    result = [levels_m([(1.0, 0.5, across_m, 0.4, 0.01)], [1e-3])[0] for across_m in (1.0, 1.0 + 1e-9)]
    assert result[0] == pytest.approx(result[1], rel=1e-6)
    along_the_axis = levels_m([(1.0, math.hypot(0.5, 1.0), 0.0, 0.4, 0.01)], [1e-3])[0]
    assert result[0] < 0.95 * along_the_axis


def test_a_mean_of_a_metre_along_the_axis_is_like_one_of_a_little_more():
    exactly_a_metre, more = (
        levels_m([(1.0, along_m, 0.0, 0.4, 0.4)], [1e-3])[0] for along_m in (1.0, 1.0 + 1e-9)
    )
    assert exactly_a_metre == pytest.approx(more, rel=1e-6)


def test_what_has_no_error_takes_nothing_of_the_risk_beyond_where_it_is():
    wide = (0.01, 0.0, 0.0, 0.5, 0.5)
    exact = math.sqrt(-math.log(SPENT * 1e-7 / 0.01))
    for sure in ((0.99, 0.0, 0.0, 0.0, 0.0), (0.99, 0.1, 0.2, 0.0, 0.0)):
        assert levels_m([wide, sure], [1e-7])[0] == pytest.approx(exact, rel=5e-4)
        together = levels_m(
            [tuple(np.full(3, value) for value in part) for part in (wide, sure)], [1e-7 + np.zeros(3)]
        )
        assert together[0] == pytest.approx(exact, rel=5e-4)


@pytest.mark.parametrize("at_m", [0.3, 3.0, 300.0])
@pytest.mark.parametrize("sigma_m", [0.0, 1e-6])
def test_the_level_of_a_certain_offset_is_that_offset(at_m, sigma_m):
    """All of P falls within a micrometre, but for Newton's steps."""
    near, horizontal = (0.9, 0.0, 0.0, 1e-4, 1e-4), (0.1, at_m, 0.0, sigma_m**2, 0.0)
    assert levels_m([near, horizontal], [1e-3])[0] == pytest.approx(at_m, rel=2e-4)
    anywhere = (5e-4, 0.0, 0.0, 1e6, 1e6)  # half of the risk
    assert levels_m([near, horizontal, anywhere], [1e-3])[0] == pytest.approx(at_m, rel=2e-4)


@pytest.mark.parametrize(
    "tails",
    [
        alone([[math.nan, 0.0], [0.0, 1.0]]),
        alone([[1.0, math.inf], [math.inf, 1.0]]),
        alone([[math.inf, 0.0], [0.0, 1.0]]),
        alone([[1.0, 2.0], [2.0, 1.0]]),
        alone([[-1.0, 0.0], [0.0, -1.0]]),
        mixture((math.nan, 0.5), ((0, 0), (0, 0)), (1, 1)),
        mixture((0.5, 0.5), ((0, 0), (math.nan, 0)), (1, 1)),
        vertical(np.ones((1, 1)), np.zeros((1, 1)), np.array([[-1.0]])),
        vertical(np.ones((1, 1)), np.full((1, 1), math.inf), np.ones((1, 1))),
    ],
)
def test_what_is_no_distribution_has_no_level(tails):
    assert level(tails, 1e-3) == math.inf
    assert of_rows(tails, np.full(1, 1e-3)) == math.inf


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_part_of_which_anything_is_not_finite_has_no_level(place, value):
    part = [0.5, 0.1, 0.1, 0.04, 0.01]
    part[place] = value
    assert levels_m([(0.5, 0.0, 0.0, 0.04, 0.01), tuple(part)], [1e-3]) == [math.inf]
    many = [tuple(np.full(2, number) for number in one) for one in ((0.5, 0.0, 0.0, 0.04, 0.01), part)]
    assert (levels_m(many, [np.full(2, 1e-3)])[0] == math.inf).all()


def test_one_without_a_level_does_not_change_those_computed_with_it():
    variance = np.array([1.0, math.nan, 4.0, -1.0])
    result = levels_m([(np.ones(4), np.zeros(4), np.zeros(4), variance, variance)], [np.full(4, 1e-3)])[0]
    one = math.sqrt(-2.0 * math.log(SPENT * 1e-3))
    assert result == pytest.approx([one, math.inf, 2.0 * one, math.inf], rel=5e-4)


@pytest.mark.parametrize("risk", [0.0, -1e-9, math.nan])
def test_without_risk_to_spend_there_is_no_level(risk):
    assert level(alone(np.eye(2)), risk) == math.inf
    assert of_rows(alone(np.eye(2)), np.array([risk])) == math.inf


def test_a_risk_of_all_is_no_distance():
    assert level(alone(np.eye(2)), 1.0) == pytest.approx(math.sqrt(-2.0 * math.log(SPENT)), abs=0.01)
    assert level(alone(np.zeros((2, 2))), 1e-7) == pytest.approx(0.0, abs=1e-12)


@exactly
@given(st.floats(0.2, 5.0), st.floats(0.2, 5.0), st.floats(-0.95, 0.95), risks)
def test_the_scale_of_an_ellipse_alone_is_that_of_r(a, b, rho, risk):
    covariance = np.array([[a * a, rho * a * b], [rho * a * b, b * b]])
    tails = in_ellipses(np.ones((1, 1)), np.zeros((1, 1, 2)), covariance[None, None])
    assert level(tails, risk) == pytest.approx(math.sqrt(-2.0 * math.log(SPENT * risk)), rel=1e-4)


def test_draws_of_a_mixture_are_inside_its_ellipse_as_often_as_promised():
    rng = np.random.default_rng(8)
    n = 400_000
    first, second = np.array([[0.04, 0.03], [0.03, 0.09]]), np.array([[1.0, -0.2], [-0.2, 0.3]])
    wrong = rng.random(n) < 0.004
    e = np.where(
        wrong[:, None],
        rng.multivariate_normal([0.5, -0.3], second, n),
        rng.multivariate_normal([0.0, 0.0], first, n),
    )
    square = np.einsum("ni,ij,nj->n", e, np.linalg.inv(first), e)
    tails = in_ellipses(
        np.array([[0.996, 0.004]]), np.array([[[0.0, 0.0], [0.5, -0.3]]]), np.array([[first, second]])
    )
    for risk in (0.01, 0.001):
        outside = (square > level(tails, risk) ** 2).mean()
        assert outside <= risk + 4.0 * math.sqrt(risk / n)
        assert outside >= 0.8 * risk


@pytest.mark.parametrize(
    "covariance", [[[0.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]]]
)
def test_a_first_part_without_an_ellipse_has_no_scale(covariance):
    tails = in_ellipses(np.ones((1, 1)), np.zeros((1, 1, 2)), np.array(covariance)[None, None])
    assert level(tails, 0.01) == math.inf


@pytest.mark.parametrize("mean_m", [0.0, 0.3])
def test_a_smaller_variance_that_rounding_has_made_negative_is_none(mean_m):
    rounded, exact_m = (levels_m([(1.0, mean_m, 0.0, 0.5, s)], [1e-3])[0] for s in (-1e-10, 0.0))
    assert rounded == pytest.approx(exact_m, rel=1e-9)

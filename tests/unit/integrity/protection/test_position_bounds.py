"""Ellipses and levels of one mixture, and R's levels: against draws, and what must always hold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    IndexRules,
    LevelRules,
    MixtureComponent,
    bounds_of,
    is_beyond,
)
from camber.integrity.protection.reliability_index import ReliabilityIndex
from support.judging import START_NS

exactly = settings(derandomize=True, deadline=None)
RULES = LevelRules()
sigma = st.floats(0.01, 3.0)
SLACK = 1.0 + 5e-4


def part(horizontal_m2, up_m2=0.01, weight=1.0, **changes):
    return MixtureComponent(weight=weight, horizontal_m2=horizontal_m2, up_m2=up_m2, **changes)


def normal(s, up=0.05, rho=0.0, ratio=1.0):
    return ErrorMixture((part((s * s, rho * s * s * ratio, (s * ratio) ** 2), up * up),))


def with_wrong(w, s=0.055, offset=0.3, pose=0.1):
    wrong = part((pose * pose, 0.0, pose * pose), 0.05**2, w, mean_m=(offset, 0.0, 0.1))
    return ErrorMixture((normal(s).parts[0].weighed(1.0 - w), wrong), w * 1e-8)


def of(mixture, rules=RULES):
    return bounds_of([mixture], rules)[0]


def outside(bounds, errors, major, minor):
    c, s = math.cos(bounds.orientation_rad), math.sin(bounds.orientation_rad)
    along, across = errors @ np.array([c, s]), errors @ np.array([-s, c])
    return ((along / major) ** 2 + (across / minor) ** 2 > 1.0).mean()


@pytest.mark.parametrize(("s", "ratio", "rho"), [(0.05, 1.0, 0.0), (0.5, 0.2, 0.6), (2.0, 0.01, -0.5)])
def test_of_independent_draws_the_ellipses_hold_what_they_promise_and_little_more(s, ratio, rho):
    rng = np.random.default_rng(21)
    (right,) = normal(s, rho=rho, ratio=ratio).parts
    ee, en, nn = right.horizontal_m2
    errors = rng.multivariate_normal([0.0, 0.0], [[ee, en], [en, nn]], 400_000)
    result = of(ErrorMixture((right,)))
    assert 0.990 <= 1.0 - outside(result, errors, result.semi_major_99_m, result.semi_minor_99_m) <= 0.995
    assert 0.9990 <= 1.0 - outside(result, errors, result.semi_major_999_m, result.semi_minor_999_m) <= 0.9997


@pytest.mark.parametrize("w", [0.0, 0.002, 0.05])
def test_with_wrong_fixes_among_the_draws_they_still_hold(w):
    rng, n = np.random.default_rng(22), 400_000
    wrong = rng.random(n) < w
    errors = np.where(wrong[:, None], rng.normal((0.3, 0.0), 0.1, (n, 2)), rng.normal(0.0, 0.055, (n, 2)))
    result = of(with_wrong(w))
    for risk, major, minor in (
        (0.01, result.semi_major_99_m, result.semi_minor_99_m),
        (0.001, result.semi_major_999_m, result.semi_minor_999_m),
    ):
        assert outside(result, errors, major, minor) <= risk + 4.0 * math.sqrt(risk / n)


@pytest.mark.parametrize("pose", [0.05, 0.10])
def test_the_level_at_1e_7_is_below_a_metre_for_a_fix_with_a_matched_pose(pose):
    for w in (1e-5, 1e-3, 0.1):
        assert of(with_wrong(w, pose=pose)).horizontal_level_m < 1.0


@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.1])
def test_the_level_at_1e_7_is_less_than_eight_times_the_median_error(ratio):
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(200_000, 2)) * [0.3, 0.3 * ratio]
    level = of(normal(0.3, ratio=ratio)).horizontal_level_m
    assert level <= 8.1 * np.median(np.hypot(*errors.T))
    assert of(normal(0.3)).vertical_level_m <= 8.0 * 0.6745 * 0.05


@exactly
@given(sigma, sigma, sigma, st.floats(0.0, 0.5), st.floats(0.0, 2.0))
def test_more_uncertainty_never_shrinks_any_bound(s, pose, more, w, offset):
    for small, large in (
        (with_wrong(w, s, offset, pose), with_wrong(w, s, offset, math.hypot(pose, more))),
        (with_wrong(w, s, offset, pose), with_wrong(w, s, offset + more, pose)),
        (normal(s), normal(math.hypot(s, more))),
        (normal(s, up=pose), normal(s, up=pose + more)),
    ):
        one, other = of(small), of(large)
        for name in ("semi_major_99_m", "semi_major_999_m", "horizontal_level_m", "vertical_level_m"):
            assert getattr(other, name) * SLACK >= getattr(one, name)


@exactly
@given(sigma, st.floats(0.0, 0.5), st.floats(1e-9, 1e-2), st.floats(1.0, 100.0))
def test_less_risk_never_shrinks_a_level(s, w, risk, less):
    def at(value):
        return of(with_wrong(w, s), replace(RULES, integrity_risk=value))

    large, small = at(risk / less), at(risk)
    assert large.horizontal_level_m * SLACK >= small.horizontal_level_m
    assert large.vertical_level_m * SLACK >= small.vertical_level_m


def test_what_no_bound_covers_is_taken_from_the_risk():
    whole = of(normal(0.1), replace(RULES, integrity_risk=0.5e-7))
    part = of(replace(normal(0.1), lost=0.5e-7))
    assert part.horizontal_level_m == pytest.approx(whole.horizontal_level_m)
    spent = of(replace(normal(0.1), lost=1e-7))
    assert spent.horizontal_level_m == spent.vertical_level_m == math.inf
    assert spent.semi_major_99_m < 1.0


def test_a_height_that_is_not_known_has_no_level_and_takes_nothing_from_the_others():
    result = of(normal(0.1, up=math.inf))
    assert result.vertical_level_m == math.inf
    assert result.horizontal_level_m == of(normal(0.1)).horizontal_level_m


def test_a_position_that_is_sure_in_one_direction_has_bounds_all_the_same():
    result = of(ErrorMixture((part((0.04, 0.0, 0.0)),)))
    assert result.horizontal_level_m == pytest.approx(1.03 * 0.2 * 5.327, rel=1e-3)
    assert 0.0 < result.semi_minor_99_m < 1e-3


def test_several_positions_are_bounded_each_by_itself():
    alone = [of(normal(0.1)), of(with_wrong(0.01))]
    for one, other in zip(bounds_of([normal(0.1), with_wrong(0.01)], RULES), alone, strict=True):
        assert one.horizontal_level_m == pytest.approx(other.horizontal_level_m, rel=1e-3)
        assert one.semi_major_999_m == pytest.approx(other.semi_major_999_m, rel=1e-3)


def test_a_part_split_in_two_is_the_same_part():
    other = part((0.02, 0.0, 0.02), 1e-4, 0.1, mean_m=(0.5, 0.0, 0.0))
    all_of_it, half, rest = (normal(0.1).parts[0].weighed(weight) for weight in (0.9, 0.3, 0.6))
    whole, split = ErrorMixture((all_of_it, other)), ErrorMixture((half, other, rest))
    assert of(split).horizontal_level_m == pytest.approx(of(whole).horizontal_level_m, rel=1e-9)
    assert of(split).vertical_level_m == pytest.approx(of(whole).vertical_level_m, rel=1e-9)


def test_draws_of_biased_elongated_errors_exceed_the_level_as_often_as_the_risk():
    rng, n = np.random.default_rng(23), 400_000
    rules = replace(RULES, integrity_risk=0.01, horizontal_margin=1.0)
    for east_m, north_m in ((0.5, 0.2), (1.0, 1.0), (-0.4, 0.4)):
        errors = rng.multivariate_normal([east_m, north_m], [[0.25, 0.1], [0.1, 0.09]], n)
        biased = ErrorMixture((part((0.25, 0.1, 0.09), mean_m=(east_m, north_m, 0.0)),))
        share = (np.hypot(*errors.T) > of(biased, rules).horizontal_level_m).mean()
        assert 0.94 * 0.01 <= share <= 0.01 + 4.0 * math.sqrt(0.01 / n)


@pytest.mark.parametrize(
    "horizontal_m2", [(-1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (1.0, 2.0, 1.0), (math.nan, 0.0, 1.0)]
)
def test_what_is_no_covariance_has_no_bounds_and_is_none_of_a_position_that_is_right(horizontal_m2):
    result = of(ErrorMixture((part((0.01, 0.0, 0.01), weight=0.5), part(horizontal_m2, weight=0.5))))
    assert result.horizontal_level_m == result.semi_major_99_m == math.inf, "not beside others"
    with pytest.raises(ValueError, match="is not positive semidefinite"):
        of(ErrorMixture((part(horizontal_m2),)))


@exactly
@given(sigma, sigma, st.floats(0.0, 0.5), st.floats(0.0, 2.0), st.floats(0.5, 2.0))
def test_a_level_that_is_surely_larger_is_larger(s, pose, w, offset, factor):
    mixture = with_wrong(w, s, offset, pose)
    limit = factor * of(mixture).horizontal_level_m
    assert not (is_beyond(mixture, limit, RULES) and factor >= 1.0)


def test_a_level_far_beyond_is_seen_without_finding_it():
    assert is_beyond(normal(0.1), 0.3, RULES)
    assert is_beyond(with_wrong(0.01), 0.1, RULES)
    assert is_beyond(replace(normal(0.1), lost=1.0), 1e6, RULES)
    assert not is_beyond(normal(0.1), 0.6, RULES)
    assert not is_beyond(normal(0.1), math.inf, RULES)
    assert not is_beyond(ErrorMixture((part((0.0, 0.0, 0.0), 1.0),)), 0.0, RULES)


def turned(mixture, angle_rad):
    """The same errors, seen in axes turned the other way round."""
    turn = np.array([[math.cos(angle_rad), -math.sin(angle_rad)], [math.sin(angle_rad), math.cos(angle_rad)]])
    parts = []
    for one in mixture.parts:
        (ee, en, nn), (east_m, north_m, up_m) = one.horizontal_m2, one.mean_m
        (ee, en), (_, nn) = (turn @ np.array([[ee, en], [en, nn]]) @ turn.T).tolist()
        mean_m = (*(turn @ [east_m, north_m]).tolist(), up_m)
        parts.append(one._replace(mean_m=mean_m, horizontal_m2=(ee, en, nn)))
    return ErrorMixture(tuple(parts), mixture.lost)


@exactly
@given(st.floats(-3.0, 3.0), st.floats(0.0, 1.5), st.floats(-1.0, 1.0))
def test_no_direction_is_special(angle_rad, offset, slant):
    right = part((0.04, 0.0, 0.0025), weight=0.99)
    wrong = part((0.09, 0.02 * slant, 0.01), 0.04, 0.01, mean_m=(offset, 0.5 * offset, 0.2))
    mixture = ErrorMixture((right, wrong), 1e-9)
    one, other = of(mixture), of(turned(mixture, angle_rad))
    for name in ("semi_major_99_m", "semi_minor_99_m", "semi_major_999_m", "horizontal_level_m"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=2e-3)
    assert other.vertical_level_m == one.vertical_level_m
    # The main axis has turned along.
    assert math.sin(other.orientation_rad - one.orientation_rad - angle_rad) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("angle_rad", [0.5, -0.5, math.pi / 4, -math.pi / 4])
def test_a_level_far_beyond_is_seen_in_any_direction(angle_rad):
    narrow = ErrorMixture((part((0.25, 0.0, 1e-4)),))
    assert is_beyond(turned(narrow, angle_rad), 2.4, RULES)
    assert not is_beyond(turned(narrow, angle_rad), 3.0, RULES)


# --- the reliability index ---------------------------------------------------------------------------------------

A99 = math.sqrt(9.2103)


def at(k):
    return START_NS + round(k * 1e8)


BY_RISK = of(normal(1.0))


def by_index(index, source, k, known=True):
    return index.bounds(source, at(k), BY_RISK, known=known)


def test_r_s_levels_grow_by_a_sigma_each_tenth_of_a_second():
    index = ReliabilityIndex(IndexRules())
    rtk = by_index(index, "rtk", 0)
    assert rtk.horizontal_level_m == pytest.approx(A99 * 0.025, rel=1e-4)
    assert rtk.vertical_level_m == pytest.approx(2.5758 * 0.025, rel=1e-4)
    index.keep(at(0), rtk)
    doppler = by_index(index, "doppler", 10)
    assert doppler.horizontal_level_m == pytest.approx(A99 * (0.025 + 10 * 0.02), rel=1e-4)
    index.keep(at(10), doppler)
    sensors = by_index(index, "sensors", 11)
    assert sensors.horizontal_level_m == pytest.approx(A99 * (0.025 + 10 * 0.02 + 0.03), rel=1e-4)
    assert sensors.semi_major_99_m == BY_RISK.semi_major_99_m
    assert by_index(index, "sensors", 11, known=False).vertical_level_m == math.inf
    assert by_index(index, "sensors", 9).horizontal_level_m == doppler.horizontal_level_m


def test_before_any_fix_and_of_a_match_the_level_is_the_ellipse():
    index = ReliabilityIndex(IndexRules())
    for source in ("sensors", "scan_match"):
        assert by_index(index, source, 0).horizontal_level_m == BY_RISK.semi_major_99_m
    index.keep(at(0), by_index(index, "rtk", 0))
    assert by_index(index, "scan_match", 1).horizontal_level_m == BY_RISK.semi_major_99_m


def test_of_two_positions_of_one_time_the_levels_go_on_from_the_later():
    index = ReliabilityIndex(IndexRules())
    rtk = by_index(index, "rtk", 0)
    index.keep(at(0), BY_RISK)
    index.keep(at(0), rtk)
    assert by_index(index, "doppler", 0).horizontal_level_m == rtk.horizontal_level_m


def test_an_older_position_does_not_set_the_level_back_and_one_dated_ahead_is_forgotten():
    index = ReliabilityIndex(IndexRules())
    index.keep(at(10), by_index(index, "rtk", 10))
    index.keep(at(5), BY_RISK)
    near = by_index(index, "doppler", 11).horizontal_level_m
    assert near == pytest.approx(A99 * 0.045, rel=1e-4)
    index.forget_future(at(10))
    assert by_index(index, "doppler", 11).horizontal_level_m == near
    index.forget_future(at(9))
    assert by_index(index, "doppler", 11).horizontal_level_m == BY_RISK.semi_major_99_m


def test_that_a_level_is_larger_shows_in_any_part_also_after_one_that_is_sure():
    sure, wide = part((0.0, 0.0, 0.0), 0.0, 0.5), part((1.0, 0.0, 1.0), 0.0, 0.5)
    assert is_beyond(ErrorMixture((sure, wide)), 1.0, RULES)
    assert not is_beyond(ErrorMixture((sure, sure)), 1.0, RULES)

"""Where exactly a difference from the independent position becomes a fault, and where it ends."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.learning.independent_errors import IndependentErrors
from camber.integrity.learning.independent_offset import (
    _MOST_SAMPLES,
    IndependentOffsetRules,
    IndependentOffsets,
    _fault_of,
    _near,
    _renewed_m,
    _Sample,
    _shows,
    _statistics,
)
from support.residual_drives import START_NS, residual

RULES = IndependentOffsetRules()
ANY = replace(
    RULES, least_chi2=0.0, margin=0.0, least_s=0.0, least_far_s=0.0, least_drift_s=0.0, least_drift_m=0.0
)
"""Whatever shows is a fault where it is coherent."""
BY_FIT = replace(ANY, coherent=2.0)
"""Only what errors explain."""


def sample(number, east_north_m, covariance_m2=(0.09, 0.0, 0.09), fix_sigma_m=0.02, **changes):
    """One each two seconds, 50 m apart, each with evidence of its time."""
    fields = {
        "time_ns": START_NS + number * 2 * 10**9,
        "driven_m": 50.0 * number,
        "evidence_ns": START_NS + number * 2 * 10**9,
        "heading_rad": 0.0,
    }
    return _Sample(
        east_north_m=tuple(east_north_m),
        covariance_m2=covariance_m2,
        fix_sigma_m=fix_sigma_m,
        **fields | changes,
    )


def base_samples(count, east_north_m=(12.0, 0.0), **other):
    """A base that is off since the first; `other` is what stands elsewhere, by number."""
    elsewhere = {int(number[1:]): place for number, place in other.items()}
    return [sample(k, elsewhere.get(k, east_north_m)) for k in range(count)]


def led_away(count, rate_m_s=(0.3, 0.1), across_m=0.0):
    """Since the first; every other sample lies `across_m` north or south of the path."""
    return [
        sample(k, (2.0 * k * rate_m_s[0], 2.0 * k * rate_m_s[1] + (-1) ** k * across_m)) for k in range(count)
    ]


def times_s(samples):
    return np.array([(each.time_ns - samples[-1].time_ns) / 1e9 for each in samples])


def scaled(samples, factor):
    return [replace(each, east_north_m=tuple(factor * m for m in each.east_north_m)) for each in samples]


def headings(samples):
    return [each.heading_rad for each in samples]


def matrices(samples):
    return [np.array(((ee, en), (en, nn))) for ee, en, nn in (each.covariance_m2 for each in samples)]


# --- the statistic ----------------------------------------------------------------------------------------------


def random_samples(rng, count):
    """Differences and covariances of whatever size and direction."""
    result = []
    for k in range(count):
        root = rng.normal(0.0, 0.7, (2, 2))
        (ee, en), (_, nn) = (root @ root.T + 0.05 * np.eye(2)).tolist()
        driven_m = 120.0 * k
        has_evidence = k % 3 == 0
        result.append(
            sample(
                k,
                rng.normal(1.0, 1.5, 2),
                (ee, en, nn),
                float(rng.uniform(0.3, 1.5)),
                driven_m=driven_m,
                evidence_ns=k if has_evidence else None,
                heading_rad=float(rng.uniform(-4.0, 4.0)),
            )
        )
    return result


def by_least_squares(samples, rules):
    """T and size of each template by least squares in whitened numbers, and what is left, for each model."""
    n = len(samples)
    seen = np.array([each.east_north_m for each in samples]).ravel()
    renewed = [max(k for k in range(j + 1) if samples[k].evidence_ns is not None) for j in range(n)]
    driven_m = np.array([each.driven_m for each in samples])
    errors = IndependentErrors(
        covariance_m2=np.array(matrices(samples)),
        driven_m=driven_m,
        renewed_m=driven_m[renewed],
    )
    time_s = times_s(samples)
    constant = [np.where(np.arange(n) >= k, 1.0, 0.0) for k in range(n)]
    growing = [np.maximum(time_s - time_s[k], 0.0) for k in range(n - 1)]
    shapes = [np.kron(shape[:, None], np.eye(2)) for shape in (*constant, *growing)]
    turned = [np.array(((math.cos(h), -math.sin(h)), (math.sin(h), math.cos(h)))) for h in headings(samples)]
    shapes += [np.concatenate([s * turn for s, turn in zip(shape, turned, strict=True)]) for shape in growing]
    for model in errors.models():
        joint = model.reshape(2 * n, 2 * n) + np.kron(np.ones((n, n)), rules.common_sigma_m**2 * np.eye(2))
        joint += np.diag(np.repeat([each.fix_sigma_m**2 for each in samples], 2))
        whitening = np.linalg.inv(np.linalg.cholesky(joint))
        white = whitening @ seen
        rows = []
        for shape in shapes:
            design = whitening @ shape
            size, *_ = np.linalg.lstsq(design, white, rcond=None)
            left = float(np.sum((white - design @ size) ** 2))
            rows.append((float(white @ white) - left, *size, left))
        yield np.array(rows)


@pytest.mark.parametrize("seed", range(4))
def test_the_statistic_is_the_least_over_the_covariances_of_what_least_squares_gives(seed):
    rules = replace(RULES, least_chi2=0.0, common_sigma_m=0.6)
    samples = random_samples(np.random.default_rng(seed), 7)
    statistic, size, unexplained = _statistics(samples, rules)
    of_models = np.array(list(by_least_squares(samples, rules)))
    least = np.argmin(of_models[:, :, 0], axis=0)
    assert len(set(least.tolist())) > 1, "no model has the least of all templates"
    expected = of_models[least, np.arange(of_models.shape[1])]
    assert statistic == pytest.approx(expected[:, 0], rel=1e-6)
    assert size == pytest.approx(expected[:, 1:3], rel=1e-6, abs=1e-8)
    assert unexplained == pytest.approx(expected[:, 3], rel=1e-6)


def test_a_covariance_by_which_there_is_no_fault_ends_the_search_and_one_at_the_bound_does_not():
    samples = random_samples(np.random.default_rng(1), 7)
    first, _, _ = _statistics(samples, replace(RULES, least_chi2=1e9))
    all_of_them, _, _ = _statistics(samples, replace(RULES, least_chi2=0.0))
    at_bound, _, _ = _statistics(samples, replace(RULES, least_chi2=float(first.max())))
    assert first.sum() > all_of_them.sum()
    assert np.array_equal(at_bound, all_of_them)


def test_the_distance_at_the_evidence_stands_still_where_there_is_none():
    evidence = [None, None, 5, 5, None, None, 7, 8]
    rows = [sample(k, (0.0, 0.0), driven_m=100.0 + k, evidence_ns=at) for k, at in enumerate(evidence)]
    assert _renewed_m(rows).tolist() == [0.0, 0.0, 102.0, 102.0, 102.0, 102.0, 106.0, 107.0]


# --- which samples count ----------------------------------------------------------------------------------------


def test_a_sample_is_near_a_path_within_half_of_it_or_within_two_sigma():
    rng = np.random.default_rng(3)
    samples = random_samples(rng, 400)
    path_m = rng.normal(0.0, 3.0, (400, 2))
    path_m[-2:] = (4.0, 3.0), (1.5, 2.0)
    apart_m = np.array([each.east_north_m for each in samples]) - path_m
    distances = [float(d @ np.linalg.solve(c, d)) for d, c in zip(apart_m, matrices(samples), strict=True)]
    within_m = [max(0.5 * math.hypot(*at), 0.25 * 2.5) for at in path_m]
    expected = [
        math.hypot(*d) <= w or chi2 <= 4.0 for d, w, chi2 in zip(apart_m, within_m, distances, strict=True)
    ]
    assert _near(samples, path_m).tolist() == expected


def test_what_lies_on_one_of_the_bounds_is_near():
    exact = [sample(0, (2.0, 0.0), (1e-4, 0.0, 1e-4)), sample(1, (0.0, 2.0), (1.0, 0.0, 1.0))]
    assert _near(exact, np.array([(4.0, 0.0), (0.0, 0.0)])).tolist() == [True, True]


def test_the_newest_difference_shows_where_it_is_beyond_the_errors_of_all():
    rules = replace(RULES, common_sigma_m=0.7)
    for each in random_samples(np.random.default_rng(5), 400):
        (covariance_m2,) = matrices([each])
        covariance_m2 = covariance_m2 + (each.fix_sigma_m**2 + 0.7**2) * np.eye(2)
        d = np.array(each.east_north_m)
        assert _shows(each, rules) == (d @ np.linalg.solve(covariance_m2, d) > 2.0)
    at_bound = sample(0, (2.0, 0.0), (1.0, 0.0, 1.0), 1.0)
    assert not _shows(at_bound, replace(RULES, common_sigma_m=0.0))
    assert _shows(replace(at_bound, east_north_m=(2.001, 0.0)), replace(RULES, common_sigma_m=0.0))


# --- when it is a fault -----------------------------------------------------------------------------------------


def test_a_fault_takes_three_samples():
    rules = replace(RULES, least_far_s=2.0)
    assert _fault_of(base_samples(2), rules) is None
    named = _fault_of(base_samples(3), rules)
    assert (named.kind, named.onset_ns) == ("base", START_NS)
    assert named.east_north_m == pytest.approx((12.0, 0.0))
    assert named.growth_m_s == (0.0, 0.0)


def test_a_far_vector_counts_from_its_least_time_on_and_a_near_one_later():
    samples = base_samples(5)
    assert _fault_of(samples, replace(RULES, least_far_s=8.0)) is not None
    assert _fault_of(samples, replace(RULES, least_far_s=8.1)) is None
    size_m = float(np.hypot(*_fault_of(samples, RULES).east_north_m))
    for far_m, named in ((math.nextafter(size_m, 0.0), True), (size_m, False)):
        assert (_fault_of(samples, replace(RULES, far_m=far_m)) is not None) == named
    near = base_samples(30, (3.0, 0.0))
    assert _fault_of(near, replace(RULES, least_s=58.0)).kind == "base"
    assert _fault_of(near, replace(RULES, least_s=58.1)) is None


def test_a_growing_one_counts_from_its_least_time_and_its_least_length_on():
    samples = led_away(8)
    named = _fault_of(samples, ANY)
    assert (named.kind, named.onset_ns) == ("drift", START_NS)
    assert named.growth_m_s == pytest.approx((0.3, 0.1))
    assert named.east_north_m == pytest.approx((4.2, 1.4))
    assert _fault_of(samples, replace(ANY, least_drift_s=14.0)) is not None
    assert _fault_of(samples, replace(ANY, least_drift_s=14.1)) is None
    size_m = float(np.hypot(*named.east_north_m))
    assert _fault_of(samples, replace(ANY, least_drift_m=size_m)) is not None
    assert _fault_of(samples, replace(ANY, least_drift_m=math.nextafter(size_m, 99.0))) is None


def test_it_needs_the_least_statistic_and_a_distinction_of_the_two_kinds():
    samples = led_away(8)
    statistic, _, _ = _statistics(samples, ANY)
    most, apart = float(statistic.max()), float(statistic[8:].max() - statistic[:8].max())
    assert most > apart > 0.0
    for rules in (replace(ANY, least_chi2=most), replace(ANY, margin=apart)):
        assert _fault_of(samples, rules) is not None
    above = math.nextafter
    for rules in (replace(ANY, least_chi2=above(most, 1e9)), replace(ANY, margin=above(apart, 1e9))):
        assert _fault_of(samples, rules) is None


def test_the_likelier_kind_is_named_however_little_likelier():
    """Fixes of 2.6 m that are led away by 1 m in each sample."""
    samples = [sample(k, (float(k), 0.0), (0.01, 0.0, 0.01), 2.6) for k in range(5)]
    statistic, _, _ = _statistics(samples, ANY)
    assert 0.0 < float(statistic[5:].max() - statistic[:5].max()) < 1.0
    assert _fault_of(samples, ANY).kind == "drift"


@pytest.mark.parametrize("count", [9, 16, 25])
def test_errors_explain_the_rest_of_a_drift_up_to_two_sigma_of_chi2(count):
    """χ² of two numbers from each sample: the mean 2n, and σ the root of twice that."""
    most = 2.0 * count + 2.0 * math.sqrt(2.0 * 2.0 * count)
    samples = led_away(count, across_m=0.5)
    statistic, _, unexplained = _statistics(samples, BY_FIT)
    assert int(np.argmax(statistic)) == count, "since the first"
    factor = math.sqrt(most / float(unexplained[count]))
    assert _fault_of(scaled(samples, factor * 0.999), BY_FIT).kind == "drift"
    assert _fault_of(scaled(samples, factor * 1.001), BY_FIT) is None


def test_errors_explain_no_vector_that_is_not_coherent():
    assert _fault_of(base_samples(9), BY_FIT) is None
    assert _fault_of(base_samples(9), ANY).kind == "base"


def test_three_samples_of_four_must_lie_near_what_is_named():
    three_of_four = base_samples(16, n2=(5.0, 0.0), n5=(5.0, 0.0), n8=(5.0, 0.0), n11=(5.0, 0.0))
    named = _fault_of(three_of_four, RULES)
    assert (named.kind, named.onset_ns) == ("base", START_NS)
    fewer = [*three_of_four[:13], replace(three_of_four[13], east_north_m=(5.0, 0.0)), *three_of_four[14:]]
    assert _fault_of(fewer, RULES) is None


def test_the_newest_sample_must_lie_near_it_and_only_that():
    assert _fault_of(base_samples(20, n19=(4.0, 0.0)), RULES) is None
    for before in ((4.0, 0.0), (0.0, 0.0)):
        coarse = [replace(each, fix_sigma_m=1.5) for each in base_samples(20, n18=before)]
        assert _fault_of(coarse, RULES).kind == "base"


# --- how samples are made ---------------------------------------------------------------------------------------


def test_a_sample_ends_with_the_first_fix_two_seconds_after_its_first():
    offsets = IndependentOffsets(RULES)
    known = (0.0, 0.0, 0.1, 0.0, 0.1, 0.02)
    ended = [offsets.update(residual(epoch, independent=known)) for epoch in (0, 0, 5, 19, 20, 39, 40)]
    assert ended == [False, False, False, False, True, False, True]


def test_of_a_full_memory_the_older_half_keeps_every_other_sample():
    offsets = IndependentOffsets(RULES)
    half = _MOST_SAMPLES // 2
    for number in range(_MOST_SAMPLES + 2):
        offsets.update(residual(20 * number, independent=(0.0, 0.0, 0.1, 0.0, 0.1, 0.02)))
        if number == _MOST_SAMPLES:
            assert len(offsets._samples) == _MOST_SAMPLES, "each, up to the last that fits"
    kept = [(each.time_ns - START_NS) // (2 * 10**9) for each in offsets._samples]
    assert kept == [*range(0, half, 2), *range(half, _MOST_SAMPLES + 1)]


# --- how it goes on and ends ------------------------------------------------------------------------------------


def offsets_of(samples, rules=RULES):
    offsets = IndependentOffsets(rules)
    for each in samples:
        offsets._add(each)
    return offsets


def test_a_base_moves_with_what_is_seen_and_becomes_a_drift_where_it_grows():
    moved = [*base_samples(10), *(sample(k, (13.0, 0.0)) for k in range(10, 60))]
    assert offsets_of(moved[:10]).fault.east_north_m[0] == pytest.approx(12.0)
    assert offsets_of(moved).fault.east_north_m[0] == pytest.approx(13.0, abs=0.5)
    grows = [*base_samples(10), *(sample(k, (12.0 + 4.0 * (k - 9), 0.0)) for k in range(10, 40))]
    assert offsets_of(grows[:10]).fault.kind == "base"
    assert offsets_of(grows).fault.kind == "drift"


def test_a_drift_that_stands_for_so_long_that_its_onset_is_forgotten_does_not_become_a_base():
    drift = offsets_of(led_away(20)).fault
    standing = base_samples(12, drift.east_north_m)
    assert offsets_of(standing).fault.kind == "base"
    offsets = IndependentOffsets(RULES)
    offsets.fault = drift
    for each in standing:
        offsets._add(each)
    assert offsets.fault == drift


OVER = (
    ((6.0, 8.0), (3.0, 0.0, 3.0), 0.02),
    ((6.0, 8.0), (3.0, 1.5, 5.0), 1.5),
    ((6.0, 8.0), (5.0, -2.0, 2.0), 1.5),
    ((-9.0, 3.0), (1.0, 0.6, 6.0), 0.5),
    ((3.0, -9.0), (2.0, 1.2, 1.0), 2.0),
)


@pytest.mark.parametrize(("vector_m", "covariance_m2", "fix_sigma_m"), OVER)
@pytest.mark.parametrize("over", [True, False])
def test_a_base_is_over_where_nothing_is_likelier_than_it_by_two_sigma(
    vector_m, covariance_m2, fix_sigma_m, over
):
    """χ² along the vector: from the vector, less that from nothing, is four."""
    begun = offsets_of(base_samples(20, vector_m))
    u = np.array(begun.fault.east_north_m)
    size_m = float(np.hypot(*u))
    u /= size_m
    variance_m2 = float(u @ matrices([sample(0, (0.0, 0.0), covariance_m2)])[0] @ u) + fix_sigma_m**2
    left_m = 0.5 * (size_m - 4.0 * variance_m2 / size_m) + (-1e-4 if over else 1e-4)
    across_m = 0.7 * np.array((-u[1], u[0]))
    for k in range(20, 23):
        assert begun.fault is not None
        begun._add(sample(k, (left_m * u + across_m).tolist(), covariance_m2, fix_sigma_m))
    assert (begun.fault is None) == over


def test_three_samples_in_a_row_end_it_and_two_do_not():
    begun = offsets_of(base_samples(20))
    seen, ended = [0.0, 0.0, 12.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.0], []
    for k, east_m in enumerate(seen, start=20):
        begun._add(sample(k, (east_m, 0.0)))
        ended.append(begun.fault is None)
    assert ended == [False] * 8 + [True]
    assert [each.time_ns for each in begun._samples] == [sample(k, (0.0, 0.0)).time_ns for k in (26, 27, 28)]


def test_a_base_ends_where_fixes_are_off_as_far_elsewhere_and_a_drift_does_not():
    for samples, over in ((base_samples(20), True), (led_away(20, (0.3, 0.0)), False)):
        begun = offsets_of(samples)
        size_m = math.hypot(*begun.fault.east_north_m)
        for k in range(20, 23):
            begun._add(sample(k, (0.0, size_m)))
        assert (begun.fault is None) == over

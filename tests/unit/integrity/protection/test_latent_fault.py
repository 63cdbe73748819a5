"""A wrong fix that may have passed: few wide ones are kept beside many narrow ones, and what is kept is never less."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.protection.latent_fault import (
    LatentFaultHypothesis,
    LatentFaultPart,
    MatchCorroboration,
    is_same_draw,
)
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    LevelRules,
    MixtureComponent,
    bounds_of,
)
from support.judging import at, fix, pose

LEVELS = LevelRules()
RULES = LEVELS.wrong_fix
NOTHING = LatentFaultHypothesis(time_ns=at(0), parts=())
exactly = settings(derandomize=True, deadline=None)


def off(sigma_m, weight=1.0):
    return MixtureComponent(weight=weight, horizontal_m2=(sigma_m**2, 0.0, sigma_m**2), up_m2=0.01)


def level_m(latent_fault):
    right = MixtureComponent(weight=1.0, horizontal_m2=(0.0025, 0.0, 0.0025), up_m2=0.01)
    mixture = ErrorMixture((right, *latent_fault.components(1.0)))
    return bounds_of([mixture], LEVELS)[0].horizontal_level_m


def test_narrow_faults_do_not_hide_a_wide_one_however_many_they_are():
    """Of a start with a pose of 1 m, a minute ago, 1e-5 is left; since then fixes under a pose of 5 cm."""
    latent_fault = NOTHING.after(at(10), 2e-2, [off(1.0)], RULES)
    wide = latent_fault.odds
    for k in range(11, 310):
        latent_fault = latent_fault.after(at(k), 3e-4, [off(0.05)], RULES)
    left = wide * math.exp(-(at(309) - at(10)) / 1e9 / RULES.episode_s)
    assert 1e-7 < left < 1e-4
    needed_m = math.sqrt(-2.0 * math.log(LEVELS.integrity_risk / left))
    assert level_m(latent_fault) >= needed_m
    mean_m2 = sum(part.odds * part.horizontal_m2 for part in latent_fault.parts) / latent_fault.odds
    hidden = ErrorMixture((off(0.05), off(math.sqrt(mean_m2), latent_fault.odds)))
    assert bounds_of([hidden], LEVELS)[0].horizontal_level_m < needed_m, "one variance for all is too small"


@exactly
@given(st.lists(st.tuples(st.floats(1e-9, 0.5), st.floats(0.02, 20.0)), min_size=1, max_size=12))
def test_no_tail_of_the_classes_is_smaller_than_that_of_the_faults_themselves(faults):
    latent_fault, true, time_ns = NOTHING, [], 0
    for k, (odds, sigma_m) in enumerate(faults):
        time_ns, share = at(20 * k + 20), math.exp(-(at(20) - at(0)) / 1e9 / RULES.episode_s)
        latent_fault = latent_fault.after(time_ns, odds, [off(sigma_m)], RULES)
        true = [(share * odds, sigma) for odds, sigma in true] + [((1.0 - share) * odds, sigma_m)]

    def tail(parts, beyond_m):
        return sum(odds * math.exp(-0.5 * beyond_m**2 / m2) for odds, m2 in parts)

    kept = [(part.odds, part.horizontal_m2) for part in latent_fault.parts]
    for beyond_m in np.geomspace(0.05, 50.0, 20).tolist():
        assert (
            tail(kept, beyond_m) >= tail([(odds, s * s) for odds, s in true], beyond_m) * (1 - 1e-9) - 1e-13
        )
    assert latent_fault.odds == pytest.approx(sum(odds for odds, _ in true))


def test_the_classes_of_a_minute_are_few():
    rng, latent_fault = np.random.default_rng(1), NOTHING
    for k in range(1, 600):
        latent_fault = latent_fault.after(at(k), 1e-3, [off(s) for s in rng.uniform(0.02, 3.0, 2)], RULES)
    assert len(latent_fault.parts) <= 4 * 13
    assert len(latent_fault.components(1.0, 1e-4)) < len(latent_fault.parts)


def test_a_match_refutes_what_is_wide_compared_with_it_and_says_nothing_of_the_rest():
    latent_fault = NOTHING.after(at(10), 0.5, [off(4.0, 0.5), off(0.25, 0.5)], RULES)
    places = MatchCorroboration(LEVELS)
    wide, narrow = latent_fault.parts
    for k in (0, 40, 41):
        the_pose = pose(k, mode="scan_match", match_time_ns=at(k), sigma_m=0.2)
        latent_fault = places.update(the_pose, latent_fault)
    after_wide, after_narrow = latent_fault.parts
    assert after_wide.odds == pytest.approx(LEVELS.false_match_prior * wide.odds)
    assert after_narrow.odds == narrow.odds


def test_at_first_fixes_that_are_not_known_may_be_near_or_far():
    far, near = LatentFaultHypothesis.initial(RULES).parts
    assert far.horizontal_m2 == pytest.approx(100.0, rel=0.2)
    assert near.horizontal_m2 == 1.0
    assert far.odds / near.odds == pytest.approx(0.3 / 0.7)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_fault_is_as_wide_as_its_mean_and_its_covariance_together_along_the_worse_axis(axis):
    mean_m, m2 = [0.0, 0.0, 0.5], [0.1, 0.1]
    mean_m[axis], m2[axis] = 2.0, 4.0
    wrong = MixtureComponent(weight=1.0, mean_m=tuple(mean_m), horizontal_m2=(m2[0], 0.0, m2[1]), up_m2=0.75)
    (part,) = NOTHING.after(at(10), 0.1, [wrong], RULES).parts
    assert part.horizontal_m2 == 8.0
    assert part.up_m2 == 1.0


def test_what_is_of_one_class_is_one_part_with_the_mean_height():
    """Odds of 0.03 and 0.01, both between 2^(-2/4) and 2^(-1/4); what has become impossible is left out."""
    parts = (
        LatentFaultPart(odds=0.0, horizontal_m2=9.0, up_m2=1.0),
        LatentFaultPart(odds=0.03, horizontal_m2=0.75, up_m2=1.0, marked_odds=0.02),
        LatentFaultPart(odds=0.01, horizontal_m2=0.8, up_m2=5.0, marked_odds=0.005),
    )
    narrow = LatentFaultPart(odds=0.07, horizontal_m2=0.25, up_m2=2.0, marked_odds=0.03)
    part, other = (
        LatentFaultHypothesis(time_ns=at(0), parts=(*parts, narrow)).after(at(0), 0.0, [], RULES).parts
    )
    assert part == pytest.approx((0.04, 2.0**-0.25, 2.0, 0.025))
    assert other == pytest.approx(narrow)


def test_at_first_heights_are_those_of_wrong_fixes_and_all_of_it_is_latent():
    first = LatentFaultHypothesis.initial(RULES)
    mean_m2 = sum(share * up_m2 for share, (_, _, up_m2) in RULES.parts)
    assert first.odds == pytest.approx(RULES.prior / (1.0 - RULES.prior))
    assert sum(part.odds * part.up_m2 for part in first.parts) / first.odds == pytest.approx(mean_m2)
    components = first.components(1.0)
    assert len(components) == len(first.parts)
    assert all(component.is_latent is True for component in components)


def test_parts_of_the_least_odds_or_less_are_left_out():
    latent_fault = NOTHING.after(at(100), 0.5, [off(1.0)], RULES)
    assert latent_fault.components(1.0, latent_fault.odds) == ()
    assert len(latent_fault.components(1.0, 0.999 * latent_fault.odds)) == 1
    assert NOTHING.after(at(0), 1.0, [], RULES).parts == ()


def test_a_match_takes_what_was_marked_once_and_from_its_bound_on():
    latent_fault = NOTHING.after(at(1000), 0.5, [off(2.0)], RULES).marked()
    left = LEVELS.false_match_prior * latent_fault.odds
    once = latent_fault.corroborated(4.0, LEVELS)
    assert once.odds == pytest.approx(left)
    assert once.corroborated(4.0, LEVELS).odds == pytest.approx(left)
    assert latent_fault.corroborated(math.nextafter(4.0, 5.0), LEVELS) == latent_fault


def test_what_was_marked_fades_as_all_of_it_does():
    marked = NOTHING.after(at(1000), 0.5, [off(2.0)], RULES).marked()
    faded = marked.after(at(1050), 0.0, [], RULES)
    assert faded.odds == pytest.approx(marked.odds * math.exp(-10.0 / RULES.episode_s))
    assert faded.corroborated(1.0, LEVELS).odds == pytest.approx(LEVELS.false_match_prior * faded.odds)


@pytest.mark.parametrize(("sigma_m", "odds"), [(0.5, LEVELS.false_match_prior), (0.51, 1.0)])
def test_a_match_counts_where_four_of_its_sigma_are_within_the_fault(sigma_m, odds):
    latent_fault = NOTHING.after(at(1000), 0.5, [off(2.0)], RULES)
    places = MatchCorroboration(LEVELS)
    before = latent_fault.odds
    for k in (1000, 1020, 1040):
        there = pose(k, mode="scan_match", sigma_m=sigma_m, match_time_ns=at(k))
        latent_fault = places.update(there, latent_fault)
    assert latent_fault.odds == pytest.approx(odds * before)


def carried_fix(epoch, since, **changes):
    fields = {
        "ambiguity_mode": "carried",
        "ambiguity_continuity": "continuous",
        "continuous_since_ns": at(since),
    }
    return fix(epoch, **fields | changes)


def test_only_carried_integers_that_reach_back_to_a_fix_are_the_same_draw():
    assert is_same_draw(carried_fix(9, 3), at(8))
    assert is_same_draw(carried_fix(9, 3), at(3))
    assert not is_same_draw(carried_fix(9, 3), at(2))
    assert not is_same_draw(carried_fix(9, 3), None)
    for changes in (
        {"ambiguity_mode": "single_epoch"},
        {"ambiguity_mode": "unknown"},
        {"ambiguity_continuity": "broken"},
        {"ambiguity_continuity": "no_evidence"},
        {"continuous_since_ns": None},
    ):
        assert not is_same_draw(carried_fix(9, 3, **changes), at(8))


@exactly
@given(st.floats(1e-9, 0.5), st.floats(1e-9, 0.5), st.integers(1, 10_000))
def test_the_same_draw_neither_fades_nor_counts_again(first, later, epochs):
    begun = NOTHING.after(at(1), first, [off(1.0)], RULES)
    after = begun.after(at(1 + epochs), later, [off(1.0)], RULES, same_draw=True)
    assert after.odds == pytest.approx(begun.odds)
    assert after.time_ns == at(1 + epochs)
    # A new draw would have let the first fade, and counted the second.
    faded = math.exp(-(at(1 + epochs) - at(1)) / 1e9 / RULES.episode_s)
    other = begun.after(at(1 + epochs), later, [off(1.0)], RULES)
    assert other.odds == pytest.approx(faded * begun.odds + (1.0 - faded) * later, rel=1e-9)

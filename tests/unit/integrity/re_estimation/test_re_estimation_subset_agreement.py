"""Estimates that agree: which place they name, and which of them is judged; no height of road or antenna is known."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.re_estimation import subset_agreement as agreement
from camber.integrity.re_estimation.subset_agreement import AgreementRules, agreement_of
from support.judging import candidate

RULES = AgreementRules()


def trio(east_m=0.0, up_m=0.0, **changes):
    """Three estimates of one place, some centimetres apart."""
    return [
        candidate(east_m=east_m + 0.02 * k, up_m=up_m, excluded=(f"G{k + 1:02d}",), **changes)
        for k in range(3)
    ]


def test_without_estimates_there_is_no_agreement():
    result = agreement_of([], RULES)
    assert result.candidate is None
    assert result.why == "no other estimate passes"


def test_three_that_name_one_place_agree_on_the_one_with_most_ambiguities():
    best = candidate(east_m=0.05, ambiguities=14, success_rate=0.7, excluded=("E05",))
    result = agreement_of([*trio(success_rate=0.9), best], RULES)
    assert result.candidate is best
    assert result.subsets == 4


def test_of_as_many_ambiguities_the_surer_one_is_judged():
    surer = candidate(east_m=0.05, success_rate=0.96)
    assert agreement_of([*trio(success_rate=0.9), surer], RULES).candidate is surer


@pytest.mark.parametrize(
    ("subsets", "enough", "too_little"), [(1, 0.95, 0.94), (2, 0.7, 0.69), (3, 0.5, 0.49), (5, 0.5, 0.49)]
)
def test_the_fewer_agree_the_surer_the_surest_has_to_be(subsets, enough, too_little):
    def of(success_rate):
        low = [candidate(east_m=0.01 * k, success_rate=0.1) for k in range(subsets - 1)]
        return agreement_of([candidate(east_m=-0.01, success_rate=success_rate), *low], RULES)

    assert of(enough).candidate is not None
    assert of(too_little).candidate is None
    assert f"{too_little:.3f}" in of(too_little).why


def test_the_very_same_position_counts_once():
    same = [candidate(success_rate=0.9, excluded=(f"G{k:02d}",)) for k in range(1, 6)]
    result = agreement_of(same, RULES)
    assert (result.candidate, result.subsets) == (None, 1)


def test_places_apart_are_not_one():
    result = agreement_of([candidate(success_rate=0.9), candidate(up_m=0.11, success_rate=0.9)], RULES)
    assert result.candidate is None
    assert (result.subsets, result.disputed) == (1, True)
    assert result.why == "1 estimates name one place, 1 another"


def test_what_is_linked_by_others_is_one_place():
    chain = [candidate(east_m=0.09 * k, success_rate=0.6) for k in (0, 3, 1, 2)]
    assert agreement_of(chain, RULES).subsets == 4


@pytest.mark.parametrize(("rivals", "named", "agrees"), [(1, 3, True), (2, 3, False), (1, 2, True)])
def test_a_place_must_be_named_twice_as_often_as_any_other(rivals, named, agrees):
    others = [candidate(east_m=3.0 + 0.01 * k) for k in range(rivals)]
    result = agreement_of([*others, *trio()[:named]], RULES)
    assert (result.candidate is not None) == agrees
    assert result.disputed == (not agrees)


def test_many_places_of_one_each_do_not_add_up_against_it():
    others = [candidate(north_m=float(k)) for k in range(1, 6)]
    assert agreement_of([*others, *trio()], RULES).candidate is not None


@pytest.mark.parametrize(("ambiguities", "agrees"), [(6, True), (5, False)])
def test_few_ambiguities_make_no_estimate(ambiguities, agrees):
    result = agreement_of(trio(ambiguities=ambiguities), RULES)
    assert (result.candidate is not None, result.subsets) == (agrees, 3)
    assert ("5 ambiguities" in result.why) == (not agrees)


def test_the_rules_can_ask_for_more():
    four = replace(RULES, success=(1.1, 1.1, 1.1, 0.5))
    assert agreement_of(trio(), four).candidate is None
    assert agreement_of([*trio(), candidate(east_m=0.06)], four).candidate is not None


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 0.03, 0.06, 2.0, 2.04, 5.0]), st.floats(0.3, 1.0), st.integers(4, 12)
        ),
        min_size=1,
        max_size=12,
    ),
    st.randoms(use_true_random=False),
    st.floats(-20.0, 20.0),
)
def test_neither_the_order_nor_a_height_common_to_all_matters(drawn, random, up_m):
    """What is chosen is the same place, wherever that is: no height can have chosen it."""
    first = [candidate(east_m=e, success_rate=s, ambiguities=a) for e, s, a in drawn]
    turned = list(range(len(drawn)))
    random.shuffle(turned)
    moved = [
        candidate(east_m=drawn[k][0], up_m=up_m, success_rate=drawn[k][1], ambiguities=drawn[k][2])
        for k in turned
    ]
    one, other = agreement_of(first, RULES), agreement_of(moved, RULES)
    assert one.subsets == other.subsets
    assert (one.candidate is None) == (other.candidate is None)
    if one.candidate is not None and other.candidate is not None:
        np.testing.assert_allclose(one.candidate.ambiguities, other.candidate.ambiguities)
        assert one.candidate.success_rate == other.candidate.success_rate


def test_nothing_of_a_road_a_map_or_an_antenna_comes_in():
    source = inspect.getsource(agreement).split('"""', 2)[2]
    assert not {"road", "antenna", "pose"} & set(source.replace("_", " ").split())
    assert list(inspect.signature(agreement_of).parameters) == ["candidates", "rules"]

"""What was learnt survives a restart; a damaged file never moves the height."""

import json

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from camber.integrity.learning.height_correction import Correction, CorrectionState, Learning, LearningRules
from camber.integrity.learning.offset_causes import RoadChange
from camber.integrity.learning.saved_state import from_text, to_text
from support.residual_drives import KEY, START_NS, residual

RULES = LearningRules()


def learning(correction_m=0.1, samples=7):
    part = CorrectionState(
        antenna=KEY.antenna,
        base=KEY.base,
        map_version=KEY.map_version,
        correction=Correction(correction_m=correction_m, sigma_m=0.02, samples=samples),
    )
    return Learning(
        RULES, [part], [RoadChange(surface_id=9, map_version=3, offset_m=-0.2, onset_ns=START_NS)]
    )


@settings(derandomize=True)
@given(st.floats(-0.3, 0.3), st.integers(0, 10**9))
@example(RULES.cap_m, 7)
@example(-RULES.cap_m, 7)
def test_it_survives_a_restart(correction_m, samples):
    kept = learning(correction_m, samples)
    again = from_text(to_text(kept), RULES)
    assert again.correction(KEY) == kept.correction(KEY)
    assert again.causes.roads == kept.causes.roads
    assert to_text(again) == to_text(kept)


def test_after_a_restart_it_learns_on_from_there_and_is_less_sure():
    again = from_text(to_text(learning()), RULES)
    (part,) = again.parts
    assert (part.prior_m, part.prior_sigma_m) == (0.1, RULES.release_sigma_m)
    for epoch in range(600):
        again.update(residual(epoch, up_m=0.06))
    assert again.correction(KEY).correction_m == pytest.approx(0.06, abs=0.015)
    assert again.diagnosis(9).cause == "road"


def test_nothing_learnt_is_kept_as_nothing():
    assert from_text(to_text(Learning(RULES)), RULES).parts == ()


def test_what_is_less_sure_than_can_be_kept_is_kept_as_a_metre():
    vague = CorrectionState(
        antenna=KEY.antenna,
        base=KEY.base,
        map_version=KEY.map_version,
        correction=Correction(correction_m=0.1, sigma_m=1.7, samples=7),
    )
    assert from_text(to_text(Learning(RULES, [vague])), RULES).correction(KEY) == Correction(
        correction_m=0.1, sigma_m=1.0, samples=7
    )


def test_of_more_roads_than_can_be_kept_the_newest_are():
    roads = [
        RoadChange(surface_id=number, map_version=3, offset_m=0.2, onset_ns=START_NS + number)
        for number in range(4097)
    ]
    assert [*from_text(to_text(Learning(RULES, (), roads)), RULES).causes.roads] == [*range(1, 4097)]


ROAD = json.loads(to_text(learning()))["roads"][0]


def changed(**changes):
    table = json.loads(to_text(learning()))
    table["parts"][0] |= changes
    return json.dumps(table)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{",
        to_text(learning())[:-5],
        json.dumps({"correction_m": 0.1, "samples": 1}),
        json.dumps(json.loads(to_text(learning())) | {"roads": [ROAD | {"offset_m": 10.1}]}),
        json.dumps(json.loads(to_text(learning())) | {"more": 1}),
        changed(more=1),
        changed(correction_m=0.31),
        changed(correction_m=-0.31),
        changed(correction_m=float("nan")),
        changed(correction_m=float("inf")),
        changed(correction_m=True),
        changed(correction_m="0.1"),
        changed(correction_m=None),
        changed(sigma_m=-0.01),
        changed(sigma_m=1.5),
        changed(samples=-1),
        changed(samples=1.5),
        changed(antenna="x" * 201),
        json.dumps({"roads": [], "parts": 2 * json.loads(to_text(learning()))["parts"]}),
    ],
    ids=lambda text: text[:60],
)
def test_values_out_of_their_bounds_are_refused(text):
    with pytest.raises(ValueError, match=r"\w"):
        from_text(text, RULES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (changed(correction_m=0.31), r"correction_m is 0\.31, expected a number within ±0\.3 m"),
        (
            json.dumps({"roads": [], "parts": 2 * json.loads(to_text(learning()))["parts"]}),
            "parts: expected each antenna and base once",
        ),
    ],
)
def test_the_line_says_what_was_expected_where(text, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        from_text(text, RULES)


@settings(derandomize=True, max_examples=300)
@given(st.data())
def test_no_damage_whatever_moves_the_height_beyond_the_cap(data):
    text = to_text(learning())
    at = data.draw(st.integers(0, len(text) - 1))
    damaged = text[:at] + data.draw(st.text(max_size=4)) + text[at + data.draw(st.integers(0, 4)) :]
    try:
        result = from_text(damaged, RULES)
    except ValueError:
        return
    assert abs(result.correction(KEY).correction_m) <= RULES.cap_m

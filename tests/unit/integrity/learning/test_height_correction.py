"""The height correction: learnt from confirmed positions of a moving vehicle, robustly, slowly, and within its cap."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.learning.common_offset import CommonOffset
from camber.integrity.learning.height_correction import Correction, Learning, LearningRules, _differences
from camber.integrity.learning.offset_causes import NO_OFFSET, Diagnosis, OffsetCauses, RoadChange
from camber.integrity.learning.residuals import ReferenceKey, cell_of
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel
from support.residual_drives import KEY, START_NS, Noise, drive, residual

RULES = LearningRules()
BY_GAIN = LearningRules(mode="document")
ONE_SCALE = MapErrorModel(short_share=1.0, short_m=20.0)


def update(learning, first, last, **changes):
    for epoch in range(first, last):
        learning.update(residual(epoch, **changes))
    return learning.correction(changes.get("key", KEY))


# --- the document's mode ------------------------------------------------------------------------------------------


def test_by_the_document_one_position_moves_the_correction_by_the_gain():
    assert update(Learning(BY_GAIN), 0, 1, up_m=0.1) == Correction(
        correction_m=pytest.approx(0.01 * 0.1), sigma_m=0.0, samples=1
    )


def test_by_the_document_it_ends_at_what_is_observed():
    assert update(Learning(BY_GAIN), 0, 2000, up_m=0.1).correction_m == pytest.approx(0.1, abs=1e-6)


def test_by_the_document_what_would_go_beyond_the_cap_is_not_believed():
    learning = Learning(BY_GAIN)
    before = update(learning, 0, 100, up_m=0.1)
    assert update(learning, 100, 101, up_m=1e6) == before


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"map_version": 4}], ids=str)
def test_by_the_document_one_number_is_for_every_base_and_map(changes):
    learning = Learning(BY_GAIN)
    known = update(learning, 0, 100, up_m=0.1)
    assert known.samples == 100
    assert learning.correction(replace(KEY, **changes)) == known


# --- what is learnt from ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rules", [RULES, BY_GAIN], ids=["per cause", "document"])
@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": "erroneous"},
        {"verdict": "unknown"},
        {"speed_m_s": None},
        {"speed_m_s": 0.0},
        {"speed_m_s": 2.99},
        {"speed_m_s": -2.99},
        {"speed_m_s": math.nan},
        {"speed_m_s": math.inf},
        {"up_m": None},
        {"up_m": math.nan},
        {"up_m": math.inf},
        {"fix_sigma_m": math.nan},
        {"map_sigma_m": math.inf},
        {"fix_sigma_m": 0.0, "map_sigma_m": 0.0},
    ],
    ids=str,
)
def test_from_what_is_not_confirmed_not_moving_or_not_known_nothing_is_learnt(rules, changes):
    assert update(Learning(rules), 0, 300, **{"up_m": 0.05} | changes) == Correction()


@pytest.mark.parametrize("rules", [RULES, BY_GAIN], ids=["per cause", "document"])
@pytest.mark.parametrize(
    "changes", [{"speed_m_s": 3.0}, {"speed_m_s": -3.0}, {"verdict": "confirmed_after_verification"}]
)
def test_both_kinds_of_confirmed_positions_teach_forwards_and_backwards(rules, changes):
    assert update(Learning(rules), 0, 300, up_m=0.05, **changes).correction_m > 0.01


def test_a_place_that_is_none_is_left_out():
    assert update(Learning(RULES), 0, 300, up_m=0.05, latitude_rad=math.nan) == Correction()


# --- how fast, how far ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "map_sigma_m", "least"),
    [(ONE_SCALE, 0.05, 0.9), (MAP_ERRORS, 0.026, 0.85), (MAP_ERRORS, 0.05, 0.5)],
    ids=["5 cm over 20 m", "as measured", "5 cm, scales as measured"],
)
def test_from_ten_centimetres_off_three_are_reached_in_a_minute_in_most_drives(model, map_sigma_m, least):
    """The more of the map's error is alike along 600 m, the more is taken for the antenna's."""
    print("seeds 0 to 199")
    errors_m = []
    for seed in range(200):
        learning = Learning(replace(RULES, map_errors=model))
        *_, last_m = drive(learning, seed, 60.0, 0.1, Noise(map_sigma_m=map_sigma_m, map_errors=model))
        errors_m.append(last_m - 0.1)
    reached = float(np.mean(np.abs(errors_m) <= 0.03))
    print(f"{reached:.1%} within 3 cm, rms {np.std(errors_m) * 100:.1f} cm")
    assert reached >= least


@pytest.mark.slow
def test_wrong_fixes_that_pass_do_not_pull_it():
    noise = Noise(wrong=0.15, wrong_s=3.0)
    with_wrong = [[*drive(Learning(RULES), seed, 120.0, 0.0, noise)][-1] for seed in range(20)]
    assert float(np.mean(np.abs(with_wrong))) < 0.02


def test_it_changes_by_no_more_than_the_rate():
    track_m = [*drive(Learning(RULES), 1, 60.0, 0.2, Noise(wrong=0.0))]
    per_cell_m = np.abs(np.diff(track_m))
    assert per_cell_m.max() <= RULES.rate_m_s * 2.2  # a cell is 20 m, two seconds


def test_the_same_stretch_again_and_again_makes_it_no_surer():
    learning, other = Learning(RULES), Learning(RULES)
    for epoch in range(1200):
        place = residual(epoch % 20)  # 20 m up, and back at once
        moved = residual(epoch)
        learning.update(
            replace(moved, latitude_rad=place.latitude_rad, surface_id=epoch // 20 % 2, up_m=0.05)
        )
        other.update(replace(moved, up_m=0.05))
    assert learning.correction(KEY).sigma_m > 1.5 * other.correction(KEY).sigma_m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drift_m_s", "most_m"), [(0.0003, 0.1), (0.001, 0.2), (0.002, 0.25), (0.005, 0.15), (0.02, 0.05)]
)
def test_what_drifts_steadily_is_not_learnt(drift_m_s, most_m):
    for seed in range(6):
        noise = Noise(map_sigma_m=0.026)  # as measured
        track_m = [*drive(Learning(RULES), seed, 240.0, 0.0, noise, drift_m_s)]
        print(f"seed {seed}: {drift_m_s * 240:.2f} m drifted, {max(track_m):.3f} m learnt at most")
        assert max(track_m) <= most_m


numbers = st.one_of(
    st.none(), st.floats(-2.0, 2.0), st.floats(allow_nan=True, allow_infinity=True), st.just(0.25)
)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(numbers, st.floats(-200.0, 200.0), st.sampled_from(["confirmed", "erroneous"])), max_size=80
    ),
    st.sampled_from([RULES, BY_GAIN]),
)
def test_no_sequence_of_heights_whatever_takes_it_beyond_the_cap_or_the_rate(steps, rules):
    learning, before_m = Learning(rules), 0.0
    for number, (up_m, driven_m, verdict) in enumerate(steps):
        place = residual(driven_m)
        learning.update(replace(place, time_ns=START_NS + number * 10**9, up_m=up_m, verdict=verdict))
        result = learning.correction(KEY)
        assert abs(result.correction_m) <= rules.cap_m
        assert 0.0 <= result.sigma_m < math.inf
        if rules is RULES:
            assert abs(result.correction_m - before_m) <= RULES.rate_m_s * 10.0 + 1e-12
        before_m = result.correction_m


def test_what_drifts_is_held_where_it_was_at_the_oldest_stretch_remembered(learnt):
    """A drift counts where it is sure, and large."""
    (part,) = learnt.parts
    oldest_m = part.cells[0][1]
    part.cells[0] = (part.cells[0][0], oldest_m - 0.001)
    sure, large = RULES.drift_sigmas + 0.1, RULES.drift_m + 0.001

    def target_m(sigmas, metres, value_m=0.07):
        result = CommonOffset(value_m=value_m, sigma_m=0.01, used=70, drift_sigmas=sigmas, drift_m=metres)
        return learnt._target_m(part, result)

    for sigmas, metres in ((sure, 0.0), (0.0, large)):
        assert target_m(sigmas, metres) == 0.07
        assert part.held_m is None
    assert target_m(sure, large) == oldest_m - 0.001
    part.cells.popleft()
    assert target_m(sure, large, value_m=0.08) == oldest_m - 0.001
    assert target_m(0.0, 0.0) == 0.07
    assert part.held_m is None


def test_cells_have_metres_and_seconds_since_the_first_and_a_sigma_of_at_least_a_centimetre():
    cells = [
        cell_of([residual(epoch, up_m=up_m, fix_sigma_m=fix_sigma_m, map_sigma_m=0.04)])
        for epoch, up_m, fix_sigma_m in ((100, 0.1, 0.0), (130, 0.2, 0.03))
    ]
    result = _differences([(cell, 0.0) for cell in cells])
    assert result.up_m.tolist() == [0.1, 0.2]
    assert result.variance_m2 == pytest.approx([0.01**2, 0.03**2 + 0.01**2])
    assert result.map_sigma_m.tolist() == [0.04, 0.04]
    assert result.place_m == pytest.approx(np.array([[0.0, 0.0], [0.0, 30.0]]), rel=0.01, abs=1e-6)
    assert result.time_s.tolist() == [0.0, 3.0]


def test_towards_what_is_beyond_the_cap_it_does_not_go():
    assert update(Learning(RULES), 0, 900, up_m=0.4).correction_m <= 0.01


# --- to what it belongs ---------------------------------------------------------------------------------------------


@pytest.fixture
def learnt():
    learning = Learning(RULES)
    assert update(learning, 0, 1200, up_m=0.06).correction_m == pytest.approx(0.06, abs=0.01)
    return learning


def test_of_another_antenna_nothing_is_known(learnt):
    assert learnt.correction(replace(KEY, antenna="fixed")) == Correction()


def test_causes_get_the_sigma_of_the_correction_and_before_one_is_learnt_that_of_the_survey(
    learnt, monkeypatch
):
    known_m, sigmas_m = learnt.correction(KEY).sigma_m, []
    for learning in (Learning(RULES), learnt):
        monkeypatch.setattr(learning.causes, "update", lambda _, __, sigma_m: sigmas_m.append(sigma_m))
        learning.update(residual(0))
    assert sigmas_m == [RULES.map_errors.common_offset_sigma_m, known_m]
    assert known_m < 0.7 * RULES.map_errors.common_offset_sigma_m


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"map_version": 4}], ids=str)
def test_with_another_base_or_map_the_antennas_part_stays_and_is_less_sure(learnt, changes):
    known, other = learnt.correction(KEY), learnt.correction(replace(KEY, **changes))
    assert other.correction_m == known.correction_m
    assert other.sigma_m == pytest.approx(math.hypot(known.sigma_m, RULES.release_sigma_m))
    assert other.samples == known.samples > 0


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"map_version": 4}], ids=str)
def test_it_goes_on_from_there(learnt, changes):
    key = replace(KEY, **changes)
    assert update(learnt, 1200, 2400, up_m=0.02, key=key).correction_m == pytest.approx(0.02, abs=0.015)
    part = learnt.parts[-1]
    assert (part.base, part.map_version) == (key.base, key.map_version)
    assert len(part.cells) > 50, "its cells are kept"


@pytest.mark.parametrize("changes", [{"base": "receiver:WGS84"}, {"map_version": 4}], ids=str)
def test_as_long_as_nothing_is_learnt_there_that_is_all_that_is_known_of_it(learnt, changes):
    """Here the road has changed, so nothing is learnt."""
    key = replace(KEY, **changes)
    learnt.causes = OffsetCauses(
        RULES.causes,
        [RoadChange(surface_id=24, map_version=key.map_version, offset_m=0.2, onset_ns=START_NS)],
    )
    update(learnt, 1200, 1201, up_m=0.26, key=key)
    known, learnt.parts[0].held_m = learnt.correction(KEY), 0.01  # something drifted
    update(learnt, 1201, 1240, up_m=0.26, key=key)
    part, sigma_m = learnt.parts[-1], math.hypot(known.sigma_m, RULES.release_sigma_m)
    assert part.correction == Correction(
        correction_m=known.correction_m, sigma_m=sigma_m, samples=known.samples
    )
    assert (part.prior_m, part.prior_sigma_m) == (known.correction_m, sigma_m)
    assert (part.held_m, len(part.cells)) == (None, 0)


def test_a_new_map_that_has_the_changed_road_right_does_not_correct_it_twice(learnt):
    before = learnt.correction(KEY).correction_m
    learnt.causes.roads[30] = RoadChange(
        surface_id=30, map_version=KEY.map_version, offset_m=0.2, onset_ns=START_NS
    )
    assert update(learnt, 1500, 1550, up_m=0.26).correction_m == pytest.approx(before, abs=0.003)
    new = replace(KEY, map_version=4)
    assert update(learnt, 1550, 1950, up_m=0.06, key=new).correction_m == pytest.approx(before, abs=0.01)
    assert learnt.causes.roads == {}


def test_a_base_that_returns_finds_its_part_again(learnt):
    other = replace(KEY, base="receiver:WGS84")
    update(learnt, 1200, 2400, up_m=0.0, key=other)
    assert learnt.correction(KEY).correction_m == pytest.approx(0.06, abs=0.01)


def test_of_many_bases_the_oldest_are_forgotten():
    learning = Learning(RULES)
    for number in range(20):
        update(
            learning,
            30 * number,
            30 * number + 30,
            key=ReferenceKey(antenna="stroke", base=f"base {number}", map_version=3),
        )
    assert len(learning.parts) == 16
    assert learning.parts[-1].base == "base 19"


def test_an_antenna_that_was_measured_well_is_moved_less():
    """What is moved then is the common offset of the survey, which no measurement of the antenna shows."""
    without = replace(RULES, map_errors=replace(RULES.map_errors, common_offset_sigma_m=0.0))
    well, badly, with_offset = (
        update(Learning(rules), 0, 900, up_m=0.06).correction_m
        for rules in (replace(without, prior_sigma_m=0.01), without, replace(RULES, prior_sigma_m=0.01))
    )
    assert well < 0.5 * badly
    assert well < with_offset < badly


# --- causes ---------------------------------------------------------------------------------------------------------


def test_a_wrong_base_is_not_learnt_and_what_was_learnt_since_it_began_is_undone(learnt):
    before = learnt.correction(KEY).correction_m
    update(learnt, 1200, 1700, up_m=0.16, east_m=0.6, north_m=-0.4)
    assert learnt.diagnosis(None).cause == "base"
    assert learnt.correction(KEY).correction_m == pytest.approx(before, abs=0.004)
    assert [result.cause for result in learnt.news()] == ["base"]
    assert update(learnt, 1700, 2400, up_m=0.06).correction_m == pytest.approx(0.06, abs=0.01)
    assert learnt.diagnosis(None).cause == "none"


def test_a_base_metres_off_leaves_what_was_learnt_as_it_is(learnt):
    before, samples = learnt.correction(KEY), learnt.samples
    update(learnt, 1200, 1400, verdict="unknown", up_m=9.0, east_m=12.0, north_m=-9.0)
    assert learnt.diagnosis(None).cause == "base"
    assert learnt.correction(KEY).correction_m == pytest.approx(before.correction_m, abs=1e-3)
    assert learnt.samples == samples


def test_a_cause_that_is_named_before_anything_is_learnt_teaches_nothing():
    learning = Learning(RULES)
    update(learning, 0, 400, verdict="unknown", up_m=9.0, east_m=12.0, north_m=-9.0)
    assert learning.diagnosis(None).cause == "base"
    assert (learning.parts, learning.correction(KEY)) == ((), Correction())


def test_an_antenna_named_while_something_drifts_does_not_make_right_what_drifted(learnt):
    (part,) = learnt.parts
    part.held_m, known = 0.0, len(part.cells)
    learnt._forget(NO_OFFSET, Diagnosis(cause="antenna", onset_ns=residual(600).time_ns), part)
    assert (part.held_m, len(part.cells)) == (0.0, known)


def test_where_a_base_went_wrong_nothing_is_held_of_what_drifted(learnt):
    (part,) = learnt.parts
    part.held_m = 0.05
    learnt._forget(NO_OFFSET, Diagnosis(cause="base", onset_ns=residual(600).time_ns), part)
    assert part.held_m is None


def test_an_antenna_that_changed_is_named_and_learnt_from_then_on(learnt):
    update(learnt, 1200, 1800, up_m=-0.19)
    (named,) = [result for result in learnt.news() if result.cause == "antenna"]
    assert named.onset_ns == pytest.approx(residual(1200).time_ns, abs=3e9)
    (part,) = learnt.parts
    assert all(cell.end_ns > named.onset_ns for cell, _ in part.cells), "what was before says nothing of it"
    assert (part.prior_sigma_m, part.held_m, part.cells.maxlen) == (RULES.prior_sigma_m, None, 96)
    assert update(learnt, 1800, 3000, up_m=-0.19).correction_m == pytest.approx(-0.19, abs=0.015)


def test_what_may_be_the_road_is_not_learnt_and_leaves_nothing_where_it_ends(learnt):
    before = learnt.correction(KEY).correction_m
    update(learnt, 1200, 1500, up_m=before + 0.3)
    assert learnt.diagnosis(None).cause == "ambiguous"
    assert learnt.correction(KEY).correction_m == pytest.approx(before, abs=0.004)
    (part,) = learnt.parts
    onset_ns = learnt.diagnosis(None).onset_ns
    assert min(cell.begin_ns for cell, _ in part.cells if cell.up_m > before + 0.2) == onset_ns, "it is kept"
    update(learnt, 1500, 1900, up_m=before)
    assert learnt.diagnosis(None).cause == "none"
    assert learnt.correction(KEY).correction_m == pytest.approx(before, abs=0.004)
    (part,) = learnt.parts
    assert all(abs(cell.up_m - before) < 0.05 for cell, _ in part.cells)


def test_cells_on_a_changed_road_are_removed():
    learning = Learning(RULES)
    update(learning, 0, 200)
    for epoch in range(200, 300):
        off = {"up_m": 0.25, "verdict": "confirmed_after_verification"} if epoch < 250 else {}
        learning.update(residual(epoch, **off))
    assert set(learning.causes.roads) == {4}
    (part,) = learning.parts
    assert {cell.surface_id for cell, _ in part.cells} == {0, 1, 2, 3, 5}
    assert part.cells.maxlen == 96


def test_cells_on_a_changed_road_are_removed_with_another_base_too():
    learning, other = Learning(RULES), replace(KEY, base="receiver:WGS84")
    update(learning, 0, 300)
    for epoch in range(300):
        off = {"up_m": 0.25, "verdict": "confirmed_after_verification"} if 200 <= epoch < 250 else {}
        again = residual(epoch, key=other, **off)
        learning.update(replace(again, time_ns=again.time_ns + 600 * 10**9))
    assert set(learning.causes.roads) == {4}
    surfaces = {part.base: {cell.surface_id for cell, _ in part.cells} for part in learning.parts}
    assert surfaces == {base: {0, 1, 2, 3, 5} for base in (KEY.base, other.base)}


def test_a_road_that_is_named_at_a_walking_pace_before_anything_is_learnt_teaches_nothing():
    learning = Learning(RULES)
    update(learning, 0, 200, speed_m_s=1.0)
    update(learning, 200, 250, speed_m_s=1.0, up_m=0.25, verdict="confirmed_after_verification")
    update(learning, 250, 300, speed_m_s=1.0)
    assert set(learning.causes.roads) == {4}
    assert (learning.parts, learning.correction(KEY)) == ((), Correction())


def test_a_changed_road_of_a_few_hundred_metres_that_fits_the_height_check_is_not_learnt(learnt):
    before = learnt.correction(KEY).correction_m
    for epoch in range(1200, 1360):
        learnt.update(residual(epoch, up_m=before + 0.28, fix_sigma_m=0.1))
    for epoch in range(1360, 1800):
        learnt.update(residual(epoch, up_m=before, fix_sigma_m=0.1))
        assert learnt.correction(KEY).correction_m == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize("keep", [False, True])
def test_what_is_taken_back_leaves_it_as_sure_as_it_was_and_where_it_was_then(learnt, keep):
    (part,) = learnt.parts
    cells, known = list(part.cells), part.correction
    learnt._undo(part, cells[-1][0].end_ns, keep=True)
    assert (part.correction, list(part.cells)) == (known, cells), "nothing was learnt since"
    learnt._undo(part, cells[-4][0].end_ns, keep=keep)
    assert part.correction == Correction(
        correction_m=cells[-3][1], sigma_m=known.sigma_m, samples=known.samples
    )
    assert list(part.cells) == (cells if keep else cells[:-3])
    assert part.cells.maxlen == 96


@pytest.mark.parametrize("epochs", [50, 5])
def test_far_from_where_it_should_be_it_goes_there_at_its_rate_stretch_by_stretch(epochs):
    learning, steps = Learning(RULES), []
    before = learning.correction(KEY)
    for epoch in range(8 * epochs):
        learning.update(residual(epoch, up_m=0.25, surface_id=epoch // epochs))
        now = learning.correction(KEY)
        if now.samples != before.samples:
            assert now.samples == before.samples + 1
            steps.append(now.correction_m - before.correction_m)
            assert now.samples < 4 or now.sigma_m > 0.2 - now.correction_m, "it is not there yet, and says so"
        before = now
    (part,) = learning.parts
    ends_s = np.diff([cell.end_ns for cell, _ in part.cells]) / 1e9
    assert steps[1:] == pytest.approx(RULES.rate_m_s * ends_s, rel=1e-6)


def test_an_erroneous_run_is_named_and_not_learnt(learnt):
    before = learnt.correction(KEY).correction_m
    assert update(learnt, 1200, 1800, up_m=0.6, verdict="erroneous").correction_m == before
    assert learnt.diagnosis(None).cause == "antenna"
    assert learnt.diagnosis(None).up_m == pytest.approx(0.6 - before, abs=0.01)


def test_causes_take_the_map_errors_of_the_learning():
    errors = MapErrorModel(common_offset_sigma_m=0.3)
    assert Learning(replace(RULES, map_errors=errors)).causes.rules.map_errors is errors

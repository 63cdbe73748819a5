"""Other estimates of an epoch: which choices are tried, what agrees, and that no height is known."""

import inspect

import numpy as np
import pytest

from camber.formats.observations import satellite_name
from camber.gnss.ambiguity.fixed_solution import estimate
from camber.gnss.candidates import satellite_subsets as re_estimation
from camber.gnss.candidates.satellite_subsets import subset_candidates
from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.float_solution import NO_PRIOR, PositionPrior
from camber.gnss.position.rtk_engine import Solution
from support.engine_drives import open_sky_drive, solved
from support.single_difference_rows import MadeUp, made_up_rows

LIMITS = EngineSettings().fix_criteria()
AT = np.array([1000.0, 2000.0, 3000.0])


def made_up(seed: int = 1, **arguments) -> MadeUp:
    return made_up_rows(np.random.default_rng(seed), noise=0.5, **arguments)


def tried(rows: SingleDifferences, strategy: str, excluded=(), most=100, limits=LIMITS, prior=NO_PRIOR):
    solution = Solution(time_ns=0, quality="float", reason="", approximate_ecef_m=AT, rows=rows, prior=prior)
    return subset_candidates(solution, limits, strategy, excluded, most_trials=most)


def names_of(rows: SingleDifferences) -> list[str]:
    return [satellite_name(s) for s in np.unique(rows.satellite).tolist()]


def test_each_estimate_is_that_of_the_satellites_that_are_left():
    made = made_up()
    trials, subsets = tried(made.rows, "leave_one_out")
    assert trials == 16
    assert sorted(other.excluded for other in subsets) == [(name,) for name in sorted(names_of(made.rows))]
    assert [other.agreeing for other in subsets] == [15] * 16
    for other in subsets:
        mask = np.array([satellite_name(s) not in other.excluded for s in made.rows.satellite.tolist()])
        alone = estimate(made.rows, mask, NO_PRIOR, LIMITS)
        np.testing.assert_array_equal(other.position_ecef_m, AT + alone.dx_m)
        np.testing.assert_array_equal(other.covariance_ecef_m2, alone.covariance_m2)
        assert (other.fixed, other.ratio, other.ambiguities) == (alone.fixed, alone.ratio, alone.ambiguities)
        np.testing.assert_allclose(other.position_ecef_m - AT, made.dx_m, atol=0.03)


def test_leave_one_system_out_leaves_each_system_out():
    rows = made_up(systems="GEC").rows
    trials, subsets = tried(rows, "leave_one_system_out")
    assert trials == 3
    assert [{name[0] for name in other.excluded} for other in subsets] == [{"G"}, {"E"}, {"C"}]


@pytest.mark.parametrize(
    "strategy", ["leave_one_out", "leave_one_system_out", "by_cn0", "by_elevation", "by_residual", "all"]
)
def test_satellites_without_integers_are_in_every_subset(strategy):
    """Without one of GLONASS the integers are the same, so that agreement would be no evidence."""
    made = made_up(systems="GER")
    of_glonass = made.rows.satellite >> 8 == ord("R")
    rows = made.rows._replace(phase_m=np.where(of_glonass, np.nan, made.rows.phase_m))
    trials, subsets = tried(rows, strategy)
    assert subsets
    assert not {name for other in subsets for name in other.excluded if name[0] == "R"}
    same = made.rows._replace(
        **{f: getattr(rows, f)[~of_glonass] for f in rows._fields if f != "atmosphere_m2"}
    )
    assert trials == tried(same, strategy)[0]
    (alone,) = tried(rows, "explicit", ["R01"])[1]
    assert alone.excluded == ("R01",)


@pytest.mark.parametrize(("strategy", "column"), [("by_cn0", "cn0_dbhz"), ("by_elevation", "elevation_rad")])
def test_the_weakest_and_the_lowest_go_first(strategy, column):
    rows = made_up().rows
    satellites = np.unique(rows.satellite)
    least = [getattr(rows, column)[rows.satellite == s].min() for s in satellites]
    order = [satellite_name(s) for s in satellites[np.argsort(least)].tolist()]
    _, subsets = tried(rows, strategy)
    assert len(subsets) >= 5
    for other in subsets:
        assert set(other.excluded) == set(order[: len(other.excluded)])


def test_the_worst_residual_goes_first():
    made = made_up()
    code = made.rows.code_m.copy()
    wrong = made.rows.satellite == made.rows.satellite[9]
    code[wrong] += 25.0
    _, subsets = tried(made.rows._replace(code_m=code), "by_residual", most=1)
    assert [other.excluded for other in subsets] == [(satellite_name(int(made.rows.satellite[9])),)]


def test_explicit_is_one_trial_without_those_named():
    rows = made_up().rows
    trials, subsets = tried(rows, "explicit", ("G03", "E05", "C40"))
    assert (trials, [other.excluded for other in subsets]) == (1, [("E05", "G03")])
    assert subsets[0].agreeing == 0


@pytest.mark.parametrize("strategy", ["leave_one_out", "by_cn0", "by_elevation", "by_residual", "all"])
def test_what_is_excluded_is_in_no_choice(strategy):
    _, subsets = tried(made_up().rows, strategy, ("G03", "E05"))
    assert subsets
    assert all({"G03", "E05"} <= set(other.excluded) for other in subsets)


@pytest.mark.parametrize("most", [-3, 0, 1, 2, 7, 20, 1000])
@pytest.mark.parametrize("strategy", ["all", "leave_one_out", "explicit"])
def test_no_more_are_tried_than_allowed_and_each_choice_once(strategy, most):
    trials, subsets = tried(made_up().rows, strategy, (), most)
    assert trials <= max(most, 0)
    assert len(subsets) <= trials
    assert len({other.excluded for other in subsets}) == len(subsets)


def test_trials_count_what_failed_too():
    """Phases of noise: nothing passes, and all of it was tried."""
    rows = made_up().rows
    noise = np.random.default_rng(5).uniform(-1, 1, rows.group.size)
    trials, subsets = tried(rows._replace(phase_m=rows.phase_m + noise), "leave_one_out")
    assert trials == 16
    assert len(subsets) < 3


def test_a_satellite_whose_phases_are_wrong_is_identified_by_leaving_it_out():
    for seed in range(5):
        made = made_up(seed)
        wrong = made.rows.satellite == made.rows.satellite[6]
        phase = made.rows.phase_m + wrong * np.where(np.arange(wrong.size) % 2, 0.08, -0.06)
        limits = LIMITS._replace(partial=False)
        _, subsets = tried(made.rows._replace(phase_m=phase), "leave_one_out", limits=limits)
        without = [o for o in subsets if satellite_name(int(made.rows.satellite[6])) in o.excluded]
        assert len(without) == 1
        np.testing.assert_allclose(without[0].position_ecef_m - AT, made.dx_m, atol=0.03)


def test_the_same_measurements_do_not_agree_with_themselves():
    """Satellites whose codes are rejected and that have no phase: to leave them out changes nothing."""
    made = made_up()
    idle = np.isin(made.rows.satellite, [ord("G") * 256 + 1, ord("E") * 256 + 1])
    rows = made.rows._replace(
        code_m=made.rows.code_m + 500.0 * idle * (made.rows.satellite % 7 + 1),
        phase_m=np.where(idle, np.nan, made.rows.phase_m),
    )
    every = [name for name in names_of(rows) if name not in ("G01", "E01")]
    subsets = [tried(rows, "explicit", (name,))[1][0] for name in ("G01", "E01")]
    np.testing.assert_array_equal(subsets[0].position_ecef_m, subsets[1].position_ecef_m)
    _, together = tried(rows, "leave_one_out")
    by_name = {other.excluded[0]: other.agreeing for other in together}
    assert by_name["G01"] == len(every)
    assert by_name[every[0]] == len(every) + 1


def test_no_map_and_no_height_can_be_given():
    names = set(inspect.signature(subset_candidates).parameters)
    assert not [name for name in names if "height" in name or "road" in name or "map" in name]
    assert "camber.gnss.map" not in inspect.getsource(re_estimation)


@pytest.mark.parametrize(("satellites", "systems"), [(0, "G"), (1, "G"), (3, "G"), (4, "G"), (2, "GE")])
def test_few_satellites_are_few_choices(satellites, systems):
    rows = made_up(satellites=satellites, systems=systems).rows
    for strategy in ("all", "leave_one_out", "explicit", "by_residual"):
        trials, subsets = tried(rows, strategy)
        assert trials <= (1 if strategy == "explicit" else 0) or satellites * len(systems) > 3
        assert len(subsets) <= trials


def test_an_epoch_of_the_engine_has_candidates_at_its_position():
    d = open_sky_drive(seed=2, seconds=2)
    for solution, truth in zip(solved(d), d.true_ecef_m, strict=True):
        trials, subsets = subset_candidates(solution, LIMITS, "all", most_trials=20)
        assert trials == 20
        right = [np.linalg.norm(other.position_ecef_m - truth) < 0.2 for other in subsets]
        assert len(subsets) >= 15
        assert all(right)
        assert max(other.agreeing for other in subsets) >= 10


def test_what_the_epoch_had_of_the_epochs_before_each_estimate_has_too():
    """Where the float position is known to centimetres from before, the integers are surer."""
    made = made_up(systems="G")
    few = [name for k, name in enumerate(names_of(made.rows)) if k >= 5]
    known = PositionPrior(AT + made.dx_m, np.eye(3) / 0.02**2)
    _, (without,) = tried(made.rows, "explicit", few, 1)
    _, (subsets,) = tried(made.rows, "explicit", few, 1, prior=known)
    assert 1.0 - subsets.success_rate < 0.1 * (1.0 - without.success_rate)
    np.testing.assert_allclose(subsets.position_ecef_m - AT, made.dx_m, atol=0.03)

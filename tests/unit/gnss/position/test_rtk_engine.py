"""The engine on simulated receivers: right in the open, never wrong-looking right where something is wrong."""

import functools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.observations import ObservationEpoch
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.engine_warnings import HELP, EngineWarnings
from camber.gnss.position.rtk_engine import Engine, EngineWarning, Solution
from camber.gnss.warm_up import _constellation
from support.canyon_statistics import FIRST_NS
from support.engine_drives import (
    Drive,
    clock_ahead,
    engine_of,
    open_sky_drive,
    seconds_later,
    solved,
    some_rows,
)

ALONE = EngineSettings(doppler_aided=False)


@functools.cache
def drive() -> Drive:
    return open_sky_drive(seed=1, seconds=8)


def one(rover: ObservationEpoch, base: ObservationEpoch, engine: Engine | None = None) -> Solution:
    engine = engine or engine_of(drive(), ALONE)
    engine.add_base(base)
    return engine.solve(rover)


def is_honest(solution: Solution, truth_m: np.ndarray) -> bool:
    """Not fixed, or right; and a reason either way."""
    assert solution.reason
    if solution.quality != "fixed":
        return solution.reason != "resolved"
    return bool(np.linalg.norm(solution.position_ecef_m - truth_m) < 0.3)


ACROSS_THE_WEEKS_TURN_NS = -(-FIRST_NS // NS_PER_WEEK) * NS_PER_WEEK - 3 * NS_PER_SECOND


@pytest.mark.parametrize("aided", [False, True])
@pytest.mark.parametrize(
    "of_drive",
    [*({"seed": n} for n in range(1, 5)), {"rate_hz": 10}, {"seed": 5, "begin_ns": ACROSS_THE_WEEKS_TURN_NS}],
)
def test_in_the_open_every_epoch_is_fixed_to_centimetres_and_goes_on(of_drive, aided):
    d = open_sky_drive(seconds=6, **of_drive)
    engine = engine_of(d, EngineSettings(doppler_aided=aided))
    solutions = solved(d, engine)
    assert [s.quality for s in solutions] == ["fixed"] * len(d.rover)
    positions = np.array([s.position_ecef_m for s in solutions])
    assert np.linalg.norm(positions - d.true_ecef_m, axis=1).max() < 0.05
    assert [s.continuity for s in solutions][1:] == ["continuous"] * (len(solutions) - 1)
    assert {s.continuous_since_ns for s in solutions} == {solutions[0].time_ns}
    assert dict(engine.reasons) == {"resolved": len(solutions)}


def test_covariances_of_fixes_are_those_of_their_errors():
    nees = []
    for seed in range(1, 13):
        d = open_sky_drive(seed=seed, seconds=3, begin_ns=FIRST_NS + seed * 6000 * NS_PER_SECOND)
        for s, truth in zip(solved(d), d.true_ecef_m, strict=True):
            if s.quality == "fixed":
                error = s.position_ecef_m - truth
                nees.append(error @ np.linalg.solve(s.covariance_ecef_m2, error))
    assert len(nees) > 30
    assert np.mean(nees) < 4.5


@pytest.mark.parametrize(
    "bands", [("12", "", ""), ("", "17", ""), ("", "", "27"), ("1", "1", ""), ("12", "", "2")]
)
def test_any_systems_and_bands_do(bands):
    d = drive()
    gps, galileo, beidou = bands
    settings = EngineSettings(gps_bands=gps, galileo_bands=galileo, beidou_bands=beidou)
    solutions = solved(d, engine_of(d, settings))
    for s, truth in zip(solutions, d.true_ecef_m, strict=True):
        assert is_honest(s, truth)
        assert s.quality in ("fixed", "float")
    assert sum(s.quality == "fixed" for s in solutions) >= 1


@given(st.randoms(use_true_random=False))
@settings(derandomize=True, max_examples=10, deadline=None)
def test_the_order_of_signals_changes_nothing(random):
    rover, base = drive().rover[2], drive().base[2]
    shuffled = [
        some_rows(e, np.array(random.sample(range(e.satellite.size), e.satellite.size)))
        for e in (rover, base)
    ]
    before, after = one(rover, base), one(*shuffled)
    assert (before.quality, before.satellites) == (after.quality, after.satellites)
    np.testing.assert_allclose(after.position_ecef_m, before.position_ecef_m, atol=1e-4)


@pytest.mark.parametrize("clock_ms", [0.4, -1.0, 17.0, -40.0])
def test_a_receivers_clock_error_moves_its_time_and_nothing_else(clock_ms):
    rover, base = drive().rover[2], drive().base[2]
    before, after = one(rover, base), one(clock_ahead(rover, clock_ms * 1e-3), base)
    assert (before.quality, after.quality) == ("fixed", "fixed")
    np.testing.assert_allclose(after.position_ecef_m, before.position_ecef_m, atol=2e-3)


@pytest.mark.parametrize(
    ("age_s", "quality"), [(-5.0, "fixed"), (4.0, "fixed"), (10.5, "single"), (-11.0, "single")]
)
def test_a_base_is_used_within_the_age_limit_before_and_after(age_s, quality):
    """The base of another time, labelled as such: of the drive's own seconds, or too far away."""
    d = drive()
    k = 6 if age_s > 0 else 1
    at = k - round(age_s)
    base = d.base[at] if 0 <= at < len(d.base) else seconds_later(d.base[k], -age_s)
    engine = engine_of(d)
    solution = one(d.rover[k], base, engine)
    assert solution.quality == quality
    if quality == "fixed":
        assert solution.age_s == pytest.approx(age_s)
        assert np.linalg.norm(solution.position_ecef_m - d.true_ecef_m[k]) < 0.06
    else:
        assert (solution.reason, engine.warnings["base_stale"]) == ("base_too_old", 1)


def test_epochs_that_come_late_or_twice_are_refused_and_disturb_nothing():
    d = drive()
    engine = engine_of(d)
    solved_epochs = [one(d.rover[k], d.base[k], engine) for k in (0, 1, 2, 1, 3, 3, 4)]
    r, o = "resolved", "out_of_order"
    assert [s.reason for s in solved_epochs] == [r, r, r, o, r, o, r]
    assert [s.continuity for s in solved_epochs if s.quality == "fixed"][1:] == ["continuous"] * 4
    assert engine.warnings == {"rover_out_of_order": 2, "base_out_of_order": 2}
    assert solved_epochs[3].position_ecef_m is None


def test_a_receiver_whose_time_went_back_is_followed_after_three_epochs():
    d = drive()
    engine = engine_of(d)
    assert one(seconds_later(d.rover[0], 604_800.0), d.base[0], engine).quality in ("single", "none")
    assert [one(d.rover[k], d.base[k], engine).reason for k in range(1, 6)] == ["out_of_order"] * 2 + [
        "resolved"
    ] * 3
    assert engine.warnings["rover_time_went_back"] == 1


def test_a_signal_that_is_there_twice_and_differs_is_not_used():
    rover, base = drive().rover[2], drive().base[2]
    plain = one(rover, base)
    n = rover.satellite.size
    twice = some_rows(rover, np.concatenate((np.arange(n), [3, 9])))
    assert one(twice, base).satellites == plain.satellites
    np.testing.assert_allclose(one(twice, base).position_ecef_m, plain.position_ecef_m, atol=1e-6)
    code = twice.pseudorange_m.copy()
    code[-2:] += 12.0
    differing = one(replace(twice, pseudorange_m=code), base)
    used = {
        (int(s), int(g))
        for s, g in zip(differing.rows.satellite, rover.signal[differing.rows.rover], strict=True)
    }
    assert (int(rover.satellite[3]), int(rover.signal[3])) not in used
    assert is_honest(differing, drive().true_ecef_m[2])


def test_every_satellite_twice_makes_no_exception_and_no_wrong_fix():
    rover, base = drive().rover[2], drive().base[2]
    n = rover.satellite.size
    twice = some_rows(rover, np.tile(np.arange(n), 2))
    shifted = replace(twice, carrier_phase_cycles=twice.carrier_phase_cycles + np.repeat([0.0, 0.4], n))
    solution = one(shifted, base)
    assert solution.quality != "fixed"
    assert solution.position_ecef_m is not None


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5])
def test_few_satellites_are_never_sure_of_more_than_they_know(count):
    d = drive()
    for rover, base, truth in zip(d.rover, d.base, d.true_ecef_m, strict=True):
        few = np.isin(rover.satellite, np.unique(rover.satellite)[:count])
        assert is_honest(one(some_rows(rover, few), base), truth)


def test_a_base_without_phases_gives_a_float_position():
    rover, base = drive().rover[2], drive().base[2]
    nothing = np.full(base.satellite.size, np.nan)
    solution = one(rover, replace(base, carrier_phase_cycles=nothing))
    assert (solution.quality, solution.reason) == ("float", "success_rate_too_low")
    assert np.linalg.norm(solution.position_ecef_m - drive().true_ecef_m[2]) < 3.0


def test_flagged_half_cycles_are_no_phases():
    rover, base = drive().rover[2], drive().base[2]
    every = np.ones(rover.satellite.size, np.bool_)
    assert one(replace(rover, half_cycle=every), base).quality == "float"


@pytest.mark.parametrize("seed", range(6))
def test_unflagged_half_cycles_never_make_a_wrong_fix(seed):
    d = drive()
    rng = np.random.default_rng(seed)
    for rover, base, truth in zip(d.rover, d.base, d.true_ecef_m, strict=True):
        wrong = rng.random(rover.satellite.size) < 0.1
        cycles = rover.carrier_phase_cycles + 0.5 * wrong
        assert is_honest(one(replace(rover, carrier_phase_cycles=cycles), base), truth)


ODD = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e9, 1e300, 2.0e7])
FIELDS = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "cn0_dbhz", "lock_time_s")


@given(
    st.integers(0, 7),
    st.lists(st.tuples(st.sampled_from(FIELDS), st.integers(0, 400), ODD, st.booleans()), max_size=30),
)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_odd_values_here_and_there_are_no_exception_and_no_wrong_fix(k, changes):
    d = drive()
    epochs = {False: d.rover[k], True: d.base[k]}
    for name, row, value, at_base in changes:
        epoch = epochs[at_base]
        column = getattr(epoch, name).copy()
        column[row % column.size] = value
        epochs[at_base] = replace(epoch, **{name: column})
    assert is_honest(one(epochs[False], epochs[True]), d.true_ecef_m[k])


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 2.2e7])
@pytest.mark.parametrize("at_base", [False, True])
def test_a_column_of_one_odd_value_is_no_exception_and_no_wrong_fix(field, value, at_base):
    rover, base = drive().rover[2], drive().base[2]
    epoch = base if at_base else rover
    changed = replace(epoch, **{field: np.full(epoch.satellite.size, value)})
    assert is_honest(one(*((rover, changed) if at_base else (changed, base))), drive().true_ecef_m[2])


@pytest.mark.parametrize("metres", [15.0, 300.0, 5.0e4, 3.0e6])
@pytest.mark.parametrize("at_base", [False, True])
def test_wrong_codes_of_two_satellites_make_no_wrong_fix(metres, at_base):
    d = drive()
    for rover, base, truth in zip(d.rover, d.base, d.true_ecef_m, strict=True):
        epoch = base if at_base else rover
        wrong = np.isin(epoch.satellite, np.unique(rover.satellite)[2:4])
        changed = replace(epoch, pseudorange_m=epoch.pseudorange_m + metres * wrong)
        assert is_honest(one(*((rover, changed) if at_base else (changed, base))), truth)


def test_an_observation_of_another_time_makes_no_fix():
    """The base's epoch with a time tag that is a second wrong."""
    d = drive()
    solution = one(d.rover[4], seconds_later(d.base[3], 1.0))
    assert solution.quality != "fixed" or np.linalg.norm(solution.position_ecef_m - d.true_ecef_m[4]) < 0.3


def test_a_wrong_fix_pulls_no_later_one():
    """What goes on is the float position: that of an epoch whose phases are all of another place is as before."""
    d = drive()
    plain, disturbed = engine_of(d), engine_of(d)
    rng = np.random.default_rng(1)
    for k, (rover, base) in enumerate(zip(d.rover, d.base, strict=True)):
        plain.add_base(base)
        disturbed.add_base(base)
        before = plain.solve(rover)
        if k == 3:
            wrong = rover.carrier_phase_cycles + rng.uniform(-3, 3, rover.satellite.size)
            disturbed.solve(replace(rover, carrier_phase_cycles=wrong))
        else:
            after = disturbed.solve(rover)
            np.testing.assert_array_equal(after.position_ecef_m, before.position_ecef_m)


def test_a_failure_rate_in_place_of_the_ratio_fixes_in_the_open():
    # No epoch reaches this ratio, which the settings do not allow either.
    without_ratio = EngineSettings(failure_rate=0.001).model_copy(update={"least_ratio": 1e9})
    solutions = solved(drive(), engine_of(drive(), without_ratio))
    assert [s.quality for s in solutions] == ["fixed"] * 8


def test_a_warning_is_reported_each_time_it_has_happened_again():
    engine, warnings = Engine(EngineSettings()), EngineWarnings()
    assert warnings.new(engine) == []
    engine.warnings["base_silent"] += 3
    engine.warnings["rover_clock_step"] += 1
    assert warnings.new(engine) == [
        ("base_silent", f"3 epochs; {HELP['base_silent']}"),
        ("rover_clock_step", f"1 epochs; {HELP['rover_clock_step']}"),
    ]
    assert warnings.new(engine) == []
    engine.warnings["base_silent"] += 1
    assert warnings.new(engine) == [("base_silent", f"4 epochs; {HELP['base_silent']}")]


def test_refused_ephemerides_are_reported_with_the_reason():
    engine, warnings = Engine(EngineSettings()), EngineWarnings()
    first, second, third = _constellation()[:3]
    engine.add_ephemeris(replace(first, sqrt_a=1.0))
    engine.add_ephemeris(replace(second, sqrt_a=np.inf))
    engine.add_ephemeris(replace(third, eccentricity=0.7))
    assert warnings.new(engine) == [("ephemeris_refused", "not_finite 1, orbit 2")]
    assert warnings.new(engine) == []


def test_every_warning_has_a_text_that_helps():
    assert set(get_args(EngineWarning)) == {*HELP, "ephemeris_missing", "base_position_wrong", "base_moved"}
    assert all(len(text) > 10 for text in HELP.values())

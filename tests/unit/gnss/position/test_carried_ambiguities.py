"""Ambiguities over time: what is carried, what ends an arc, and that wrong integers and slips do not last."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import signal_number
from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED
from camber.gnss.position.engine_settings import EngineSettings
from support.engine_drives import Drive, engine_of, of_systems, open_sky_drive, some_rows

CARRIED = EngineSettings(ambiguities="carried")
WRONG_M = 0.1
RATE_HZ = 5


@functools.cache
def drive(seconds: int = 12, rate_hz: int = RATE_HZ) -> Drive:
    return open_sky_drive(seed=3, seconds=seconds, rate_hz=rate_hz)


def run(rover, base, engine):
    solutions = []
    for one, other in zip(rover, base, strict=True):
        engine.add_base(other)
        solutions.append(engine.solve(one))
    return solutions


def errors_m(solutions, truth):
    return [
        float(np.linalg.norm(s.position_ecef_m - at)) if s.quality == "fixed" else np.nan
        for s, at in zip(solutions, truth, strict=True)
    ]


def arcs_of(engine):
    return set(engine._carried.arcs())


def test_by_default_each_epoch_is_solved_by_itself_and_says_so():
    solutions = run(drive().rover[:5], drive().base[:5], engine_of(drive()))
    assert EngineSettings().ambiguities == "single_epoch"
    assert {s.ambiguity_mode for s in solutions} == {"single_epoch"}


def test_under_an_open_sky_all_is_fixed_by_carried_ambiguities_to_centimetres():
    solutions = run(drive().rover, drive().base, engine_of(drive(), CARRIED))
    assert {s.quality for s in solutions} == {"fixed"}
    assert {s.ambiguity_mode for s in solutions} == {"carried"}
    assert np.max(errors_m(solutions, drive().true_ecef_m)) < 0.05
    assert {s.continuity for s in solutions[1:]} == {"continuous"}


def test_satellites_in_another_order_give_the_same():
    rng, one, other = np.random.default_rng(1), engine_of(drive(), CARRIED), engine_of(drive(), CARRIED)
    turned = [some_rows(epoch, rng.permutation(epoch.satellite.size)) for epoch in drive().rover[:15]]
    for s, t in zip(
        run(drive().rover[:15], drive().base[:15], one), run(turned, drive().base[:15], other), strict=True
    ):
        assert t.quality == s.quality
        assert t.position_ecef_m == pytest.approx(s.position_ecef_m, abs=1e-3)


@pytest.mark.parametrize("what", ["slip", "half_cycle", "code", "gap"])
def test_an_arc_ends(what):
    """A lost lock, a half cycle that was open, another code, and a gap of some seconds."""
    epochs, base = list(drive().rover[:20]), list(drive().base[:20])
    engine = engine_of(drive(), CARRIED)
    run(epochs[:10], base[:10], engine)
    before = arcs_of(engine)
    if what == "gap":
        engine.add_base(drive().base[30])
        engine.solve(drive().rover[30])
        assert not before & arcs_of(engine)
        return
    first = epochs[10]
    row = int(np.flatnonzero((first.satellite >> 8) == ord("G"))[0])
    mark = np.arange(first.satellite.size) == row
    if what == "slip":
        first = replace(first, loss_of_lock=first.loss_of_lock | mark)
    elif what == "half_cycle":
        first = replace(first, half_cycle=first.half_cycle | mark)
    else:
        first = replace(first, signal=np.where(mark, signal_number("1W"), first.signal))
    run([first, epochs[11]], base[10:12], engine)
    lost = before - arcs_of(engine)
    assert len(lost) <= 2, "the other arcs go on"
    numbers = [engine._slips.update(epoch)[row] for epoch in (epochs[12],)]
    assert what == "half_cycle" or numbers[0] not in {rover for rover, _ in before} or lost


def test_another_coordinate_of_the_base_begins_anew():
    engine = engine_of(drive(), CARRIED)
    run(drive().rover[:5], drive().base[:5], engine)
    assert arcs_of(engine)
    engine.set_base_position(engine.base.position_ecef_m + np.array([0.0, 0.0, 1.0]))
    assert not arcs_of(engine)


def with_slip(epochs, satellite, signal, cycles):
    """From here on the phase of one signal is off by so many cycles, and nothing indicates it."""
    return [
        replace(
            epoch,
            carrier_phase_cycles=epoch.carrier_phase_cycles
            + cycles * ((epoch.satellite == satellite) & (epoch.signal == signal)),
        )
        for epoch in epochs
    ]


@pytest.mark.parametrize("systems", ["G", "GEC"])
@pytest.mark.parametrize("doppler", [True, False])
def test_a_slip_of_one_cycle_does_not_last_as_a_fix(systems, doppler):
    """On any one satellite, with few and with many others."""
    rng = np.random.default_rng(5)
    rover = [of_systems(epoch, systems + ("J" if systems == "GEC" else "")) for epoch in drive().rover]
    if not doppler:
        rover = [replace(epoch, doppler_hz=np.full(epoch.satellite.size, np.nan)) for epoch in rover]
    at = 4 * RATE_HZ
    for _ in range(6):
        row = int(rng.integers(rover[at].satellite.size))
        slipped = with_slip(
            rover[at:], int(rover[at].satellite[row]), int(rover[at].signal[row]), rng.choice([-1.0, 1.0])
        )
        solutions = run([*rover[:at], *slipped], drive().base, engine_of(drive(), CARRIED))
        error = np.array(errors_m(solutions, drive().true_ecef_m))
        late = error[at + 2 * RATE_HZ :]
        assert not (late > WRONG_M).any()


def test_wrong_integers_put_in_on_purpose_are_left_within_three_seconds():
    rng, left = np.random.default_rng(6), []
    for _ in range(12):
        engine = engine_of(drive(), CARRIED)
        at = 3 * RATE_HZ
        run(drive().rover[:at], drive().base[:at], engine)
        carried = engine._carried
        hypothesis = carried._hypothesis
        assert hypothesis is not None
        # Each held ambiguity is off by whole cycles: the datum is moved, and the value is not.
        wrong = hypothesis.arcs.datum_cycles + rng.integers(-3, 4, hypothesis.arcs.datum_cycles.size)
        carried._hypothesis = hypothesis._replace(
            arcs=hypothesis.arcs._replace(datum_cycles=wrong.astype(np.float64))
        )
        error = np.array(
            errors_m(run(drive().rover[at:], drive().base[at:], engine), drive().true_ecef_m[at:])
        )
        left.append(not (error[3 * RATE_HZ :] > WRONG_M).any())
    assert all(left)


def test_a_hypothesis_gives_the_fix_where_the_epoch_by_itself_gives_none():
    """Six satellites of one band are too few for one epoch, and enough with integers that are known."""
    rover = list(drive().rover)
    rows = run(rover[:1], drive().base[:1], engine_of(drive()))[0].rows
    of_gps = np.flatnonzero((rows.satellite >> 8 == ord("G")) & (rows.group == rows.group.min()))
    few = rows.satellite[of_gps[np.argsort(rows.elevation_rad[of_gps])][-6:]]
    at = 5 * RATE_HZ
    poor = [
        some_rows(epoch, np.isin(epoch.satellite, few) & (epoch.signal == signal_number("1C")))
        for epoch in rover[at:]
    ]
    carried = run([*rover[:at], *poor], drive().base, engine_of(drive(), CARRIED))
    alone = run([*rover[:at], *poor], drive().base, engine_of(drive()))
    fixed = sum(s.quality == "fixed" for s in carried[at:])
    assert fixed > sum(s.quality == "fixed" for s in alone[at:]) + 10
    assert np.nanmax(errors_m(carried, drive().true_ecef_m)) < WRONG_M
    assert all(s.estimate.status == RESOLVED for s in carried if s.quality == "fixed")

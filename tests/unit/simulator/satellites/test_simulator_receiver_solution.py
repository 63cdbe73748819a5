"""The receiver's own solution: what is right, what is wrong, and that the truth beside it says so."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import norm

from camber.formats.receiver.solution import SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.faults.radio_faults import RadioFaults, Spoofing
from camber.simulator.satellites.constellation import true_ephemerides
from camber.simulator.satellites.differenced_geometry import Screening, differenced_geometry, fitting
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER
from camber.simulator.satellites.receiver_solution import receiver_solutions
from camber.simulator.satellites.track import static_track
from camber.simulator.satellites.wrong_integers import shift_of, wrong_integers
from support.canyon_statistics import BASE_M, FRAME, canyon_run

BEGIN_NS = 1_461_000_000 * NS_PER_SECOND
SCREENING = Screening(float(np.deg2rad(15.0)), 33.0, 4.0, 4.0)
CANYONS = [canyon_run(seed, 1) for seed in range(1, 9)]


def standing(seconds):
    track = static_track(BEGIN_NS + np.arange(seconds, dtype=np.int64) * NS_PER_SECOND, (10.0, 20.0, 60.0))
    return track, true_ephemerides(BEGIN_NS, int(track.time_ns[-1]), 1)


def test_in_the_open_all_is_fixed_and_right():
    track, true = standing(60)
    rover = simulate_signals(track, FRAME, true, ROVER, 1, "rover")
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, 1, "base")
    found = receiver_solutions(rover, base, track, FRAME, 1)
    assert np.all(found.quality == SolutionQuality.FIX)
    assert not found.wrong_integers.any()
    assert np.max(np.abs(found.error_m)) < 0.08


def test_right_fixes_in_the_open_are_as_good_as_a_data_sheet_says():
    horizontal = []
    for seed in range(1, 9):
        track, true = standing(120)
        rover = simulate_signals(track, FRAME, true, ROVER, seed, "rover")
        base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, seed, "base")
        found = receiver_solutions(rover, base, track, FRAME, seed)
        horizontal.append(np.hypot(found.error_m[:, 0], found.error_m[:, 1]))
    assert 0.009 < np.median(horizontal) < 0.018
    assert np.quantile(horizontal, 0.95) < 0.04


def test_a_spoofed_fix_goes_where_the_signals_go_though_its_integers_are_right():
    track, true = standing(60)
    begin = BEGIN_NS + 20 * NS_PER_SECOND
    faults = RadioFaults(spoofing=(Spoofing(begin, BEGIN_NS + 60 * NS_PER_SECOND, (0.1, 0.0, 0.05)),))
    rover = simulate_signals(track, FRAME, true, ROVER, 1, "rover", faults=faults)
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, 1, "base")
    found = receiver_solutions(rover, base, track, FRAME, 1)
    since = np.maximum((track.time_ns - begin) / NS_PER_SECOND, 0.0)
    assert np.max(np.abs(found.error_m - since[:, None] * [0.1, 0.0, 0.05])) < 0.08
    assert not found.wrong_integers.any()


def test_in_canyons_wrong_fixes_come_in_episodes_that_the_truth_dates():
    fixed = wrong = episodes = 0
    for seed, (track, rover, base) in enumerate(CANYONS, start=1):
        found = receiver_solutions(rover, base, track, FRAME, seed)
        horizontal = np.hypot(found.error_m[:, 0], found.error_m[:, 1])
        right = (found.quality == SolutionQuality.FIX) & ~found.wrong_integers
        assert np.all(horizontal[right] < 0.5)
        assert np.all(found.quality[found.wrong_integers] == SolutionQuality.FIX)
        assert np.all((found.wrong_integers_since_ns >= 0) == found.wrong_integers)
        for since in np.unique(found.wrong_integers_since_ns[found.wrong_integers]):
            rows = np.nonzero(found.wrong_integers_since_ns == since)[0]
            assert track.time_ns[rows[0]] == since
            assert np.all(np.diff(rows) == 1)
            episodes += 1
        fixed += int(np.sum(found.quality == SolutionQuality.FIX))
        wrong += int(np.sum(found.wrong_integers))
    assert 0.1 < fixed / (8 * 120) < 0.8
    assert episodes >= 3
    assert 0.01 < wrong / fixed < 0.3


def test_solutions_carry_the_errors_that_the_truth_names():
    track, rover, base = CANYONS[0]
    found = receiver_solutions(rover, base, track, FRAME, 1)
    rows = np.nonzero(found.quality)[0]
    assert [s.time_ns for s in found.solutions] == track.time_ns[rows].tolist()
    place = FRAME.east_north_from_geodetic_array(
        [s.latitude_rad for s in found.solutions], [s.longitude_rad for s in found.solutions],
        [s.height_m for s in found.solutions],
    )  # fmt: skip
    height = np.array([s.height_m for s in found.solutions])
    said = np.column_stack((place, height)) - track.antenna_m[rows]
    assert np.max(np.abs(said - found.error_m[rows])) < 1e-6
    again = receiver_solutions(rover, base, track, FRAME, 1)
    assert again.solutions == found.solutions


def test_wrong_integers_move_the_position_as_the_double_differences_say():
    """Oracle: integers that are wrong by δ put into explicit double differences with their covariance."""
    tried = 0
    for _, rover, base in CANYONS:
        geometry = differenced_geometry(rover, base, 0.6, 0.006, SCREENING)
        for k in np.nonzero(geometry.ambiguities >= 8)[0][::10]:
            used, directions = geometry.phase_used[k], rover.geometry.direction[k]
            new = wrong_integers(
                directions, used, geometry.group, geometry.wavelength_m, geometry.code_normal[k], np.zeros(3), 0.6,
                0.006, np.random.default_rng(int(k)),
            )  # fmt: skip
            if new is None:
                continue
            assert new.offset_cycles.any()
            assert np.all(new.offset_cycles == np.rint(new.offset_cycles))
            assert not new.offset_cycles[~used].any()
            rows, covariance, right = [], [], []
            for g in np.unique(geometry.group[used]):
                sat, freq = np.nonzero(used & (geometry.group == g))
                d = np.hstack((-np.ones((len(sat) - 1, 1)), np.eye(len(sat) - 1)))
                rows.append(d @ -directions[sat])
                covariance.append(d @ d.T)
                right.append(d @ (new.offset_cycles[sat, freq] * geometry.wavelength_m[sat, freq]))
            size = sum(map(len, right))
            weight = np.zeros((size, size))
            at = 0
            for c in covariance:
                weight[at : at + len(c), at : at + len(c)] = np.linalg.inv(c)
                at += len(c)
            a, y = np.vstack(rows), np.concatenate(right)
            expected = np.linalg.solve(a.T @ weight @ a, a.T @ weight @ y)
            shift = shift_of(new.offset_cycles, directions, used, geometry.group, geometry.wavelength_m)
            assert shift == pytest.approx(expected, abs=1e-9)
            tried += 1
    assert tried >= 10


def double_differences(directions, used, group, unit_m):
    """Explicit ones: design matrix and covariance, both in units of `unit_m` (m, 2) for undifferenced noise of 1 m."""
    rows, noise = [], []
    for g in np.unique(group[used]):
        sat, freq = np.nonzero(used & (group == g))
        d = np.hstack((-np.ones((len(sat) - 1, 1)), np.eye(len(sat) - 1)))
        unit = unit_m[sat[0], freq[0]]
        rows.append(d @ -directions[sat] / unit)
        noise.append(d @ d.T / unit**2)
    return np.vstack(rows), block_diag(*noise)


def test_the_success_rate_is_that_of_explicit_double_differences():
    _, rover, base = CANYONS[1]
    geometry = differenced_geometry(rover, base, 0.6, 0.006, Screening(np.deg2rad(15.0)))
    for k in np.nonzero(geometry.ambiguities >= 5)[0][::15]:
        directions, group, waves = rover.geometry.direction[k], geometry.group, geometry.wavelength_m
        code, q_code = double_differences(directions, geometry.code_used[k], group, np.ones(waves.shape))
        phase, q_phase = double_differences(directions, geometry.phase_used[k], group, waves)
        q_x = np.linalg.inv(code.T @ np.linalg.inv(q_code * 0.6**2) @ code)
        q_a = q_phase * 0.006**2 + phase @ q_x @ phase.T
        adop = np.exp(np.linalg.slogdet(q_a)[1] / (2 * len(q_a)))
        assert len(q_a) == geometry.ambiguities[k]
        assert geometry.success[k] == pytest.approx((2 * norm.cdf(0.5 / adop) - 1) ** len(q_a), abs=1e-4)


def seen_from(directions, used, error_m, limit_m):
    group = np.tile([0, 1], (len(directions), 1))
    return fitting(directions[None], used[None], group, error_m[None], limit_m)


def random_sky(rng, count):
    up = rng.uniform(0.3, 0.95, count)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    level = np.sqrt(1.0 - up**2)
    return np.column_stack((level * np.cos(turn), level * np.sin(turn), up))


def test_what_does_not_fit_the_rest_is_left_out_without_asking_the_truth():
    rng = np.random.default_rng(7)
    for _ in range(20):
        directions = random_sky(rng, 9)
        error = rng.normal(0.0, 0.003, (9, 2))
        bad = int(rng.integers(9))
        error[bad, 0] += 0.2
        used, fits = seen_from(directions, np.ones((9, 2), np.bool_), error, 0.024)
        expected = np.ones((9, 2), np.bool_)
        expected[bad, 0] = False
        assert fits[0]
        assert np.array_equal(used[0], expected)


def test_an_error_that_looks_like_a_shift_or_a_clock_is_not_seen():
    rng = np.random.default_rng(8)
    directions = random_sky(rng, 9)
    # All signals agree on a place three metres off and on clocks of their own: no receiver could tell.
    shifted = np.repeat((-directions @ [2.0, -1.0, 2.0])[:, None], 2, axis=1)
    error = shifted + np.array([5.0, -40.0])
    used, fits = seen_from(directions, np.ones((9, 2), np.bool_), error, 0.024)
    assert fits[0]
    assert used.all()


def test_residuals_are_those_of_explicit_double_differences():
    """Oracle: with one group, the statistic is Baarda's w of double differences with their covariance."""
    rng = np.random.default_rng(9)
    directions, error = random_sky(rng, 7), rng.normal(0.0, 1.0, (7, 1))
    group = np.zeros((7, 1), np.int64)
    d = np.hstack((-np.ones((6, 1)), np.eye(6)))
    a, y, weight = d @ -directions, d @ error[:, 0], np.linalg.inv(d @ d.T)
    left = weight @ (y - a @ np.linalg.solve(a.T @ weight @ a, a.T @ weight @ y))
    spread = weight - weight @ a @ np.linalg.solve(a.T @ weight @ a, a.T @ weight)
    w = np.abs(d.T @ left) / np.sqrt(np.diag(d.T @ spread @ d))
    worst = int(np.argmax(w))
    for limit, kept in ((float(w[worst]) * 1.001, True), (float(w[worst]) * 0.999, False)):
        used, _ = fitting(directions[None], np.ones((1, 7, 1), np.bool_), group, error[None], limit)
        assert used[0, worst, 0] == kept

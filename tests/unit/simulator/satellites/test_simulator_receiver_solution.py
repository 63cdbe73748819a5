"""The receiver's own solution: what is right, what is wrong, and that the truth beside it says so."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import norm

from camber.formats.receiver.solution import SolutionQuality
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.injected_faults import Spoofing
from camber.simulator.satellites.constellation import true_ephemerides
from camber.simulator.satellites.differenced_geometry import differenced_geometry, fitting
from camber.simulator.satellites.observations import simulate_signals
from camber.simulator.satellites.parameters import BASE, ROVER, SolutionParameters
from camber.simulator.satellites.receiver_solution import receiver_solutions
from camber.simulator.satellites.track import static_track
from camber.simulator.satellites.wrong_integers import PhaseSignals, shift_of, wrong_integers
from support.canyon_statistics import BASE_M, FRAME, canyon_run

BEGIN_NS = 1_461_000_000 * NS_PER_SECOND
ENGINE = SolutionParameters()
CANYONS = [canyon_run(seed, 1) for seed in range(1, 9)]


def standing(seconds):
    track = static_track(BEGIN_NS + np.arange(seconds, dtype=np.int64) * NS_PER_SECOND, (10.0, 20.0, 60.0))
    return track, true_ephemerides(BEGIN_NS, int(track.time_ns[-1]), 1)


def in_the_open(seconds, seed, *faults):
    track, true = standing(seconds)
    rover = simulate_signals(track, FRAME, true, ROVER, seed, "rover", faults=faults)
    base = simulate_signals(static_track(track.time_ns, BASE_M), FRAME, true, BASE, seed, "base")
    return track, receiver_solutions(rover, base, track, FRAME, seed)


def test_right_fixes_in_the_open_are_as_good_as_in_a_data_sheet():
    made = [in_the_open(120, seed)[1] for seed in range(1, 9)]
    horizontal = [np.hypot(one.error_m[:, 0], one.error_m[:, 1]) for one in made]
    assert all((one.quality == SolutionQuality.FIX).all() for one in made)
    assert not any(one.wrong_integers.any() for one in made)
    assert max(np.abs(one.error_m).max() for one in made) < 0.11
    assert 0.009 < np.median(horizontal) < 0.018
    assert np.quantile(horizontal, 0.95) < 0.04


def test_a_spoofed_fix_goes_where_the_signals_go_though_its_integers_are_right():
    spoof = Spoofing(kind="spoofing", onset_s=20.0, end_s=60.0, east_m_s=0.1, up_m_s=0.05)
    track, made = in_the_open(60, 1, spoof)
    since = np.maximum((track.time_ns - BEGIN_NS) / NS_PER_SECOND - 20.0, 0.0)
    assert np.max(np.abs(made.error_m - since[:, None] * [0.1, 0.0, 0.05])) < 0.08
    assert not made.wrong_integers.any()


def test_in_canyons_wrong_fixes_come_in_episodes():
    fixed = wrong = episodes = 0
    for seed, (track, rover, base) in enumerate(CANYONS, start=1):
        made = receiver_solutions(rover, base, track, FRAME, seed)
        horizontal = np.hypot(made.error_m[:, 0], made.error_m[:, 1])
        is_fix = made.quality == SolutionQuality.FIX
        assert np.all(horizontal[is_fix & ~made.wrong_integers] < 0.5)
        assert np.all(is_fix[made.wrong_integers])
        episodes += int(np.sum(np.diff(made.wrong_integers.astype(int), prepend=0) == 1))
        fixed += int(is_fix.sum())
        wrong += int(made.wrong_integers.sum())
    assert 0.1 < fixed / (8 * 120) < 0.8
    assert episodes >= 3
    assert 0.01 < wrong / fixed < 0.3


def test_solutions_carry_the_errors_of_the_truth():
    track, rover, base = CANYONS[0]
    made = receiver_solutions(rover, base, track, FRAME, 1)
    rows = np.nonzero(made.quality)[0]
    assert [s.time_ns for s in made.solutions] == track.time_ns[rows].tolist()
    latitude, longitude, height = np.array(
        [(s.latitude_rad, s.longitude_rad, s.height_m) for s in made.solutions]
    ).T
    place = FRAME.east_north_from_geodetic_array(latitude, longitude, height)
    reported = np.column_stack((place, height)) - track.antenna_m[rows]
    assert np.max(np.abs(reported - made.error_m[rows])) < 1e-6
    assert receiver_solutions(rover, base, track, FRAME, 1).solutions == made.solutions


def test_wrong_integers_move_the_position_as_in_double_differences():
    """Oracle: integers that are wrong by δ put into explicit double differences with their covariance."""
    tried = 0
    for _, rover, base in CANYONS:
        geometry = differenced_geometry(rover, base, ENGINE)
        for k in np.nonzero(geometry.ambiguities >= 8)[0][::10]:
            signals = PhaseSignals(
                directions=rover.geometry.direction[k],
                used=geometry.phase_used[k],
                group=geometry.group,
                wavelength_m=geometry.wavelength_m,
            )
            rng = np.random.default_rng(int(k))
            new = wrong_integers(signals, geometry.code_normal[k], np.zeros(3), engine=ENGINE, rng=rng)
            if new is None:
                continue
            offset, _ = new
            assert offset.any()
            assert np.all(offset == np.rint(offset))
            assert not offset[~signals.used].any()
            ones = np.ones(signals.used.shape)
            a, q = double_differences(signals.directions, signals.used, signals.group, ones)
            length = offset * signals.wavelength_m
            y = np.concatenate([d @ length[at] for d, at in differences(signals.used, signals.group)])
            weight = np.linalg.inv(q)
            expected = np.linalg.solve(a.T @ weight @ a, a.T @ weight @ y)
            assert shift_of(offset, signals) == pytest.approx(expected, abs=1e-9)
            tried += 1
    assert tried >= 10


def differences(used, group):
    """For each group the matrix that differences its signals to the first, and which signals they are."""
    for g in np.unique(group[used]):
        at = np.nonzero(used & (group == g))
        count = len(at[0]) - 1
        yield np.hstack((-np.ones((count, 1)), np.eye(count))), at


def double_differences(directions, used, group, unit_m):
    """Explicit ones: design matrix and covariance, both in units of `unit_m` (m, 2) for undifferenced noise of 1 m."""
    rows, noise = [], []
    for d, at in differences(used, group):
        unit = unit_m[at[0][0], at[1][0]]
        rows.append(d @ -directions[at[0]] / unit)
        noise.append(d @ d.T / unit**2)
    return np.vstack(rows), block_diag(*noise)


def test_the_success_rate_is_that_of_explicit_double_differences():
    _, rover, base = CANYONS[1]
    plain = replace(ENGINE, cn0_mask_dbhz=0.0, sigmas_left_out=np.inf)
    geometry = differenced_geometry(rover, base, plain)
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
    return fitting(directions[None], used[None], group, error_m=error_m[None], limit_m=limit_m)


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
    # All signals agree on a place three metres off and on clocks of each group: no receiver could see it.
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
        used, _ = fitting(
            directions[None], np.ones((1, 7, 1), np.bool_), group, error_m=error[None], limit_m=limit
        )
        assert used[0, worst, 0] == kept

"""Single differences of simulated receivers without errors, and what masks, age and weights do to them."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from camber.formats.observations import SPEED_OF_LIGHT_M_S, Ephemeris, ObservationEpoch
from camber.gnss.observations.differenced_observations import (
    Masks,
    Noise,
    ReceiverAtEpoch,
    SingleDifferences,
    single_differences,
    variance_m2,
    without_clocks,
)
from camber.gnss.observations.satellite_states import SatelliteStates, states_at_transmission
from camber.gnss.observations.signal_pairs import GROUPS, columns_of, pair_signals
from support.engine_drives import base_ecef_m, open_sky_drive, store_of
from support.single_difference_rows import made_up_rows

ALL = np.ones(GROUPS, np.bool_)
NO_MASKS = Masks(0.0, 0.0)


@functools.cache
def drive():
    return open_sky_drive(seed=3, seconds=4)


def rows_of(rover, base, store, at_m, masks=NO_MASKS, without=0) -> SingleDifferences:
    """All rows of two epochs against a position of the rover; satellites of a number are not known where."""
    usable, base_usable = (np.full(e.satellite.size, 2) for e in (rover, base))
    pairs = pair_signals(columns_of(rover), usable, columns_of(base), base_usable=base_usable, groups=ALL)
    satellite, place = np.unique(rover.satellite, return_inverse=True)
    known = store.rows_at(rover.time_ns, satellite)
    known[satellite == without] = -1

    def states(epoch: ObservationEpoch) -> SatelliteStates:
        of_satellite = dict(
            zip(epoch.satellite[::-1].tolist(), epoch.pseudorange_m[::-1].tolist(), strict=True)
        )
        code = np.array([of_satellite.get(number, np.nan) for number in satellite.tolist()])
        return states_at_transmission(store.table, known, epoch.time_ns, code)

    return single_differences(
        pairs._replace(place=place[pairs.rover]),
        ReceiverAtEpoch(columns_of(rover), states(rover), at_m),
        ReceiverAtEpoch(columns_of(base), states(base), base_ecef_m()),
        noise=Noise(),
        masks=masks,
    )


def left_in_groups(rows: SingleDifferences, values: np.ndarray) -> np.ndarray:
    """What remains when each group's median is taken off."""
    left = values.copy()
    for g in np.unique(rows.group):
        left[rows.group == g] -= np.median(left[rows.group == g])
    return left


def test_at_the_true_position_codes_differ_by_the_groups_clock_and_their_noise_only():
    d = drive()
    for rover, base, truth in zip(d.rover, d.base, d.true_ecef_m, strict=True):
        rows = rows_of(rover, base, d.store, truth)
        assert rows.group.size > 40
        left = left_in_groups(rows, rows.code_m)
        assert np.median(np.abs(left)) < 0.8
        assert np.mean(left**2 / rows.code_variance_m2) < 2.5


def test_phases_of_a_group_differ_by_whole_cycles():
    d = drive()
    rows = rows_of(d.rover[0], d.base[0], d.store, d.true_ecef_m[0], Masks(np.deg2rad(15.0), 0.0))
    for g in np.unique(rows.group):
        cycles = (rows.phase_m / rows.wavelength_m)[rows.group == g]
        apart = cycles - cycles[np.argmax(rows.elevation_rad[rows.group == g])]
        # Signals without a pilot may be off by a half for a while, and say so.
        sound = ~d.rover[0].half_cycle[rows.rover] & ~d.base[0].half_cycle[rows.base]
        assert np.abs(apart - np.rint(apart))[sound[rows.group == g]].max() < 0.2


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_step_of_the_approximate_position_moves_the_rows_along_their_directions(axis):
    d = drive()
    step = np.eye(3)[axis] * 5.0
    at, moved_rows = (
        rows_of(d.rover[0], d.base[0], d.store, d.true_ecef_m[0] + m) for m in (np.zeros(3), step)
    )
    moved = (moved_rows.code_m - at.code_m) + at.direction @ step
    # 5 m of height are up to 1.6 mm of the troposphere, over the sine of the elevation.
    assert np.abs(moved * np.sin(at.elevation_rad)).max() < 0.002
    np.testing.assert_allclose(moved_rows.phase_m - at.phase_m, moved_rows.code_m - at.code_m, atol=1e-6)


def test_a_base_seconds_older_than_the_rover_is_no_error_but_that_of_clocks_and_noise():
    d = drive()
    rover, truth = d.rover[3], d.true_ecef_m[3]
    now = rows_of(rover, d.base[3], d.store, truth)
    old = rows_of(rover, d.base[0], d.store, truth)
    moved = left_in_groups(now, now.phase_m - old.phase_m)
    # Satellites move by kilometres in the meantime; centimetres of the base's own phase noise are left.
    whole = np.rint(moved / now.wavelength_m) * now.wavelength_m
    assert np.abs(moved - whole).max() < 0.05
    assert np.median(np.abs(moved)) < 0.01
    grown = old.phase_variance_m2 - now.phase_variance_m2
    assert np.median(grown) == pytest.approx((SPEED_OF_LIGHT_M_S * 5e-12 * 3.0) ** 2, rel=0.3)


def test_a_satellites_clock_that_runs_fast_between_base_and_rover_is_taken_off():
    """All clocks 1e-9 faster than they were, in what they broadcast and in what is measured: 0.9 m in 3 s."""
    d = drive()
    toc_ns = d.rover[0].time_ns - 1_000_000_000_000

    def faster(e: Ephemeris) -> Ephemeris:
        offset, rate, change = e.clock
        return replace(e, clock=(offset + 1e-9 * (e.toc_ns - toc_ns) * 1e-9, rate + 1e-9, change))

    def measured(epoch: ObservationEpoch) -> ObservationEpoch:
        early_m = SPEED_OF_LIGHT_M_S * 1e-9 * (epoch.time_ns - toc_ns) * 1e-9
        return replace(epoch, pseudorange_m=epoch.pseudorange_m - early_m)

    rover, base, truth = d.rover[3], d.base[0], d.true_ecef_m[3]
    before = rows_of(rover, base, d.store, truth)
    after = rows_of(measured(rover), measured(base), store_of(map(faster, d.ephemerides)), truth)
    np.testing.assert_allclose(after.code_m, before.code_m, atol=0.005)


def test_elevations_are_those_of_the_directions():
    d = drive()
    rows = rows_of(d.rover[0], d.base[0], d.store, d.true_ecef_m[0])
    up = d.true_ecef_m[0] / np.linalg.norm(d.true_ecef_m[0])
    np.testing.assert_allclose(np.sin(rows.elevation_rad), -rows.direction @ up, atol=0.004)


def test_what_is_low_weak_or_not_known_is_left_out_and_changes_no_other_row():
    d = drive()
    full = rows_of(d.rover[0], d.base[0], d.store, d.true_ecef_m[0])
    for masks, without, stays in (
        (Masks(np.deg2rad(30.0), 0.0), 0, full.elevation_rad >= np.deg2rad(30.0)),
        (Masks(0.0, 44.0), 0, full.cn0_dbhz >= 44.0),
        (NO_MASKS, int(full.satellite[5]), full.satellite != full.satellite[5]),
    ):
        some = rows_of(d.rover[0], d.base[0], d.store, d.true_ecef_m[0], masks, without=without)
        assert 0 < stays.sum() < stays.size
        for name in SingleDifferences._fields[:-1]:
            np.testing.assert_array_equal(getattr(some, name), getattr(full, name)[stays])


@pytest.mark.parametrize("at_m", [(0.0, 0.0, 0.0), (np.nan,) * 3, (1e12, 0.0, 0.0), (6.0e6, 0.0, 0.0)])
def test_a_position_where_no_receiver_can_be_has_no_rows(at_m):
    d = drive()
    rows = rows_of(d.rover[0], d.base[0], d.store, np.array(at_m))
    assert rows.group.size == 0 or at_m == (6.0e6, 0.0, 0.0)


def test_what_the_air_does_to_a_fix_grows_with_the_baseline():
    d = drive()
    for away in (0.0, 1.0):
        at = base_ecef_m() + away * (d.true_ecef_m[0] - base_ecef_m())
        covariance = rows_of(d.rover[0], d.base[0], d.store, at).atmosphere_m2
        up = at / np.linalg.norm(at)
        baseline_m = np.linalg.norm(at - base_ecef_m())
        assert np.sqrt(up @ covariance @ up) == pytest.approx(2e-6 * baseline_m, rel=1e-3, abs=1e-12)
        assert np.sqrt(np.trace(covariance)) == pytest.approx(np.sqrt(6.0) * 1e-6 * baseline_m, abs=1e-12)


def test_variances_grow_as_the_signal_sinks_and_weakens():
    assert variance_m2(0.2, 0.3, 1.0, 45.0) == pytest.approx(0.2**2 + 0.3**2)
    assert variance_m2(0.2, 0.3, 0.5, 45.0) == pytest.approx(0.4**2 + 0.3**2)
    assert variance_m2(0.2, 0.3, 1.0, 25.0) == pytest.approx(0.2**2 + 3.0**2)
    assert variance_m2(0.2, 0.3, 1.0, np.nan) == variance_m2(0.2, 0.3, 1.0, 40.0)


def test_a_group_less_its_mean_has_no_clock_and_weights_of_nothing_take_no_part():
    rows = made_up_rows(np.random.default_rng(1)).rows
    weights = np.random.default_rng(2).uniform(0.5, 2.0, rows.group.size)
    weights[::5] = 0.0
    directions, values, total = without_clocks(rows, rows.code_m, weights)
    shifted = rows.code_m + 1e4 * rows.group
    np.testing.assert_allclose(without_clocks(rows, shifted, weights)[1], values, atol=1e-6)
    for g in np.unique(rows.group):
        inside = (rows.group == g) & (weights > 0)
        assert total[inside][0] == pytest.approx(weights[inside].sum())
        assert weights[inside] @ values[inside] == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(weights[inside] @ directions[inside], 0.0, atol=1e-9)
    assert not values[::5].any()

"""Offset of a base's coordinate over minutes and days: minutes average hardly anything, days do down to a floor."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.base_offset import (
    DAILY_FLOOR_M,
    LARGEST_CHI2,
    OffsetWindow,
    enu_rotation,
    offset_over_days,
)
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.position.single_point import single_point
from support.engine_drives import base_ecef_m
from support.gnss_files import read_navigation, read_observations, recorded_place_m, recording

BASE_M = base_ecef_m()
TO_ENU = enu_rotation(BASE_M)


def window(misses_enu_m, sigma_m=(1.0, 1.0, 5.0), every_s=10):
    of = OffsetWindow()
    covariance_m2 = TO_ENU.T @ np.diag(np.square(sigma_m)) @ TO_ENU
    for k, miss_m in enumerate(misses_enu_m):
        of.add(k * every_s * NS_PER_SECOND, TO_ENU.T @ np.array(miss_m), covariance_m2)
    return of.offset(BASE_M)


def test_a_minute_gives_the_mean_with_the_sigma_of_one_epoch():
    assert window([(3.0, 0.0, 0.0)] * 5) is None
    offset = window([(3.0, -1.0, 2.0), (5.0, -1.0, 2.0)] * 3)
    assert offset.enu_m == pytest.approx((4.0, -1.0, 2.0))
    assert offset.sigma_m == pytest.approx((1.0, 1.0, 5.0))
    assert offset.chi2 == pytest.approx(16.0 + 1.0 + 4.0 / 25.0)
    assert window([(4.0, -1.0, 2.0)] * 60).sigma_m == pytest.approx((1.0, 1.0, 5.0))


def test_samples_closer_than_ten_seconds_and_older_than_ten_minutes_do_not_count():
    assert window([(3.0, 0.0, 0.0)] * 50, every_s=1) is None
    assert window([(30.0, 0.0, 0.0)] * 60 + [(3.0, 0.0, 0.0)] * 60).enu_m[0] == pytest.approx(3.0)


def test_a_cleared_window_begins_anew():
    of = OffsetWindow()
    for k in range(10):
        of.add(k * 10 * NS_PER_SECOND, np.ones(3), np.eye(3))
    of.clear()
    assert of.offset(BASE_M) is None


@pytest.mark.parametrize(
    ("days", "east_m", "is_wrong"), [(2, 6.0, True), (2, 4.0, False), (20, 3.5, True), (20, 2.0, False)]
)
def test_days_lower_what_is_detected_to_a_few_metres(days, east_m, is_wrong):
    """At σ 1.1 m of a day: 6 √(0.25 + 1.21 / D), which is 5.5 m for two days and 3.3 m for twenty."""
    offset = offset_over_days([((east_m, 0.0, 0.0), (1.1, 1.1, 4.9))] * days)
    assert (offset.is_wrong, offset.windows) == (is_wrong, days)
    assert offset_over_days([((99.0, 0.0, 0.0), (1.1, 1.1, 4.9))]) is None


vectors = st.tuples(*[st.floats(-50.0, 50.0)] * 3)
sigmas = st.tuples(*[st.floats(0.1, 20.0)] * 3)


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(vectors, sigmas), min_size=2, max_size=32))
def test_no_number_of_days_goes_below_the_floor_and_less_offset_is_never_worse(days):
    offset = offset_over_days(days)
    assert all(sigma >= floor for sigma, floor in zip(offset.sigma_m, DAILY_FLOOR_M, strict=True))
    half = offset_over_days([(tuple(0.5 * e for e in enu), sigma) for enu, sigma in days])
    assert half.chi2 <= offset.chi2
    assert offset.is_wrong is (offset.chi2 > LARGEST_CHI2)


@pytest.mark.parametrize("name", ["rooftop", "fujisawa"])
def test_on_recordings_the_mean_is_within_two_sigma_and_the_scatter_is_not_its_error(name):
    if name == "rooftop":
        at = recording("rooftop-2024-06-24")
        base_m, files = recorded_place_m(at / "base_position.txt"), ("base.obs", "base.nav")
    else:
        at = recording("fujisawa-2021-09-22")
        base_m, files = np.array([-3959400.631, 3385704.533, 3667523.111]), ("3034265G.21O", "SEPT2650.21P")
    navigation = read_navigation(at / files[1])
    store, of, misses_m = EphemerisStore(1000), OffsetWindow(), []
    for ephemeris in navigation.ephemerides:
        store.add(ephemeris)
    klobuchar = navigation.klobuchar["G"]
    for epoch in read_observations(at / files[0]).epochs:
        solution = single_point(epoch, store, ionosphere=np.array([*klobuchar.alpha, *klobuchar.beta]))
        miss_m = solution.position_ecef_m - base_m
        of.add(epoch.time_ns, miss_m, solution.covariance_ecef_m2)
        misses_m.append(enu_rotation(base_m) @ miss_m)
    offset, scatter_m = of.offset(base_m), np.std(misses_m, axis=0)
    print(
        f"{name}: mean {np.round(offset.enu_m, 2)}, σ {np.round(offset.sigma_m, 2)}, scatter {scatter_m.round(2)}"
    )
    assert not offset.is_wrong
    assert (np.abs(offset.enu_m) < 2.0 * np.array(offset.sigma_m)).all()
    assert np.hypot(*scatter_m[:2]) < 0.5 * np.hypot(*offset.enu_m[:2]) + 0.1

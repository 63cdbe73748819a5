"""Delays of the atmosphere: known values, and no jumps that would look like slips of the phase."""

import numpy as np
import pytest

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.satellites.atmosphere import Atmosphere, klobuchar_m, saastamoinen_m, shell_mapping

DAY_S = np.arange(0.0, 86400.0, 5.0)


def over_a_day(elevation_deg: float) -> np.ndarray:
    n = len(DAY_S)
    place = np.full(n, np.deg2rad(35.0)), np.full(n, np.deg2rad(137.0))
    angles = np.full((n, 1), 2.0), np.full((n, 1), np.deg2rad(elevation_deg))
    return klobuchar_m((DAY_S * NS_PER_SECOND).astype(np.int64), *place, *angles)[:, 0]


def test_the_ionosphere_is_five_nanoseconds_at_night_most_after_noon_and_never_jumps():
    delay = over_a_day(90.0)
    assert np.min(delay) == pytest.approx(299792458.0 * 5e-9, rel=0.01)
    peak_local_h = (DAY_S[np.argmax(delay)] / 3600.0 + 137.0 / 15.0) % 24.0
    assert peak_local_h == pytest.approx(14.0, abs=0.2)
    assert 2.0 < np.max(delay) < 12.0
    assert np.max(np.abs(np.diff(over_a_day(20.0)))) < 0.01


def test_the_troposphere_is_the_standard_one():
    zenith = saastamoinen_m(np.zeros(1), np.zeros(1), np.full((1, 1), 0.5 * np.pi), 0.0)[0, 0]
    assert zenith == pytest.approx(0.0022768 * 1013.25 / (1 - 0.00266), rel=1e-6)
    wet = saastamoinen_m(np.zeros(1), np.zeros(1), np.full((1, 1), 0.5 * np.pi), 0.7)[0, 0] - zenith
    assert 0.05 < wet < 0.2
    lower, higher = (
        saastamoinen_m(np.zeros(1), np.array([h]), np.full((1, 1), 0.5), 0.7)[0, 0] for h in (0, 500)
    )
    assert lower > higher
    assert shell_mapping(np.array([0.5 * np.pi]))[0] == pytest.approx(1.0)


def test_gradients_are_what_rover_and_base_differ_by():
    quiet = Atmosphere(
        ionosphere_scale=1.0,
        gradient_m_per_m=(2e-6, 0.0),
        humidity=0.7,
        wet_zenith_m=0.0,
        wet_gradient_m_per_m=(0.0, 0.0),
    )
    time_ns = np.zeros(2, np.int64)
    same = np.full(2, 0.6), np.full(2, 2.4), np.zeros(2)
    angles = np.zeros((2, 1)), np.full((2, 1), 0.5 * np.pi)
    ionosphere, troposphere = quiet.delays_m(time_ns, same, np.array([[0.0, 0.0], [3000.0, 0.0]]), angles)
    assert ionosphere[1, 0] - ionosphere[0, 0] == pytest.approx(6e-3, rel=1e-6)
    assert troposphere[1, 0] == troposphere[0, 0]
    assert Atmosphere.drawn(4) == Atmosphere.drawn(4) != Atmosphere.drawn(5)

"""Delays by the atmosphere against other implementations and published figures."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.gnss.observations.atmosphere import (
    klobuchar_m,
    slant_troposphere_m,
    troposphere_at,
    zenith_delays_m,
)
from camber.simulator.satellites import atmosphere as simulated

COEFFICIENTS = np.array([*simulated.KLOBUCHAR_ALPHA, *simulated.KLOBUCHAR_BETA])
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


def troposphere_m(latitude_rad: float, height_m: float, elevation_rad: float) -> float:
    sine = math.sin(elevation_rad) if math.isfinite(elevation_rad) else math.nan
    return slant_troposphere_m(troposphere_at(latitude_rad, height_m), sine)


def test_the_delay_of_the_zenith_is_saastamoinens():
    for latitude, height in ((0.0, 0.0), (0.6, 100.0), (-1.2, 4000.0)):
        up = np.array([[math.pi / 2]])
        expected = simulated.saastamoinen_m(np.array([latitude]), np.array([height]), up, 0.7)
        assert troposphere_m(latitude, height, math.pi / 2) == pytest.approx(expected[0, 0], abs=1e-6)


def test_a_hydrostatic_delay_at_sea_level_is_2_31_m_and_decreases_with_height():
    dry, wet = zenith_delays_m(math.radians(45.0), 0.0)
    assert dry == pytest.approx(2.307, abs=0.002)
    assert 0.05 < wet < 0.3
    assert zenith_delays_m(math.radians(45.0), 1000.0)[0] == pytest.approx(2.307 - 0.26, abs=0.02)


@pytest.mark.parametrize(("elevation_deg", "factor"), [(5.0, 10.15), (15.0, 3.80)])
def test_low_satellites_are_mapped_as_by_niell(elevation_deg, factor):
    # Niell 1996: 10.15 at 5°, 3.80 at 15° for the hydrostatic part of the middle latitudes.
    air = troposphere_at(math.radians(45.0), 0.0)._replace(wet_m=0.0)
    slant = slant_troposphere_m(air, math.sin(math.radians(elevation_deg)))
    assert slant / air.dry_m == pytest.approx(factor, rel=0.003)


def test_the_mapping_stays_within_a_few_millimetres_of_the_cosecant_above_60_degrees():
    zenith = troposphere_m(0.6, 50.0, math.pi / 2)
    for elevation in np.deg2rad([60.0, 75.0, 90.0]).tolist():
        cosecant = 1.0 / math.sin(elevation)
        assert troposphere_m(0.6, 50.0, elevation) == pytest.approx(zenith * cosecant, abs=0.004)


def test_klobuchars_delay_is_that_of_the_simulator():
    rng = np.random.default_rng(20)
    for _ in range(300):
        time_ns = int(rng.integers(0, 604_800)) * 10**9
        latitude, longitude = rng.uniform(-1.4, 1.4), rng.uniform(-math.pi, math.pi)
        elevation, azimuth = rng.uniform(0.1, math.pi / 2), rng.uniform(-math.pi, math.pi)
        expected = simulated.klobuchar_m(
            np.array([time_ns]), np.array([latitude]), np.array([longitude]), np.array([[azimuth]]),
            np.array([[elevation]]),
        )[0, 0]  # fmt: skip
        delay = klobuchar_m(COEFFICIENTS, time_ns / 1e9, latitude, longitude, elevation, azimuth)
        # The document's series of the cosine is up to 2 % of the amplitude off at the edge of night: 3 ns, slanted.
        assert delay == pytest.approx(expected, abs=0.25)


def test_the_night_is_five_nanoseconds():
    delay = klobuchar_m(COEFFICIENTS, 0.0, 0.0, 0.0, math.pi / 2, 0.0)
    assert delay == pytest.approx(299792458.0 * 5e-9 * (1.0 + 16.0 * 0.03**3))


@pytest.mark.parametrize("height_m", [-501.0, -500.0, 0.0, 9000.0, 9001.0, math.nan, math.inf])
def test_beyond_the_standard_atmosphere_no_delay_is_known_within_it_one_is(height_m):
    air = troposphere_at(0.6, height_m)
    assert air.known == (-500.0 <= height_m <= 9000.0)
    assert slant_troposphere_m(air, 0.7) > 1.0 if air.known else slant_troposphere_m(air, 0.7) == 0.0


@pytest.mark.parametrize(
    "coefficients", [np.zeros(0), np.full(8, np.nan), np.r_[COEFFICIENTS[:7], np.nan], COEFFICIENTS[:4]]
)
def test_without_coefficients_there_is_no_ionosphere(coefficients):
    assert klobuchar_m(coefficients, 50400.0, 0.6, 2.4, 1.0, 1.0) == 0.0


@settings(derandomize=True, max_examples=300)
@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_whatever_the_numbers_delays_are_finite_and_not_negative(a, b, c, d, e):
    assert 0.0 <= troposphere_m(a, b, c) < 1e3
    assert 0.0 <= klobuchar_m(COEFFICIENTS, a, b, c, d, e) < 1e4


def test_higher_up_low_satellites_are_mapped_a_little_steeper():
    # Niell 1996, eq. 6: 1/sin 5° less the fraction of the three heights' coefficients, 0.022 a km.
    sine = math.sin(math.radians(5.0))
    low, high = (troposphere_at(math.radians(45.0), h)._replace(wet_m=0.0) for h in (0.0, 2000.0))
    steeper = slant_troposphere_m(high, sine) / high.dry_m - slant_troposphere_m(low, sine) / low.dry_m
    a, b, c = 2.53e-5, 5.49e-3, 1.14e-3
    norm = 1.0 + a / (1.0 + b / (1.0 + c))
    fraction = norm / (sine + a / (sine + b / (sine + c)))
    assert steeper == pytest.approx(2.0 * (1.0 / sine - fraction), rel=1e-9)
    assert steeper == pytest.approx(0.0439, abs=1e-4)

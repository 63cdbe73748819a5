"""Delay of code by ionosphere and troposphere, from models; compiled, one satellite a call.

Sources: IS-GPS-200N, 20.3.3.5.2.5 and figure 20-4 (ionosphere, J. Klobuchar's model); J. Saastamoinen, "Contributions
to the theory of atmospheric refraction", Bulletin géodésique 105 to 107 (1972-73), with the gravity term of J. Davis
et al., "Geodesy by radio interferometry", Radio Science 20 (1985), A11 (zenith delays); standard atmosphere as in
RTKLIB manual 2.4.2, E.5 (1), humidity 0.7; A. Niell, "Global mapping functions for the atmosphere delay at radio
wavelengths", J. Geophys. Res. 101 (1996), tables 3 and 4 (mapping; without the season, 2 mm at 15°).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats

IONOSPHERE_CARRIER_HZ = 1575.42e6
"""GPS L1 (IS-GPS-200N); the delay on another carrier f is (this / f)² times as much."""
LOWEST_HEIGHT_M, GREATEST_HEIGHT_M = -500.0, 9000.0  # chosen: all roads
LOWEST_ELEVATION_RAD = math.radians(2.0)
"""Lower elevations get the delay of this one: the models do not hold there."""

_LOWEST_SINE = math.sin(LOWEST_ELEVATION_RAD)
_NIELL_STEP_RAD = math.radians(15.0)
# By latitude 15°, 30°, … 75°: a, b, c of the hydrostatic part (mean of the year) and of the wet one.
_HYDROSTATIC = np.array([
    [1.2769934e-3, 2.9153695e-3, 62.610505e-3],
    [1.2683230e-3, 2.9152299e-3, 62.837393e-3],
    [1.2465397e-3, 2.9288445e-3, 63.721774e-3],
    [1.2196049e-3, 2.9022565e-3, 63.824265e-3],
    [1.2045996e-3, 2.9024912e-3, 64.258455e-3],
])  # fmt: skip
_WET = np.array([
    [5.8021897e-4, 1.4275268e-3, 4.3472961e-2],
    [5.6794847e-4, 1.5138625e-3, 4.6729510e-2],
    [5.8118019e-4, 1.4572752e-3, 4.3908931e-2],
    [5.9727542e-4, 1.5007428e-3, 4.4626982e-2],
    [6.1641693e-4, 1.7599082e-3, 5.4736038e-2],
])  # fmt: skip
_PER_HEIGHT = (2.53e-5, 5.49e-3, 1.14e-3)


class Troposphere(NamedTuple):
    """Zenith delays and mapping coefficients at one position.

    `known` is false, and every slant delay zero, for a height outside −500 m to 9000 m or a NaN position.
    """

    known: bool
    dry_m: float
    wet_m: float
    height_m: float
    dry_mapping: tuple[float, float, float]
    wet_mapping: tuple[float, float, float]


@compiled
def troposphere_at(latitude_rad: float, height_m: float) -> Troposphere:
    """Standard atmosphere at a latitude and an ellipsoidal height."""
    known = LOWEST_HEIGHT_M <= height_m <= GREATEST_HEIGHT_M and abs(latitude_rad) <= 0.5 * np.pi + 1e-9
    if not known:
        latitude_rad, height_m = 0.0, 0.0
    dry_m, wet_m = zenith_delays_m(latitude_rad, height_m)
    place = min(max(abs(latitude_rad) / _NIELL_STEP_RAD - 1.0, 0.0), 3.999999)
    row = int(place)
    part = place - row
    return Troposphere(
        known=known,
        dry_m=dry_m,
        wet_m=wet_m,
        height_m=height_m,
        dry_mapping=_interpolated(_HYDROSTATIC, row, part),
        wet_mapping=_interpolated(_WET, row, part),
    )


@compiled
def _interpolated(table: Floats, row: int, part: float) -> tuple[float, float, float]:
    return (
        table[row, 0] + part * (table[row + 1, 0] - table[row, 0]),
        table[row, 1] + part * (table[row + 1, 1] - table[row, 1]),
        table[row, 2] + part * (table[row + 1, 2] - table[row, 2]),
    )


@compiled
def slant_troposphere_m(troposphere: Troposphere, sin_elevation: float) -> float:
    """Delay [m] towards a satellite; zero where it is not known: below the horizon, NaN, an unknown position."""
    if not (troposphere.known and 0.0 < sin_elevation <= 1.0 + 1e-9):
        return 0.0
    sine = max(sin_elevation, _LOWEST_SINE)
    da, db, dc = troposphere.dry_mapping
    wa, wb, wc = troposphere.wet_mapping
    height_mapping = 1.0 / sine - _continued(sine, _PER_HEIGHT[0], _PER_HEIGHT[1], _PER_HEIGHT[2])
    dry_mapping = _continued(sine, da, db, dc) + height_mapping * troposphere.height_m * 1e-3
    return troposphere.dry_m * dry_mapping + troposphere.wet_m * _continued(sine, wa, wb, wc)


@compiled
def zenith_delays_m(latitude_rad: float, height_m: float) -> tuple[float, float]:
    """Hydrostatic and wet delay [m] towards the zenith in the standard atmosphere."""
    pressure = 1013.25 * (1.0 - 2.2557e-5 * height_m) ** 5.2568
    kelvin = 288.16 - 6.5e-3 * height_m
    vapour = 6.108 * 0.7 * math.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    gravity = 1.0 - 0.00266 * math.cos(2.0 * latitude_rad) - 0.28e-6 * height_m
    return 0.0022768 * pressure / gravity, 0.002277 * (1255.0 / kelvin + 0.05) * vapour


@compiled
def _continued(sine: float, a: float, b: float, c: float) -> float:
    """Marini's continued fraction, normalised to one at the zenith (Niell 1996, eq. 4)."""
    return (1.0 + a / (1.0 + b / (1.0 + c))) / (sine + a / (sine + b / (sine + c)))


@compiled
def has_ionosphere(coefficients: Floats) -> bool:
    """Whether these are the eight coefficients of `klobuchar_m`; (0,) means none."""
    usable = coefficients.size == 8
    for k in range(coefficients.size):
        usable = usable and abs(coefficients[k]) < 1e9
    return usable


@compiled
def klobuchar_m(
    coefficients: Floats,
    of_week_s: float,
    latitude_rad: float,
    longitude_rad: float,
    elevation_rad: float,
    azimuth_rad: float,
) -> float:
    """Delay of code on L1 [m] towards a satellite at a GPS time of week.

    `coefficients` (8,) are α₀ … α₃, β₀ … β₃ as GPS broadcasts them (s, s/semicircle, …). Zero where it is not known:
    without coefficients, below the horizon, where a number is not finite.
    """
    finite = (
        abs(latitude_rad) < 2.0
        and abs(longitude_rad) < 7.0
        and abs(azimuth_rad) < 7.0
        and abs(of_week_s) < 1e9
    )
    if not (finite and 0.0 < elevation_rad <= 0.5 * np.pi + 1e-9 and has_ionosphere(coefficients)):
        return 0.0
    el = max(elevation_rad, LOWEST_ELEVATION_RAD) / np.pi
    psi = 0.0137 / (el + 0.11) - 0.022
    latitude = min(max(latitude_rad / np.pi + psi * math.cos(azimuth_rad), -0.416), 0.416)
    longitude = longitude_rad / np.pi + psi * math.sin(azimuth_rad) / math.cos(latitude * np.pi)
    magnetic = latitude + 0.064 * math.cos((longitude - 1.617) * np.pi)
    local_s = (4.32e4 * longitude + of_week_s) % 86400.0
    amplitude, period = 0.0, 0.0
    for power in range(3, -1, -1):
        amplitude = amplitude * magnetic + coefficients[power]
        period = period * magnetic + coefficients[4 + power]
    x = 2.0 * np.pi * (local_s - 50400.0) / max(period, 72000.0)
    day = max(amplitude, 0.0) * (1.0 - x * x / 2.0 + x * x * x * x / 24.0) if abs(x) < 1.57 else 0.0
    slant = 1.0 + 16.0 * (0.53 - el) ** 3
    return SPEED_OF_LIGHT_M_S * slant * (5.0e-9 + day)

"""Delays by ionosphere and troposphere, many at a time.

Sources: IS-GPS-200N, 20.3.3.5.2.5 and figure 20-4 (Klobuchar's model); J. Saastamoinen, "Contributions to the theory of
atmospheric refraction", Bulletin géodésique 105-107 (1972-73), with the standard atmosphere as in RTKLIB manual 2.4.2,
E.5 (1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.simulator.random_streams import stream
from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S
from camber.simulator.scene import Floats, Integers

KLOBUCHAR_ALPHA = (1.118e-08, 2.235e-08, -5.96e-08, -1.192e-07)
KLOBUCHAR_BETA = (1.167e05, 1.802e05, -1.311e05, -4.588e05)
"""Broadcast by GPS on a day of moderate activity; s, s/semicircle, …"""

# IS-GPS-200N, 20.3.3.5.2.6: the ionosphere as a shell at 350 km over a sphere.
_SHELL_M = 350e3
_EARTH_M = 6371e3


def klobuchar_m(
    time_ns: Integers, latitude_rad: Floats, longitude_rad: Floats, azimuth_rad: Floats, elevation_rad: Floats
) -> Floats:
    """Delay of code on L1 [m]: time, latitude, longitude (n,), azimuth and elevation (n, m) → (n, m)."""
    semicircle = 1.0 / np.pi
    el = elevation_rad * semicircle
    psi = 0.0137 / (el + 0.11) - 0.022
    lat = np.clip(latitude_rad[:, None] * semicircle + psi * np.cos(azimuth_rad), -0.416, 0.416)
    lon = longitude_rad[:, None] * semicircle + psi * np.sin(azimuth_rad) / np.cos(lat * np.pi)
    magnetic = lat + 0.064 * np.cos((lon - 1.617) * np.pi)
    tow = (time_ns % NS_PER_WEEK)[:, None] / NS_PER_SECOND
    local = (4.32e4 * lon + tow) % 86400.0
    powers = magnetic[..., None] ** np.arange(4)
    amplitude = np.maximum(powers @ np.array(KLOBUCHAR_ALPHA), 0.0)
    period = np.maximum(powers @ np.array(KLOBUCHAR_BETA), 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    slant = 1.0 + 16.0 * (0.53 - el) ** 3
    # The cosine itself: the document's series jumps by 2 % of the amplitude at the edge of night, the sky does not.
    day = np.where(np.abs(x) < 0.5 * np.pi, amplitude * np.cos(x), 0.0)
    return SPEED_OF_LIGHT_M_S * slant * (5.0e-9 + day)


def saastamoinen_m(latitude_rad: Floats, height_m: Floats, elevation_rad: Floats, humidity: float) -> Floats:
    """Delay of the standard atmosphere [m]: latitude, ellipsoidal height (n,), elevation (n, m) → (n, m)."""
    height = np.maximum(height_m, 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * height) ** 5.2568
    kelvin = 15.0 - 6.5e-3 * height + 273.16
    vapour = 6.108 * humidity * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    zenith = 0.5 * np.pi - elevation_rad
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * latitude_rad) - 0.00028 * height * 1e-3)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return (dry + wet)[:, None] / np.cos(zenith)


def shell_mapping(elevation_rad: Floats) -> Floats:
    """Slant to vertical in a thin shell at 350 km: 1 / cos z′."""
    ratio = _EARTH_M / (_EARTH_M + _SHELL_M) * np.cos(elevation_rad)
    return 1.0 / np.sqrt(1.0 - ratio**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Atmosphere:
    """The atmosphere of one day about a place; rover and base share it.

    `ionosphere_scale`: the true delay against the broadcast model's. `gradient_m_per_m`: vertical delay on L1 towards
    east and north beyond the model's. `humidity`, `wet_zenith_m`: the troposphere against the standard one, and
    `wet_gradient_m_per_m`.
    """

    ionosphere_scale: float
    gradient_m_per_m: tuple[float, float]
    humidity: float
    wet_zenith_m: float
    wet_gradient_m_per_m: tuple[float, float]

    @classmethod
    def drawn(cls, seed: int) -> Atmosphere:
        """From a seed; gradients with σ of 1 mm/km (ionosphere) and 0.3 mm/km (wet troposphere)."""
        draw = stream(seed, "satellites/atmosphere").normal(size=6)
        return cls(
            ionosphere_scale=float(np.clip(1.0 + 0.2 * draw[0], 0.4, 1.6)),
            gradient_m_per_m=(float(draw[1]) * 1e-6, float(draw[2]) * 1e-6),
            humidity=0.7,
            wet_zenith_m=0.05 * float(draw[3]),
            wet_gradient_m_per_m=(float(draw[4]) * 0.3 * 1e-6, float(draw[5]) * 0.3 * 1e-6),
        )

    def delays_m(
        self,
        time_ns: Integers,
        place: tuple[Floats, Floats, Floats],
        east_north_m: Floats,
        sky: tuple[Floats, Floats],
    ) -> tuple[Floats, Floats]:
        """Ionosphere of code on L1 and troposphere [m], (n, m) each.

        `place`: latitude, longitude, height (n,); `east_north_m` (n, 2) from the frame's origin; `sky`: azimuth and
        elevation (n, m).
        """
        (latitude, longitude, height_m), (azimuth, elevation) = place, sky
        el = np.maximum(elevation, np.deg2rad(2.0))
        modelled = klobuchar_m(time_ns, latitude, longitude, azimuth_rad=azimuth, elevation_rad=el)
        beyond = (east_north_m @ np.array(self.gradient_m_per_m))[:, None]
        ionosphere = self.ionosphere_scale * modelled + beyond * shell_mapping(el)
        wet = self.wet_zenith_m + east_north_m @ np.array(self.wet_gradient_m_per_m)
        troposphere = saastamoinen_m(latitude, height_m, el, self.humidity) + wet[:, None] / np.sin(el)
        return ionosphere, troposphere

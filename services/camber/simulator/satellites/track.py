"""Where an antenna is, in the world frame and in ECEF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.scene import Floats, Integers

_MEAN_RADIUS_M = 6.371e6  # IUGG


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AntennaTrack:
    """An antenna's motion: `time_ns` (n,), `antenna_m`, `antenna_velocity_m_s` (n, 3) in the world frame of `scene`.

    Between the times it is taken to move evenly, over the clock error of a receiver (microseconds).
    """

    time_ns: Integers
    antenna_m: Floats
    antenna_velocity_m_s: Floats


def static_track(time_ns: Integers, antenna_m: tuple[float, float, float]) -> AntennaTrack:
    """An antenna that stands: a base station."""
    n = len(time_ns)
    place_m = np.tile(np.array(antenna_m, np.float64), (n, 1))
    return AntennaTrack(time_ns=time_ns, antenna_m=place_m, antenna_velocity_m_s=np.zeros((n, 3)))


class GeodeticTrack(NamedTuple):
    """Latitude, longitude [rad], ellipsoidal height [m] (n,), ECEF position and velocity (n, 3)."""

    latitude_rad: Floats
    longitude_rad: Floats
    height_m: Floats
    ecef_m: Floats
    ecef_velocity_m_s: Floats

    def rows(self, index: Integers) -> GeodeticTrack:
        """Some of its times."""
        return GeodeticTrack(*(column[index] for column in self))


def geodetic_track(frame: LocalFrame, antenna_m: Floats, velocity_m_s: Floats) -> GeodeticTrack:
    """Of positions (n, 3) in a world frame about `frame`; the third coordinate is the ellipsoidal height."""
    latitude, longitude, height = frame.geodetic_from_east_north_array(antenna_m[:, :2], antenna_m[:, 2])
    ecef = ecef_from_geodetic(latitude, longitude, height)
    # Height above the ellipsoid rises against the tangent plane by d² / 2R.
    tangent = velocity_m_s.copy()
    tangent[:, 2] -= np.sum(antenna_m[:, :2] * velocity_m_s[:, :2], axis=1) / _MEAN_RADIUS_M
    rotation = frame.enu_from_ecef_rotation()
    return GeodeticTrack(*(latitude, longitude, height, ecef, tangent @ rotation))

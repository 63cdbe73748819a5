"""What keeps a right fix from the map's place of the antenna, however good the satellites are.

The point that the phases give and the one that the settings state are not the same: phase centre, lever arm, the point
that the map was measured with. It is constant in the vehicle and turns with it. And the base's coordinates are in a
frame of another survey than the map: a constant vector. Neither averages out along a street.
"""

from __future__ import annotations

import math

import numpy as np

from camber.geodesy.gps_time import NS_PER_SECOND
from camber.simulator.random_streams import stream
from camber.simulator.satellites.track import AntennaTrack
from camber.simulator.scene import Floats


def frame_offset_m(sigma_m: float, seed: int) -> Floats:
    """The base's frame less the map's, (3,) east, north, up; heights are in one frame."""
    east_m, north_m = sigma_m * stream(seed, "satellites/frame").normal(size=2)
    return np.array([east_m, north_m, 0.0])


def with_reference_error(track: AntennaTrack, yaw_rad: Floats, length_m: float, seed: int) -> AntennaTrack:
    """The point that the phases give, `length_m` beside the stated one in a horizontal direction of the vehicle."""
    if length_m == 0.0:
        return track
    direction_rad = yaw_rad + stream(seed, "satellites/reference").uniform(0.0, 2.0 * math.pi)
    offset_m = length_m * np.column_stack(
        (np.cos(direction_rad), np.sin(direction_rad), np.zeros_like(direction_rad))
    )
    time_s = (track.time_ns - track.time_ns[0]) / NS_PER_SECOND
    turning_m_s = np.gradient(offset_m, time_s, axis=0) if len(time_s) > 1 else np.zeros_like(offset_m)
    return AntennaTrack(
        time_ns=track.time_ns,
        antenna_m=track.antenna_m + offset_m,
        antenna_velocity_m_s=track.antenna_velocity_m_s + turning_m_s,
    )

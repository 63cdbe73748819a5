"""Ranges, range rates and directions from antennas to satellites, with light time and the earth's rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.simulator.satellites.orbits import (
    EARTH_ROTATION_RAD_S,
    SPEED_OF_LIGHT_M_S,
    OrbitTable,
    satellite_states,
)
from camber.simulator.satellites.track import GeodeticTrack
from camber.simulator.scene import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ranges:
    """Of n epochs and m satellites: columns (n, m), `direction` (n, m, 3) in the frame's east, north, up.

    `azimuth_rad` clockwise from north and `elevation_rad` are those at the frame's origin.
    """

    range_m: Floats
    rate_m_s: Floats
    clock_s: Floats
    clock_rate: Floats
    direction: Floats
    azimuth_rad: Floats
    elevation_rad: Floats


def ranges(
    table: OrbitTable, times: tuple[Integers, Floats], track: GeodeticTrack, frame: LocalFrame
) -> Ranges:
    """At the receiver's `times`: its tags [ns] and its clock [s] (n,), true time being the tag less the clock."""
    time_ns, receiver_clock_s = times
    true_offset = -receiver_clock_s[:, None]
    travel = np.full((len(time_ns), len(table.satellite)), 0.08)
    for first in (True, False):
        states = satellite_states(table, time_ns, true_offset - travel)
        position, velocity = _turned(states.position_m, states.velocity_m_s, travel)
        line = position - track.ecef_m[:, None, :]
        distance = np.sqrt(np.sum(line**2, axis=-1))
        unit = line / distance[..., None]
        along = np.sum(unit * velocity, axis=-1)
        turning = EARTH_ROTATION_RAD_S * (unit[..., 0] * position[..., 1] - unit[..., 1] * position[..., 0])
        # d(line)/d(travel) is turning − along: Newton's step for travel = distance / c; a second one would be < 1 µm.
        slope = 1.0 + (along - turning) / SPEED_OF_LIGHT_M_S
        if first:
            travel = travel + (distance / SPEED_OF_LIGHT_M_S - travel) / slope
    # dρ/dt of ρ = |R(ρ/c) s(t − ρ/c) − r(t)|: through ρ/c the rate stands on both sides.
    of_receiver = np.sum(unit * track.ecef_velocity_m_s[:, None, :], axis=-1)
    direction = unit @ frame.enu_from_ecef_rotation().T
    return Ranges(
        range_m=distance,
        rate_m_s=(along - of_receiver) / slope,
        clock_s=states.clock_s,
        clock_rate=states.clock_rate,
        direction=direction,
        azimuth_rad=np.arctan2(direction[..., 0], direction[..., 1]),
        elevation_rad=np.arcsin(np.clip(direction[..., 2], -1.0, 1.0)),
    )


def _turned(position: Floats, velocity: Floats, travel_s: Floats) -> tuple[Floats, Floats]:
    """Into the ECEF frame of the time of reception (IS-GPS-200N, 20.3.3.4.3.3.2)."""
    angle = EARTH_ROTATION_RAD_S * travel_s
    s, c = np.sin(angle), np.cos(angle)

    def turn(v: Floats) -> Floats:
        return np.stack((c * v[..., 0] + s * v[..., 1], -s * v[..., 0] + c * v[..., 1], v[..., 2]), axis=-1)

    return turn(position), turn(velocity)

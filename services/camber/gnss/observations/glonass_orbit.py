"""Positions of GLONASS satellites: numerical integration of a broadcast state; compiled.

Source: ICD GLONASS 5.1 (2008), A.3.1.2: the simplified equations of motion in the rotating frame of PZ-90, with the
second zonal harmonic of the earth's field, the acceleration by moon and sun being constant; fourth order Runge-Kutta
method. PZ-90.11 and WGS 84 agree to centimetres, so that positions are not transformed.
"""

from __future__ import annotations

import math

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats

# ICD GLONASS 5.1, table 3.2 (PZ-90.02).
_GRAVITY_M3_S2 = 3.986004418e14
_EQUATOR_M = 6_378_136.0
_J2 = 1.08262575e-3
_ROTATION_RAD_S = 7.292115e-5
_LONGEST_STEP_S = 60.0  # chosen: the method then errs by 1.4 mm after half an hour
STATE = 9
"""Columns of a state: position [m], velocity [m/s], acceleration by moon and sun [m/s²], PZ-90."""


@compiled
def integrate_state(state: Floats, since_s: float, position: Floats, velocity: Floats) -> None:
    """Write position and velocity (3,) in the rotating frame of `since_s`, from a state (9,) at time zero."""
    steps = max(math.ceil(abs(since_s) / _LONGEST_STEP_S), 1)
    step_s = since_s / steps
    moving = state[:6].copy()
    rates = np.empty((4, 6))
    for _ in range(steps):
        _rates(moving, state, rates[0])
        _rates(moving + 0.5 * step_s * rates[0], state, rates[1])
        _rates(moving + 0.5 * step_s * rates[1], state, rates[2])
        _rates(moving + step_s * rates[2], state, rates[3])
        moving += step_s / 6.0 * (rates[0] + 2.0 * rates[1] + 2.0 * rates[2] + rates[3])
    position[:], velocity[:] = moving[:3], moving[3:]


@compiled
def _rates(moving: Floats, state: Floats, out: Floats) -> None:
    """Write the derivatives (6,) of position and velocity; the acceleration by moon and sun is that of `state`."""
    x, y, z = moving[0], moving[1], moving[2]
    vx, vy, vz = moving[3], moving[4], moving[5]
    r_squared = x * x + y * y + z * z
    central = -_GRAVITY_M3_S2 / (r_squared * math.sqrt(r_squared))
    oblate = 1.5 * _J2 * central * _EQUATOR_M * _EQUATOR_M / r_squared
    polar = 5.0 * z * z / r_squared
    turning = _ROTATION_RAD_S * _ROTATION_RAD_S
    in_plane = central + oblate * (1.0 - polar) + turning
    out[0], out[1], out[2] = vx, vy, vz
    out[3] = in_plane * x + 2.0 * _ROTATION_RAD_S * vy + state[6]
    out[4] = in_plane * y - 2.0 * _ROTATION_RAD_S * vx + state[7]
    out[5] = (central + oblate * (3.0 - polar)) * z + state[8]

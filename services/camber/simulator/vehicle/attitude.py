"""Rotations of many moments at once: R = Rz(yaw) Ry(pitch) Rx(roll), as in `camber.geodesy.se3`, as arrays."""

from __future__ import annotations

import numpy as np

from camber.simulator.scene import Floats


def rotations(roll_rad: Floats, pitch_rad: Floats, yaw_rad: Floats) -> Floats:
    """World from vehicle (n, 3, 3)."""
    sr, cr = np.sin(roll_rad), np.cos(roll_rad)
    sp, cp = np.sin(pitch_rad), np.cos(pitch_rad)
    sy, cy = np.sin(yaw_rad), np.cos(yaw_rad)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def angular_velocity(pitch_rad: Floats, yaw_rad: Floats, rates: tuple[Floats, Floats, Floats]) -> Floats:
    """ω in world axes [rad/s] (n, 3) of the rates of roll, pitch, yaw: about the body's x, the turned y, up."""
    roll_rate, pitch_rate, yaw_rate = rates
    sp, cp = np.sin(pitch_rad), np.cos(pitch_rad)
    sy, cy = np.sin(yaw_rad), np.cos(yaw_rad)
    east = -sy * pitch_rate + cy * cp * roll_rate
    north = cy * pitch_rate + sy * cp * roll_rate
    return np.column_stack((east, north, yaw_rate - sp * roll_rate))


def body_yaw_rate(
    roll_rad: Floats, pitch_rad: Floats, pitch_rate_rad_s: Floats, yaw_rate_rad_s: Floats
) -> Floats:
    """What a rate sensor fixed to the body measures about its own z [rad/s] (n,)."""
    return np.cos(pitch_rad) * np.cos(roll_rad) * yaw_rate_rad_s - np.sin(roll_rad) * pitch_rate_rad_s

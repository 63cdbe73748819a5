"""Rigid motions as 4 × 4 homogeneous matrices, named `a_from_b` so that neighbours cancel
and `a_from_b @ b_from_c` is `a_from_c`.

Vehicle frame: x forward, y left, z up. Map frame: x east, y north, z up. Attitude follows the right-hand rule
about these axes (ISO 8855, REP 103): `R = Rz(yaw) Ry(pitch) Rx(roll)`, yaw counter-clockwise from east,
**pitch positive with the nose down**, roll positive with the left side up. Many instruments give pitch
positive with the nose up: their reader changes the sign.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

# How far RᵀR may be from the identity before a matrix is not a rotation; leaves room for float32 poses.
_ORTHOGONALITY_TOLERANCE = 1.0e-5


def rotation_from_roll_pitch_yaw(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """Rotation (3, 3) that takes vectors of the vehicle to the map (east, north, up)."""
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    sy, cy = math.sin(yaw_rad), math.cos(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def roll_pitch_yaw_from_rotation(map_from_vehicle: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a rotation (3, 3) or rigid motion (4, 4); pitch in [−π/2, π/2].

    With the nose straight up or down only yaw − roll or yaw + roll is defined: roll is then given as zero.
    """
    r = np.asarray(map_from_vehicle, dtype=np.float64)
    if r.shape not in ((3, 3), (4, 4)):
        raise ValueError(f"map_from_vehicle has shape {r.shape}, expected (3, 3) or (4, 4)")
    cos_pitch = math.hypot(r[0, 0], r[1, 0])
    pitch_rad = math.atan2(-r[2, 0], cos_pitch)
    if cos_pitch < 1.0e-9:
        return 0.0, pitch_rad, math.atan2(-r[0, 1], r[1, 1])
    return math.atan2(r[2, 1], r[2, 2]), pitch_rad, math.atan2(r[1, 0], r[0, 0])


def rigid_motion(rotation: ArrayLike, translation_m: ArrayLike) -> NDArray[np.float64]:
    """The 4 × 4 matrix `a_from_b` of a rotation (3, 3) and the origin of b in a (3,) [m].

    Raises ValueError on other shapes, numbers that are not finite and matrices that are not rotations.
    """
    r = np.asarray(rotation, dtype=np.float64)
    t = np.asarray(translation_m, dtype=np.float64)
    if r.shape != (3, 3) or t.shape != (3,):
        raise ValueError(f"rotation, translation_m have shapes {r.shape}, {t.shape}, expected (3, 3), (3,)")
    if not bool(np.all(np.isfinite(t))):
        raise ValueError("translation_m is not finite")
    deviation = float(np.max(np.abs(r.T @ r - np.eye(3))))
    if not (deviation <= _ORTHOGONALITY_TOLERANCE and np.linalg.det(r) > 0.0):
        raise ValueError(
            f"rotation is not a rotation: RᵀR differs from the identity by {deviation}, or det R < 0"
        )
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = r
    a_from_b[:3, 3] = t
    return a_from_b


def map_from_vehicle(
    east_m: float, north_m: float, up_m: float, roll_rad: float, pitch_rad: float, yaw_rad: float
) -> NDArray[np.float64]:
    """The 4 × 4 pose of a vehicle in an east-north-up frame."""
    return rigid_motion(rotation_from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad), (east_m, north_m, up_m))


def invert(a_from_b: ArrayLike) -> NDArray[np.float64]:
    """`b_from_a` (4, 4), by transposing: [Rᵀ, −Rᵀ t]."""
    t = _rigid(a_from_b, "a_from_b")
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = t[:3, :3].T
    b_from_a[:3, 3] = -t[:3, :3].T @ t[:3, 3]
    return b_from_a


def transform_points(a_from_b: ArrayLike, points_b_m: ArrayLike) -> NDArray[np.float64]:
    """Points (n, 3) [m] given in b, expressed in a."""
    t = _rigid(a_from_b, "a_from_b")
    points = np.asarray(points_b_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points_b_m has shape {points.shape}, expected (n, 3)")
    points_a_m: NDArray[np.float64] = points @ t[:3, :3].T + t[:3, 3]
    return points_a_m


def lever_arm_enu(
    roll_rad: float, pitch_rad: float, yaw_rad: float, lever_arm_vehicle_m: tuple[float, float, float]
) -> tuple[float, float, float]:
    """East, north, up [m] of an offset in the vehicle frame [m]; plain floats, no numpy.

    On a 10 % grade one metre of forward offset is 10 cm of height, which is why roll and pitch are asked for.
    """
    x, y, z = lever_arm_vehicle_m
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    # roll about x, then pitch about y, then yaw about z
    y, z = y * cr - z * sr, y * sr + z * cr
    x, z = x * cp + z * sp, z * cp - x * sp
    sy, cy = math.sin(yaw_rad), math.cos(yaw_rad)
    return x * cy - y * sy, x * sy + y * cy, z


def _rigid(matrix: ArrayLike, name: str) -> NDArray[np.float64]:
    array = np.asarray(matrix, dtype=np.float64)
    if array.shape != (4, 4):
        raise ValueError(f"{name} has shape {array.shape}, expected (4, 4)")
    return array

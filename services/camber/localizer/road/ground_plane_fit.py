"""Height and tilt of the vehicle over the road: by the map's road points, and by the ground in a sweep.

`road_line` is JP2016-109650A, step 10 (spec/layered-matching.md): map points of the road within 10 m, in the local
frame, projected on x–z, a line by RANSAC. Crossfall would bend such a line towards the side with more points; so
only a strip about the vehicle's path is used, and the last step estimates the slope across too. `ground_plane` does
the same with a sweep: the sensor above the road it sees, independent of the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.localizer.arrays import Floats
from camber.localizer.matching.sweep_preparation import SensorMount

REACH_M: Final = 10.0  # JP2016-109650A, step 10: of the road around the vehicle
# Chosen: with half of outliers 120 trials miss the plane once in ten million; the weights converge in 8 rounds.
_TRIALS: Final = 120
_INLIER_M: Final = 0.05
_ROUNDS: Final = 8
_TUKEY: Final = 4.685  # 95 % efficiency for normal errors: Holland and Welsch 1977
_MIN_POINTS: Final = 15  # chosen
_MIN_SIGMA_M: Final = 0.004
"""Chosen: not reduced by more points; the range error is common to them, and the road is rough under the wheels."""
_NEIGHBOURS: Final = 4.0  # chosen: number of points that err alike
_CURVATURE_PER_M: Final = 1.0 / 400.0  # chosen: σ of a road's vertical curvature, crests in towns included


class RoadLine(NamedTuple):
    """The map's road in the local frame: `dz_m` above its origin, falling ahead by `dpitch_rad` (as pitch)."""

    dz_m: float
    dpitch_rad: float

    @property
    def local_from_road(self) -> Floats:
        """`M_ΔZ` of JP2016-109650A eq. (5): `[R_y(Δφ) T_z(Δz); 0 1]`, from the frame on the road to the local one."""
        cos, sin = math.cos(self.dpitch_rad), math.sin(self.dpitch_rad)
        return np.array(
            [[cos, 0.0, sin, 0.0], [0.0, 1.0, 0.0, 0.0], [-sin, 0.0, cos, self.dz_m], [0.0, 0.0, 0.0, 1.0]]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundPlane:
    """The road around the vehicle by the ground in a sweep, in the vehicle frame by the sensor's mount.

    `distance_m` is from the sensor to the road along the road's normal. `pitch_rad`, `roll_rad` are those of the body
    against the road. `problem` is *mounting* where the ground contradicts the sensor's mount by more than 0.3 m or 3°.
    """

    distance_m: float
    distance_sigma_m: float
    roll_rad: float
    pitch_rad: float
    problem: Literal["mounting"] | None

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body against the road [rad]; level where the mount is contradicted."""
        return (0.0, 0.0) if self.problem is not None else (self.roll_rad, self.pitch_rad)

    def height_m(self, slope: float) -> float:
        """Return the sensor's vertical height above the road of this slope."""
        return self.distance_m * math.hypot(1.0, slope)


def road_line(
    road_m: Floats, *, reach_m: float = REACH_M, half_width_m: float = 2.0, search_m: float = 1.5
) -> RoadLine | None:
    """Fit a line to road points of the map in the local frame (n, 3), x forward and z up, z about zero on the road.

    Points more than `search_m` above or below are of another road. None with fewer than 15 points.
    """
    x, y, z = road_m[:, 0], road_m[:, 1], road_m[:, 2]
    near = (x * x + y * y < reach_m * reach_m) & (np.abs(y) < half_width_m) & (np.abs(z) < search_m)
    fit = _fitted(road_m[near], across=False)
    return None if fit is None else RoadLine(fit.at_origin_m, -math.atan(fit.ahead))


def ground_plane(
    points_m: Floats,
    mount: SensorMount,
    *,
    nearest_m: float = 2.0,
    reach_m: float = 12.0,
    half_width_m: float = 2.5,
) -> GroundPlane | None:
    """Fit the road to a sweep in the vehicle frame (n, 3), without points of the vehicle. None where no road is seen.

    Only a strip of `half_width_m` to each side counts (a crowned road is two planes), between `nearest_m` and `reach_m`
    from the sensor. It is a plane with curvature along the way, so that crests do not lift the road.
    """
    x, y, z = points_m[:, 0] - mount.x_m, points_m[:, 1] - mount.y_m, points_m[:, 2]
    square = x * x + y * y
    # Wide enough for a sensor that is 0.5 m and 10° off its mount: only a fitted road shows it.
    near = (square > nearest_m * nearest_m) & (square < reach_m * reach_m) & (np.abs(y) < half_width_m)
    near &= np.abs(z) < 0.6 + 0.18 * np.sqrt(square)
    about = np.column_stack((x[near], y[near], z[near]))
    fit = _fitted(about, across=True)
    if fit is None:
        return None
    norm = math.sqrt(1.0 + fit.ahead**2 + fit.left**2)
    # The plane is z = a + b x + c y, the normal (−b, −c, 1) / norm; the sensor stands above the fit's origin.
    distance_m = (mount.z_m - fit.at_origin_m) / norm
    pitch, roll = math.atan(fit.ahead), -math.atan(fit.left)
    off = abs(fit.at_origin_m) > 0.3 or max(abs(pitch), abs(roll)) > math.radians(3.0)
    return GroundPlane(
        distance_m=distance_m,
        distance_sigma_m=math.sqrt(fit.covariance[0, 0]),
        roll_rad=roll,
        pitch_rad=pitch,
        problem="mounting" if off else None,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _RoadPlane:
    """z = at_origin + ahead x + left y, and the covariance (3, 3) of these."""

    at_origin_m: float
    ahead: float
    left: float
    covariance: Floats


def _fitted(points_m: Floats, *, across: bool) -> _RoadPlane | None:
    """RANSAC (a line in x–z, or a plane), then weighted least squares of plane and curvature with Tukey's weights."""
    if len(points_m) < _MIN_POINTS:
        return None
    points = np.ascontiguousarray(points_m, np.float64)
    inlier_m = _INLIER_M if across else 2.0 * _INLIER_M  # crossfall spreads the points about a line
    trial, inliers = _ransac(points, across, inlier_m, _TRIALS)
    if inliers < max(_MIN_POINTS, 0.2 * len(points)):
        return None
    # Ahead, left, and half the curvature ahead: what is known of a road before it is seen.
    prior = np.array([0.0, 0.0, 0.0, 1.0 / (0.5 * _CURVATURE_PER_M) ** 2])
    rows = np.column_stack((np.ones(len(points)), points[:, 0], points[:, 1], points[:, 0] ** 2))
    solution = np.append(trial, 0.0)
    scale = inlier_m
    weight = (np.abs(points[:, 2] - rows @ solution) < 2.0 * inlier_m).astype(np.float64)
    inverse = np.eye(4)
    for _ in range(_ROUNDS):
        normal = (rows * weight[:, None]).T @ rows + np.diag(prior) * scale**2
        inverse = np.linalg.pinv(normal, hermitian=True)
        solution = inverse @ ((rows * weight[:, None]).T @ points[:, 2])
        residual = points[:, 2] - rows @ solution
        used = weight > 0.0
        if int(used.sum()) < _MIN_POINTS:
            return None
        scale = max(1.4826 * float(np.median(np.abs(residual[used]))), _MIN_SIGMA_M)
        weight = np.where(
            np.abs(residual) < _TUKEY * scale, (1.0 - (residual / (_TUKEY * scale)) ** 2) ** 2, 0.0
        )
    covariance = (scale**2 * _NEIGHBOURS * inverse)[:3, :3]
    covariance[0, 0] += _MIN_SIGMA_M**2
    a, b, c, _ = solution.tolist()
    return _RoadPlane(at_origin_m=a, ahead=b, left=c, covariance=covariance)


@compiled_without_gil
def _ransac(points_m: Floats, across: bool, inlier_m: float, trials: int) -> tuple[Floats, int]:
    """Of planes (lines, not `across`) through points drawn at random the one that most points lie on: a, b, c."""
    n = len(points_m)
    best = np.zeros(3)
    most = -1
    state = 88_172_645_463_325_252  # xorshift64: the same draws for the same points
    for _ in range(trials):
        drawn = np.empty(3, np.int64)
        for k in range(3):
            state ^= (state << 13) & 0x7FFFFFFFFFFFFFFF
            state ^= state >> 7
            state ^= (state << 17) & 0x7FFFFFFFFFFFFFFF
            drawn[k] = state % n
        p, q, r = points_m[drawn[0]], points_m[drawn[1]], points_m[drawn[2]]
        if across:
            e, f, g, h = q[0] - p[0], q[1] - p[1], r[0] - p[0], r[1] - p[1]
            area = e * h - f * g
            if abs(area) < 0.5:
                continue
            b = ((q[2] - p[2]) * h - (r[2] - p[2]) * f) / area
            c = ((r[2] - p[2]) * e - (q[2] - p[2]) * g) / area
        else:
            if abs(q[0] - p[0]) < 1.0:
                continue
            b, c = (q[2] - p[2]) / (q[0] - p[0]), 0.0
        if abs(b) > 0.35 or abs(c) > 0.35:
            continue
        a = p[2] - b * p[0] - c * p[1]
        inliers = 0
        for i in range(n):
            if abs(points_m[i, 2] - a - b * points_m[i, 0] - c * points_m[i, 1]) < inlier_m:
                inliers += 1
        if inliers > most:
            most = inliers
            best[0], best[1], best[2] = a, b, c
    return best, most

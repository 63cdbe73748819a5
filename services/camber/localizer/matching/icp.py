"""Point-to-plane ICP in three degrees of freedom that does not move along degenerate directions.

A layer of walls hardly observes height, roll and pitch, and a road none of the rest: with six degrees of freedom
the weak ones wander and drag the others along. So a fit is *planar* (east, north, yaw) or *vertical* (up, roll,
pitch), about the origin of the local frame.

A correspondence is weighted by the thickness of the map's surface and the noise of both clouds, and robustly
(Cauchy) by its residual. The scale of the noise begins wide and narrows from iteration to iteration, so that a
start half a metre off converges and what has moved since the survey is an outlier in the end.

Errors of the normals make every direction look a little observable. How much of the normal matrix they explain
follows from the normals' variance: directions without clearly more are degenerate. The fit never moves along them,
and their information is zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.compiled.decorator import compiled
from camber.geodesy.se3 import transform_points
from camber.localizer.arrays import Floats, Integers, Mask
from camber.localizer.matching.registration import LayerTarget

Correspondences: TypeAlias = tuple[Integers, Floats]
"""Rows (n,) of the nearest map points, and their distances (n,) [m]."""
Freedom: TypeAlias = Literal["planar", "vertical"]

NOISE_M: Final = 0.03
"""Chosen: σ of a point about a surface of no thickness, by ranging, deskewing and the thinning of both clouds."""
DEGENERATE_RATIO: Final = 2.0
"""Chosen: a direction is observable with this many times the information that errors of the normals alone explain."""
MAX_ITERATIONS: Final = 30  # chosen: five or six narrow the scale
LAST_DISTANCE_M: Final = 0.5
"""Chosen: correspondences farther apart are dropped once the scale has narrowed."""
_NARROWING: Final = 0.7  # chosen: of the scale, from one iteration to the next
_CAUCHY: Final = 2.385  # 95 % efficiency for normal errors: Holland and Welsch 1977
_SEARCH_AGAIN_M: Final = 0.02  # a tenth of the map's grid: below it the nearest map point hardly changes
_SEARCH_REACH_M: Final = 30.0  # chosen: where that motion is measured, most of a local map being nearer
# Chosen: smaller steps have converged, a tenth and a fifth of the covariance's floor.
_STEP_M: Final = 1.0e-3
_STEP_RAD: Final = 1.0e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class NormalEquations:
    """Point-to-plane normal equations of three parameters at a transform; residuals weighted by 1/σ²."""

    normal_matrix: Floats
    """(3, 3), of all correspondences."""
    by_normal_errors: Floats
    """(3, 3), the part that errors of the normals alone explain."""
    gradient: Floats
    """(3,)"""
    weight: float
    """Sum of the robust weights, at most 1 per correspondence."""
    square: float
    """Weighted sum of (residual / σ)²."""
    inliers: Mask
    """(n,) points with a correspondence that is no outlier."""

    def observability(self) -> tuple[Floats, Floats, Floats]:
        """Return ratios (3,) of the normal matrix to the part of normal errors, ascending, directions and duals.

        Directions (3, 3) are columns with unit by_normal_errors; duals: Σ ratioₖ dualₖ dualₖᵀ = normal_matrix.
        """
        size = np.sqrt(np.maximum(np.diag(self.normal_matrix), 1e-12))
        # A floor keeps planes without errors invertible.
        noise = self.by_normal_errors / np.outer(size, size) + 1e-6 * np.eye(3)
        root = np.linalg.cholesky(noise)
        inverse = np.linalg.inv(root)
        ratios, vectors = np.linalg.eigh(inverse @ (self.normal_matrix / np.outer(size, size)) @ inverse.T)
        return ratios, (inverse.T @ vectors) / size[:, None], (root @ vectors) * size[:, None]

    def step(self) -> Floats:
        """Return the Gauss–Newton step (3,) within the observable directions."""
        ratios, directions, _ = self.observability()
        use = ratios >= DEGENERATE_RATIO
        along: Floats = directions[:, use]
        step: Floats = along @ ((along.T @ self.gradient) / ratios[use])
        return step

    def information(self) -> Floats:
        """Return the information (3, 3) of independent residuals less the part of normal errors; zero if degenerate."""
        ratios, _, duals = self.observability()
        use = ratios >= DEGENERATE_RATIO
        observed: Floats = duals[:, use]
        information: Floats = (observed * (ratios[use] - 1.0)) @ observed.T
        return information

    def rms(self) -> float:
        """Return the root mean square of residual / σ; infinite without correspondences."""
        return float(np.sqrt(self.square / self.weight)) if self.weight else np.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class IcpOptions:
    """Degrees of freedom, largest distance of a correspondence, and the scale of the noise, from first to last.

    An ICP that ends at a wide scale is a start for another one and does not wait for convergence.
    """

    free: Freedom
    max_distance_m: float
    first_scale_m: float
    last_scale_m: float = 0.0
    max_iterations: int = MAX_ITERATIONS


@dataclass(frozen=True, eq=False, kw_only=True)
class IcpResult:
    """map_from_local (4, 4) at the end, and whether the iteration has converged."""

    transform: Floats
    converged: bool


def icp_point_to_plane(
    layers: Sequence[tuple[LayerTarget, Floats]], guess: Floats, options: IcpOptions
) -> IcpResult:
    """Register clouds (n, 3) [m], each to its layer of the map, by one motion from `guess`, map_from_local (4, 4)."""
    transform = np.array(guess, dtype=np.float64)
    scale_m, searched_at, correspondences = options.first_scale_m, transform, list[Correspondences]()
    for _ in range(options.max_iterations):
        last = scale_m < max(NOISE_M, options.last_scale_m)
        narrow = scale_m < NOISE_M
        if not correspondences or _motion_m(transform, searched_at) > _SEARCH_AGAIN_M:
            correspondences = [find_correspondences(target, source, transform) for target, source in layers]
            searched_at = transform
        equations = summed(
            [
                normal_equations(
                    target,
                    source,
                    transform,
                    pairs,
                    free=options.free,
                    max_distance_m=min(options.max_distance_m, LAST_DISTANCE_M)
                    if narrow
                    else options.max_distance_m,
                    scale_m=0.0 if narrow else scale_m,
                )
                for (target, source), pairs in zip(layers, correspondences, strict=True)
            ]
        )
        if equations is None:
            return IcpResult(transform=transform, converged=False)
        step = equations.step()
        transform = moved(transform, step, options.free)
        if last and (options.last_scale_m > NOISE_M or _has_converged(step, options.free)):
            return IcpResult(transform=transform, converged=True)
        scale_m *= _NARROWING
    return IcpResult(transform=transform, converged=False)


def find_correspondences(target: LayerTarget, source_m: Floats, transform: Floats) -> Correspondences:
    """Return the nearest map points of a cloud (n, 3) [m] at `transform`; infinitely far from an empty target."""
    if target.empty or not len(source_m):
        return np.zeros(len(source_m), np.int64), np.full(len(source_m), np.inf)
    return target.nearest(transform_points(transform, source_m))


def normal_equations(
    target: LayerTarget,
    source_m: Floats,
    transform: Floats,
    correspondences: Correspondences,
    *,
    free: Freedom,
    max_distance_m: float = LAST_DISTANCE_M,
    scale_m: float = 0.0,
) -> NormalEquations:
    """Return the normal equations of a cloud (n, 3) [m] at `transform` (4, 4); `scale_m` widens the σ of residuals."""
    matrix, noise, gradient = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    inliers = np.zeros(len(source_m), np.bool_)
    weight = square = 0.0
    if not target.empty and len(source_m):
        shift, turn = _parameter_motions(transform, free)
        weight, square = _accumulate(
            planes=_Planes(target.points_m, target.normals, target.thickness_m, target.normal_variance_rad2),
            points_m=transform_points(transform, source_m),
            correspondences=correspondences,
            max_distance_m=max_distance_m,
            motions=_Motions(np.ascontiguousarray(transform[:3, 3]), shift, turn),
            noise_m2=NOISE_M**2 + scale_m**2,
            sums=_Sums(matrix, noise, gradient),
            inliers=inliers,
        )
    return NormalEquations(
        normal_matrix=matrix,
        by_normal_errors=noise,
        gradient=gradient,
        weight=weight,
        square=square,
        inliers=inliers,
    )


def summed(parts: Sequence[NormalEquations]) -> NormalEquations | None:
    """Return the normal equations of several clouds at one transform together; None without correspondences."""
    if not any(part.weight > 0.0 for part in parts):
        return None
    return NormalEquations(
        normal_matrix=sum((part.normal_matrix for part in parts), np.zeros((3, 3))),
        by_normal_errors=sum((part.by_normal_errors for part in parts), np.zeros((3, 3))),
        gradient=sum((part.gradient for part in parts), np.zeros(3)),
        weight=sum(part.weight for part in parts),
        square=sum(part.square for part in parts),
        inliers=np.concatenate([part.inliers for part in parts]),
    )


def moved(transform: Floats, step: Floats, free: Freedom) -> Floats:
    """Return `transform` after a motion (3,): east, north [m], yaw [rad], or up [m], roll, pitch [rad]."""
    shift, turn = _parameter_motions(transform, free)
    moved = transform.copy()
    moved[:3, 3] += step @ shift
    moved[:3, :3] = _rotation(step @ turn) @ transform[:3, :3]
    return moved


def _parameter_motions(transform: Floats, free: Freedom) -> tuple[Floats, Floats]:
    """Return shift (3, 3) and turn (3, 3) in the map's frame, one row per parameter."""
    shift, turn = np.zeros((3, 3)), np.zeros((3, 3))
    if free == "planar":
        shift[0, 0] = shift[1, 1] = turn[2, 2] = 1.0
    else:
        shift[0, 2] = 1.0
        turn[1], turn[2] = transform[:3, 0], transform[:3, 1]
    return shift, turn


def _rotation(turn: Floats) -> Floats:
    """Return the rotation of a rotation vector (3,), by Rodrigues' formula."""
    x, y, z = turn.tolist()
    angle = math.hypot(x, y, z)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Floats = np.eye(3) + _sinc(angle) * k + 0.5 * _sinc(0.5 * angle) ** 2 * (k @ k)
    return rotation


def _sinc(angle_rad: float) -> float:
    return math.sin(angle_rad) / angle_rad if angle_rad else 1.0


def _motion_m(a: Floats, b: Floats) -> float:
    """Return an upper bound of the motion of points within `_SEARCH_REACH_M`."""
    return float(
        np.linalg.norm(a[:3, 3] - b[:3, 3]) + _SEARCH_REACH_M * np.linalg.norm(a[:3, :3] - b[:3, :3])
    )


def _has_converged(step: Floats, free: Freedom) -> bool:
    metres, radians = (step[:2], step[2:]) if free == "planar" else (step[:1], step[1:])
    return bool(np.abs(metres).max() < _STEP_M and np.abs(radians).max() < _STEP_RAD)


class _Planes(NamedTuple):
    points_m: Floats
    normals: Floats
    thickness_m: Floats
    variance_rad2: Floats


class _Motions(NamedTuple):
    """Origin (3,) of the local frame, and what each parameter does about it."""

    origin_m: Floats
    shift: Floats
    turn: Floats


class _Sums(NamedTuple):
    matrix: Floats
    noise: Floats
    gradient: Floats


@compiled
def _accumulate(
    planes: _Planes,
    points_m: Floats,
    correspondences: Correspondences,
    max_distance_m: float,
    motions: _Motions,
    noise_m2: float,
    sums: _Sums,
    inliers: Mask,
) -> tuple[float, float]:
    """Fill the sums and the inliers; return the sums of robust weights and of squares."""
    rows, distance_m = correspondences
    matrix, noise, gradient = sums
    origin_m, shift, turn = motions
    normals = planes.normals
    sum_weight, sum_square = 0.0, 0.0
    motion, j = np.empty((3, 3)), np.empty(3)
    for i in range(len(points_m)):
        if not distance_m[i] <= max_distance_m:
            continue
        m = rows[i]
        x, y, z = points_m[i, 0] - origin_m[0], points_m[i, 1] - origin_m[1], points_m[i, 2] - origin_m[2]
        residual = 0.0
        for d in range(3):
            residual += normals[m, d] * (planes.points_m[m, d] - points_m[i, d])
        for c in range(3):
            motion[c, 0] = shift[c, 0] + turn[c, 1] * z - turn[c, 2] * y
            motion[c, 1] = shift[c, 1] + turn[c, 2] * x - turn[c, 0] * z
            motion[c, 2] = shift[c, 2] + turn[c, 0] * y - turn[c, 1] * x
            j[c] = normals[m, 0] * motion[c, 0] + normals[m, 1] * motion[c, 1] + normals[m, 2] * motion[c, 2]
        variance_m2 = noise_m2 + planes.thickness_m[m] ** 2
        square = residual * residual / variance_m2
        robust = 1.0 / (1.0 + square / _CAUCHY**2)
        weight = robust / variance_m2
        inliers[i] = robust > 0.5
        sum_weight += robust
        sum_square += robust * square
        noise_weight = weight * planes.variance_rad2[m]
        for c in range(3):
            gradient[c] += weight * j[c] * residual
            for e in range(c, 3):
                matrix[c, e] += weight * j[c] * j[e]
                both = motion[c, 0] * motion[e, 0] + motion[c, 1] * motion[e, 1] + motion[c, 2] * motion[e, 2]
                noise[c, e] += noise_weight * (both - j[c] * j[e])
    for c in range(3):
        for e in range(c):
            matrix[c, e], noise[c, e] = matrix[e, c], noise[e, c]
    return sum_weight, sum_square

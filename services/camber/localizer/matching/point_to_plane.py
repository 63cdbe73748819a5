"""Point-to-plane least squares that moves three degrees of freedom and no direction that the planes leave open.

A layer of walls says little of height, roll and pitch, and a road nothing of the rest: fitting six degrees of freedom
to either lets the weak ones wander and drag the others along. So a fit is *planar* (east, north, yaw) or *vertical*
(up, roll, pitch), about the origin of the local frame.

A row counts by the thickness of the map's surface there and the noise of both clouds, and less the farther it is off
(Cauchy). The scale of the noise begins wide and narrows from step to step, so that a start half a metre off still
pulls and what moved since the map was made does not in the end.

Normals err, so every direction looks a little seen. How much of the normal matrix that explains is known from the
normals' variance: directions in which there is not clearly more are degenerate. The fit never moves along them, and
their information is zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.se3 import transform_points
from camber.localizer.matching.registration import LayerTarget

Floats = NDArray[np.float64]
Correspondences = tuple[NDArray[np.int64], Floats]
Free = Literal["planar", "vertical"]

NOISE_M = 0.03
"""Standard deviation of a point about a surface of no thickness: ranging, de-skewing, the thinning of both clouds."""
DEGENERATE_RATIO = 2.0
"""A direction is seen where the rows hold this many times what errors of the normals alone would put there."""
MAX_ITERATIONS = 30
LAST_DISTANCE_M = 0.5
"""Pairs farther apart than this are dropped once the scale has narrowed."""
_NARROWING = 0.7
_CAUCHY = 2.385  # 95 % efficient on normal errors
_SEARCH_AGAIN_M = 0.02  # a tenth of the map's grid: below it the nearest map point hardly changes
_SEARCH_REACH_M = 30.0
_STEP_M = 1.0e-3
_STEP_RAD = 1.0e-4


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What point-to-plane rows at a transform say of three parameters; rows weighted by 1/σ²."""

    normal_matrix: Floats
    """(3, 3), of all rows."""
    by_chance: Floats
    """(3, 3), what the errors of the normals alone would put there."""
    gradient: Floats
    """(3,)"""
    weight: float
    """Sum of the robust weights, at most 1 for a pair."""
    square: float
    """Sum of (residual / σ)², weighted so."""
    kept: NDArray[np.bool_]
    """(n,) rows that were paired and not put down as outliers."""

    def seen(self) -> tuple[Floats, Floats, Floats]:
        """Ratios (3,) of the normal matrix to chance, ascending, and the directions they belong to.

        The second is (3, 3), a direction in each column, with unit by_chance; the third the columns' duals,
        Σ ratioₖ dualₖ dualₖᵀ = normal_matrix.
        """
        size = np.sqrt(np.maximum(np.diag(self.normal_matrix), 1e-12))
        # A floor keeps planes without errors invertible.
        chance = self.by_chance / np.outer(size, size) + 1e-6 * np.eye(3)
        root = np.linalg.cholesky(chance)
        inverse = np.linalg.inv(root)
        ratios, vectors = np.linalg.eigh(inverse @ (self.normal_matrix / np.outer(size, size)) @ inverse.T)
        return ratios, (inverse.T @ vectors) / size[:, None], (root @ vectors) * size[:, None]

    def step(self) -> Floats:
        """Gauss–Newton step (3,) within the directions that are seen."""
        ratios, directions, _ = self.seen()
        use = ratios >= DEGENERATE_RATIO
        along: Floats = directions[:, use]
        step: Floats = along @ ((along.T @ self.gradient) / ratios[use])
        return step

    def information(self) -> Floats:
        """(3, 3) of the rows as if they were independent, less what chance puts there; zero where degenerate."""
        ratios, _, duals = self.seen()
        use = ratios >= DEGENERATE_RATIO
        seen: Floats = duals[:, use]
        information: Floats = (seen * (ratios[use] - 1.0)) @ seen.T
        return information


@dataclass(frozen=True, eq=False)
class IcpResult:
    """Where a fit ended: map_from_local (4, 4), and whether its last step was small."""

    transform: Floats
    converged: bool
    iterations: int


def icp_point_to_plane(
    layers: Sequence[tuple[LayerTarget, Floats]],
    guess: Floats,
    free: Free,
    max_distance_m: float,
    first_scale_m: float,
    last_scale_m: float = 0.0,
    max_iterations: int = MAX_ITERATIONS,
) -> IcpResult:
    """Fit clouds (n, 3) [m], each to its part of the map, all by one motion from `guess`, map_from_local (4, 4).

    The scale narrows from the first to the last; pairs may be `max_distance_m` apart, and once the scale is below the
    noise `LAST_DISTANCE_M` at most. A fit that ends at a wide scale is a start for another and does not wait for its
    steps to be small.
    """
    transform = np.array(guess, dtype=np.float64)
    scale_m, searched_at, pairs = first_scale_m, transform, list[Correspondences]()
    for iteration in range(1, max_iterations + 1):
        last = scale_m < max(NOISE_M, last_scale_m)
        distance_m = min(max_distance_m, LAST_DISTANCE_M) if scale_m < NOISE_M else max_distance_m
        if not pairs or _apart_m(transform, searched_at) > _SEARCH_AGAIN_M:
            pairs = [find_correspondences(target, source, transform) for target, source in layers]
            searched_at = transform
        width_m = scale_m if scale_m >= NOISE_M else 0.0
        rows = summed(
            [
                normal_equations(target, source, transform, free, pair, distance_m, width_m)
                for (target, source), pair in zip(layers, pairs, strict=True)
            ]
        )
        if rows is None:
            return IcpResult(transform, False, iteration)
        step = rows.step()
        transform = moved(transform, step, free)
        if last and (last_scale_m > NOISE_M or _is_small(step, free)):
            return IcpResult(transform, True, iteration)
        scale_m *= _NARROWING
    return IcpResult(transform, False, max_iterations)


def find_correspondences(target: LayerTarget, source_m: Floats, transform: Floats) -> Correspondences:
    """Of a cloud (n, 3) [m] at `transform` the rows (n,) of the nearest map points, and their distances (n,) [m]."""
    if target.empty or not len(source_m):
        return np.zeros(len(source_m), np.int64), np.full(len(source_m), np.inf)
    return target.nearest(transform_points(transform, source_m))


def normal_equations(
    target: LayerTarget,
    source_m: Floats,
    transform: Floats,
    free: Free,
    pairs: Correspondences,
    max_distance_m: float = LAST_DISTANCE_M,
    scale_m: float = 0.0,
) -> NormalEquations:
    """The rows of a cloud (n, 3) [m] at `transform`, map_from_local (4, 4); `scale_m` widens their σ."""
    matrix, chance, gradient = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    kept = np.zeros(len(source_m), np.bool_)
    if target.empty or not len(source_m):
        return NormalEquations(matrix, chance, gradient, 0.0, 0.0, kept)
    points_m = transform_points(transform, source_m)
    shift, turn = _motions(transform, free)
    weight, square = _accumulate(
        points_m, target.points_m, target.normals, target.thickness_m, target.normal_variance_rad2, *pairs,
        np.ascontiguousarray(transform[:3, 3]), shift, turn, max_distance_m, NOISE_M**2 + scale_m**2,
        matrix, chance, gradient, kept,
    )  # fmt: skip
    return NormalEquations(matrix, chance, gradient, weight, square, kept)


def summed(parts: Sequence[NormalEquations]) -> NormalEquations | None:
    """The rows of several clouds at one transform together; None where none is paired."""
    if not any(part.weight > 0.0 for part in parts):
        return None
    return NormalEquations(
        sum((part.normal_matrix for part in parts), np.zeros((3, 3))),
        sum((part.by_chance for part in parts), np.zeros((3, 3))),
        sum((part.gradient for part in parts), np.zeros(3)),
        sum(part.weight for part in parts),
        sum(part.square for part in parts),
        np.concatenate([part.kept for part in parts]),
    )


def moved(transform: Floats, step: Floats, free: Free) -> Floats:
    """`transform` after a motion (3,): east, north [m], yaw [rad], or up [m], roll, pitch [rad]."""
    shift, turn = _motions(transform, free)
    moved = transform.copy()
    moved[:3, 3] += step @ shift
    moved[:3, :3] = _rotation(step @ turn) @ transform[:3, :3]
    return moved


def _motions(transform: Floats, free: Free) -> tuple[Floats, Floats]:
    """What each parameter does in the map's frame: shifts (3, 3) and turns (3, 3), a row for each."""
    shift, turn = np.zeros((3, 3)), np.zeros((3, 3))
    if free == "planar":
        shift[0, 0] = shift[1, 1] = turn[2, 2] = 1.0
    else:
        shift[0, 2] = 1.0
        turn[1], turn[2] = transform[:3, 0], transform[:3, 1]
    return shift, turn


def _rotation(turn: Floats) -> Floats:
    """Rodrigues' formula, of a rotation vector (3,)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    rotation: Floats = np.eye(3) + np.sinc(angle / np.pi) * k + half * (k @ k)
    return rotation


def _apart_m(a: Floats, b: Floats) -> float:
    """How far a motion takes points 30 m away, at most."""
    return float(
        np.linalg.norm(a[:3, 3] - b[:3, 3]) + _SEARCH_REACH_M * np.linalg.norm(a[:3, :3] - b[:3, :3])
    )


def _is_small(step: Floats, free: Free) -> bool:
    metres, radians = (step[:2], step[2:]) if free == "planar" else (step[:1], step[1:])
    return bool(np.abs(metres).max() < _STEP_M and np.abs(radians).max() < _STEP_RAD)


@compiled
def _accumulate(
    points_m: Floats, map_m: Floats, normals: Floats, thickness_m: Floats, normal_variance_rad2: Floats,
    rows: NDArray[np.int64], distance_m: Floats, origin_m: Floats, shift: Floats, turn: Floats,
    max_distance_m: float, noise_m2: float,
    matrix: Floats, chance: Floats, gradient: Floats, kept: NDArray[np.bool_],
) -> tuple[float, float]:  # fmt: skip
    sum_weight, sum_square = 0.0, 0.0
    motion, j = np.empty((3, 3)), np.empty(3)
    for i in range(len(points_m)):
        if not distance_m[i] <= max_distance_m:
            continue
        m = rows[i]
        x, y, z = points_m[i, 0] - origin_m[0], points_m[i, 1] - origin_m[1], points_m[i, 2] - origin_m[2]
        residual = 0.0
        for d in range(3):
            residual += normals[m, d] * (map_m[m, d] - points_m[i, d])
        for c in range(3):
            motion[c, 0] = shift[c, 0] + turn[c, 1] * z - turn[c, 2] * y
            motion[c, 1] = shift[c, 1] + turn[c, 2] * x - turn[c, 0] * z
            motion[c, 2] = shift[c, 2] + turn[c, 0] * y - turn[c, 1] * x
            j[c] = normals[m, 0] * motion[c, 0] + normals[m, 1] * motion[c, 1] + normals[m, 2] * motion[c, 2]
        variance_m2 = noise_m2 + thickness_m[m] ** 2
        square = residual * residual / variance_m2
        robust = 1.0 / (1.0 + square / _CAUCHY**2)
        weight = robust / variance_m2
        kept[i] = robust > 0.5
        sum_weight += robust
        sum_square += robust * square
        chance_weight = weight * normal_variance_rad2[m]
        for c in range(3):
            gradient[c] += weight * j[c] * residual
            for e in range(c, 3):
                matrix[c, e] += weight * j[c] * j[e]
                both = motion[c, 0] * motion[e, 0] + motion[c, 1] * motion[e, 1] + motion[c, 2] * motion[e, 2]
                chance[c, e] += chance_weight * (both - j[c] * j[e])
    for c in range(3):
        for e in range(c):
            matrix[c, e], chance[c, e] = matrix[e, c], chance[e, c]
    return sum_weight, sum_square

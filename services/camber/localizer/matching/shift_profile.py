"""Likelihood of a match under shifts along its worst direction: the local map over the map, both seen from above.

Least squares gives the curvature at its minimum, not whether there is another minimum, nor whether the few objects that
observe the direction are there at all. So the likelihood of shifts up to 3 m to both sides is integrated: a cell of
the local map either hits static structure of the map, within the blur, or is an outlier (ε). Cells and not points
count, for a thousand points on one post are one post.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.se3 import transform_points
from camber.localizer.arrays import Floats, Integers

CELL_M: Final = 0.1  # chosen: below the blur
BLUR_M: Final = 0.15
"""Chosen: σ of a hit, half the map's grid and the noise of both clouds."""
_STAMP: Final = 4  # cells around a point that the blur reaches
REACH_M: Final = 3.0  # chosen: what lies farther off is left to the coarse search
STEP_M: Final = 0.1  # of the shifts: one cell
PATCH_M: Final = 0.5
"""Chosen: cells of the local map that count as one observation."""
OUTLIER_SHARE: Final = 0.2
"""Chosen: ε, share of cells that are traffic, visitors and leaves."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyRaster:
    """Proximity, 0 to 255, to static structure (rows, columns), east by north from a corner."""

    corner_m: Floats
    proximity: NDArray[np.uint8]

    @classmethod
    def of(cls, points_m: Floats) -> OccupancyRaster:
        """Draw points (n, 3) [m] of static structure."""
        if not len(points_m):
            return cls(np.zeros(2), np.zeros((1, 1), np.uint8))
        corner_m = points_m[:, :2].min(axis=0) - (_STAMP + 1) * CELL_M
        size = np.ceil((points_m[:, :2].max(axis=0) - corner_m) / CELL_M).astype(np.int64) + _STAMP + 2
        proximity = np.zeros((int(size[0]), int(size[1])), np.uint8)
        _stamp(np.ascontiguousarray(points_m[:, :2]), corner_m, proximity)
        return cls(corner_m, proximity)


class ShiftProfile(NamedTuple):
    """Mean and σ [m] of the shift by the likelihoods, the match itself at zero."""

    mean_m: float
    sigma_m: float

    @property
    def variance_m2(self) -> float:
        """Second moment about the match."""
        return self.mean_m**2 + self.sigma_m**2


def shift_profile(points_m: Floats, occupancy: OccupancyRaster, direction: Floats) -> ShiftProfile:
    """Return the profile of points (n, 2) or (n, 3) [m] in the map's frame, as matched, along a unit vector (2,)."""
    if not len(points_m):
        return ShiftProfile(0.0, REACH_M)
    plane_m = np.ascontiguousarray(points_m[:, :2])
    steps = round(REACH_M / STEP_M)
    shifts_m: Floats = STEP_M * np.arange(-steps, steps + 1).astype(np.float64)
    score = _log_likelihoods(plane_m, _patches(plane_m), occupancy, shifts_m[:, None] * direction)
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    mean_m = float(weight @ shifts_m)
    return ShiftProfile(mean_m, math.sqrt(float(weight @ (shifts_m - mean_m) ** 2) + STEP_M**2 / 12.0))


def log_likelihoods(points_m: Floats, poses: Sequence[Floats], occupancy: OccupancyRaster) -> Floats:
    """Return the log-likelihood of each pose, map_from_local (4, 4), of a local map (n, 3) [m], up to a constant."""
    if not len(points_m):
        return np.zeros(len(poses))
    patch, no_shift = _patches(points_m), np.zeros((1, 2))
    placed = (np.ascontiguousarray(transform_points(pose, points_m)[:, :2]) for pose in poses)
    return np.array([_log_likelihoods(plane_m, patch, occupancy, no_shift)[0] for plane_m in placed])


def _log_likelihoods(
    plane_m: Floats, patch: Integers, occupancy: OccupancyRaster, shifts_m: Floats
) -> Floats:
    return _scores(
        plane_m, patch, corner_m=occupancy.corner_m, proximity=occupancy.proximity, shifts_m=shifts_m
    )


def _patches(points_m: Floats) -> Integers:
    """Return the number (n,) of each point's patch."""
    patch = np.floor(points_m[:, :2] / PATCH_M).astype(np.int64)
    patch -= patch.min(axis=0)
    number = patch[:, 0] * (int(patch[:, 1].max()) + 1) + patch[:, 1]
    numbers: Integers = np.unique(number, return_inverse=True)[1].astype(np.int64)
    return numbers


@compiled_without_gil
def _stamp(plane_m: Floats, corner_m: Floats, proximity: NDArray[np.uint8]) -> None:
    """Draw each point with the blur."""
    for i in range(len(plane_m)):
        row = int((plane_m[i, 0] - corner_m[0]) / CELL_M)
        column = int((plane_m[i, 1] - corner_m[1]) / CELL_M)
        if proximity[row, column] == 255:
            continue
        for r in range(-_STAMP, _STAMP + 1):
            for c in range(-_STAMP, _STAMP + 1):
                square = (r * r + c * c) * CELL_M * CELL_M
                value = np.uint8(255.0 * math.exp(-0.5 * square / (BLUR_M * BLUR_M)))
                if value > proximity[row + r, column + c]:
                    proximity[row + r, column + c] = value


@compiled_without_gil
def _scores(
    plane_m: Floats, patch: Integers, corner_m: Floats, proximity: NDArray[np.uint8], shifts_m: Floats
) -> Floats:
    """Return the log-likelihood of each shift (k, 2), over all patches."""
    patches = patch.max() + 1
    count = np.zeros(patches)
    for i in range(len(patch)):
        count[patch[i]] += 1.0
    scores = np.zeros(len(shifts_m))
    hit = np.empty(patches)
    for s in range(len(shifts_m)):
        hit[:] = 0.0
        for i in range(len(plane_m)):
            east = plane_m[i, 0] + shifts_m[s, 0] - corner_m[0]
            north = plane_m[i, 1] + shifts_m[s, 1] - corner_m[1]
            row, column = int(east / CELL_M), int(north / CELL_M)
            if east >= 0.0 and north >= 0.0 and row < proximity.shape[0] and column < proximity.shape[1]:
                hit[patch[i]] += proximity[row, column]
        for k in range(patches):
            scores[s] += math.log(OUTLIER_SHARE + (1.0 - OUTLIER_SHARE) * hit[k] / (255.0 * count[k]))
    return scores

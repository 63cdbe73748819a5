"""How sure is a match along the direction it sees worst: the map seen from above, and the local map shifted over it.

Least squares knows the bottom of the valley it stands in, not whether there is another one, nor whether the few things
that tell the direction are things at all. So the likelihood of shifts up to 3 m to either side is added up: a cell of
the local map either hits what stands in the map, within the blur, or is something else (ε). Cells and not points
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

Floats = NDArray[np.float64]
Raster = NDArray[np.uint8]

CELL_M: Final = 0.1
BLUR_M: Final = 0.15
"""Standard deviation of a hit: half the map's grid, and the noise of both clouds."""
_STAMP: Final = 4
REACH_M: Final = 3.0
STEP_M: Final = 0.1
PATCH_M: Final = 0.5
"""Cells of the local map that count as one observation."""
ELSE: Final = 0.2
"""ε: share of cells that are traffic, visitors, leaves."""
CORRELATED: Final = 1.0
"""Patches that err alike. One: on simulated streets even a half of it claims no more than the errors bear out."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyRaster:
    """Nearness (rows, columns) of 0 to 255 to what stands, east by north, from a corner."""

    corner_m: Floats
    nearness: Raster

    @classmethod
    def of(cls, points_m: Floats) -> OccupancyRaster:
        """Of points (n, 3) [m] of what stands."""
        if not len(points_m):
            return cls(np.zeros(2), np.zeros((1, 1), np.uint8))
        corner_m = points_m[:, :2].min(axis=0) - (_STAMP + 1) * CELL_M
        size = np.ceil((points_m[:, :2].max(axis=0) - corner_m) / CELL_M).astype(np.int64) + _STAMP + 2
        nearness = np.zeros((int(size[0]), int(size[1])), np.uint8)
        _stamp(np.ascontiguousarray(points_m[:, :2]), corner_m, nearness)
        return cls(corner_m, nearness)


class ShiftProfile(NamedTuple):
    """Mean and standard deviation [m] of the shift that the likelihoods speak for, the match itself at zero."""

    mean_m: float
    sigma_m: float

    @property
    def variance_m2(self) -> float:
        """About the match."""
        return self.mean_m**2 + self.sigma_m**2


def shift_profile(points_m: Floats, above: OccupancyRaster, direction: Floats) -> ShiftProfile:
    """Of points (n, 2) or (n, 3) [m] in the map's frame, as matched, along a unit vector (2,)."""
    if not len(points_m):
        return ShiftProfile(0.0, REACH_M)
    plane_m = np.ascontiguousarray(points_m[:, :2])
    number = _patches(plane_m)
    steps = round(REACH_M / STEP_M)
    shifts_m: Floats = STEP_M * np.arange(-steps, steps + 1).astype(np.float64)
    score = _scores(plane_m, number, above.corner_m, above.nearness, shifts_m, direction)
    weight = np.exp((score - score.max()) / CORRELATED)
    weight /= weight.sum()
    mean_m = float(weight @ shifts_m)
    return ShiftProfile(mean_m, math.sqrt(float(weight @ (shifts_m - mean_m) ** 2) + STEP_M**2 / 12.0))


def log_likelihoods(points_m: Floats, poses: Sequence[Floats], above: OccupancyRaster) -> Floats:
    """How well each of some poses (4, 4), map from local, explains what stands in a local map (n, 3) [m]; up to a
    common constant."""
    if not len(points_m):
        return np.zeros(len(poses))
    number = _patches(points_m)
    still, anywhere = np.zeros(1), np.zeros(2)
    scores = [
        _scores(
            np.ascontiguousarray(transform_points(pose, points_m)[:, :2]),
            number, above.corner_m, above.nearness, still, anywhere,
        )[0]
        for pose in poses
    ]  # fmt: skip
    return np.array(scores) / CORRELATED


def _patches(points_m: Floats) -> NDArray[np.int64]:
    """The number (n,) of each point's patch."""
    patch = np.floor(points_m[:, :2] / PATCH_M).astype(np.int64)
    patch -= patch.min(axis=0)
    number = patch[:, 0] * (int(patch[:, 1].max()) + 1) + patch[:, 1]
    numbers: NDArray[np.int64] = np.unique(number, return_inverse=True)[1].astype(np.int64)
    return numbers


@compiled_without_gil
def _stamp(plane_m: Floats, corner_m: Floats, nearness: Raster) -> None:
    for i in range(len(plane_m)):
        row = int((plane_m[i, 0] - corner_m[0]) / CELL_M)
        column = int((plane_m[i, 1] - corner_m[1]) / CELL_M)
        if nearness[row, column] == 255:
            continue
        for r in range(-_STAMP, _STAMP + 1):
            for c in range(-_STAMP, _STAMP + 1):
                square = (r * r + c * c) * CELL_M * CELL_M
                value = np.uint8(255.0 * math.exp(-0.5 * square / (BLUR_M * BLUR_M)))
                if value > nearness[row + r, column + c]:
                    nearness[row + r, column + c] = value


@compiled_without_gil
def _scores(
    plane_m: Floats,
    patch: NDArray[np.int64],
    corner_m: Floats,
    nearness: Raster,
    shifts_m: Floats,
    direction: Floats,
) -> Floats:
    patches = patch.max() + 1
    count = np.zeros(patches)
    for i in range(len(patch)):
        count[patch[i]] += 1.0
    scores = np.zeros(len(shifts_m))
    hit = np.empty(patches)
    for s in range(len(shifts_m)):
        hit[:] = 0.0
        for i in range(len(plane_m)):
            east = plane_m[i, 0] + shifts_m[s] * direction[0] - corner_m[0]
            north = plane_m[i, 1] + shifts_m[s] * direction[1] - corner_m[1]
            row, column = int(east / CELL_M), int(north / CELL_M)
            if east >= 0.0 and north >= 0.0 and row < nearness.shape[0] and column < nearness.shape[1]:
                hit[patch[i]] += nearness[row, column]
        for k in range(patches):
            scores[s] += math.log(ELSE + (1.0 - ELSE) * hit[k] / (255.0 * count[k]))
    return scores

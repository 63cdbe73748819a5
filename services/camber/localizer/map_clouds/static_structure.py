"""Which points of a map belong to what cannot have moved since the survey: to columns from knee to overhead.

Cars, bins and fences end below the height of a person; crowns of trees begin above it, and grow. Walls, posts and
trunks do neither. Under a roof that follows the road, in a tunnel, whatever stands was built there. That is told from
the map alone, so a car that stood there on the survey's day, and fits no better than the one that stands there now, is
left out of what a pose is taken from.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil

Floats = NDArray[np.float64]

COLUMN_M: Final = 0.5
"""Edge of a column, so that a leaning trunk or a wall with a plinth is one."""
LOWEST_M: Final = 0.4
STEP_M: Final = 0.4
STEPS: Final = 6
"""From 0.4 m to 2.8 m above the road: higher than vans, lower than most crowns."""
FILLED: Final = 5
"""Steps with points that make a column steady: a gap of one may be a window, a sign or bad luck."""

ROOF_CELL_M: Final = 2.0
ROOF_M: Final = (3.5, 8.0)
ROOF_POINTS: Final = 8
ROOF_SPREAD_M: Final = 0.15
"""A roof is even, seen from the road; a crown over a road is not."""


def static_mask(points_m: Floats, heights_m: Floats) -> NDArray[np.bool_]:
    """Of points (n, 3) with heights (n,) above the road, NaN where there is none: is each part of a steady column?"""
    if not len(points_m):
        return np.zeros(0, np.bool_)
    cells = np.floor(points_m[:, :2] / COLUMN_M).astype(np.int64)
    cells -= cells.min(axis=0)
    columns = int(cells[:, 1].max()) + 1
    number = cells[:, 0] * columns + cells[:, 1]
    steady = _static_columns(number, heights_m, (int(cells[:, 0].max()) + 1) * columns)
    return steady | _under_roof(points_m, heights_m)


def _under_roof(points_m: Floats, heights_m: Floats) -> NDArray[np.bool_]:
    """Of points (n, 3), which are below a roof or within a cell of one."""
    cells = np.floor(points_m[:, :2] / ROOF_CELL_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    rows, columns = (cells.max(axis=0) + 2).tolist()
    number = cells[:, 0] * columns + cells[:, 1]
    high = (heights_m > ROOF_M[0]) & (heights_m < ROOF_M[1])
    count = np.bincount(number[high], minlength=rows * columns)
    least = np.maximum(count, 1)
    mean_m = np.bincount(number[high], heights_m[high], rows * columns) / least
    square = np.bincount(number[high], heights_m[high] ** 2, rows * columns) / least
    roof = (count >= ROOF_POINTS) & (square - mean_m**2 < ROOF_SPREAD_M**2)
    around = roof.reshape(rows, columns)
    near = np.zeros_like(around)
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            near |= np.roll(around, (row, column), axis=(0, 1))
    below: NDArray[np.bool_] = near.reshape(-1)[number] & (heights_m < ROOF_M[0])
    return below


@compiled_without_gil
def _static_columns(number: NDArray[np.int64], heights_m: Floats, count: int) -> NDArray[np.bool_]:
    seen = np.zeros(count, np.uint8)
    for i in range(len(number)):
        step = np.floor((heights_m[i] - LOWEST_M) / STEP_M)
        if 0.0 <= step < STEPS:  # NaN is not
            seen[number[i]] |= np.uint8(1 << int(step))
    steady = np.zeros(len(number), np.bool_)
    for i in range(len(number)):
        filled = 0
        for step in range(STEPS):
            filled += (seen[number[i]] >> step) & 1
        steady[i] = filled >= FILLED
    return steady

"""Static structure: points of a map that cannot have moved since the survey, by columns from knee to overhead height.

Cars, bins and fences end below the height of a person; crowns of trees begin above it, and grow. Walls, posts and
trunks do neither. Under a roof that follows the road, in a tunnel, every point is static. This uses the map alone,
so a car of the survey's day, which would match the car parked there now as well as any, is excluded.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.localizer.arrays import Floats, Integers, Mask

COLUMN_M: Final = 0.5
"""Chosen: edge of a column, so that a leaning trunk or a wall with a plinth is one."""
# Chosen: steps from 0.4 m to 2.8 m above the road, higher than vans and lower than most crowns.
LOWEST_M: Final = 0.4
STEP_M: Final = 0.4
STEPS: Final = 6
FILLED: Final = 5
"""Chosen: steps with points that make a column static; a gap of one may be a window, a sign or an occlusion."""

# Chosen: a roof seen from the road is even, a crown over a road is not.
ROOF_CELL_M: Final = 2.0
ROOF_M: Final = (3.5, 8.0)
# Chosen: points of a roof cell, and their spread in height.
ROOF_POINTS: Final = 8
ROOF_SPREAD_M: Final = 0.15


def static_mask(points_m: Floats, heights_m: Floats) -> Mask:
    """Return which points (n, 3) are static, by heights (n,) above the road, NaN where there is none."""
    if not len(points_m):
        return np.zeros(0, np.bool_)
    cells = np.floor(points_m[:, :2] / COLUMN_M).astype(np.int64)
    cells -= cells.min(axis=0)
    columns = int(cells[:, 1].max()) + 1
    number = cells[:, 0] * columns + cells[:, 1]
    in_column = _in_static_columns(number, heights_m, (int(cells[:, 0].max()) + 1) * columns)
    return in_column | _under_roof(points_m, heights_m)


def _under_roof(points_m: Floats, heights_m: Floats) -> Mask:
    """Return which points (n, 3) are below a roof or within a cell of one."""
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
    below: Mask = near.reshape(-1)[number] & (heights_m < ROOF_M[0])
    return below


@compiled_without_gil
def _in_static_columns(number: Integers, heights_m: Floats, count: int) -> Mask:
    seen = np.zeros(count, np.uint8)
    for i in range(len(number)):
        step = np.floor((heights_m[i] - LOWEST_M) / STEP_M)
        if 0.0 <= step < STEPS:  # NaN is not
            seen[number[i]] |= np.uint8(1 << int(step))
    static = np.zeros(len(number), np.bool_)
    for i in range(len(number)):
        filled = 0
        for step in range(STEPS):
            filled += (seen[number[i]] >> step) & 1
        static[i] = filled >= FILLED
    return static

"""A ray's walk through the cells of a grid of shapes, to the nearest surface.

Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing", in the plane; the walk ends where a surface
is nearer than the end of the cell.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.compiled import compiled
from camber.simulator.world.ray_shapes import box_span, crown_span, cylinder_span, triangle_distance
from camber.simulator.world.shape_grid import BOX, CROWN, CYLINDER

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_NEAREST_M = 1.0e-6
"""A surface nearer than this is the one that a ray starts from."""
NOTHING, SOLID, TRIANGLE = -1, 0, 1

Lists = tuple[Integers, Integers, Floats, Floats]
"""The fields of CellLists, in their order."""
Place = tuple[float, float, float, int, int]
"""West, south, size of a cell, columns, rows of a grid."""
Solids = tuple[Integers, Integers, Floats, Floats, Floats]
"""Kind and row of each solid; boxes, cylinders, crowns, as `ray_shapes` takes them."""


@compiled
def into_grid(place: Place, x: float, y: float, dx: float, dy: float, max_m: float) -> tuple[float, float]:
    """The part of a ray, from t to t, above the grid."""
    west, south, cell, columns, rows = place
    t0, t1 = 0.0, max_m
    for origin, step, low, high in (
        (x, dx, west, west + columns * cell),
        (y, dy, south, south + rows * cell),
    ):
        if step == 0.0:
            if origin < low or origin >= high:
                return 1.0, 0.0
        else:
            a, b = (low - origin) / step, (high - origin) / step
            t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
    return t0, t1


@compiled
def walk(
    place: Place, x: float, y: float, dx: float, dy: float, t0: float
) -> tuple[int, int, int, int, float, float, float, float]:
    """Column and row of the first cell, the steps, and t to the next column and row and from one to the next."""
    west, south, cell, columns, rows = place
    column = min(max(int((x + t0 * dx - west) / cell), 0), columns - 1)
    row = min(max(int((y + t0 * dy - south) / cell), 0), rows - 1)
    step_c, next_c, every_c = 0, math.inf, math.inf
    if dx > 0.0:
        step_c, next_c, every_c = 1, (west + (column + 1) * cell - x) / dx, cell / dx
    elif dx < 0.0:
        step_c, next_c, every_c = -1, (west + column * cell - x) / dx, -cell / dx
    step_r, next_r, every_r = 0, math.inf, math.inf
    if dy > 0.0:
        step_r, next_r, every_r = 1, (south + (row + 1) * cell - y) / dy, cell / dy
    elif dy < 0.0:
        step_r, next_r, every_r = -1, (south + row * cell - y) / dy, -cell / dy
    return column, row, step_c, step_r, next_c, next_r, every_c, every_r


@compiled
def _solid_span(
    solids: Solids, k: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    kind, row, boxes, cylinders, crowns = solids
    if kind[k] == BOX:
        return box_span(boxes, row[k], x, y, z, dx, dy, dz)
    if kind[k] == CYLINDER:
        return cylinder_span(cylinders, row[k], x, y, z, dx, dy, dz)
    return crown_span(crowns, row[k], x, y, z, dx, dy, dz)


@compiled
def nearest(
    place: Place,
    solid_lists: Lists,
    triangle_lists: Lists,
    solids: Solids,
    triangles: Floats,
    with_crowns: bool,
    any_will_do: bool,
    ray: tuple[float, float, float, float, float, float],
    max_m: float,
) -> tuple[float, int, int]:
    """Distance to the nearest surface, which sort of shape it is (SOLID, TRIANGLE, NOTHING) and its number."""
    x, y, z, dx, dy, dz = ray
    best, sort, number = max_m, NOTHING, -1
    t, end = into_grid(place, x, y, dx, dy, max_m)
    if t > end:
        return math.inf, NOTHING, -1
    column, row, step_c, step_r, next_c, next_r, every_c, every_r = walk(place, x, y, dx, dy, t)
    columns, rows = place[3], place[4]
    s_first, s_shape, s_span, s_cell = solid_lists
    t_first, t_shape, t_span, t_cell = triangle_lists
    while True:
        leave = min(next_c, next_r, end)
        z0, z1 = z + t * dz, z + leave * dz
        low, high = (z0, z1) if z0 < z1 else (z1, z0)
        cell = row * columns + column
        if low <= t_cell[cell, 1] and high >= t_cell[cell, 0]:
            for j in range(t_first[cell], t_first[cell + 1]):
                if low <= t_span[j, 1] and high >= t_span[j, 0]:
                    at = triangle_distance(triangles, t_shape[j], x, y, z, dx, dy, dz)
                    if _NEAREST_M < at < best:
                        best, sort, number = at, TRIANGLE, t_shape[j]
        if low <= s_cell[cell, 1] and high >= s_cell[cell, 0]:
            for j in range(s_first[cell], s_first[cell + 1]):
                if low <= s_span[j, 1] and high >= s_span[j, 0]:
                    k = s_shape[j]
                    if not with_crowns and solids[0][k] == CROWN:
                        continue
                    enter, out = _solid_span(solids, k, x, y, z, dx, dy, dz)
                    if enter <= out:
                        at = enter if enter > _NEAREST_M else out
                        if _NEAREST_M < at < best:
                            best, sort, number = at, SOLID, k
        if sort != NOTHING and (any_will_do or best <= leave):
            return best, sort, number
        if leave >= end:
            break
        t = leave
        if next_c < next_r:
            column += step_c
            next_c += every_c
            if column < 0 or column >= columns:
                break
        else:
            row += step_r
            next_r += every_r
            if row < 0 or row >= rows:
                break
    if sort == NOTHING:
        return math.inf, NOTHING, -1
    return best, sort, number

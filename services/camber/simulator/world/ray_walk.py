"""A ray's walk through the cells of a grid of shapes, to the nearest surface.

Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing", in the plane; the walk ends where a surface
is nearer than the end of the cell.
"""

from __future__ import annotations

import math

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats, Integers
from camber.simulator.world.ray_shapes import Ray, box_span, crown_span, cylinder_span, triangle_distance
from camber.simulator.world.shape_grid import BOX, CROWN, CYLINDER, Grid, GriddedShapes

_NEAREST_M = 1.0e-6  # chosen: a surface nearer than this is the one that a ray starts from
NOTHING, SOLID, TRIANGLE = -1, 0, 1

Cell = tuple[int, float, float, int, int, float, float]
"""One cell on a ray's path: its number, −1 for none; from where to where on the ray; column, row; where the next column
and row begin."""
Steps = tuple[int, int, float, float, float]
"""To the next column and row, and how far that is on the ray; where the path ends."""

Solids = tuple[Integers, Integers, Floats, Floats, Floats]
"""Kind and row of each solid; boxes, cylinders, crowns."""


@compiled
def first_cell(grid: Grid, ray: Ray, max_m: float) -> tuple[Cell, Steps]:
    """The first cell above which a ray is, for at most so far, and how it goes on; number −1: none."""
    x, y, _, dx, dy, _ = ray
    t, end = 0.0, max_m
    for origin, step, low, high in (
        (x, dx, grid.west_m, grid.west_m + grid.columns * grid.cell_m),
        (y, dy, grid.south_m, grid.south_m + grid.rows * grid.cell_m),
    ):
        if step == 0.0:
            if origin < low or origin >= high:
                end = -1.0
        else:
            a, b = (low - origin) / step, (high - origin) / step
            t, end = max(t, min(a, b)), min(end, max(a, b))
    column = min(max(int((x + t * dx - grid.west_m) / grid.cell_m), 0), grid.columns - 1)
    row = min(max(int((y + t * dy - grid.south_m) / grid.cell_m), 0), grid.rows - 1)
    step_c, next_c, every_c = _steps(column, (grid.west_m, grid.cell_m), x, dx)
    step_r, next_r, every_r = _steps(row, (grid.south_m, grid.cell_m), y, dy)
    number = row * grid.columns + column if t <= end else -1
    cell = number, t, min(next_c, next_r, end), column, row, next_c, next_r
    return cell, (step_c, step_r, every_c, every_r, end)


@compiled
def _steps(number: int, axis: tuple[float, float], x: float, dx: float) -> tuple[int, float, float]:
    """Along one axis (its begin, size of a cell): the step to the next cell, how far that is and to the one after."""
    first_m, cell_m = axis
    if dx > 0.0:
        return 1, (first_m + (number + 1) * cell_m - x) / dx, cell_m / dx
    if dx < 0.0:
        return -1, (first_m + number * cell_m - x) / dx, -cell_m / dx
    return 0, math.inf, math.inf


@compiled
def next_cell(grid: Grid, steps: Steps, cell: Cell) -> Cell:
    """The next one; number −1: the ray ends or leaves the grid."""
    _, _, leave, column, row, next_c, next_r = cell
    step_c, step_r, every_c, every_r, end = steps
    if next_c < next_r:
        column += step_c
        next_c += every_c
    else:
        row += step_r
        next_r += every_r
    inside = leave < end and 0 <= column < grid.columns and 0 <= row < grid.rows
    number = row * grid.columns + column if inside else -1
    return number, leave, min(next_c, next_r, end), column, row, next_c, next_r


@compiled
def heights(ray: Ray, cell: Cell) -> tuple[float, float]:
    """The lowest and highest z of a ray above a cell."""
    z0, z1 = ray[2] + cell[1] * ray[5], ray[2] + cell[2] * ray[5]
    return (z0, z1) if z0 < z1 else (z1, z0)


@compiled
def _solid_span(solids: Solids, k: int, ray: Ray) -> tuple[float, float]:
    kind, row, boxes, cylinders, crowns = solids
    if kind[k] == BOX:
        return box_span(boxes, row[k], ray)
    if kind[k] == CYLINDER:
        return cylinder_span(cylinders, row[k], ray)
    return crown_span(crowns, row[k], ray)


@compiled
def nearest(shapes: GriddedShapes, ray: Ray, max_m: float, blocking: bool) -> tuple[float, int, int]:
    """Distance to the nearest surface, which sort of shape it is (SOLID, TRIANGLE, NOTHING) and its number.

    `blocking`: crowns of trees do not count, and any surface will do.
    """
    best, sort, number = max_m, NOTHING, -1
    # Out of their tuples once: each access in a loop would count references.
    grid, kind, table = shapes.grid, shapes.solid_kind, shapes.corner_and_edges
    solids = kind, shapes.solid_row, shapes.boxes, shapes.cylinders, shapes.crowns
    s_first, s_shape, s_span, s_cell = shapes.solids
    t_first, t_shape, t_span, t_cell = shapes.triangles
    at_cell, steps = first_cell(grid, ray, max_m)
    while at_cell[0] >= 0:
        cell, leave = at_cell[0], at_cell[2]
        low, high = heights(ray, at_cell)
        if low <= t_cell[cell, 1] and high >= t_cell[cell, 0]:
            for j in range(t_first[cell], t_first[cell + 1]):
                if low <= t_span[j, 1] and high >= t_span[j, 0]:
                    at = triangle_distance(table, t_shape[j], ray)
                    if _NEAREST_M < at < best:
                        best, sort, number = at, TRIANGLE, t_shape[j]
        if low <= s_cell[cell, 1] and high >= s_cell[cell, 0]:
            for j in range(s_first[cell], s_first[cell + 1]):
                if low <= s_span[j, 1] and high >= s_span[j, 0]:
                    k = s_shape[j]
                    if blocking and kind[k] == CROWN:
                        continue
                    enter, out = _solid_span(solids, k, ray)
                    if enter <= out:
                        at = enter if enter > _NEAREST_M else out
                        if _NEAREST_M < at < best:
                            best, sort, number = at, SOLID, k
        if sort != NOTHING and (blocking or best <= leave):
            break
        at_cell = next_cell(grid, steps, at_cell)
    return (math.inf, NOTHING, -1) if sort == NOTHING else (best, sort, number)

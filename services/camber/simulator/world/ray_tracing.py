"""Rays against the shapes of a district: what a LiDAR's beams hit, and what stands before a satellite.

All loops are compiled and run without the interpreter's lock, so two threads may ask the same tracer.
"""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled, compiled_without_gil
from camber.simulator.scene import Booleans, Floats, Hits, Shapes
from camber.simulator.world.ray_shapes import (
    box_normal,
    crown_normal,
    crown_span,
    cylinder_normal,
    triangle_normal,
)
from camber.simulator.world.ray_walk import NOTHING, TRIANGLE, first_cell, heights, nearest, next_cell
from camber.simulator.world.shape_grid import BOX, CROWN, CYLINDER, GriddedShapes, gridded

CELL_M = 6.0  # benchmarks/simulator.py


class ShapeTracer:
    """Answers rays against fixed shapes; a ray that starts inside a solid meets its surface from inside.

    All questions are of rays with origins (n, 3) and unit directions (n, 3) in the world frame.
    """

    def __init__(self, shapes: Shapes, cell_m: float = CELL_M) -> None:
        self._shapes = gridded(shapes, cell_m)

    def first_hits(self, origin_m: Floats, direction: Floats, max_range_m: float) -> Hits:
        """The first surface along each ray."""
        origin, towards = _rays(origin_m, direction)
        n = len(origin)
        hits = Hits(distance_m=np.full(n, np.inf), material=np.full(n, -1, np.int64), normal=np.zeros((n, 3)))
        _first_hits(self._shapes, (origin, towards), max_range_m, hits)
        return hits

    def blocked(self, origin_m: Floats, direction: Floats, max_range_m: float) -> Booleans:
        """Is there anything but a tree's crown along each ray? (n,)"""
        return _blocked(self._shapes, _rays(origin_m, direction), max_range_m)

    def through_crowns_m(self, origin_m: Floats, direction: Floats, max_range_m: float) -> Floats:
        """How many metres of tree crowns each ray passes, (n,); where crowns overlap, once. Walls do not end it."""
        rays = _rays(origin_m, direction)
        if not len(self._shapes.crowns):
            return np.zeros(len(rays[0]))
        return _through_crowns(self._shapes, rays, max_range_m)


def _rays(origin_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
    origin = np.ascontiguousarray(origin_m, np.float64)
    towards = np.ascontiguousarray(direction, np.float64)
    if origin.ndim != 2 or origin.shape[1] != 3 or origin.shape != towards.shape:
        raise ValueError(f"origin {origin.shape} and direction {towards.shape}, expected both (n, 3)")
    return origin, towards


@compiled_without_gil
def _first_hits(shapes: GriddedShapes, rays: tuple[Floats, Floats], max_m: float, hits: Hits) -> None:
    origin, towards = rays
    distance, material, normal = hits
    kind, row_of, table = shapes.solid_kind, shapes.solid_row, shapes.corner_and_edges
    boxes, cylinders, crowns = shapes.boxes, shapes.cylinders, shapes.crowns
    solid_material, triangle_material = shapes.solid_material, shapes.triangle_material
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = towards[i, 0], towards[i, 1], towards[i, 2]
        at, sort, k = nearest(shapes, (x, y, z, dx, dy, dz), max_m, False)
        if sort == NOTHING:
            continue
        distance[i] = at
        point = x + at * dx, y + at * dy, z + at * dz
        if sort == TRIANGLE:
            material[i] = triangle_material[k]
            nx, ny, nz = triangle_normal(table, k)
        else:
            material[i] = solid_material[k]
            if kind[k] == BOX:
                nx, ny, nz = box_normal(boxes, row_of[k], point)
            elif kind[k] == CYLINDER:
                nx, ny, nz = cylinder_normal(cylinders, row_of[k], point)
            else:
                nx, ny, nz = crown_normal(crowns, row_of[k], point)
        side = -1.0 if nx * dx + ny * dy + nz * dz > 0.0 else 1.0
        normal[i, 0], normal[i, 1], normal[i, 2] = side * nx, side * ny, side * nz


@compiled_without_gil
def _blocked(shapes: GriddedShapes, rays: tuple[Floats, Floats], max_m: float) -> Booleans:
    origin, towards = rays
    blocked = np.zeros(len(origin), np.bool_)
    for i in range(len(origin)):
        ray = origin[i, 0], origin[i, 1], origin[i, 2], towards[i, 0], towards[i, 1], towards[i, 2]
        blocked[i] = nearest(shapes, ray, max_m, True)[1] != NOTHING
    return blocked


@compiled_without_gil
def _through_crowns(shapes: GriddedShapes, rays: tuple[Floats, Floats], max_m: float) -> Floats:
    origin, towards = rays
    grid, kind, row_of, crowns = shapes.grid, shapes.solid_kind, shapes.solid_row, shapes.crowns
    first, shape, span_m, cell_span = shapes.solids
    spans, metres = np.empty((len(crowns) + 1, 2)), np.zeros(len(origin))
    for i in range(len(origin)):
        ray = origin[i, 0], origin[i, 1], origin[i, 2], towards[i, 0], towards[i, 1], towards[i, 2]
        used = 0
        at_cell, steps = first_cell(grid, ray, max_m)
        while at_cell[0] >= 0:
            cell = at_cell[0]
            low, high = heights(ray, at_cell)
            if low <= cell_span[cell, 1] and high >= cell_span[cell, 0]:
                for j in range(first[cell], first[cell + 1]):
                    k = shape[j]
                    if kind[k] == CROWN and low <= span_m[j, 1] and high >= span_m[j, 0]:
                        a, b = crown_span(crowns, row_of[k], ray)
                        a, b = max(a, 0.0), min(b, max_m)
                        if a < b:
                            used = _joined(spans, used, a, b)
            at_cell = next_cell(grid, steps, at_cell)
        for j in range(used):
            metres[i] += spans[j, 1] - spans[j, 0]
    return metres


@compiled
def _joined(spans: Floats, used: int, a: float, b: float) -> int:
    """Add a span to those that do not touch one another; a crown met in two cells is met once. Returns how many."""
    j = 0
    while j < used:
        if spans[j, 0] <= b and a <= spans[j, 1]:
            a, b = min(a, spans[j, 0]), max(b, spans[j, 1])
            used -= 1
            spans[j, 0], spans[j, 1] = spans[used, 0], spans[used, 1]
            j = 0
        else:
            j += 1
    spans[used, 0], spans[used, 1] = a, b
    return used + 1

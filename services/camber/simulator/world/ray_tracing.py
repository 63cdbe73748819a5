"""Rays against the shapes of a district: what a LiDAR's beams hit, and what stands before a satellite.

All loops are compiled and run without the interpreter's lock, so two threads may ask the same tracer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled, compiled_without_gil
from camber.simulator.scene import Hits, Material, Shapes
from camber.simulator.world.ray_shapes import (
    box_normal,
    crown_normal,
    crown_span,
    cylinder_normal,
    triangle_normal,
)
from camber.simulator.world.ray_walk import (
    NOTHING,
    TRIANGLE,
    Lists,
    Place,
    Solids,
    first_cell,
    heights,
    nearest,
    next_cell,
)
from camber.simulator.world.shape_grid import BOX, CROWN, CYLINDER, CellLists, ShapeGrid, shape_grid

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

CELL_M = 6.0


class ShapeTracer:
    """The Tracer of `scene`. A ray that starts inside a solid meets that solid's surface from inside."""

    def __init__(self, shapes: Shapes, cell_m: float = CELL_M) -> None:
        grid = shape_grid(shapes, cell_m)
        self._crowns = len(shapes.crowns_m)
        self._place = _place(grid)
        self._solid_lists = _lists(grid.solids)
        self._triangle_lists = _lists(grid.triangles)
        boxes = shapes.boxes_m
        rows = np.column_stack((boxes[:, :6], np.cos(boxes[:, 6]), np.sin(boxes[:, 6])))
        self._solids: Solids = (
            grid.solid_kind.astype(np.int64),
            grid.solid_row.astype(np.int64),
            np.ascontiguousarray(rows),
            np.ascontiguousarray(shapes.cylinders_m),
            np.ascontiguousarray(shapes.crowns_m),
        )
        corner = shapes.triangles_m
        self._triangles = np.ascontiguousarray(
            np.concatenate((corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        )
        crowns = np.full(len(shapes.crowns_m), int(Material.TREE), np.int64)
        self._solid_material = np.concatenate((shapes.boxes_material, shapes.cylinders_material, crowns))
        self._triangle_material = shapes.triangles_material

    def first_hits(self, origin_m: Floats, direction: Floats, max_range_m: float) -> Hits:
        """The first surface along each ray; origin (n, 3), direction (n, 3), unit."""
        origin, towards = _rays(origin_m, direction)
        distance = np.full(len(origin), np.inf)
        material = np.full(len(origin), -1, np.int64)
        normal = np.zeros((len(origin), 3))
        _first_hits(
            origin,
            towards,
            max_range_m,
            self._place,
            self._solid_lists,
            self._triangle_lists,
            self._solids,
            self._triangles,
            self._solid_material,
            self._triangle_material,
            distance,
            material,
            normal,
        )
        return Hits(distance, material, normal)

    def blocked(self, origin_m: Floats, direction: Floats, max_range_m: float) -> NDArray[np.bool_]:
        """Is there anything but a tree's crown along each ray? (n,)"""
        origin, towards = _rays(origin_m, direction)
        result = np.zeros(len(origin), np.bool_)
        _blocked(
            origin,
            towards,
            max_range_m,
            self._place,
            self._solid_lists,
            self._triangle_lists,
            self._solids,
            self._triangles,
            result,
        )
        return result

    def through_crowns_m(self, origin_m: Floats, direction: Floats, max_range_m: float) -> Floats:
        """How many metres of tree crowns each ray passes, (n,); where crowns overlap, once. Walls do not end it."""
        origin, towards = _rays(origin_m, direction)
        result = np.zeros(len(origin))
        if self._crowns:
            spans = np.empty((self._crowns + 1, 2))
            _through_crowns(
                origin, towards, max_range_m, self._place, self._solid_lists, self._solids, spans, result
            )
        return result


def _rays(origin_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
    origin = np.ascontiguousarray(origin_m, np.float64)
    towards = np.ascontiguousarray(direction, np.float64)
    if origin.ndim != 2 or origin.shape[1] != 3 or origin.shape != towards.shape:
        raise ValueError(f"origin {origin.shape} and direction {towards.shape}, expected both (n, 3)")
    return origin, towards


def _place(grid: ShapeGrid) -> Place:
    return grid.west_m, grid.south_m, grid.cell_m, grid.columns, grid.rows


def _lists(lists: CellLists) -> Lists:
    return lists.first, lists.shape, lists.span_m, lists.cell_span_m


@compiled_without_gil
def _first_hits(
    origin: Floats,
    towards: Floats,
    max_m: float,
    place: Place,
    solid_lists: Lists,
    triangle_lists: Lists,
    solids: Solids,
    triangles: Floats,
    solid_material: Integers,
    triangle_material: Integers,
    distance: Floats,
    material: Integers,
    normal: Floats,
) -> None:
    kind, row_of, boxes, cylinders, crowns = solids
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = towards[i, 0], towards[i, 1], towards[i, 2]
        at, sort, k = nearest(
            place,
            solid_lists,
            triangle_lists,
            solids,
            triangles,
            True,
            False,
            (x, y, z, dx, dy, dz),
            max_m,
        )
        if sort == NOTHING:
            continue
        distance[i] = at
        px, py, pz = x + at * dx, y + at * dy, z + at * dz
        if sort == TRIANGLE:
            material[i] = triangle_material[k]
            nx, ny, nz = triangle_normal(triangles, k)
        else:
            material[i] = solid_material[k]
            if kind[k] == BOX:
                nx, ny, nz = box_normal(boxes, row_of[k], px, py, pz)
            elif kind[k] == CYLINDER:
                nx, ny, nz = cylinder_normal(cylinders, row_of[k], px, py, pz)
            else:
                nx, ny, nz = crown_normal(crowns, row_of[k], px, py, pz)
        side = -1.0 if nx * dx + ny * dy + nz * dz > 0.0 else 1.0
        normal[i, 0], normal[i, 1], normal[i, 2] = side * nx, side * ny, side * nz


@compiled_without_gil
def _blocked(
    origin: Floats,
    towards: Floats,
    max_m: float,
    place: Place,
    solid_lists: Lists,
    triangle_lists: Lists,
    solids: Solids,
    triangles: Floats,
    result: NDArray[np.bool_],
) -> None:
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = towards[i, 0], towards[i, 1], towards[i, 2]
        ray = (x, y, z, dx, dy, dz)
        _, sort, _ = nearest(place, solid_lists, triangle_lists, solids, triangles, False, True, ray, max_m)
        result[i] = sort != NOTHING


@compiled_without_gil
def _through_crowns(
    origin: Floats,
    towards: Floats,
    max_m: float,
    place: Place,
    solid_lists: Lists,
    solids: Solids,
    spans: Floats,
    result: Floats,
) -> None:
    first, shape, span_m, cell_span = solid_lists
    kind, row_of, _, _, crowns = solids
    for i in range(len(origin)):
        x, y, z = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = towards[i, 0], towards[i, 1], towards[i, 2]
        used = 0
        ray = (x, y, z, dx, dy, dz)
        at_cell, steps = first_cell(place, ray, max_m)
        while at_cell[0] >= 0:
            cell = at_cell[0]
            low, high = heights(ray, at_cell)
            if low <= cell_span[cell, 1] and high >= cell_span[cell, 0]:
                for j in range(first[cell], first[cell + 1]):
                    k = shape[j]
                    if kind[k] == CROWN and low <= span_m[j, 1] and high >= span_m[j, 0]:
                        a, b = crown_span(crowns, row_of[k], x, y, z, dx, dy, dz)
                        a, b = max(a, 0.0), min(b, max_m)
                        if a < b:
                            used = _joined(spans, used, a, b)
            at_cell = next_cell(place, steps, at_cell)
        total = 0.0
        for j in range(used):
            total += spans[j, 1] - spans[j, 0]
        result[i] = total


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

"""Which shapes stand in which cell of a plane grid: what a ray over a district has to look at.

A district is wide and low, so its grid has two dimensions; each shape in a cell carries its lowest and highest point,
and so does each cell, for its triangles (roads, ground: low) apart from its solids (tall). A ray that passes above
or below is done with a cell in two comparisons.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats, Integers, Material, Shapes

BOX, CYLINDER, CROWN = 0, 1, 2
_SLACK_M = (
    1.0e-6  # chosen: shapes count as this much larger, so that rounding at the border of a cell loses none
)
_MOST_CELLS = 4_000_000  # chosen: some 100 MB


class Grid(NamedTuple):
    """Cells from the south-west corner on, row by row."""

    west_m: float
    south_m: float
    cell_m: float
    columns: int
    rows: int


class CellLists(NamedTuple):
    """Shapes by cell: those of cell c are rows `first[c]` to `first[c + 1]` of `shape` and `span_m` (low, high).

    `cell_span_m` (cells, 2) is the lowest and the highest point of what stands in a cell; empty: (inf, −inf).
    """

    first: Integers
    shape: Integers
    span_m: Floats
    cell_span_m: Floats


class GriddedShapes(NamedTuple):
    """Shapes as `ray_shapes` takes them, by cell; solid k is row `solid_row[k]` of the kind `solid_kind[k]`."""

    grid: Grid
    solids: CellLists
    triangles: CellLists
    solid_kind: Integers
    solid_row: Integers
    boxes: Floats
    cylinders: Floats
    crowns: Floats
    corner_and_edges: Floats
    solid_material: Integers
    triangle_material: Integers


def gridded(shapes: Shapes, cell_m: float) -> GriddedShapes:
    """All shapes in one grid; cells grow where there would be more than four million."""
    boxes, cylinders, crowns = shapes.boxes_m, shapes.cylinders_m, shapes.crowns_m
    parts = (boxes, cylinders, crowns)
    solid_m = np.concatenate((_box_outlines(boxes), _round_outlines(cylinders), _round_outlines(crowns)))
    low = np.concatenate((boxes[:, 2], cylinders[:, 2], crowns[:, 2] - crowns[:, 4]))
    high = np.concatenate(
        (boxes[:, 2] + boxes[:, 5], cylinders[:, 2] + cylinders[:, 4], crowns[:, 2] + crowns[:, 4])
    )
    # A triangle is a quadrilateral with its last corner twice.
    triangle_m = np.ascontiguousarray(shapes.triangles_m[:, [0, 1, 2, 2], :2])
    up = shapes.triangles_m[:, :, 2]
    triangle_span = np.column_stack((up.min(axis=1, initial=np.inf), up.max(axis=1, initial=-np.inf)))
    grid = _grid_over(np.concatenate((solid_m.reshape(-1, 2), triangle_m.reshape(-1, 2))), cell_m)
    corner = shapes.triangles_m
    edges = (corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    of_crowns = np.full(len(crowns), int(Material.TREE), np.int64)
    return GriddedShapes(
        grid=grid,
        solids=_cell_lists(solid_m, np.column_stack((low, high)), grid),
        triangles=_cell_lists(triangle_m, triangle_span, grid),
        solid_kind=np.repeat([BOX, CYLINDER, CROWN], [len(part) for part in parts]),
        solid_row=np.concatenate([np.arange(len(part)) for part in parts]),
        boxes=np.ascontiguousarray(np.column_stack((boxes[:, :6], np.cos(boxes[:, 6]), np.sin(boxes[:, 6])))),
        cylinders=np.ascontiguousarray(cylinders),
        crowns=np.ascontiguousarray(crowns),
        corner_and_edges=np.ascontiguousarray(np.concatenate(edges, axis=1)),
        solid_material=np.concatenate((shapes.boxes_material, shapes.cylinders_material, of_crowns)),
        triangle_material=shapes.triangles_material,
    )


def _grid_over(corners: Floats, cell_m: float) -> Grid:
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(2), np.ones(2))
    low, high = low - 0.01, high + 0.01
    cell = max(cell_m, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
    columns, rows = (int(v) for v in np.ceil((high - low) / cell).astype(np.int64) + 1)
    return Grid(west_m=float(low[0]), south_m=float(low[1]), cell_m=cell, columns=columns, rows=rows)


def _box_outlines(boxes: Floats) -> Floats:
    c, s = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    along = np.column_stack((c, s)) * boxes[:, 3:4]
    left = np.column_stack((-s, c)) * boxes[:, 4:5]
    centre = boxes[:, :2]
    corners = (centre + along + left, centre - along + left, centre - along - left, centre + along - left)
    return np.stack(corners, axis=1)


def _round_outlines(solids: Floats) -> Floats:
    """Squares about cylinders and crowns."""
    signs = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    return solids[:, None, :2] + signs * solids[:, None, 3:4]


def _cell_lists(outline_m: Floats, span_m: Floats, grid: Grid) -> CellLists:
    cells = grid.columns * grid.rows
    count = np.zeros(cells + 1, np.int64)
    _visit(outline_m, grid, count, np.zeros(0, np.int64))
    first = np.concatenate(([0], np.cumsum(count[:-1])))
    shape = np.empty(first[-1], np.int64)
    _visit(outline_m, grid, first[:-1].copy(), shape)
    entry_span = span_m[shape] + np.array([-_SLACK_M, _SLACK_M])
    cell_span = np.column_stack((np.full(cells, np.inf), np.full(cells, -np.inf)))
    cell = np.repeat(np.arange(cells), np.diff(first))
    np.minimum.at(cell_span[:, 0], cell, entry_span[:, 0])
    np.maximum.at(cell_span[:, 1], cell, entry_span[:, 1])
    return CellLists(first, shape, entry_span, cell_span)


@compiled
def _visit(outline_m: Floats, grid: Grid, next_of_cell: Integers, shape: Integers) -> None:
    """Count each convex outline (n, 4, 2) in each cell it touches, and write it into `shape` unless that is empty."""
    cell_m = grid.cell_m
    for i in range(len(outline_m)):
        quad = outline_m[i]
        e0, e1 = quad[:, 0].min() - _SLACK_M, quad[:, 0].max() + _SLACK_M
        n0, n1 = quad[:, 1].min() - _SLACK_M, quad[:, 1].max() + _SLACK_M
        for row in range(int((n0 - grid.south_m) / cell_m), int((n1 - grid.south_m) / cell_m) + 1):
            for column in range(int((e0 - grid.west_m) / cell_m), int((e1 - grid.west_m) / cell_m) + 1):
                middle_e = grid.west_m + (column + 0.5) * cell_m
                middle_n = grid.south_m + (row + 0.5) * cell_m
                if _touches(quad, middle_e, middle_n, 0.5 * cell_m + _SLACK_M):
                    cell = row * grid.columns + column
                    if shape.size:
                        shape[next_of_cell[cell]] = i
                    next_of_cell[cell] += 1


@compiled
def _touches(quad: Floats, middle_e: float, middle_n: float, half: float) -> bool:
    """Does a square touch a convex outline? By the separating axes of the outline's sides; its box is known to."""
    for k in range(4):
        a, b = quad[k], quad[(k + 1) % 4]
        e, n = a[1] - b[1], b[0] - a[0]
        low, high = np.inf, -np.inf
        for j in range(4):
            along = quad[j, 0] * e + quad[j, 1] * n
            low, high = min(low, along), max(high, along)
        at = middle_e * e + middle_n * n
        reach = half * (abs(e) + abs(n))
        if at + reach < low or at - reach > high:
            return False
    return True

"""Which shapes stand in which cell of a plane grid: what a ray over a district has to look at.

A district is wide and low, so its grid has two dimensions; each shape in a cell carries its lowest and highest point,
and so does each cell, for its triangles (roads, ground: low) apart from its solids (tall). A ray that passes above
or below is done with a cell in two comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.simulator.scene import Shapes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BOX, CYLINDER, CROWN = 0, 1, 2
_SLACK_M = 1.0e-6
"""Shapes count as this much larger, so that rounding at the border of a cell loses none."""
_MOST_CELLS = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class CellLists:
    """Shapes by cell: those of cell c are rows `first[c]` to `first[c + 1]` of `shape` and `span_m` (low, high).

    `cell_span_m` (cells, 2) is the lowest and the highest point of what stands in a cell; empty: (inf, −inf).
    """

    first: Integers
    shape: Integers
    span_m: Floats
    cell_span_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ShapeGrid:
    """Solids and triangles of a district by cell; solid k is the row `solid_row[k]` of kind `solid_kind[k]`."""

    west_m: float
    south_m: float
    cell_m: float
    columns: int
    rows: int
    solid_kind: Integers
    solid_row: Integers
    solids: CellLists
    triangles: CellLists


def shape_grid(shapes: Shapes, cell_m: float) -> ShapeGrid:
    """The grid over all shapes; cells grow where there would be more than four million."""
    boxes, cylinders, crowns = shapes.boxes_m, shapes.cylinders_m, shapes.crowns_m
    kind = np.repeat([BOX, CYLINDER, CROWN], [len(boxes), len(cylinders), len(crowns)])
    row = np.concatenate([np.arange(len(part)) for part in (boxes, cylinders, crowns)])
    solid_m = np.concatenate((_box_outlines(boxes), _round_outlines(cylinders), _round_outlines(crowns)))
    solid_span = np.concatenate(
        (
            np.column_stack((boxes[:, 2], boxes[:, 2] + boxes[:, 5])),
            np.column_stack((cylinders[:, 2], cylinders[:, 2] + cylinders[:, 4])),
            np.column_stack((crowns[:, 2] - crowns[:, 4], crowns[:, 2] + crowns[:, 4])),
        )
    )
    # A triangle is a quadrilateral with its last corner twice.
    triangle_m = np.ascontiguousarray(shapes.triangles_m[:, [0, 1, 2, 2], :2])
    up = shapes.triangles_m[:, :, 2]
    triangle_span = np.column_stack((up.min(axis=1, initial=np.inf), up.max(axis=1, initial=-np.inf)))
    corners = np.concatenate((solid_m.reshape(-1, 2), triangle_m.reshape(-1, 2)))
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(2), np.ones(2))
    low, high = low - 0.01, high + 0.01
    cell = max(cell_m, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
    columns, rows = (int(v) for v in np.ceil((high - low) / cell).astype(np.int64) + 1)
    west, south = float(low[0]), float(low[1])
    lists = [
        _cell_lists(outline, span, west, south, cell, columns, rows)
        for outline, span in ((solid_m, solid_span), (triangle_m, triangle_span))
    ]
    return ShapeGrid(west, south, cell, columns, rows, kind, row, lists[0], lists[1])


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
    outlines: Floats = solids[:, None, :2] + signs * solids[:, None, 3:4]
    return outlines


def _cell_lists(
    outline_m: Floats, span_m: Floats, west_m: float, south_m: float, cell_m: float, columns: int, rows: int
) -> CellLists:
    place = (west_m, south_m, cell_m, columns, rows)
    count = np.zeros(columns * rows + 1, np.int64)
    _visit(outline_m, *place, count, np.zeros(0, np.int64), False)
    first = np.concatenate(([0], np.cumsum(count[:-1])))
    shape = np.empty(first[-1], np.int64)
    _visit(outline_m, *place, first[:-1].copy(), shape, True)
    entry_span = span_m[shape] + np.array([-_SLACK_M, _SLACK_M])
    cell_span = np.column_stack((np.full(columns * rows, np.inf), np.full(columns * rows, -np.inf)))
    cell = np.repeat(np.arange(columns * rows), np.diff(first))
    np.minimum.at(cell_span[:, 0], cell, entry_span[:, 0])
    np.maximum.at(cell_span[:, 1], cell, entry_span[:, 1])
    return CellLists(first, shape, entry_span, cell_span)


@compiled
def _visit(
    outline_m: Floats,
    west_m: float,
    south_m: float,
    cell_m: float,
    columns: int,
    rows: int,
    next_of_cell: Integers,
    shape: Integers,
    write: bool,
) -> None:
    """Count, or write down, each convex outline (n, 4, 2) in each cell it touches."""
    for i in range(len(outline_m)):
        quad = outline_m[i]
        e0, e1 = quad[:, 0].min() - _SLACK_M, quad[:, 0].max() + _SLACK_M
        n0, n1 = quad[:, 1].min() - _SLACK_M, quad[:, 1].max() + _SLACK_M
        for row in range(int((n0 - south_m) / cell_m), int((n1 - south_m) / cell_m) + 1):
            for column in range(int((e0 - west_m) / cell_m), int((e1 - west_m) / cell_m) + 1):
                middle_e = west_m + (column + 0.5) * cell_m
                middle_n = south_m + (row + 0.5) * cell_m
                if _touches(quad, middle_e, middle_n, 0.5 * cell_m + _SLACK_M):
                    cell = row * columns + column
                    if write:
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

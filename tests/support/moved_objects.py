"""Parked cars, bins and bushes of a cloud, moved or replaced, as between the day of the map and today."""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Cell = tuple[int, int]
Change = Literal["shifted", "shifted_together", "replaced"]

SHARE = 0.4
SHIFT_M = 0.8
LOW_M = (0.2, 2.0)
_CELL_M = 0.4
_LONGEST_M = 6.0
_PIECE_CELLS = 10
_ABOVE_M = 0.5
_STANDING = 0.3
_MIN_POINTS = 15


def objects(points_m: Floats, heights_m: Floats) -> list[NDArray[np.int64]]:
    """Rows of each low object: what is connected 0.2 to 2 m above the ground and does not go on above, as walls do.

    What is longer than a car (rows of cars, hedges) is cut into pieces of a car's size.
    """
    cells = np.floor(points_m[:, :2] / _CELL_M).astype(np.int64)
    low = np.flatnonzero((heights_m > LOW_M[0]) & (heights_m < LOW_M[1]))
    goes_on = (heights_m >= LOW_M[1]) & (heights_m < LOW_M[1] + _ABOVE_M)
    tall = {(int(a), int(b)) for a, b in cells[goes_on]}
    members: dict[Cell, list[int]] = {}
    for row in low:
        members.setdefault((int(cells[row, 0]), int(cells[row, 1])), []).append(int(row))
    result = []
    for cluster in _clusters(members):
        for piece in _pieces(cluster):
            rows = np.array([row for cell in piece for row in members[cell]])
            standing = sum(cell in tall for cell in piece) > _STANDING * len(piece)
            if len(rows) >= _MIN_POINTS and not standing:
                result.append(rows)
    return result


def _clusters(members: dict[Cell, list[int]]) -> list[list[Cell]]:
    left, clusters = dict.fromkeys(members), []
    while left:
        seed = next(iter(left))
        del left[seed]
        queue, cluster = deque([seed]), [seed]
        while queue:
            i, j = queue.popleft()
            for other in [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]:
                if other in left:
                    del left[other]
                    queue.append(other)
                    cluster.append(other)
        clusters.append(cluster)
    return clusters


def _pieces(cluster: list[Cell]) -> list[list[Cell]]:
    if np.ptp(np.array(cluster), axis=0).max() * _CELL_M <= _LONGEST_M:
        return [cluster]
    pieces: dict[Cell, list[Cell]] = {}
    for i, j in cluster:
        pieces.setdefault((i // _PIECE_CELLS, j // _PIECE_CELLS), []).append((i, j))
    return list(pieces.values())


def changed(points_m: Floats, heights_m: Floats, change: Change, random: np.random.Generator) -> Floats:
    """The cloud (n, 3) with `SHARE` of its low objects shifted by `SHIFT_M` or replaced by another of them, turned."""
    low = objects(points_m, heights_m)
    if not low:
        return points_m
    moved = points_m.copy()
    away = np.zeros(len(points_m), np.bool_)
    extra = []
    common_rad = random.uniform(-np.pi, np.pi)
    for k in random.choice(len(low), size=round(SHARE * len(low)), replace=False):
        rows = low[k]
        if change == "replaced":
            other = low[int(random.integers(len(low)))]
            turn = random.uniform(-np.pi, np.pi)
            cos, sin = np.cos(turn), np.sin(turn)
            shape = points_m[other] - points_m[other].mean(axis=0)
            place = np.array([*points_m[rows, :2].mean(axis=0), points_m[other, 2].mean()])
            extra.append(shape @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + place)
            away[rows] = True
        else:
            direction = common_rad if change == "shifted_together" else random.uniform(-np.pi, np.pi)
            moved[rows, :2] += SHIFT_M * np.array([np.cos(direction), np.sin(direction)])
    return np.concatenate([moved[~away], *extra])

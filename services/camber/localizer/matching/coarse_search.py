"""Coarse search: all positions within 5 m and 15° of the guess are scored, and the best few are matched.

The map's layers are rasters of proximity, a few hundred points of each layer are scored at every shift and turn,
and the best separate candidates are refined by `match_layers`. The best one is unique only if the next one is
clearly worse: in a tunnel, or along a row of equal houses, it is not, and the match is ambiguous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats, Integers
from camber.localizer.matching.icp import moved
from camber.localizer.matching.layered_matching import (
    LayeredMatch,
    MatchInput,
    MatchOptions,
    match_layers,
    split_layers,
)

UNIQUE_RATIO: Final = 0.9
"""Chosen: the best candidate is unique if no other has this share of its inliers."""
# Chosen: two cells; half a step, of yaw at 25 m too, is within the blur.
_STEP_M: Final = 0.5
_STEP_RAD: Final = math.radians(1.5)
# Chosen: resolution and blur of the raster.
_CELL_M: Final = 0.25
_BLUR_M: Final = 0.5
# Chosen: they bound the time of a search.
_POINTS_PER_LAYER: Final = 400
_CANDIDATES: Final = 6
_RIVAL_RATIO: Final = 0.7  # chosen: with less of the best score a candidate does not fit as well when refined
# Chosen: candidates nearer than these are one.
_APART_M: Final = 1.0
_APART_RAD: Final = math.radians(4.0)
# Chosen: matches nearer than these are the same.
_SAME_M: Final = 0.3
_SAME_RAD: Final = math.radians(1.0)
_CAPTURE_M: Final = 1.5  # chosen: error of a candidate of the grid at far points


class SearchRange(NamedTuple):
    """How far to search in each direction. Chosen: 5 m is the drift of dead reckoning over some 500 m."""

    m: float = 5.0
    rad: float = math.radians(15.0)


FULL_RANGE: Final = SearchRange()


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchResult:
    """The best match; ambiguous where a rival fits as well, and then its covariance covers all of them."""

    match: LayeredMatch
    unique: bool
    score: float
    """Share of all layers' points that lie on the map, of the best match."""
    best: LayeredMatch
    """The match without regard to rivals."""
    rivals: tuple[LayeredMatch, ...] = ()
    """Other matches that fit as well, by the share of points that lie on the map."""


def search(scan: MatchInput, options: MatchOptions, reach: SearchRange = FULL_RANGE) -> SearchResult:
    """Match as `match_layers` does, from everywhere around the guess."""
    options = replace(options, capture_distance_m=_CAPTURE_M)
    scored: list[tuple[float, LayeredMatch]] = []
    for offset in _candidates(scan, options, reach):
        match = match_layers(replace(scan, guess=moved(scan.guess, offset, "planar")), options)
        score = match_score(match)
        same = next((k for k, (_, other) in enumerate(scored) if _is_same(match, other)), None)
        if same is None:
            scored.append((score, match))
        elif score > scored[same][0]:
            scored[same] = (score, match)
    if not scored:
        lost = match_layers(scan, options)
        return SearchResult(match=lost, unique=False, score=0.0, best=lost)
    scored.sort(key=lambda item: -item[0])
    score, match = scored[0]
    best, rivals = match, tuple(other for points, other in scored[1:] if points >= UNIQUE_RATIO * score)
    unique = not rivals and score > 0.0
    if best.status == "lost":
        rivals = ()
    if rivals:
        offsets = (_apart(best, rival) for rival in rivals)
        spread = sum((np.outer(offset, offset) for offset in offsets), np.zeros((3, 3)))
        match = replace(best, status="ambiguous", reason="not_unique", covariance=best.covariance + spread)
    return SearchResult(match=match, unique=unique, score=score, best=best, rivals=rivals)


def seems_mirrored(scan: MatchInput, options: MatchOptions) -> bool:
    """Whether the local map fits only with left and right exchanged, as with a sensor whose y axis is reversed."""
    mirrored = search(replace(scan, points_m=scan.points_m * np.array([1.0, -1.0, 1.0])), options)
    if mirrored.match.status != "converged":
        return False
    return search(scan, options).score < UNIQUE_RATIO * mirrored.score


def match_score(match: LayeredMatch) -> float:
    """Return the share of the points of all layers that lie on a plane of the map."""
    points = sum(layer.fit.points for layer in match.layers)
    return sum(layer.inliers * layer.fit.points for layer in match.layers) / points if points else 0.0


def _apart(a: LayeredMatch, b: LayeredMatch) -> Floats:
    """Return east, north [m], yaw [rad] (3,) from one match to another."""
    return np.array([b.east_m - a.east_m, b.north_m - a.north_m, wrap_pi(b.yaw_rad - a.yaw_rad)])


def _is_same(a: LayeredMatch, b: LayeredMatch) -> bool:
    east_m, north_m, turn_rad = _apart(a, b)
    return math.hypot(east_m, north_m) < _SAME_M and abs(turn_rad) < _SAME_RAD


def _candidates(scan: MatchInput, options: MatchOptions, reach: SearchRange) -> list[Floats]:
    """Return the offsets (east, north [m], yaw [rad]) of the best separate candidates of the grid, best first."""
    shifts, turns = math.ceil(reach.m / _STEP_M), math.ceil(reach.rad / _STEP_RAD)
    scores = np.zeros((2 * turns + 1, 2 * shifts + 1, 2 * shifts + 1))
    layers = split_layers(scan, options.bounds_m, _POINTS_PER_LAYER)
    for points_m, target in zip(layers, scan.targets, strict=True):
        if target.empty or len(points_m) < options.min_points:
            continue
        turned_m = points_m @ scan.guess[:3, :3].T
        half_m = float(np.hypot(turned_m[:, 0], turned_m[:, 1]).max()) + shifts * _STEP_M + 1.0
        corner_m = scan.guess[:2, 3] - half_m
        raster = _proximity(target.points_m[:, :2] - corner_m, math.ceil(2.0 * half_m / _CELL_M))
        scores += _scores(turned_m, raster, half_m, (turns, shifts)) / len(points_m)
    offsets = []
    remaining = scores.copy()
    for _ in range(_CANDIDATES):
        best = np.unravel_index(int(np.argmax(remaining)), remaining.shape)
        if remaining[best] <= _RIVAL_RATIO * scores.max():
            break
        k, i, j = (int(index) for index in best)
        offsets.append(np.array([(i - shifts) * _STEP_M, (j - shifts) * _STEP_M, (k - turns) * _STEP_RAD]))
        near, about = round(_APART_M / _STEP_M), round(_APART_RAD / _STEP_RAD)
        remaining[
            max(k - about, 0) : k + about + 1,
            max(i - near, 0) : i + near + 1,
            max(j - near, 0) : j + near + 1,
        ] = 0.0
    return offsets


def _proximity(points_m: Floats, cells: int) -> NDArray[np.float32]:
    """Return a raster (cells, cells) of the proximity, 0 to 1, to the nearest point."""
    raster = np.zeros((cells, cells), np.float32)
    occupied = np.zeros((cells, cells), np.bool_)
    cell = np.floor(points_m / _CELL_M).astype(np.int64)
    inside = ((cell >= 0) & (cell < cells)).all(axis=1)
    occupied[cell[inside, 0], cell[inside, 1]] = True
    reach = math.ceil(2.0 * _BLUR_M / _CELL_M)
    steps = np.arange(-reach, reach + 1) * _CELL_M
    stamp = np.exp(-0.5 * (steps[:, None] ** 2 + steps**2) / _BLUR_M**2).astype(np.float32)
    _stamp(np.argwhere(occupied), stamp, raster)
    return raster


@compiled
def _stamp(cells: Integers, stamp: NDArray[np.float32], raster: NDArray[np.float32]) -> None:
    """Raise the raster to the stamp around each cell."""
    reach, n = stamp.shape[0] // 2, raster.shape[0]
    for k in range(len(cells)):
        for a in range(-reach, reach + 1):
            i = cells[k, 0] + a
            if i < 0 or i >= n:
                continue
            for b in range(-reach, reach + 1):
                j = cells[k, 1] + b
                if 0 <= j < n:
                    raster[i, j] = max(raster[i, j], stamp[a + reach, b + reach])


@compiled
def _scores(
    points_m: Floats, raster: NDArray[np.float32], half_m: float, turns_shifts: tuple[int, int]
) -> Floats:
    """Return sums (turns, east, north) of the proximity of points (n, 3) about the raster's middle."""
    turns, shifts = turns_shifts
    scores = np.zeros((2 * turns + 1, 2 * shifts + 1, 2 * shifts + 1))
    stride, n = round(_STEP_M / _CELL_M), raster.shape[0]
    reach = shifts * stride
    for k in range(2 * turns + 1):
        cos, sin = math.cos((k - turns) * _STEP_RAD), math.sin((k - turns) * _STEP_RAD)
        for p in range(len(points_m)):
            x = cos * points_m[p, 0] - sin * points_m[p, 1] + half_m
            y = sin * points_m[p, 0] + cos * points_m[p, 1] + half_m
            i, j = math.floor(x / _CELL_M), math.floor(y / _CELL_M)
            if i - reach < 0 or j - reach < 0 or i + reach >= n or j + reach >= n:
                continue
            for a in range(2 * shifts + 1):
                for b in range(2 * shifts + 1):
                    scores[k, a, b] += raster[i - reach + a * stride, j - reach + b * stride]
    return scores

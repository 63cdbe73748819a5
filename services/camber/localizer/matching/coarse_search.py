"""Where am I when lost: every place within 5 m and 15° of the guess is tried, and the best few are matched.

The map's layers are drawn as rasters of nearness, a few hundred points of each layer are laid on them at every shift
and turn, and the best places that are apart are refined by `match_layers`. A place is only *the* place if the next
best is clearly worse: along a tunnel, or a row of equal houses, it is not, and the answer is ambiguous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.localizer.map_clouds.downsampling import thinned_evenly
from camber.localizer.matching.layered_matching import LayeredMatch, MatchOptions, match_layers
from camber.localizer.matching.point_to_plane import moved
from camber.localizer.matching.registration import LayerTarget

Floats = NDArray[np.float64]
Nearness = NDArray[np.float32]

REACH_M = 5.0
REACH_RAD = math.radians(15.0)
UNIQUE_RATIO = 0.9
"""The best place is the only one if no other has this share of its inliers."""
_CELL_M = 0.25
_STEP_M = 0.5  # two cells; half of it, and half a step of yaw at 25 m, are within the rasters' blur
_STEP_RAD = math.radians(1.5)
_BLUR_M = 0.5
_POINTS_PER_LAYER = 400
_CANDIDATES = 6
_RIVAL_RATIO = (
    0.7  # of the best place's nearness: what is farther below does not fit as well after refinement
)
_APART_M = 1.0
_APART_RAD = math.radians(4.0)
_SAME_M = 0.3
_SAME_RAD = math.radians(1.0)
_CAPTURE_M = 1.5  # what the best place of the grid may still be off at the far points


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best match found; ambiguous where another place fits as well, and then its covariance holds them all."""

    match: LayeredMatch
    unique: bool
    score: float
    """Share of all layers' points that lie on the map, of the best place and of the next best that is another."""
    next_score: float
    best: LayeredMatch
    """The match as it would be without rivals."""
    rivals: tuple[LayeredMatch, ...] = ()
    """Other places that fit as well, by the share of points that lie on the map."""


def search(
    local_points_m: Floats,
    heights_m: Floats,
    targets: Sequence[LayerTarget],
    guess: Floats,
    options: MatchOptions | None = None,
    reach_m: float = REACH_M,
    reach_rad: float = REACH_RAD,
) -> SearchResult:
    """Match as `match_layers` does, from everywhere about `guess`, map_from_local (4, 4)."""
    options = replace(options or MatchOptions(), capture_distance_m=_CAPTURE_M)
    found: list[tuple[float, LayeredMatch]] = []
    for offset in _candidates(local_points_m, heights_m, targets, guess, options, reach_m, reach_rad):
        match = match_layers(local_points_m, heights_m, targets, moved(guess, offset, "planar"), options)
        score = match_score(match)
        same = [k for k, (_, other) in enumerate(found) if _same(match, other)]
        if not same:
            found.append((score, match))
        elif score > found[same[0]][0]:
            found[same[0]] = (score, match)
    if not found:
        lost = match_layers(local_points_m, heights_m, targets, guess, options)
        return SearchResult(lost, False, 0.0, 0.0, lost)
    found.sort(key=lambda place: -place[0])
    (score, match), next_score = found[0], found[1][0] if len(found) > 1 else 0.0
    best, unique = match, next_score < UNIQUE_RATIO * score
    rivals: tuple[LayeredMatch, ...] = ()
    if match.status != "lost" and not unique:
        rivals = tuple(other for other_score, other in found[1:] if other_score >= UNIQUE_RATIO * score)
        covariance = match.covariance + sum((_apart(match, rival) for rival in rivals), np.zeros((3, 3)))
        match = replace(match, status="ambiguous", reason="not_unique", covariance=covariance)
    return SearchResult(match, unique, score, next_score, best, rivals)


def seems_mirrored(
    local_points_m: Floats,
    heights_m: Floats,
    targets: Sequence[LayerTarget],
    guess: Floats,
    options: MatchOptions | None = None,
) -> bool:
    """Does the local map fit only with left and right exchanged, as from a sensor whose y points the wrong way?"""
    mirrored_m = local_points_m * np.array([1.0, -1.0, 1.0])
    mirrored = search(mirrored_m, heights_m, targets, guess, options)
    if mirrored.match.status != "converged":
        return False
    return search(local_points_m, heights_m, targets, guess, options).score < UNIQUE_RATIO * mirrored.score


def match_score(match: LayeredMatch) -> float:
    """Share of the points of all layers that lie on a plane of the map."""
    points = sum(row.fit.points for row in match.layers)
    return sum(row.inliers * row.fit.points for row in match.layers) / points if points else 0.0


def _apart(match: LayeredMatch, rival: LayeredMatch) -> Floats:
    """What the covariance (3, 3) of a match must hold for the rival to be within it."""
    turn = math.remainder(rival.yaw_rad - match.yaw_rad, math.tau)
    offset = np.array([rival.east_m - match.east_m, rival.north_m - match.north_m, turn])
    return np.outer(offset, offset)


def _same(a: LayeredMatch, b: LayeredMatch) -> bool:
    turn = math.remainder(a.yaw_rad - b.yaw_rad, math.tau)
    return math.hypot(a.east_m - b.east_m, a.north_m - b.north_m) < _SAME_M and abs(turn) < _SAME_RAD


def _candidates(
    local_points_m: Floats,
    heights_m: Floats,
    targets: Sequence[LayerTarget],
    guess: Floats,
    options: MatchOptions,
    reach_m: float,
    reach_rad: float,
) -> list[Floats]:
    """East, north [m], yaw [rad] from the guess of the best places of the grid, apart from one another, best first."""
    shifts, turns = math.ceil(reach_m / _STEP_M), math.ceil(reach_rad / _STEP_RAD)
    total = np.zeros((2 * turns + 1, 2 * shifts + 1, 2 * shifts + 1))
    for (low, high), target in zip(options.bounds_m, targets, strict=True):
        points_m = local_points_m[(heights_m >= low) & (heights_m < high)]
        points_m = thinned_evenly(points_m, _POINTS_PER_LAYER)
        if target.empty or len(points_m) < options.min_points:
            continue
        turned_m = points_m @ guess[:3, :3].T
        reach_of_cloud_m = float(np.hypot(turned_m[:, 0], turned_m[:, 1]).max()) + shifts * _STEP_M + 1.0
        origin_m = guess[:2, 3] - reach_of_cloud_m
        raster = _nearness(target.points_m[:, :2] - origin_m, math.ceil(2.0 * reach_of_cloud_m / _CELL_M))
        total += _scores(turned_m, raster, reach_of_cloud_m, turns, shifts) / len(points_m)
    places = []
    score = total.copy()
    for _ in range(_CANDIDATES):
        best = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[best] <= _RIVAL_RATIO * total.max():
            break
        k, i, j = (int(index) for index in best)
        places.append(np.array([(i - shifts) * _STEP_M, (j - shifts) * _STEP_M, (k - turns) * _STEP_RAD]))
        near, about = round(_APART_M / _STEP_M), round(_APART_RAD / _STEP_RAD)
        score[
            max(k - about, 0) : k + about + 1,
            max(i - near, 0) : i + near + 1,
            max(j - near, 0) : j + near + 1,
        ] = 0.0
    return places


def _nearness(points_m: Floats, cells: int) -> Nearness:
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
def _stamp(cells: NDArray[np.int64], stamp: Nearness, raster: Nearness) -> None:
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
def _scores(points_m: Floats, raster: Nearness, half_m: float, turns: int, shifts: int) -> Floats:
    """Sums (turns, east, north) of the nearness of points (n, 3) about the raster's middle."""
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

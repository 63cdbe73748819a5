"""Which roads a drive was on: its track, sampled by distance, with what it drove twice counted once.

The track becomes samples at equal distances; standing still adds none. A sample is *covered* when the vehicle has
been at its place before, on the same level: then the road there is the first pass's, whichever way it is driven.
What is not covered are *runs* of new road. A run that begins or ends at a covered sample is joined there to the
road it met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.schemas.base import Float64, Int64

SPACING_M = 2.0
"""Of samples along the road. Chosen: a road's height is straight over it to some millimetres."""
WIDTH_M = 8.0
"""Chosen: a street of two lanes."""
SAME_PLACE_M = 0.5 * WIDTH_M - 0.5
"""A track this near to an earlier one runs on the same road: within its width, with room for a curve's chord."""
OTHER_LEVEL_M = 2.0
"""Two tracks at one place whose heights differ by more are on different levels."""
BEYOND_END_M = 1.5
"""A road reaches this far beyond its last sample; what is further on is new road."""
_NO_OVERLAP_M = WIDTH_M + 1.0
"""Roads whose middles are further apart do not overlap."""
_STANDSTILL_STEP_M = 0.02  # chosen: the reference's noise (2 cm)
# A place counts as met again only if the way back to it was a detour: twice as long as straight, and 1 m more. So a
# bend does not meet itself, while reversing does.
_DETOUR = 2.0
_DETOUR_MORE_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLines:
    """Samples of a track; a sample is named by its index.

    `same_as[k]` is k for new road, else the sample of the first pass at its place. `level` is zero but where new road
    goes over (+) or under (−) what was driven earlier. `runs` are (first, last + 1) of
    consecutive new samples; `joined` gives, for each run, the earlier samples it starts and ends at, or −1.
    """

    distance_m: Float64
    east_north_m: Float64
    height_m: Float64
    same_as: Int64
    level: Int64
    runs: tuple[tuple[int, int], ...]
    joined: tuple[tuple[int, int], ...]


def road_lines(east_north_m: Float64, height_m: Float64) -> RoadLines:
    """Samples of a track given as (n, 2) and (n,), in the order driven; raises ValueError if it does not move."""
    step_m = np.hypot(*np.diff(east_north_m, axis=0).T)
    step_m[step_m < _STANDSTILL_STEP_M] = 0.0
    along_m = np.append(0.0, np.cumsum(step_m))
    if along_m[-1] < 2.0 * SPACING_M:
        raise ValueError(
            f"track is {along_m[-1]:.1f} m long, expected at least {2.0 * SPACING_M} m to make a road"
        )
    # The last of the epochs at one place stands for it: np.interp wants ascending distances.
    last = np.append(np.diff(along_m) > 0.0, True)
    samples_m = np.linspace(0.0, along_m[-1], int(np.ceil(along_m[-1] / SPACING_M)) + 1)
    east, north, height = (np.interp(samples_m, along_m[last], v[last]) for v in (*east_north_m.T, height_m))
    plane = np.column_stack((east, north))
    same_as = _first_passes(samples_m, plane, height)
    runs = _runs(same_as)
    joined = tuple(
        (int(same_as[a - 1]) if a > 0 else -1, int(same_as[b]) if b < len(same_as) else -1) for a, b in runs
    )
    return RoadLines(
        distance_m=samples_m, east_north_m=plane, height_m=height, same_as=same_as,
        level=_levels(plane, height, same_as), runs=runs, joined=joined,
    )  # fmt: skip


def _first_passes(distance_m: Float64, plane_m: Float64, height_m: Float64) -> Int64:
    same_as = np.arange(len(distance_m))
    new = np.ones(len(distance_m), dtype=bool)
    step_m = np.diff(plane_m, axis=0)
    step_m = np.vstack((step_m[0], step_m))
    ahead = step_m / np.maximum(np.hypot(*step_m.T), 1e-9)[:, None]
    for k in range(1, len(distance_m)):
        to_m = plane_m[k] - plane_m[:k]
        away_m = np.hypot(*to_m.T)
        met = new[:k] & (away_m <= SAME_PLACE_M) & (np.abs(height_m[:k] - height_m[k]) <= OTHER_LEVEL_M)
        met &= distance_m[k] - distance_m[:k] > _DETOUR * away_m + _DETOUR_MORE_M
        met &= np.abs(np.sum(to_m * ahead[:k], axis=1)) < BEYOND_END_M
        if met.any():
            same_as[k] = int(np.argmin(np.where(met, away_m, np.inf)))
            new[k] = False
    return same_as


def _levels(plane_m: Float64, height_m: Float64, same_as: Int64) -> Int64:
    """One above (below) the new road met earlier that is more than two metres lower (higher) there; covered: zero."""
    levels = np.zeros(len(height_m), dtype=np.int64)
    new = same_as == np.arange(len(same_as))
    for k in np.flatnonzero(new).tolist():
        near = new[:k] & (np.hypot(*(plane_m[:k] - plane_m[k]).T) <= _NO_OVERLAP_M)
        below = levels[:k][near & (height_m[:k] < height_m[k] - OTHER_LEVEL_M)]
        above = levels[:k][near & (height_m[:k] > height_m[k] + OTHER_LEVEL_M)]
        if len(below):
            levels[k] = below.max() + 1
        elif len(above):
            levels[k] = above.min() - 1
    return levels


def _runs(same_as: Int64) -> tuple[tuple[int, int], ...]:
    new = np.concatenate(([False], same_as == np.arange(len(same_as)), [False]))
    edges = np.flatnonzero(np.diff(new.astype(np.int8)))
    return tuple((int(a), int(b)) for a, b in edges.reshape(-1, 2))

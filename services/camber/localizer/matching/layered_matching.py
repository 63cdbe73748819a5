"""Layered scan matching (M, JP2016-109650A, steps 12 to 14): each layer of height by itself, then one answer.

The local map is in L, the vehicle's frame with z = 0 on the road; the map in a local frame of the block. Heights that
split the local map are above the road, and so are those of the layers' targets. What is matched is east, north and
yaw of L's origin; height, roll and pitch are the guess's (M, step 10; `road_fit`): walls say little of them.

An answer is *converged*, *ambiguous* (the layers disagree without a majority, or a direction is not seen: the
covariance is large along it, and the answer stays where the guess was) or *lost* (nothing fits).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camber.localizer.map_clouds.downsampling import thinned_evenly
from camber.localizer.matching.layer_selection import LayerEstimate, Rule, choose
from camber.localizer.matching.match_covariance import (
    UNSEEN_M,
    UNSEEN_RAD,
    common,
    degenerate,
    planar_covariance,
    without_unseen,
)
from camber.localizer.matching.point_to_plane import (
    Correspondences,
    IcpResult,
    find_correspondences,
    icp_point_to_plane,
    moved,
    normal_equations,
)
from camber.localizer.matching.registration import LayerFit, LayerTarget, Method, fit_of, register

Floats = NDArray[np.float64]
Bounds = tuple[tuple[float, float], ...]
Status = Literal["converged", "ambiguous", "lost"]
Reason = Literal[
    "agreed", "layers_disagree", "few_layers", "direction_unseen",
    "not_unique", "not_searched", "low_things", "too_few_points", "not_converged", "low_overlap", "large_residual",
]  # fmt: skip

_LAYER_SCALE_M = 0.15
"""Where the joint fit hands over to the layers: half the depth of what stands in front of a wall."""
_UNSUPPORTED = np.diag([0.5**2, 0.5**2, math.radians(1.5) ** 2])
"""Added to the covariance where most layers do not fit and the rest have nobody to ask."""
DOCUMENT_BOUNDS_M: Bounds = ((0.0, 1.0), (1.0, 2.0), (2.0, 3.0))


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """How to match. The defaults follow from the sizes of things in a street, not from a recording."""

    layer_bounds_m: Bounds = ((0.3, 1.0), (1.0, 2.0), (2.0, 3.0))
    """Heights above the road; M's, but for the road itself, which says nothing of east and north."""
    method: Method = "point_to_plane"
    choice: Rule | Literal["whole"] = "voted"
    """"whole": all layers as one."""
    max_distance_m: float = 1.0
    """d_max of each layer's pairs."""
    capture_distance_m: float = 3.0
    """Point-to-plane starts with a joint fit of all layers with pairs up to this far apart: a start that is 1 m and
    5° off is 3.6 m off at 30 m."""
    points_per_layer: int = 2000
    points_at_start: int = 600
    max_iterations: int = 30
    min_points: int = 100
    """Of a layer's cloud, to be asked at all."""
    min_overlap: float = 0.5
    """Share of a layer's points with map within 0.3 m; cars that came and went are less than half of a street."""
    max_residual: float = 3.0
    """Weighted root mean square of the residuals over their expected σ."""

    @property
    def bounds_m(self) -> Bounds:
        """The layers of which `match_layers` wants a target each."""
        if self.choice == "whole":
            return ((self.layer_bounds_m[0][0], self.layer_bounds_m[-1][1]),)
        return self.layer_bounds_m


@dataclass(frozen=True, eq=False)
class LayerMatch:
    """One layer of a match."""

    bounds_m: tuple[float, float]
    fit: LayerFit
    offset: Floats
    """(3,) east, north [m], yaw [rad] of L's origin from the guess."""
    covariance: Floats
    """(3, 3) of them."""
    residual: float
    """Root mean square of the point-to-plane residuals over their expected σ, outliers weighted down."""
    inliers: float
    """Share of the points that lie on a plane of the map, within 2.4 σ."""
    outcome: Literal["used", "voted_out", "too_few_points", "not_converged", "low_overlap", "large_residual"]


@dataclass(frozen=True, eq=False)
class LayeredMatch:
    """The answer. Lost: `map_from_local` is the guess and the covariance says: not known."""

    status: Status
    reason: Reason
    map_from_local: Floats
    """(4, 4)"""
    covariance: Floats
    """(3, 3) of east, north [m], yaw [rad] of L's origin, in the map's frame."""
    layers: tuple[LayerMatch, ...]

    @property
    def east_m(self) -> float:
        """Of L's origin in the map's frame."""
        return float(self.map_from_local[0, 3])

    @property
    def north_m(self) -> float:
        """Of L's origin in the map's frame."""
        return float(self.map_from_local[1, 3])

    @property
    def yaw_rad(self) -> float:
        """Counter-clockwise from the frame's x."""
        return math.atan2(self.map_from_local[1, 0], self.map_from_local[0, 0])


def match_layers(
    local_points_m: Floats,
    heights_m: Floats,
    targets: Sequence[LayerTarget],
    guess: Floats,
    options: MatchOptions | None = None,
) -> LayeredMatch:
    """Match a local map (n, 3) [m] in L, heights (n,) above the road, to `targets`, one for each `options.bounds_m`.

    `guess` is map_from_local (4, 4). Raises ValueError for another number of targets.
    """
    options = options or MatchOptions()
    if len(targets) != len(options.bounds_m):
        raise ValueError(f"{len(targets)} targets, expected {len(options.bounds_m)}, one for each layer")
    sources = [
        thinned_evenly(local_points_m[(heights_m >= low) & (heights_m < high)], options.points_per_layer)
        for low, high in options.bounds_m
    ]
    start = _joint_start(sources, targets, guess, options) if options.method == "point_to_plane" else None
    rows = [
        _row(*each, guess, start, options) for each in zip(options.bounds_m, sources, targets, strict=True)
    ]
    return _answer(rows, guess, options)


def _joint_start(
    sources: Sequence[Floats], targets: Sequence[LayerTarget], guess: Floats, options: MatchOptions
) -> IcpResult:
    few = [thinned_evenly(source, options.points_at_start) for source in sources]
    reach_m = options.capture_distance_m
    layers = list(zip(targets, few, strict=True))
    return icp_point_to_plane(layers, guess, "planar", reach_m, reach_m / 3.0, _LAYER_SCALE_M)


def _registered(
    source_m: Floats, target: LayerTarget, guess: Floats, start: IcpResult | None, options: MatchOptions
) -> tuple[LayerFit, Floats, Correspondences]:
    """The layer's fit, its offset from the guess, and the pairs there."""
    d_max_m = options.max_distance_m
    if options.method == "point_to_plane":
        begin = guess if start is None else start.transform
        limit = options.max_iterations
        planes = icp_point_to_plane(
            [(target, source_m)], begin, "planar", d_max_m, _LAYER_SCALE_M, max_iterations=limit
        )
        pairs = find_correspondences(target, source_m, planes.transform)
        iterations = planes.iterations + (0 if start is None else start.iterations)
        fit = fit_of(planes.transform, planes.converged, iterations, pairs[1], d_max_m)
        return fit, _offset(guess, fit.transform), pairs
    fit = register(target, source_m, guess, options.method, d_max_m, options.max_iterations)
    offset = _offset(guess, fit.transform)
    return fit, offset, find_correspondences(target, source_m, moved(guess, offset, "planar"))


def _row(
    bounds_m: tuple[float, float],
    source_m: Floats,
    target: LayerTarget,
    guess: Floats,
    start: IcpResult | None,
    options: MatchOptions,
) -> LayerMatch:
    fit, offset, pairs = _registered(source_m, target, guess, start, options)
    planes = normal_equations(target, source_m, moved(guess, offset, "planar"), "planar", pairs)
    residual = math.sqrt(planes.square / planes.weight) if planes.weight else math.inf
    outcome: Literal["used", "too_few_points", "not_converged", "low_overlap", "large_residual"] = "used"
    if fit.points < options.min_points or target.empty:
        outcome = "too_few_points"
    elif not fit.converged:
        outcome = "not_converged"
    elif fit.overlap < options.min_overlap:
        outcome = "low_overlap"
    elif residual > options.max_residual:
        outcome = "large_residual"
    inliers = float(np.mean(planes.kept)) if len(source_m) else 0.0
    covariance = planar_covariance(planes, source_m)
    if options.method != "point_to_plane":
        # Least squares of points follow what has moved; what the planes would still correct is evidence of it.
        step = planes.step()
        covariance = covariance + np.outer(step, step)
    return LayerMatch(bounds_m, fit, offset, covariance, residual, inliers, outcome)


def _offset(guess: Floats, transform: Floats) -> Floats:
    turned = transform[:3, :3] @ guess[:3, :3].T
    return np.array(
        [
            *(transform[:2, 3] - guess[:2, 3]),
            math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1]),
        ]
    )


def _answer(rows: list[LayerMatch], guess: Floats, options: MatchOptions) -> LayeredMatch:
    usable = [i for i, row in enumerate(rows) if row.outcome == "used"]
    asked = [row for row in rows if row.outcome != "too_few_points"]
    if not usable:
        unseen = np.diag([UNSEEN_M**2, UNSEEN_M**2, UNSEEN_RAD**2])
        reason: Reason = asked[0].outcome if asked else "too_few_points"  # type: ignore[assignment]
        return LayeredMatch("lost", reason, guess.copy(), unseen, tuple(rows))
    rule: Rule = "voted" if options.choice == "whole" else options.choice
    choice = choose(
        [LayerEstimate(rows[i].offset, rows[i].covariance, rows[i].fit.mean_distance_m) for i in usable], rule
    )
    for i, used in zip(usable, choice.used, strict=True):
        if not used:
            rows[i] = replace(rows[i], outcome="voted_out")
    status: Status = "ambiguous"
    covariance = choice.covariance + common()
    offset = without_unseen(choice.offset, covariance)
    if not choice.agreed:
        reason = "layers_disagree"
    elif 2 * len(usable) <= len(asked):
        reason, covariance = "few_layers", covariance + _UNSUPPORTED
    elif degenerate(choice.covariance):
        reason = "direction_unseen"
    else:
        status, reason = "converged", "agreed"
    return LayeredMatch(status, reason, moved(guess, offset, "planar"), covariance, tuple(rows))

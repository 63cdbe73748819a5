"""Layered scan matching (JP2016-109650A, steps 12 to 14): each layer of height is registered alone, then one is
selected.

The local map is in the local frame, the vehicle's frame with z = 0 on the road; the map is in the frame of its
block. Heights that split the local map are above the road, as are those of the layers' targets. East, north and yaw
of L's origin are matched; height, roll and pitch are the guess's (step 10, `ground_alignment`): walls hardly
observe them.

A match is *converged*, *ambiguous* (the layers disagree without a majority, or a direction is degenerate: the
covariance is large along it, and the match stays at the guess) or *lost* (no layer fits).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.map_clouds.voxel_grid import thinned_evenly
from camber.localizer.matching.icp import (
    Correspondences,
    IcpOptions,
    IcpResult,
    find_correspondences,
    icp_point_to_plane,
    moved,
    normal_equations,
)
from camber.localizer.matching.layer_selection import LayerEstimate, select
from camber.localizer.matching.match_covariance import (
    COMMON_COVARIANCE,
    UNSEEN_COVARIANCE,
    is_degenerate,
    planar_covariance,
    without_degenerate,
)
from camber.localizer.matching.registration import LayerBounds, LayerFit, LayerTarget, Method, register

MatchStatus: TypeAlias = Literal["converged", "ambiguous", "lost"]
LayerFailure: TypeAlias = Literal["too_few_points", "not_converged", "low_overlap", "large_residual"]
MatchReason: TypeAlias = (
    LayerFailure
    | Literal["agreed", "layers_disagree", "few_layers", "direction_unseen"]
    | Literal["not_unique", "not_searched", "low_things"]
)
LayerChoice: TypeAlias = Literal["voted", "best", "mean", "weighted", "whole"]

_LAYER_SCALE_M: Final = 0.15
"""Chosen: scale at which the joint ICP hands over to the layers, half the depth of objects in front of a wall."""
_UNSUPPORTED = np.diag([0.5**2, 0.5**2, math.radians(1.5) ** 2])
"""Chosen: added to the covariance where most layers do not fit, so that none supports the rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOptions:
    """Parameters of a match. The defaults follow from the sizes of objects in a street, not from a recording."""

    layer_bounds_m: LayerBounds = ((0.3, 1.0), (1.0, 2.0), (2.0, 3.0))
    """Heights above the road; JP2016-109650A's, without the road, which observes neither east nor north."""
    method: Method = "point_to_plane"
    choice: LayerChoice = "voted"
    """"whole": all layers as one."""
    max_distance_m: float = 1.0
    """d_max of a layer's correspondences."""
    capture_distance_m: float = 3.0
    """d_max of the joint point-to-plane ICP of all layers that comes first: a start 1 m and 5° off is 3.6 m off at
    30 m."""
    points_per_layer: int = 2000
    points_at_start: int = 600
    max_iterations: int = 30
    min_points: int = 100
    """Of a layer's cloud, to be used at all."""
    min_overlap: float = 0.5
    """Share of a layer's points with map within 0.3 m; parked cars are less than half of a street."""
    max_residual: float = 3.0
    """Weighted root mean square of residual / σ."""

    @property
    def bounds_m(self) -> LayerBounds:
        """The layers of which `match_layers` expects a target each."""
        if self.choice == "whole":
            return ((self.layer_bounds_m[0][0], self.layer_bounds_m[-1][1]),)
        return self.layer_bounds_m


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchInput:
    """A local map and the layers of the map to match it to."""

    points_m: Floats
    """(n, 3) in the local frame."""
    heights_m: Floats
    """(n,) of them above the road."""
    targets: Sequence[LayerTarget]
    """One for each of `MatchOptions.bounds_m`."""
    guess: Floats
    """map_from_local (4, 4)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LayerMatch(LayerEstimate):
    """The match of one layer: the estimate is of L's origin."""

    bounds_m: tuple[float, float]
    fit: LayerFit
    residual: float
    """Root mean square of residual / σ of the point-to-plane residuals, outliers weighted down."""
    inliers: float
    """Share of the points that lie on a plane of the map, within 2.4 σ."""
    outcome: Literal["used", "voted_out"] | LayerFailure


@dataclass(frozen=True, eq=False, kw_only=True)
class LayeredMatch:
    """The match. Lost: `map_from_local` is the guess and the covariance is that of nothing observed."""

    status: MatchStatus
    reason: MatchReason
    map_from_local: Floats
    """(4, 4)"""
    covariance: Floats
    """(3, 3) of east, north [m], yaw [rad] of L's origin, in the map's frame."""
    layers: tuple[LayerMatch, ...]

    @property
    def east_m(self) -> float:
        """East of L's origin in the map's frame."""
        return float(self.map_from_local[0, 3])

    @property
    def north_m(self) -> float:
        """North of L's origin in the map's frame."""
        return float(self.map_from_local[1, 3])

    @property
    def yaw_rad(self) -> float:
        """Yaw, counter-clockwise from the frame's x."""
        return math.atan2(self.map_from_local[1, 0], self.map_from_local[0, 0])


def match_layers(scan: MatchInput, options: MatchOptions) -> LayeredMatch:
    """Split the local map into layers, register each to its target, and select one estimate.

    Raises ValueError unless there is one target for each of `options.bounds_m`.
    """
    if len(scan.targets) != len(options.bounds_m):
        raise ValueError(f"{len(scan.targets)} targets, expected {len(options.bounds_m)}, one for each layer")
    sources = split_layers(scan, options.bounds_m, options.points_per_layer)
    joint = _joint_icp(sources, scan, options) if options.method == "point_to_plane" else None
    layers = [
        _register_layer(bounds_m, source, target, guess=scan.guess, joint=joint, options=options)
        for bounds_m, source, target in zip(options.bounds_m, sources, scan.targets, strict=True)
    ]
    return _select(layers, scan.guess, options)


def split_layers(scan: MatchInput, bounds_m: LayerBounds, at_most: int) -> list[Floats]:
    """Return the points of each layer of height above the road, thinned."""
    return [
        thinned_evenly(scan.points_m[(scan.heights_m >= low) & (scan.heights_m < high)], at_most)
        for low, high in bounds_m
    ]


def _joint_icp(sources: Sequence[Floats], scan: MatchInput, options: MatchOptions) -> IcpResult:
    """Register all layers by one motion, with distant correspondences, as a start for each layer."""
    few = [thinned_evenly(source, options.points_at_start) for source in sources]
    capture = IcpOptions(
        free="planar",
        max_distance_m=options.capture_distance_m,
        first_scale_m=options.capture_distance_m / 3.0,
        last_scale_m=_LAYER_SCALE_M,
    )
    return icp_point_to_plane(list(zip(scan.targets, few, strict=True)), scan.guess, capture)


def _register(
    source_m: Floats, target: LayerTarget, guess: Floats, *, joint: IcpResult | None, options: MatchOptions
) -> tuple[LayerFit, Floats, Correspondences]:
    """Return the layer's fit, its offset from the guess, and the correspondences there."""
    d_max_m, iterations = options.max_distance_m, options.max_iterations
    if options.method != "point_to_plane" or joint is None:
        assert options.method != "point_to_plane"
        fit = register(
            target, source_m, guess, method=options.method, max_distance_m=d_max_m, max_iterations=iterations
        )
        offset = _offset(guess, fit.transform)
        return fit, offset, find_correspondences(target, source_m, moved(guess, offset, "planar"))
    refine = IcpOptions(
        free="planar", max_distance_m=d_max_m, first_scale_m=_LAYER_SCALE_M, max_iterations=iterations
    )
    icp = icp_point_to_plane([(target, source_m)], joint.transform, refine)
    correspondences = find_correspondences(target, source_m, icp.transform)
    fit = LayerFit.of(icp.transform, correspondences[1], d_max_m, converged=icp.converged)
    return fit, _offset(guess, fit.transform), correspondences


def _register_layer(
    bounds_m: tuple[float, float],
    source_m: Floats,
    target: LayerTarget,
    *,
    guess: Floats,
    joint: IcpResult | None,
    options: MatchOptions,
) -> LayerMatch:
    """Register a layer and evaluate its residuals, overlap and covariance."""
    fit, offset, correspondences = _register(source_m, target, guess, joint=joint, options=options)
    at = moved(guess, offset, "planar")
    equations = normal_equations(target, source_m, at, correspondences, free="planar")
    residual = equations.rms()
    covariance = planar_covariance(equations, source_m)
    if options.method != "point_to_plane":
        # Least squares of points follow what has moved; the step that the planes still ask for is evidence of it.
        step = equations.step()
        covariance = covariance + np.outer(step, step)
    outcome: Literal["used"] | LayerFailure = "used"
    if fit.points < options.min_points or target.empty:
        outcome = "too_few_points"
    elif not fit.converged:
        outcome = "not_converged"
    elif fit.overlap < options.min_overlap:
        outcome = "low_overlap"
    elif residual > options.max_residual:
        outcome = "large_residual"
    return LayerMatch(
        bounds_m=bounds_m,
        fit=fit,
        offset=offset,
        covariance=covariance,
        mean_distance_m=fit.mean_distance_m,
        residual=residual,
        inliers=float(np.mean(equations.inliers)) if len(source_m) else 0.0,
        outcome=outcome,
    )


def _offset(guess: Floats, transform: Floats) -> Floats:
    """Return east, north [m], yaw [rad] of a transform from the guess."""
    turned = transform[:3, :3] @ guess[:3, :3].T
    yaw_rad = math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    return np.array([*(transform[:2, 3] - guess[:2, 3]), yaw_rad])


def _select(layers: list[LayerMatch], guess: Floats, options: MatchOptions) -> LayeredMatch:
    """Select one estimate from the layers that fit, and classify the match."""
    usable = [i for i, layer in enumerate(layers) if layer.outcome == "used"]
    candidates = [layer for layer in layers if layer.outcome != "too_few_points"]
    if not usable:
        failure = next((layer.outcome for layer in candidates), "too_few_points")
        assert failure in get_args(LayerFailure)
        return LayeredMatch(
            status="lost",
            reason=failure,  # type: ignore[arg-type]
            map_from_local=guess.copy(),
            covariance=UNSEEN_COVARIANCE.copy(),
            layers=tuple(layers),
        )
    selected = select([layers[i] for i in usable], "voted" if options.choice == "whole" else options.choice)
    for i, used in zip(usable, selected.used, strict=True):
        if not used:
            layers[i] = replace(layers[i], outcome="voted_out")
    covariance = selected.covariance + COMMON_COVARIANCE
    offset = without_degenerate(selected.offset, covariance)
    status: MatchStatus = "ambiguous"
    reason: MatchReason = "direction_unseen"
    if not selected.agreed:
        reason = "layers_disagree"
    elif 2 * len(usable) <= len(candidates):
        reason, covariance = "few_layers", covariance + _UNSUPPORTED
    elif not is_degenerate(selected.covariance):
        status, reason = "converged", "agreed"
    return LayeredMatch(
        status=status,
        reason=reason,
        map_from_local=moved(guess, offset, "planar"),
        covariance=covariance,
        layers=tuple(layers),
    )

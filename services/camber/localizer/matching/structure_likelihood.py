"""Rivals and shifts of a match by the likelihood of the map's static structure."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from camber.geodesy.se3 import transform_points
from camber.localizer.arrays import Mask
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.coarse_search import SearchResult
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput
from camber.localizer.matching.match_covariance import DEGENERATE_SIGMA_M
from camber.localizer.matching.shift_profile import log_likelihoods, shift_profile

STRUCTURE_M: Final = (0.3, 3.0)
"""Chosen: heights between which the local map is compared with the static structure: the bounds of the layers."""
_RIVAL_LOG_RATIO: Final = math.log(1.0e6)
"""Chosen: a rival that the static structure makes so much less likely is none."""


def outweighs_rivals(result: SearchResult, scan: MatchInput, block: MapBlock) -> bool:
    """Whether the static structure makes the best match far more likely than rivals with as many points on the map:
    long walls fit anywhere along themselves, and outnumber what does not."""
    poses = [result.best.map_from_local, *(rival.map_from_local for rival in result.rivals)]
    points_m = scan.points_m[_is_structure(scan)]
    best, *others = log_likelihoods(points_m, poses, block.static_occupancy).tolist()
    return bool(best - max(others) > _RIVAL_LOG_RATIO)


def _is_structure(scan: MatchInput) -> Mask:
    return (scan.heights_m > STRUCTURE_M[0]) & (scan.heights_m < STRUCTURE_M[1])


def with_shift_variance(match: LayeredMatch, scan: MatchInput, block: MapBlock) -> LayeredMatch:
    """Return the match with the variance that shifts along its worst direction leave open."""
    values, vectors = np.linalg.eigh(match.covariance[:2, :2])
    worst = vectors[:, 1]
    placed_m = transform_points(match.map_from_local, scan.points_m[_is_structure(scan)])
    more_m2 = shift_profile(placed_m, block.static_occupancy, worst).variance_m2 - float(values[1])
    if more_m2 <= 0.0:
        return match
    covariance = match.covariance.copy()
    covariance[:2, :2] += more_m2 * np.outer(worst, worst)
    if match.status == "converged" and more_m2 > DEGENERATE_SIGMA_M**2:
        return replace(match, status="ambiguous", reason="direction_unseen", covariance=covariance)
    return replace(match, covariance=covariance)

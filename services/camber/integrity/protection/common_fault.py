"""A position under the hypothesis that all fixes are off by one vector, or that the map is shifted.

Wrong base coordinate, fixes that are led away, a captured pose: candidate and pose are then off alike, by a vector b.
With the candidate x = truth + b and the independent position y = truth + e, e ~ N(0, C), their difference
d = x − y = b − e is known, and the error of the candidate is

    x − truth = d + e ~ N(d, C)

whatever b is: the bound is the distance to the independent position and the error that this has by its sensors and
calibrations since its last evidence. C grows with the way driven, and the level with it. If the independent position
is at fault too, by a vector N(0, M) of another cause, the error is N(d, C + M). The weights are
`common_fault_probability`. Solution separation (Blanch et al. 2015, IEEE Trans. AES 51(1), 713–732) bounds a faulted
subset in the same way, by the distance to the solution that does not use it.

A wrong fix that has passed and taken the pose along (`latent_fault`) is such a fault, of which more is known: its error
is N(0, G), so with d at most N(d, 2 (G⁻¹ + C⁻¹)⁻¹). The factor is 1 if the errors of both positions are independent,
which those of a pose and of the independent position, by the same odometry and matches, are not: their conditional
covariance T has T ⪯ G and T ⪯ C, hence T⁻¹ ⪰ (G⁻¹ + C⁻¹) / 2.

A shifted map shifts the independent position with it, and whatever position the map gives. Its prior is small beside
the others: of a candidate of the fixes it counts together with a common fault, of a candidate of the map alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camber.integrity.checks.independent_position import OffsetFromIndependent, offset_from_independent
from camber.integrity.protection.common_fault_probability import (
    CommonFaultOdds,
    CommonFaultRules,
    HorizontalColumns,
    common_fault_odds,
    determinant,
    likelihood_ratio,
)
from camber.integrity.protection.position_bounds import (
    ErrorMixture,
    Horizontal,
    LevelRules,
    MixtureComponent,
)
from camber.integrity.protection.position_candidates import PositionCandidate, road_components
from camber.schemas.pose import Pose

_LEAST_SHARE = 1e-13
"""Chosen: beside a latent fault that is certain in floats; its odds are then those of `MOST_LOG_ODDS`."""


def with_common_fault(
    candidate: PositionCandidate, pose: Pose | None, rules: LevelRules
) -> PositionCandidate | None:
    """The candidate with these hypotheses too; None where the pose has no independent position to see them by."""
    latitude_rad, longitude_rad, _ = candidate.geodetic
    offset = (
        offset_from_independent(latitude_rad, longitude_rad, pose, candidate.time_ns)
        if pose is not None
        else None
    )
    if pose is None or offset is None:
        return None
    faults = rules.common_fault
    parts = [part for part in candidate.mixture.parts if not part.is_latent]
    latent = sum(part.weight for part in candidate.mixture.parts if part.is_latent)
    rest = max(1.0 - latent, _LEAST_SHARE)
    if_right_m2 = _sum(_horizontal(candidate), offset.covariance_m2)
    odds = common_fault_odds(offset.difference_m, if_right_m2, faults)
    after = _latent_after(candidate, offset, if_right_m2, faults)
    total = 1.0 + odds.alone + odds.with_independent + sum(part.weight for part in after) / rest
    if candidate.source in ("sensors", "scan_match"):
        parts = _with_shifted_map(parts, faults)
    mixture = ErrorMixture(
        (
            *(part.weighed(1.0 / (rest * total)) for part in (*parts, *after)),
            *_common_fault_parts(candidate, offset, odds=odds, total=total, rules=rules),
        ),
        candidate.mixture.lost,
    )
    return replace(candidate, mixture=mixture)


def _latent_after(
    candidate: PositionCandidate,
    offset: OffsetFromIndependent,
    if_right_m2: Horizontal,
    faults: CommonFaultRules,
) -> list[MixtureComponent]:
    """The latent faults of the candidate after the comparison, with weights relative to those of its other parts."""
    parts = [part for part in candidate.mixture.parts if part.is_latent and part.weight != 0.0]
    if not parts:
        return []
    horizontal_m2 = _columns([part.horizontal_m2 for part in parts])
    mean_east_m, mean_north_m, _ = _columns([part.mean_m for part in parts])
    if_wrong_m2 = _sum(horizontal_m2, offset.covariance_m2)
    both_m2 = _plus(if_wrong_m2, faults.independent_sigma_m)
    off_m = offset.difference_m[0] - mean_east_m, offset.difference_m[1] - mean_north_m
    right = offset.difference_m, if_right_m2
    ratios = likelihood_ratio(off_m, if_wrong_m2, *right).tolist()
    both = likelihood_ratio(off_m, both_m2, *right).tolist()
    shares_errors = candidate.source in ("sensors", "scan_match")
    bounded_m2 = np.transpose(_conditional(horizontal_m2, offset.covariance_m2, shares_errors)).tolist()
    result = []
    for part, ratio, (ee, en, nn) in zip(parts, ratios, bounded_m2, strict=True):
        mean_m = *offset.difference_m, part.mean_m[2]
        result.append(part._replace(weight=ratio * part.weight, mean_m=mean_m, horizontal_m2=(ee, en, nn)))
    doubted = [
        part.weighed(faults.independent_prior * ratio) for part, ratio in zip(parts, both, strict=True)
    ]
    return [*result, *doubted]


def _columns(rows: list[tuple[float, float, float]]) -> HorizontalColumns:
    first, second, third = np.array(rows).T
    return first, second, third


def _conditional(
    one_m2: HorizontalColumns, other_m2: HorizontalColumns, shares_errors: bool
) -> HorizontalColumns:
    """(A⁻¹ + B⁻¹)⁻¹ = (det A · B + det B · A) / det(A + B), twice where the errors may have a part in common.

    In two dimensions, by adj(A) = tr(A) 1 − A.
    """
    det_one, det_other, total = (
        determinant(one_m2),
        determinant(other_m2),
        determinant(_sum(one_m2, other_m2)),
    )
    scale = (2.0 if shares_errors else 1.0) / total
    a, b, c = (
        scale * (det_one * other + det_other * one) for one, other in zip(one_m2, other_m2, strict=True)
    )
    return a, b, c


def _horizontal(candidate: PositionCandidate) -> Horizontal:
    ee, en, _, nn, _, _ = candidate.covariance_enu_m2
    return ee, en, nn


def _sum(one_m2: HorizontalColumns, other_m2: HorizontalColumns) -> HorizontalColumns:
    return one_m2[0] + other_m2[0], one_m2[1] + other_m2[1], one_m2[2] + other_m2[2]


def _plus(covariance_m2: HorizontalColumns, sigma_m: float) -> HorizontalColumns:
    ee, en, nn = covariance_m2
    return ee + sigma_m**2, en, nn + sigma_m**2


def _common_fault_parts(
    candidate: PositionCandidate,
    offset: OffsetFromIndependent,
    *,
    odds: CommonFaultOdds,
    total: float,
    rules: LevelRules,
) -> tuple[MixtureComponent, ...]:
    """Where the vehicle is if only the independent position shows it, or a map that is shifted, or not even that."""
    faults, (mean_up_m, up_m2) = rules.common_fault, candidate.up_by_road_m
    off = MixtureComponent(
        weight=1.0,
        mean_m=(*offset.difference_m, mean_up_m),
        horizontal_m2=offset.covariance_m2,
        up_m2=up_m2,
    )
    share = faults.map_shift_prior
    return (
        *road_components(off, (1.0 - share) * odds.alone / total, rules),
        *road_components(_wider(off, faults.map_shift_sigma_m), share * odds.alone / total, rules),
        *road_components(_wider(off, faults.independent_sigma_m), odds.with_independent / total, rules),
    )


def _with_shifted_map(parts: list[MixtureComponent], faults: CommonFaultRules) -> list[MixtureComponent]:
    """Of a position that the map gives: its first part, once more on a map that is shifted."""
    first, share = parts[0], faults.map_shift_prior
    shifted = _wider(first, faults.map_shift_sigma_m).weighed(share)
    return [first.weighed(1.0 - share), *parts[1:], shifted]


def _wider(part: MixtureComponent, sigma_m: float) -> MixtureComponent:
    return part._replace(horizontal_m2=_plus(part.horizontal_m2, sigma_m))
